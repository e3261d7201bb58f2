"""Outliers: poses that weigh less, by Huber's rule, and runs that contradict the others."""
from collections.abc import Sequence
from contextlib import suppress

from diffdrive_ros.calibration.covariance import MAX_LOG_STEP
from diffdrive_ros.calibration.likelihood import likeliest_variances, Solution, solve
from diffdrive_ros.calibration.model import MIN_SEPARATION_SPREAD
from diffdrive_ros.calibration.residuals import Estimate, Residuals, RunState
import numpy as np
from scipy.stats import chi2

# A pose with a larger squared Mahalanobis distance from its prediction by the others weighs less.
HUBER_SQUARED_DISTANCE = float(chi2.ppf(0.999, 3))

# A run is an outlier if it is less probable than this, given the others,
MIN_PROBABILITY = 1e-6
# or if its own noise has more than this many times the variance of the others'.
MAX_VARIANCE_RATIO = 4.0

# A run is judged in the directions in which its information, relative to that of the others, is
# at least this. In the others it follows errors of the first order.
MIN_RELATIVE_INFORMATION = 0.01

# A geometry with a larger relative standard deviation is unobservable.
MAX_RELATIVE_STD = 0.1


def weigh_poses(states: Sequence[RunState], solution: Solution) -> None:
    """Set the weights of poses, less than 1 for those that contradict all the others."""
    for state, inverse, weighted in zip(
            states, solution.inverses, solution.weighted, strict=True):
        count = len(state.weights)
        blocks = inverse.reshape(count, 3, count, 3)[np.arange(count), :, np.arange(count)]
        alone = weighted.reshape(count, 3)
        # Deviation from the others' prediction, blocks^-1 alone, by its covariance blocks^-1.
        squares = np.einsum(
            'ki,ki->k', alone, np.linalg.solve(blocks, alone[:, :, np.newaxis])[:, :, 0])
        state.weights = np.minimum(1.0, HUBER_SQUARED_DISTANCE / np.maximum(squares, 1e-9))


def worst_outlier(
    residuals: Sequence[Residuals], states: Sequence[RunState], estimate: Estimate,
) -> tuple[int, str] | None:
    """
    Return the index of the run that contradicts the others the most, and how; None if none does.

    Each is judged by the geometry and the noise of the others alone.
    """
    found: list[tuple[float, int, str]] = []
    for index in range(len(states)):
        with suppress(np.linalg.LinAlgError):
            found += _contradictions(index, residuals, states, estimate)
    return max(found)[1:] if found else None


def _contradictions(
    index: int, residuals: Sequence[Residuals], states: Sequence[RunState], estimate: Estimate,
) -> list[tuple[float, int, str]]:
    """Return the size of the contradiction of a run, its index and a text; or []."""
    own, state = residuals[index], states[index]
    other_residuals = [*residuals[:index], *residuals[index + 1:]]
    other_states = [*states[:index], *states[index + 1:]]
    # Far from the variances of all runs, which this run may have distorted.
    variances = likeliest_variances(other_residuals, other_states, estimate, 8.0 * MAX_LOG_STEP)
    # Runs of one kind of motion do not show how far another kind differs.
    variances[2] = max(variances[2], MIN_SEPARATION_SPREAD**2)
    others = solve(other_residuals, other_states, estimate, variances)
    if (estimate.relative_std(others.covariance) > MAX_RELATIVE_STD).any():
        return []  # this run alone makes a parameter observable
    alone = solve([own], [state], estimate, variances)
    information, side = alone.normals[0]
    root = np.linalg.cholesky(others.covariance)
    relative, directions = np.linalg.eigh(root.T @ information @ root)
    deviation = directions.T @ root.T @ (side - information @ others.common)
    is_judged = relative > MIN_RELATIVE_INFORMATION
    distance = float((deviation**2 / (relative + relative**2))[is_judged].sum())
    probability = float(chi2.sf(distance, np.count_nonzero(is_judged))) * len(residuals)
    unexplained = own.values - own.common @ others.common
    inverse = alone.inverses[0]
    weighted = inverse @ own.own
    explained = weighted.T @ unexplained
    ratio = float(
        unexplained @ inverse @ unexplained
        - explained @ np.linalg.solve(own.own.T @ weighted, explained)
        # The others' uncertainty of the geometry is no noise of this run.
        - (deviation**2 / (1.0 + relative)).sum())
    ratio /= len(unexplained)
    if ratio > MAX_VARIANCE_RATIO:
        return [(100.0 * ratio, index,
                 f'its residuals have {ratio:.0f} times the variance of the others')]
    if probability < MIN_PROBABILITY:
        return [(distance, index, 'it contradicts the others on the geometry')]
    return []
