"""
How late a message comes, though the clock of its sender need not be that of this computer.

A message tells when it was sent, by the sender's clock; the difference to the time of its arrival
is that of the clocks plus the transit. Where both are the same, or keep the same time, it is the
transit alone. A message that differs by more is late (DDS sends again what a broken link has
swallowed, a full queue is emptied, a process that was stopped goes on), or its sender has another
clock. One message cannot tell which. Old ones that are delivered at last come less and less late;
if it stays the same for a second, it is a clock, and its messages are held against the quickest of
them. All times are in ns.
"""
from collections import deque
from dataclasses import dataclass

ALIKE_NS = 200_000_000
"""What Wi-Fi trembles by, and no clock that keeps network time is wrong by."""

PATIENCE_NS, PAUSE_NS = 1_000_000_000, 1_000_000_000
"""So long another clock has to be heard until it is believed, and without a longer pause."""

MOST_DOUBLINGS, HOUR_NS = 5, 3_600_000_000_000
"""Twice as long for each clock that was believed within an hour: a link that becomes slower and
slower does not get far. A clock that was not heard for as long is forgotten."""

DRIFT, MOST_DRIFT_NS = 5e-4, 100_000_000
"""Two clocks drift apart by no more: what the network time protocol may slew, and for how long."""

MOST_CLOCKS = 8


@dataclass
class _Clock:
    """A clock that messages are sent by, as they show it."""

    difference_ns: int
    """The least between sending, by this clock, and arrival."""
    heard_ns: int
    room_ns: int
    """How much sooner than by the quickest transit a message may come, and still be of it."""
    believed_ns: int = 0

    def drift_ns(self, now_ns: int) -> int:
        """Return how far it may have drifted since it was heard."""
        return min(round(DRIFT * (now_ns - self.heard_ns)), MOST_DRIFT_NS)

    def lateness(self, difference_ns: int, now_ns: int) -> int:
        """Return how much later than by the quickest transit a message comes."""
        return difference_ns - self.difference_ns - self.drift_ns(now_ns)

    def hear(self, difference_ns: int, now_ns: int, most_room_ns: int) -> None:
        """Take a message of it; what comes sooner and sooner, as a backlog does, is not."""
        moved_ns = min(difference_ns - self.difference_ns, self.drift_ns(now_ns))
        used_ns = max(-moved_ns - self.drift_ns(now_ns), 0) if moved_ns < 0 else -moved_ns
        self.room_ns = min(self.room_ns - used_ns, most_room_ns)
        self.difference_ns, self.heard_ns = self.difference_ns + moved_ns, now_ns


@dataclass
class _Candidate:
    """Messages that may be of another clock."""

    first_difference_ns: int
    least_difference_ns: int
    first_ns: int
    heard_ns: int


class Lateness:
    """
    The clocks that messages on a topic are sent by: this computer's, and others.

    Messages of one clock differ by less than alike_ns, for the most part; clocks that do are as
    good as one.
    """

    def __init__(self, alike_ns: int = ALIKE_NS) -> None:
        self.alike_ns = alike_ns
        self._others: list[_Clock] = []
        self._candidates: deque[_Candidate] = deque(maxlen=MOST_CLOCKS)

    def of(self, sent_ns: int, now_ns: int, wall_ns: int) -> tuple[int, int]:
        """
        Return how late a message is, and of how late a one another clock is believed just now.

        now_ns is of a clock that nobody sets, wall_ns that of the computer. A message that comes
        before it was sent, by all clocks that are known, is late by less than nothing. Both are
        0 for a message that does not tell when it was sent.
        """
        if sent_ns <= 0:
            return 0, 0
        self._others = [each for each in self._others if now_ns - each.heard_ns < HOUR_NS]
        difference_ns = now_ns - sent_ns
        clocks = [_Clock(now_ns - wall_ns, now_ns, self.alike_ns), *self._others]
        all_late = [(each.lateness(difference_ns, now_ns), each) for each in clocks]
        possible = [(late_ns, each) for late_ns, each in all_late if late_ns >= -each.room_ns]
        late_ns, clock = min(possible, key=_first) if possible else max(all_late, key=_first)
        if -clock.room_ns <= late_ns <= self.alike_ns:
            clock.hear(difference_ns, now_ns, self.alike_ns)
            return max(late_ns, 0), 0
        if self._is_another_clock(difference_ns, now_ns):
            return 0, late_ns
        return late_ns, 0

    def _is_another_clock(self, difference_ns: int, now_ns: int) -> bool:
        """Return whether a message shows, with others before it, a clock that is believed now."""
        for candidate in self._candidates:
            # A backlog that is worked off comes sooner and sooner: so the first is what counts.
            if (abs(difference_ns - candidate.first_difference_ns) <= self.alike_ns
                    and now_ns - candidate.heard_ns <= PAUSE_NS):
                break
        else:
            self._candidates.append(_Candidate(difference_ns, difference_ns, now_ns, now_ns))
            return False
        candidate.least_difference_ns = min(candidate.least_difference_ns, difference_ns)
        candidate.heard_ns = now_ns
        lately = sum(now_ns - each.believed_ns < HOUR_NS for each in self._others)
        if now_ns - candidate.first_ns < PATIENCE_NS << min(lately, MOST_DOUBLINGS):
            return False
        self._candidates.remove(candidate)
        self._others.append(_Clock(
            candidate.least_difference_ns, now_ns, self.alike_ns, believed_ns=now_ns))
        if len(self._others) > MOST_CLOCKS:
            self._others.remove(min(self._others, key=lambda each: each.heard_ns))
        return True


def _first(pair: tuple[int, _Clock]) -> int:
    return pair[0]
