"""
The way out: from the body twist asked for to the wheel speeds sent, at every moment a safe one.

Time is that of a steady clock, in ns. What is asked holds until the timeout; silence, and a
command that is not finite, bring the target to zero.
"""
from dataclasses import dataclass
import math

from diffdrive_ros.kinematics import desaturate, DiffDrive
import numpy as np


@dataclass(frozen=True)
class WheelCommand:
    """Wheel speeds [rad/s] and the body twist [m/s, rad/s] that they amount to."""

    left: float
    right: float
    linear: float
    angular: float


STOP = WheelCommand(0.0, 0.0, 0.0, 0.0)


@dataclass
class CommandPath:
    """
    The last command and what becomes of it.

    A timeout [s] of 0 is none; max_wheel_speed [rad/s] of None is no limit. The settings may
    be changed between two calls.
    """

    drive: DiffDrive
    timeout: float
    max_wheel_speed: float | None = None

    def __post_init__(self) -> None:
        self._linear = self._angular = 0.0
        self._received_ns: int | None = None
        self._complaint = ''

    @property
    def started(self) -> bool:
        """Whether a command has ever come."""
        return self._received_ns is not None

    @property
    def complaint(self) -> str:
        """Why the wheels were stopped, for a person to read; '' when they were not."""
        return self._complaint

    def accept(self, linear: float, angular: float, now_ns: int) -> None:
        """Take a command, the forward speed [m/s] and turn rate [rad/s] of the body."""
        self._received_ns = now_ns
        if self._is_drivable(linear, angular):
            self._linear, self._angular, self._complaint = linear, angular, ''
        else:
            self._stop(f'command ({linear} m/s, {angular} rad/s): must be finite')

    def step(self, now_ns: int) -> WheelCommand:
        """Return what to send to the wheels at this moment."""
        if self._received_ns is None:
            return STOP
        moving = self._linear or self._angular
        if moving and self.timeout and now_ns - self._received_ns > self.timeout * 1e9:
            self._stop(f'no command for {self.timeout:g} s')
        left, right = self.drive.wheel_speeds(self._linear, self._angular)
        if self.max_wheel_speed is not None:
            left, right = desaturate(left, right, self.max_wheel_speed)
        linear, angular = self.drive.body_twist(left, right)
        return WheelCommand(float(left), float(right), float(linear), float(angular))

    def _is_drivable(self, linear: float, angular: float) -> bool:
        if not (math.isfinite(linear) and math.isfinite(angular)):
            return False
        # Finite, but so large that a wheel's speed overflows: as good as infinite.
        with np.errstate(over='ignore', invalid='ignore'):
            speeds = self.drive.wheel_speeds(linear, angular)
            return bool(
                np.isfinite(speeds).all() and np.isfinite(self.drive.body_twist(*speeds)).all())

    def _stop(self, complaint: str) -> None:
        self._linear = self._angular = 0.0
        self._complaint = complaint
