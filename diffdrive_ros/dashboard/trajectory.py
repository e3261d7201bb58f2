"""A trajectory to draw: thinned, so that it stays bounded however long the robot drives."""
from collections.abc import Sequence
import math

Point = tuple[float, float, bool]
"""x, y [m], and whether a new line starts here."""


class DrawnTrajectory:
    """
    Points at least min_spacing [m] apart; above max_points, the older half is thinned.

    Every position of the older half stays within twice spacing [m] of a point; spacing grows as
    needed. A step longer than max_step [m] is a jump, such as a pose that was set: no line is
    drawn there. version changes when points are removed, and not when points are added.
    """

    def __init__(
        self, max_points: int = 2000, min_spacing: float = 0.01, max_step: float = 0.5,
    ) -> None:
        self.points: list[Point] = []
        self.version = 0
        self.spacing = min_spacing
        self._min_spacing = min_spacing
        self._max_points = max_points
        self._max_step = max_step
        self._last: tuple[float, float] | None = None

    def add(self, x: float, y: float) -> None:
        """Add a position of the robot [m]; one that is not finite is ignored."""
        if not (math.isfinite(x) and math.isfinite(y)):
            return
        has_jumped = self._last is None or math.dist(self._last, (x, y)) > self._max_step
        self._last = x, y
        if not has_jumped and math.dist(self.points[-1][:2], (x, y)) < self._min_spacing:
            return
        self.points.append((x, y, has_jumped))
        if len(self.points) > self._max_points:
            self._thin()

    def clear(self) -> None:
        """Remove all points."""
        self.points.clear()
        self._last = None
        self.spacing = self._min_spacing
        self.version += 1

    def _thin(self) -> None:
        """Keep at most three quarters of the older half, starts of lines with preference."""
        half = len(self.points) // 2
        capacity = 3 * half // 4
        old, new = _spaced(self.points[:half], self.spacing), self.points[half:]
        while len(old) > capacity and not all(is_start for _, _, is_start in old):
            self.spacing *= 2.0
            old = _spaced(old, self.spacing)
        self.points = old[-capacity:] + new
        self.version += 1


def _spaced(points: Sequence[Point], spacing: float) -> list[Point]:
    """Return the points at least a spacing from the last one kept, and the starts of lines."""
    kept: list[Point] = []
    for point in points:
        if point[2] or not kept or math.dist(kept[-1][:2], point[:2]) >= spacing:
            kept.append(point)
    return kept
