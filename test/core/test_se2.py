"""Test the laws of SE(2), the rigid motions of the plane."""
from decimal import Decimal, localcontext
from functools import partial
import math
import re

from diffdrive_ros.core import se2
from hypothesis import example, given, strategies as st
import numpy as np
import pytest
from support.strategies import half_turns, many_turns, metres, points, poses, twists

IDENTITY = (0.0, 0.0, 0.0)
QUARTER = math.pi / 2.0

same = partial(np.testing.assert_allclose, rtol=0.0, atol=1e-11)


def homogeneous(pose):
    """Return a pose as the 3 by 3 matrix that maps the points (x, y, 1)."""
    x, y, theta = pose
    cos, sin = math.cos(theta), math.sin(theta)
    return np.array([[cos, -sin, x], [sin, cos, y], [0.0, 0.0, 1.0]])


def matrix_exponential(twist):
    """Return the matrix exponential of a twist, by scaling and squaring of a Taylor series."""
    v_x, v_y, omega = twist
    halvings = 10
    matrix = np.array([[0.0, -omega, v_x], [omega, 0.0, v_y], [0.0, 0.0, 0.0]]) / 2.0**halvings
    term = total = np.eye(3)
    for order in range(1, 16):
        term = term @ matrix / order
        total = total + term
    return np.linalg.matrix_power(total, 2**halvings)


def arc_to_fifty_digits(omega):
    """Return the end of an arc of 1 m with a turn, by a series in decimals."""
    with localcontext() as context:
        context.prec = 60
        turn = Decimal(omega)
        ends, term = [Decimal(0), Decimal(0)], Decimal(1)
        for order in range(1, 150):
            # The integral of exp(i turn s) over s: 1, i turn/2, -turn^2/6, ...
            sign = 1 if (order - 1) % 4 < 2 else -1
            ends[(order - 1) % 2] += sign * term / math.factorial(order)
            term *= turn
        return [float(end) for end in ends]


# exp and log

@given(st.tuples(metres, metres, half_turns))
def test_log_inverts_exp(twist):
    same(se2.log(se2.exp(twist)), twist)


@given(st.tuples(metres, metres, half_turns))
def test_exp_inverts_log(pose):
    same(se2.exp(se2.log(pose)), pose)


@given(twists)
def test_exp_equals_the_matrix_exponential(twist):
    same(homogeneous(se2.exp(twist)), matrix_exponential(twist))


@given(poses, twists)
def test_pose_update_is_the_matrix_exponential_on_the_right(pose, twist):
    updated = se2.compose(pose, se2.exp(twist))
    same(homogeneous(updated), homogeneous(pose) @ matrix_exponential(twist), atol=1e-10)


@given(twists, st.floats(0.0, 1.0))
def test_parts_of_a_constant_twist_compose(twist, share):
    part, rest = share * np.array(twist), (1.0 - share) * np.array(twist)
    same(se2.compose(se2.exp(part), se2.exp(rest)), se2.exp(twist))


def test_straight_motion_is_straight_bit_for_bit():
    assert se2.exp([0.37, -0.21, 0.0]).tolist() == [0.37, -0.21, 0.0]


def test_turn_in_place_has_no_translation():
    assert se2.exp([0.0, 0.0, 2.3]).tolist() == [0.0, 0.0, 2.3]


@pytest.mark.parametrize('sign', [1.0, -1.0])
@pytest.mark.parametrize('turn', [
    1e-300, 1e-18, 1e-17, 1e-12, 1e-8, 1e-7, 1e-6, 1e-5, 1e-3, 0.1, 0.5, 1.0, 2.0, 3.0, 3.141592,
    4.0, 6.2, 7.0, 12.5, 20.0])
def test_arc_of_any_turn_has_relative_accuracy(turn, sign):
    turn *= sign
    x, y = arc_to_fifty_digits(turn)
    ahead, aside = se2.exp([1.0, 0.0, turn]), se2.exp([0.0, 1.0, turn])
    np.testing.assert_allclose(ahead, [x, y, turn], rtol=2e-15)
    np.testing.assert_allclose(aside, [-y, x, turn], rtol=2e-15)


def test_quarter_circle_to_the_left_ends_ahead_and_left():
    same(se2.exp([QUARTER, 0.0, QUARTER]), [1.0, 1.0, QUARTER])


def test_whole_circles_return_to_the_start():
    same(se2.exp([5.0, 3.0, 6.0 * math.pi]), [0.0, 0.0, 6.0 * math.pi])


@pytest.mark.parametrize('turn', [0.0, 1e-18, 1e-17, 1e-15, -1e-15, 1e-12, 1e-8])
def test_tiny_turn_far_from_the_origin_drives_straight(turn):
    end = se2.compose([100.0, 100.0, 1.0], se2.exp([1.0, 0.0, turn]))
    along = [100.0 + math.cos(1.0), 100.0 + math.sin(1.0)]
    across = 0.5 * turn * np.array([-math.sin(1.0), math.cos(1.0)])
    same(end[:2], along + across, atol=1e-12)


@given(half_turns)
def test_chord_is_not_longer_than_its_arc(half_turn):
    ratio = se2.chord_over_arc(half_turn)
    assert 0.0 <= ratio <= 1.0
    assert ratio == se2.chord_over_arc(-half_turn)


def test_chord_over_arc_is_one_straight_and_zero_after_a_circle():
    same(se2.chord_over_arc([0.0, QUARTER, math.pi]), [1.0, 2.0 / math.pi, 0.0])


# The group

@given(poses, poses, poses)
def test_compose_is_associative(a, b, c):
    same(se2.compose(se2.compose(a, b), c), se2.compose(a, se2.compose(b, c)))


@given(poses)
def test_compose_with_identity_has_no_effect(pose):
    assert se2.compose(IDENTITY, pose).tolist() == list(pose)
    assert se2.compose(pose, IDENTITY).tolist() == list(pose)


@given(poses)
def test_pose_and_its_inverse_cancel(pose):
    same(se2.compose(pose, se2.inverse(pose)), IDENTITY)
    same(se2.compose(se2.inverse(pose), pose), IDENTITY)


@given(poses, poses)
def test_compose_and_inverse_equal_matrices(a, b):
    same(homogeneous(se2.compose(a, b)), homogeneous(a) @ homogeneous(b))
    same(homogeneous(se2.inverse(a)), np.linalg.inv(homogeneous(a)))


def test_compose_does_not_wrap_headings():
    assert se2.compose([0.0, 0.0, 3.0], [0.0, 0.0, 4.0])[2] == 7.0


@given(poses, poses)
def test_between_composes_to_the_second_pose(a, b):
    same(se2.compose(a, se2.between(a, b)), b)


@given(poses, poses, poses)
def test_between_is_independent_of_the_common_frame(world, a, b):
    moved = se2.between(se2.compose(world, a), se2.compose(world, b))
    same(moved, se2.between(a, b))


# Points, vectors and velocities

@given(poses, points)
def test_transform_equals_the_matrix(pose, point):
    same(se2.transform(pose, point), (homogeneous(pose) @ [*point, 1.0])[:2])


@given(poses, poses, points)
def test_transform_by_a_product_is_two_transforms(a, b, point):
    same(se2.transform(se2.compose(a, b), point), se2.transform(a, se2.transform(b, point)))


def test_point_ahead_of_a_robot_facing_left_is_left():
    same(se2.transform([2.0, 3.0, QUARTER], [1.0, 0.0]), [2.0, 4.0])


@given(many_turns, many_turns, points)
def test_rotations_add_and_keep_lengths(a, b, vector):
    turned = se2.rotate(a, se2.rotate(b, vector))
    same(turned, se2.rotate(a + b, vector))
    same(math.hypot(*turned), math.hypot(*vector))


def test_quarter_turn_maps_forward_to_left():
    same(se2.rotate(QUARTER, [[1.0, 0.0], [0.0, 1.0]]), [[0.0, 1.0], [-1.0, 0.0]])


@given(poses, twists)
def test_pose_rate_is_the_limit_of_short_motions(pose, twist):
    short = 1e-5 * np.array(twist)
    rise = se2.compose(pose, se2.exp(short)) - se2.compose(pose, se2.exp(-short))
    same(se2.pose_rate(pose, twist), rise / 2e-5, atol=1e-6)


def test_forward_motion_facing_left_goes_left():
    same(se2.pose_rate([5.0, 7.0, QUARTER], [0.4, 0.0, 0.3]), [0.0, 0.4, 0.3])


# The adjoint

@given(poses, twists)
def test_adjoint_conjugates(T_ab, V_b):
    V_a = se2.adjoint(T_ab) @ V_b
    conjugate = se2.compose(se2.compose(T_ab, se2.exp(V_b)), se2.inverse(T_ab))
    same(se2.exp(V_a), conjugate)


@given(poses, poses)
def test_adjoint_of_a_product_is_the_product(a, b):
    same(se2.adjoint(se2.compose(a, b)), se2.adjoint(a) @ se2.adjoint(b))


@given(poses)
def test_adjoint_of_the_inverse_is_the_inverse(pose):
    same(se2.adjoint(se2.inverse(pose)) @ se2.adjoint(pose), np.eye(3))


def test_point_right_of_the_centre_of_a_left_turn_moves_ahead():
    same(se2.adjoint([0.0, 1.0, 0.0]) @ [0.0, 0.0, 1.0], [1.0, 0.0, 1.0])


# Angles

@given(st.floats(-math.pi, math.pi, exclude_min=True))
@example(math.pi)
@example(math.nextafter(-math.pi, 0.0))
@example(-0.0)
@example(5e-324)
def test_wrap_angle_inside_is_unchanged_bit_for_bit(theta):
    wrapped = se2.wrap_angle(theta)
    assert wrapped == theta
    assert math.copysign(1.0, wrapped) == math.copysign(1.0, theta)


@pytest.mark.parametrize(('theta', 'wrapped'), [
    (-math.pi, math.pi),
    (math.nextafter(math.pi, 4.0), math.nextafter(-math.pi, 0.0)),
    (3.0 * QUARTER, -QUARTER),
    (-3.0 * QUARTER, QUARTER),
    (2.0 * math.pi, 0.0),
])
def test_wrap_angle_outside_continues_at_the_other_end(theta, wrapped):
    assert se2.wrap_angle(theta) == wrapped


@given(st.floats(-1e4, 1e4))
@example(3.0 * math.pi)
@example(-3.0 * math.pi)
def test_wrapped_angle_is_in_range_and_equivalent(theta):
    wrapped = se2.wrap_angle(theta)
    assert -math.pi < wrapped <= math.pi
    assert se2.wrap_angle(wrapped) == wrapped
    same([math.cos(wrapped), math.sin(wrapped)], [math.cos(theta), math.sin(theta)])


@given(half_turns, st.integers(-1000, 1000))
def test_wrap_angle_removes_whole_turns(theta, turns):
    off = se2.wrap_angle(theta + 2.0 * math.pi * turns) - theta
    same(math.remainder(off, 2.0 * math.pi), 0.0)


@given(st.floats(allow_nan=False, allow_infinity=False))
def test_wrap_angle_of_any_finite_angle_is_in_range(theta):
    assert -math.pi < se2.wrap_angle(theta) <= math.pi


# Arrays

random = np.random.default_rng(1)
POSES = random.uniform(-3.0, 3.0, (4, 1, 3))
MORE = random.uniform(-3.0, 3.0, (5, 3))
POINTS = random.uniform(-3.0, 3.0, (5, 2))
ANGLES = random.uniform(-9.0, 9.0, (4, 1))

CALLS = {  # function: (arguments, signature of a row)
    se2.exp: ([POSES], '(i)->(i)'),
    se2.log: ([POSES], '(i)->(i)'),
    se2.compose: ([POSES, MORE], '(i),(i)->(i)'),
    se2.inverse: ([POSES], '(i)->(i)'),
    se2.between: ([POSES, MORE], '(i),(i)->(i)'),
    se2.transform: ([POSES, POINTS], '(i),(j)->(j)'),
    se2.rotate: ([ANGLES, POINTS], '(),(j)->(j)'),
    se2.adjoint: ([POSES], '(i)->(j,k)'),
    se2.pose_rate: ([POSES, MORE], '(i),(i)->(i)'),
    se2.wrap_angle: ([ANGLES], '()->()'),
    se2.chord_over_arc: ([ANGLES], '()->()'),
}
each_call = pytest.mark.parametrize(
    ('function', 'arrays', 'rows'), [(function, *call) for function, call in CALLS.items()],
    ids=[function.__name__ for function in CALLS])


@each_call
def test_arrays_are_processed_rowwise_and_broadcast(function, arrays, rows):
    row_by_row = np.vectorize(function, signature=rows)(*arrays)
    together = function(*arrays)
    assert together.shape == row_by_row.shape
    np.testing.assert_allclose(together, row_by_row, rtol=1e-13, atol=1e-15)


@each_call
def test_arguments_are_not_modified(function, arrays, rows):
    copies = [array.copy() for array in arrays]
    result = function(*arrays)
    result[...] = 99.0
    for array, copy in zip(arrays, copies, strict=True):
        np.testing.assert_array_equal(array, copy)


@each_call
def test_empty_arrays_give_empty_arrays(function, arrays, rows):
    assert function(*(array[:0] for array in arrays)).size == 0


def test_integers_and_lists_are_accepted():
    same(se2.compose([1, 2, 0], (3, 4, 0)), [4.0, 6.0, 0.0])


# Invalid arguments

ARGUMENTS = [
    (se2.exp, ['twist'], [3]),
    (se2.log, ['pose'], [3]),
    (se2.compose, ['T_ab', 'T_bc'], [3, 3]),
    (se2.inverse, ['T_ab'], [3]),
    (se2.between, ['T_wa', 'T_wb'], [3, 3]),
    (se2.transform, ['T_ab', 'points_b'], [3, 2]),
    (se2.rotate, ['theta', 'vectors_b'], [None, 2]),
    (se2.adjoint, ['T_ab'], [3]),
    (se2.pose_rate, ['pose', 'twist'], [3, 3]),
    (se2.wrap_angle, ['theta'], [None]),
    (se2.chord_over_arc, ['half_turn'], [None]),
]
EACH_ARGUMENT = [
    pytest.param(function, sizes, position, name, id=f'{function.__name__}-{name}')
    for function, names, sizes in ARGUMENTS
    for position, name in enumerate(names)
]


def call_with(function, sizes, position, value):
    values = [0.0 if size is None else [0.0] * size for size in sizes]
    values[position] = value
    return function(*values)


@pytest.mark.parametrize('value', [math.nan, math.inf, -math.inf])
@pytest.mark.parametrize(('function', 'sizes', 'position', 'name'), EACH_ARGUMENT)
def test_not_finite_value_is_rejected_with_its_index(function, sizes, position, name, value):
    rows = np.zeros((2, sizes[position] or 4))
    rows[1, -1] = value
    place = f'{name}[1, {rows.shape[1] - 1}] = {value}: must be finite'
    with pytest.raises(ValueError, match=f'^{re.escape(place)}$'):
        call_with(function, sizes, position, rows)


@pytest.mark.parametrize(('function', 'sizes', 'position', 'name'), EACH_ARGUMENT)
@pytest.mark.parametrize('value', [
    'abc', None, [1.0, 'a', 2.0], [[0.0, 1.0, 2.0], [3.0]], [True, False], [1j, 0.0]])
def test_value_that_is_no_number_is_rejected(function, sizes, position, name, value):
    message = f'{name} = {value!r}: must be a number or an array of numbers'
    with pytest.raises(ValueError, match=f'^{re.escape(message)}$'):
        call_with(function, sizes, position, value)


@pytest.mark.parametrize(('function', 'sizes', 'position', 'name'), [
    each for each in EACH_ARGUMENT if each.values[1][each.values[2]]])
@pytest.mark.parametrize('shape', [(), (0,), (4,), (3, 1)])
def test_wrong_shape_is_rejected_with_the_right_one(function, sizes, position, name, shape):
    message = f'{name} has shape {shape}: must be (..., {sizes[position]})'
    with pytest.raises(ValueError, match=f'^{re.escape(message)}$'):
        call_with(function, sizes, position, np.zeros(shape))


def test_shapes_that_do_not_broadcast_are_rejected():
    with pytest.raises(ValueError, match='broadcast'):
        se2.compose(np.zeros((2, 3)), np.zeros((4, 3)))


@pytest.mark.parametrize('theta', [
    -math.pi, math.nextafter(math.pi, 4.0), 2.0 * math.pi, -7.0, 1e300])
def test_log_rejects_headings_out_of_range(theta):
    message = f'theta = {theta}: must be in (-pi, pi], see wrap_angle'
    with pytest.raises(ValueError, match=f'^{re.escape(message)}$'):
        se2.log([[1.0, 2.0, 0.5], [1.0, 2.0, theta]])


def test_log_accepts_half_a_circle_to_the_left():
    same(se2.log([0.0, 2.0, math.pi]), [math.pi, 0.0, math.pi])
