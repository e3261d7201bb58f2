"""
Covariance of the residuals of a run.

The errors along a run are not independent: the wheels' noise adds up. So the residuals of a whole
run have the full covariance

    C = travel C_travel + turn C_turn + separation^2 C_separation
        + position^2 C_position + heading^2 C_heading + time^2 C_time
        + slow_position^2 C_slow_position + slow_heading^2 C_slow_heading ,

the first two as Odometry propagates them; the third is one error per run, of its own separation,
since tyres roll round a bend otherwise than they turn on the spot; then the white noise of the
reference's poses, the jitter of its timestamps, and its noise that is correlated over seconds.
"""
import math

from diffdrive_ros.calibration.linearization import Linearization
from diffdrive_ros.core.validation import Array
import numpy as np
from scipy import linalg

# The variances, in the order of C: travel [m^2/m], turn [rad^2/rad], separation (relative),
# position [m^2], heading [rad^2], time [s^2], slow position, slow heading.
START_VARIANCES = np.array([5e-6, 5e-5, 1e-6, 1e-6, 1e-5, 1e-5, 1e-6, 1e-5])
MAX_LOG_STEP = math.log(4.0)  # of one search
RESTART_VARIANCES = 0.02 * START_VARIANCES  # a search starts at these or above
MIN_VARIANCES: tuple[float, ...] = tuple((RESTART_VARIANCES * math.exp(-MAX_LOG_STEP)).tolist())

CORRELATION_TIME_S = 2.0  # of the slow noise of the reference


def components(
    from_origin: Array, linear: Linearization, by_separation: Array, rate: Array, seconds: Array,
    weights: Array,
) -> Array:
    """
    Return the covariance matrices of C, (8, 3 K, 3 K), for K residuals of a run.

    from_origin, (K, 3, 3): takes errors seen from the world's origin to errors of the marker.
    by_separation, (3 K,): derivatives by the logarithm of the separation. rate, (K, 3): of the
    marker's pose, per second. seconds, (K,): timestamps of the reference. weights, (K,): of the
    residuals; a smaller weight is a larger white noise.
    """
    count = len(weights)
    position, heading = np.diag([1.0, 1.0, 0.0]), np.diag([0.0, 0.0, 1.0])
    correlation = np.exp(-np.abs(np.subtract.outer(seconds, seconds)) / CORRELATION_TIME_S)
    return np.stack([
        _random_walk(from_origin, linear.noise[0] + linear.noise[1]),
        _random_walk(from_origin, linear.noise[2]),
        np.outer(by_separation, by_separation),
        _white(np.tile(position, (count, 1, 1)), weights),
        _white(np.tile(heading, (count, 1, 1)), weights),
        _white(rate[:, :, np.newaxis] * rate[:, np.newaxis, :], weights),
        np.kron(correlation, position),
        np.kron(correlation, heading),
    ])


def _random_walk(from_origin: Array, noise: Array) -> Array:
    """Return the covariance, (3 K, 3 K), of errors whose increments are independent, (K, 3, 3)."""
    count = len(noise)
    common = noise[np.minimum.outer(np.arange(count), np.arange(count))]
    blocks = from_origin[:, np.newaxis] @ common @ from_origin.transpose(0, 2, 1)[np.newaxis]
    matrix: Array = blocks.transpose(0, 2, 1, 3).reshape(3 * count, 3 * count)
    return matrix


def _white(blocks: Array, weights: Array) -> Array:
    """Return the covariance, (3 K, 3 K), of errors that are independent, (K, 3, 3)."""
    count = len(blocks)
    matrix = np.zeros((count, 3, count, 3))
    each = np.arange(count)
    matrix[each, :, each, :] = blocks / weights[:, np.newaxis, np.newaxis]
    return matrix.reshape(3 * count, 3 * count)


def inverse_and_log_determinant(covariance: Array) -> tuple[Array, float]:
    """Return the inverse of a covariance and the logarithm of its determinant; or LinAlgError."""
    factor, info = linalg.lapack.dpotrf(covariance, lower=1)
    if info != 0:
        raise np.linalg.LinAlgError('the residuals have no valid covariance')
    inverse, _ = linalg.lapack.dpotri(factor, lower=1)
    inverse = inverse + np.tril(inverse, -1).T  # dpotri fills the lower triangle only
    return inverse, 2.0 * float(np.log(np.diag(factor)).sum())
