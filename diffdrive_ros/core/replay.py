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

# Poses of the reference that are compared, at most, evenly over the log.
COMPARED = 2000


@dataclass(frozen=True)
class Trajectory:
    """Poses of a reference, (M, 3), headings continuous, and their stamps [ns], (M,), growing."""

    stamps_ns: npt.NDArray[np.int64]
    poses: Array
    frame: str


@dataclass(frozen=True)
class Replayed:
    """
    Odometry of a log: stamps [ns], (N,), and poses, (N, 3).

    Twists, (M, 3), and covariances, (M, 3, 3), are those of the samples with the indices detailed.
    """

    stamps_ns: npt.NDArray[np.int64]
    poses: Array
    detailed: npt.NDArray[np.int64]
    twists: Array
    pose_covariances: Array
    twist_covariances: Array


def replay(
    config: OdometryConfig, samples: Sequence[WheelSample], every: int = 1,
    known_ns: int | None = None,
) -> Replayed:
    """
    Return what the node makes of the samples; in detail of every so many of them.

    known_ns: from the first sample on that is not older, covariances are of what is driven from
    there, as if the pose had been known then.
    """
    odometry = config.odometry()
    stamps: list[int] = []
    poses, detailed, details = [], [], []
    for sample in samples:
        if sample.restarted_ns is not None:
            odometry.restart(sample.restarted_ns)
        # The node passes over what is not newer.
        if not odometry.update(sample.left, sample.right, sample.stamp_ns):
            continue
        if known_ns is not None and sample.stamp_ns >= known_ns:
            odometry.reset(odometry.pose)
            known_ns = None
        if len(stamps) % every == 0:
            detailed.append(len(stamps))
            details.append((
                odometry.twist, odometry.pose_covariance, odometry.twist_covariance))
        stamps.append(sample.stamp_ns)
        poses.append(odometry.pose)
    columns = (np.array(column) for column in zip(*details, strict=True))
    return Replayed(np.array(stamps), np.array(poses), np.array(detailed), *columns)


def first_compared(
    samples: Sequence[WheelSample], reference: Trajectory, time_offset: float,
) -> int | None:
    """Return when a comparison begins [ns]; None if the two do not overlap."""
    stamps = reference.stamps_ns + round(time_offset * 1e9)
    later = stamps[stamps >= samples[0].stamp_ns]
    return int(later[0]) if later.size else None


@dataclass(frozen=True)
class Comparison:
    """Odometry beside the reference: stamps [s], poses of both, (N, 3), and the figures."""

    seconds: Array
    poses: Array
    reference: Array
    """In odometry's frame."""
    covariances: Array
    figures: Evaluation


def compare(
    replayed: Replayed, reference: Trajectory, *, how: str = 'start', marker: Array | None = None,
    time_offset: float = 0.0, reference_std: tuple[float, float] = (0.0, 0.0),
) -> Comparison:
    """
    Return the comparison at the stamps of the reference.

    marker: where on the robot the reference is, a pose in the body frame; time_offset [s]: what is
    added to the stamps of the reference; reference_std: of its position [m] and heading [rad].
    The figures have a NEES where covariances are of the errors: with start if the replay is one
    that is known from first_compared on, with none, and not with path, which fits errors away.
    Raises UserError if the two do not overlap.
    """
    stamps = reference.stamps_ns + round(time_offset * 1e9)
    first, last = replayed.stamps_ns[0], replayed.stamps_ns[-1]
    if (np.diff(replayed.stamps_ns) <= 0).any():
        raise UserError('time starts again in the log: cut it there to compare')
    inside = np.flatnonzero((stamps >= first) & (stamps <= last))
    if len(inside) < 2:
        raise UserError(
            f'the reference, from {stamps[0] * 1e-9:.3f} to {stamps[-1] * 1e-9:.3f} s, does not '
            f'overlap the wheels, from {first * 1e-9:.3f} to {last * 1e-9:.3f} s')
    chosen = inside[np.unique(np.linspace(0, len(inside) - 1, COMPARED).astype(int))]
    asked = (stamps[chosen] - first) * 1e-9
    seconds = (replayed.stamps_ns - first) * 1e-9
    # Straight between two samples: they are much closer than any pose is known.
    poses = np.stack([np.interp(asked, seconds, column) for column in replayed.poses.T], axis=-1)
    seen = reference.poses[chosen]
    if marker is not None:
        seen = se2.compose(seen, se2.inverse(marker))
    nearest = np.searchsorted(replayed.detailed, np.searchsorted(seconds, asked))
    covariances = replayed.pose_covariances[
        np.minimum(nearest, len(replayed.detailed) - 1)] + _unsure(poses, how, *reference_std)
    figures = evaluation.evaluate(poses, seen, how, None if how == 'path' else covariances)
    frame = evaluation.align(poses, seen, how)
    return Comparison(
        asked, poses, se2.compose(se2.inverse(frame), seen), covariances, figures)


def _unsure(poses: Array, how: str, position: float, heading: float) -> Array:
    """Return what the reference's own noise adds to each error, (N, 3, 3)."""
    own = np.diag([position**2, position**2, heading**2])
    covariances = np.tile(own, (len(poses), 1, 1))
    if how == 'start':
        # The noise of the first pose turns and moves the whole drive.
        moved = np.tile(np.eye(3), (len(poses), 1, 1))
        moved[:, 0, 2] = -(poses[:, 1] - poses[0, 1])
        moved[:, 1, 2] = poses[:, 0] - poses[0, 0]
        covariances += moved @ own @ moved.transpose(0, 2, 1)
    return covariances
