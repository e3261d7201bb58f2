"""Test the systematic part of the covariance, the reset, and the consistency."""
import math
import re

from checks.consistency import band, Cell, nees_of, OPTIODOM, PARAMETERS, real_runs, SETS
from diffdrive_ros.core import se2
from diffdrive_ros.core.kinematics import DiffDrive
from diffdrive_ros.core.odometry import (
    GeometryUncertainty,
    integrate,
    MIN_POSE_VARIANCE,
    Odometry,
    WheelNoise,
)
from hypothesis import given, settings, strategies as st
import numpy as np
import pytest
from support.sensitivity import geometry_sensitivity
from support.strategies import drives, metres, poses, wheel_steps
from test_odometry import (
    angles_of,
    driven,
    EPOCH_NS,
    NOISE,
    numeric_jacobian,
    on_a_circle,
    ROBOT,
    same,
    wheels_for,
)

UNCERTAINTY = GeometryUncertainty(
    wheel_separation=2.3e-3, left_wheel_radius=1.1e-4, right_wheel_radius=3.7e-4)
NO_NOISE = WheelNoise(0.0, 0.0, 0.0)
MIN_COVARIANCE = MIN_POSE_VARIANCE * np.eye(3)
FULL_COVARIANCE = np.array([[0.04, 0.01, -0.02], [0.01, 0.09, 0.03], [-0.02, 0.03, 0.05]])

few_steps = st.lists(
    st.tuples(st.floats(-9.0, 9.0), st.floats(-9.0, 9.0)), min_size=1, max_size=5)


def geometry_of(drive):
    """Return separation and radii as an array, in the order of the sensitivity."""
    return np.array([drive.wheel_separation, drive.left_wheel_radius, drive.right_wheel_radius])


def uncertain(drive=ROBOT, noise=NO_NOISE, **kwargs):
    """Return an odometry whose geometry is uncertain, without noise if none is given."""
    return Odometry(drive, noise=noise, geometry_uncertainty=UNCERTAINTY, **kwargs)


# The systematic part

@given(drives, few_steps, poses)
def test_sensitivity_is_derivative_of_pose_by_geometry(drive, steps, start):
    left, right = angles_of(steps)
    expected = numeric_jacobian(
        lambda geometry: integrate(DiffDrive(*geometry), left, right, start)[-1],
        geometry_of(drive), step=1e-7)
    sensitivity = geometry_sensitivity(driven(uncertain(drive, start=start), steps))
    same(sensitivity, expected, rtol=1e-5, atol=1e-5 * np.abs(expected).max() + 1e-7)


@given(drives, wheel_steps, poses)
def test_systematic_part_is_variances_through_sensitivity(drive, steps, start):
    plain = driven(Odometry(drive, noise=NOISE, start=start), steps)
    odometry = driven(uncertain(drive, NOISE, start=start), steps)
    S, deviations = geometry_sensitivity(odometry), geometry_of(UNCERTAINTY)
    expected = plain.pose_covariance + S @ np.diag(deviations**2) @ S.T
    same(odometry.pose_covariance, expected, rtol=0.0, atol=1e-12 * np.abs(expected).max())


def test_radius_error_bends_a_straight_line_separation_does_not():
    length, s, left, right = 2.0, 0.317, 2.0 / 0.0471, 2.0 / 0.0533  # angles of the wheels [rad]
    odometry = driven(uncertain(), [(left / 50.0, right / 50.0)] * 50)
    same(geometry_sensitivity(odometry), np.transpose([
        [0.0, 0.0, 0.0],
        [0.5 * left, -0.5 * left * length / s, -left / s],
        [0.5 * right, 0.5 * right * length / s, right / s]]))


def test_heading_error_of_a_spin_is_that_of_the_separation():
    odometry = driven(uncertain(), [wheels_for(ROBOT, 0.0, 0.5)] * 8)
    same(geometry_sensitivity(odometry)[:, 0], [0.0, 0.0, -4.0 / 0.317])


@given(drives, st.floats(-3.0, 3.0), st.integers(2, 60))
def test_systematic_part_is_independent_of_sampling(drive, turn, steps):
    once, often = (
        driven(uncertain(drive), np.diff(on_a_circle(drive, turn, number)).T).pose_covariance
        - MIN_COVARIANCE for number in (1, steps))
    same(often, once, rtol=1e-7, atol=1e-9 * np.abs(once).max() + 1e-9)


def test_systematic_part_grows_quadratically_noise_linearly():
    step = 0.05 / 0.0471, 0.05 / 0.0533

    def headings(make):
        return [driven(make(), [step] * steps).pose_covariance[2, 2] - MIN_POSE_VARIANCE
                for steps in (100, 200, 400)]

    systematic, noise = headings(uncertain), headings(lambda: Odometry(ROBOT, noise=NOISE))
    same(np.array(systematic) / systematic[0], [1.0, 4.0, 16.0], rtol=1e-9)
    same(np.array(noise) / noise[0], [1.0, 2.0, 4.0], rtol=1e-9)


@given(drives, few_steps)
def test_systematic_part_vanishes_on_the_way_back(drive, steps):
    there = geometry_sensitivity(driven(uncertain(drive), steps))
    back = [*steps, *(-np.array(steps[::-1]))]
    home = geometry_sensitivity(driven(uncertain(drive), back))
    same(home, np.zeros((3, 3)), atol=1e-9 * np.abs(there).max() + 1e-9)


@given(drives, wheel_steps, st.floats(-7.0, 7.0), metres, metres)
def test_systematic_part_turns_with_the_start(drive, steps, heading, x, y):
    plain = driven(uncertain(drive, NOISE), steps)
    moved = driven(uncertain(drive, NOISE, start=[x, y, heading]), steps)
    turn = np.eye(3)
    turn[:2, :2] = se2.rotate(heading, np.eye(2)).T
    for there, here in (
            (geometry_sensitivity(moved), turn @ geometry_sensitivity(plain)),
            (moved.pose_covariance, turn @ plain.pose_covariance @ turn.T)):
        same(there, here, rtol=0.0, atol=1e-10 * np.abs(here).max())


@given(drives, wheel_steps)
def test_systematic_part_is_mirrored_by_swapped_sides(drive, steps):
    mirrored = DiffDrive(
        drive.wheel_separation, drive.right_wheel_radius, drive.left_wheel_radius)
    uncertainty = GeometryUncertainty(
        UNCERTAINTY.wheel_separation, UNCERTAINTY.right_wheel_radius,
        UNCERTAINTY.left_wheel_radius)
    here = driven(uncertain(drive), steps)
    there = driven(
        Odometry(mirrored, noise=NO_NOISE, geometry_uncertainty=uncertainty), np.flip(steps, 1))
    mirror = np.diag([1.0, -1.0, -1.0])
    for name in 'pose_covariance', 'twist_covariance':
        plain = mirror @ getattr(here, name) @ mirror
        same(getattr(there, name), plain, rtol=0.0, atol=1e-10 * np.abs(plain).max())


@given(drives, wheel_steps, poses)
def test_total_covariance_is_symmetric_positive_definite(drive, steps, start):
    odometry = driven(uncertain(drive, NOISE, start=start), steps)
    for covariance in odometry.pose_covariance, odometry.twist_covariance:
        assert (covariance == covariance.T).all()
        assert (np.diag(covariance) > 0.0).all()
        spreads = np.sqrt(np.diag(covariance))
        assert np.linalg.eigvalsh(covariance / np.outer(spreads, spreads)).min() > 0.0


def test_geometry_error_persists_after_a_change_of_drive():
    first, second = [(0.7, 1.9)] * 6, [(2.1, 1.2)] * 7
    other = DiffDrive(0.331, 0.0462, 0.0541)

    def end(error):
        odometry = driven(Odometry(DiffDrive(*(geometry_of(ROBOT) + error))), first)
        middle = odometry.pose
        return integrate(
            DiffDrive(*(geometry_of(other) + error)), *angles_of(second), middle)[-1]

    odometry = driven(uncertain(), first)
    odometry.drive = other
    for number, sample in enumerate(angles_of([*first, *second]).T[7:].tolist()):
        assert odometry.update(*sample, EPOCH_NS + (number + 1) * 10**9)
    same(odometry.pose, end(np.zeros(3)))
    expected = numeric_jacobian(end, np.zeros(3))
    same(geometry_sensitivity(odometry), expected, atol=1e-6 * np.abs(expected).max())


def test_twist_covariance_includes_the_geometry():
    step, seconds = np.array([1.1, 2.3]), 0.8
    plain, odometry = (
        driven(
            Odometry(ROBOT, window=4, noise=NOISE, geometry_uncertainty=uncertainty), [step] * 9,
            interval_ns=10**9 // 5)
        for uncertainty in (None, UNCERTAINTY))
    jacobian = numeric_jacobian(
        lambda geometry: DiffDrive(*geometry).displacement(*(4.0 * step / seconds)),
        geometry_of(ROBOT))
    expected = jacobian @ np.diag(geometry_of(UNCERTAINTY)**2) @ jacobian.T
    assert expected[2, 2] > 1e-4
    same(odometry.twist_covariance - plain.twist_covariance, expected, rtol=0.0, atol=1e-10)


@pytest.mark.parametrize('value', [-1e-9, math.nan, math.inf, None, 'a'])
@pytest.mark.parametrize('name', ['wheel_separation', 'left_wheel_radius', 'right_wheel_radius'])
def test_invalid_deviation_is_rejected(name, value):
    message = f'{name} = {value!r}: must be finite and zero or more'
    with pytest.raises(ValueError, match=f'^{re.escape(message)}$'):
        GeometryUncertainty(**{name: value})


# Reset

def test_reset_sets_the_given_covariance():
    odometry = driven(uncertain(noise=NOISE), [(3.0, 5.0)] * 5)
    odometry.reset([1.0, 2.0, 3.0], FULL_COVARIANCE)
    assert odometry.pose.tolist() == [1.0, 2.0, 3.0]
    assert odometry.pose_covariance.tolist() == FULL_COVARIANCE.tolist()


def test_heading_variance_of_a_reset_grows_sideways():
    odometry = driven(Odometry(ROBOT, noise=NO_NOISE), [])
    odometry.reset([4.0, -3.0, math.pi / 2.0], np.diag([0.01, 0.02, 0.03]))
    odometry.update(2.0 / 0.0471, 2.0 / 0.0533, EPOCH_NS + 1)
    expected = [[0.01 + 4.0 * 0.03, 0.0, -2.0 * 0.03], [0.0, 0.02, 0.0], [-2.0 * 0.03, 0.0, 0.03]]
    same(odometry.pose_covariance, expected)


@given(drives, wheel_steps, few_steps, poses)
@settings(max_examples=50)
def test_reset_restarts_the_systematic_part(drive, before, after, pose):
    odometry = driven(uncertain(drive, NOISE), before)
    odometry.reset(pose, FULL_COVARIANCE)
    assert geometry_sensitivity(odometry).tolist() == np.zeros((3, 3)).tolist()
    fresh = driven(uncertain(drive, NOISE), [])
    fresh.reset(pose, FULL_COVARIANCE)
    origin = angles_of(before)[:, -1]
    for number, (left, right) in enumerate(angles_of(after).T[1:].tolist()):
        fresh.update(left, right, EPOCH_NS + (number + 1) * 10**9)
        odometry.update(left + origin[0], right + origin[1], EPOCH_NS + (number + 1) * 10**9)
    scale = np.abs(fresh.pose_covariance).max()
    same(odometry.pose_covariance, fresh.pose_covariance, rtol=0.0, atol=1e-9 * scale)


@pytest.mark.parametrize('covariance', [
    np.zeros((3, 3)), np.diag([1.0, 0.0, 0.0]), [[1.0, 1.0, 0.0], [1.0, 1.0, 0.0], [0.0] * 3]])
def test_reset_with_zero_covariance_has_the_minimum_variance(covariance):
    odometry = Odometry(ROBOT)
    odometry.reset([1.0, 2.0, 3.0], covariance)
    same(odometry.pose_covariance, covariance, rtol=0.0, atol=1.001 * MIN_POSE_VARIANCE)
    assert np.linalg.eigvalsh(odometry.pose_covariance).min() > 0.9 * MIN_POSE_VARIANCE


def test_covariance_with_rounding_errors_is_accepted():
    large = 1e9 * FULL_COVARIANCE
    large[0, 1] *= 1.0 + 1e-13
    odometry = Odometry(ROBOT)
    odometry.reset([1.0, 2.0, 3.0], large)
    same(odometry.pose_covariance, large)


@pytest.mark.parametrize(('covariance', 'message'), [
    (np.eye(2), 'covariance has shape (2, 2): must be (3, 3)'),
    (np.zeros(9), 'covariance has shape (9,): must be (3, 3)'),
    (np.diag([1.0, math.nan, 1.0]), 'covariance[1, 1] = nan: must be finite'),
    ('none', "covariance = 'none': must be a number or an array of numbers"),
    ([[1.0, 0.5, 0.0], [0.4, 1.0, 0.0], [0.0, 0.0, 1.0]],
     'covariance = [[1.0, 0.5, 0.0], [0.4, 1.0, 0.0], [0.0, 0.0, 1.0]]: must be symmetric'),
    ([[1.0, 0.0, 0.0], [0.0, 1.0, 2.0], [0.0, 2.0, 1.0]],
     'covariance = [[1.0, 0.0, 0.0], [0.0, 1.0, 2.0], [0.0, 2.0, 1.0]]: must be positive '
     'semidefinite'),
    (np.diag([1e6, 1e6, -1e-6]),
     'covariance = [[1000000.0, 0.0, 0.0], [0.0, 1000000.0, 0.0], [0.0, 0.0, -1e-06]]: must be '
     'positive semidefinite'),
    ([[1e-12, 2e-12, 0.0], [2e-12, 1e-12, 0.0], [0.0, 0.0, 1e-12]],
     'covariance = [[1e-12, 2e-12, 0.0], [2e-12, 1e-12, 0.0], [0.0, 0.0, 1e-12]]: must be '
     'positive semidefinite'),
])
def test_invalid_covariance_is_rejected_without_effect(covariance, message):
    odometry = driven(uncertain(noise=NOISE), [(3.0, 5.0)] * 5)
    pose, before = odometry.pose.tolist(), odometry.pose_covariance.tolist()
    with pytest.raises(ValueError, match=f'^{re.escape(message)}$'):
        odometry.reset([1.0, 2.0, 3.0], covariance)
    assert odometry.pose.tolist() == pose
    assert odometry.pose_covariance.tolist() == before


# Overflow of the covariance

@pytest.mark.parametrize('far', [1e120, 1e200, 1e308])
def test_step_with_covariance_overflow_is_rejected(far):
    odometry = driven(uncertain(DiffDrive(0.317, 0.05, 0.05), NOISE), [(3.0, 5.0)])
    errors = []
    for number in range(1, 11):
        before = odometry.pose.tolist(), odometry.pose_covariance.tolist()
        try:
            odometry.update(*[(-1)**number * far] * 2, EPOCH_NS + number * 10**9)
        except ValueError as error:
            errors.append(str(error))
            after = odometry.pose.tolist(), odometry.pose_covariance.tolist()
            assert before == after
        for covariance in odometry.pose_covariance, odometry.twist_covariance:
            assert np.isfinite(covariance).all()
    assert errors
    for error in errors:
        assert re.fullmatch(r'travel = \S+, \S+ m in one step: must be .*', error)


# Consistency: test/checks/consistency.py checks more cells

CELLS = (
    Cell('straight', 'equal', systematic=True), Cell('arc', 'unequal', systematic=False),
    Cell('spin', 'unequal', systematic=False), Cell('spin', 'equal', systematic=True),
    Cell('eight', 'equal', systematic=False), Cell('straight', 'unequal', systematic=True))


def test_covariance_is_consistent_and_half_parameters_are_not():
    low, high = band(len(CELLS))
    table = [nees_of(cell, ('', *PARAMETERS)) for cell in CELLS]
    true, *halved = np.transpose(table)
    assert ((low < true) & (true < high)).all(), true
    for name, nees in zip(PARAMETERS, halved, strict=True):
        assert nees.max() > high, name


@pytest.mark.skipif(
    not OPTIODOM.is_dir(), reason='the OptiOdom recordings are not in ../shared/data/optiodom')
def test_noise_fitted_on_circles_is_consistent_on_squares():
    squares, circles = SETS[:2], SETS[2]
    k = real_runs(circles, 4).fitted()
    assert 5e-7 < k < 5e-6
    for recordings in squares:
        runs = real_runs(recordings, 1)
        assert len(runs.errors) == 6
        assert 0.3 < runs.nees(k) < 3.0
