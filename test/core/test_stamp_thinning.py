"""Thinning by timestamps, also where the clock steps."""
from diffdrive_ros.core.stamp_thinning import StampThinning
from hypothesis import given
from hypothesis.strategies import integers

HOUR_NS = 3600 * 10**9
START_NS = 10**18


def test_thinning_continues_after_the_clock_was_set_back() -> None:
    """As in open loop, where the timestamps are the clock's own."""
    thinning = StampThinning(10.0)
    due = [thinning.is_due(START_NS + k * 50_000_000) for k in range(5)]
    assert due == [True, False, True, False, True]
    before = [thinning.is_due(START_NS - HOUR_NS + k * 50_000_000) for k in range(3)]
    assert before == [True, False, True]


def test_thinning_selects_the_next_message_after_a_time_reset() -> None:
    thinning = StampThinning(10.0)
    assert [thinning.is_due(START_NS + k) for k in range(2)] == [True, False]
    thinning.reset_time()
    assert thinning.is_due(START_NS + 2)


@given(integers(1_000_000, 40_000_000))
def test_thinning_keeps_the_rate_of_a_faster_stream(period_ns: int) -> None:
    thinning = StampThinning(20.0)
    selected = sum(thinning.is_due(START_NS + k * period_ns) for k in range(2000))
    assert abs(selected - 2000 * period_ns / 50e6) <= 1.0 + 2000 * period_ns / 50e6 * 1e-3


def test_thinning_with_rate_zero_selects_every_message() -> None:
    thinning = StampThinning(0.0)
    assert [thinning.is_due(START_NS + step) for step in (0, 20, 20, -10)] == [True] * 4
