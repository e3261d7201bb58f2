"""
Wheel feedback: from joint messages to continuous angles of the left and the right side.

Joints are found by name, in any order, among any others. Several wheels of a side are averaged.
Wheels may arrive in separate messages: a sample is complete when every wheel has been renewed.

The angles are continuous whatever a message contains. A wraparound of the encoder is unwrapped.
A step above the plausible speed stays pending until the next message. If that returns to the old
value, the step was a glitch, and no motion is lost. If it confirms the new value, the step was an
encoder reset, and the motion of that one step is lost. A stamp that jumps back stays pending
likewise: a single late message is dropped; a second message confirms a time reset (a bag that
loops, a restarted simulation).
"""
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, field
import math
from typing import NamedTuple

# Above it a double resolves an angle no finer than a tenth of a milliradian: no encoder.
MAX_VALUE = 1e12  # [rad], [rad/s]

# A stamp older than the last by less is out of order; by this or more, late or a time reset.
JUMP_BACK_NS = 1_000_000_000

NEVER_NS = -2**63

# A velocity is integrated over no longer gap between messages.
MAX_VELOCITY_GAP_NS = 1_000_000_000


class WheelSample(NamedTuple):
    """The mean wheel angle of each side [rad], at the newest stamp of its wheels [ns]."""

    left: float
    right: float
    stamp_ns: int
    time_reset_ns: int | None = None
    """After a time reset: the stamp [ns], in the new time, of the previous sample's angles."""


PlainSample = tuple[float, float, int, int | None]
"""A WheelSample as a plain tuple, which is cheaper to create for each message of a robot."""


@dataclass(slots=True)
class _Wheel:
    name: str
    direction: float
    value: float = 0.0
    """The last accepted position [rad], as the joint reports it."""
    stamp_ns: int = NEVER_NS
    """The stamp of that position."""
    angle: float = 0.0
    """The forward wheel angle [rad], continuous from the first position on."""
    pending_step: tuple[float, int] | None = None
    """An implausible position and its stamp: a glitch or an encoder reset."""
    pending_past: tuple[float, int] | None = None
    """A position and its stamp before a jump back: a late message or a time reset."""


_WheelUpdate = tuple[_Wheel, float, float, str]
"""A wheel, its new position, its new angle [rad] and the counter of the event, '' for none."""


@dataclass(kw_only=True)
class WheelFeedback:
    """
    The state of every wheel, updated by each message that contains it.

    With position_feedback the angle is the joint's position [rad]. Without it, the joint's
    velocity [rad/s] is integrated over the time since the wheel's last message, of a second at
    most. A direction is -1 for joints that count backward. encoder_wrap [rad] is the range of an
    encoder that wraps around. A step faster than max_plausible_speed [rad/s] is a glitch or an
    encoder reset. None switches either check off.
    """

    left_names: Sequence[str]
    right_names: Sequence[str]
    position_feedback: bool = True
    left_direction: int = 1
    right_direction: int = 1
    encoder_wrap: float | None = None
    max_plausible_speed: float | None = None
    warning: str = field(init=False)
    """The fault of the last message with one of these wheels, as text; '' for none."""
    samples: int = field(init=False)
    """The number of complete samples."""
    counts: Counter[str] = field(default_factory=Counter, init=False)
    """
    The number of messages by event; the names are keys of /diagnostics.

    out_of_order (older than the last by less than a second, or equal), late_messages, time_resets,
    glitches, encoder_resets, wraparounds, gaps (of velocities), not_finite, missing_values,
    without_wheels, unreadable.
    """

    def __post_init__(self) -> None:
        self.warning, self.samples = '', 0
        self._left = [_Wheel(name, float(self.left_direction)) for name in self.left_names]
        self._right = [_Wheel(name, float(self.right_direction)) for name in self.right_names]
        self._wheels = {wheel.name: wheel for wheel in (*self._left, *self._right)}
        self._renewed: set[str] = set()
        self._events: set[str] = set()  # of the current message
        # Without checks, every newer finite position is accepted.
        self._is_unchecked = (
            self.position_feedback and self.encoder_wrap is None
            and self.max_plausible_speed is None)
        self._time_reset_ns: int | None = None
        # The layout of the last message, if the fast path of take() may accept the next.
        self._cached_names: tuple[str, ...] | None = None
        self._cached_stamp_ns = NEVER_NS
        self._cached_wheels: tuple[_Wheel, ...] = ()

    @property
    def missing_wheels(self) -> list[str]:
        """Return the wheels that the next sample still needs."""
        return [name for name in self._wheels if name not in self._renewed]

    def update(
        self, names: Sequence[str], positions: Sequence[float], velocities: Sequence[float],
        stamp_ns: int,
    ) -> WheelSample | None:
        """
        Process one message; return the sample that it completes, or None.

        A message without these wheels is ignored. A message is dropped as a whole if one of these
        wheels has no value or an implausible one: the last angles stay, and the next message
        contains the motion.
        """
        sample = self.take(names, positions, velocities, stamp_ns)
        return sample and WheelSample(*sample)

    def take(
        self, names: Sequence[str], positions: Sequence[float], velocities: Sequence[float],
        stamp_ns: int,
    ) -> PlainSample | None:
        """
        Do as update, and return a plain tuple.

        The first block is the fast path for two wheels in the order of the last message, without
        checks; _take_any is the general path. test_cached_layout_gives_the_same_samples holds both
        equal. It touches little code and data, because most of its cost is cache misses between
        two messages.
        """
        if (names == self._cached_names and stamp_ns > self._cached_stamp_ns
                and len(positions) == 2):
            value, other_value = positions
            if -MAX_VALUE < value < MAX_VALUE and -MAX_VALUE < other_value < MAX_VALUE:
                self.samples += 1
                self.warning = ''
                self._cached_stamp_ns = stamp_ns
                wheel, other = self._cached_wheels
                wheel.angle += wheel.direction * (value - wheel.value)
                wheel.value, wheel.stamp_ns = value, stamp_ns
                other.angle += other.direction * (other_value - other.value)
                other.value, other.stamp_ns = other_value, stamp_ns
                return self._left[0].angle, self._right[0].angle, stamp_ns, None
        self._cached_names = None
        self._events.clear()
        sample = self._take_any(names, positions, velocities, stamp_ns)
        self.counts.update(self._events)
        return sample

    def _take_any(
        self, names: Sequence[str], positions: Sequence[float], velocities: Sequence[float],
        stamp_ns: int,
    ) -> PlainSample | None:
        values = positions if self.position_feedback else velocities
        is_complete = True
        updates: list[_WheelUpdate] = []
        for name, value in zip(names, values, strict=False):
            wheel = self._wheels.get(name)
            if wheel is None:
                continue
            if is_complete and not updates:
                self.warning = ''
            update = self._update_of(wheel, value, stamp_ns)
            if update:
                updates.append(update)
            else:
                is_complete = False
        if len(values) < len(names) and self._has_missing_values(
                names, len(values), len(velocities)):
            is_complete = False
        if not is_complete:
            return None
        if not updates:
            self._events.add('without_wheels')
            return None
        for wheel, value, angle, event in updates:
            if event:
                self._events.add(event)
            wheel.value, wheel.angle, wheel.stamp_ns = value, angle, stamp_ns
            wheel.pending_step = None
            self._renewed.add(wheel.name)
        if len(self._renewed) < len(self._wheels):
            return None
        if self._is_unchecked and len(names) == 2 and self._wheels.keys() == set(names):
            self._cached_names, self._cached_stamp_ns = tuple(names), stamp_ns
            self._cached_wheels = tuple([self._wheels[name] for name in names])
        return self._sample(max([wheel.stamp_ns for wheel in self._wheels.values()]))

    def reject(self, warning: str) -> None:
        """Count an unreadable message, and set its warning."""
        self.counts['unreadable'] += 1
        self.warning = warning

    def _sample(self, stamp_ns: int) -> PlainSample:
        self.samples += 1
        self._renewed.clear()
        time_reset_ns, self._time_reset_ns = self._time_reset_ns, None
        left = right = 0.0
        for wheel in self._left:
            left += wheel.angle
        for wheel in self._right:
            right += wheel.angle
        return left / len(self._left), right / len(self._right), stamp_ns, time_reset_ns

    def _update_of(self, wheel: _Wheel, value: float, stamp_ns: int) -> _WheelUpdate | None:
        """Return the update of a wheel by a position or velocity, None if it is dropped."""
        if not abs(value) < MAX_VALUE:
            self._events.add('not_finite')
            self.warning = f'{wheel.name} = {value}: must be finite and below {MAX_VALUE:g}'
            return None
        has_baseline = wheel.stamp_ns != NEVER_NS
        if has_baseline and not self._accept_stamp(wheel, value, stamp_ns):
            return None
        if not self.position_feedback:
            return self._velocity_update(wheel, value, stamp_ns)
        if not has_baseline:
            return _wheel_update(wheel, value, value)
        return self._position_update(wheel, value, stamp_ns)

    def _accept_stamp(self, wheel: _Wheel, value: float, stamp_ns: int) -> bool:
        """Return whether a stamp follows the wheel's last one, if need be after a time reset."""
        if stamp_ns > wheel.stamp_ns:
            if wheel.pending_past:
                self._events.add('late_messages')
                wheel.pending_past = None
            return True
        if wheel.stamp_ns - stamp_ns < JUMP_BACK_NS:
            self._events.add('out_of_order')
            return False
        if wheel.pending_past is None or stamp_ns <= wheel.pending_past[1]:
            if wheel.pending_past:
                self._events.add(
                    'out_of_order' if stamp_ns == wheel.pending_past[1] else 'late_messages')
            wheel.pending_past = (value, stamp_ns)
            return False
        self._reset_time(wheel, *wheel.pending_past)
        return True

    def _reset_time(self, wheel: _Wheel, value: float, stamp_ns: int) -> None:
        """Move a wheel's baseline to a position and stamp in the new time; its angle stays."""
        self._events.add('time_resets')
        wheel.value, wheel.stamp_ns = value, stamp_ns
        wheel.pending_step = wheel.pending_past = None
        if self._time_reset_ns is None or stamp_ns < self._time_reset_ns:
            self._time_reset_ns = stamp_ns
        for other in self._wheels.values():
            if other.stamp_ns - stamp_ns >= JUMP_BACK_NS:
                self._renewed.discard(other.name)  # its last message is of the old time

    def _position_update(self, wheel: _Wheel, value: float, stamp_ns: int) -> _WheelUpdate | None:
        turned = self._step(wheel.value, value)
        if self._is_plausible(turned, stamp_ns - wheel.stamp_ns):
            if wheel.pending_step:
                return _wheel_update(wheel, value, turned, 'glitches')
            is_wrap = abs(value - wheel.value) > 1.5 * abs(turned)
            return _wheel_update(wheel, value, turned, 'wraparounds' if is_wrap else '')
        if wheel.pending_step:
            turned = self._step(wheel.pending_step[0], value)
            if self._is_plausible(turned, stamp_ns - wheel.pending_step[1]):
                return _wheel_update(wheel, value, turned, 'encoder_resets')
        wheel.pending_step = (value, stamp_ns)
        self.warning = (
            f'{wheel.name} moved from {wheel.value:g} to {value:g} rad in '
            f'{(stamp_ns - wheel.stamp_ns) * 1e-9:g} s, faster than max_plausible_wheel_speed: '
            'ignored as a glitch or an encoder reset')
        return None

    def _step(self, old: float, new: float) -> float:
        if self.encoder_wrap is None:
            return new - old
        return math.remainder(new - old, self.encoder_wrap)

    def _is_plausible(self, turned: float, elapsed_ns: int) -> bool:
        return (self.max_plausible_speed is None
                or abs(turned) <= self.max_plausible_speed * elapsed_ns * 1e-9)

    def _velocity_update(self, wheel: _Wheel, speed: float, stamp_ns: int) -> _WheelUpdate | None:
        """Return the update of a wheel by a velocity [rad/s], None if it is implausible."""
        if self.max_plausible_speed is not None and abs(speed) > self.max_plausible_speed:
            self._events.add('glitches')
            self.warning = f'{wheel.name} = {speed:g} rad/s: faster than max_plausible_wheel_speed'
            return None
        elapsed_ns = stamp_ns - wheel.stamp_ns
        if wheel.stamp_ns == NEVER_NS:
            return _wheel_update(wheel, 0.0, 0.0)
        if elapsed_ns > MAX_VELOCITY_GAP_NS:
            self.warning = (
                f'{wheel.name} had no velocity for {elapsed_ns * 1e-9:g} s: its motion in the gap '
                'is lost, the driver must publish more often')
            return _wheel_update(wheel, 0.0, 0.0, 'gaps')
        return _wheel_update(wheel, 0.0, speed * elapsed_ns * 1e-9)

    def _has_missing_values(
        self, names: Sequence[str], value_count: int, velocity_count: int,
    ) -> bool:
        """Return whether one of these wheels has a name but no value, and set the warning."""
        is_missing = False
        for index in range(value_count, len(names)):
            if names[index] in self._wheels:
                is_missing = True
                self._events.add('missing_values')
                if self.position_feedback and index < velocity_count:
                    self.warning = (
                        'wheels have velocities but no positions: set position_feedback to false, '
                        'or let the driver publish positions')
                else:
                    missing = 'position' if self.position_feedback else 'velocity'
                    self.warning = f'{names[index]} has no {missing}'
        return is_missing


def _wheel_update(wheel: _Wheel, value: float, turned: float, event: str = '') -> _WheelUpdate:
    return wheel, value, wheel.angle + wheel.direction * turned, event
