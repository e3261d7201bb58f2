"""The equations of the kinematics with the numbers of the robot, as text."""
from diffdrive_ros.core import se2
from diffdrive_ros.core.kinematics import DiffDrive
from diffdrive_ros.core.validation import Array
import numpy as np
import numpy.typing as npt


def equations(drive: DiffDrive, pose: npt.ArrayLike, speeds: npt.ArrayLike) -> str:
    """Return pose, frames, Jacobians and twist of a pose and wheel speeds, as lines of text."""
    pose, speeds = np.asarray(pose, dtype=float), np.asarray(speeds, dtype=float)
    T_odom_wheels = se2.compose(pose, drive.wheel_frames)
    twist = drive.body_jacobian @ speeds
    x, y, theta = _rounded(pose, 3)
    left, right = _rounded(speeds, 2)
    forward, _, turn = _rounded(twist, 3)
    return '\n'.join((
        f'x = {x:.3f} m   y = {y:.3f} m',
        f'θ = {theta:.3f} rad = {_rounded(np.degrees(pose[2]), 1):.1f}°',
        _matrix('T_odom_base', homogeneous(pose)), '',
        _frame('T_base_left ', drive.wheel_frames[0]),
        _frame('T_base_right', drive.wheel_frames[1]),
        _frame('T_odom_left ', T_odom_wheels[0]), _frame('T_odom_right', T_odom_wheels[1]), '',
        _matrix('H', drive.wheel_jacobian), _matrix('H⁺', drive.body_jacobian), '',
        f"φ' = H V_b  = ({left:.2f}, {right:.2f}) rad/s",
        f"V_b = H⁺ φ' = ({forward:.3f}, 0, {turn:.3f}) m/s, rad/s"))


def homogeneous(pose: Array) -> Array:
    """Return the homogeneous matrix of a pose, (3, 3)."""
    matrix = np.eye(3)
    # Its columns are the transformed axes and origin.
    matrix[:2, :2] = se2.rotate(pose[2], np.eye(2)).T
    matrix[:2, 2] = pose[:2]
    return matrix


def _rounded(values: Array, digits: int) -> Array:
    """Return rounded values, none of them -0."""
    return np.round(values, digits) + 0.0


def _matrix(name: str, matrix: Array) -> str:
    rows = ('  '.join(f'{value:8.4f}' for value in row) for row in _rounded(matrix, 4))
    return '\n'.join((f'{name} =', *(f'  [ {row} ]' for row in rows)))


def _frame(name: str, pose: Array) -> str:
    x, y, theta = _rounded(pose, 3)
    return f'{name} = ({x:.3f}, {y:.3f}, {theta:.3f})'
