"""
The way out: from the body twist asked for to the wheel speeds sent, at every moment a safe one.

Time is that of a clock that does not go back, in ns. What is asked holds until the timeout;
silence, a command that is not finite and a hold bring the target to zero, and the deceleration
limits alone say how fast the robot gets there.
"""
from collections import Counter
from dataclasses import dataclass, field, KW_ONLY, replace
from enum import Enum
import math

from diffdrive_ros.core.axis_limits import AxisLimits
from diffdrive_ros.core.kinematics import desaturate, DiffDrive
import numpy as np


class Inhibit(str, Enum):
    """What keeps the wheels at zero, by the words of /diagnostics."""

    DISABLED = 'disabled'
    FEEDBACK_TIMEOUT = 'feedback_timeout'
    CLOCK_STALL = 'clock_stall'


REASONS = {  # for a person to read
    Inhibit.DISABLED: 'disabled by ~/enable',
    Inhibit.FEEDBACK_TIMEOUT: 'no usable joint_states',
    Inhibit.CLOCK_STALL: '/clock stands still',
}


@dataclass(frozen=True)
class WheelCommand:
    """Speeds of the joints [rad/s] and the body twist [m/s, rad/s] that they amount to."""

    left: float
    right: float
    linear: float
    angular: float


# Of a longer time without a step, no more counts for speeding up.
MOST_PERIODS = 5.0

A_MOMENT = 1e-9  # [s]

STOP = WheelCommand(0.0, 0.0, 0.0, 0.0)
NO_LIMITS = AxisLimits()


@dataclass
class WheelCommander:
    """
    The last command and what becomes of it.

    A timeout [s] of 0 is none; max_wheel_speed [rad/s] of None is no limit; period [s] is the time
    from one step to the next; the directions are -1 for joints that turn backward when the robot
    drives forward. The settings may be changed between two calls. While there is one of the
    inhibits, which inhibit() changes, the wheels are kept at zero and commands are not taken.
    """

    drive: DiffDrive
    _: KW_ONLY
    timeout: float
    max_wheel_speed: float | None = None
    linear_limits: AxisLimits = NO_LIMITS
    angular_limits: AxisLimits = NO_LIMITS
    period: float = 0.02
    left_direction: int = 1
    right_direction: int = 1
    inhibits: set[Inhibit] = field(default_factory=set, init=False)
    counts: Counter[str] = field(default_factory=Counter, init=False)
    """How often what happened, by the words in which diagnostics say it."""

    def __post_init__(self) -> None:
        self._linear = self._angular = 0.0
        self._received_ns: int | None = None
        self._stepped_ns: int | None = None
        self._seconds = self.period  # of the last step
        self._held_until_ns = -math.inf  # the target of the last step
        self._applied = self._applied_before = STOP
        self._complaint = ''

    @property
    def started(self) -> bool:
        """Return whether a command has ever come."""
        return self._received_ns is not None

    @property
    def complaint(self) -> str:
        """Return why the wheels are stopped, for a person to read; '' when they are not."""
        return ', '.join(REASONS[each] for each in sorted(self.inhibits)) or self._complaint

    def inhibit(self, inhibit: Inhibit, is_active: bool) -> None:
        """Keep the wheels at zero, which forgets the last command, or end that."""
        if is_active:
            self.inhibits.add(inhibit)
            self._linear = self._angular = 0.0
        else:
            self.inhibits.discard(inhibit)

    def accept(self, linear: float, angular: float, now_ns: int, late_ns: int = 0) -> None:
        """
        Take a command, the forward speed [m/s] and turn rate [rad/s] of the body.

        late_ns [ns] is how late it comes, and how much sooner it is too old; less than nothing
        where it seems to be from the future. What is too old already, or of as far a future,
        changes nothing, but it may stop.
        """
        self._count('commands')
        if not self._is_drivable(linear, angular):
            self._received_ns = now_ns
            self._count('not_finite')
            self._stop(f'command ({linear} m/s, {angular} rad/s): must be finite')
        elif self.timeout and abs(late_ns) > self.timeout * 1e9 and (linear or angular):
            self._count('late')
            if not (self._linear or self._angular):
                self._complaint = (f'commands come {abs(late_ns) * 1e-9:.1f} s '
                                   f'{"late" if late_ns > 0 else "early"}, or by another clock')
        elif self.inhibits:
            self._received_ns = now_ns
            self._count('inhibited')
            self._stop('')
        else:
            self._received_ns = now_ns - max(late_ns, 0)
            self._linear, self._angular, self._complaint = linear, angular, ''

    def step(self, now_ns: int) -> WheelCommand:
        """Return what to send to the wheels now; the limits count the time since the last step."""
        if (self._linear or self._angular) and self._is_too_old(now_ns):
            self._count('timeouts')
            self._stop(f'no command for {self.timeout:g} s')
        seconds, self._stepped_ns = self._since_last_step(now_ns), now_ns
        most = MOST_PERIODS * self.period
        if seconds > most:
            self._slow_down(min(seconds - most, (now_ns - self._held_until_ns) * 1e-9))
            seconds = most
        self._held_until_ns = self._valid_until_ns(now_ns)
        last, before_last = self._applied, self._applied_before
        linear = self.linear_limits.step(
            self._linear, last.linear, before_last.linear, seconds, self._seconds)
        angular = self.angular_limits.step(
            self._angular, last.angular, before_last.angular, seconds, self._seconds)
        if (linear, angular) != (self._linear, self._angular):
            self._count('limited')
        self._applied = self._for_wheels(linear, angular)
        if seconds > A_MOMENT:
            self._applied_before, self._seconds = last, seconds
        return self._applied

    def forget_time(self) -> None:
        """Let the time be that of another clock from now on; a command from before it is over."""
        self._stepped_ns = None
        self._stop('the clock was changed')

    def _since_last_step(self, now_ns: int) -> float:
        """Return the time [s] since the last step, which is never nothing."""
        if self._stepped_ns is None:
            return self.period
        seconds = (now_ns - self._stepped_ns) * 1e-9
        if seconds > 0.0:
            return seconds
        # Simulation time stands still or starts again: what is not limited changes all the same,
        # and what has to stop for that stops.
        return self.period if self.inhibits else A_MOMENT

    def _valid_until_ns(self, now_ns: int) -> float:
        """Return until when the target holds, if no other is asked for."""
        if self._received_ns is None or not (self._linear or self._angular):
            return now_ns
        return self._received_ns + self.timeout * 1e9 if self.timeout else math.inf

    def _slow_down(self, seconds: float) -> None:
        """Let a time count in which the process stood still and nothing was asked for."""
        if seconds <= 0.0:
            return
        last = self._applied
        self._applied = self._applied_before = replace(
            last, linear=self.linear_limits.step(0.0, last.linear, last.linear, seconds),
            angular=self.angular_limits.step(0.0, last.angular, last.angular, seconds))

    def _for_wheels(self, linear: float, angular: float) -> WheelCommand:
        with np.errstate(over='ignore'):
            left, right = map(float, self.drive.wheel_speeds(linear, angular))
        if not (math.isfinite(left) and math.isfinite(right)):  # by a geometry set meanwhile
            self._stop(f'wheel speeds ({left}, {right} rad/s): must be finite')
            return STOP
        if self.max_wheel_speed is not None:
            asked = left, right
            left, right = map(float, desaturate(left, right, self.max_wheel_speed))
            if (left, right) != asked:
                self._count('saturated')
                linear, angular = map(float, self.drive.body_twist(left, right))
        return WheelCommand(  # plus 0.0: no zero has a sign
            self.left_direction * left + 0.0, self.right_direction * right + 0.0, linear, angular)

    def _is_too_old(self, now_ns: int) -> bool:
        if self._received_ns is None or not self.timeout:
            return False
        age_ns = now_ns - self._received_ns
        return age_ns > self.timeout * 1e9 or age_ns < 0  # simulation time that started again

    def _is_drivable(self, linear: float, angular: float) -> bool:
        if not (math.isfinite(linear) and math.isfinite(angular)):
            return False
        # Finite, but so large that a wheel's speed overflows: as good as infinite.
        with np.errstate(over='ignore'):
            speeds = self.drive.wheel_speeds(linear, angular)
            return bool(
                np.isfinite(speeds).all() and np.isfinite(self.drive.body_twist(*speeds)).all())

    def _stop(self, complaint: str) -> None:
        self._linear = self._angular = 0.0
        self._complaint = complaint

    def _count(self, what: str) -> None:
        self.counts[what] += 1
