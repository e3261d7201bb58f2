"""Sensitivity of an odometry's pose to its geometry."""
import numpy as np


def geometry_sensitivity(odometry):
    """
    Return the derivative of the pose by the geometry since the last reset, (3, 3).

    Rows: x, y, theta. Columns: wheel_separation, left_wheel_radius, right_wheel_radius [m].
    """
    return np.reshape(odometry._sensitivity, (3, 3)).T
