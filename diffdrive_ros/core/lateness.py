"""
Latency of messages whose senders may have clock offsets.

A message has a stamp of its sender's clock. The difference of receipt and stamp is the clock
offset plus the latency; for synchronous clocks it is the latency alone. A message with a larger
difference is late (DDS resends after a link loss, a full queue empties, a stopped process
continues), or its sender has a clock offset. One message alone is ambiguous. In a backlog the
differences decrease. If the difference is constant for a second, it is a clock offset, and the
latency is relative to the quickest message of that clock. All times are in ns.
"""
from collections import deque
from dataclasses import dataclass

ALIKE_NS = 200_000_000
"""Above the jitter of Wi-Fi and the offset of a clock that is synchronised by network."""

ACCEPTANCE_NS, MAX_GAP_NS = 1_000_000_000, 1_000_000_000
"""The time until a clock offset is accepted, and the longest gap of messages in it."""

MAX_DOUBLINGS, HOUR_NS = 5, 3_600_000_000_000
"""That time doubles for each clock offset accepted within an hour, as a guard against a link that
becomes slower and slower. A clock without messages for an hour is discarded."""

DRIFT, MAX_DRIFT_NS = 5e-4, 100_000_000
"""Maximum drift between two clocks: the slew rate of NTP, and its total."""

MAX_CLOCKS = 8


@dataclass
class _Clock:
    """The clock of a sender, as estimated from its messages."""

    difference_ns: int
    """The smallest difference of receipt and stamp."""
    received_ns: int
    room_ns: int
    """How much smaller the difference of a message of this clock may be."""
    accepted_ns: int = 0

    def drift_ns(self, now_ns: int) -> int:
        """Return the possible drift since its last message."""
        return min(round(DRIFT * (now_ns - self.received_ns)), MAX_DRIFT_NS)

    def lateness(self, difference_ns: int, now_ns: int) -> int:
        """Return the latency of a message relative to the quickest one."""
        return difference_ns - self.difference_ns - self.drift_ns(now_ns)

    def update(self, difference_ns: int, now_ns: int, most_room_ns: int) -> None:
        """Update the estimate; a backlog, whose differences decrease, uses up room_ns."""
        moved_ns = min(difference_ns - self.difference_ns, self.drift_ns(now_ns))
        used_ns = max(-moved_ns - self.drift_ns(now_ns), 0) if moved_ns < 0 else -moved_ns
        self.room_ns = min(self.room_ns - used_ns, most_room_ns)
        self.difference_ns, self.received_ns = self.difference_ns + moved_ns, now_ns


@dataclass
class _Candidate:
    """Messages of a possible clock offset."""

    first_difference_ns: int
    least_difference_ns: int
    first_ns: int
    received_ns: int


class Lateness:
    """
    The clocks of the publishers on a topic: this computer's, and others with an offset.

    Differences of one clock mostly vary by less than alike_ns; clocks closer than that are one.
    """

    def __init__(self, alike_ns: int = ALIKE_NS) -> None:
        self.alike_ns = alike_ns
        self._others: list[_Clock] = []
        self._candidates: deque[_Candidate] = deque(maxlen=MAX_CLOCKS)

    def of(self, sent_ns: int, now_ns: int, wall_ns: int) -> tuple[int, int]:
        """
        Return the latency of a message, and the clock offset accepted on it, or 0.

        now_ns is of a monotonic clock, wall_ns of the wall clock. The latency is negative if the
        stamp is in the future by all accepted clocks. Both are 0 for a message without a stamp.
        """
        if sent_ns <= 0:
            return 0, 0
        self._others = [each for each in self._others if now_ns - each.received_ns < HOUR_NS]
        difference_ns = now_ns - sent_ns
        clocks = [_Clock(now_ns - wall_ns, now_ns, self.alike_ns), *self._others]
        all_late = [(each.lateness(difference_ns, now_ns), each) for each in clocks]
        possible = [(late_ns, each) for late_ns, each in all_late if late_ns >= -each.room_ns]
        late_ns, clock = min(possible, key=_first) if possible else max(all_late, key=_first)
        if -clock.room_ns <= late_ns <= self.alike_ns:
            clock.update(difference_ns, now_ns, self.alike_ns)
            return max(late_ns, 0), 0
        if self._is_another_clock(difference_ns, now_ns):
            return 0, late_ns
        return late_ns, 0

    def _is_another_clock(self, difference_ns: int, now_ns: int) -> bool:
        """Return whether a message, with those before it, establishes a clock offset."""
        for candidate in self._candidates:
            # In a backlog the differences decrease: so each is compared with the first.
            if (abs(difference_ns - candidate.first_difference_ns) <= self.alike_ns
                    and now_ns - candidate.received_ns <= MAX_GAP_NS):
                break
        else:
            self._candidates.append(_Candidate(difference_ns, difference_ns, now_ns, now_ns))
            return False
        candidate.least_difference_ns = min(candidate.least_difference_ns, difference_ns)
        candidate.received_ns = now_ns
        lately = sum(now_ns - each.accepted_ns < HOUR_NS for each in self._others)
        if now_ns - candidate.first_ns < ACCEPTANCE_NS << min(lately, MAX_DOUBLINGS):
            return False
        self._candidates.remove(candidate)
        self._others.append(_Clock(
            candidate.least_difference_ns, now_ns, self.alike_ns, accepted_ns=now_ns))
        if len(self._others) > MAX_CLOCKS:
            self._others.remove(min(self._others, key=lambda each: each.received_ns))
        return True


def _first(pair: tuple[int, _Clock]) -> int:
    return pair[0]
