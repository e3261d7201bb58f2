"""Keys and joystick ask for the twist that a hand means."""
import math

from diffdrive_ros.dashboard.steering import (
    BACKWARD,
    FORWARD,
    LEFT,
    of_keys,
    of_stick,
    RIGHT,
    within,
)
from hypothesis import given, strategies as st
import pytest

FASTEST = (0.37, 1.9)
UNIT = st.floats(-1.0, 1.0)


def test_keys_ask_for_their_directions():
    assert of_keys({FORWARD}, FASTEST) == (0.37, 0.0)
    assert of_keys({BACKWARD}, FASTEST) == (-0.37, 0.0)
    assert of_keys({LEFT}, FASTEST) == (0.0, 1.9)
    assert of_keys({FORWARD, RIGHT}, FASTEST) == (0.37, -1.9)


def test_opposite_keys_cancel_and_unknown_ones_do_nothing():
    assert of_keys({FORWARD, BACKWARD, LEFT, RIGHT, 'fly'}, FASTEST) == (0.0, 0.0)


def test_a_stick_at_its_ends_asks_for_the_fastest():
    assert of_stick((0.0, 1.0), FASTEST) == pytest.approx((0.37, 0.0))
    assert of_stick((-1.0, 0.0), FASTEST) == pytest.approx((0.0, 1.9))
    assert of_stick((0.0, -1.0), FASTEST) == pytest.approx((-0.37, 0.0))


def test_the_middle_of_a_stick_is_rest():
    assert of_stick((0.07, -0.07), FASTEST) == (0.0, 0.0)


@given(UNIT, UNIT)
def test_no_stick_asks_for_more_than_the_fastest(right, ahead):
    linear, angular = of_stick((right, ahead), FASTEST)
    assert math.hypot(linear / FASTEST[0], angular / FASTEST[1]) <= 1.0 + 1e-9


@given(st.floats(0.0, 2.0 * math.pi), UNIT, UNIT)
def test_further_out_is_never_slower(angle, a, b):
    near, far = sorted((abs(a), abs(b)))
    speed = [math.hypot(*of_stick((way * math.cos(angle), way * math.sin(angle)), (1.0, 1.0)))
             for way in (near, far)]
    assert speed[0] <= speed[1] + 1e-9


@pytest.mark.parametrize('stick', [(math.nan, 0.0), (0.0, math.inf), (1.0,), ('x', 0.0)])
def test_a_stick_that_is_none_is_refused(stick):
    with pytest.raises(ValueError):  # noqa: PT011, whichever of them
        of_stick(stick, FASTEST)


@given(st.floats(-50.0, 50.0), st.floats(-50.0, 50.0))
def test_a_twist_is_slowed_down_without_bending_its_curve(linear, angular):
    slow = within((linear, angular), FASTEST)
    assert abs(slow[0]) <= FASTEST[0] * (1 + 1e-9)
    assert abs(slow[1]) <= FASTEST[1] * (1 + 1e-9)
    assert slow[0] * angular == pytest.approx(slow[1] * linear, abs=1e-9)
