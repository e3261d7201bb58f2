"""A warning whose text changes: logged on change, at most once a second."""
from collections.abc import Callable
import math
import time

PAUSE_S = 1.0


class ThrottledWarning:
    """Logs the changing text of one warning; a text that is still current is never lost."""

    def __init__(self, warn: Callable[[str], object], form: str) -> None:
        self.logged = ''
        """The text logged last; '' once its cause is gone."""
        self._warn, self._form = warn, form
        self._logged_at = -math.inf

    def update(self, text: str) -> None:
        """Log a new text, or wait for a later update within the pause; '' for no warning."""
        if text == self.logged:
            return
        if text:
            now = time.monotonic()
            if now - self._logged_at < PAUSE_S:
                return
            self._logged_at = now
            self._warn(self._form.format(text))
        self.logged = text
