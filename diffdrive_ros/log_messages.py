"""
What a log says, read from the bytes of its messages (CDR, as ROS 2 writes them).

Only what is needed is read: wheels from JointState, poses from Odometry, PoseStamped,
PoseWithCovarianceStamped and TFMessage. Full deserialisers take several times as long.
"""
from collections.abc import Sequence
import math
import struct
from typing import NamedTuple

NANOSECONDS = 1_000_000_000


class MessageError(ValueError):
    """Bytes that are no message of the type."""


class Joints(NamedTuple):
    """A JointState without its efforts."""

    stamp_ns: int
    names: Sequence[str]
    positions: Sequence[float]
    velocities: Sequence[float]


class SeenPose(NamedTuple):
    """A pose in the plane: x, y [m], theta [rad]; child is '' where the type has none."""

    stamp_ns: int
    frame: str
    child: str
    pose: tuple[float, float, float]


class _Cursor:
    """Reads one message's bytes in order; alignment counts from behind the 4 bytes of the head."""

    def __init__(self, data: bytes) -> None:
        if len(data) < 4 or data[0] != 0 or data[1] not in (0, 1):
            raise MessageError('no plain CDR')
        self._data = data
        self.at = 4
        self._order = '<' if data[1] == 1 else '>'

    def numbers(self, kind: str, size: int, count: int = 1) -> tuple[float, ...]:
        """Return numbers of a kind of struct, of so many bytes each."""
        self.at += (4 - self.at) % size
        try:
            values = struct.unpack_from(f'{self._order}{count}{kind}', self._data, self.at)
        except struct.error:
            raise MessageError('ends too early') from None
        self.at += size * count
        return values

    def count(self) -> int:
        """Return the length of what follows."""
        return int(self.numbers('I', 4)[0])

    def text(self) -> str:
        """Return a string."""
        length = self.count()
        end = self.at + length
        if end > len(self._data):
            raise MessageError('ends too early')
        value = bytes(self._data[self.at:max(end - 1, self.at)])
        self.at = end
        return value.decode(errors='replace')

    def stamp_ns(self) -> int:
        """Return a time [ns]."""
        return int(self.numbers('i', 4)[0]) * NANOSECONDS + self.count()

    def doubles(self) -> tuple[float, ...]:
        """Return a sequence of doubles."""
        count = self.count()
        # An empty sequence is followed by no padding.
        return self.numbers('d', 8, count) if count else ()

    def pose(self) -> tuple[float, float, float]:
        """Return a Pose in the plane."""
        x, y, _, q_x, q_y, q_z, q_w = self.numbers('d', 8, 7)
        return x, y, _heading(q_x, q_y, q_z, q_w)


class JointReader:
    """Reads JointStates; names that come again are not read again."""

    def __init__(self) -> None:
        self._head, self._names, self._end = b'-', [''], 0
        self.seen: set[str] = set()
        """Every name that was read."""

    def read(self, data: bytes) -> Joints:
        """Return the joints of a message; raises MessageError."""
        cursor = _Cursor(data)
        stamp_ns = cursor.stamp_ns()
        start = cursor.at
        if data[start:self._end] == self._head:
            cursor.at = self._end
        else:
            cursor.text()
            self._names = [cursor.text() for _ in range(cursor.count())]
            self._head, self._end = bytes(data[start:cursor.at]), cursor.at
            self.seen.update(self._names)
        return Joints(stamp_ns, self._names, cursor.doubles(), cursor.doubles())


def read_odometry(data: bytes) -> list[SeenPose]:
    """Return the pose of an Odometry; raises MessageError."""
    cursor = _Cursor(data)
    stamp_ns, frame, child = cursor.stamp_ns(), cursor.text(), cursor.text()
    return [SeenPose(stamp_ns, frame, child, cursor.pose())]


def read_pose_stamped(data: bytes) -> list[SeenPose]:
    """Return the pose of a PoseStamped or PoseWithCovarianceStamped; raises MessageError."""
    cursor = _Cursor(data)
    stamp_ns, frame = cursor.stamp_ns(), cursor.text()
    return [SeenPose(stamp_ns, frame, '', cursor.pose())]


def read_transforms(data: bytes) -> list[SeenPose]:
    """Return the transforms of a TFMessage as poses; raises MessageError."""
    cursor = _Cursor(data)
    poses = []
    for _ in range(cursor.count()):
        stamp_ns, frame, child = cursor.stamp_ns(), cursor.text(), cursor.text()
        poses.append(SeenPose(stamp_ns, frame, child, cursor.pose()))
    return poses


JOINTS = 'sensor_msgs/msg/JointState'
POSES = {
    'nav_msgs/msg/Odometry': read_odometry,
    'geometry_msgs/msg/PoseStamped': read_pose_stamped,
    'geometry_msgs/msg/PoseWithCovarianceStamped': read_pose_stamped,
    'tf2_msgs/msg/TFMessage': read_transforms,
}


def _heading(x: float, y: float, z: float, w: float) -> float:
    """Return the yaw of a quaternion, of any norm but zero; nan for none."""
    if not 0.0 < x * x + y * y + z * z + w * w < math.inf:
        return math.nan
    return math.atan2(2.0 * (w * z + x * y), w * w + x * x - y * y - z * z)
