"""How late a message is, by clocks that need not agree: what is believed, and what is not."""
from diffdrive_ros.lateness import Lateness
from hypothesis import given, strategies as st
import pytest

MS, S = 1_000_000, 1_000_000_000
START = 10**5 * S

clocks = st.integers(-10**12, 2 * 10**18)  # what a sender's clock shows more than ours [ns]


def hear(lateness: Lateness, clock: int, arrivals: range, transit: int = 3 * MS) -> list[int]:
    """Return how late messages are that all took as long."""
    return [lateness.of(at - transit + clock, at) for at in arrivals]


@given(clocks, st.lists(st.integers(0, 50 * MS), max_size=50))
def test_nobody_is_late_whose_messages_take_about_as_long(clock: int, transits: list[int]) -> None:
    """However wrong the clock is, and however the transit trembles."""
    lateness = Lateness()
    for k, transit in enumerate(transits):
        at = START + k * 100 * MS
        assert lateness.of(at - transit + clock, at) <= 50 * MS


@given(clocks, st.integers(60 * MS, 3600 * S))
def test_what_was_kept_back_is_late_by_that(clock: int, kept: int) -> None:
    """DDS sends again what was sent before a link broke; the next message is as ever."""
    lateness = Lateness()
    hear(lateness, clock, range(START, START + 5 * S, 100 * MS))
    sent = START + 5 * S
    at = sent + kept + 3 * MS
    drift = min(5e-4 * (kept + S), 100 * MS)
    assert lateness.of(sent + clock, at) == pytest.approx(kept, abs=drift)
    assert lateness.of(at + 100 * MS + clock, at + 103 * MS) == 0


@given(clocks, st.integers(2, 30), st.integers(1 * S, 60 * S))
def test_a_burst_of_what_was_kept_back_is_late_to_the_last(
        clock: int, count: int, kept: int) -> None:
    """A full queue arrives at once, each message a little less late; none is confirmed by it."""
    lateness = Lateness()
    hear(lateness, clock, range(START, START + 5 * S, 100 * MS))
    cut, back = START + 5 * S, START + 5 * S + count * 100 * MS + kept
    for k in range(count):
        assert lateness.of(cut + k * 100 * MS + clock, back + k * MS) >= kept - 50 * MS


def test_a_sender_is_new_until_its_first_word() -> None:
    """What it says late after that is late."""
    senders = iter([True, False])
    lateness = Lateness()
    assert lateness.of(START, START + 3 * MS, lambda: next(senders)) == 0
    assert lateness.of(START + MS, START + S, lambda: next(senders)) > 0.9 * S


def test_one_by_one_after_each_of_several_cuts_is_late_each_time() -> None:
    """By the same time even: that is no clock, for a clock goes on to speak."""
    lateness = Lateness()
    for begin in range(START, START + 100 * S, 20 * S):
        assert max(hear(lateness, 0, range(begin, begin + 5 * S, 100 * MS))) == 0
        assert lateness.of(begin + 5 * S, begin + 12 * S) == pytest.approx(7 * S, abs=10 * MS)


@given(clocks, st.integers(100 * MS, 3600 * S))
def test_a_clock_that_is_set_back_is_believed_after_a_second(clock: int, back: int) -> None:
    """Until then its messages look late; who speaks on, by the same, is there."""
    lateness = Lateness()
    hear(lateness, clock, range(START, START + 5 * S, 100 * MS))
    after = hear(lateness, clock - back, range(START + 5 * S, START + 8 * S, 100 * MS))
    assert min(after[:10]) > 50 * MS
    assert max(after[11:]) == 0


@given(clocks, st.integers(100 * MS, 3600 * S))
def test_a_clock_that_is_set_forward_is_believed_at_once(clock: int, by: int) -> None:
    """What comes too early cannot be late."""
    lateness = Lateness()
    hear(lateness, clock, range(START, START + 5 * S, 100 * MS))
    assert hear(lateness, clock + by, range(START + 5 * S, START + 6 * S, 100 * MS)) == [0] * 10


@given(clocks, clocks)
def test_two_senders_with_clocks_of_their_own_are_heard_in_turn(one: int, other: int) -> None:
    """A new sender is believed at its first word; both keep their clocks."""
    lateness = Lateness()
    hear(lateness, one, range(START, START + 5 * S, 100 * MS))
    at = START + 5 * S
    lateness.of(at - 3 * MS + other, at, lambda: True)
    for k in range(1, 50):
        for clock in one, other:
            assert lateness.of(at + k * 100 * MS - 3 * MS + clock, at + k * 100 * MS) <= 50 * MS


@given(clocks, st.integers(0, 3 * S), st.integers(600 * MS, 20 * S))
def test_a_first_word_that_was_late_excuses_none_after_it(
        clock: int, first: int, kept: int) -> None:
    """The messages after it show that the clock is not so slow."""
    lateness = Lateness()
    lateness.of(START - first + clock, START)
    hear(lateness, clock, range(START + 100 * MS, START + 5 * S, 100 * MS))
    for begin in range(START + 5 * S, START + 100 * S, 30 * S):
        assert lateness.of(begin + clock, begin + kept) >= kept - 100 * MS
        hear(lateness, clock, range(begin + kept + S, begin + 30 * S, 100 * MS))


def test_a_sender_whose_clock_was_set_back_may_tap() -> None:
    """Or plan slowly: three words that are late alike are enough, seconds apart."""
    lateness = Lateness()
    hear(lateness, 0, range(START, START + 5 * S, 100 * MS))
    taps = range(START + 5 * S, START + 15 * S, 1200 * MS)
    late = hear(lateness, -2 * S, taps)
    assert [late_ns > 0 for late_ns in late[:3]] == [True, True, False]
    assert max(late[2:]) == 0


def test_two_clocks_that_are_not_known_do_not_hinder_each_other() -> None:
    """Both are believed after a second."""
    lateness = Lateness()
    hear(lateness, 0, range(START, START + 5 * S, 100 * MS))
    for at in range(START + 5 * S, START + 8 * S, 100 * MS):
        for clock in -2 * S, -9 * S:
            late = lateness.of(at + clock, at)
            assert at < START + 6 * S + 200 * MS or late == 0


@given(st.lists(st.integers(0, 200 * MS), min_size=31, max_size=31))
def test_a_transit_that_trembles_hinders_no_belief(transits: list[int]) -> None:
    """Wi-Fi: up to a fifth of a second, and a clock that was set back."""
    lateness = Lateness()
    hear(lateness, 0, range(START, START + 5 * S, 100 * MS))
    for k, transit in enumerate(transits):
        at = START + 5 * S + k * 100 * MS
        late = lateness.of(at - transit - 2 * S, at)
        assert late <= 250 * MS or k <= 21


def test_who_does_not_tell_when_it_was_sent_is_not_late() -> None:
    """A writer of DDS need not."""
    lateness = Lateness()
    assert [lateness.of(0, at) for at in range(START, START + 9 * S, S)] == [0] * 9


@pytest.mark.parametrize('idle', [600, 3600, 36000])
def test_to_be_idle_for_long_excuses_nothing(idle: int) -> None:
    """Clocks do not drift by a second within hours."""
    lateness = Lateness()
    end = START + 5 * S
    hear(lateness, 0, range(START, end, 100 * MS))
    assert lateness.of(end + idle * S, end + idle * S + 1500 * MS) > 1300 * MS


def test_an_excuse_ends_where_it_is_not_needed() -> None:
    """A buffer was full for seconds; a minute after it is empty, what is so late is late again."""
    lateness = Lateness()
    hear(lateness, 0, range(START, START + 5 * S, 100 * MS))
    after = hear(lateness, 0, range(START + 5 * S, START + 8 * S, 100 * MS), transit=5 * S)
    assert after[-1] == 0
    assert lateness.doubtful_ns == pytest.approx(5 * S, abs=10 * MS)
    hear(lateness, 0, range(START + 8 * S, START + 80 * S, 100 * MS))
    assert lateness.of(START + 80 * S, START + 85 * S) > 4.9 * S


@given(clocks, st.floats(-4e-4, 4e-4))
def test_clocks_that_drift_are_followed_for_hours(clock: int, drift: float) -> None:
    """By four ten-thousandths, more than any that is left to itself."""
    lateness = Lateness()
    for at in range(START, START + 4 * 3600 * S, 10 * S):
        assert lateness.of(at - 3 * MS + clock + round(drift * (at - START)), at) <= 50 * MS


@given(st.lists(st.tuples(clocks, st.integers(0, S)), max_size=60))
def test_any_times_give_a_lateness_that_is_not_negative(messages: list[tuple[int, int]]) -> None:
    """Whatever clocks say; and no more than eight clocks are remembered."""
    lateness, now = Lateness(), START
    for clock, later in messages:
        now += later
        assert lateness.of(now + clock, now) >= 0
        assert len(lateness._clocks) <= 8
