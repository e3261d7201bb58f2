"""Test the laws of odometry: batch integration, online updates, twist and covariance."""
from functools import partial
import math
import re
import tracemalloc

from diffdrive_ros.core import se2
from diffdrive_ros.core.kinematics import DiffDrive
from diffdrive_ros.core.odometry import (
    BLOCK_STEPS,
    integrate,
    integrate_chunks,
    integrate_euler,
    integrate_speeds,
    Odometry,
    WheelNoise,
)
from hypothesis import given, settings, strategies as st
import numpy as np
import pytest
from support.strategies import drives, metres, poses, wheel_steps

# No two of these numbers, nor their halves, doubles or inverses, can stand for each other.
ROBOT = DiffDrive(wheel_separation=0.317, left_wheel_radius=0.0471, right_wheel_radius=0.0533)
NOISE = WheelNoise(left_travel=2e-4, right_travel=7e-4, turn=3e-3)
EPOCH_NS = 1_700_000_000 * 10**9
SECOND = 10**9

each_integrator = pytest.mark.parametrize('integrator', [integrate, integrate_euler])

same = partial(np.testing.assert_allclose, rtol=1e-12, atol=1e-11)


def wheels_for(drive, distance, turn):
    """Return the increments of the left and the right wheel on an arc of a length and a turn."""
    return drive.wheel_speeds(distance, turn)


def angles_of(steps):
    """Return the left and right wheel angles of a log that starts at zero."""
    return np.vstack([[0.0, 0.0], np.cumsum(np.reshape(steps, (-1, 2)), axis=0)]).T


def driven(odometry, steps, start_ns=EPOCH_NS, interval_ns=SECOND // 50):
    """Return an odometry after the updates with the angles of a log."""
    for number, (left, right) in enumerate(angles_of(steps).T.tolist()):
        assert odometry.update(left, right, start_ns + number * interval_ns)
    return odometry


def on_a_circle(drive, turn, steps):
    """Return wheel angles of an arc of radius 1 m, left and right, in equal steps."""
    return np.outer(wheels_for(drive, turn, turn), np.linspace(0.0, 1.0, steps + 1))


# The path

@given(drives, wheel_steps, poses)
def test_online_and_batch_end_at_the_same_pose(drive, steps, start):
    online = driven(Odometry(drive, start=start), steps)
    same(online.pose, integrate(drive, *angles_of(steps), start)[-1])


@given(drives, wheel_steps, poses)
def test_poses_are_products_of_exponentials(drive, steps, start):
    poses_of_log = integrate(drive, *angles_of(steps), start)
    assert poses_of_log.shape == (len(steps) + 1, 3)
    pose = np.array(start)
    same(poses_of_log[0], pose)
    for (left, right), pose_of_log in zip(steps, poses_of_log[1:], strict=True):
        pose = se2.compose(pose, se2.exp(drive.body_jacobian @ [left, right]))
        same(pose_of_log, pose, atol=1e-10)


@given(drives, wheel_steps, poses)
def test_start_transforms_the_whole_path(drive, steps, start):
    from_origin = integrate(drive, *angles_of(steps))
    same(integrate(drive, *angles_of(steps), start), se2.compose(start, from_origin))


@given(drives, wheel_steps, st.floats(-1e3, 1e3), st.floats(-1e3, 1e3))
def test_poses_depend_on_angle_differences_only(drive, steps, left_offset, right_offset):
    left, right = angles_of(steps)
    moved = integrate(drive, left + left_offset, right + right_offset)
    same(moved, integrate(drive, left, right), atol=1e-8)


@given(drives, wheel_steps)
def test_path_is_mirrored_by_swapped_sides(drive, steps):
    mirrored = DiffDrive(
        drive.wheel_separation, drive.right_wheel_radius, drive.left_wheel_radius)
    left, right = angles_of(steps)
    mirror = [1.0, -1.0, -1.0]
    same(integrate(mirrored, right, left), mirror * integrate(drive, left, right))
    there, here = driven(Odometry(mirrored), np.flip(steps, 1)), driven(Odometry(drive), steps)
    same(there.pose, mirror * here.pose)


@given(drives, wheel_steps, poses)
def test_reverse_drive_returns_to_the_start(drive, steps, start):
    there_and_back = [*steps, *(-np.array(steps[::-1]))]
    same(driven(Odometry(drive, start=start), there_and_back).pose, start, atol=1e-10)
    same(integrate(drive, *angles_of(there_and_back), start)[-1], start, atol=1e-10)


@given(drives, st.floats(-5.0, 5.0), st.floats(-15.0, 15.0), st.integers(2, 1000))
@settings(max_examples=50)
def test_arc_is_independent_of_sampling(drive, distance, turn, samples):
    wheels = np.array(wheels_for(drive, distance, turn))
    fine = np.outer(wheels, np.linspace(0.0, 1.0, samples + 1))
    once, often = integrate(drive, *fine[:, [0, -1]]), integrate(drive, *fine)
    same(often[-1], once[-1])


@each_integrator
def test_equal_travel_drives_along_the_heading(integrator):
    angles = [0.0, 1.0 / 0.0471, 3.0 / 0.0471], [0.0, 1.0 / 0.0533, 3.0 / 0.0533]
    same(integrator(ROBOT, *angles), [[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [3.0, 0.0, 0.0]])
    up = integrator(ROBOT, *angles, [5.0, 7.0, math.pi / 2.0])
    same(up[-1], [5.0, 10.0, math.pi / 2.0])


@pytest.mark.parametrize(('turn', 'x', 'y'), [
    (math.pi / 2.0, 1.0, 1.0),  # the midpoint rule is 11 % off
    (math.pi, 0.0, 2.0),
    (2.0 * math.pi, 0.0, 0.0),
    (-math.pi / 2.0, -1.0, 1.0),
    (12.0 * math.pi, 0.0, 0.0),
])
def test_arc_in_one_step_ends_on_its_circle(turn, x, y):
    angles = on_a_circle(ROBOT, turn, 1)
    same(integrate(ROBOT, *angles)[-1], [x, y, turn])
    same(driven(Odometry(ROBOT), [angles[:, 1]]).pose, [x, y, turn])


def test_half_turn_in_place_rolls_wheels_half_a_circle():
    roll = 0.5 * math.pi * 0.317
    same(driven(Odometry(ROBOT), [(-roll / 0.0471, roll / 0.0533)]).pose, [0.0, 0.0, math.pi])


@pytest.mark.parametrize('excess', [0.0, 1e-17, 1e-15, -1e-15])
def test_tiny_turn_far_from_the_origin_drives_straight(excess):
    drive, wheel = DiffDrive(0.317, 0.0471, 0.0471 + excess), 1.0 / 0.0471
    start, end = [100.0, 100.0, 1.0], [100.0 + math.cos(1.0), 100.0 + math.sin(1.0)]
    online = driven(Odometry(drive, start=start), [(wheel, wheel)])
    whole_log = integrate(drive, [0.0, wheel], [0.0, wheel], start)
    for pose in online.pose, whole_log[-1]:
        same(pose[:2], end, rtol=0.0, atol=1e-12)


def test_headings_are_not_wrapped():
    assert integrate(ROBOT, *on_a_circle(ROBOT, 20.0, 7))[-1, 2] == pytest.approx(20.0)


@given(drives, wheel_steps, st.floats(0.01, 0.5), poses)
def test_integrated_speeds_equal_integrated_angles(drive, speeds, dt, start):
    left, right = np.transpose(speeds)
    path = integrate_speeds(drive, left, right, dt, start)
    assert path.shape == (len(speeds) + 1, 3)
    same(path, integrate(drive, *angles_of(dt * np.array(speeds)), start))
    same(integrate_speeds(drive, left, right, [dt] * len(speeds), start), path)


def test_each_pair_of_speeds_has_its_own_dt():
    left, right = np.transpose([wheels_for(ROBOT, 0.5, 0.0), wheels_for(ROBOT, 1.0, 1.0)])
    path = integrate_speeds(ROBOT, left, right, [4.0, math.pi / 2.0])
    same(path, [[0.0, 0.0, 0.0], [2.0, 0.0, 0.0], [3.0, 1.0, math.pi / 2.0]])


def test_empty_speeds_give_the_start():
    assert integrate_speeds(ROBOT, [], [], 0.1, [1.0, 2.0, 3.0]).tolist() == [[1.0, 2.0, 3.0]]


@pytest.mark.parametrize(('left', 'right', 'dt'), [
    ([1.0, 2.0], [1.0], 0.1),
    ([1.0, 2.0], [1.0, 2.0], [0.1, 0.1, 0.1]),
    ([1.0, 2.0], [1.0, 2.0], [[0.1], [0.1]]),
    ([[1.0, 2.0]], [[1.0, 2.0]], 0.1),
    ([1.0], [1.0], [0.1, 0.1]),
    (1.0, 1.0, 0.1),
])
def test_speeds_and_dt_of_different_shapes_are_rejected(left, right, dt):
    with pytest.raises(ValueError, match=r'has shape .*: must be'):
        integrate_speeds(ROBOT, left, right, dt)


@pytest.mark.parametrize('position', range(3))
def test_not_finite_speeds_and_dt_are_rejected_by_name(position):
    arguments = [[1.0, 2.0], [1.0, 2.0], [0.1, 0.1]]
    arguments[position][1] = math.nan
    name = ('left', 'right', 'dt')[position]
    with pytest.raises(ValueError, match=rf'^{name}\[1\] = nan: must be finite$'):
        integrate_speeds(ROBOT, *arguments)


def test_euler_steps_follow_the_old_heading():
    quarter = math.pi / 2.0
    same(integrate_euler(ROBOT, *on_a_circle(ROBOT, quarter, 1))[-1], [quarter, 0.0, quarter])


def test_euler_curves_are_too_wide():
    outward = integrate_euler(ROBOT, *on_a_circle(ROBOT, 3.0, 30))[1:, :2] - [0.0, 1.0]
    assert (np.hypot(*outward.T) > 1.0 + 1e-4).all()


def test_euler_error_is_proportional_to_the_step():
    exact = integrate(ROBOT, *on_a_circle(ROBOT, 2.0, 1))[-1]
    errors = [
        math.hypot(*(integrate_euler(ROBOT, *on_a_circle(ROBOT, 2.0, steps))[-1] - exact)[:2])
        for steps in (100, 200, 400)]
    assert errors[0] > 1e-3
    same(errors[0] / errors[1], 2.0, rtol=0.02)
    same(errors[1] / errors[2], 2.0, rtol=0.01)


@given(drives, wheel_steps, poses)
def test_euler_headings_are_exact(drive, steps, start):
    angles = angles_of(steps)
    same(integrate_euler(drive, *angles, start)[:, 2], integrate(drive, *angles, start)[:, 2])


@each_integrator
def test_empty_log_has_no_poses(integrator):
    assert integrator(ROBOT, [], []).shape == (0, 3)


@each_integrator
def test_log_of_one_sample_is_its_start(integrator):
    assert integrator(ROBOT, [4.0], [5.0], [1.0, 2.0, 3.0]).tolist() == [[1.0, 2.0, 3.0]]


@each_integrator
@pytest.mark.parametrize(('left', 'right', 'shapes'), [
    ([0.0, 1.0], [0.0], 'left has shape (2,), right (1,)'),
    (0.0, 1.0, 'left has shape (), right ()'),
    ([[0.0]], [[1.0]], 'left has shape (1, 1), right (1, 1)'),
])
def test_angles_of_wrong_shapes_are_rejected(integrator, left, right, shapes):
    message = f'{shapes}: must be (N,) for both'
    with pytest.raises(ValueError, match=f'^{re.escape(message)}$'):
        integrator(ROBOT, left, right)


@each_integrator
@pytest.mark.parametrize('value', [math.nan, math.inf, -math.inf])
def test_not_finite_angles_are_rejected_by_name(integrator, value):
    for name, left, right, start in [
        ('left[1]', [0.0, value], [0.0, 0.0], [0.0, 0.0, 0.0]),
        ('right[0]', [0.0, 0.0], [value, 0.0], [0.0, 0.0, 0.0]),
        ('start[2]', [0.0, 0.0], [0.0, 0.0], [0.0, 0.0, value]),
    ]:
        message = f'{name} = {value}: must be finite'
        with pytest.raises(ValueError, match=f'^{re.escape(message)}$'):
            integrator(ROBOT, left, right, start)


@each_integrator
@pytest.mark.parametrize(('start', 'message'), [
    ([0.0, 0.0], 'start has shape (2,): must be (..., 3)'),
    ([[0.0, 0.0, 0.0]], 'start has shape (1, 3): must be (3,)'),
    ('here', "start = 'here': must be a number or an array of numbers"),
])
def test_invalid_start_is_rejected(integrator, start, message):
    with pytest.raises(ValueError, match=f'^{re.escape(message)}$'):
        integrator(ROBOT, [0.0, 1.0], [0.0, 1.0], start)


# Long logs

def long_log(samples):
    """Return left and right wheel angles with curves to both sides."""
    time = np.linspace(0.0, 0.01 * samples, samples)
    return 5.0 * time + np.sin(time), 5.0 * time - 2.0 * np.sin(0.7 * time)


def peak_memory(work):
    """Return the peak memory of some work [bytes]."""
    tracemalloc.start()
    try:
        work()
        return tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()


@pytest.mark.parametrize(
    'samples', [BLOCK_STEPS, BLOCK_STEPS + 1, BLOCK_STEPS + 2, 3 * BLOCK_STEPS + 7])
def test_path_is_continuous_across_blocks(samples):
    left, right = long_log(samples)
    path = integrate(ROBOT, left, right, [1.0, 2.0, 3.0])
    online = Odometry(ROBOT, start=[1.0, 2.0, 3.0])
    for number, (pose, *angles) in enumerate(zip(path, left, right, strict=True)):
        online.update(*angles, EPOCH_NS + number)
        if number % 1000 == 0 or number % BLOCK_STEPS < 3:
            same(pose, online.pose)
    same(path[-1], online.pose)


def test_memory_of_a_long_log_is_that_of_its_poses():
    left, right = long_log(1_000_000)
    assert peak_memory(lambda: integrate(ROBOT, left, right)) < 1.1 * 24 * 1_000_000


@given(drives, wheel_steps, poses, st.lists(st.integers(0, 21)))
def test_chunks_have_the_poses_of_the_whole_log(drive, steps, start, cuts):
    angles = angles_of(steps)
    parts = np.split(angles, sorted(cuts), axis=1)
    of_parts = list(integrate_chunks(drive, parts, start))
    assert [len(each) for each in of_parts] == [part.shape[1] for part in parts]
    same(np.concatenate(of_parts), integrate(drive, *angles, start))


@given(st.lists(st.integers(0, 50_000), max_size=20))
@settings(max_examples=20)
def test_chunks_do_not_drift_from_the_whole_log(cuts):
    angles = np.array(long_log(50_000))
    parts = np.split(angles, sorted(cuts), axis=1)
    path = np.concatenate(list(integrate_chunks(ROBOT, parts)))
    same(path, integrate(ROBOT, *angles))


def test_empty_chunks_have_no_poses():
    assert list(integrate_chunks(ROBOT, [])) == []
    parts = [([], []), ([4.0], [5.0]), ([], []), ([4.0], [5.0])]
    start = [1.0, 2.0, 3.0]
    path = [each.tolist() for each in integrate_chunks(ROBOT, parts, start)]
    assert path == [[], [start], [], [start]]


def test_memory_of_chunks_is_that_of_one():
    def integrate_all(count):
        parts = (np.array(long_log(10_000)) for _ in range(count))
        assert sum(map(len, integrate_chunks(ROBOT, parts))) == count * 10_000

    assert peak_memory(lambda: integrate_all(30)) < 1.1 * peak_memory(lambda: integrate_all(3))


def test_chunks_are_read_lazily():
    taken = []

    def log():
        for number in range(3):
            taken.append(number)
            yield [1.0 * number], [2.0 * number]

    path = integrate_chunks(ROBOT, log())
    assert taken == []
    next(path)
    assert taken == [0]


def test_writes_into_a_chunk_do_not_affect_others():
    angles = np.array(long_log(30))

    def one_buffer():
        buffer = np.empty((2, 10))
        for part in np.split(angles, 3, axis=1):
            buffer[:] = part
            yield buffer

    path = []
    for each in integrate_chunks(ROBOT, one_buffer()):
        path.append(each.copy())
        each[:] = math.nan
    same(np.concatenate(path), integrate(ROBOT, *angles))


@pytest.mark.parametrize(('chunk', 'message'), [
    (([0.0, math.nan], [0.0, 0.0]), 'chunk 1: left[1] = nan: must be finite'),
    (([0.0], ['a']), "chunk 1: right = ['a']: must be a number or an array of numbers"),
    (([0.0, 1.0], [0.0]), 'chunk 1: left has shape (2,), right (1,): must be (N,) for both'),
    ((0.0, 1.0), 'chunk 1: left has shape (), right (): must be (N,) for both'),
    (7.0, 'chunk 1 = 7.0: must be a pair (left, right)'),
    (([], [], []), 'chunk 1 = ([], [], []): must be a pair (left, right)'),
])
def test_invalid_chunk_is_rejected_after_earlier_poses(chunk, message):
    path = integrate_chunks(ROBOT, [([0.0], [0.0]), chunk])
    assert next(path).tolist() == [[0.0, 0.0, 0.0]]
    with pytest.raises(ValueError, match=f'^{re.escape(message)}$'):
        next(path)


def test_invalid_start_is_rejected_before_the_first_chunk():
    with pytest.raises(ValueError, match=r'^start\[0\] = nan: must be finite$'):
        integrate_chunks(ROBOT, iter([]), [math.nan, 0.0, 0.0])


@each_integrator
@pytest.mark.parametrize(('left', 'right'), [
    ([0.0, 1.0, 1e308, -1e308, 0.0], [0.0, 1.0, 2.0, 3.0, 4.0]),
    ([0.0, 1.0, 1e308, -1e308, 0.0], [0.0, 1.0, 1e308, -1e308, 0.0]),
])
def test_angles_with_pose_overflow_are_rejected_by_name(integrator, left, right):
    steps = f'-1e+308, {right[3]} after 1e+308, {right[2]}'
    message = f'left, right = {steps}: must lead to a finite pose'
    with pytest.raises(ValueError, match=f'^{re.escape(message)}$'):
        integrator(ROBOT, left, right)


# Sample by sample

def test_first_sample_is_the_baseline():
    odometry = Odometry(ROBOT, start=[1.0, 2.0, 3.0])
    assert odometry.update(100.0, -200.0, EPOCH_NS)
    assert odometry.pose.tolist() == [1.0, 2.0, 3.0]
    assert odometry.twist.tolist() == [0.0, 0.0, 0.0]


@pytest.mark.parametrize('offset_ns', [0, -1, -SECOND])
def test_out_of_order_sample_is_dropped_without_lost_motion(offset_ns):
    odometry, smooth = Odometry(ROBOT), Odometry(ROBOT)
    for each in odometry, smooth:
        each.update(0.0, 0.0, EPOCH_NS)
        each.update(1.0, 2.0, EPOCH_NS + SECOND)
    before = odometry.pose.tolist(), odometry.twist.tolist(), odometry.pose_covariance.tolist()
    assert not odometry.update(7.0, 9.0, EPOCH_NS + SECOND + offset_ns)
    after = odometry.pose.tolist(), odometry.twist.tolist(), odometry.pose_covariance.tolist()
    assert before == after
    for each in odometry, smooth:
        assert each.update(3.0, 5.0, EPOCH_NS + 2 * SECOND)
    assert odometry.pose.tolist() == smooth.pose.tolist()
    assert odometry.twist.tolist() == smooth.twist.tolist()


@pytest.mark.parametrize('angles', [
    (math.nan, 5.0), (5.0, math.nan), (math.inf, 5.0), (5.0, -math.inf)])
def test_not_finite_sample_is_rejected_without_effect(angles):
    odometry, smooth = Odometry(ROBOT), Odometry(ROBOT)
    for each in odometry, smooth:
        driven(each, [(1.0, 2.0), (0.5, -3.0)], interval_ns=SECOND)
    message = f'left, right = {angles[0]}, {angles[1]}: must be finite'
    with pytest.raises(ValueError, match=f'^{re.escape(message)}$'):
        odometry.update(*angles, EPOCH_NS + 3 * SECOND)
    for each in odometry, smooth:
        assert each.update(4.0, 4.0, EPOCH_NS + 4 * SECOND)
    assert odometry.pose.tolist() == smooth.pose.tolist()
    assert odometry.twist.tolist() == smooth.twist.tolist()
    assert odometry.pose_covariance.tolist() == smooth.pose_covariance.tolist()


def test_not_finite_first_sample_is_rejected():
    odometry = Odometry(ROBOT)
    with pytest.raises(ValueError, match='must be finite'):
        odometry.update(math.nan, 0.0, EPOCH_NS)
    odometry.update(50.0, 60.0, EPOCH_NS + 1)
    assert odometry.pose.tolist() == [0.0, 0.0, 0.0]


@given(st.floats(allow_nan=False, allow_infinity=False),
       st.floats(allow_nan=False, allow_infinity=False))
def test_pose_of_finite_angles_is_finite(left, right):
    odometry = driven(Odometry(ROBOT), [])
    try:
        odometry.update(left, right, EPOCH_NS + 1)
        odometry.update(-left, -right, EPOCH_NS + 2)
    except ValueError:
        pass
    assert np.isfinite(odometry.pose).all()


def test_reset_sets_the_pose_and_keeps_the_baseline():
    odometry = driven(Odometry(ROBOT), [(3.0, 5.0)])
    odometry.reset([1.0, 2.0, math.pi / 2.0])
    assert odometry.pose.tolist() == [1.0, 2.0, math.pi / 2.0]
    ahead = 0.1 / 0.0471, 0.1 / 0.0533
    odometry.update(3.0 + ahead[0], 5.0 + ahead[1], EPOCH_NS + SECOND)
    same(odometry.pose, [1.0, 2.1, math.pi / 2.0])


def test_reset_without_arguments_is_the_origin():
    odometry = driven(Odometry(ROBOT), [(3.0, 5.0)] * 5)
    odometry.reset()
    assert odometry.pose.tolist() == [0.0, 0.0, 0.0]
    same(odometry.pose_covariance, Odometry(ROBOT).pose_covariance, rtol=0.0, atol=0.0)


def test_returned_arrays_are_copies():
    odometry = driven(Odometry(ROBOT), [(3.0, 5.0)])
    pose, covariance = odometry.pose.tolist(), odometry.pose_covariance.tolist()
    for array in odometry.pose, odometry.twist, odometry.pose_covariance:
        array[...] = 99.0
    assert odometry.pose.tolist() == pose
    assert odometry.pose_covariance.tolist() == covariance


@pytest.mark.parametrize(('pose', 'message'), [
    ([0.0, 0.0], ' has shape (2,): must be (..., 3)'),
    ([[0.0, 0.0, 0.0]], ' has shape (1, 3): must be (3,)'),
    ([0.0, math.nan, 0.0], '[1] = nan: must be finite'),
    (None, ' = None: must be a number or an array of numbers'),
])
def test_invalid_pose_is_rejected_by_name(pose, message):
    odometry = driven(Odometry(ROBOT), [(3.0, 5.0)])
    before = odometry.pose.tolist()
    with pytest.raises(ValueError, match=f'^{re.escape("pose" + message)}$'):
        odometry.reset(pose)
    assert odometry.pose.tolist() == before


def test_invalid_online_start_is_rejected_by_name():
    with pytest.raises(ValueError, match=f'^{re.escape("start[1] = nan: must be finite")}$'):
        Odometry(ROBOT, start=[0.0, math.nan, 0.0])


@pytest.mark.parametrize('window', [0, -1])
def test_window_below_one_is_rejected(window):
    with pytest.raises(ValueError, match=f'^window = {window}: must be an integer of 1 or more$'):
        Odometry(ROBOT, window=window)


# The twist

@given(st.floats(-2.0, 2.0), st.floats(-5.0, 5.0), st.integers(1, 12), st.integers(1, 10**10))
def test_constant_twist_is_exact_for_any_window(linear, angular, window, interval):
    left, right = ROBOT.wheel_speeds(linear, angular)
    seconds = interval / SECOND
    steps = [(left * seconds, right * seconds)] * 8
    odometry = driven(Odometry(ROBOT, window=window), steps, interval_ns=interval)
    same(odometry.twist, [linear, 0.0, angular], rtol=1e-9, atol=1e-9)


def test_twist_at_epoch_stamps_is_exact():
    odometry = Odometry(ROBOT)
    left, right = ROBOT.wheel_speeds(0.7, -1.3)
    odometry.update(0.0, 0.0, EPOCH_NS + 990_000_001)
    odometry.update(0.019999998 * left, 0.019999998 * right, EPOCH_NS + SECOND + 9_999_999)
    same(odometry.twist, [0.7, 0.0, -1.3], rtol=0.0, atol=1e-9)


@pytest.mark.parametrize('heading', [0.0, math.pi / 2.0, -2.0, 50.0])
def test_twist_is_in_the_body_frame(heading):
    odometry = Odometry(ROBOT, start=[3.0, 4.0, heading])
    ahead = 0.01 / 0.0471, 0.01 / 0.0533
    same(driven(odometry, [ahead] * 4, interval_ns=SECOND // 100).twist, [1.0, 0.0, 0.0])


@given(wheel_steps, st.integers(1, 12))
def test_twist_at_rest_is_exactly_zero(steps, window):
    odometry = driven(Odometry(ROBOT, window=window), [*steps, *[(0.0, 0.0)] * window])
    assert odometry.twist.tolist() == [0.0, 0.0, 0.0]


def test_twist_ignores_samples_before_its_window():
    late = [(1.0, 2.0), (3.0, -1.0), (0.5, 0.25)]
    odometry = driven(Odometry(ROBOT, window=3), [(40.0, -50.0), *late])
    fresh = driven(Odometry(ROBOT, window=3), late)
    same(odometry.twist, fresh.twist)
    within_window = driven(Odometry(ROBOT, window=4), [(40.0, -50.0), *late])
    assert abs(within_window.twist[2] - fresh.twist[2]) > 1.0


def test_twist_of_unequal_intervals_is_displacement_over_time():
    odometry = Odometry(ROBOT, window=2)
    ahead = np.array([1.0 / 0.0471, 1.0 / 0.0533])
    for metres_ahead, second in (0.0, 0), (0.1, 1), (0.9, 3):
        odometry.update(*(metres_ahead * ahead).tolist(), EPOCH_NS + second * SECOND)
    same(odometry.twist, [0.3, 0.0, 0.0])


# The covariance

def numeric_jacobian(function, point, step=1e-6):
    """Return the derivative of a function of a vector by central differences."""
    columns = [
        (function(point + offset) - function(point - offset)) / (2.0 * step)
        for offset in step * np.eye(len(point))]
    return np.array(columns).T


def variances_of(noise, left_travel, right_travel, turn):
    return np.diag([
        noise.left_travel * abs(left_travel), noise.right_travel * abs(right_travel),
        noise.turn * abs(turn)])


def displacement_of(drive, travels_and_scrub):
    """Return the displacement twist of travels of the wheels [m] and an additional turn [rad]."""
    left, right, scrub = travels_and_scrub
    wheels = left / drive.left_wheel_radius, right / drive.right_wheel_radius
    return np.array([0.0, 0.0, scrub]) + drive.displacement(*wheels)


def propagated(drive, noise, covariance, pose, left, right):
    """Return the covariance after one step, by numeric differentiation of the motion."""
    travels = np.array([drive.left_wheel_radius * left, drive.right_wheel_radius * right, 0.0])
    turn = displacement_of(drive, travels)[2]

    def moved(state):
        return se2.compose(state[:3], se2.exp(displacement_of(drive, state[3:])))

    jacobian = numeric_jacobian(moved, np.concatenate([pose, travels]))
    spread = np.zeros((6, 6))
    spread[:3, :3], spread[3:, 3:] = covariance, variances_of(noise, *travels[:2], turn)
    return jacobian @ spread @ jacobian.T


@given(drives, st.lists(st.tuples(st.floats(-15.0, 15.0), st.floats(-15.0, 15.0)),
                        min_size=1, max_size=4), poses)
@settings(max_examples=60)
def test_covariance_is_propagated_by_numeric_derivatives(drive, steps, start):
    odometry = driven(Odometry(drive, noise=NOISE, start=start), [])
    angles = angles_of(steps).T
    for number, (step, sample) in enumerate(zip(steps, angles[1:].tolist(), strict=True)):
        expected = propagated(drive, NOISE, odometry.pose_covariance, odometry.pose, *step)
        odometry.update(*sample, EPOCH_NS + number + 1)
        largest = np.abs(expected).max()
        same(odometry.pose_covariance, expected, rtol=0.0, atol=1e-7 * largest)


@pytest.mark.parametrize('turn', [0.0, 1e-9, 1e-4, 0.19, 0.2, 0.21, 1.0, -3.0, 7.0])
def test_covariance_is_exact_for_turns_of_any_size(turn):
    wheels = wheels_for(ROBOT, 0.8, turn)
    start = np.array([0.0, 0.0, 0.4])
    odometry = driven(Odometry(ROBOT, noise=NOISE, start=start), [wheels])
    least = Odometry(ROBOT).pose_covariance
    expected = propagated(ROBOT, NOISE, least, start, *wheels)
    same(odometry.pose_covariance, expected, rtol=0.0, atol=1e-8 * np.abs(expected).max())


def test_covariance_equals_monte_carlo():
    random, runs = np.random.default_rng(3), 40_000
    steps = [wheels_for(ROBOT, 0.1, turn) for turn in np.linspace(-0.05, 0.12, 20)]
    noise = WheelNoise(left_travel=2e-5, right_travel=9e-5, turn=1e-3)
    ends = np.tile([1.0, 2.0, 0.7], (runs, 1))
    for left, right in steps:
        travels = np.array([0.0471 * left, 0.0533 * right])
        turn = ROBOT.displacement(left, right)[2]
        deviations = np.sqrt(np.diag(variances_of(noise, *travels, turn)))
        drawn = [*travels, 0.0] + deviations * random.standard_normal((runs, 3))
        moves = ROBOT.displacement(drawn[:, 0] / 0.0471, drawn[:, 1] / 0.0533)
        moves[:, 2] += drawn[:, 2]
        ends = se2.compose(ends, se2.exp(moves))
    odometry = driven(Odometry(ROBOT, noise=noise, start=[1.0, 2.0, 0.7]), steps)
    sampled = np.cov(ends.T)
    scale = np.sqrt(np.outer(np.diag(sampled), np.diag(sampled)))
    assert (np.abs(odometry.pose_covariance - sampled) / scale).max() < 0.03


@given(drives, wheel_steps, poses)
def test_covariance_is_symmetric_positive_definite(drive, steps, start):
    odometry = driven(Odometry(drive, start=start), steps)
    for covariance in odometry.pose_covariance, odometry.twist_covariance:
        assert (covariance == covariance.T).all()
        assert (np.diag(covariance) > 0.0).all()
        spreads = np.sqrt(np.diag(covariance))
        assert np.linalg.eigvalsh(covariance / np.outer(spreads, spreads)).min() > -1e-12


@given(drives, st.lists(st.tuples(st.floats(-6.0, 6.0), st.floats(0.1, 6.0)), max_size=10))
def test_covariance_grows_with_every_step(drive, steps):
    odometry = driven(Odometry(drive, noise=NOISE), [])
    for number, (left, right) in enumerate(angles_of(steps).T[1:].tolist()):
        before = odometry.pose_covariance
        odometry.update(left, right, EPOCH_NS + number + 1)
        after = odometry.pose_covariance
        assert after[2, 2] > before[2, 2]
        assert np.linalg.slogdet(after)[1] > np.linalg.slogdet(before)[1]


def test_covariance_is_constant_at_rest():
    odometry = driven(Odometry(ROBOT, noise=NOISE), [(3.0, 5.0)])
    before = odometry.pose_covariance.tolist()
    odometry.update(3.0, 5.0, EPOCH_NS + SECOND)
    assert odometry.pose_covariance.tolist() == before


def test_travel_variance_is_independent_of_sampling():
    once, often = (
        driven(Odometry(ROBOT, noise=NOISE), np.diff(on_a_circle(ROBOT, 0.5, steps)).T)
        for steps in (200, 1000))
    scale = np.abs(often.pose_covariance).max()
    same(once.pose_covariance, often.pose_covariance, rtol=0.0, atol=1e-3 * scale)


@given(drives, wheel_steps, st.floats(-7.0, 7.0), metres, metres)
def test_covariance_turns_with_the_start(drive, steps, heading, x, y):
    plain = driven(Odometry(drive, noise=NOISE), steps).pose_covariance
    moved = driven(Odometry(drive, noise=NOISE, start=[x, y, heading]), steps).pose_covariance
    turn = np.eye(3)
    turn[:2, :2] = se2.rotate(heading, np.eye(2)).T
    same(moved, turn @ plain @ turn.T, rtol=0.0, atol=1e-10 * np.abs(plain).max())


@given(drives, wheel_steps)
def test_covariance_is_mirrored_by_swapped_sides(drive, steps):
    mirrored = DiffDrive(
        drive.wheel_separation, drive.right_wheel_radius, drive.left_wheel_radius)
    swapped = WheelNoise(NOISE.right_travel, NOISE.left_travel, NOISE.turn)
    here = driven(Odometry(drive, noise=NOISE), steps)
    there = driven(Odometry(mirrored, noise=swapped), np.flip(steps, 1))
    mirror = np.diag([1.0, -1.0, -1.0])
    for name in 'pose_covariance', 'twist_covariance':
        plain = mirror @ getattr(here, name) @ mirror
        same(getattr(there, name), plain, rtol=0.0, atol=1e-10 * np.abs(plain).max())


@pytest.mark.parametrize(('noise', 'sign'), [
    (WheelNoise(left_travel=0.0, right_travel=1e-4, turn=0.0), 1.0),
    (WheelNoise(left_travel=1e-4, right_travel=0.0, turn=0.0), -1.0),
])
def test_travel_and_heading_errors_of_a_wheel_correlate(noise, sign):
    ahead = 0.1 / 0.0471, 0.1 / 0.0533
    odometry = driven(Odometry(ROBOT, noise=noise), [ahead] * 10)
    pose, twist = odometry.pose_covariance, odometry.twist_covariance
    assert sign * pose[0, 2] > 1e-6
    assert sign * twist[0, 2] > 1e-6
    assert pose[1, 2] > 1e-6  # a left turn ends on the left, whichever wheel caused it


def test_turn_noise_affects_the_heading_only():
    odometry = driven(
        Odometry(ROBOT, noise=WheelNoise(0.0, 0.0, 0.01)), [wheels_for(ROBOT, 0.0, -2.0)])
    least = Odometry(ROBOT).pose_covariance
    same(odometry.pose_covariance - least, np.diag([0.0, 0.0, 0.02]))


def test_variances_are_never_zero():
    odometry = Odometry(ROBOT, noise=WheelNoise(0.0, 0.0, 0.0))
    for steps in [], [(0.0, 0.0)] * 3, [(1.0, -2.0)] * 3:
        odometry = driven(Odometry(ROBOT, noise=WheelNoise(0.0, 0.0, 0.0)), steps)
        for covariance in odometry.pose_covariance, odometry.twist_covariance:
            assert np.linalg.eigvalsh(covariance).min() > 1e-10


def test_twist_covariance_is_that_of_travel_in_the_window():
    step, seconds = np.array([1.1, 2.3]), 0.8
    odometry = driven(
        Odometry(ROBOT, window=4, noise=NOISE), [step] * 9, interval_ns=SECOND // 5)
    travels = 4.0 * step * [0.0471, 0.0533]
    turn = ROBOT.displacement(*(4.0 * step))[2]
    jacobian = numeric_jacobian(partial(displacement_of, ROBOT), np.array([*travels, 0.0]))
    expected = jacobian @ variances_of(NOISE, *travels, turn) @ jacobian.T / seconds**2
    ahead_and_turn = np.ix_([0, 2], [0, 2])
    same(odometry.twist_covariance[ahead_and_turn], expected[ahead_and_turn], rtol=0.0, atol=2e-6)
    same(odometry.twist_covariance[1], [0.0, expected[0, 0], 0.0], rtol=0.0, atol=2e-6)
    assert expected[0, 0] > 1e-5


def test_twist_covariance_of_rocking_is_that_of_driving():
    ahead = np.array([0.1 / 0.0471, 0.1 / 0.0533])
    driving = driven(Odometry(ROBOT, noise=NOISE), [ahead] * 10)
    rocking = driven(Odometry(ROBOT, noise=NOISE), [ahead, -ahead] * 5)
    same(rocking.twist, [0.0, 0.0, 0.0])
    same(rocking.twist_covariance, driving.twist_covariance)


@pytest.mark.parametrize('value', [-1e-9, math.nan, math.inf, None, 'a'])
@pytest.mark.parametrize('name', ['left_travel', 'right_travel', 'turn'])
def test_invalid_noise_is_rejected(name, value):
    message = f'{name} = {value!r}: must be finite and zero or more'
    with pytest.raises(ValueError, match=f'^{re.escape(message)}$'):
        WheelNoise(**{name: value})
