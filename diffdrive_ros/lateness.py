"""
How late a message comes, though the clocks of its sender and of its reader may not agree.

A message tells when it was sent, by the sender's clock; the difference to the time of its arrival
is that of the clocks plus the transit. The least of it is what the quickest transit gives, and
what is beyond the least is lateness: DDS sends again what a broken link has swallowed, a full
queue is emptied, a process that was stopped goes on. All times are in ns.
"""
from dataclasses import dataclass

PUNCTUAL_NS = 50_000_000
"""Transits that differ by less are as good as the same."""

ALIKE_NS = 500_000_000
"""Messages that are late by the same, but for this, may be of a clock that was set back."""

CONFIRMED, APART_NS = 3, 500_000_000
"""So many show that it was, of which each comes so long after the one before: no burst does."""

DRIFT, MOST_DRIFT_NS = 5e-4, 100_000_000
"""Two clocks drift apart by no more: what the network time protocol may slew, and for how long."""

QUICKEST, LEEWAY = 2000.0, 100
"""Nobody sends more messages a second, or more than these at once."""

MOST_SENDERS = 8


@dataclass
class _Late:
    """Messages of a sender that are late by about the same."""

    difference_ns: int
    counted_ns: int
    count: int = 1


@dataclass
class _Sender:
    """One who sends, by what its messages showed."""

    sequence: int
    """The number of its last message."""
    heard_ns: int
    difference_ns: float
    """The least difference between arrival and sending."""
    sooner_ns: int | None = None
    """The difference of a message that came sooner than any: the clock may have been set."""
    late: _Late | None = None

    def may_have_sent(self, sequence: int, now_ns: int) -> bool:
        """Return whether a message of a number can be the next of this sender that is heard."""
        most = LEEWAY + QUICKEST * 1e-9 * (now_ns - self.heard_ns)
        return 0 < sequence - self.sequence <= most

    def lateness(self, difference_ns: int, now_ns: int) -> float:
        """Return how much later than by the quickest transit a message comes."""
        drift_ns = min(DRIFT * (now_ns - self.heard_ns), MOST_DRIFT_NS)
        return difference_ns - self.difference_ns - drift_ns

    def is_set(self, difference_ns: int, now_ns: int) -> bool:
        """Return whether a late message shows, with others before it, that its clock was set."""
        if self.late is None or abs(difference_ns - self.late.difference_ns) > ALIKE_NS:
            self.late = _Late(difference_ns, now_ns)
            return False
        if now_ns - self.late.counted_ns >= APART_NS:
            self.late.counted_ns = now_ns
            self.late.count += 1
        return self.late.count >= CONFIRMED

    def set_clock(self, difference_ns: float, now_ns: int) -> None:
        """Take a difference for that of the quickest transit."""
        self.difference_ns, self.heard_ns = difference_ns, now_ns
        self.sooner_ns = self.late = None


class Lateness:
    """
    Those who send on a topic, as their messages show them.

    A message does not name its sender, but it has a number, and each sender counts its own. One
    that follows no number that was heard is of a new sender, and not late. One that comes late is
    late, unless others before it, with nothing punctual between, were late by about the same: then
    the sender's clock was set back, or its link has become slower. Two that come too early show
    that it was set forward, or taken for slower than it is. So nobody who goes on to send is
    refused for more than a second or two messages.
    """

    def __init__(self) -> None:
        self._senders: list[_Sender] = []

    def of(self, sent_ns: int, sequence: int | None, now_ns: int) -> tuple[int, int]:
        """
        Return how late a message is, and of how late a one a new clock is believed.

        Both are mostly 0, and always for a message that does not tell when it was sent or, with
        None, its number.
        """
        if sent_ns <= 0 or sequence is None:
            return 0, 0
        difference_ns = now_ns - sent_ns
        possible = [each for each in self._senders if each.may_have_sent(sequence, now_ns)]
        if not possible:
            self._senders.append(_Sender(sequence, now_ns, difference_ns))
            if len(self._senders) > MOST_SENDERS:
                self._senders.remove(min(self._senders, key=lambda each: each.heard_ns))
            return 0, 0
        # Who counts alike is told apart by the clock; else it is whose numbers are nearest.
        sender = min(possible, key=lambda each: (
            abs(each.lateness(difference_ns, now_ns)) > PUNCTUAL_NS, sequence - each.sequence))
        sender.sequence = sequence
        late_ns = sender.lateness(difference_ns, now_ns)
        if late_ns < -PUNCTUAL_NS:
            if sender.sooner_ns is not None:
                sender.set_clock(max(sender.sooner_ns, difference_ns), now_ns)
            else:
                sender.sooner_ns = difference_ns
            return 0, 0
        if late_ns <= PUNCTUAL_NS:
            sender.set_clock(difference_ns - max(late_ns, 0.0), now_ns)
            return max(round(late_ns), 0), 0
        if sender.is_set(difference_ns, now_ns):
            sender.set_clock(difference_ns, now_ns)
            return 0, round(late_ns)
        return round(late_ns), 0
