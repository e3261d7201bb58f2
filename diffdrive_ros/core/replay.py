"""
Replay of recorded wheel samples, and the comparison of the poses with a reference.

The samples are integrated by Odometry as the node does; the poses are interpolated at the
reference's timestamps and evaluated there.
"""
from collections.abc import Sequence
from dataclasses import dataclass

from diffdrive_ros.core import evaluation, se2
from diffdrive_ros.core.evaluation import Evaluation
from diffdrive_ros.core.odometry_config import OdometryConfig
from diffdrive_ros.core.validation import Array, UserError
from diffdrive_ros.core.wheel_feedback import WheelSample
import numpy as np
import numpy.typing as npt

MAX_COMPARED = 2000  # poses of the reference, evenly over the log


@dataclass(frozen=True)
class Trajectory:
    """Poses of a reference, (M, 3), headings unwrapped, at increasing stamps [ns], (M,)."""

    stamps_ns: npt.NDArray[np.int64]
    poses: Array


@dataclass(frozen=True)
class ReplayedOdometry:
    """
    Odometry of recorded samples: timestamps [ns], (N,), and poses, (N, 3).

    Twists, (M, 3), and covariances, (M, 3, 3), are of the poses with the detail_indices, (M,).
    """

    stamps_ns: npt.NDArray[np.int64]
    poses: Array
    detail_indices: npt.NDArray[np.int64]
    twists: Array
    pose_covariances: Array
    twist_covariances: Array


def replay(
    config: OdometryConfig, samples: Sequence[WheelSample], detail_interval: int = 1,
    reset_ns: int | None = None,
) -> ReplayedOdometry:
    """
    Return the odometry that the node would publish, in detail at every so many samples.

    reset_ns: the first sample at this time or later resets the covariance, not the pose. Raises
    UserError for a step without a finite pose or covariance.
    """
    odometry = config.odometry()
    stamps: list[int] = []
    poses, detail_indices, details = [], [], []
    for sample in samples:
        if sample.time_reset_ns is not None:
            odometry.reset_time(sample.time_reset_ns)
        # As in the node, out-of-order and duplicate samples are dropped.
        try:
            is_new = odometry.update(sample.left, sample.right, sample.stamp_ns)
        except ValueError as error:
            raise UserError(f'wheels at {sample.stamp_ns * 1e-9:.3f} s: {error}') from None
        if not is_new:
            continue
        if reset_ns is not None and sample.stamp_ns >= reset_ns:
            odometry.reset(odometry.pose)
            reset_ns = None
        if len(stamps) % detail_interval == 0:
            detail_indices.append(len(stamps))
            details.append((
                odometry.twist, odometry.pose_covariance, odometry.twist_covariance))
        stamps.append(sample.stamp_ns)
        poses.append(odometry.pose)
    columns = (np.array(column) for column in zip(*details, strict=True))
    return ReplayedOdometry(
        np.array(stamps), np.array(poses), np.array(detail_indices), *columns)


def comparison_start_ns(
    samples: Sequence[WheelSample], reference: Trajectory, clock_offset: float,
) -> int | None:
    """Return the timestamp of the first compared pose [ns]; None if the two do not overlap."""
    stamps = reference.stamps_ns + round(clock_offset * 1e9)
    later = stamps[stamps >= samples[0].stamp_ns]
    return int(later[0]) if later.size else None


@dataclass(frozen=True)
class Comparison:
    """Odometry beside a reference: timestamps [s], poses of both, (N, 3), and the errors."""

    seconds: Array
    poses: Array
    reference: Array
    """In the odom frame."""
    covariances: Array
    figures: Evaluation


def compare(
    replayed: ReplayedOdometry, reference: Trajectory, *, alignment: str = 'start',
    marker: npt.ArrayLike | None = None, clock_offset: float = 0.0,
    reference_std: tuple[float, float] = (0.0, 0.0),
) -> Comparison:
    """
    Return the comparison at the timestamps of the reference.

    alignment: see evaluation.align. marker: pose of the reference's marker in the body frame.
    clock_offset [s]: added to the timestamps of the reference. reference_std: standard deviations
    of its position [m] and heading [rad]. The NEES holds for alignment 'start' if the replay was
    reset at comparison_start_ns, and for 'none'; 'path' has none, since its fit removes errors.
    Raises UserError if the two do not overlap.
    """
    stamps = reference.stamps_ns + round(clock_offset * 1e9)
    first, last = replayed.stamps_ns[0], replayed.stamps_ns[-1]
    if (np.diff(replayed.stamps_ns) <= 0).any():
        raise UserError('the clock restarts within the log: cut it there to compare')
    inside = np.flatnonzero((stamps >= first) & (stamps <= last))
    if len(inside) < 2:
        raise UserError(
            f'the reference, from {stamps[0] * 1e-9:.3f} to {stamps[-1] * 1e-9:.3f} s, does not '
            f'overlap the wheels, from {first * 1e-9:.3f} to {last * 1e-9:.3f} s')
    chosen = inside[np.unique(np.linspace(0, len(inside) - 1, MAX_COMPARED).astype(int))]
    wanted = (stamps[chosen] - first) * 1e-9
    seconds = (replayed.stamps_ns - first) * 1e-9
    # Linear between two samples: their distance is far below the noise of any pose.
    poses = np.stack([np.interp(wanted, seconds, column) for column in replayed.poses.T], axis=-1)
    reference_poses = reference.poses[chosen]
    if marker is not None:
        reference_poses = se2.compose(reference_poses, se2.inverse(marker))
    nearest = np.searchsorted(replayed.detail_indices, np.searchsorted(seconds, wanted))
    covariances = replayed.pose_covariances[
        np.minimum(nearest, len(replayed.detail_indices) - 1)]
    covariances = covariances + _reference_covariances(poses, alignment, *reference_std)
    figures = evaluation.evaluate(
        poses, reference_poses, alignment, None if alignment == 'path' else covariances)
    frame = evaluation.align(poses, reference_poses, alignment)
    return Comparison(
        wanted, poses, se2.compose(se2.inverse(frame), reference_poses), covariances, figures)


def _reference_covariances(
    poses: Array, alignment: str, position: float, heading: float,
) -> Array:
    """Return the covariance that the reference's noise adds to each error, (N, 3, 3)."""
    own = np.diag([position**2, position**2, heading**2])
    covariances = np.tile(own, (len(poses), 1, 1))
    if alignment == 'start':
        # The noise of the first pose rotates and translates the whole trajectory.
        moved = np.tile(np.eye(3), (len(poses), 1, 1))
        moved[:, 0, 2] = -(poses[:, 1] - poses[0, 1])
        moved[:, 1, 2] = poses[:, 0] - poses[0, 0]
        covariances += moved @ own @ moved.transpose(0, 2, 1)
    return covariances
