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
"""Transits that differ by less are as good as the same."""

ALIKE_NS = 200_000_000
"""Messages that are late by the same, but for this, may be of one clock."""

CONFIRMED_NS = 1_000_000_000
"""Three messages at least, across this time at least, show that they are."""

FORGOTTEN_NS = 5_000_000_000
"""Messages further apart than this show nothing together."""

UNHEARD_NS = 60_000_000_000
"""A clock by which nobody was punctual for so long, while by another somebody was, is given up."""

DRIFT, MOST_DRIFT_NS = 5e-4, 100_000_000
"""Two clocks drift apart by no more: what the network time protocol may slew, and for how long."""

MOST_CLOCKS = MOST_SUSPECTS = 8


@dataclass(frozen=True)
class _Clock:
    """A sender's clock, of which no more is known than what its messages showed."""

    difference_ns: float
    """Its least difference between arrival and sending."""
    heard_ns: int

    def lateness(self, difference_ns: int, now_ns: int) -> float:
        """Return how much later than by the quickest transit a message came."""
        drift_ns = min(DRIFT * (now_ns - self.heard_ns), MOST_DRIFT_NS)
        return difference_ns - self.difference_ns - drift_ns


@dataclass
class _Suspect:
    """Messages that are late by every known clock, and all by about the same."""

    difference_ns: int
    since_ns: int
    heard_ns: int
    count: int = 1


class Lateness:
    """
    The clocks of those who send on a topic, as their messages show them.

    Senders cannot be told apart by their messages. A message is held against the clock by which
    it is the least late. One that is late by all is late, unless its sender is new, or others
    that are late by about the same have come for a second: then that is a clock, which was set
    back or not heard before. One that is too early for all shows that a clock was set forward,
    or taken for slower than it is.
    """

    def __init__(self) -> None:
        self.doubtful_ns = 0
        """By how much the messages were late that were last taken for those of another clock."""
        self._clocks: list[_Clock] = []
        self._suspects: list[_Suspect] = []

    def of(
        self, sent_ns: int, now_ns: int, has_new_sender: Callable[[], bool] = lambda: False,
    ) -> int:
        """
        Return how late a message is; 0 for one that does not tell when it was sent.

        has_new_sender tells whether there is a sender that was not there when it was last asked;
        it is asked only where that matters.
        """
        if sent_ns <= 0:
            return 0
        difference_ns = now_ns - sent_ns
        late = [clock.lateness(difference_ns, now_ns) for clock in self._clocks]
        possible = [(late_ns, index) for index, late_ns in enumerate(late)
                    if late_ns >= -PUNCTUAL_NS]
        if not possible:
            if not has_new_sender() and late:
                del self._clocks[late.index(max(late))]
            self._learn(difference_ns, now_ns)
            return 0
        late_ns, index = min(possible)
        if late_ns <= PUNCTUAL_NS:
            self._clocks[index] = _Clock(difference_ns - max(late_ns, 0.0), now_ns)
            self._clocks = [
                clock for clock in self._clocks if now_ns - clock.heard_ns <= UNHEARD_NS]
            return max(round(late_ns), 0)
        if has_new_sender():
            self._learn(difference_ns, now_ns)
            return 0
        if self._is_confirmed(difference_ns, now_ns):
            self.doubtful_ns = round(late_ns)
            return 0
        return round(late_ns)

    def _is_confirmed(self, difference_ns: int, now_ns: int) -> bool:
        """Return whether this is one message of many that are late alike; then it is a clock."""
        self._suspects = [
            each for each in self._suspects if now_ns - each.heard_ns <= FORGOTTEN_NS]
        for suspect in self._suspects:
            if abs(difference_ns - suspect.difference_ns) <= ALIKE_NS:
                break
        else:
            self._suspects.append(_Suspect(difference_ns, now_ns, now_ns))
            del self._suspects[:-MOST_SUSPECTS]
            return False
        suspect.difference_ns = min(suspect.difference_ns, difference_ns)
        suspect.heard_ns = now_ns
        suspect.count += 1
        if suspect.count < 3 or now_ns - suspect.since_ns < CONFIRMED_NS:
            return False
        self._suspects.remove(suspect)
        self._learn(suspect.difference_ns, now_ns)
        return True

    def _learn(self, difference_ns: int, now_ns: int) -> None:
        self._clocks.append(_Clock(difference_ns, now_ns))
        if len(self._clocks) > MOST_CLOCKS:
            self._clocks.remove(min(self._clocks, key=lambda clock: clock.heard_ns))
