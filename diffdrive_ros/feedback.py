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
from dataclasses import dataclass, field
import math
from typing import NamedTuple

# Beyond it a double resolves an angle [rad] no finer than a tenth of a milliradian: no encoder.
LARGEST = 1e12

# Stamps that are older than the last by less than this are out of order; by more, a new time.
JUMP_BACK_NS = 1_000_000_000

# A velocity says nothing about what a wheel did longer ago.
VELOCITY_HOLDS_NS = 1_000_000_000


@dataclass(frozen=True)
class WheelSample:
    """The mean angle of the wheels of each side [rad], at the stamp of the newest [ns]."""

    left: float
    right: float
    stamp_ns: int
    restarted_ns: int | None = None
    """When time has started again: the stamp [ns] in the new time of the last sample's angles."""


@dataclass
class _Wheel:
    name: str
    direction: int
    value: float = 0.0
    """The last position that was believed [rad], as the joint gives it."""
    stamp_ns: int = 0
    """When that was."""
    angle: float = 0.0
    """How far the wheel has turned forward [rad], continuous from its first value on."""
    is_known: bool = False
    is_renewed: bool = False
    held: tuple[float, int] | None = None
    """A position that cannot be, and its stamp, until the next tells what it was."""
    held_past: tuple[float, int] | None = None
    """A position from the past, and its stamp, until the next tells whether time restarted."""


class _Turn(NamedTuple):
    """What one value says of a wheel: how far it turned [rad], and what was special about it."""

    wheel: _Wheel
    value: float
    turned: float
    event: str = ''


@dataclass
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
    position_feedback: bool = True
    left_direction: int = 1
    right_direction: int = 1
    encoder_wrap: float | None = None
    max_plausible_speed: float | None = None
    complaint: str = field(default='', init=False)
    """What was wrong with the last message of ours, for a person to read; '' if nothing was."""
    counts: Counter[str] = field(default_factory=Counter, init=False)
    """How often what happened, by the words in which diagnostics say it."""

    def __post_init__(self) -> None:
        self._left = [_Wheel(name, self.left_direction) for name in self.left_names]
        self._right = [_Wheel(name, self.right_direction) for name in self.right_names]
        self._wheels = {wheel.name: wheel for wheel in (*self._left, *self._right)}
        self._restarted_ns: int | None = None

    @property
    def waits_for(self) -> list[str]:
        """Return the wheels without which the next sample is not complete."""
        return [wheel.name for wheel in self._wheels.values() if not wheel.is_renewed]

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
        values = positions if self.position_feedback else velocities
        turns: list[_Turn | None] = []
        for index, name in enumerate(names):
            wheel = self._wheels.get(name)
            if wheel is None:
                continue
            if not turns:
                self.complaint = ''
            if index >= len(values):
                self._complain_of_missing(name, has_velocity=index < len(velocities))
                turns.append(None)
            elif not abs(values[index]) < LARGEST:
                self._count('not finite')
                self.complaint = f'{name} = {values[index]}: must be finite and below {LARGEST:g}'
                turns.append(None)
            else:
                turns.append(self._turn_to(wheel, float(values[index]), stamp_ns))
        if not turns:
            self._count('without our wheels')
        believed = [turn for turn in turns if turn]
        if len(believed) < len(turns):
            return None
        for turn in {turn.wheel.name: turn for turn in believed}.values():  # a name may come twice
            self._believe(turn, stamp_ns)
        if not all(wheel.is_renewed for wheel in self._wheels.values()):
            return None
        return self._sample()

    def _sample(self) -> WheelSample:
        self._count('samples')
        for wheel in self._wheels.values():
            wheel.is_renewed = False
        newest_ns = max(wheel.stamp_ns for wheel in self._wheels.values())
        restarted_ns, self._restarted_ns = self._restarted_ns, None
        return WheelSample(
            _mean_angle(self._left), _mean_angle(self._right), newest_ns, restarted_ns)

    def _turn_to(self, wheel: _Wheel, value: float, stamp_ns: int) -> _Turn | None:
        """Return what a finite value says of a wheel, None if it cannot be believed."""
        if wheel.is_known and not self._is_newer(wheel, value, stamp_ns):
            return None
        if not self.position_feedback:
            return self._turn_at(wheel, value, stamp_ns)
        if not wheel.is_known:
            return _Turn(wheel, value, value)
        return self._plausible_turn(wheel, value, stamp_ns)

    def _is_newer(self, wheel: _Wheel, value: float, stamp_ns: int) -> bool:
        """Return whether a stamp follows the wheel's last one; let time restart if it has."""
        if stamp_ns > wheel.stamp_ns:
            if wheel.held_past:
                self._count('stragglers')
                wheel.held_past = None
            return True
        if wheel.stamp_ns - stamp_ns < JUMP_BACK_NS:
            self._count('not newer')
            return False
        if wheel.held_past is None or stamp_ns <= wheel.held_past[1]:
            wheel.held_past = (value, stamp_ns)
            return False
        self._restart(wheel, *wheel.held_past)
        return True

    def _restart(self, wheel: _Wheel, value: float, stamp_ns: int) -> None:
        """Let time start again with a wheel's value and stamp; its angle stays."""
        self._count('restarts of time')
        wheel.value, wheel.stamp_ns, wheel.held, wheel.held_past = value, stamp_ns, None, None
        if self._restarted_ns is None or stamp_ns < self._restarted_ns:
            self._restarted_ns = stamp_ns
        for other in self._wheels.values():
            if other.stamp_ns - stamp_ns >= JUMP_BACK_NS:
                other.is_renewed = False  # by what was heard of it in the old time

    def _plausible_turn(self, wheel: _Wheel, value: float, stamp_ns: int) -> _Turn | None:
        turned = self._turned(wheel.value, value)
        if self._is_plausible(turned, stamp_ns - wheel.stamp_ns):
            if wheel.held:
                return _Turn(wheel, value, turned, 'glitches')
            is_wrap = abs(value - wheel.value) > 1.5 * abs(turned)
            return _Turn(wheel, value, turned, 'wraps' if is_wrap else '')
        if wheel.held:
            turned = self._turned(wheel.held[0], value)
            if self._is_plausible(turned, stamp_ns - wheel.held[1]):
                return _Turn(wheel, value, turned, 'counter resets')
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
            self._count('glitches')
            self.complaint = f'{wheel.name} at {speed:g} rad/s: above max_plausible_wheel_speed'
            return None
        elapsed_ns = stamp_ns - wheel.stamp_ns
        if not wheel.is_known:
            return _Turn(wheel, 0.0, 0.0)
        if elapsed_ns > VELOCITY_HOLDS_NS:
            self.complaint = (f'{wheel.name} had no velocity for {elapsed_ns * 1e-9:g} s: what it '
                              'did meanwhile is lost')
            return _Turn(wheel, 0.0, 0.0, 'gaps')
        return _Turn(wheel, 0.0, speed * elapsed_ns * 1e-9)

    def _believe(self, turn: _Turn, stamp_ns: int) -> None:
        wheel = turn.wheel
        if turn.event:
            self._count(turn.event)
        wheel.angle += wheel.direction * turn.turned
        wheel.value, wheel.stamp_ns, wheel.held = turn.value, stamp_ns, None
        wheel.is_known = wheel.is_renewed = True

    def _complain_of_missing(self, name: str, has_velocity: bool) -> None:
        self._count('without a value')
        if self.position_feedback and has_velocity:
            self.complaint = (
                'the wheels have velocities but no positions: set position_feedback to false, or '
                'let the driver publish positions')
        else:
            missing = 'position' if self.position_feedback else 'velocity'
            self.complaint = f'{name} has no {missing}'

    def _count(self, what: str) -> None:
        self.counts[what] += 1


def _mean_angle(wheels: Sequence[_Wheel]) -> float:
    return sum(wheel.angle for wheel in wheels) / len(wheels)
