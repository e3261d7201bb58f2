"""Quaternions of planar headings in plain floats, as in geometry_msgs: x, y, z, w."""
from math import atan2, cos, inf, nan, sin


def quaternion_of_heading(theta: float) -> tuple[float, float]:
    """Return z and w >= 0 of the unit quaternion of a heading [rad]; x and y are zero."""
    q_z, q_w = sin(0.5 * theta), cos(0.5 * theta)
    return (q_z, q_w) if q_w >= 0.0 else (-q_z, -q_w)


def heading_of_quaternion(q_x: float, q_y: float, q_z: float, q_w: float) -> float:
    """
    Return the yaw [rad], in [-pi, pi], of a quaternion of any norm.

    The result is nan where the norm is zero or not finite. Yaw as in REP 103: the last factor of
    R = Rz(yaw) Ry(pitch) Rx(roll).
    """
    if not 0.0 < q_x * q_x + q_y * q_y + q_z * q_z + q_w * q_w < inf:
        return nan
    return atan2(2.0 * (q_w * q_z + q_x * q_y), q_w * q_w + q_x * q_x - q_y * q_y - q_z * q_z)
