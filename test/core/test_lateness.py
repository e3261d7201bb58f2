"""How late a message is, by clocks that need not agree: what is believed, and what is not."""
import random

from diffdrive_ros.core.lateness import Lateness
from hypothesis import assume, given, strategies as st
import pytest

MS, S = 1_000_000, 1_000_000_000
START = 10**5 * S
WALL = 1_700_000_000 * S  # what this computer's clock shows more than the steady one

# What a sender's clock shows more than this computer's [ns]: nothing, or clearly something.
clocks = st.integers(-10**14, -4000 * S) | st.just(0) | st.integers(4000 * S, 10**17)


class Talker:
    """One who sends; its clock may be set."""

    def __init__(self, lateness: Lateness, clock: int = 0) -> None:
        self.lateness, self.clock = lateness, clock

    def say(self, at: int, transit: int = 3 * MS) -> int:
        """Return how late a message is that arrives at a time."""
        return self.hear(at, transit)[0]

    def hear(self, at: int, transit: int = 3 * MS) -> tuple[int, int]:
        """Return that, and of how late a one another clock is believed."""
        return self.lateness.of(at - transit + WALL + self.clock, at, at + WALL)

    def talk(self, arrivals: range, transit: int = 3 * MS) -> list[int]:
        """Return how late messages are that all took as long."""
        return [self.say(at, transit) for at in arrivals]


def known(clock: int = 0) -> Talker:
    """Return one whose clock is known, at START + 5 s."""
    talker = Talker(Lateness(), clock)
    talker.talk(range(START, START + 5 * S, 100 * MS))
    return talker


@given(st.integers(0, 3600 * S))
def test_first_message_of_a_synchronous_sender_has_its_latency(late: int) -> None:
    """Nobody has to be heard first to be told from what was kept back."""
    assert Talker(Lateness()).say(START, late) == late


@given(clocks, st.lists(st.integers(0, 50 * MS), min_size=1, max_size=50))
def test_messages_of_similar_latency_are_not_late(clock: int, transits: list[int]) -> None:
    """However wrong the clock is, once it is known, and however the transit trembles."""
    talker = known(clock)
    for k, transit in enumerate(transits):
        assert talker.say(START + 5 * S + k * 100 * MS, transit) <= 50 * MS


@given(st.integers(210 * MS, 10**17), st.sampled_from([-1, 1]))
def test_clock_offset_is_accepted_after_a_second(apart: int, sign: int) -> None:
    """Until then its messages are late, or early: they might be what was kept back."""
    talker = Talker(Lateness(), sign * apart)
    heard = [talker.hear(at) for at in range(START, START + 3 * S, 100 * MS)]
    late = 3 * MS - sign * apart
    assert set(heard[:10]) == {(late, 0)}
    assert heard[10] == (0, late)
    assert set(heard[11:]) == {(0, 0)}


# After an hour without a message, here from 100 ms before the link loss on, a clock is discarded.
@given(clocks, st.integers(210 * MS, 3600 * S - 100 * MS - 1))
def test_delayed_message_is_late_by_its_delay(clock: int, kept: int) -> None:
    """Deliver a message from before a link loss; the next one is on time."""
    talker = known(clock)
    at = START + 5 * S + kept
    drift = min(5e-4 * (kept + S), 100 * MS)
    assert talker.say(at, kept) == pytest.approx(kept, abs=3 * MS + drift)
    assert talker.say(at + 100 * MS) <= 3 * MS


@given(clocks, st.integers(2, 30), st.integers(1 * S, 60 * S), st.integers(0, 4))
def test_burst_of_delayed_messages_is_late_to_the_last(
        clock: int, count: int, kept: int, bursts: int) -> None:
    """A full queue arrives at once, each message a little less late; none is believed for it."""
    talker = known(clock)
    now = START + 5 * S
    for _ in range(bursts):
        now += count * 100 * MS + kept
        for k in range(count):
            assert talker.say(now + k * MS, (count - k) * 100 * MS + kept) >= kept - 100 * MS


@pytest.mark.parametrize('pace', [1.3, 1.5, 2.0, 3.0, 5.0])
@pytest.mark.parametrize('stall', [2, 10, 30])
def test_backlog_is_late_until_it_is_empty(stall: int, pace: float) -> None:
    """Each message is a little less late than the one before, for longer than a second."""
    lateness = Lateness()
    Talker(lateness).talk(range(START, START + 5 * S, 50 * MS))
    begin = START + 5 * S
    for k in range(round(20 * stall * pace / (pace - 1.0))):
        sent, at = begin + 50 * k * MS, begin + stall * S + round(50 * k / pace) * MS
        late, _ = lateness.of(sent + WALL, at, at + WALL)
        assert late > at - sent - 650 * MS or at - sent < 200 * MS


def test_burst_does_not_change_an_accepted_clock_offset() -> None:
    """A link was 3 s slow for a while; hours later what was kept back is no sign of that."""
    talker = Talker(Lateness())
    talker.talk(range(START, START + 2 * S, 50 * MS), 3 * S)
    for hours in range(5):
        talker.say(START + 10 * S + hours * 1800 * S)
    now = START + 5 * 3600 * S
    for k in range(70):
        kept = 3550 * MS - 50 * k * MS
        assert talker.say(now + k * MS, kept) >= kept - 10 * MS


def test_messages_after_repeated_link_losses_are_late() -> None:
    """By the same time even."""
    talker = Talker(Lateness())
    for begin in range(START, START + 100 * S, 10 * S):
        assert max(talker.talk(range(begin, begin + 2 * S, 100 * MS))) == 3 * MS
        assert talker.say(begin + 9 * S, 7 * S) == 7 * S


@pytest.mark.parametrize('growth', [0.05, 0.1, 0.2, 0.3, 0.5, 0.8])
def test_filling_queue_hides_at_most_a_second_of_latency(growth: float) -> None:
    """However slowly: what is driven would else be older and older."""
    lateness, worst = Lateness(), 0
    for sent in range(START, START + 120 * S, 50 * MS):
        transit = round(growth * (sent - START))
        late, _ = lateness.of(sent + WALL, sent + transit, sent + transit + WALL)
        worst = max(worst, transit - late)
    assert worst < 1.1 * S


@given(clocks, st.integers(-3600 * S, 3600 * S))
def test_clock_jump_is_accepted_after_two_seconds(clock: int, by: int) -> None:
    """One second as any, and one more for the clock that was believed before."""
    talker = known(clock)
    talker.clock += by
    after = talker.talk(range(START + 5 * S, START + 9 * S, 100 * MS))
    assert max(map(abs, after[20:])) <= 210 * MS


def test_message_from_the_future_makes_no_later_one_late() -> None:
    """One wrong stamp is no clock."""
    talker = Talker(Lateness())
    talker.talk(range(START, START + 5 * S, 100 * MS))
    talker.clock = 10 * S
    assert talker.say(START + 5 * S) == -10 * S + 3 * MS
    talker.clock = 0
    assert talker.talk(range(START + 5 * S + 100 * MS, START + 9 * S, 100 * MS)) == [3 * MS] * 39


@given(st.integers(0, 10**6), st.floats(0.0, 0.5), st.integers(60, 150), st.floats(0.0, 0.3))
def test_jitter_does_not_hide_delayed_messages(
        seed: int, share: float, jitter: int, loss: float) -> None:
    """Two who keep the time, one of them on a poor link, and a word of the other 8 s old."""
    draw, lateness = random.Random(seed), Lateness()
    talker = Talker(lateness)
    for at in range(START, START + 10 * S, 20 * MS):
        if draw.random() >= loss:
            late = draw.random() < share
            talker.say(at, 2 * MS + (draw.randrange(jitter * MS) if late else 0))
    assert talker.say(START + 10 * S, 8 * S) == 8 * S


@given(st.integers(0, 10**6), st.sampled_from([-3 * S, -7200 * S, 3 * S]), st.floats(0.0, 0.3))
def test_two_senders_with_clock_offsets_are_both_accepted(
        seed: int, apart: int, loss: float) -> None:
    """Whatever the link does to them, within the tenths of a second that Wi-Fi trembles by."""
    draw, lateness = random.Random(seed), Lateness()
    talkers = Talker(lateness), Talker(lateness, apart)
    heard = [START, START]
    for at in range(START, START + 20 * S, 50 * MS):
        for index, talker in enumerate(talkers):
            if draw.random() >= loss:
                if abs(talker.say(at, draw.randrange(150 * MS))) < 400 * MS:
                    heard[index] = at
                assert at - heard[index] < 4 * S


@given(st.lists(st.integers(0, 200 * MS), min_size=31, max_size=31))
def test_jitter_does_not_prevent_a_clock_offset(transits: list[int]) -> None:
    """Wi-Fi: up to a fifth of a second."""
    talker = Talker(Lateness(), -2 * S)
    for k, transit in enumerate(transits):
        assert talker.say(START + k * 100 * MS, transit) <= 250 * MS or k <= 12


def test_message_without_stamp_is_not_late() -> None:
    """A middleware need not."""
    for at in range(START, START + 9 * S, S):
        assert Lateness().of(0, at, at + WALL) == (0, 0)


@pytest.mark.parametrize('idle', [600, 3600, 36000])
def test_idle_time_hides_no_latency(idle: int) -> None:
    """Clocks do not drift by a second within hours."""
    talker = known(-5 * S)
    assert talker.say(START + (5 + idle) * S + 1500 * MS, 1500 * MS) > 1300 * MS


def test_wall_clock_jump_makes_no_local_sender_late() -> None:
    """By an hour, as when the network time comes at last."""
    lateness = Lateness()
    for set_by in 0, 3600 * S, -3600 * S:
        for at in range(START, START + S, 100 * MS):
            assert lateness.of(at + WALL + set_by, at + MS, at + MS + WALL + set_by) == (MS, 0)


@given(clocks, st.floats(-4e-4, 4e-4))
def test_clock_drift_is_tracked_for_hours(clock: int, drift: float) -> None:
    """By four ten-thousandths, more than any that is left to itself."""
    assume(clock)
    talker = known(clock)
    for at in range(START + 5 * S, START + 4 * 3600 * S, 10 * S):
        talker.clock = clock + round(drift * (at - START - 5 * S))
        assert abs(talker.say(at)) <= 50 * MS


@given(st.lists(st.tuples(clocks, st.integers(0, S)), max_size=60))
def test_at_most_eight_clock_offsets_are_kept(messages: list[tuple[int, int]]) -> None:
    """Whatever the stamps say."""
    lateness, now = Lateness(), START
    for clock, later in messages:
        for _ in range(4):
            now += later
            lateness.of(now + WALL + clock, now, now + WALL)
            assert len(lateness._others) <= 8
            assert len(lateness._candidates) <= 8
