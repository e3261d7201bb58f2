"""
Evaluation of odometry against a reference: errors along the path and at its end.

Poses, (N, 3), are of the same timestamps. Position errors are in m, heading errors in rad. ATE and
RPE are root mean squares as of Sturm et al., A Benchmark for the Evaluation of RGB-D SLAM Systems
(2012). The ATE is theirs with the alignment path; it is larger with start, the default. The RPE
needs no alignment and is by distance driven.
"""
from collections.abc import Sequence
from dataclasses import dataclass
import math

from diffdrive_ros.core import se2
from diffdrive_ros.core.validation import Array
import numpy as np

ALIGNMENTS = ('start', 'path', 'none')
DISTANCES = (0.5, 1.0, 2.0, 5.0, 10.0, 20.0, 50.0, 100.0)


@dataclass(frozen=True)
class RelativeError:
    """Errors over all parts of the path of one length [m]."""

    distance: float
    position: float
    heading: float
    parts: int


@dataclass(frozen=True)
class Evaluation:
    """Errors of a trajectory; nees are means of e^T P^-1 e / 3, None without covariances."""

    length: float
    final_position: float
    final_heading: float
    ate: float
    heading_rms: float
    heading_worst: float
    rpe: tuple[RelativeError, ...]
    nees_final: float | None = None
    nees_mean: float | None = None


def distances_along(poses: Array) -> Array:
    """Return the length of the path up to each pose [m], (N,)."""
    return np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(poses[:, :2], axis=0).T))])


def align(poses: Array, reference: Array, how: str) -> Array:
    """
    Return the pose of odometry's frame in the reference's, (3,).

    how: start aligns the first poses; path is the rigid motion that minimises the distances of the
    positions (Umeyama 1991, in the plane, without scale); none is the identity.
    """
    if how == 'none':
        return np.zeros(3)
    if how == 'start':
        return se2.compose(reference[0], se2.inverse(poses[0]))
    centres = poses[:, :2].mean(axis=0), reference[:, :2].mean(axis=0)
    own, other = (track[:, :2] - centre for track, centre in zip(
        (poses, reference), centres, strict=True))
    across = np.sum(own[:, 0] * other[:, 1] - own[:, 1] * other[:, 0])
    turn = math.atan2(float(across), float(np.sum(own * other)))
    return np.array([*(centres[1] - se2.rotate(turn, centres[0])), turn])


def evaluate(
    poses: Array, reference: Array, how: str = 'start', covariances: Array | None = None,
    distances: Sequence[float] = DISTANCES,
) -> Evaluation:
    """
    Return the errors of odometry's poses against the reference's.

    covariances, (N, 3, 3): of the poses in odometry's frame, that of the reference included.
    """
    frame = align(poses, reference, how)
    # Errors in odometry's frame, where its covariance is.
    errors = se2.compose(se2.inverse(frame), reference) - poses
    errors[:, 2] = se2.wrap_angle(errors[:, 2])
    apart = np.hypot(errors[:, 0], errors[:, 1])
    nees = None
    if covariances is not None:
        nees = np.einsum(
            'ni,ni->n', errors, np.linalg.solve(covariances, errors[:, :, np.newaxis])[:, :, 0])
    way = distances_along(poses)
    return Evaluation(
        length=float(way[-1]), final_position=float(apart[-1]),
        final_heading=float(abs(errors[-1, 2])), ate=_rms(apart),
        heading_rms=_rms(errors[:, 2]), heading_worst=float(np.abs(errors[:, 2]).max()),
        rpe=tuple(
            _relative(poses, reference, way, distance)
            for distance in distances if distance <= way[-1]),
        nees_final=None if nees is None else float(nees[-1]) / 3.0,
        # With alignment 'start' the first error is zero.
        nees_mean=None if nees is None else float(nees[1:].mean()) / 3.0)


def _relative(poses: Array, reference: Array, way: Array, distance: float) -> RelativeError:
    ends = np.searchsorted(way, way + distance)
    begins = np.flatnonzero(ends < len(way))
    ends = ends[begins]
    own, other = (se2.between(track[begins], track[ends]) for track in (poses, reference))
    errors = se2.between(own, other)
    return RelativeError(
        distance, _rms(np.hypot(errors[:, 0], errors[:, 1])), _rms(se2.wrap_angle(errors[:, 2])),
        len(begins))


def _rms(values: Array) -> float:
    return float(np.sqrt(np.mean(np.square(values)))) if values.size else 0.0
