"""
The way in: from joint messages, as they really come, to the angles of the left and right side.

Joints are found by name, in any order, among any others. Several wheels a side are averaged.
Wheels may come in separate messages: a sample is complete when every wheel has been renewed.

Whatever a message brings, the angles that come out are continuous: a counter that wraps is
unrolled, and a value that cannot be is held back until the next one tells what it was. A glitch
came alone, and nothing is lost with it; a reset of the counter stays, and the one step in which
it happened is lost. A stamp far in the past is treated likewise: a straggler comes alone; when
time itself starts again (a bag that loops, a simulation that is reset), the next stamp follows it.
"""
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, field, KW_ONLY
import math
from typing import NamedTuple

# Beyond it a double resolves an angle [rad] no finer than a tenth of a milliradian: no encoder.
LARGEST = 1e12

# Stamps that are older than the last by less than this are out of order; by more, a new time.
JUMP_BACK_NS = 1_000_000_000

BEFORE_ALL_NS = -2**63

# A velocity says nothing about what a wheel did longer ago.
VELOCITY_HOLDS_NS = 1_000_000_000


class WheelSample(NamedTuple):
    """The mean angle of the wheels of each side [rad], at the stamp of the newest [ns]."""

    left: float
    right: float
    stamp_ns: int
    restarted_ns: int | None = None
    """When time has started again: the stamp [ns] in the new time of the last sample's angles."""


PlainSample = tuple[float, float, int, int | None]
"""The same without the names, which cost too much for each message of a live robot."""


@dataclass(slots=True)
class _Wheel:
    name: str
    direction: float
    value: float = 0.0
    """The last position that was believed [rad], as the joint gives it."""
    stamp_ns: int = BEFORE_ALL_NS
    """When that was."""
    angle: float = 0.0
    """How far the wheel has turned forward [rad], continuous from its first value on."""
    held: tuple[float, int] | None = None
    """A position that cannot be, and its stamp, until the next tells what it was."""
    held_past: tuple[float, int] | None = None
    """A position from the past, and its stamp, until the next tells whether time restarted."""


_Turn = tuple[_Wheel, float, float, str]
"""What a value says: of which wheel, the value, the new angle [rad], what was special about it."""


@dataclass(kw_only=True)
class WheelFeedback:
    """
    The state of every wheel, renewed by each message that brings it.

    With position_feedback the angle is the joint's position [rad]; without, the joint's velocity
    [rad/s] is integrated, taken to have been constant since the wheel's last message, which may be
    at most a second ago. The directions are -1 for joints that count backward. encoder_wrap is
    the range of a counter [rad] that starts anew at its end, max_plausible_speed [rad/s] the speed
    above which a step is held back; None for no such thing.
    """

    left_names: Sequence[str]
    right_names: Sequence[str]
    _: KW_ONLY
    position_feedback: bool = True
    left_direction: int = 1
    right_direction: int = 1
    encoder_wrap: float | None = None
    max_plausible_speed: float | None = None
    complaint: str = field(init=False)
    """What was wrong with the last message of ours, for a person to read; '' if nothing was."""
    samples: int = field(init=False)
    """How many there were."""
    counts: Counter[str] = field(default_factory=Counter, init=False)
    """Of how many messages what else is to be said, by the words in which diagnostics say it."""

    def __post_init__(self) -> None:
        self.complaint, self.samples = '', 0
        self._left = [_Wheel(name, float(self.left_direction)) for name in self.left_names]
        self._right = [_Wheel(name, float(self.right_direction)) for name in self.right_names]
        self._wheels = {wheel.name: wheel for wheel in (*self._left, *self._right)}
        self._renewed: set[str] = set()
        self._happened: set[str] = set()  # with the message at hand
        # With nothing to hold it against, a position that is newer is believed.
        self._takes_all = (
            self.position_feedback and self.encoder_wrap is None
            and self.max_plausible_speed is None)
        self._restarted_ns: int | None = None
        # What the next message of a robot with two wheels nearly always is: as the last.
        self._usual_names: tuple[str, ...] | None = None
        self._usual_after_ns = BEFORE_ALL_NS
        self._usual_wheels: tuple[_Wheel, ...] = ()

    @property
    def waits_for(self) -> list[str]:
        """Return the wheels without which the next sample is not complete."""
        return [name for name in self._wheels if name not in self._renewed]

    def update(
        self, names: Sequence[str], positions: Sequence[float], velocities: Sequence[float],
        stamp_ns: int,
    ) -> WheelSample | None:
        """
        Take one message; return the sample that it completes, or None.

        Messages without our wheels are passed over. If one of our wheels has no value, or one that
        cannot be believed, nothing of the message is taken: the last angles stay, and the next
        message carries the motion.
        """
        sample = self.take(names, positions, velocities, stamp_ns)
        return sample and WheelSample(*sample)

    def take(
        self, names: Sequence[str], positions: Sequence[float], velocities: Sequence[float],
        stamp_ns: int,
    ) -> PlainSample | None:
        """Do what update does, for less."""
        # As nearly always: two wheels, in the order of the last message, and nothing special. The
        # same is done as for any other message, by as little code and data as can be: between two
        # messages the caches forget, and it is what has to be fetched again that costs.
        if names == self._usual_names and stamp_ns > self._usual_after_ns and len(positions) == 2:
            value, other_value = positions
            if -LARGEST < value < LARGEST and -LARGEST < other_value < LARGEST:
                self.samples += 1
                self.complaint = ''
                self._usual_after_ns = stamp_ns
                wheel, other = self._usual_wheels
                wheel.angle += wheel.direction * (value - wheel.value)
                wheel.value, wheel.stamp_ns = value, stamp_ns
                other.angle += other.direction * (other_value - other.value)
                other.value, other.stamp_ns = other_value, stamp_ns
                return self._left[0].angle, self._right[0].angle, stamp_ns, None
        self._usual_names = None
        self._happened.clear()
        sample = self._take_any(names, positions, velocities, stamp_ns)
        self.counts.update(self._happened)
        return sample

    def _take_any(
        self, names: Sequence[str], positions: Sequence[float], velocities: Sequence[float],
        stamp_ns: int,
    ) -> PlainSample | None:
        values = positions if self.position_feedback else velocities
        is_whole = True
        turns: list[_Turn] = []
        for name, value in zip(names, values, strict=False):
            wheel = self._wheels.get(name)
            if wheel is None:
                continue
            if is_whole and not turns:
                self.complaint = ''
            turn = self._turn_to(wheel, value, stamp_ns)
            if turn:
                turns.append(turn)
            else:
                is_whole = False
        if len(values) < len(names) and self._misses(names, len(values), len(velocities)):
            is_whole = False
        if not is_whole:
            return None
        if not turns:
            self._happened.add('without our wheels')
            return None
        for wheel, value, angle, event in turns:
            if event:
                self._happened.add(event)
            wheel.value, wheel.angle, wheel.stamp_ns = value, angle, stamp_ns
            wheel.held = None
            self._renewed.add(wheel.name)
        if len(self._renewed) < len(self._wheels):
            return None
        if self._takes_all and len(names) == 2 and self._wheels.keys() == set(names):
            self._usual_names, self._usual_after_ns = tuple(names), stamp_ns
            self._usual_wheels = tuple([self._wheels[name] for name in names])
        return self._sample(max([wheel.stamp_ns for wheel in self._wheels.values()]))

    def refuse(self, complaint: str) -> None:
        """Take note of a message that cannot be read, and why."""
        self.counts['unreadable'] += 1
        self.complaint = complaint

    def _sample(self, stamp_ns: int) -> PlainSample:
        self.samples += 1
        self._renewed.clear()
        restarted_ns, self._restarted_ns = self._restarted_ns, None
        left = right = 0.0
        for wheel in self._left:
            left += wheel.angle
        for wheel in self._right:
            right += wheel.angle
        return left / len(self._left), right / len(self._right), stamp_ns, restarted_ns

    def _turn_to(self, wheel: _Wheel, value: float, stamp_ns: int) -> _Turn | None:
        """Return what a value says of a wheel, None if it cannot be believed."""
        if not abs(value) < LARGEST:
            self._happened.add('not finite')
            self.complaint = f'{wheel.name} = {value}: must be finite and below {LARGEST:g}'
            return None
        is_known = wheel.stamp_ns != BEFORE_ALL_NS
        if is_known and not self._is_newer(wheel, value, stamp_ns):
            return None
        if not self.position_feedback:
            return self._turn_at(wheel, value, stamp_ns)
        if not is_known:
            return _turn(wheel, value, value)
        return self._plausible_turn(wheel, value, stamp_ns)

    def _is_newer(self, wheel: _Wheel, value: float, stamp_ns: int) -> bool:
        """Return whether a stamp follows the wheel's last one; let time restart if it has."""
        if stamp_ns > wheel.stamp_ns:
            if wheel.held_past:
                self._happened.add('stragglers')
                wheel.held_past = None
            return True
        if wheel.stamp_ns - stamp_ns < JUMP_BACK_NS:
            self._happened.add('not newer')
            return False
        if wheel.held_past is None or stamp_ns <= wheel.held_past[1]:
            if wheel.held_past:
                self._happened.add(
                    'not newer' if stamp_ns == wheel.held_past[1] else 'stragglers')
            wheel.held_past = (value, stamp_ns)
            return False
        self._restart(wheel, *wheel.held_past)
        return True

    def _restart(self, wheel: _Wheel, value: float, stamp_ns: int) -> None:
        """Let time start again with a wheel's value and stamp; its angle stays."""
        self._happened.add('restarts of time')
        wheel.value, wheel.stamp_ns, wheel.held, wheel.held_past = value, stamp_ns, None, None
        if self._restarted_ns is None or stamp_ns < self._restarted_ns:
            self._restarted_ns = stamp_ns
        for other in self._wheels.values():
            if other.stamp_ns - stamp_ns >= JUMP_BACK_NS:
                self._renewed.discard(other.name)  # what was heard of it is of the old time

    def _plausible_turn(self, wheel: _Wheel, value: float, stamp_ns: int) -> _Turn | None:
        turned = self._turned(wheel.value, value)
        if self._is_plausible(turned, stamp_ns - wheel.stamp_ns):
            if wheel.held:
                return _turn(wheel, value, turned, 'glitches')
            is_wrap = abs(value - wheel.value) > 1.5 * abs(turned)
            return _turn(wheel, value, turned, 'wraps' if is_wrap else '')
        if wheel.held:
            turned = self._turned(wheel.held[0], value)
            if self._is_plausible(turned, stamp_ns - wheel.held[1]):
                return _turn(wheel, value, turned, 'counter resets')
        wheel.held = (value, stamp_ns)
        self.complaint = (
            f'{wheel.name} went from {wheel.value:g} to {value:g} rad in '
            f'{(stamp_ns - wheel.stamp_ns) * 1e-9:g} s, faster than max_plausible_wheel_speed')
        return None

    def _turned(self, old: float, new: float) -> float:
        if self.encoder_wrap is None:
            return new - old
        return math.remainder(new - old, self.encoder_wrap)

    def _is_plausible(self, turned: float, elapsed_ns: int) -> bool:
        return (self.max_plausible_speed is None
                or abs(turned) <= self.max_plausible_speed * elapsed_ns * 1e-9)

    def _turn_at(self, wheel: _Wheel, speed: float, stamp_ns: int) -> _Turn | None:
        """Return what a velocity [rad/s] says of a wheel, None if it cannot be believed."""
        if self.max_plausible_speed is not None and abs(speed) > self.max_plausible_speed:
            self._happened.add('glitches')
            self.complaint = f'{wheel.name} at {speed:g} rad/s: above max_plausible_wheel_speed'
            return None
        elapsed_ns = stamp_ns - wheel.stamp_ns
        if wheel.stamp_ns == BEFORE_ALL_NS:
            return _turn(wheel, 0.0, 0.0)
        if elapsed_ns > VELOCITY_HOLDS_NS:
            self.complaint = (f'{wheel.name} had no velocity for {elapsed_ns * 1e-9:g} s: what it '
                              'did meanwhile is lost')
            return _turn(wheel, 0.0, 0.0, 'gaps')
        return _turn(wheel, 0.0, speed * elapsed_ns * 1e-9)

    def _misses(self, names: Sequence[str], value_count: int, velocity_count: int) -> bool:
        """Return whether a message names wheels of ours without a value, and complain of them."""
        is_missing = False
        for index in range(value_count, len(names)):
            if names[index] in self._wheels:
                is_missing = True
                self._happened.add('without a value')
                if self.position_feedback and index < velocity_count:
                    self.complaint = (
                        'the wheels have velocities but no positions: set position_feedback to '
                        'false, or let the driver publish positions')
                else:
                    missing = 'position' if self.position_feedback else 'velocity'
                    self.complaint = f'{names[index]} has no {missing}'
        return is_missing


def _turn(wheel: _Wheel, value: float, turned: float, event: str = '') -> _Turn:
    return wheel, value, wheel.angle + wheel.direction * turned, event
