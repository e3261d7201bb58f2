"""
Linearize a whole run: its poses, and their derivatives by every source of error.

What Odometry propagates sample by sample (doc/kinematics.md, section 9) is here a cumulative sum.
Let T = [[1, 0, -y], [0, 1, x], [0, 0, 1]] and the error of a pose be T eta: eta is that error seen
from the origin of the world. Later motion does not change it, since the F of a step is the T after
it times the inverse of the T before. So errors seen from the origin add up.
"""
from dataclasses import dataclass

from diffdrive_ros.core import se2
from diffdrive_ros.core.kinematics import DiffDrive
from diffdrive_ros.core.odometry import integrate, ORIGIN
from diffdrive_ros.core.validation import Array
import numpy as np
import numpy.typing as npt

Chosen = list[int] | npt.NDArray[np.int64] | slice


@dataclass(frozen=True)
class Linearization:
    """
    N poses of a run, (N, 3), and their dependence on the sources of error.

    by_geometry, (N, 3, 3): derivatives by wheel_separation, left_wheel_radius and
    right_wheel_radius, in columns. by_start, (N, 3, 3): by the start pose. seen_from, (N, 3, 3):
    T, which maps errors seen from the world's origin to errors of the pose. noise,
    (3, N, 3, 3): covariances seen from the origin, for one unit of each parameter of WheelNoise.
    """

    poses: Array
    by_geometry: Array
    by_start: Array
    seen_from: Array
    noise: Array
    by_steps: Array
    """Derivatives of all steps, seen from the origin: by left travel, right travel and turn."""
    variances: Array
    """Of all steps, for one unit of each parameter of WheelNoise, (M - 1, 3)."""


def linearize(
    drive: DiffDrive, left: npt.ArrayLike, right: npt.ArrayLike, start: npt.ArrayLike = ORIGIN,
    chosen: Chosen = slice(None),
) -> Linearization:
    """
    Return the linearization of wheel angles [rad], (M,), at the chosen indices.

    Raises ValueError as odometry.integrate does.
    """
    poses = integrate(drive, left, right, start)
    d_left, d_right = np.diff(np.asarray(left)), np.diff(np.asarray(right))
    separation = drive.wheel_separation
    distance, turn = drive.body_twist(d_left, d_right)
    half, heading = 0.5 * turn, poses[:-1, 2] + 0.5 * turn
    shrink, (dx, dy) = se2.chord_over_arc(half), np.diff(poses[:, :2], axis=0).T
    cos, sin = np.cos(heading), np.sin(heading)
    # u_D and u_omega of doc/kinematics.md, section 9, (M - 1, 3).
    bend = 0.5 * distance * se2.chord_over_arc_rate(half)
    one, zero = np.ones_like(turn), np.zeros_like(turn)
    by_turn = np.stack([bend * cos - 0.5 * dy, bend * sin + 0.5 * dx, one], axis=-1)
    by_distance = np.stack([shrink * cos, shrink * sin, zero], axis=-1)
    by_turn, by_distance = (_from_origin(by, poses[1:]) for by in (by_turn, by_distance))
    by_left = 0.5 * by_distance - by_turn / separation
    by_right = 0.5 * by_distance + by_turn / separation
    geometry = np.stack([
        (-turn / separation)[:, np.newaxis] * by_turn,
        d_left[:, np.newaxis] * by_left, d_right[:, np.newaxis] * by_right], axis=-1)
    by_steps = np.stack([by_left, by_right, by_turn], axis=-1)
    variances = np.abs(np.stack([
        drive.left_wheel_radius * d_left, drive.right_wheel_radius * d_right, turn], axis=-1))
    seen_from = seen_from_origin(poses)
    return Linearization(
        poses=poses[chosen],
        by_geometry=seen_from[chosen] @ _cumulative_sum(geometry)[chosen],
        by_start=seen_from[chosen] @ np.linalg.inv(seen_from[0]),
        seen_from=seen_from[chosen],
        noise=np.stack([
            _covariance_sum(variances[:, which], by_steps[:, :, which])[chosen]
            for which in range(3)]),
        by_steps=by_steps, variances=variances)


def seen_from_origin(poses: Array) -> Array:
    """Return T of each pose, (N, 3, 3)."""
    matrices = np.tile(np.eye(3), (len(poses), 1, 1))
    matrices[:, 0, 2], matrices[:, 1, 2] = -poses[:, 1], poses[:, 0]
    return matrices


def _from_origin(by: Array, poses: Array) -> Array:
    """Return T^-1 u for derivatives u, (N, 3)."""
    return np.stack([
        by[:, 0] + poses[:, 1] * by[:, 2], by[:, 1] - poses[:, 0] * by[:, 2], by[:, 2]], axis=-1)


def _cumulative_sum(values: Array) -> Array:
    return np.concatenate([np.zeros((1, *values.shape[1:])), np.cumsum(values, axis=0)])


def _covariance_sum(variance: Array, by: Array) -> Array:
    return _cumulative_sum(
        variance[:, np.newaxis, np.newaxis] * by[:, :, np.newaxis] * by[:, np.newaxis, :])
