"""
Measure the costs of the node and the core, as ratios within one run. A script without bounds.

It measures the round trip over DDS (a JointState in, an Odometry out), against a floor in C and a
typical Python node; robots in separate processes and in one; the time from a start to the first
odom; the core, against numpy. The candidates alternate, and medians are compared. Writes
doc/performance.md and doc/performance.png; with --quick, only prints. Returns 1 on a wrong pose.
"""
import argparse
from collections.abc import Iterator
from contextlib import contextmanager
from glob import glob
import itertools
import json
import os
from pathlib import Path
import shlex
import subprocess
import sys
import sysconfig
import tempfile

from benchmark import performance
from benchmark.performance import CANDIDATES, EACH, FLOOR, NODE, SHARED, TYPICAL

HERE = Path(__file__).resolve().parent

# The example robot, with every computation of a message; without /tf, like the other candidates.
GEOMETRY = {
    'wheel_separation': 0.16, 'wheel_radius': 0.033, 'wheel_separation_std': 0.002,
    'left_wheel_radius_std': 0.0001, 'right_wheel_radius_std': 0.0001, 'enable_odom_tf': False}

LIBRARIES = (
    'rcl', 'rcutils', 'rmw', 'rosidl_runtime_c', 'nav_msgs__rosidl_generator_c',
    'nav_msgs__rosidl_typesupport_c', 'sensor_msgs__rosidl_generator_c',
    'sensor_msgs__rosidl_typesupport_c')

Command = tuple[list[str], dict[str, str]]
"""Arguments, and changes of the environment."""


class Plan:
    """The extent of the measurement: full or quick."""

    def __init__(self, quick: bool, rounds: int | None, seconds: float | None) -> None:
        self.rounds = rounds or (1 if quick else 5)
        self.seconds = seconds or (1.5 if quick else 10.0)
        self.settling = 0.5 if quick else 1.0
        self.rates = (200, 3000) if quick else (200, 1000, 3000)
        self.robots = (1, 5) if quick else (1, 5, 20)
        self.starts = 1 if quick else 20
        self.sizes = [10**3, 10**5] if quick else [
            10**3, 10**4, 10**5, 10**6, 10**7, 5 * 10**7]
        self.most_updates = 10**3 if quick else 10**6
        self.work = 2e6 if quick else 2e7  # samples in total: small logs are repeated more often


class Benchmark:
    """The measurements, in separate processes, each in another ROS domain."""

    def __init__(self, plan: Plan, floor: Command | None) -> None:
        self.plan = plan
        self.wrong: list[str] = []
        self._domains = itertools.cycle(range(60, 100))
        for _ in range(os.getpid() % 40):  # two runs at once begin with different domains
            next(self._domains)
        typical = [sys.executable, str(HERE / 'typical_node.py')], {}
        given: dict[str, Command | None] = {
            FLOOR: floor, NODE: node_of(''), TYPICAL: typical}
        self._candidates = {name: given[name] for name in CANDIDATES if given[name]}

    def round_trips(self) -> dict[int, dict[str, list[dict]]]:
        """Return the costs of rounds with one robot, by rate and candidate."""
        results = {rate: {name: [] for name in self._candidates} for rate in self.plan.rates}
        for _, rate, (name, command) in itertools.product(
                range(self.plan.rounds), results, self._candidates.items()):
            results[rate][name].append(self._round(
                f'{name}, {rate} Hz', [command], [''], rate, check=name == NODE))
        return results

    def robots(self) -> dict[int, dict[str, list[dict]]]:
        """Return the costs of rounds with several robots at 50 Hz, by number and processes."""
        results = {count: {EACH: [], SHARED: []} for count in self.plan.robots}
        for _, count in itertools.product(range(self.plan.rounds), results):
            namespaces = [f'/r{number}' for number in range(count)]
            together = [sys.executable, str(HERE / 'one_process.py'), json.dumps({
                namespace: parameters_in(namespace) for namespace in namespaces})], {}
            for way, commands in (
                    (EACH, [node_of(namespace) for namespace in namespaces]),
                    (SHARED, [together])):
                results[count][way].append(self._round(
                    f'{count} robots, {way}', commands, namespaces, 50, check=True))
        return results

    def starts(self) -> dict[str, list[float]]:
        """Return the seconds from starts to the first odom, by candidate."""
        candidates = {name: self._candidates[name] for name in (NODE, TYPICAL)}
        print_progress('starts')
        return self._run('start.py', json.dumps({
            'candidates': candidates, 'starts': self.plan.starts}))

    def core(self) -> dict[int, dict[str, dict]]:
        """Return time [ns] and memory [bytes] per sample, by the size of the log and the work."""
        results = {}
        for size in self.plan.sizes:
            print_progress(f'core, {size:,} samples')
            repeats = max(3, min(200, round(self.plan.work / size)))
            times = self._run(
                'core.py', size, repeats, 'numpy', 'integrate', 'integrate_chunks')
            if size <= self.plan.most_updates:
                repeats = max(1, min(20, round(self.plan.work / size / 20)))
                times |= self._run('core.py', size, repeats, 'update', 'update and read-out')
            results[size] = {
                work: {'ns': ns, 'bytes': self._run('core.py', size, 0, work)}
                for work, ns in times.items()}
        return results

    def _round(
        self, what: str, commands: list[Command], namespaces: list[str], rate: float, check: bool,
    ) -> dict:
        print_progress(what)
        result = self._run('roundtrip.py', json.dumps({
            'commands': commands, 'namespaces': namespaces, 'rate': rate,
            'settling': self.plan.settling, 'seconds': self.plan.seconds, 'check': check}))
        if result['wrong']:
            self.wrong.append(f'{what}: {result["wrong"]}')
        return result

    def _run(self, script: str, *arguments: object) -> object:
        return run(next(self._domains), script, *arguments)


def run(domain: int, script: str, *arguments: object) -> object:
    """Return the result of a script of the benchmark, in a ROS domain on this machine."""
    done = subprocess.run(
        [sys.executable, str(HERE / script), *map(str, arguments)], text=True,
        stdout=subprocess.PIPE,
        env={**os.environ, 'ROS_DOMAIN_ID': str(domain),
             'ROS_AUTOMATIC_DISCOVERY_RANGE': 'LOCALHOST',
             'PYTHONDONTWRITEBYTECODE': ''})  # compiled once, as if installed
    if done.returncode:
        sys.exit(f'{script} failed, in: {arguments}')
    return json.loads(done.stdout.splitlines()[-1])  # DDS may print, too


def parameters_in(namespace: str) -> dict[str, object]:
    """Return the node's parameters: reliable and deep, so that DDS drops nothing."""
    return GEOMETRY | {
        f'qos_overrides.{namespace}/joint_states.subscription.reliability': 'reliable',
        f'qos_overrides.{namespace}/joint_states.subscription.depth': 1000,
        f'qos_overrides.{namespace}/odom.publisher.depth': 1000}


def node_of(namespace: str) -> Command:
    """Return the command of the node in a namespace."""
    given = [word for name, value in parameters_in(namespace).items()
             for word in ('-p', f'{name}:={value}')]
    remapped = ['-r', f'__ns:={namespace}'] if namespace else []
    return [sys.executable, '-m', 'diffdrive_ros.node.odometry_node', '--ros-args', *remapped,
            *given], {}


@contextmanager
def floor() -> Iterator[Command | None]:
    """Build the floor, from a sourced ROS or from wheels; None if it does not compile."""
    sourced = os.environ.get('AMENT_PREFIX_PATH', '').split(':')
    prefixes = [*filter(None, sourced), sys.prefix]
    includes = [path for prefix in prefixes for path in glob(f'{prefix}/include/*')]
    libraries = [f'{prefix}/lib' for prefix in prefixes] + [
        *glob(f'{sysconfig.get_path("purelib")}/ros_*.libs'), sysconfig.get_config_var('LIBDIR')]
    with tempfile.TemporaryDirectory() as folder:
        binary = f'{folder}/floor'
        command = [
            *shlex.split(os.environ.get('CC', 'cc')), '-O2', '-o', binary, str(HERE / 'floor.c'),
            *(f'-I{path}' for path in includes), *(f'-L{path}' for path in libraries),
            '-Wl,--allow-shlib-undefined', *(f'-l{name}' for name in LIBRARIES)]
        if Path(sys.prefix, 'lib', 'librcl.so').exists():
            # The libraries in the wheels need symbols of Python without linking it.
            command += ['-Wl,--no-as-needed', f'-lpython{sysconfig.get_config_var("LDVERSION")}']
        try:
            subprocess.run(command, check=True, text=True, stderr=subprocess.PIPE)
        except (OSError, subprocess.CalledProcessError) as error:
            print(f'without the floor, which does not compile: '
                  f'{getattr(error, "stderr", None) or error}', file=sys.stderr)
            yield None
            return
        paths = [*libraries, os.environ.get('LD_LIBRARY_PATH', '')]
        yield [binary], {'LD_LIBRARY_PATH': ':'.join(filter(None, paths)),
                         'AMENT_PREFIX_PATH': ':'.join(prefixes)}


def print_progress(what: str) -> None:
    """Print what is measured now."""
    print(f'... {what}', file=sys.stderr, flush=True)


def main() -> int:
    """Measure; return the exit code."""
    parser = argparse.ArgumentParser(description=__doc__.strip().split('\n', 1)[0])
    parser.add_argument('--quick', action='store_true', help='less than a minute; only prints')
    parser.add_argument('--rounds', type=int, help='of each candidate; default 5')
    parser.add_argument('--seconds', type=float, help='of a round; default 10')
    given = parser.parse_args()
    plan = Plan(given.quick, given.rounds, given.seconds)
    with floor() as command:
        benchmark = Benchmark(plan, command)
        results = performance.Results(
            rounds=plan.rounds, seconds=plan.seconds, load=os.getloadavg()[0],
            round_trips=benchmark.round_trips(), robots=benchmark.robots(),
            starts=benchmark.starts(), core=benchmark.core())
    text = performance.tables(results)
    print(text)
    if not given.quick:
        performance.write(text, results)
    for each in benchmark.wrong:
        print(f'WRONG: {each}')
    return 1 if benchmark.wrong else 0


if __name__ == '__main__':
    sys.exit(main())
