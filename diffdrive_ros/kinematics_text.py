"""The equations of the robot with today's numbers, for a person to read."""
from diffdrive_ros import se2
from diffdrive_ros.arguments import Array
from diffdrive_ros.kinematics import DiffDrive
import numpy as np
import numpy.typing as npt


def equations(drive: DiffDrive, pose: npt.ArrayLike, speeds: npt.ArrayLike) -> str:
    """Return pose, frames, Jacobians and twist of a pose and wheel speeds, as lines of text."""
    pose, speeds = np.asarray(pose, dtype=float), np.asarray(speeds, dtype=float)
    T_odom_wheels = se2.compose(pose, drive.wheel_frames)
    twist = drive.body_jacobian @ speeds
    x, y, theta = pose
    return '\n'.join((
        f'x = {x:.3f} m   y = {y:.3f} m',
        f'θ = {theta:.3f} rad = {np.degrees(theta):.1f}°',
        _matrix('T_odom_base', homogeneous(pose)), '',
        _frame('T_base_left ', drive.wheel_frames[0]),
        _frame('T_base_right', drive.wheel_frames[1]),
        _frame('T_odom_left ', T_odom_wheels[0]), _frame('T_odom_right', T_odom_wheels[1]), '',
        _matrix('H', drive.wheel_jacobian), _matrix('H⁺', drive.body_jacobian), '',
        f"φ' = H V_b  = ({speeds[0]:.2f}, {speeds[1]:.2f}) rad/s",
        f"V_b = H⁺ φ' = ({twist[0]:.3f}, {twist[1]:.0f}, {twist[2]:.3f}) m/s, rad/s"))


def homogeneous(pose: Array) -> Array:
    """Return the homogeneous matrix of a pose, (3, 3)."""
    matrix = np.eye(3)
    # Its columns are what the pose makes of the axes and of the origin.
    matrix[:2, :2] = se2.rotate(pose[2], np.eye(2)).T
    matrix[:2, 2] = pose[:2]
    return matrix


def _matrix(name: str, matrix: Array) -> str:
    rows = ('  '.join(f'{value + 0.0:8.4f}' for value in row) for row in matrix)
    return '\n'.join((f'{name} =', *(f'  [ {row} ]' for row in rows)))


def _frame(name: str, pose: Array) -> str:
    x, y, theta = pose + 0.0
    return f'{name} = ({x:.3f}, {y:.3f}, {theta:.3f})'
