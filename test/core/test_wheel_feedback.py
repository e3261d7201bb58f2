"""Wheel samples from joint messages: names, completeness, dropped values, velocities."""
import itertools
import math

from diffdrive_ros.core.wheel_feedback import WheelFeedback, WheelSample
from hypothesis import given, strategies as st
import pytest

SECOND = 10**9
EPOCH_NS = 1_700_000_000 * SECOND


def positions_of(**angles):
    """Return names, positions and velocities of a message with positions only."""
    return tuple(angles), tuple(angles.values()), ()


def velocities_of(**speeds):
    """Return names, positions and velocities of a message with velocities only."""
    return tuple(speeds), (), tuple(speeds.values())


@pytest.fixture
def two_wheels():
    return WheelFeedback(left_names=['left'], right_names=['right'])


@pytest.fixture
def four_wheels():
    return WheelFeedback(
        left_names=['front_left', 'rear_left'], right_names=['front_right', 'rear_right'])


@pytest.fixture
def by_velocity():
    return WheelFeedback(left_names=['left'], right_names=['right'], position_feedback=False)


# Names

@pytest.mark.parametrize('order', list(itertools.permutations(
    ['left', 'arm', 'right', 'gripper'])))
def test_wheels_are_found_by_name_in_any_order(two_wheels, order):
    angles = {'left': 1.25, 'arm': 8.0, 'right': -2.5, 'gripper': math.nan}
    message = positions_of(**{name: angles[name] for name in order})
    assert two_wheels.update(*message, 7) == WheelSample(1.25, -2.5, 7)
    assert two_wheels.warning == ''


def test_wheels_of_a_side_are_averaged(four_wheels):
    message = positions_of(rear_right=3.0, front_left=10.0, front_right=5.0, rear_left=20.0)
    assert four_wheels.update(*message, 7) == WheelSample(15.0, 4.0, 7)


def test_sides_with_different_numbers_of_wheels_are_accepted():
    feedback = WheelFeedback(left_names=['left'], right_names=['front', 'middle', 'rear'])
    message = positions_of(left=1.0, front=1.0, middle=2.0, rear=6.0)
    assert feedback.update(*message, 7) == WheelSample(1.0, 3.0, 7)


@pytest.mark.parametrize('message', [
    ((), (), ()), positions_of(arm=1.0, gripper=2.0), ((), (1.0, 2.0), ()), (('arm',), (), ())])
def test_messages_without_wheels_are_ignored(two_wheels, message):
    two_wheels.update(*positions_of(left=1.0, right=2.0), 7)
    assert two_wheels.update(*message, 8) is None
    assert two_wheels.warning == ''
    assert two_wheels.update(*positions_of(left=3.0, right=4.0), 9) == WheelSample(3.0, 4.0, 9)


def test_velocities_are_ignored_with_position_feedback(two_wheels):
    sample = two_wheels.update(['left', 'right'], [1.0, 2.0], [math.nan, 9.0], 7)
    assert sample == WheelSample(1.0, 2.0, 7)
    assert two_wheels.warning == ''


# Wheels in separate messages

def test_sample_is_complete_when_every_wheel_is_renewed(four_wheels):
    for number, name in enumerate(['rear_left', 'front_right', 'front_left']):
        assert four_wheels.update(*positions_of(**{name: 4.0}), number) is None
    assert four_wheels.update(*positions_of(rear_right=8.0), 3) == WheelSample(4.0, 6.0, 3)


def test_every_sample_needs_all_wheels_again(two_wheels):
    two_wheels.update(*positions_of(left=1.0, right=2.0), 7)
    assert two_wheels.update(*positions_of(left=3.0), 8) is None
    assert two_wheels.update(*positions_of(right=4.0), 9) == WheelSample(3.0, 4.0, 9)
    assert two_wheels.update(*positions_of(right=5.0), 10) is None


def test_wheel_renewed_twice_has_its_last_angle(two_wheels):
    two_wheels.update(*positions_of(left=1.0), 7)
    assert two_wheels.update(*positions_of(left=2.0), 8) is None
    assert two_wheels.update(*positions_of(right=4.0), 9) == WheelSample(2.0, 4.0, 9)


def test_sample_has_the_newest_stamp_of_its_messages(two_wheels):
    two_wheels.update(*positions_of(left=1.0), 200)
    assert two_wheels.update(*positions_of(right=2.0), 190) == WheelSample(1.0, 2.0, 200)


@given(st.permutations(range(8)))
def test_one_sample_is_returned_per_round_of_all_wheels(order):
    names = ['a', 'b', 'c', 'd'] * 2
    feedback = WheelFeedback(left_names=['a', 'b'], right_names=['c', 'd'])
    renewed, samples = set(), 0
    for stamp, index in enumerate(order):
        renewed.add(names[index])
        sample = feedback.update(*positions_of(**{names[index]: 1.0}), stamp)
        assert (sample is not None) == (len(renewed) == 4)
        if sample:
            assert sample == WheelSample(1.0, 1.0, stamp)
            renewed.clear()
            samples += 1
    assert samples >= 1


@given(st.lists(st.tuples(
    st.sampled_from([
        ('left', 'front', 'rear'), ('rear', 'left', 'front'), ('left',), ('front', 'rear'),
        ('left', 'left', 'front', 'rear'), ('arm',), ()]),
    st.lists(st.sampled_from([0.0, 1.5, -7.25, 9e11, 1e12, math.inf, math.nan]), max_size=4),
    st.integers(-1, 3) | st.integers(-3 * SECOND, 3 * SECOND))))
def test_cached_layout_gives_the_same_samples(messages):
    """Tuples of names have the fast path, lists never have."""
    tuples, lists = (
        WheelFeedback(left_names=['left'], right_names=['front', 'rear'], right_direction=-1)
        for _ in range(2))
    stamp_ns = EPOCH_NS
    for names, values, later_ns in messages:
        stamp_ns += later_ns
        sample = tuples.update(names, tuple(values), (), stamp_ns)
        assert sample == lists.update(list(names), values, [], stamp_ns)
        assert (tuples.warning, tuples.counts) == (lists.warning, lists.counts)
        assert tuples.missing_wheels == lists.missing_wheels


# Missing or invalid values

@pytest.mark.parametrize('value', [math.nan, math.inf, -math.inf, 1e12, -1e300])
def test_not_finite_positions_are_dropped_without_lost_motion(two_wheels, value):
    two_wheels.update(*positions_of(left=1.0, right=2.0), 7)
    assert two_wheels.update(*positions_of(left=value, right=3.0), 8) is None
    assert two_wheels.warning == f'left = {value}: must be finite and below 1e+12'
    assert two_wheels.update(*positions_of(left=3.0, right=4.0), 9) == WheelSample(3.0, 4.0, 9)
    assert two_wheels.warning == ''


def test_velocities_without_positions_name_the_parameter(two_wheels):
    assert two_wheels.update(['left', 'right'], [], [1.0, 2.0], 7) is None
    assert two_wheels.warning == (
        'wheels have velocities but no positions: set position_feedback to false, '
        'or let the driver publish positions')


def test_missing_value_names_the_wheel(two_wheels, by_velocity):
    assert two_wheels.update(['arm', 'left'], [], [], 7) is None
    assert two_wheels.warning == 'left has no position'
    assert by_velocity.update(['arm', 'left'], [1.0, 2.0], [], 7) is None
    assert by_velocity.warning == 'left has no velocity'


def test_message_with_one_bad_wheel_is_dropped_as_a_whole(two_wheels):
    assert two_wheels.update(['left', 'right'], [1.0], [], 7) is None
    assert two_wheels.warning == 'right has no position'
    assert two_wheels.update(['left', 'right'], [1.0, math.nan], [], 8) is None
    assert two_wheels.update(*positions_of(right=2.0), 9) is None
    assert two_wheels.update(*positions_of(left=3.0), 10) == WheelSample(3.0, 2.0, 10)


def test_joint_named_twice_turns_once(two_wheels):
    two_wheels.update(*positions_of(left=0.0, right=0.0), 1)
    sample = two_wheels.update(['left', 'right', 'left'], [1.0, 1.0, 1.0], [], 2)
    assert (sample.left, sample.right) == (1.0, 1.0)


def test_warning_is_of_the_last_message_with_wheels(two_wheels):
    two_wheels.update(['left'], [], [], 7)
    two_wheels.update(*positions_of(arm=1.0), 8)
    assert two_wheels.warning == 'left has no position'
    two_wheels.update(*positions_of(left=1.0), 9)
    assert two_wheels.warning == ''


# Velocities

def test_first_velocity_is_the_baseline(by_velocity):
    sample = by_velocity.update(*velocities_of(left=5.0, right=-7.0), EPOCH_NS)
    assert sample == WheelSample(0.0, 0.0, EPOCH_NS)


def test_velocity_is_integrated_since_the_last_message(by_velocity):
    by_velocity.update(*velocities_of(left=100.0, right=100.0), EPOCH_NS + 900_000_000)
    sample = by_velocity.update(
        *velocities_of(left=5.0, right=-7.0), EPOCH_NS + SECOND + 100_000_000)
    assert sample.left == pytest.approx(1.0, rel=1e-12)
    assert sample.right == pytest.approx(-1.4, rel=1e-12)
    sample = by_velocity.update(*velocities_of(left=1.0, right=2.0), EPOCH_NS + 2 * SECOND)
    assert sample.left == pytest.approx(1.9, rel=1e-12)
    assert sample.right == pytest.approx(0.4, rel=1e-12)


@pytest.mark.parametrize('late', [0, -1, -SECOND])
def test_out_of_order_velocities_are_ignored(by_velocity, late):
    by_velocity.update(*velocities_of(left=0.0, right=0.0), EPOCH_NS)
    by_velocity.update(*velocities_of(left=1.0, right=2.0), EPOCH_NS + SECOND)
    late_message = velocities_of(left=50.0, right=50.0)
    assert by_velocity.update(*late_message, EPOCH_NS + SECOND + late) is None
    message = velocities_of(left=1.0, right=2.0)
    sample = by_velocity.update(*message, EPOCH_NS + 2 * SECOND)
    assert sample == WheelSample(2.0, 4.0, EPOCH_NS + 2 * SECOND)


def test_each_wheel_is_integrated_over_its_own_interval(by_velocity):
    by_velocity.update(*velocities_of(left=0.0), EPOCH_NS)
    by_velocity.update(*velocities_of(right=0.0), EPOCH_NS + SECOND // 10)
    by_velocity.update(*velocities_of(left=10.0), EPOCH_NS + 4 * SECOND // 10)
    sample = by_velocity.update(*velocities_of(right=10.0), EPOCH_NS + 6 * SECOND // 10)
    assert (sample.left, sample.right) == pytest.approx((4.0, 5.0))
    assert sample.stamp_ns == EPOCH_NS + 6 * SECOND // 10


def test_velocity_after_a_dropped_one_covers_both_intervals(by_velocity):
    by_velocity.update(*velocities_of(left=1.0, right=1.0), EPOCH_NS)
    by_velocity.update(*velocities_of(left=math.nan, right=1.0), EPOCH_NS + SECOND // 2)
    sample = by_velocity.update(*velocities_of(left=1.0, right=1.0), EPOCH_NS + SECOND)
    assert sample == WheelSample(1.0, 1.0, EPOCH_NS + SECOND)


def test_positions_are_ignored_without_position_feedback(by_velocity):
    by_velocity.update(['left', 'right'], [9.0, math.nan], [0.0, 0.0], EPOCH_NS)
    sample = by_velocity.update(['left', 'right'], [9.0], [3.0, 4.0], EPOCH_NS + SECOND)
    assert sample == WheelSample(3.0, 4.0, EPOCH_NS + SECOND)
    assert by_velocity.warning == ''
