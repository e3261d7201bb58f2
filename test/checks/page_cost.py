"""
Measure the cost of the page for an odometry on the same machine: round trips with and without it.

A round trip is from the publication of joint_states to the receipt of odom, in another process;
each round has a new odometry. The browser runs without a debugger, which would receive each frame
and use the processor as well. Exits with 1 if a figure is above its bound. make page runs it.
"""
import argparse
from collections.abc import Iterator
from contextlib import contextmanager, nullcontext
import json
import os
from pathlib import Path
import signal
from statistics import median
import subprocess
import sys
import tempfile
import time

from benchmark.benchmark import node_of, run
from support.browser import CHROMIUM, Dashboard, missing

MAX_RATIOS = {'cpu_us': 1.1, 'p99_us': 2.0}  # of the figures with and without the page
OPENING_S = 6.0  # until the page is loaded and drawn
DOMAINS = range(60, 100)


def main() -> int:
    """Measure, and print figures; return the exit code."""
    parser = argparse.ArgumentParser(description=__doc__.strip().split('\n')[0])
    parser.add_argument('--rounds', type=int, default=8)
    parser.add_argument('--seconds', type=float, default=10.0, help='of a round')
    options = parser.parse_args()
    if missing():
        raise SystemExit(missing())
    os.environ['ROS_AUTOMATIC_DISCOVERY_RANGE'] = 'LOCALHOST'
    domain = DOMAINS[os.getpid() % len(DOMAINS)]
    os.environ['ROS_DOMAIN_ID'] = str(domain)
    rounds: dict[bool, list[dict[str, float]]] = {False: [], True: []}
    for number in range(2 * options.rounds):
        has_page = number % 4 in (1, 2)  # in turns, against drift
        with page() if has_page else nullcontext('') as shares:
            rounds[has_page].append(measured(domain, options.seconds))
        print(f'{"beside the page" if has_page else "without":16}{formatted(rounds[has_page][-1])}'
              f'   {shares}', flush=True)
    is_above = False
    for figure in ('cpu_us', 'p50_us', 'p99_us'):
        alone, both = (median(each[figure] for each in which) for which in rounds.values())
        bound = MAX_RATIOS.get(figure)
        is_above |= bound is not None and both > bound * alone
        print(f'{figure}: {alone:.0f} without, {both:.0f} beside the page: '
              f'{both / alone:.2f} times' + (f', at most {bound:g}' if bound else ''))
    return int(is_above)


def measured(domain: int, seconds: float) -> dict[str, float]:
    """Return the figures of a round at 200 Hz, in a ROS domain."""
    task = {'commands': [node_of('')], 'namespaces': [''], 'rate': 200, 'settling': 1.0,
            'seconds': seconds, 'check': True}
    result = run(domain, 'roundtrip.py', json.dumps(task))
    if result['wrong'] or result['answered'] < 1.0:
        raise SystemExit(f'wrong poses or missing answers: {result}')
    return result


def formatted(figures: dict[str, float]) -> str:
    """Return the figures of a round as text."""
    return ' '.join(f'{figures[name]:5.0f}' for name in ('cpu_us', 'p50_us', 'p99_us'))


@contextmanager
def page() -> Iterator['Shares']:
    """Start a dashboard and a browser that shows its page."""
    dashboard = Dashboard()
    try:
        dashboard.wait_until_it_serves()
        # Dozens of processes write there until the last one has exited.
        with tempfile.TemporaryDirectory(ignore_cleanup_errors=True) as profile:
            browser = subprocess.Popen(
                [str(CHROMIUM), '--headless', '--no-sandbox', '--no-first-run', '--disable-sync',
                 '--disable-background-networking', '--disable-component-update',
                 '--window-size=1280,720', f'--user-data-dir={profile}', dashboard.url],
                stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL, start_new_session=True)
            try:
                time.sleep(OPENING_S)
                shares = Shares(server=dashboard.pid, browser=browser.pid)
                yield shares
                shares.take()
            finally:
                os.killpg(browser.pid, signal.SIGKILL)
                browser.wait()
    finally:
        dashboard.close()


class Shares:
    """The share of a processor that the processes of some sessions use."""

    def __init__(self, **sessions: int) -> None:
        self._sessions = sessions
        self._before = self._ticks(), time.monotonic()
        self._text = ''

    def take(self) -> None:
        """Measure the shares until now; a page that draws nothing is an error."""
        spent = time.monotonic() - self._before[1]
        shares = {name: (ticks - self._before[0][name]) / os.sysconf('SC_CLK_TCK') / spent
                  for name, ticks in self._ticks().items()}
        if min(shares.values()) < 0.01:
            raise SystemExit(f'nothing was drawn: {shares}')
        self._text = ', '.join(f'{name} {share:.0%} of a core' for name, share in shares.items())

    def __str__(self) -> str:
        return self._text

    def _ticks(self) -> dict[str, int]:
        ticks = dict.fromkeys(self._sessions, 0)
        for stat in Path('/proc').glob('[0-9]*/stat'):
            try:
                number, fields = stat.parent.name, stat.read_text().rpartition(')')[2].split()
            except OSError:  # it has exited
                continue
            for name, session in self._sessions.items():
                if session in (int(number), int(fields[3])):
                    ticks[name] += int(fields[11]) + int(fields[12])
        return ticks


if __name__ == '__main__':
    sys.exit(main())
