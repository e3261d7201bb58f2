"""
The way in: from joint messages, as they really come, to the angles of the left and right side.

Joints are found by name, in any order, among any others. Several wheels a side are averaged.
Wheels may come in separate messages: a sample is complete when every wheel has been renewed.
"""
from collections.abc import Sequence
from dataclasses import dataclass, field

# Beyond it a double resolves an angle [rad] no finer than a tenth of a milliradian: no encoder.
LARGEST = 1e12


@dataclass(frozen=True)
class WheelSample:
    """The mean angle of the wheels of each side [rad], at the stamp of the newest [ns]."""

    left: float
    right: float
    stamp_ns: int


@dataclass
class _Wheel:
    name: str
    angle: float = 0.0
    stamp_ns: int = 0
    is_known: bool = False
    renewed: bool = False


@dataclass
class WheelFeedback:
    """
    The state of every wheel, renewed by each message that brings it.

    With position_feedback the angle is the joint's position [rad]; without, the joint's velocity
    [rad/s] is integrated, taken to have been constant since the wheel's last message.
    """

    left_names: Sequence[str]
    right_names: Sequence[str]
    position_feedback: bool = True
    complaint: str = field(default='', init=False)
    """What was wrong with the last message, for a person to read; '' when nothing was."""

    def __post_init__(self) -> None:
        self._left = [_Wheel(name) for name in self.left_names]
        self._right = [_Wheel(name) for name in self.right_names]
        self._wheels = {wheel.name: wheel for wheel in (*self._left, *self._right)}

    def update(
        self, names: Sequence[str], positions: Sequence[float], velocities: Sequence[float],
        stamp_ns: int,
    ) -> WheelSample | None:
        """
        Take one message; return the sample that it completes, or None.

        Messages without our wheels are passed over. A wheel without a value, or with one that is
        not finite or absurd, is not renewed: its last angle stays, and its next one carries the
        motion.
        """
        self.complaint = ''
        values = positions if self.position_feedback else velocities
        for index, name in enumerate(names):
            wheel = self._wheels.get(name)
            if wheel is None:
                continue
            if index >= len(values):
                self.complaint = self._missing(name, has_velocity=index < len(velocities))
            elif not abs(values[index]) < LARGEST:
                self.complaint = f'{name} = {values[index]}: must be finite and below {LARGEST:g}'
            else:
                self._renew(wheel, float(values[index]), stamp_ns)
        if not all(wheel.renewed for wheel in self._wheels.values()):
            return None
        for wheel in self._wheels.values():
            wheel.renewed = False
        newest_ns = max(wheel.stamp_ns for wheel in self._wheels.values())
        return WheelSample(_mean_angle(self._left), _mean_angle(self._right), newest_ns)

    def _renew(self, wheel: _Wheel, value: float, stamp_ns: int) -> None:
        if self.position_feedback:
            wheel.angle = value
        elif wheel.is_known:
            if stamp_ns <= wheel.stamp_ns:
                return
            wheel.angle += value * (stamp_ns - wheel.stamp_ns) * 1e-9
        wheel.stamp_ns = stamp_ns
        wheel.is_known = wheel.renewed = True

    def _missing(self, name: str, has_velocity: bool) -> str:
        if self.position_feedback and has_velocity:
            return (f'{name} has a velocity but no position: set position_feedback to false, '
                    'or let the driver publish positions')
        return f'{name} has no {"position" if self.position_feedback else "velocity"}'


def _mean_angle(wheels: Sequence[_Wheel]) -> float:
    return sum(wheel.angle for wheel in wheels) / len(wheels)
