"""Test the latency of messages: clock offsets, backlogs, jitter and drift."""
import random

from diffdrive_ros.core.lateness import Lateness
from hypothesis import assume, given, strategies as st
import pytest

MS, S = 1_000_000, 1_000_000_000
START = 10**5 * S
WALL = 1_700_000_000 * S  # offset of the wall clock from the monotonic clock

# Clock offset of a sender [ns]: none, or a large one.
clocks = st.integers(-10**14, -4000 * S) | st.just(0) | st.integers(4000 * S, 10**17)


class Sender:
    """A sender of messages; its clock offset may be changed."""

    def __init__(self, lateness: Lateness, clock: int = 0) -> None:
        self.lateness, self.clock = lateness, clock

    def latency(self, at: int, transit: int = 3 * MS) -> int:
        """Return the latency of a message received at a time."""
        return self.receive(at, transit)[0]

    def receive(self, at: int, transit: int = 3 * MS) -> tuple[int, int]:
        """Return that, and the clock offset that the message makes accepted."""
        return self.lateness.of(at - transit + WALL + self.clock, at, at + WALL)

    def latencies(self, arrivals: range, transit: int = 3 * MS) -> list[int]:
        """Return the latencies of messages with the same transit time."""
        return [self.latency(at, transit) for at in arrivals]


def accepted_sender(clock: int = 0) -> Sender:
    """Return a sender with an accepted clock offset, at START + 5 s."""
    sender = Sender(Lateness(), clock)
    sender.latencies(range(START, START + 5 * S, 100 * MS))
    return sender


@given(st.integers(0, 3600 * S))
def test_first_message_of_a_synchronous_sender_has_its_latency(late: int) -> None:
    """No earlier message is needed for the latency of a delayed one."""
    assert Sender(Lateness()).latency(START, late) == late


@given(clocks, st.lists(st.integers(0, 50 * MS), min_size=1, max_size=50))
def test_messages_of_similar_latency_are_not_late(clock: int, transits: list[int]) -> None:
    """With any accepted clock offset, and any jitter of the transit."""
    sender = accepted_sender(clock)
    for k, transit in enumerate(transits):
        assert sender.latency(START + 5 * S + k * 100 * MS, transit) <= 50 * MS


@given(st.integers(210 * MS, 10**17), st.sampled_from([-1, 1]))
def test_clock_offset_is_accepted_after_a_second(apart: int, sign: int) -> None:
    """Until then its messages are late or early, because they could be a backlog."""
    sender = Sender(Lateness(), sign * apart)
    received = [sender.receive(at) for at in range(START, START + 3 * S, 100 * MS)]
    late = 3 * MS - sign * apart
    assert set(received[:10]) == {(late, 0)}
    assert received[10] == (0, late)
    assert set(received[11:]) == {(0, 0)}


# After an hour without a message, here from 100 ms before the link loss on, a clock is discarded.
@given(clocks, st.integers(210 * MS, 3600 * S - 100 * MS - 1))
def test_delayed_message_is_late_by_its_delay(clock: int, kept: int) -> None:
    """Deliver a message from before a link loss; the next one is on time."""
    sender = accepted_sender(clock)
    at = START + 5 * S + kept
    drift = min(5e-4 * (kept + S), 100 * MS)
    assert sender.latency(at, kept) == pytest.approx(kept, abs=3 * MS + drift)
    assert sender.latency(at + 100 * MS) <= 3 * MS


@given(clocks, st.integers(2, 30), st.integers(1 * S, 60 * S), st.integers(0, 4))
def test_burst_of_delayed_messages_is_late_to_the_last(
        clock: int, count: int, kept: int, bursts: int) -> None:
    """The latencies of a full queue decrease, so no clock offset is accepted."""
    sender = accepted_sender(clock)
    now = START + 5 * S
    for _ in range(bursts):
        now += count * 100 * MS + kept
        for k in range(count):
            assert sender.latency(now + k * MS, (count - k) * 100 * MS + kept) >= kept - 100 * MS


@pytest.mark.parametrize('pace', [1.3, 1.5, 2.0, 3.0, 5.0])
@pytest.mark.parametrize('stall', [2, 10, 30])
def test_backlog_is_late_until_it_is_empty(stall: int, pace: float) -> None:
    """The latency decreases from message to message for more than a second."""
    lateness = Lateness()
    Sender(lateness).latencies(range(START, START + 5 * S, 50 * MS))
    begin = START + 5 * S
    for k in range(round(20 * stall * pace / (pace - 1.0))):
        sent, at = begin + 50 * k * MS, begin + stall * S + round(50 * k / pace) * MS
        late, _ = lateness.of(sent + WALL, at, at + WALL)
        assert late > at - sent - 650 * MS or at - sent < 200 * MS


def test_burst_does_not_change_an_accepted_clock_offset() -> None:
    """An offset of 3 s accepted hours before does not hide a backlog of that latency."""
    sender = Sender(Lateness())
    sender.latencies(range(START, START + 2 * S, 50 * MS), 3 * S)
    for hours in range(5):
        sender.latency(START + 10 * S + hours * 1800 * S)
    now = START + 5 * 3600 * S
    for k in range(70):
        kept = 3550 * MS - 50 * k * MS
        assert sender.latency(now + k * MS, kept) >= kept - 10 * MS


def test_messages_after_repeated_link_losses_are_late() -> None:
    """Also if each loss is as long as the one before."""
    sender = Sender(Lateness())
    for begin in range(START, START + 100 * S, 10 * S):
        assert max(sender.latencies(range(begin, begin + 2 * S, 100 * MS))) == 3 * MS
        assert sender.latency(begin + 9 * S, 7 * S) == 7 * S


@pytest.mark.parametrize('growth', [0.05, 0.1, 0.2, 0.3, 0.5, 0.8])
def test_filling_queue_hides_at_most_a_second_of_latency(growth: float) -> None:
    """At any growth, so that the age of applied commands is bounded."""
    lateness, worst = Lateness(), 0
    for sent in range(START, START + 120 * S, 50 * MS):
        transit = round(growth * (sent - START))
        late, _ = lateness.of(sent + WALL, sent + transit, sent + transit + WALL)
        worst = max(worst, transit - late)
    assert worst < 1.1 * S


@given(clocks, st.integers(-3600 * S, 3600 * S))
def test_clock_jump_is_accepted_after_two_seconds(clock: int, by: int) -> None:
    """One second as for any offset, and one more because an offset was accepted before."""
    sender = accepted_sender(clock)
    sender.clock += by
    after = sender.latencies(range(START + 5 * S, START + 9 * S, 100 * MS))
    assert max(map(abs, after[20:])) <= 210 * MS


def test_message_from_the_future_makes_no_later_one_late() -> None:
    """One wrong stamp is no clock offset."""
    sender = Sender(Lateness())
    sender.latencies(range(START, START + 5 * S, 100 * MS))
    sender.clock = 10 * S
    assert sender.latency(START + 5 * S) == -10 * S + 3 * MS
    sender.clock = 0
    arrivals = range(START + 5 * S + 100 * MS, START + 9 * S, 100 * MS)
    assert sender.latencies(arrivals) == [3 * MS] * 39


@given(st.integers(0, 10**6), st.floats(0.0, 0.5), st.integers(60, 150), st.floats(0.0, 0.3))
def test_jitter_does_not_hide_delayed_messages(
        seed: int, share: float, jitter: int, loss: float) -> None:
    """A synchronous sender on a poor link does not hide a message delayed by 8 s."""
    draw, lateness = random.Random(seed), Lateness()
    sender = Sender(lateness)
    for at in range(START, START + 10 * S, 20 * MS):
        if draw.random() >= loss:
            late = draw.random() < share
            sender.latency(at, 2 * MS + (draw.randrange(jitter * MS) if late else 0))
    assert sender.latency(START + 10 * S, 8 * S) == 8 * S


@given(st.integers(0, 10**6), st.sampled_from([-3 * S, -7200 * S, 3 * S]), st.floats(0.0, 0.3))
def test_two_senders_with_clock_offsets_are_both_accepted(
        seed: int, apart: int, loss: float) -> None:
    """With any loss, and jitter of some tenths of a second as of Wi-Fi."""
    draw, lateness = random.Random(seed), Lateness()
    senders = Sender(lateness), Sender(lateness, apart)
    received = [START, START]
    for at in range(START, START + 20 * S, 50 * MS):
        for index, sender in enumerate(senders):
            if draw.random() >= loss:
                if abs(sender.latency(at, draw.randrange(150 * MS))) < 400 * MS:
                    received[index] = at
                assert at - received[index] < 4 * S


@given(st.lists(st.integers(0, 200 * MS), min_size=31, max_size=31))
def test_jitter_does_not_prevent_a_clock_offset(transits: list[int]) -> None:
    """The jitter is up to 0.2 s, as of Wi-Fi."""
    sender = Sender(Lateness(), -2 * S)
    for k, transit in enumerate(transits):
        assert sender.latency(START + k * 100 * MS, transit) <= 250 * MS or k <= 12


def test_message_without_stamp_is_not_late() -> None:
    """Middlewares may leave out the source timestamp."""
    for at in range(START, START + 9 * S, S):
        assert Lateness().of(0, at, at + WALL) == (0, 0)


@pytest.mark.parametrize('idle', [600, 3600, 36000])
def test_idle_time_hides_no_latency(idle: int) -> None:
    """Clocks do not drift by a second within hours."""
    sender = accepted_sender(-5 * S)
    assert sender.latency(START + (5 + idle) * S + 1500 * MS, 1500 * MS) > 1300 * MS


def test_wall_clock_jump_makes_no_local_sender_late() -> None:
    """The clock jumps by an hour, as at the first synchronization by NTP."""
    lateness = Lateness()
    for set_by in 0, 3600 * S, -3600 * S:
        for at in range(START, START + S, 100 * MS):
            assert lateness.of(at + WALL + set_by, at + MS, at + MS + WALL + set_by) == (MS, 0)


@given(clocks, st.floats(-4e-4, 4e-4))
def test_clock_drift_is_tracked_for_hours(clock: int, drift: float) -> None:
    """A drift of 4e-4 is more than that of any free-running clock."""
    assume(clock)
    sender = accepted_sender(clock)
    for at in range(START + 5 * S, START + 4 * 3600 * S, 10 * S):
        sender.clock = clock + round(drift * (at - START - 5 * S))
        assert abs(sender.latency(at)) <= 50 * MS


@given(st.lists(st.tuples(clocks, st.integers(0, S)), max_size=60))
def test_at_most_eight_clock_offsets_are_kept(messages: list[tuple[int, int]]) -> None:
    """With any stamps."""
    lateness, now = Lateness(), START
    for clock, later in messages:
        for _ in range(4):
            now += later
            lateness.of(now + WALL + clock, now, now + WALL)
            assert len(lateness._others) <= 8
            assert len(lateness._candidates) <= 8
