"""Differential-drive kinematics, odometry and command node for ROS 2."""
from diffdrive_ros.core import se2
from diffdrive_ros.core.kinematics import desaturate, DiffDrive
from diffdrive_ros.core.odometry import (
    GeometryUncertainty,
    integrate,
    integrate_chunks,
    integrate_speeds,
    Odometry,
    WheelNoise,
)

__all__ = [
    'DiffDrive',
    'GeometryUncertainty',
    'Odometry',
    'WheelNoise',
    'desaturate',
    'integrate',
    'integrate_chunks',
    'integrate_speeds',
    'se2',
]
