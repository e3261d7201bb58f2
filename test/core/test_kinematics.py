"""Test the laws of the kinematics of a differential drive."""
from dataclasses import FrozenInstanceError, replace
from functools import partial
import math
import re

from diffdrive_ros.core import se2
from diffdrive_ros.core.kinematics import desaturate, DiffDrive
from hypothesis import assume, example, given, strategies as st
import numpy as np
import pytest
from support.strategies import drives, twists

# No two of these numbers, nor their halves, doubles or inverses, can stand for each other.
ROBOT = DiffDrive(wheel_separation=0.317, left_wheel_radius=0.0471, right_wheel_radius=0.0533)
# Round numbers, for values by hand.
ROUND = DiffDrive(wheel_separation=0.4, left_wheel_radius=0.05, right_wheel_radius=0.1)

same = partial(np.testing.assert_allclose, rtol=1e-12, atol=1e-12)

speeds = st.floats(-50.0, 50.0)
any_speeds = st.floats(allow_nan=False, allow_infinity=False)
limits = st.floats(1e-3, 100.0)


# Directions and values by hand

def test_positive_wheel_speeds_drive_forward():
    linear, angular = ROBOT.body_twist(1.0 / 0.0471, 1.0 / 0.0533)
    same([linear, angular], [1.0, 0.0])


def test_faster_right_wheel_turns_left():
    assert ROBOT.body_twist(3.0, 4.0)[1] > 0.0


def test_larger_right_wheel_turns_left():
    assert ROBOT.body_twist(3.0, 3.0)[1] > 0.0


def test_left_turn_has_a_slower_left_wheel():
    straight, turning = ROBOT.wheel_speeds(0.5, 0.0), ROBOT.wheel_speeds(0.5, 0.8)
    assert turning[0] < straight[0]
    assert turning[1] > straight[1]


def test_turn_in_place_rolls_wheels_along_their_circle():
    left, right = ROBOT.wheel_speeds(0.0, 2.0 * math.pi)
    same(right * 0.0533, math.pi * 0.317)
    same(left * 0.0471, -math.pi * 0.317)


def test_left_wheel_at_the_centre_of_the_turn_stands_still():
    left, right = ROBOT.wheel_speeds(0.5 * 0.317, 1.0)
    same(left, 0.0)
    same(right * 0.0533, 0.317)


def test_speeds_equal_values_by_hand():
    # Rims at 0.5 and 0.2 m/s: the mean is 0.35, the difference -0.3 over 0.4 m.
    same(ROUND.body_twist(10.0, 2.0), [0.35, -0.75])
    same(ROUND.wheel_speeds(0.35, -0.75), [10.0, 2.0])
    same(ROUND.displacement(10.0, 2.0), [0.35, 0.0, -0.75])


def test_matrices_equal_values_by_hand():
    same(ROUND.wheel_jacobian, [[20.0, 0.0, -4.0], [10.0, 0.0, 2.0]])
    same(ROUND.body_jacobian, [[0.025, 0.05], [0.0, 0.0], [-0.125, 0.25]])


@given(drives, speeds, speeds)
def test_swapped_sides_turn_the_other_way(drive, left, right):
    mirrored = replace(
        drive, left_wheel_radius=drive.right_wheel_radius,
        right_wheel_radius=drive.left_wheel_radius)
    linear, angular = drive.body_twist(left, right)
    same(mirrored.body_twist(right, left), [linear, -angular])
    path = se2.exp(drive.displacement(left, right))
    same(se2.exp(mirrored.displacement(right, left)), path * [1.0, -1.0, -1.0])


@given(drives, speeds, speeds, st.floats(0.1, 10.0))
def test_scaled_robot_drives_faster_and_turns_equally(drive, left, right, scale):
    larger = DiffDrive(
        scale * drive.wheel_separation, scale * drive.left_wheel_radius,
        scale * drive.right_wheel_radius)
    linear, angular = drive.body_twist(left, right)
    same(larger.body_twist(left, right), [scale * linear, angular], atol=1e-9)


# Inverses

@given(drives, speeds, speeds)
def test_wheel_speeds_invert_body_twist(drive, left, right):
    same(drive.wheel_speeds(*drive.body_twist(left, right)), [left, right], atol=1e-10)


@given(drives, speeds, speeds)
def test_body_twist_inverts_wheel_speeds(drive, linear, angular):
    same(drive.body_twist(*drive.wheel_speeds(linear, angular)), [linear, angular], atol=1e-10)


def test_arrays_are_processed_elementwise():
    left, right = np.arange(12.0).reshape(3, 4), np.array([2.0, -3.0, 5.0, 7.0])
    for function in ROBOT.body_twist, ROBOT.wheel_speeds, partial(desaturate, limit=4.0):
        together = np.array(function(left, right))
        assert together.shape == (2, 3, 4)
        for row, column in np.ndindex(3, 4):
            single = function(left[row, column], right[column])
            assert together[:, row, column].tolist() == list(single)


def test_scalars_give_scalars():
    for function in ROBOT.body_twist, ROBOT.wheel_speeds, partial(desaturate, limit=4.0):
        assert all(isinstance(value, float) for value in function(3, 5))


# The matrices

@given(drives)
def test_body_jacobian_is_pseudo_inverse_of_wheel_jacobian(drive):
    same(drive.wheel_jacobian @ drive.body_jacobian, np.eye(2))
    same(drive.body_jacobian, np.linalg.pinv(drive.wheel_jacobian))


@given(drives, twists)
def test_wheel_jacobian_ignores_sideways_motion(drive, twist):
    same(drive.wheel_jacobian @ twist, drive.wheel_speeds(twist[0], twist[2]), atol=1e-9)


@given(drives, speeds, speeds)
def test_body_jacobian_gives_twist_without_sideways_motion(drive, left, right):
    linear, angular = drive.body_twist(left, right)
    same(drive.body_jacobian @ [left, right], [linear, 0.0, angular], atol=1e-9)


@given(drives, speeds, speeds)
def test_displacement_is_body_jacobian_times_increments(drive, left, right):
    expected = drive.body_jacobian @ [left, right]
    same(drive.displacement(left, right), expected, atol=1e-9)
    rows = drive.displacement([[left, 0.0]], [[right, 0.0]])
    assert rows.shape == (1, 2, 3)
    same(rows[0, 0], expected, atol=1e-9)


# The wheels' frames

def test_left_wheel_is_half_the_separation_to_the_left():
    same(ROBOT.wheel_frames, [[0.0, 0.1585, 0.0], [0.0, -0.1585, 0.0]])


def test_wheel_twists_equal_values_by_hand():
    # In a left turn the wheel on the left is slower by 0.2 m times the turn rate.
    same(ROUND.wheel_twists([1.0, 0.3, 2.0]), [[0.6, 0.3, 2.0], [1.4, 0.3, 2.0]])


@given(drives, twists)
def test_wheel_frames_move_rigidly_with_the_robot(drive, twist):
    for frame, wheel_twist in zip(drive.wheel_frames, drive.wheel_twists(twist), strict=True):
        moved = se2.compose(se2.exp(twist), frame)
        same(se2.compose(frame, se2.exp(wheel_twist)), moved)


def test_wheel_twists_of_arrays_have_one_row_a_twist():
    many = np.arange(24.0).reshape(2, 4, 3)
    together = ROBOT.wheel_twists(many)
    assert together.shape == (2, 4, 2, 3)
    same(together[1, 2], ROBOT.wheel_twists(many[1, 2]))


# The rolling constraint

@given(drives, speeds, speeds)
def test_rolling_wheels_do_not_slide(drive, left, right):
    twist = drive.displacement(left, right)
    same(drive.contact_velocities(left, right, twist), np.zeros((2, 2)), atol=1e-10)


@given(drives, speeds, speeds, twists)
def test_wheels_without_sliding_roll(drive, left, right, twist):
    sliding = np.abs(drive.contact_velocities(left, right, twist)).max()
    rolling = drive.displacement(left, right)
    assume(np.abs(rolling - twist).max() > 1e-6)
    assert sliding > 1e-9


def test_sideways_motion_slides_both_wheels():
    left, right = ROBOT.wheel_speeds(0.7, 0.4)
    sliding = ROBOT.contact_velocities(left, right, [0.7, 0.2, 0.4])
    same(sliding, [[0.0, 0.2], [0.0, 0.2]])


def test_spinning_wheel_slides_backward():
    sliding = ROBOT.contact_velocities(2.0, 0.0, [0.0, 0.0, 0.0])
    same(sliding, [[-2.0 * 0.0471, 0.0], [0.0, 0.0]])


def test_contact_velocities_of_arrays_have_one_row_a_sample():
    left, right = np.array([1.0, 2.0, 3.0]), np.array([3.0, 2.0, -1.0])
    sliding = ROBOT.contact_velocities(left, right, ROBOT.displacement(left, right))
    same(sliding, np.zeros((3, 2, 2)))


# Desaturation

@given(any_speeds, any_speeds, st.floats(0.0, exclude_min=True, allow_infinity=False))
@example(0.1, 0.3, 0.1)
def test_desaturated_speeds_are_within_the_limit(left, right, limit):
    assert all(abs(speed) <= limit for speed in desaturate(left, right, limit))


@given(speeds, speeds, limits)
def test_desaturation_keeps_the_curvature(left, right, limit):
    slow_left, slow_right = desaturate(left, right, limit)
    same(slow_left * right, slow_right * left)
    assert slow_left * left >= 0.0
    assert slow_right * right >= 0.0


@given(speeds, speeds, limits)
def test_desaturation_scales_the_faster_wheel_to_the_limit(left, right, limit):
    assume(max(abs(left), abs(right)) > limit)
    same(max(map(abs, desaturate(left, right, limit))), limit)


@given(speeds, speeds, st.floats(50.0, 100.0))
@example(3.0, -5.0, 5.0)
@example(-5.0, 5.0, 5.0)
def test_speeds_within_the_limit_are_unchanged(left, right, limit):
    assert desaturate(left, right, limit) == (left, right)


@pytest.mark.parametrize('left_sign', [1.0, -1.0])
@pytest.mark.parametrize('right_sign', [1.0, -1.0])
@pytest.mark.parametrize(('left', 'right', 'slow_left', 'slow_right'), [
    (8.0, 2.0, 4.0, 1.0), (2.0, 8.0, 1.0, 4.0), (8.0, 0.0, 4.0, 0.0), (16.0, 16.0, 4.0, 4.0)])
def test_desaturation_is_independent_of_signs(
        left, right, slow_left, slow_right, left_sign, right_sign):
    assert desaturate(left_sign * left, right_sign * right, 4.0) == (
        left_sign * slow_left, right_sign * slow_right)


def test_each_pair_of_an_array_has_its_own_factor():
    left, right = desaturate([8.0, 1.0, -2.0], [4.0, 2.0, 16.0], 4.0)
    assert left.tolist() == [4.0, 1.0, -0.5]
    assert right.tolist() == [2.0, 2.0, 4.0]


# Invalid arguments

INVALID_LENGTHS = [0, 0.0, -0.3, math.nan, math.inf, -math.inf, None, 'a', [0.3], 1j]


@pytest.mark.parametrize('value', INVALID_LENGTHS)
@pytest.mark.parametrize('name', ['wheel_separation', 'left_wheel_radius', 'right_wheel_radius'])
def test_geometry_not_positive_is_rejected(name, value):
    message = f'{name} = {value!r}: must be positive and finite'
    with pytest.raises(ValueError, match=f'^{re.escape(message)}$'):
        replace(ROBOT, **{name: value})


def test_geometry_too_large_for_a_float_is_rejected():
    with pytest.raises(ValueError, match=r'^wheel_separation = 10+: must be positive and finite$'):
        replace(ROBOT, wheel_separation=10**400)


@pytest.mark.parametrize('limit', INVALID_LENGTHS)
def test_limit_not_positive_is_rejected(limit):
    message = f'limit = {limit!r}: must be positive and finite'
    with pytest.raises(ValueError, match=f'^{re.escape(message)}$'):
        desaturate(1.0, 2.0, limit)


def test_geometry_is_immutable():
    with pytest.raises(FrozenInstanceError):
        ROBOT.wheel_separation = 0.4


def test_integers_and_numpy_scalars_are_accepted():
    assert DiffDrive(1, np.float64(0.5), np.int64(2)) == DiffDrive(1.0, 0.5, 2.0)


@pytest.mark.parametrize(('function', 'names'), [
    (ROBOT.wheel_speeds, ('linear', 'angular')),
    (ROBOT.body_twist, ('left', 'right')),
    (ROBOT.displacement, ('left', 'right')),
    (partial(desaturate, limit=4.0), ('left', 'right')),
    (partial(ROBOT.contact_velocities, body_twist=[0.0, 0.0, 0.0]), ('left', 'right')),
])
def test_not_finite_speeds_are_rejected_by_name(function, names):
    for position, name in enumerate(names):
        for value in math.nan, math.inf, -math.inf:
            arguments = [1.0, 1.0]
            arguments[position] = [0.0, value]
            message = f'{name}[1] = {value}: must be finite'
            with pytest.raises(ValueError, match=f'^{re.escape(message)}$'):
                function(*arguments)
        arguments[position] = 'fast'
        with pytest.raises(ValueError, match=f"^{name} = 'fast': must be a number or an array"):
            function(*arguments)


@pytest.mark.parametrize('function', [
    ROBOT.wheel_twists, partial(ROBOT.contact_velocities, 1.0, 2.0)])
def test_invalid_body_twists_are_rejected(function):
    with pytest.raises(ValueError, match=re.escape('body_twist has shape (2,): must be (..., 3)')):
        function([1.0, 2.0])
    with pytest.raises(ValueError, match=re.escape('body_twist[1] = nan: must be finite')):
        function([1.0, math.nan, 2.0])
