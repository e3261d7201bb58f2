"""
How late a message comes, though the clock of its sender need not be that of this computer.

A message tells when it was sent, by the sender's clock; the difference to the time of its arrival
is that of the clocks plus the transit. Where both are the same, or keep the same time, it is the
transit alone. A message that differs by more is late (DDS sends again what a broken link has
swallowed, a full queue is emptied, a process that was stopped goes on), or its sender has another
clock. One message cannot tell which, but no burst of old ones goes on for a second: then it is a
clock, and its messages are held against the quickest of them. All times are in ns.
"""
from collections import deque
from dataclasses import dataclass

ALIKE_NS = 200_000_000
"""Messages of one clock differ by less, for the most part; clocks that do are as good as one."""

PATIENCE_NS, PAUSE_NS = 1_000_000_000, 1_000_000_000
"""So long another clock has to be heard until it is believed, and without a longer pause."""

HOUR_NS = 3_600_000_000_000
"""For each that was believed within it, twice as long: no link that becomes slower gets far."""

DRIFT, MOST_DRIFT_NS = 5e-4, 100_000_000
"""Two clocks drift apart by no more: what the network time protocol may slew, and for how long."""

MOST_CLOCKS = 8


@dataclass
class _Clock:
    """A clock that messages are sent by, as they show it."""

    difference_ns: int
    """The least between sending, by this clock, and arrival."""
    first_ns: int
    heard_ns: int

    def lateness(self, difference_ns: int, now_ns: int) -> int:
        """Return how much later than by the quickest transit a message comes."""
        drift_ns = min(round(DRIFT * (now_ns - self.heard_ns)), MOST_DRIFT_NS)
        return difference_ns - self.difference_ns - drift_ns


class Lateness:
    """The clocks that messages on a topic are sent by: this computer's, and others."""

    def __init__(self) -> None:
        self._others: list[_Clock] = []
        self._believed_ns: deque[int] = deque(maxlen=MOST_CLOCKS)
        """When each of the others was."""
        self._candidates: deque[_Clock] = deque(maxlen=MOST_CLOCKS)

    def of(self, sent_ns: int, now_ns: int, wall_ns: int) -> tuple[int, int]:
        """
        Return how late a message is, and of how late a one another clock is believed just now.

        now_ns is of a clock that nobody sets, wall_ns that of the computer. A message that comes
        before it was sent, by all clocks that are known, is late by less than nothing. Both are
        0 for a message that does not tell when it was sent.
        """
        if sent_ns <= 0:
            return 0, 0
        difference_ns = now_ns - sent_ns
        clocks = [_Clock(now_ns - wall_ns, now_ns, now_ns), *self._others]
        all_late = [(each.lateness(difference_ns, now_ns), each) for each in clocks]
        possible = [pair for pair in all_late if pair[0] >= -ALIKE_NS]
        late_ns, clock = (min(possible, key=_first) if possible else max(all_late, key=_first))
        if abs(late_ns) <= ALIKE_NS:
            clock.difference_ns, clock.heard_ns = difference_ns - max(late_ns, 0), now_ns
            return max(late_ns, 0), 0
        if self._is_another_clock(difference_ns, now_ns):
            return 0, late_ns
        return late_ns, 0

    def _is_another_clock(self, difference_ns: int, now_ns: int) -> bool:
        """Return whether a message shows, with others before it, a clock that is believed now."""
        for candidate in self._candidates:
            if (abs(difference_ns - candidate.difference_ns) <= ALIKE_NS
                    and now_ns - candidate.heard_ns <= PAUSE_NS):
                break
        else:
            self._candidates.append(_Clock(difference_ns, now_ns, now_ns))
            return False
        candidate.difference_ns = min(candidate.difference_ns, difference_ns)
        candidate.heard_ns = now_ns
        lately = sum(now_ns - believed_ns < HOUR_NS for believed_ns in self._believed_ns)
        if now_ns - candidate.first_ns < PATIENCE_NS << lately:
            return False
        self._candidates.remove(candidate)
        self._others.append(candidate)
        if len(self._others) > MOST_CLOCKS:
            self._others.remove(min(self._others, key=lambda each: each.heard_ns))
        self._believed_ns.append(now_ns)
        return True


def _first(pair: tuple[int, _Clock]) -> int:
    return pair[0]
