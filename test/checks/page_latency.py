"""
Measure the latency from a key press in the browser to the wheel command, on this machine.

Starts simulator, odometry, dashboard and a browser in the ROS domain that is set, presses W at
random phases, and measures the time until the first wheel command that is not zero arrives: from
the event in the browser, and from the call that presses. make latency runs it.
"""
import argparse
import os
import random
import statistics
import time

from playwright.sync_api import sync_playwright
from sensor_msgs.msg import JointState
from support.browser import CHROMIUM, Dashboard, Person
from support.station import Station, wait_until

MAX_LATENCY_S = 0.060  # at the 95th percentile


def main() -> None:
    """Measure and print the latencies; exit with 1 if they are above the bound."""
    parser = argparse.ArgumentParser(description=__doc__.strip().split('\n')[0])
    parser.add_argument('--presses', type=int, default=200)
    options = parser.parse_args()
    os.environ.setdefault('ROS_AUTOMATIC_DISCOVERY_RANGE', 'LOCALHOST')
    dashboard = Dashboard('--simulate')
    try:
        dashboard.wait_until_it_serves()
        station = Station(int(os.environ.get('ROS_DOMAIN_ID', '0')), '_ros2cli_latency')
        try:
            with sync_playwright() as playwright:
                browser = playwright.chromium.launch(
                    executable_path=CHROMIUM, args=['--no-sandbox'])
                page = browser.new_page()
                page.goto(dashboard.url)
                measured = presses(Person(page), station, options.presses)
                rate = frames(page)
                browser.close()
        finally:
            station.close()
    finally:
        dashboard.close()
    for name, values in zip(
            ('the event in the page', 'the call of the browser'), zip(*measured, strict=True),
            strict=True):
        p95 = sorted(values)[int(0.95 * (len(values) - 1))]
        print(f'from {name}: {len(values)} presses, median {statistics.median(values) * 1e3:.1f} '
              f'ms, p95 {p95 * 1e3:.1f} ms, worst {max(values) * 1e3:.1f} ms')
    print(f'{rate:.1f} frames a second')
    raise SystemExit(p95 >= MAX_LATENCY_S)


def presses(person: Person, station: Station, count: int) -> list[tuple[float, float]]:
    """Return the times from presses of W, by both clocks, to their wheel commands [s]."""
    received = station.subscribe(JointState, 'wheel_commands')
    person.wait_for('Nobody drives')
    # event.timeStamp counts from timeOrigin; the offset converts it to the clock of this process.
    person.page.evaluate("""window.addEventListener('keydown', (event) => {
        if (!event.repeat) window.pressedAt = performance.timeOrigin + event.timeStamp;
    }, true)""")
    chance, measured = random.Random(1), []
    while len(measured) < count:
        person.page.wait_for_timeout(chance.uniform(100.0, 200.0))
        wait_until(lambda: not received or not any(received[-1][1].velocity))
        seen = len(received)
        offset, called = time.time() - time.monotonic(), time.monotonic()
        person.page.keyboard.down('w')
        deadline = time.monotonic() + 1.0
        while time.monotonic() < deadline and not any(
                any(message.velocity) for _, message in received[seen:]):
            time.sleep(0.001)
        pressed = person.page.evaluate('window.pressedAt') / 1e3 - offset
        person.page.keyboard.up('w')
        moved = [at for at, message in received[seen:] if any(message.velocity)]
        if not moved:
            print(f'a press was ignored: {person.status}')
            measured.append((1.0, 1.0))
            continue
        measured.append((moved[0] - pressed, moved[0] - called))
    return measured


def frames(page: object) -> float:
    """Return how many frames a second are drawn."""
    drawn = 'Number(document.querySelector("canvas").dataset.drawn)'
    before, start = page.evaluate(drawn), time.monotonic()
    page.wait_for_timeout(5000)
    return (page.evaluate(drawn) - before) / (time.monotonic() - start)


if __name__ == '__main__':
    main()
