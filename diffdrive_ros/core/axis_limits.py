"""
Limits of velocity, acceleration and jerk of one body axis.

Parameters and rules are those of diff_drive_controller, by control_toolbox's RateLimiter; step()
lists the differences. Units are m and s for the linear axis, rad and s for the angular one;
forward is the positive direction. Without a limit, the limit is infinite.
"""
from dataclasses import dataclass, fields
import math
import sys
from typing import NamedTuple

from diffdrive_ros.core.validation import finite_number, real_number

# The maximum that switches a family of limits off if it is nan, and the rest of the family.
_FAMILIES = {
    'max_velocity': ('min_velocity',),
    'max_acceleration': (
        'max_deceleration', 'max_acceleration_reverse', 'max_deceleration_reverse'),
    'max_jerk': ('min_jerk',),
}
_NOT_POSITIVE = 'min_velocity', 'max_deceleration', 'max_acceleration_reverse', 'min_jerk'


class _Rates(NamedTuple):
    """Limits of acceleration and deceleration in one direction, without signs."""

    acceleration: float
    deceleration: float


@dataclass(frozen=True)
class AxisLimits:
    """
    Limits of velocity, acceleration and jerk of one axis; nan is a limit that is not set.

    A maximum of nan switches its family off: max_velocity the velocities, max_acceleration all
    accelerations and decelerations, max_jerk the jerks. If the maximum is set,

    - min_velocity, max_acceleration_reverse and min_jerk are minus the maximum unless set;
    - max_deceleration, of forward motion, is max_acceleration_reverse unless set;
    - max_deceleration_reverse, of reverse motion, is max_acceleration unless set.

    0.0 is a limit: with a max_acceleration of 0.0 the robot never moves. An infinite limit is no
    limit. Raises ValueError unless min_velocity, max_deceleration, max_acceleration_reverse and
    min_jerk are zero or less, and the others zero or more.
    """

    max_velocity: float = math.nan
    min_velocity: float = math.nan
    max_acceleration: float = math.nan
    max_deceleration: float = math.nan
    max_acceleration_reverse: float = math.nan
    max_deceleration_reverse: float = math.nan
    max_jerk: float = math.nan
    min_jerk: float = math.nan

    def __post_init__(self) -> None:
        for name in (field.name for field in fields(self)):
            value, sign, side = getattr(self, name), 1.0, 'more'
            if name in _NOT_POSITIVE:
                sign, side = -1.0, 'less'
            number = real_number(value)
            if number is None or sign * number < 0.0:
                raise ValueError(f'{name} = {value!r}: must be zero or {side}, or nan (not set)')
            object.__setattr__(self, name, number)

    @property
    def without_effect(self) -> tuple[str, ...]:
        """Limits that are set without effect, because their maximum is not set."""
        return tuple(
            name for maximum, others in _FAMILIES.items() if math.isnan(getattr(self, maximum))
            for name in others if not math.isnan(getattr(self, name)))

    def step(
        self, target: float, last: float, before_last: float, dt: float,
        dt_before: float | None = None,
    ) -> float:
        """
        Return the speed to apply now; last was dt ago, before_last dt_before (or dt) before that.

        The jerk is limited first, if it is towards the target; then the acceleration, forward or
        reverse by the sign of last; then the velocity. Differences to diff_drive_controller:

        - A target of zero, or one that the velocity limits make zero, is a stop. Jerk limits have
          no effect then, nor has a deceleration limit of 0.0, with which no robot could stop.
        - A speed beyond lowered velocity limits decelerates by the deceleration limit, unless that
          is 0.0, and does not jump. Jerk limits have no effect.
        - In a period of reversal the speed decelerates to zero, and accelerates in the new
          direction for the rest of the period, each by its own limit.
        - The momentum that jerk limits preserve never accelerates a robot whose target is slower,
          and never carries the speed past zero, away from the target.

        So the speed never overshoots the target and approaches zero monotonically. With jerk
        limits, a robot that decelerates may continue to, although its target is faster. With a dt
        of zero or less the speed stays at last. Raises ValueError for values that are not finite.
        """
        target, last = finite_number('target', target), finite_number('last', last)
        before_last, dt = finite_number('before_last', before_last), finite_number('dt', dt)
        dt_before = finite_number('dt_before', dt if dt_before is None else dt_before)
        if dt <= 0.0:
            return last
        low, high = self._velocities
        target = min(max(target, low), high)
        forward, reverse = self._rates
        if target and low <= last <= high:
            change = last - before_last
            if dt_before > 0.0:
                change *= dt / dt_before
            now = self._ramp(self._smooth(target, last, change, dt), last, dt)
        elif (forward if last > 0.0 else reverse).deceleration:
            now = self._ramp(target, last, dt)
        else:
            now = min(max(last, low), high) if target else 0.0
        return now + 0.0  # no negative zero

    @property
    def _velocities(self) -> tuple[float, float]:
        """Lowest and highest velocity, both finite, so that the applied speed is too."""
        fastest = sys.float_info.max
        high = _set_or(self.max_velocity, fastest)
        low = -high if math.isnan(self.max_velocity) else _set_or(self.min_velocity, -high)
        return max(low, -fastest), min(high, fastest)

    @property
    def _rates(self) -> tuple[_Rates, _Rates]:
        """Rates of forward and of reverse motion."""
        ahead = self.max_acceleration
        if math.isnan(ahead):
            return _Rates(math.inf, math.inf), _Rates(math.inf, math.inf)
        back = _set_or(self.max_acceleration_reverse, -ahead)
        return (_Rates(ahead, -_set_or(self.max_deceleration, back)),
                _Rates(-back, _set_or(self.max_deceleration_reverse, ahead)))

    @property
    def _jerks(self) -> tuple[float, float]:
        """Lowest and highest jerk."""
        high = self.max_jerk
        if math.isnan(high):
            return -math.inf, math.inf
        return _set_or(self.min_jerk, -high), high

    def _smooth(self, target: float, last: float, change: float, dt: float) -> float:
        """
        Return the speed closest to a nonzero target within the jerk limits.

        change is the change of the speed in dt at the current acceleration.
        """
        lowest, highest = (jerk * dt * dt for jerk in self._jerks)
        low, high = self._velocities
        coasting = last + change
        # The target is the first argument: min and max return it if the other is nan.
        if target > last:
            target = min(target, coasting + highest)
            low = max(low, 0.0 if last >= 0.0 else last)
        elif target < last:
            target = max(target, coasting + lowest)
            high = min(high, 0.0 if last <= 0.0 else last)
        return min(max(target, low), high)

    def _ramp(self, target: float, last: float, dt: float) -> float:
        """Return the speed closest to a target within the limits of acceleration."""
        forward, reverse = self._rates
        if last < 0.0 or (last == 0.0 and target < 0.0):
            return -_ramp_forward(-target, -last, dt, reverse, forward)
        return _ramp_forward(target, last, dt, forward, reverse)


def _ramp_forward(target: float, last: float, dt: float, here: _Rates, there: _Rates) -> float:
    """Return the next speed of motion in one direction, by the rates of both directions."""
    if target >= last:
        return min(target, last + here.acceleration * dt)
    slowed = last - here.deceleration * dt
    if slowed >= 0.0:
        return max(target, slowed)
    left = max(dt - last / here.deceleration, 0.0)  # of the period after the speed is zero
    return max(target, -there.acceleration * left)


def _set_or(value: float, default: float) -> float:
    return default if math.isnan(value) else value
