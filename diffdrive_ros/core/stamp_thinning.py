"""Thinning of messages to a rate, by their timestamps: the node and the tools thin alike."""


class StampThinning:
    """Selects messages at a rate [Hz], or all if it is 0, by their stamps [ns]."""

    def __init__(self, rate: float) -> None:
        self._period_ns = round(1e9 / rate) if rate else 0
        self._due_ns: int | None = None

    def reset_time(self) -> None:
        """Select the next message, after a time reset."""
        self._due_ns = None

    def is_due(self, stamp_ns: int) -> bool:
        """Return whether the message with this stamp is selected."""
        due_ns, period_ns = self._due_ns, self._period_ns
        if due_ns is None or not due_ns - period_ns <= stamp_ns < due_ns + period_ns:
            due_ns = stamp_ns  # at the start, after a gap, after a step of the clock
        is_due = stamp_ns >= due_ns
        self._due_ns = due_ns + period_ns if is_due else due_ns
        return is_due
