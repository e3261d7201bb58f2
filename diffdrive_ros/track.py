"""A track that can be drawn however long it gets: thinned, so that it stays bounded."""
import math

Point = tuple[float, float, bool]
"""x, y [m], and whether a new line starts here."""


class Track:
    """
    Points at least spacing [m] apart; each time they are too many, every other one goes.

    A step longer than longest_step [m] is a jump, such as of a pose that was set: no line is drawn
    there. version changes when points have been taken away, and not when some were added.
    """

    def __init__(
        self, most: int = 2000, spacing: float = 0.01, longest_step: float = 0.5,
    ) -> None:
        self.points: list[Point] = []
        self.version = 0
        self.spacing = spacing
        self._most = most
        self._longest_step = longest_step
        self._last: tuple[float, float] | None = None

    def add(self, x: float, y: float) -> None:
        """Take note of where the robot is; what is not finite is passed over."""
        if not (math.isfinite(x) and math.isfinite(y)):
            return
        jumped = self._last is None or math.dist(self._last, (x, y)) > self._longest_step
        self._last = x, y
        if not jumped and math.dist(self.points[-1][:2], (x, y)) < self.spacing:
            return
        self.points.append((x, y, jumped))
        if len(self.points) > self._most:
            self._thin()

    def clear(self) -> None:
        """Forget everything."""
        self.points.clear()
        self._last = None
        self.version += 1

    def _thin(self) -> None:
        """Keep every other point, and all at which a line starts; of too many lines the newest."""
        self.spacing *= 2.0
        kept = [
            point for number, point in enumerate(self.points)
            if point[2] or number % 2 == 0 or number == len(self.points) - 1]
        self.points = kept[-(self._most // 2 + 1):] if len(kept) > self._most else kept
        self.version += 1
