"""
Wheel commands: from the commanded body twist to wheel speeds, with timeout, inhibits and limits.

Times are in ns, of a monotonic clock. A command is the target until the timeout. The timeout, a
command that is not finite and an inhibit set the target to zero; the wheels stop within the
deceleration limits.
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


REASONS = {  # as text, for people
    Inhibit.DISABLED: 'disabled by ~/enable',
    Inhibit.FEEDBACK_TIMEOUT: 'no usable joint_states',
    Inhibit.CLOCK_STALL: '/clock stands still',
}


@dataclass(frozen=True)
class WheelCommand:
    """Speeds of the joints [rad/s] and their body twist [m/s, rad/s]."""

    left: float
    right: float
    linear: float
    angular: float


# After a longer pause the robot accelerates for no more than this.
MAX_PERIODS = 5.0

MIN_STEP_S = 1e-9

STOP = WheelCommand(0.0, 0.0, 0.0, 0.0)
NO_LIMITS = AxisLimits()


@dataclass
class WheelCommander:
    """
    The last command, its watchdog and its limits.

    A timeout [s] of 0 is none; max_wheel_speed [rad/s] of None is no limit; period [s] is the time
    from one step to the next; the directions are -1 for joints that turn backward when the robot
    drives forward. The settings may be changed between two calls. While there is one of the
    inhibits, which inhibit() changes, the wheels are kept at zero and commands are dropped.
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
    """The number of events by name; the names are keys of /diagnostics."""

    def __post_init__(self) -> None:
        self._linear = self._angular = 0.0
        self._received_ns: int | None = None
        self._stepped_ns: int | None = None
        self._seconds = self.period  # of the last step
        self._target_until_ns = -math.inf  # the target of the last step
        self._applied = self._applied_before = STOP
        self._stop_reason = ''

    @property
    def started(self) -> bool:
        """Return whether a command was ever accepted."""
        return self._received_ns is not None

    @property
    def stop_reason(self) -> str:
        """Return why the wheels are stopped, as text; '' if they are not."""
        return ', '.join(REASONS[each] for each in sorted(self.inhibits)) or self._stop_reason

    def inhibit(self, inhibit: Inhibit, is_active: bool) -> None:
        """Begin an inhibit, which discards the last command, or end it."""
        if is_active:
            self.inhibits.add(inhibit)
            self._linear = self._angular = 0.0
        else:
            self.inhibits.discard(inhibit)

    def accept(self, linear: float, angular: float, now_ns: int, late_ns: int = 0) -> None:
        """
        Process a command: forward speed [m/s] and turn rate [rad/s] of the body.

        late_ns is its latency, which counts for the timeout; negative if its stamp is in the
        future. A command later or earlier than the timeout is dropped, unless it is a stop.
        """
        self._count('commands')
        if not self._is_finite(linear, angular):
            self._received_ns = now_ns
            self._count('not_finite')
            self._stop(f'command ({linear} m/s, {angular} rad/s): must be finite')
        elif self.timeout and abs(late_ns) > self.timeout * 1e9 and (linear or angular):
            self._count('late')
            if not (self._linear or self._angular):
                self._stop_reason = (
                    f'commands are {abs(late_ns) * 1e-9:.1f} s '
                    f'{"late" if late_ns > 0 else "early"}: delay, or clock offset of the sender')
        elif self.inhibits:
            self._received_ns = now_ns
            self._count('inhibited')
            self._stop('')
        else:
            self._received_ns = now_ns - max(late_ns, 0)
            self._linear, self._angular, self._stop_reason = linear, angular, ''

    def step(self, now_ns: int) -> WheelCommand:
        """Return the current wheel command; limits apply to the time since the last step."""
        if (self._linear or self._angular) and self._is_timed_out(now_ns):
            self._count('timeouts')
            self._stop(f'no command for {self.timeout:g} s')
        seconds, self._stepped_ns = self._since_last_step(now_ns), now_ns
        longest = MAX_PERIODS * self.period
        if seconds > longest:
            self._decelerate(min(seconds - longest, (now_ns - self._target_until_ns) * 1e-9))
            seconds = longest
        self._target_until_ns = self._valid_until_ns(now_ns)
        last, before_last = self._applied, self._applied_before
        linear = self.linear_limits.step(
            self._linear, last.linear, before_last.linear, seconds, self._seconds)
        angular = self.angular_limits.step(
            self._angular, last.angular, before_last.angular, seconds, self._seconds)
        if (linear, angular) != (self._linear, self._angular):
            self._count('limited')
        self._applied = self._wheel_command(linear, angular)
        if seconds > MIN_STEP_S:
            self._applied_before, self._seconds = last, seconds
        return self._applied

    def reset_clock(self) -> None:
        """Continue with a new clock, and discard the last command."""
        self._stepped_ns = None
        self._stop('the clock was changed')

    def _since_last_step(self, now_ns: int) -> float:
        """Return the time [s] since the last step, which is never zero."""
        if self._stepped_ns is None:
            return self.period
        seconds = (now_ns - self._stepped_ns) * 1e-9
        if seconds > 0.0:
            return seconds
        # Simulation time stands still or was reset: speeds without limits still change, and an
        # inhibit for that still stops.
        return self.period if self.inhibits else MIN_STEP_S

    def _valid_until_ns(self, now_ns: int) -> float:
        """Return the time [ns] until which the target is valid without a new command."""
        if self._received_ns is None or not (self._linear or self._angular):
            return now_ns
        return self._received_ns + self.timeout * 1e9 if self.timeout else math.inf

    def _decelerate(self, seconds: float) -> None:
        """Decelerate for a time [s] in which the process was paused and the target was zero."""
        if seconds <= 0.0:
            return
        last = self._applied
        self._applied = self._applied_before = replace(
            last, linear=self.linear_limits.step(0.0, last.linear, last.linear, seconds),
            angular=self.angular_limits.step(0.0, last.angular, last.angular, seconds))

    def _wheel_command(self, linear: float, angular: float) -> WheelCommand:
        with np.errstate(over='ignore'):
            left, right = map(float, self.drive.wheel_speeds(linear, angular))
        if not (math.isfinite(left) and math.isfinite(right)):  # by a live change of the geometry
            self._stop(f'wheel speeds ({left}, {right} rad/s): must be finite')
            return STOP
        if self.max_wheel_speed is not None:
            unlimited = left, right
            left, right = map(float, desaturate(left, right, self.max_wheel_speed))
            if (left, right) != unlimited:
                self._count('saturated')
                linear, angular = map(float, self.drive.body_twist(left, right))
        return WheelCommand(  # plus 0.0: no negative zero
            self.left_direction * left + 0.0, self.right_direction * right + 0.0, linear, angular)

    def _is_timed_out(self, now_ns: int) -> bool:
        if self._received_ns is None or not self.timeout:
            return False
        age_ns = now_ns - self._received_ns
        return age_ns > self.timeout * 1e9 or age_ns < 0  # simulation time that was reset

    def _is_finite(self, linear: float, angular: float) -> bool:
        if not (math.isfinite(linear) and math.isfinite(angular)):
            return False
        # A finite twist whose wheel speeds overflow is as bad as an infinite one.
        with np.errstate(over='ignore'):
            speeds = self.drive.wheel_speeds(linear, angular)
            return bool(
                np.isfinite(speeds).all() and np.isfinite(self.drive.body_twist(*speeds)).all())

    def _stop(self, reason: str) -> None:
        self._linear = self._angular = 0.0
        self._stop_reason = reason

    def _count(self, event: str) -> None:
        self.counts[event] += 1
