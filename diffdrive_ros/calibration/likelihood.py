"""
Generalised least squares over all runs, and the noise that makes their residuals the likeliest.

The variances maximise the restricted likelihood, which accounts for the degrees of freedom that
the fit takes away (Patterson and Thompson, Biometrika 58, 1971).
"""
from collections.abc import Sequence
from dataclasses import dataclass
import math

from diffdrive_ros.calibration.covariance import (
    inverse_and_log_determinant,
    MAX_LOG_STEP,
    MIN_VARIANCES,
    RESTART_VARIANCES,
)
from diffdrive_ros.calibration.residuals import Estimate, Residuals, RunState
from diffdrive_ros.core.validation import Array
import numpy as np
from scipy import optimize

# Standard deviations of weak priors, which keep the fit determinate where, as on a straight line,
# an offset of the marker cannot be distinguished from another start.
MARKER_PRIOR_STD = (0.3, 0.3, 3.0)  # [m, m, rad]
MARKER_PRIOR_STD_WITHOUT_TURNS = (1e-6, 1e-6, 3.0)  # at the origin of the body
CLOCK_OFFSET_PRIOR_STD_S = 0.2


@dataclass
class Solution:
    """
    Solution of the normal equations of all runs.

    common, (q,), is the step of the common unknowns, own, (p,) each, that of each run's. objective
    is minus twice the logarithm of the restricted likelihood, gradient, (8,), its derivative.
    """

    common: Array
    information: Array
    covariance: Array
    own: list[Array]
    own_covariances: list[Array]
    """With the common unknowns known."""
    normals: list[tuple[Array, Array]]
    """Information and right side of each run, its own unknowns eliminated."""
    objective: float
    gradient: Array
    weighted: list[Array]
    """C^-1 (e - J x) of each run."""
    inverses: list[Array]
    """C^-1 of each run."""


def solve(
    residuals: Sequence[Residuals], states: Sequence[RunState], estimate: Estimate,
    variances: Array,
) -> Solution:
    """Return the generalised least squares for given variances, (8,); raises LinAlgError."""
    terms = estimate.terms
    size = residuals[0].common.shape[1]
    information, right_side = np.zeros((size, size)), np.zeros(size)
    if terms.marker:
        prior = 1.0 / np.square(
            MARKER_PRIOR_STD if estimate.turns else MARKER_PRIOR_STD_WITHOUT_TURNS)
        information[-3:, -3:] += np.diag(prior)
        right_side[-3:-1] -= prior[:2] * estimate.marker[:2]
    objective, parts, normals = 0.0, [], []
    for each, state in zip(residuals, states, strict=True):
        inverse, log_determinant = inverse_and_log_determinant(
            np.tensordot(variances, each.components, 1))
        derivatives = np.concatenate([each.own, each.common], axis=1)
        weighted = inverse @ derivatives
        own = each.own.shape[1]
        normal, side = derivatives.T @ weighted, weighted.T @ each.values
        if terms.clock_offset:
            normal[own - 1, own - 1] += 1.0 / CLOCK_OFFSET_PRIOR_STD_S**2
            side[own - 1] -= state.clock_offset / CLOCK_OFFSET_PRIOR_STD_S**2
        own_inverse = np.linalg.inv(normal[:own, :own])
        eliminated = own_inverse @ np.column_stack([side[:own], normal[:own, own:]])
        normals.append((
            normal[own:, own:] - normal[own:, :own] @ eliminated[:, 1:],
            side[own:] - normal[own:, :own] @ eliminated[:, 0]))
        information += normals[-1][0]
        right_side += normals[-1][1]
        objective += (
            log_determinant - np.linalg.slogdet(own_inverse)[1]
            + each.values @ inverse @ each.values - side[:own] @ eliminated[:, 0])
        parts.append((inverse, derivatives, weighted, own_inverse, eliminated))
    covariance = np.asarray(np.linalg.inv(information), dtype=np.float64)
    common = covariance @ right_side
    objective += np.linalg.slogdet(information)[1] - right_side @ common
    gradient = np.zeros(len(variances))
    own_steps, smooth = [], []
    for each, (inverse, derivatives, weighted, own_inverse, eliminated) in zip(
            residuals, parts, strict=True):
        own_steps.append(eliminated[:, 0] - eliminated[:, 1:] @ common)
        unknown = np.concatenate([own_steps[-1], common])
        smooth.append(inverse @ (each.values - derivatives @ unknown))
        across = -eliminated[:, 1:] @ covariance
        joint = np.block([
            [own_inverse - across @ eliminated[:, 1:].T, across], [across.T, covariance]])
        moved = each.components @ weighted
        gradient += (
            np.tensordot(each.components, inverse, 2)
            - np.tensordot(moved, weighted @ joint, 2)
            - (each.components @ smooth[-1]) @ smooth[-1])
    return Solution(
        common, information, covariance, own_steps, [part[3] for part in parts], normals,
        float(objective), gradient, smooth, [part[0] for part in parts])


def likeliest_variances(
    residuals: Sequence[Residuals], states: Sequence[RunState], estimate: Estimate,
    max_log_step: float = MAX_LOG_STEP,
) -> Array:
    """Return the likeliest variances, (8,), of some or all runs, within a step of the estimate."""
    def objective(logarithms: Array) -> tuple[float, Array]:
        variances = np.exp(logarithms)
        solution = solve(residuals, states, estimate, variances)
        return solution.objective, solution.gradient * variances

    # A variance that was tiny while the geometry was still wrong could not grow by itself.
    start = np.log(np.maximum(estimate.variances, RESTART_VARIANCES))
    found = optimize.minimize(
        objective, start, jac=True, method='L-BFGS-B',
        bounds=[(max(each - max_log_step, math.log(least)), each + max_log_step)
                for each, least in zip(start.tolist(), MIN_VARIANCES, strict=True)],
        options={'maxiter': 40, 'ftol': 1e-7})
    return np.exp(found.x)
