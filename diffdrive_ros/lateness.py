"""
How late a message comes, though the clocks of its sender and of its reader may not agree.

A message tells when it was sent, by the sender's clock; the difference to the time of its arrival
is that of the clocks plus the transit. The least of it is what the quickest transit gives, and
what is beyond the least is lateness: DDS sends again what a broken link has swallowed, a full
queue is emptied, a process that was stopped goes on. All times are in ns.
"""
from collections.abc import Callable
from dataclasses import dataclass

PUNCTUAL_NS = 50_000_000
"""Transits that differ by less are as good as the same; less by more is a new clock's."""

CONFIRMED_NS = 1_000_000_000
"""Messages that are late by the same for this long, without a gap of it, are of another clock."""

DRIFT = 5e-4
"""Two clocks drift apart by no more: what the network time protocol may slew."""

MOST_CLOCKS = 8


@dataclass(frozen=True)
class _Clock:
    """A sender's clock, of which no more is known than what its messages showed."""

    difference_ns: float
    """Its least difference between arrival and sending."""
    heard_ns: int

    def lateness(self, difference_ns: int, now_ns: int) -> float:
        """Return how much later than by the quickest transit a message came."""
        return difference_ns - self.difference_ns - DRIFT * (now_ns - self.heard_ns)


@dataclass
class _Suspect:
    """Messages that are late by every known clock, and all by the same."""

    difference_ns: int
    since_ns: int
    heard_ns: int


class Lateness:
    """
    The clocks of those who send on a topic, as their messages show them.

    Senders cannot be told apart by their messages. A message is held against the clock by which
    it is the least late; one that is late by all is late, unless its sender is new, or goes on to
    be late by the same for a second, as only a clock is that was set or was not heard before.
    """

    def __init__(self) -> None:
        self._clocks: list[_Clock] = []
        self._suspect: _Suspect | None = None

    def of(
        self, sent_ns: int, now_ns: int, has_new_sender: Callable[[], bool] = lambda: False,
    ) -> int:
        """
        Return how late a message is.

        has_new_sender tells whether there is a sender that was not there when it was last asked;
        it is asked only where that matters.
        """
        difference_ns = now_ns - sent_ns
        possible = [
            (late_ns, index) for index, clock in enumerate(self._clocks)
            if (late_ns := clock.lateness(difference_ns, now_ns)) >= -PUNCTUAL_NS]
        if not possible:
            has_new_sender()  # from now on it is none
            self._learn(difference_ns, now_ns)
            return 0
        late_ns, index = min(possible)
        if late_ns <= PUNCTUAL_NS:
            self._clocks[index] = _Clock(difference_ns - max(late_ns, 0.0), now_ns)
            return max(round(late_ns), 0)
        if has_new_sender() or self._is_confirmed(difference_ns, now_ns):
            self._learn(difference_ns, now_ns)
            return 0
        return round(late_ns)

    def _learn(self, difference_ns: int, now_ns: int) -> None:
        self._suspect = None
        self._clocks.append(_Clock(difference_ns, now_ns))
        if len(self._clocks) > MOST_CLOCKS:
            self._clocks.remove(min(self._clocks, key=lambda clock: clock.heard_ns))

    def _is_confirmed(self, difference_ns: int, now_ns: int) -> bool:
        suspect = self._suspect
        if (suspect is None or now_ns - suspect.heard_ns > CONFIRMED_NS
                or abs(difference_ns - suspect.difference_ns) > PUNCTUAL_NS):
            self._suspect = _Suspect(difference_ns, now_ns, now_ns)
            return False
        suspect.heard_ns = now_ns
        return now_ns - suspect.since_ns >= CONFIRMED_NS
