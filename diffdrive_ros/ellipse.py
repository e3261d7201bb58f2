"""A covariance of a place in the plane as the ellipse that a person can look at."""
import math

import numpy as np
import numpy.typing as npt

INSIDE_95 = math.sqrt(5.991)
"""Semi-axes in standard deviations of the ellipse that holds 95 % of a normal distribution."""


def of_covariance(covariance: npt.ArrayLike) -> tuple[float, float, float] | None:
    """
    Return both semi-axes [m], the longer first, and the direction [rad] of the longer one.

    Of the 95 % ellipse of a covariance of x and y, (2, 2); None if it is none.
    """
    matrix = np.asarray(covariance, dtype=float)
    if not np.isfinite(matrix).all():
        return None
    variances, axes = np.linalg.eigh(0.5 * (matrix + matrix.T))
    if variances[0] < -1e-9 * max(variances[1], 1e-12):
        return None
    short, long = INSIDE_95 * np.sqrt(np.maximum(variances, 0.0))
    return float(long), float(short), math.atan2(axes[1, 1], axes[0, 1])
