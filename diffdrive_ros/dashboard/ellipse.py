"""A covariance of a place in the plane as the ellipse that a person can look at."""
from collections.abc import Sequence
import math

INSIDE_95 = math.sqrt(5.991)
"""Semi-axes in standard deviations of the ellipse that holds 95 % of a normal distribution."""


def of_covariance(covariance: Sequence[Sequence[float]]) -> tuple[float, float, float] | None:
    """
    Return both semi-axes [m], the longer first, and the direction [rad] of the longer one.

    Of the 95 % ellipse of a covariance of x and y, (2, 2); None if it is none. By the double
    angle of the principal axes, in plain floats: numpy's eigh costs ten times that for one matrix.
    """
    (xx, xy), (yx, yy) = covariance
    mean, difference, shared = 0.5 * (xx + yy), 0.5 * (xx - yy), 0.5 * (xy + yx)
    spread = math.hypot(difference, shared)
    if not math.isfinite(mean + spread) or mean - spread < -1e-9 * max(mean + spread, 1e-12):
        return None
    long = INSIDE_95 * math.sqrt(max(0.0, mean + spread))
    short = INSIDE_95 * math.sqrt(max(0.0, mean - spread))
    return long, short, 0.5 * math.atan2(shared, difference)
