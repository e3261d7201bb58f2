"""Complaints as they change: said at most once a second, the last too unless it is over before."""
from collections.abc import Callable
import math
import time

PAUSE = 1.0  # [s]


class Complaints:
    """Passes on, as one line each, what a complaint that is looked at again and again becomes."""

    def __init__(self, warn: Callable[[str], object], form: str) -> None:
        self.said = ''
        """The complaint that was said last; '' since it was over."""
        self._warn, self._form = warn, form
        self._said_at = -math.inf

    def look(self, complaint: str) -> None:
        """Say a complaint that is new; one that comes too soon is said at a later look."""
        if complaint == self.said:
            return
        if complaint:
            now = time.monotonic()
            if now - self._said_at < PAUSE:
                return
            self._said_at = now
            self._warn(self._form.format(complaint))
        self.said = complaint
