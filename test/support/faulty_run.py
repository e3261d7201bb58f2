"""A run whose messages have every fault, and the odometry that is expected of it."""
from collections import Counter
from collections.abc import Callable, Sequence
import math
import random

from diffdrive_ros.core.kinematics import DiffDrive
from diffdrive_ros.core.odometry import integrate
import numpy as np

LEFT, RIGHT = NAMES = 'left_wheel_joint', 'right_wheel_joint'
DIRECTIONS = 1, -1  # the right wheel counts backward
WRAP_RAD = 53.7  # range of the encoders
MAX_SPEED = 31.0  # [rad/s]
SECOND_NS = 1_000_000_000

# Parameters of the node for these wheels.
PARAMETERS = {
    'right_wheel_direction': -1, 'encoder_wrap': WRAP_RAD, 'max_plausible_wheel_speed': MAX_SPEED}

Send = Callable[[Sequence[str], Sequence[float], Sequence[float], int], None]
"""Send names, positions, velocities and a stamp [ns]."""


class FaultyRun:
    """
    Two wheels in a run, through fault after fault; each fault is a method of a name in FAULTS.

    expected has the timestamp [ns] and the wheel angles [rad] of each odometry message: those of
    the run without faults, less the losses that WheelFeedback documents. counts are those of
    diagnostics.
    """

    FAULTS = (
        'ordinary_sample', 'reordered_and_foreign_joints', 'separate_messages', 'foreign_joints',
        'missing_value', 'velocities_only', 'not_finite_value', 'duplicate',
        'out_of_order_message', 'late_message', 'time_reset', 'wraparound', 'glitch',
        'encoder_reset', 'single_encoder_reset', 'pause_in_motion')

    def __init__(self, send: Send, period_ns: int = 20_000_000, seed: int = 1) -> None:
        self._publish = send
        self._period_ns = period_ns
        self.random = random.Random(seed)
        self.now = 1_700_000_000 * SECOND_NS
        self.expected: list[tuple[int, float, float]] = []
        self.counts: Counter[str] = Counter()
        self._speeds = [3.0, 5.0]  # [rad/s], forward
        self._counter = [17.0, -41.0]  # of the encoders, not wrapped; any start
        self._accepted = self.raw()
        self._turned = [0.0, 0.0]  # total of the samples
        self._pending = [0.0, 0.0]  # motion in the next sample
        self._last = self.now

    def begin(self) -> None:
        """Send the first sample, the baseline, at any encoder position."""
        self._send()
        self._expect(counts_wraps=False)

    def stand(self) -> None:
        """Let a period pass in which no wheel turns."""
        self.now += self._period_ns
        self._send()
        self._expect()

    def ordinary_sample(self) -> None:
        """Send a sample without a fault; an encoder may wrap."""
        self._move()
        self._send()
        self._expect()

    def reordered_and_foreign_joints(self) -> None:
        """Send the wheels in another order, beside other joints."""
        self._move()
        self._send(names=['arm', RIGHT, 'hand', LEFT])
        self._expect()

    def separate_messages(self) -> None:
        """Send one message per wheel: the second completes the sample, with the newest stamp."""
        self._move()
        first, second = self.random.sample(NAMES, 2)
        is_older_last = self.random.random() < 0.5
        self._send(names=[first], stamp_ns=self.now if is_older_last else self.now - 1000)
        self._send(names=['arm', second], stamp_ns=self.now - 1000 if is_older_last else self.now)
        self._expect()

    def foreign_joints(self) -> None:
        """Send messages without our wheels, one of them empty: they are dropped."""
        self._move()
        self._send(names=['arm', 'hand'])
        self._send(names=[])
        self.counts['without_wheels'] += 2
        self.ordinary_sample()

    def missing_value(self) -> None:
        """Send fewer positions than names: dropped, the next sample contains the motion."""
        self._move()
        self._publish(NAMES, [self.raw()[0]], [], self.now)
        self.counts['missing_values'] += 1
        self.ordinary_sample()

    def velocities_only(self) -> None:
        """Send velocities without positions: dropped, the next sample contains the motion."""
        self._move()
        self._publish(NAMES, [], [7.0, 8.0], self.now)
        self.counts['missing_values'] += 1
        self.ordinary_sample()

    def not_finite_value(self) -> None:
        """Send one value that is not finite: both are dropped, the next sample has the motion."""
        self._move()
        self._send({self.random.choice((0, 1)): self.random.choice(
            (math.nan, math.inf, -math.inf, 1e300))})
        self.counts['not_finite'] += 1
        self.ordinary_sample()

    def duplicate(self) -> None:
        """Send a stamp twice, with equal or other angles: the first counts."""
        self.ordinary_sample()
        self._send({0: self.random.choice((self.raw()[0], 3.0))})
        self.counts['out_of_order'] += 1
        self.ordinary_sample()

    def out_of_order_message(self) -> None:
        """Send a message that is late by less than a second: it is dropped."""
        self._send({0: 3.0}, stamp_ns=self._last - self.random.randrange(2000, SECOND_NS))
        self.counts['out_of_order'] += 1
        self.ordinary_sample()

    def late_message(self) -> None:
        """Send one very late message: it is dropped, and is no time reset."""
        self._move()
        self._send({1: 3.0}, stamp_ns=self._last - self.random.randrange(2, 1000) * SECOND_NS)
        self.counts['late_messages'] += 1
        self.ordinary_sample()

    def time_reset(self) -> None:
        """Loop a bag, encoders included: the step before its first message is lost."""
        self._move()
        self.now -= self.random.randrange(2, 1000) * SECOND_NS
        self._jump(0)
        self._jump(1)
        self._send()
        self._accepted = self.raw()
        self._send_harmless()
        self.counts['time_resets'] += 1
        self.ordinary_sample()

    def wraparound(self) -> None:
        """Drive until both encoders have wrapped, in either direction."""
        sign = self.random.choice((1.0, -1.0))
        # At most a fifth of the range per message, within the speed of the wheels.
        step_ns = round(0.15 * WRAP_RAD / (0.4 * MAX_SPEED) * SECOND_NS)
        for _ in range(8):
            self._speeds = [0.4 * MAX_SPEED * sign, 0.35 * MAX_SPEED * sign]
            self._move(step_ns, is_steady=True)
            self._send()
            self._expect()

    def glitch(self) -> None:
        """Send one implausible position: nothing is lost."""
        self.ordinary_sample()
        self._move()
        side = self.random.choice((0, 1))
        self._send({side: self.raw()[side] + self._implausible_step()})
        self._send_harmless()
        self._move()
        self._send()
        self._expect(faulty_sides={side})
        self.counts['glitches'] += 1

    def encoder_reset(self) -> None:
        """Reset both encoders: only the step of the reset is lost."""
        self._reset({0, 1})

    def single_encoder_reset(self) -> None:
        """Reset one encoder: only that wheel's step is lost."""
        self._reset({self.random.choice((0, 1))})

    def pause_in_motion(self) -> None:
        """Send nothing for a second of motion: the next sample contains it, as one arc."""
        self._move(SECOND_NS)
        self.ordinary_sample()

    def _reset(self, sides: set[int]) -> None:
        self.ordinary_sample()
        self._move()
        for side in sides:
            self._jump(side)
        self._send()
        self._send_harmless()
        self._move()
        self._send()
        self._expect(faulty_sides=sides)
        self.counts['encoder_resets'] += 1

    def _send_harmless(self) -> None:
        """Send, at random, a message that neither confirms nor refutes a rejected value."""
        kind = self.random.randrange(4)
        if kind == 1:
            self._send(names=['arm'])
            self.counts['without_wheels'] += 1
        elif kind == 2:
            self._move()
            self._publish(NAMES, [], [], self.now)
            self.counts['missing_values'] += 1

    def _move(self, elapsed_ns: int | None = None, is_steady: bool = False) -> None:
        """Turn the wheels for a period."""
        elapsed_ns = elapsed_ns or self._period_ns
        self.now += elapsed_ns
        for side, direction in enumerate(DIRECTIONS):
            if not is_steady:
                speed = self._speeds[side] + self.random.uniform(-1.0, 1.0)
                self._speeds[side] = min(max(speed, -0.4 * MAX_SPEED), 0.4 * MAX_SPEED)
            step = self._speeds[side] * elapsed_ns * 1e-9
            self._counter[side] += direction * step
            self._pending[side] += step

    def _implausible_step(self) -> float:
        """Return an implausible step, well below the whole range [rad]."""
        return self.random.choice((1.0, -1.0)) * self.random.uniform(12.0, 0.45 * WRAP_RAD)

    def _jump(self, side: int) -> None:
        """Let an encoder jump: its pending motion is lost."""
        self._counter[side] += self._implausible_step()
        self._pending[side] = 0.0

    def raw(self) -> list[float]:
        """Return the encoder positions [rad]."""
        return [angle % WRAP_RAD for angle in self._counter]

    def _send(self, replaced: dict[int, float] | None = None, stamp_ns: int | None = None,
              names: Sequence[str] = NAMES) -> None:
        """Send the encoder positions, or other values for some sides."""
        values = self.raw()
        for side, value in (replaced or {}).items():
            values[side] = value
        by_name = dict(zip(NAMES, values, strict=True))
        self._publish(
            names, [by_name.get(name, 7.0) for name in names], [],
            self.now if stamp_ns is None else stamp_ns)

    def _expect(
        self, counts_wraps: bool = True, faulty_sides: Sequence[int] | set[int] = (),
    ) -> None:
        """Expect odometry of the last message; wraparounds count for sides without a fault."""
        raw = self.raw()
        wraps = False
        for side in (0, 1):
            self._turned[side] += self._pending[side]
            step = DIRECTIONS[side] * self._pending[side]
            wraps |= side not in faulty_sides and (
                abs(raw[side] - self._accepted[side] - step) > 0.5 * WRAP_RAD)
        self.counts['wraparounds'] += counts_wraps and wraps
        self._pending = [0.0, 0.0]
        self._accepted = raw
        self._last = self.now
        self.counts['samples'] += 1
        self.expected.append((self.now, *self._turned))


class Expected:
    """Expected poses, by the expected angles of a run."""

    def __init__(self, drive: DiffDrive) -> None:
        self.drive = drive
        self.pose = np.zeros(3)
        self._angles: tuple[float, float] | None = None

    def reset(self) -> None:
        """Set the pose to zero at the last message."""
        self.pose = np.zeros(3)

    def of(self, messages: Sequence[tuple[int, float, float]]) -> np.ndarray:
        """Return the poses, (N, 3), of further expected angles."""
        angles = np.array([angles for _, *angles in messages]).reshape(-1, 2)
        if self._angles is None:
            self._angles = tuple(angles[0])
        left, right = np.vstack([self._angles, angles]).T
        poses = integrate(self.drive, left, right, self.pose)[1:]
        if len(messages):
            self._angles, self.pose = tuple(angles[-1]), poses[-1]
        return poses
