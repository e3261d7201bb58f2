"""Convert a PoseWithCovarianceStamped to a pose and a covariance of the core."""
import math
from typing import Any

from diffdrive_ros.core.cdr import PLANAR
from diffdrive_ros.core.quaternion import heading_of_quaternion
from diffdrive_ros.core.validation import Array
import numpy as np

MAX_POSITION_M = 1e9  # above, rounding would lose the motion of a wheel


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
    if not (abs(x) < MAX_POSITION_M and abs(y) < MAX_POSITION_M):
        raise ValueError(
            f'position = ({x}, {y}): must be finite and below {MAX_POSITION_M:g} m')
    covariance = np.reshape(message.pose.covariance, (6, 6))
    planar = covariance[np.ix_(PLANAR, PLANAR)]
    heading = heading_of_quaternion(q.x, q.y, q.z, q.w)
    return np.array([x, y, heading]), planar if planar.any() else None
