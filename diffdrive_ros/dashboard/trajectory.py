"""A track that can be drawn however long it gets: thinned, so that it stays bounded."""
from collections.abc import Sequence
import math

Point = tuple[float, float, bool]
"""x, y [m], and whether a new line starts here."""


class Track:
    """
    Points a finest distance [m] apart; each time they are too many, the older half is thinned.

    Of that, no place is further from a point than twice spacing [m], which grows as it has to.
    A step longer than longest_step [m] is a jump, such as of a pose that was set: no line is drawn
    there. version changes when points have been taken away, and not when some were added.
    """

    def __init__(
        self, most: int = 2000, finest: float = 0.01, longest_step: float = 0.5,
    ) -> None:
        self.points: list[Point] = []
        self.version = 0
        self.spacing = finest
        self._finest = finest
        self._most = most
        self._longest_step = longest_step
        self._last: tuple[float, float] | None = None

    def add(self, x: float, y: float) -> None:
        """Take note of where the robot is; what is not finite is passed over."""
        if not (math.isfinite(x) and math.isfinite(y)):
            return
        jumped = self._last is None or math.dist(self._last, (x, y)) > self._longest_step
        self._last = x, y
        if not jumped and math.dist(self.points[-1][:2], (x, y)) < self._finest:
            return
        self.points.append((x, y, jumped))
        if len(self.points) > self._most:
            self._thin()

    def clear(self) -> None:
        """Forget everything."""
        self.points.clear()
        self._last = None
        self.spacing = self._finest
        self.version += 1

    def _thin(self) -> None:
        """Keep three quarters of the older half at most, and where lines start before others."""
        half = len(self.points) // 2
        room = 3 * half // 4
        old, new = _spread(self.points[:half], self.spacing), self.points[half:]
        while len(old) > room and not all(is_start for _, _, is_start in old):
            self.spacing *= 2.0
            old = _spread(old, self.spacing)
        self.points = old[-room:] + new
        self.version += 1


def _spread(points: Sequence[Point], spacing: float) -> list[Point]:
    """Return the points a spacing away from the last that is kept, and where lines start."""
    kept: list[Point] = []
    for point in points:
        if point[2] or not kept or math.dist(kept[-1][:2], point[:2]) >= spacing:
            kept.append(point)
    return kept
