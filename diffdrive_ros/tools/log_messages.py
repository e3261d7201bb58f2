"""The poses of a log, out of bytes: full deserialisers take several times as long."""
from typing import NamedTuple

from diffdrive_ros.core.cdr import Scan
from diffdrive_ros.core.quaternion import heading_of_quaternion


class SeenPose(NamedTuple):
    """A pose in the plane: x, y [m], theta [rad]; child is '' where the type has none."""

    stamp_ns: int
    frame: str
    child: str
    pose: tuple[float, float, float]


def read_odometry(payload: bytes) -> list[SeenPose]:
    """Return the pose of an Odometry; raises WireError."""
    scan = Scan(payload)
    return [SeenPose(scan.stamp_ns(), scan.string(), scan.string(), _planar(scan))]


def read_pose_stamped(payload: bytes) -> list[SeenPose]:
    """Return the pose of a PoseStamped or PoseWithCovarianceStamped; raises WireError."""
    scan = Scan(payload)
    return [SeenPose(scan.stamp_ns(), scan.string(), '', _planar(scan))]


def read_transforms(payload: bytes) -> list[SeenPose]:
    """Return the transforms of a TFMessage as poses; raises WireError."""
    scan = Scan(payload)
    return [
        SeenPose(scan.stamp_ns(), scan.string(), scan.string(), _planar(scan))
        for _ in range(scan.count())]


JOINTS = 'sensor_msgs/msg/JointState'
POSES = {
    'nav_msgs/msg/Odometry': read_odometry,
    'geometry_msgs/msg/PoseStamped': read_pose_stamped,
    'geometry_msgs/msg/PoseWithCovarianceStamped': read_pose_stamped,
    'tf2_msgs/msg/TFMessage': read_transforms,
}


def _planar(scan: Scan) -> tuple[float, float, float]:
    """Return a Pose in the plane; nan for a heading of no rotation."""
    x, y, _, *rotation = scan.pose()
    return x, y, heading_of_quaternion(*rotation)
