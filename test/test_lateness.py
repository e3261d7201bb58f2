"""How late a message is, by clocks that need not agree: what is believed, and what is not."""
from diffdrive_ros.lateness import Lateness
from hypothesis import given, strategies as st
import pytest

MS, S = 1_000_000, 1_000_000_000
START = 10**5 * S

clocks = st.integers(-10**12, 2 * 10**18)  # what a sender's clock shows more than ours [ns]


class Talker:
    """One who sends, and counts what it sends; its clock may be set."""

    def __init__(self, lateness: Lateness, clock: int = 0, sequence: int = 0) -> None:
        self.lateness, self.clock, self.sequence = lateness, clock, sequence

    def say(self, at: int, transit: int = 3 * MS) -> int:
        """Return how late a message is that arrives at a time."""
        return self.hear(at, transit)[0]

    def hear(self, at: int, transit: int = 3 * MS) -> tuple[int, int]:
        """Return that, and of how late a one a new clock is believed."""
        self.sequence += 1
        return self.lateness.of(at - transit + self.clock, self.sequence, at)

    def talk(self, arrivals: range, transit: int = 3 * MS) -> list[int]:
        """Return how late messages are that all took as long."""
        return [self.say(at, transit) for at in arrivals]


@given(clocks, st.lists(st.integers(0, 50 * MS), max_size=50))
def test_nobody_is_late_whose_messages_take_about_as_long(clock: int, transits: list[int]) -> None:
    """However wrong the clock is, and however the transit trembles."""
    talker = Talker(Lateness(), clock)
    for k, transit in enumerate(transits):
        assert talker.say(START + k * 100 * MS, transit) <= 50 * MS


@given(clocks, st.integers(60 * MS, 3600 * S))
def test_what_was_kept_back_is_late_by_that(clock: int, kept: int) -> None:
    """DDS sends again what was sent before a link broke; the next message is as ever."""
    talker = Talker(Lateness(), clock)
    talker.talk(range(START, START + 5 * S, 100 * MS))
    at = START + 5 * S + kept
    drift = min(5e-4 * (kept + S), 100 * MS)
    assert talker.say(at + 3 * MS, kept + 3 * MS) == pytest.approx(kept, abs=drift)
    assert talker.say(at + 103 * MS) == 0


@given(clocks, st.integers(2, 30), st.integers(1 * S, 60 * S), st.integers(0, 2))
def test_a_burst_of_what_was_kept_back_is_late_to_the_last(
        clock: int, count: int, kept: int, bursts: int) -> None:
    """A full queue arrives at once, each message a little less late; none is believed for it."""
    talker = Talker(Lateness(), clock)
    talker.talk(range(START, START + 5 * S, 100 * MS))
    now = START + 5 * S
    for _ in range(bursts):
        now += count * 100 * MS + kept
        for k in range(count):
            assert talker.say(now + k * MS, (count - k) * 100 * MS + kept) >= kept - 50 * MS


def test_one_by_one_after_each_of_several_cuts_is_late_each_time() -> None:
    """By the same time even: between the cuts the sender is punctual, so its clock is the same."""
    talker = Talker(Lateness())
    for begin in range(START, START + 100 * S, 10 * S):
        assert max(talker.talk(range(begin, begin + 2 * S, 100 * MS))) == 0
        assert talker.say(begin + 9 * S, 7 * S) == pytest.approx(7 * S, abs=10 * MS)


@given(clocks, st.integers(100 * MS, 3600 * S))
def test_a_clock_that_is_set_back_is_believed_after_a_second(clock: int, back: int) -> None:
    """Until then its messages look late; who speaks on, by the same, is there."""
    talker = Talker(Lateness(), clock)
    talker.talk(range(START, START + 5 * S, 100 * MS))
    talker.clock -= back
    after = [talker.hear(at) for at in range(START + 5 * S, START + 8 * S, 100 * MS)]
    assert min(late for late, _ in after[:10]) > 50 * MS
    assert after[10] == (0, pytest.approx(back, abs=10 * MS))
    assert max(after[11:]) == (0, 0)


@given(clocks, st.integers(100 * MS, 3600 * S))
def test_a_clock_that_is_set_forward_is_believed_at_once(clock: int, by: int) -> None:
    """What comes too early cannot be late."""
    talker = Talker(Lateness(), clock)
    talker.talk(range(START, START + 5 * S, 100 * MS))
    talker.clock += by
    assert talker.talk(range(START + 5 * S, START + 6 * S, 100 * MS)) == [0] * 10


def test_one_message_from_the_future_makes_none_after_it_late() -> None:
    """One wrong stamp is no clock; two are."""
    talker = Talker(Lateness())
    talker.talk(range(START, START + 5 * S, 100 * MS))
    talker.clock = 10 * S
    assert talker.say(START + 5 * S) == 0
    talker.clock = 0
    assert talker.talk(range(START + 5 * S + 100 * MS, START + 9 * S, 100 * MS)) == [0] * 39


@given(clocks, clocks, st.integers(0, 10**6), st.integers(0, 10**6), st.integers(0, 100 * S))
def test_senders_with_clocks_of_their_own_are_heard_in_turn(
        one: int, other: int, first: int, second: int, pause: int) -> None:
    """A new one is believed at its first word, whenever it comes, if its numbers are its own."""
    lateness = Lateness()
    talkers = Talker(lateness, one, first), Talker(lateness, other, second)
    talkers[0].talk(range(START, START + 5 * S, 100 * MS))
    at = START + 5 * S + pause
    talkers[0].say(at)
    word = talkers[1].say(at + MS)
    assert word <= 50 * MS or 0 < second + 1 - talkers[0].sequence <= 105
    late = [talker.say(at + k * 100 * MS) for k in range(1, 50) for talker in talkers]
    assert max(late[30:]) <= 50 * MS


@given(st.integers(600 * MS, 20 * S), st.integers(0, 20 * S))
def test_another_sender_with_another_clock_excuses_none(kept: int, behind: int) -> None:
    """Not even if it is behind by what a message of the first was kept back."""
    lateness = Lateness()
    talkers = Talker(lateness), Talker(lateness, -behind, 5000)
    for at in range(START, START + 5 * S, 100 * MS):
        assert [talker.say(at) for talker in talkers] == [0, 0]
    assert talkers[0].say(START + 5 * S + kept, kept) >= kept - 50 * MS


@given(clocks, st.integers(0, 3 * S), st.integers(600 * MS, 20 * S))
def test_a_first_word_that_was_late_excuses_none_after_it(
        clock: int, first: int, kept: int) -> None:
    """The messages after it show that the clock is not so slow."""
    talker = Talker(Lateness(), clock)
    talker.say(START, first)
    talker.talk(range(START + 100 * MS, START + 5 * S, 100 * MS))
    for begin in range(START + 5 * S, START + 100 * S, 30 * S):
        assert talker.say(begin + kept, kept) >= kept - 100 * MS
        talker.talk(range(begin + kept + S, begin + 30 * S, 100 * MS))


@given(st.integers(600 * MS, 3600 * S), st.integers(60 * MS, 20 * S))
def test_a_sender_whose_clock_was_set_back_may_tap(apart: int, back: int) -> None:
    """Or plan slowly: the third word that is late alike is believed, however far apart."""
    talker = Talker(Lateness())
    talker.talk(range(START, START + 5 * S, 100 * MS))
    talker.clock = -back - 110 * MS
    late = talker.talk(range(START + 5 * S, START + 5 * S + 9 * apart, apart))
    assert max(late[2:]) <= 50 * MS


@given(st.lists(st.integers(0, 200 * MS), min_size=31, max_size=31))
def test_a_transit_that_trembles_hinders_no_belief(transits: list[int]) -> None:
    """Wi-Fi: up to a fifth of a second, and a clock that was set back."""
    talker = Talker(Lateness())
    talker.talk(range(START, START + 5 * S, 100 * MS))
    talker.clock = -2 * S
    for k, transit in enumerate(transits):
        assert talker.say(START + 5 * S + k * 100 * MS, transit) <= 250 * MS or k <= 10


def test_who_does_not_tell_when_it_was_sent_or_its_number_is_not_late() -> None:
    """A middleware need not."""
    lateness = Lateness()
    for at in range(START, START + 9 * S, S):
        assert lateness.of(0, 7, at) == (0, 0)
        assert lateness.of(START, None, at) == (0, 0)


@pytest.mark.parametrize('idle', [600, 3600, 36000])
def test_to_be_idle_for_long_excuses_nothing(idle: int) -> None:
    """Clocks do not drift by a second within hours."""
    talker = Talker(Lateness())
    end = START + 5 * S
    talker.talk(range(START, end, 100 * MS))
    assert talker.say(end + idle * S + 1500 * MS, 1500 * MS) > 1300 * MS


def test_an_excuse_ends_where_it_is_not_needed() -> None:
    """A buffer was full for seconds; when it is empty, what is so late is late again."""
    talker = Talker(Lateness())
    talker.talk(range(START, START + 5 * S, 100 * MS))
    assert talker.talk(range(START + 5 * S, START + 8 * S, 100 * MS), 5 * S)[-1] == 0
    talker.talk(range(START + 8 * S, START + 9 * S, 100 * MS))
    assert talker.say(START + 14 * S, 5 * S) > 4.9 * S


@given(clocks, st.floats(-4e-4, 4e-4))
def test_clocks_that_drift_are_followed_for_hours(clock: int, drift: float) -> None:
    """By four ten-thousandths, more than any that is left to itself."""
    talker = Talker(Lateness())
    for at in range(START, START + 4 * 3600 * S, 10 * S):
        talker.clock = clock + round(drift * (at - START))
        assert talker.say(at) <= 50 * MS


@given(st.lists(st.tuples(clocks, st.integers(0, S), st.integers(0, 300)), max_size=60))
def test_any_times_give_a_lateness_that_is_not_negative(
        messages: list[tuple[int, int, int]]) -> None:
    """Whatever clocks and numbers say; and no more than eight senders are remembered."""
    lateness, now = Lateness(), START
    for clock, later, sequence in messages:
        now += later
        assert min(lateness.of(now + clock, sequence, now)) >= 0
        assert len(lateness._senders) <= 8
