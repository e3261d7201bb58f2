"""A drive whose messages are damaged in all ways that happen, and what should become of it."""
from collections import Counter
from collections.abc import Callable, Sequence
import math
import random

from diffdrive_ros.core.kinematics import DiffDrive
from diffdrive_ros.core.odometry import integrate
import numpy as np

LEFT, RIGHT = NAMES = 'left_wheel_joint', 'right_wheel_joint'
DIRECTIONS = 1, -1  # the right wheel counts backward
WRAP = 53.7  # [rad] range of the counters
FASTEST = 31.0  # [rad/s]
SECOND = 1_000_000_000

# What a node has to be told of these wheels.
PARAMETERS = {
    'right_wheel_direction': -1, 'encoder_wrap': WRAP, 'max_plausible_wheel_speed': FASTEST}

Say = Callable[[Sequence[str], Sequence[float], Sequence[float], int], None]
"""Send names, positions, velocities and a stamp [ns]."""


class DamagedDrive:
    """
    Two wheels on a drive, through fault after fault; each fault is a method of a name in FAULTS.

    expected has the stamp [ns] and the wheel angles [rad] of each answer that is due: those of the
    undamaged drive, less the losses that WheelFeedback documents. counts are those of diagnostics.
    """

    FAULTS = (
        'an_ordinary_sample', 'other_order_and_other_joints', 'wheels_in_separate_messages',
        'messages_of_other_joints', 'a_message_without_a_value', 'velocities_instead_of_positions',
        'a_value_that_is_none', 'a_duplicate', 'a_message_out_of_order', 'a_straggler',
        'time_starts_again', 'a_wrap', 'a_glitch', 'a_reset_of_the_counters',
        'a_reset_of_one_counter', 'silence_while_it_drives')

    def __init__(self, say: Say, period_ns: int = 20_000_000, seed: int = 1) -> None:
        self._say = say
        self._period_ns = period_ns
        self.random = random.Random(seed)
        self.now = 1_700_000_000 * SECOND
        self.expected: list[tuple[int, float, float]] = []
        self.counts: Counter[str] = Counter()
        self._speeds = [3.0, 5.0]  # [rad/s], forward
        self._counter = [17.0, -41.0]  # of the encoders, before it wraps: anything at the start
        self._believed = self.raw()
        self._turned = [0.0, 0.0]  # what the samples should have told
        self._unheard = [0.0, 0.0]  # what the next sample should add to it
        self._last = self.now

    def begin(self) -> None:
        """Send the first sample: the baseline, wherever the encoders are."""
        self._send()
        self._answer(counts_wraps=False)

    def stand(self) -> None:
        """Let a period pass in which no wheel turns."""
        self.now += self._period_ns
        self._send()
        self._answer()

    def an_ordinary_sample(self) -> None:
        """Go on: neither wheel's counter may have wrapped, or either."""
        self._move()
        self._send()
        self._answer()

    def other_order_and_other_joints(self) -> None:
        """Wheels are found by name."""
        self._move()
        self._send(names=['arm', RIGHT, 'hand', LEFT])
        self._answer()

    def wheels_in_separate_messages(self) -> None:
        """Complete the sample with the second; it has the newest stamp."""
        self._move()
        first, second = self.random.sample(NAMES, 2)
        is_older_last = self.random.random() < 0.5
        self._send(names=[first], stamp_ns=self.now if is_older_last else self.now - 1000)
        self._send(names=['arm', second], stamp_ns=self.now - 1000 if is_older_last else self.now)
        self._answer()

    def messages_of_other_joints(self) -> None:
        """They are passed over, empty ones too."""
        self._move()
        self._send(names=['arm', 'hand'])
        self._send(names=[])
        self.counts['without_wheels'] += 2
        self.an_ordinary_sample()

    def a_message_without_a_value(self) -> None:
        """Fewer positions than names: nothing of it is taken, the next carries the motion."""
        self._move()
        self._say(NAMES, [self.raw()[0]], [], self.now)
        self.counts['missing_values'] += 1
        self.an_ordinary_sample()

    def velocities_instead_of_positions(self) -> None:
        """Be a driver that is not heard; the next carries the motion."""
        self._move()
        self._say(NAMES, [], [7.0, 8.0], self.now)
        self.counts['missing_values'] += 1
        self.an_ordinary_sample()

    def a_value_that_is_none(self) -> None:
        """Not finite: the other wheel's is not taken either, the next carries the motion."""
        self._move()
        self._send({self.random.choice((0, 1)): self.random.choice(
            (math.nan, math.inf, -math.inf, 1e300))})
        self.counts['not_finite'] += 1
        self.an_ordinary_sample()

    def a_duplicate(self) -> None:
        """Sent twice, or the same stamp with other angles: the first counts."""
        self.an_ordinary_sample()
        self._send({0: self.random.choice((self.raw()[0], 3.0))})
        self.counts['out_of_order'] += 1
        self.an_ordinary_sample()

    def a_message_out_of_order(self) -> None:
        """One that is late by less than a second is passed over."""
        self._send({0: 3.0}, stamp_ns=self._last - self.random.randrange(2000, SECOND))
        self.counts['out_of_order'] += 1
        self.an_ordinary_sample()

    def a_straggler(self) -> None:
        """One message from long ago is no restart of time."""
        self._move()
        self._send({1: 3.0}, stamp_ns=self._last - self.random.randrange(2, 1000) * SECOND)
        self.counts['late_messages'] += 1
        self.an_ordinary_sample()

    def time_starts_again(self) -> None:
        """Let a bag loop, encoders and all: the step until the first of its messages is lost."""
        self._move()
        self.now -= self.random.randrange(2, 1000) * SECOND
        self._jump(0)
        self._jump(1)
        self._send()
        self._believed = self.raw()
        self._something_harmless()
        self.counts['time_resets'] += 1
        self.an_ordinary_sample()

    def a_wrap(self) -> None:
        """Drive on until both counters have started anew, either way."""
        sign = self.random.choice((1.0, -1.0))
        # At most a fifth of a range a message, and no faster than the wheels can.
        step_ns = round(0.15 * WRAP / (0.4 * FASTEST) * SECOND)
        for _ in range(8):
            self._speeds = [0.4 * FASTEST * sign, 0.35 * FASTEST * sign]
            self._move(step_ns, is_steady=True)
            self._send()
            self._answer()

    def a_glitch(self) -> None:
        """Send a position that cannot be, alone: nothing is lost."""
        self.an_ordinary_sample()
        self._move()
        side = self.random.choice((0, 1))
        self._send({side: self.raw()[side] + self._leap()})
        self._something_harmless()
        self._move()
        self._send()
        self._answer(but_of={side})
        self.counts['glitches'] += 1

    def a_reset_of_the_counters(self) -> None:
        """Lose the step in which both are reset, and nothing else."""
        self._reset({0, 1})

    def a_reset_of_one_counter(self) -> None:
        """Lose that wheel's step; the other's motion is not lost."""
        self._reset({self.random.choice((0, 1))})

    def silence_while_it_drives(self) -> None:
        """Of the encoders, for a second: the next sample carries the motion, as one arc."""
        self._move(SECOND)
        self.an_ordinary_sample()

    def _reset(self, sides: set[int]) -> None:
        self.an_ordinary_sample()
        self._move()
        for side in sides:
            self._jump(side)
        self._send()
        self._something_harmless()
        self._move()
        self._send()
        self._answer(but_of=sides)
        self.counts['encoder_resets'] += 1

    def _something_harmless(self) -> None:
        """Send, sometimes, what is neither believed nor refutes what is held back."""
        kind = self.random.randrange(4)
        if kind == 1:
            self._send(names=['arm'])
            self.counts['without_wheels'] += 1
        elif kind == 2:
            self._move()
            self._say(NAMES, [], [], self.now)
            self.counts['missing_values'] += 1

    def _move(self, elapsed_ns: int | None = None, is_steady: bool = False) -> None:
        """Turn the wheels, and let a period pass."""
        elapsed_ns = elapsed_ns or self._period_ns
        self.now += elapsed_ns
        for side, direction in enumerate(DIRECTIONS):
            if not is_steady:
                speed = self._speeds[side] + self.random.uniform(-1.0, 1.0)
                self._speeds[side] = min(max(speed, -0.4 * FASTEST), 0.4 * FASTEST)
            step = self._speeds[side] * elapsed_ns * 1e-9
            self._counter[side] += direction * step
            self._unheard[side] += step

    def _leap(self) -> float:
        """Return a leap further than any wheel turns, and not nearly a whole range."""
        return self.random.choice((1.0, -1.0)) * self.random.uniform(12.0, 0.45 * WRAP)

    def _jump(self, side: int) -> None:
        """Let a counter jump: what was not heard of it until now never will be."""
        self._counter[side] += self._leap()
        self._unheard[side] = 0.0

    def raw(self) -> list[float]:
        """Return what the encoders say."""
        return [angle % WRAP for angle in self._counter]

    def _send(self, spoil: dict[int, float] | None = None, stamp_ns: int | None = None,
              names: Sequence[str] = NAMES) -> None:
        """Send what the encoders say, or something else for some sides."""
        values = self.raw()
        for side, value in (spoil or {}).items():
            values[side] = value
        by_name = dict(zip(NAMES, values, strict=True))
        self._say(names, [by_name.get(name, 7.0) for name in names], [],
                  self.now if stamp_ns is None else stamp_ns)

    def _answer(self, counts_wraps: bool = True, but_of: Sequence[int] | set[int] = ()) -> None:
        """Expect an answer to what was sent last; wraps are counted where nothing else is."""
        raw = self.raw()
        wraps = False
        for side in (0, 1):
            self._turned[side] += self._unheard[side]
            step = DIRECTIONS[side] * self._unheard[side]
            wraps |= side not in but_of and (
                abs(raw[side] - self._believed[side] - step) > 0.5 * WRAP)
        self.counts['wraparounds'] += counts_wraps and wraps
        self._unheard = [0.0, 0.0]
        self._believed = raw
        self._last = self.now
        self.counts['samples'] += 1
        self.expected.append((self.now, *self._turned))


class Expected:
    """The poses that are due, from the angles that a drive expects, answer by answer."""

    def __init__(self, drive: DiffDrive) -> None:
        self.drive = drive
        self.pose = np.zeros(3)
        self._angles: tuple[float, float] | None = None

    def reset(self) -> None:
        """Let the pose be zero at the last answer."""
        self.pose = np.zeros(3)

    def of(self, answers: Sequence[tuple[int, float, float]]) -> np.ndarray:
        """Return the poses, (N, 3), of further answers."""
        angles = np.array([angles for _, *angles in answers]).reshape(-1, 2)
        if self._angles is None:
            self._angles = tuple(angles[0])
        left, right = np.vstack([self._angles, angles]).T
        poses = integrate(self.drive, left, right, self.pose)[1:]
        if len(answers):
            self._angles, self.pose = tuple(angles[-1]), poses[-1]
        return poses
