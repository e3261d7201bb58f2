"""Poses and covariances of the core as messages, and back."""
from collections.abc import Sequence
import math
from typing import Any

from diffdrive_ros.arguments import Array
from diffdrive_ros.se2 import wrap_angle
from nav_msgs.msg import Odometry as OdometryMessage
import numpy as np

# The variance of what wheels do not measure: large, yet such that filters can still invert it.
UNKNOWN = 1e6

# Where x, y and yaw stand in the six rows and columns of a message's covariance.
PLANAR = (0, 1, 5)
NOT_PLANAR = (2, 3, 4)

Diagonal = Sequence[float] | None


class OdometryWriter:
    """One message, filled anew with each pose; diagonals stand in for the covariances."""

    def __init__(
        self, odom_frame: str, base_frame: str, pose_variances: Diagonal = None,
        twist_variances: Diagonal = None,
    ) -> None:
        self.message = OdometryMessage(child_frame_id=base_frame)
        self.message.header.frame_id = odom_frame
        self._covariances = []
        for part, variances in (
            (self.message.pose, pose_variances), (self.message.twist, twist_variances),
        ):
            if variances is None:
                self._covariances.append(part.covariance)
                variances = [UNKNOWN if axis in NOT_PLANAR else 0.0 for axis in range(6)]
            else:
                self._covariances.append(None)
                variances = [variance or UNKNOWN for variance in variances]
            for axis, variance in enumerate(variances):
                part.covariance[7 * axis] = variance

    def fill(self, stamp_ns: int, pose: Array, twist: Array, *covariances: Array) -> None:
        """Put in a pose and a twist, (3,), and their covariances, (3, 3), pose before twist."""
        message = self.message
        stamp = message.header.stamp
        stamp.sec, stamp.nanosec = divmod(stamp_ns, 1_000_000_000)
        position, orientation = message.pose.pose.position, message.pose.pose.orientation
        position.x, position.y, theta = pose.tolist()
        half = 0.5 * float(wrap_angle(theta))
        orientation.z, orientation.w = math.sin(half), math.cos(half)
        message.twist.twist.linear.x, _, message.twist.twist.angular.z = twist.tolist()
        for target, planar in zip(self._covariances, covariances, strict=True):
            if target is not None:
                _fill_planar(target, _capped(planar).tolist())


def read_pose(message: Any) -> tuple[Array, Array | None]:
    """
    Return pose, (3,), and covariance, (3, 3), of a PoseWithCovarianceStamped.

    A covariance of zeros is not set: None. Raises ValueError for a pose that is not finite, an
    orientation that is no rotation, or one that is not about the z axis.
    """
    pose, q = message.pose.pose, message.pose.pose.orientation
    norm = math.hypot(q.x, q.y, q.z, q.w)
    if not 0.99 < norm < 1.01:
        raise ValueError(f'orientation has the norm {norm}: must be 1')
    if math.hypot(q.x, q.y) > 0.01:
        raise ValueError(f'orientation = ({q.x}, {q.y}, {q.z}, {q.w}): must be about the z axis')
    x, y = pose.position.x, pose.position.y
    if not (math.isfinite(x) and math.isfinite(y)):
        raise ValueError(f'position = ({x}, {y}): must be finite')
    covariance = np.reshape(message.pose.covariance, (6, 6))
    planar = covariance[np.ix_(PLANAR, PLANAR)]
    return np.array([x, y, 2.0 * math.atan2(q.z, q.w)]), planar if planar.any() else None


def _capped(covariance: Array) -> Array:
    """Return a covariance with no variance above UNKNOWN, scaled so that it stays one."""
    variances = np.diag(covariance)
    if variances.max() <= UNKNOWN:
        return covariance
    scale = np.sqrt(np.minimum(1.0, UNKNOWN / np.maximum(variances, UNKNOWN)))
    return covariance * scale * scale[:, np.newaxis]


def _fill_planar(covariance: Any, planar: list[list[float]]) -> None:
    for row, values in zip(PLANAR, planar, strict=True):
        for column, value in zip(PLANAR, values, strict=True):
            covariance[6 * row + column] = value
