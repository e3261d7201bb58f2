"""
Drive the node for a quarter of an hour at 200 Hz over DDS, with a fault each second. A script.

The node is a process, reliable and deep by qos_overrides, so that DDS loses nothing. Every
expected odometry must arrive, in order, with the pose of the drive without faults less the
documented losses. The counters in /diagnostics must be exact. The wheels must be within their
limit, and stop after a command timeout, a command that is not finite, and ~/enable with false. The
memory of the process must not grow once it has settled. Prints a line a minute; returns 1 on a
failure.
"""
import argparse
from collections import Counter, deque
from collections.abc import Callable
import math
import os
from pathlib import Path
import random
import signal
import subprocess
import sys
import tempfile
import time

from diagnostic_msgs.msg import DiagnosticArray
from diffdrive_ros.core.kinematics import DiffDrive
from diffdrive_ros.core.quaternion import heading_of_quaternion
from nav_msgs.msg import Odometry
import numpy as np
from rcl_interfaces.srv import SetParameters
from rclpy.parameter import Parameter
from sensor_msgs.msg import JointState
from std_srvs.srv import SetBool, Trigger
from support.faulty_run import Expected, FaultyRun, PARAMETERS
from support.station import (
    DEEP,
    GEOMETRY,
    LEFT_RADIUS,
    RIGHT_RADIUS,
    SEPARATION,
    stamp_ns,
    Station,
    twist,
    wait_until,
)

RATE = 200.0  # [Hz]
COMMAND_PERIOD = 0.05  # [s]
TIMEOUT = 0.5  # [s]
FASTEST_WHEEL = 12.0  # [rad/s]
MAX_STOP_TIME = 0.35  # [s]: the deceleration, a period, a busy machine
SETTLED = 5.0  # [min] after which the process may not grow
MAX_GROWTH = 1.0  # [MB]
POSE_TOLERANCE = 1e-6  # [m, rad] after kilometres of curves

DEEP_AND_RELIABLE = {
    f'qos_overrides./{end}.{name}': value
    for end in ('joint_states.subscription', 'odom.publisher')
    for name, value in (('reliability', 'reliable'), ('history', 'keep_last'), ('depth', 2000))}

PARAMETERS_OF_NODE = {
    **GEOMETRY, **PARAMETERS, **DEEP_AND_RELIABLE, 'cmd_vel_timeout': TIMEOUT,
    'max_wheel_speed': FASTEST_WHEEL, 'linear.x.max_acceleration': 5.0,
    'angular.z.max_acceleration': 20.0}


class Soak:
    """A node, its input and its output."""

    def __init__(self, station: Station, pid: int, seed: int) -> None:
        self.station, self.pid = station, pid
        self.random = random.Random(seed)
        self.failures: list[str] = []
        self.faults: Counter[str] = Counter()
        self.answers = self.messages = 0
        self.furthest = 0.0  # error of a pose
        self._received: deque[tuple[int, float, float, float]] = deque()
        self._speeds: tuple[float, ...] = ()
        self._figures: dict[str, dict[str, str]] = {}
        self._diagnosed = 0
        self._commands = self._not_finite = self._timeouts = self._late = 0
        self._command_at, self._commanded_at = 0.0, math.inf
        self._stands_from, self._stands_until = math.inf, -math.inf
        self._multiplier = 1.0
        self.drive = FaultyRun(self._send, round(1e9 / RATE), seed)
        self._expected = Expected(DiffDrive(SEPARATION, LEFT_RADIUS, RIGHT_RADIUS))
        self._checked = 0
        self.faults_of_commands: dict[str, Callable[[], None]] = {
            'not_finite_cmd_vel': self._send_not_finite, 'cmd_vel_timeout': self._let_time_out,
            'reset_odometry': self._reset, 'disable': self._disable,
            'set_parameter': self._set_parameter, 'set_wrong_parameter': self._set_wrong}
        node = station.node
        node.create_subscription(Odometry, 'odom', self._on_odom, DEEP)
        node.create_subscription(JointState, 'wheel_commands', self._on_wheels, DEEP)
        node.create_subscription(DiagnosticArray, '/diagnostics', self._on_diagnostics, DEEP)
        wait_until(lambda: node.count_publishers('odom') and node.count_publishers(
            '/diagnostics') and node.count_publishers('wheel_commands'))
        self._services = [
            node.create_client(kind, f'odometry/{name}') for kind, name in (
                (Trigger, 'reset_odometry'), (SetBool, 'enable'),
                (SetParameters, 'set_parameters'))]
        for service in self._services:
            assert service.wait_for_service(timeout_sec=20.0)
        wait_until(lambda: node.count_subscribers('joint_states'))
        time.sleep(1.0)  # discovery at both ends

    def fail(self, what: str) -> None:
        """Record and print a failure."""
        self.failures.append(what)
        if len(self.failures) < 20:
            print('FAILURE:', what, flush=True)

    def run(self, minutes: float) -> None:
        """Drive with a fault every second."""
        started = time.monotonic()
        self.drive.begin()
        next_at, fault_at, minute = started, started + 1.0, 1
        sizes = []
        while (now := time.monotonic()) < started + 60.0 * minutes:
            self._command(now)
            if now >= fault_at:
                fault_at += 1.0
                name = self.random.choice((*self.drive.FAULTS, *self.faults_of_commands))
                self.faults[name] += 1
                self.faults_of_commands.get(name, getattr(self.drive, name, None))()
                sizes.append(((now - started) / 60.0, resident(self.pid)))
                self.check_odometry()
            else:
                self.drive.ordinary_sample()
            if now > started + 60.0 * minute:
                self.check_counters()
                grown = growth(sizes, minutes)
                print(f'{minute:3} min  {self.messages:7,} messages  {self.answers:7,} answers  '
                      f'largest error {self.furthest:.1e}  RSS {sizes[-1][1]:.2f} MB'
                      + ('' if grown is None else f' (+{grown:.2f})'), flush=True)
                minute += 1
            next_at = max(next_at + 1.0 / RATE, now - 0.1)
            time.sleep(max(0.0, next_at - time.monotonic()))
        self.check_counters()
        self.seconds, self.grown = time.monotonic() - started, growth(sizes, minutes)
        self.sizes = sizes
        if self.grown is not None and self.grown > MAX_GROWTH:
            self.fail(f'the process grew by {self.grown:.2f} MB')

    def check_odometry(self) -> None:
        """Wait for every expected odometry, and compare it."""
        expected, self.drive.expected = self.drive.expected, []
        if not expected:
            return
        try:
            wait_until(lambda: len(self._received) >= len(expected), timeout=5.0)
        except AssertionError:
            self.fail(f'{len(expected) - len(self._received)} messages of {len(expected)} are '
                      f'missing, after {self.answers}')
        count = min(len(expected), len(self._received))
        received = [self._received.popleft() for _ in range(count)]
        self.answers += len(received)
        poses = self._expected.of(expected)
        for (stamp, x, y, theta), (due, *_), pose in zip(received, expected, poses, strict=False):
            if stamp != due:
                self.fail(f'odometry of {stamp} in place of {due}')
                return
            off = max(abs(x - pose[0]), abs(y - pose[1]),
                      abs(math.remainder(theta - pose[2], math.tau)))
            self.furthest = max(self.furthest, off)
            if not off < POSE_TOLERANCE:
                self.fail(f'pose at {due}: {x}, {y}, {theta}, expected {pose}')
                return

    def check_counters(self) -> None:
        """Wait for diagnostics of all messages until now, and compare the counters."""
        self._let_time_out()  # no commands while it waits
        self.check_odometry()
        seen = self._diagnosed
        wait_until(lambda: self._diagnosed >= seen + 2, timeout=5.0)
        if self._received:
            self.fail(f'{len(self._received)} unexpected messages')
        figures = self._figures['feedback']
        counters = {name: int(value) for name, value in figures.items() if '[' not in name}
        if counters != dict(self.drive.counts):
            self.fail(f'counters of the wheels: {counters}, expected {dict(self.drive.counts)}')
        counters = {name: int(value) for name, value in self._figures['commands'].items()
                    if '[' not in name and name != 'inhibits'}
        for name, least, most in (
                ('commands', round(0.95 * self._commands), self._commands),
                ('not_finite', self._not_finite, self._not_finite),
                ('timeouts', self._timeouts, self._timeouts + self._late)):
            if not least <= counters.get(name, 0) <= most:
                self.fail(f'counter of commands, {name}: {counters}, expected {least} to {most}')

    def _command(self, now: float) -> None:
        """Send the next command when it is time."""
        if now < self._command_at:
            return
        if now - self._commanded_at > 0.8 * TIMEOUT:
            self._late += 1  # this process was delayed: the node may have a timeout
        self._command_at, self._commanded_at = now + COMMAND_PERIOD, now
        self._commands += 1
        self.station.publish('cmd_vel', twist(self.random.uniform(0.2, 2.0),
                                              self.random.uniform(-4.0, 4.0)))

    def _send_not_finite(self) -> None:
        """Stop the wheels by a command that is not finite."""
        self._send_samples(0.1)  # a newer command replaces one in the queue
        self._commands += 1
        self._not_finite += 1
        self.station.publish('cmd_vel', twist(math.nan, 0.1))
        self._send_samples(MAX_STOP_TIME)
        self._check_stop('a command that is not finite')
        self._commanded_at = math.inf

    def _let_time_out(self) -> None:
        """Let the commands time out."""
        self._command_at = 0.0
        self._command(time.monotonic())
        self._timeouts += 1
        self._send_samples(TIMEOUT + MAX_STOP_TIME)
        self._check_stop('a timeout')
        self._commanded_at = math.inf

    def _disable(self) -> None:
        """Disable the wheels, and enable them again."""
        self._call(1, SetBool.Request(data=False))
        self._send_samples(MAX_STOP_TIME)
        self._command(time.monotonic())
        self._send_samples(0.06)
        self._check_stop('~/enable with false')
        self._call(1, SetBool.Request(data=True))
        self._commanded_at = math.inf

    def _reset(self) -> None:
        """Reset the pose to zero."""
        self.check_odometry()
        self._call(0, Trigger.Request())
        self._expected.reset()

    def _set_parameter(self) -> None:
        """Set a parameter while it drives."""
        self.check_odometry()
        self._multiplier = self.random.uniform(0.8, 1.2)
        self._set('wheel_separation_multiplier', self._multiplier, is_valid=True)
        self._expected.drive = DiffDrive(
            SEPARATION * self._multiplier, LEFT_RADIUS, RIGHT_RADIUS)

    def _set_wrong(self) -> None:
        """Set an invalid value, which is rejected without effect."""
        self._set('wheel_separation_multiplier', self.random.choice((0.0, -1.0, math.nan)),
                  is_valid=False)

    def _set(self, name: str, value: float, is_valid: bool) -> None:
        request = SetParameters.Request(
            parameters=[Parameter(name, value=value).to_parameter_msg()])
        [result] = self._call(2, request).results
        if result.successful != is_valid:
            self.fail(f'{name} = {value}: {result}')

    def _call(self, service: int, request: object) -> object:
        future = self._services[service].call_async(request)
        wait_until(future.done)
        return future.result()

    def _send_samples(self, seconds: float) -> None:
        """Send wheel messages, and no commands."""
        until = time.monotonic() + seconds
        while time.monotonic() < until:
            self.drive.ordinary_sample()
            time.sleep(1.0 / RATE)

    def _check_stop(self, after: str) -> None:
        if any(self._speeds):
            self.fail(f'the wheels turn at {self._speeds} rad/s after {after}')

    def _send(self, names: object, positions: object, velocities: object, stamp: int) -> None:
        message = JointState(name=list(names), position=positions, velocity=velocities)
        message.header.stamp.sec, message.header.stamp.nanosec = divmod(stamp, 10**9)
        self.station.publish('joint_states', message)
        self.messages += 1

    def _on_odom(self, message: Odometry) -> None:
        position, q = message.pose.pose.position, message.pose.pose.orientation
        self._received.append((
            stamp_ns(message), position.x, position.y,
            heading_of_quaternion(q.x, q.y, q.z, q.w)))
        if not (np.isfinite(message.pose.covariance).all()
                and np.isfinite(message.twist.covariance).all()):
            self.fail(f'covariance: {message}')

    def _on_wheels(self, message: JointState) -> None:
        self._speeds = tuple(message.velocity)
        if not max(map(abs, self._speeds)) <= FASTEST_WHEEL:
            self.fail(f'the wheel command is {self._speeds} rad/s')

    def _on_diagnostics(self, message: DiagnosticArray) -> None:
        self._figures = {
            status.name.partition(': ')[2]: {item.key: item.value for item in status.values}
            for status in message.status}
        self._diagnosed += 1


def resident(pid: int) -> float:
    """Return the resident memory of a process [MB]."""
    pages = int(Path(f'/proc/{pid}/statm').read_text().split()[1])
    return pages * os.sysconf('SC_PAGE_SIZE') / 1e6


def growth(sizes: list[tuple[float, float]], minutes: float) -> float | None:
    """Return the growth of a process [MB] since it settled, None before."""
    settled = SETTLED if minutes > SETTLED else 0.5 * minutes
    after = [size for minute, size in sizes if minute >= settled]
    return max(after) - after[0] if after else None


def main() -> int:
    """Soak; return the exit code."""
    parser = argparse.ArgumentParser(description=__doc__.strip().split('\n', 1)[0])
    parser.add_argument('--minutes', type=float, default=15.0, help='duration; default 15')
    parser.add_argument('--seed', type=int, default=1, help='seed of the faults')
    given = parser.parse_args()
    # Apart from the domains of the tests; without ephemeral ports either.
    domain = 215 + os.getpid() % 17
    os.environ |= {'ROS_DOMAIN_ID': str(domain), 'ROS_AUTOMATIC_DISCOVERY_RANGE': 'LOCALHOST',
                   'ROS_PYTHON_CHECK_FIELDS': '1'}
    settings = [word for name, value in PARAMETERS_OF_NODE.items()
                for word in ('-p', f'{name}:={value}')]
    # A file, because the log of a quarter of an hour does not fit into a pipe.
    with tempfile.TemporaryFile('w+') as log:
        process = subprocess.Popen(
            [sys.executable, '-m', 'diffdrive_ros.node.odometry_node', '--ros-args', *settings],
            stdout=log, stderr=subprocess.STDOUT)
        station = Station(domain)
        try:
            soak = Soak(station, process.pid, given.seed)
            soak.run(given.minutes)
            process.send_signal(signal.SIGINT)
            if process.wait(10) != 0:
                soak.fail(f'exit code {process.returncode}')
            log.seek(0)
            text = log.read()
            if 'Traceback' in text:
                soak.fail(text[text.index('Traceback'):][:2000])
        finally:
            station.close()
            process.kill()
            process.wait()
    print(f'seed {given.seed}: {soak.seconds / 60.0:.1f} min, {soak.messages:,} messages '
          f'({soak.messages / soak.seconds:.0f}/s), {soak.answers:,} answers, '
          f'{sum(soak.faults.values())} faults of {len(soak.faults)} kinds; largest error '
          f'{soak.furthest:.1e}; RSS from {soak.sizes[0][1]:.2f} to {soak.sizes[-1][1]:.2f} MB, '
          f'+{soak.grown:.2f} since it settled; counters: {dict(soak.drive.counts)}')
    print(f'{len(soak.failures)} failures' if soak.failures else 'no failure')
    return 1 if soak.failures else 0


if __name__ == '__main__':
    sys.exit(main())
