"""
Fuzz the core with ten million messages, most of them valid, the others arbitrary. A script.

An episode is one robot with random settings and some hundreds of messages, determined by its
number and the seed. Two thirds of the episodes send wheel messages through WheelFeedback into
Odometry as the node does. Invalid sequences must raise nothing, and all results must be finite.
Valid sequences must give a sample from the fourth message on at the latest, and then each one
exactly: the angles by the true wheels, the poses by integrate(), the twists by the Jacobian. The
other episodes send commands through WheelCommander, with inhibits, timeouts and live changes of
every setting, and compare them with a model of the target.
"""
import argparse
from array import array
from collections import deque
from collections.abc import Callable, Iterator
import itertools
import math
import multiprocessing
import random
import sys
import time
import traceback

from diffdrive_ros.core.axis_limits import AxisLimits
from diffdrive_ros.core.kinematics import DiffDrive
from diffdrive_ros.core.odometry import GeometryUncertainty, integrate, Odometry, WheelNoise
from diffdrive_ros.core.wheel_commander import Inhibit, WheelCommand, WheelCommander
from diffdrive_ros.core.wheel_feedback import WheelFeedback, WheelSample
import numpy as np

SECOND = 1_000_000_000
STAMP_GAP_NS = 2 * SECOND  # between the stamps of invalid and of valid sequences
REJECTED_VALUES = math.nan, math.inf, -math.inf, 1e308, -1e308, 1e12, -1e12
EXTREMES = *REJECTED_VALUES, 9.9e11, 5e-324, -0.0, 1e-300
MAX_SYNCHRONISATION = 4  # valid messages at most, after any invalid ones


class WrongError(Exception):
    """A wrong result of the package."""


def demand(is_true: bool, what: str, *values: object) -> None:
    """Raise WrongError, with the values, unless a condition is true."""
    if not is_true:
        raise WrongError(f'{what}: {", ".join(map(repr, values))}')


class Episode:
    """The common part of both kinds of episodes: random numbers, and a log of the last calls."""

    def __init__(self, seed: int, number: int) -> None:
        self.random = random.Random(f'{seed} {number}')
        self.calls: deque[tuple[object, ...]] = deque(maxlen=8)
        self.messages = self.valid = 0

    def drive(self) -> DiffDrive:
        """Return a robot of 3 cm to 10 m."""
        size = 10.0 ** self.random.uniform(-1.5, 1.0)
        radius = size * self.random.uniform(0.05, 0.5)
        return DiffDrive(size, radius * self.random.uniform(0.8, 1.2), radius)


class FeedbackEpisode(Episode):
    """Wheel messages into the feedback, and its samples into the odometry."""

    def __init__(self, seed: int, number: int) -> None:
        super().__init__(seed, number)
        draw = self.random
        sides = draw.choice((1, 1, 1, 2))
        self.left = [f'left_{k}' for k in range(sides)]
        self.right = [f'right_{k}' for k in range(sides)]
        self.names = self.left + self.right
        self.directions = draw.choice((1, -1)), draw.choice((1, -1))
        self.by_position = draw.random() < 0.75
        self.wrap = draw.choice((None, 10.0 ** draw.uniform(0.5, 4.0)))
        self.fastest = draw.choice((None, draw.uniform(5.0, 100.0)))
        self.feedback = WheelFeedback(
            left_names=self.left, right_names=self.right, position_feedback=self.by_position,
            left_direction=self.directions[0], right_direction=self.directions[1],
            encoder_wrap=self.wrap, max_plausible_speed=self.fastest)
        self.has_extremes = draw.random() < 0.5  # in its invalid sequences
        self.window = draw.choice((1, 2, 10))
        self.odometry = Odometry(
            self.drive(), window=self.window,
            noise=WheelNoise(*(10.0 ** draw.uniform(-7.0, -2.0) for _ in range(3))),
            geometry_uncertainty=draw.choice((None, GeometryUncertainty(1e-3, 1e-4, 2e-4))))
        self.now = draw.randrange(3 * 10**18)
        self.invalid_stamps_ns: set[int] = set()
        self.samples = 0
        # Of each wheel: position of the joint, forward angle, and last stamp.
        self.counter = [draw.uniform(-1e3, 1e3) for _ in self.names]
        self.turned = [0.0] * len(self.names)
        self.stamps = [0] * len(self.names)

    def run(self) -> None:
        """Alternate invalid and valid sequences."""
        for _ in range(6):
            if self.random.random() < 0.8:
                self.invalid_sequence(self.random.randrange(1, 25))
            self.valid_sequence(self.random.randrange(25, 100))
        demand(self.feedback.samples == self.samples, 'samples were miscounted',
               self.feedback.samples, self.samples)

    def send(self, names: list[str], values: list[float], stamp_ns: int) -> WheelSample | None:
        """Process a message, and its sample by the odometry, as the node does."""
        self.messages += 1
        self.calls.append((names, values, stamp_ns))
        given: object = values
        if stamp_ns % 2:
            given = array('d', values)
        positions, velocities = (given, ()) if self.by_position else ((), given)
        sample = self.feedback.update(tuple(names), positions, velocities, stamp_ns)
        if sample is None:
            return None
        self.samples += 1
        demand(math.isfinite(sample.left) and math.isfinite(sample.right), 'angles', sample)
        if sample.time_reset_ns is not None:
            self.odometry.reset_time(sample.time_reset_ns)
        self.is_new = self.odometry.update(sample.left, sample.right, sample.stamp_ns)
        return sample

    def invalid_sequence(self, count: int) -> None:
        """Send arbitrary messages."""
        draw = self.random
        for _ in range(count):
            names = [*self.names, 'arm', 'hand']
            draw.shuffle(names)
            names = names[:draw.randrange(len(names) + 1)] if draw.random() < 0.4 else names
            if names and draw.random() < 0.1:
                names.append(names[0])
            values = [self.arbitrary_value(name) for name in names]
            if draw.random() < 0.2:
                values = values[:draw.randrange(len(values) + 1)]
            stamp_ns = self.now + draw.choice((
                0, 1, -1, draw.randrange(-SECOND, SECOND), draw.randrange(-10**13, 10**13),
                -SECOND, 10**8, 10**8, -2**62, 2**62))
            self.invalid_stamps_ns.add(stamp_ns)
            if self.send(names, values, stamp_ns):
                self.check_finite()
            if draw.random() < 0.5:
                self.now += draw.randrange(10**8)
            if draw.random() < 0.1:
                self.odometry.reset((1.0, 2.0, 3.0), np.diag((0.1, 0.2, 0.3)))

    def arbitrary_value(self, name: str) -> float:
        """Return an arbitrary value of a joint."""
        draw = self.random
        kind = draw.random()
        if kind < 0.2:
            return draw.choice(EXTREMES if self.has_extremes else REJECTED_VALUES)
        if kind < 0.4 or name not in self.names:
            return draw.uniform(-1.0, 1.0) * 10.0 ** draw.uniform(
                -3.0, 13.0 if self.has_extremes else 3.0)
        return self.counter[self.names.index(name)] + draw.uniform(-1.0, 1.0)

    def check_finite(self) -> None:
        """Check that all published values are finite, and each variance positive."""
        odometry = self.odometry
        for part in (odometry.pose, odometry.twist):
            demand(bool(np.isfinite(part).all()), 'pose or twist', part)
        for part in (odometry.pose_covariance, odometry.twist_covariance):
            demand(bool(np.isfinite(part).all() and (np.diag(part) > 0.0).all()),
                   'covariance', part.tolist())

    def valid_sequence(self, count: int) -> None:
        """Send valid messages, and check their samples."""
        draw = self.random
        # An out-of-order stamp is dropped by design: keep away from those.
        for stamp_ns in sorted(self.invalid_stamps_ns):
            if self.now <= stamp_ns <= self.now + STAMP_GAP_NS:
                self.now = stamp_ns + 1
        self.invalid_stamps_ns.clear()
        self.turned = [0.0] * len(self.names)
        self.stamps = [self.now] * len(self.names)
        if self.by_position and self.wrap:
            self.counter = [value % self.wrap for value in self.counter]
        sample = None
        for tried in range(MAX_SYNCHRONISATION):
            self.move(draw.randrange(1_000_000, 50_000_000))
            sample = self.one_message()
            if sample:
                break
            demand(tried + 1 < MAX_SYNCHRONISATION, 'valid messages give no sample')
        demand(self.is_new, 'a valid sample is out of order to the odometry')
        if draw.random() < 0.3:
            self.odometry.drive = self.drive()
        start = draw.uniform(-9.0, 9.0), draw.uniform(-9.0, 9.0), draw.uniform(-3.0, 3.0)
        self.odometry.reset(start)
        first, truth = (sample.left, sample.right), [self.truth()]
        stamps, poses = [sample.stamp_ns], [self.odometry.pose]
        for _ in range(count):
            self.move(draw.randrange(1_000_000, 200_000_000))
            sample = self.separate_messages() if draw.random() < 0.1 else self.one_message()
            demand(sample is not None and sample.stamp_ns == self.now and self.is_new
                   and sample.time_reset_ns is None, 'no sample', sample, self.now)
            truth.append(self.truth())
            close = 1e-9 + 1e-14 * self.furthest()
            for side, angle in enumerate((sample.left, sample.right)):
                right = truth[-1][side] - truth[0][side]
                demand(abs(angle - first[side] - right) < close * count, 'angle', angle, right)
            stamps.append(self.now)
            poses.append(self.odometry.pose)
        self.valid += count
        self.check_poses(np.array(truth), np.array(poses), stamps, start, close * count)
        self.check_finite()

    def check_poses(
        self, truth: np.ndarray, poses: np.ndarray, stamps: list[int],
        start: tuple[float, float, float], close: float,
    ) -> None:
        """Compare poses and the last twist with those of the true wheel angles."""
        drive = self.odometry.drive
        expected = integrate(drive, truth[:, 0], truth[:, 1], start)
        travel = np.abs(np.diff(truth, axis=0)).sum() * drive.right_wheel_radius
        # A heading error by the resolution of the angles grows along the path.
        tolerance = close * (1.0 + drive.right_wheel_radius) * (
            1.0 + travel) * (1.0 + drive.right_wheel_radius / drive.wheel_separation)
        off = np.abs(poses - expected).max()
        demand(off < tolerance, 'pose', off, tolerance, poses[-1], expected[-1])
        back = min(self.window, len(stamps) - 1)
        seconds = (stamps[-1] - stamps[-1 - back]) * 1e-9
        twist = drive.body_jacobian @ (truth[-1] - truth[-1 - back]) / seconds
        off = np.abs(self.odometry.twist - twist).max()
        demand(off < 10.0 * tolerance / seconds, 'twist', self.odometry.twist, twist)

    def furthest(self) -> float:
        """Return the largest wheel angle: an accepted extreme costs resolution."""
        return max(abs(wheel.angle) for wheel in self.feedback._wheels.values())

    def truth(self) -> tuple[float, float]:
        """Return the mean angle by which the wheels of each side have turned."""
        half = len(self.left)
        return sum(self.turned[:half]) / half, sum(self.turned[half:]) / half

    def move(self, elapsed_ns: int) -> None:
        """Advance the time, and choose the wheel speeds in it."""
        self.now += elapsed_ns
        seconds = elapsed_ns * 1e-9
        fastest = self.fastest or 100.0
        if self.by_position and self.wrap:
            fastest = min(fastest, 0.49 * self.wrap / seconds)
        uniform = self.random.uniform
        # A margin, because the time may count from the other wheel's message.
        self.speeds = [0.9 * uniform(-fastest, fastest) for _ in self.names]
        self.elapsed_ns = elapsed_ns

    def value_of(self, wheel: int, stamp_ns: int) -> float:
        """Turn a wheel until a time, and return the value of its joint."""
        direction = self.directions[wheel >= len(self.left)]
        if not self.by_position:
            # Velocities are integrated since the wheel's last message.
            elapsed_ns = stamp_ns - self.stamps[wheel]
            self.stamps[wheel] = stamp_ns
            self.turned[wheel] += self.speeds[wheel] * elapsed_ns * 1e-9
            return direction * self.speeds[wheel]
        step = self.speeds[wheel] * self.elapsed_ns * 1e-9
        self.turned[wheel] += step
        self.counter[wheel] += direction * step
        if self.wrap:
            self.counter[wheel] %= self.wrap
        return self.counter[wheel]

    def one_message(self) -> WheelSample | None:
        """Send all wheels in one message, in any order, among other joints."""
        values = [self.value_of(wheel, self.now) for wheel in range(len(self.names))]
        names = self.names
        if self.random.random() < 0.2:
            pairs = [*zip(names, values, strict=True), ('arm', math.nan)]
            self.random.shuffle(pairs)
            names, values = (list(part) for part in zip(*pairs, strict=True))
        return self.send(names, values, self.now)

    def separate_messages(self) -> WheelSample | None:
        """Send each wheel in a message of its own; the last one completes the sample."""
        wheels = list(range(len(self.names)))
        self.random.shuffle(wheels)
        sample = None
        for left in reversed(range(len(wheels))):
            demand(sample is None, 'an incomplete sample was returned', sample)
            wheel = wheels[left]
            stamp_ns = self.now - left
            sample = self.send([self.names[wheel]], [self.value_of(wheel, stamp_ns)], stamp_ns)
        self.valid += len(wheels) - 1
        return sample


class CommandEpisode(Episode):
    """Commands through WheelCommander, and a model of the expected target."""

    def __init__(self, seed: int, number: int) -> None:
        super().__init__(seed, number)
        draw = self.random
        self.commander = WheelCommander(
            self.drive(), timeout=self.timeout(), max_wheel_speed=self.fastest(),
            linear_limits=self.limits(), angular_limits=self.limits(),
            period=10.0 ** draw.uniform(-3.0, 0.0))
        self.now = draw.randrange(10**18)
        self.received: int | None = None
        self.stepped: int | None = None
        self.valid_until: float | None = -math.inf  # the target of the last step; None for unknown
        self.target: tuple[float, float] | None = (0.0, 0.0)  # None for unknown
        self.last = WheelCommand(0.0, 0.0, 0.0, 0.0)

    def timeout(self) -> float:
        """Return a timeout or none."""
        return self.random.choice((0.0, 0.5, self.random.uniform(0.01, 2.0)))

    def fastest(self) -> float | None:
        """Return a limit of the wheels or none."""
        return self.random.choice((None, 10.0 ** self.random.uniform(-1.0, 3.0)))

    def limits(self) -> AxisLimits:
        """Return any limits of an axis: nan, zero and infinity included."""
        def size() -> float:
            return self.random.choice((
                math.nan, math.nan, math.nan, 10.0 ** self.random.uniform(-2.0, 2.0),
                10.0 ** self.random.uniform(-2.0, 2.0), 1.0, 0.0, math.inf))
        if self.random.random() < 0.4:
            return AxisLimits()
        return AxisLimits(size(), -size(), size(), -size(), -size(), size(), size(), -size())

    def run(self) -> None:
        """Command, step, and change the settings in between."""
        draw, commander = self.random, self.commander
        for _ in range(300):
            chance = draw.random()
            if chance < 0.02:
                commander.drive = self.drive()
            elif chance < 0.04:
                commander.timeout = self.timeout()
            elif chance < 0.06:
                commander.max_wheel_speed = self.fastest()
            elif chance < 0.08:
                commander.linear_limits, commander.angular_limits = self.limits(), self.limits()
            elif chance < 0.10:
                commander.inhibit(draw.choice(tuple(Inhibit)), True)
            elif chance < 0.14:
                commander.inhibit(draw.choice(tuple(Inhibit)), False)
            self.command()
            for _ in range(draw.choice((0, 1, 1, 1, 2))):
                self.pass_time(draw.choice((commander.period, 0.02, draw.uniform(0.0, 0.1))))
                self.step()
            if draw.random() < 0.02:
                self.pass_time(draw.choice((-5.0, 0.5, 3.0)))
            if draw.random() < 0.02:
                self.settle()

    def pass_time(self, seconds: float) -> None:
        """Advance the time; negative for a reset of the simulation."""
        self.now += round(seconds * 1e9)

    def command(self) -> None:
        """Send a command, mostly a valid one."""
        draw = self.random
        self.messages += 1
        self.received = self.now
        if draw.random() < 0.75:
            self.valid += 1
            linear, angular = draw.choice((
                (draw.uniform(-2.0, 2.0), draw.uniform(-4.0, 4.0)), (0.0, 0.0),
                (draw.uniform(-2.0, 2.0), 0.0), (0.0, draw.uniform(-4.0, 4.0)),
                (draw.uniform(-100.0, 100.0), draw.uniform(-100.0, 100.0))))
            is_small = max(abs(self.last.linear), abs(self.last.angular)) < 1e6
            self.target = (linear, angular) if is_small else None
            if self.commander.inhibits:
                self.target = 0.0, 0.0
        else:
            linear, angular = (
                draw.choice((*EXTREMES, draw.uniform(-1.0, 1.0) * 10.0 ** draw.uniform(
                    -300.0, 308.0))) for _ in range(2))
            self.target = None
            if self.commander.inhibits or not math.isfinite(linear) or not math.isfinite(angular):
                self.target = 0.0, 0.0
        self.calls.append(('accept', linear, angular, self.now))
        self.commander.accept(linear, angular, self.now)

    def step(self) -> None:
        """Do a step, and check the wheel command."""
        commander, last = self.commander, self.last
        self.calls.append((
            'step', self.now, commander.timeout, commander.max_wheel_speed, commander.drive,
            commander.linear_limits, commander.angular_limits, commander.period,
            set(commander.inhibits)))
        sent = self.last = commander.step(self.now)
        self.calls.append(('sent', sent))
        # With a stalled clock, a step with an inhibit takes a period. In a pause, the time beyond
        # five periods decelerates if the target was zero.
        elapsed = commander.period if self.stepped is None else (self.now - self.stepped) * 1e-9
        elapsed = elapsed if elapsed > 0.0 else commander.period if commander.inhibits else 1e-9
        self.seconds = min(elapsed, 5.0 * commander.period)
        pause, valid_until = elapsed - self.seconds, self.valid_until
        self.stepped = self.now
        age_ns = None if self.received is None else self.now - self.received
        is_timeout = commander.timeout and age_ns is not None and not (
            0 <= age_ns <= commander.timeout * 1e9)
        if commander.inhibits or is_timeout:
            self.target = 0.0, 0.0
        self.valid_until = None if self.target is None else (
            self.now if self.target == (0.0, 0.0) or self.received is None
            else self.received + commander.timeout * 1e9 if commander.timeout else math.inf)
        demand(all(map(math.isfinite, (sent.left, sent.right, sent.linear, sent.angular))),
               'not finite', sent)
        limit = commander.max_wheel_speed
        demand(limit is None or max(abs(sent.left), abs(sent.right)) <= limit,
               'faster than max_wheel_speed', sent, limit)
        amounts = commander.drive.wheel_jacobian @ (sent.linear, 0.0, sent.angular)
        demand(close_to(sent.left, amounts[0], amounts) and close_to(
            sent.right, amounts[1], amounts), 'twist and wheels differ', sent, amounts)
        is_limited = limit is not None and max(abs(amounts)) > 0.999999 * limit
        # A live change to smaller wheels, whose speed overflows, stops at once.
        is_limited |= max(abs(last.linear), abs(last.angular)) > 1e300
        if self.target is None or (pause and valid_until is None):
            return
        if pause:
            pause = max(0.0, min(pause, (self.now - valid_until) * 1e-9))
        for target, limits, before, now in (
                (self.target[0], commander.linear_limits, last.linear, sent.linear),
                (self.target[1], commander.angular_limits, last.angular, sent.angular)):
            if pause:
                slowed = abs(before) - self.slowing(limits, before) * pause
                before = math.copysign(max(slowed, 0.0), before)
            self.check_axis(target, limits, before, now, is_limited)

    def check_axis(
        self, target: float, limits: AxisLimits, before: float, now: float, is_limited: bool,
    ) -> None:
        """Check the speed of an axis after that before; is_limited by the speed of the wheels."""
        high = or_else(limits.max_velocity, math.inf)
        low = -math.inf if math.isinf(high) else or_else(limits.min_velocity, -high)
        if math.isinf(high) and not math.isnan(limits.max_velocity):
            low = or_else(limits.min_velocity, -math.inf)
        target = min(max(target, low), high)
        tiny = 1e-9 * (1.0 + abs(before))
        if not target:
            slowed = max(abs(before) - self.slowing(limits, before) * self.seconds, 0.0)
            demand(abs(now) <= slowed + tiny and (now * before >= 0.0 or abs(now) <= tiny),
                   'not stopped by the deceleration limit', now, before, slowed)
            demand(is_limited or abs(now) >= slowed - tiny,
                   'decelerated beyond the limit', now, slowed)
        elif low <= before <= high:
            demand(low - tiny <= now <= high + tiny, 'beyond its velocity limit', now, low, high)
        if not is_limited:
            # Jerk limits preserve momentum away from the target, but only towards zero.
            least = most = before
            if target and not math.isnan(limits.max_jerk):
                least, most = min(before, 0.0), max(before, 0.0)
            demand(min(least, target) - tiny <= now <= max(most, target) + tiny,
                   'not on the way to the target', before, now, target)
            if limits == AxisLimits():
                demand(abs(now - target) <= tiny, 'not the command', now, target)
            fastest = max(ahead(limits), -back(limits), self.slowing(limits, before))
            demand(abs(now - before) <= fastest * self.seconds + tiny
                   or not low <= before <= high or not target,
                   'faster than its accelerations', before, now, target)

    def slowing(self, limits: AxisLimits, before: float) -> float:
        """Return the deceleration, infinite without a limit."""
        if math.isnan(limits.max_acceleration):
            return math.inf
        rate = (-or_else(limits.max_deceleration, back(limits)) if before > 0.0
                else or_else(limits.max_deceleration_reverse, limits.max_acceleration))
        return rate or math.inf

    def settle(self) -> None:
        """Repeat one command until it is reached, with limits that allow it soon."""
        commander = self.commander
        for inhibit in Inhibit:
            commander.inhibit(inhibit, False)
        commander.linear_limits = AxisLimits(max_acceleration=50.0, max_deceleration=-40.0)
        commander.angular_limits = AxisLimits(max_acceleration=70.0, max_jerk=1e4)
        commander.max_wheel_speed, commander.timeout, commander.period = None, 0.5, 0.05
        if max(abs(self.last.linear), abs(self.last.angular)) > 200.0:
            return
        command = self.random.uniform(-5.0, 5.0), self.random.uniform(-5.0, 5.0)
        for _ in range(250):
            self.messages += 1
            self.valid += 1
            commander.accept(*command, self.now)
            self.received, self.target = self.now, command
            self.step()
            if (self.last.linear, self.last.angular) == command:
                return
            self.pass_time(0.05)
        raise WrongError(f'{self.last} after 250 periods of {command}')


def ahead(limits: AxisLimits) -> float:
    """Return the acceleration forward."""
    return or_else(limits.max_acceleration, math.inf)


def back(limits: AxisLimits) -> float:
    """Return the acceleration backward, zero or less."""
    if math.isnan(limits.max_acceleration):
        return -math.inf
    return or_else(limits.max_acceleration_reverse, -limits.max_acceleration)


def or_else(value: float, default: float) -> float:
    """Return the value, or the default where it is nan."""
    return default if math.isnan(value) else value


def close_to(value: float, other: float, scale: np.ndarray) -> bool:
    """Return whether two values are as close as the rounding of the wheels' speeds leaves them."""
    return abs(value - other) <= 1e-12 * max(abs(scale)) + 1e-300


Outcome = tuple[int, int, int, str]
"""The number of an episode, its messages, the valid ones, and its failure as text."""


def run(seed: int, number: int) -> Outcome:
    """Run an episode: every third is of commands, the others of wheel messages."""
    kind: Callable[[int, int], FeedbackEpisode | CommandEpisode] = (
        CommandEpisode if number % 3 == 0 else FeedbackEpisode)
    episode = kind(seed, number)
    try:
        episode.run()
    except Exception:
        calls = '\n'.join(f'    {call}' for call in episode.calls)
        return number, episode.messages, episode.valid, (
            f'{traceback.format_exc()}\n{kind.__name__}, message {episode.messages}, after\n'
            f'{calls}')
    return number, episode.messages, episode.valid, ''


def run_many(task: tuple[int, range]) -> list[Outcome]:
    """Run some episodes; stop at the first failure."""
    seed, numbers = task
    outcomes = []
    for number in numbers:
        outcomes.append(run(seed, number))
        if outcomes[-1][-1]:
            break
    return outcomes


def tasks(seed: int) -> Iterator[tuple[int, range]]:
    """Return endless tasks of twelve episodes each."""
    return ((seed, range(first, first + 12)) for first in itertools.count(0, 12))


def fuzz(seed: int, wanted: int, processes: int | None) -> int:
    """Run episodes for a number of messages; return 1 at the first failure."""
    started = reported = time.monotonic()
    messages = valid = episodes = 0
    with multiprocessing.get_context('fork').Pool(processes) as pool:
        # Not imap, which would read the endless tasks at once.
        todo = tasks(seed)
        pending = deque(
            pool.apply_async(run_many, (next(todo),)) for _ in range(4 * (processes or 2)))
        while messages < wanted:
            outcomes = pending.popleft().get()
            pending.append(pool.apply_async(run_many, (next(todo),)))
            for number, count, valid_count, failure in outcomes:
                episodes += 1
                messages += count
                valid += valid_count
                if failure:
                    print(f'\nepisode {number} failed: {failure}\n\nto repeat it: python '
                          f'test/checks/fuzz.py --seed {seed} --episode {number}')
                    return 1
            if time.monotonic() - reported > 5.0:
                reported = time.monotonic()
                rate = messages / (reported - started)
                left = max(wanted - messages, 0) / rate
                print(f'{messages:10,} of {wanted:,} messages, {rate:,.0f}/s, {left:.0f} s left',
                      flush=True)
    seconds = time.monotonic() - started
    print(f'seed {seed}: {messages:,} messages in {episodes:,} episodes, {valid / messages:.0%} '
          f'valid, {seconds:.0f} s, {messages / seconds:,.0f}/s: no failure')
    if valid < 0.5 * messages:
        print('less than half were valid: fault of the fuzzer')
        return 1
    return 0


def main() -> int:
    """Fuzz, or run one episode again; return the exit code."""
    parser = argparse.ArgumentParser(description=__doc__.strip().split('\n', 1)[0])
    parser.add_argument('--messages', type=float, default=1e7, help='their number; default 1e7')
    parser.add_argument('--seed', type=int, default=1, help='seed of the messages')
    parser.add_argument('--episode', type=int, help='run this episode alone')
    parser.add_argument('--processes', type=int, help='default: one for each core')
    given = parser.parse_args()
    if given.episode is None:
        return fuzz(given.seed, round(given.messages), given.processes)
    _, messages, valid, failure = run(given.seed, given.episode)
    print(failure or f'{messages} messages, {valid} valid: no failure')
    return 1 if failure else 0


if __name__ == '__main__':
    sys.exit(main())
