"""Calibration on a real robot under motion capture: OptiOdom, see optiodom.py."""
import itertools

from diffdrive_ros.calibration.fit import calibrate
from diffdrive_ros.core.kinematics import DiffDrive
from diffdrive_ros.core.odometry import integrate
import numpy as np
import pytest
from scipy import optimize
from support import optiodom
from support.optiodom import CIRCULAR, median_final_error, NOMINAL, OTHER_SQUARE, runs, SQUARE

pytestmark = pytest.mark.skipif(
    not optiodom.DATA.is_dir(),
    reason='the OptiOdom recordings are not in ../shared/data/optiodom')


@pytest.fixture(scope='module')
def circular():
    """Return the calibration by the circles alone."""
    return calibrate(runs(CIRCULAR), NOMINAL)


def test_circles_give_the_published_geometry(circular):
    assert circular.drive.wheel_separation == pytest.approx(0.2022, abs=0.5e-3)
    assert 2.0 * circular.drive.right_wheel_radius == pytest.approx(0.0837, abs=0.1e-3)
    assert 2.0 * circular.drive.left_wheel_radius == pytest.approx(0.0838, abs=0.1e-3)
    assert circular.unobservable == ()
    assert [run.outlier for run in circular.runs] == [''] * 6


def test_circles_final_error_is_a_tenth_of_the_nominal_one(circular):
    assert median_final_error(NOMINAL, CIRCULAR) == pytest.approx(0.107, abs=1e-3)
    assert median_final_error(circular.drive, CIRCULAR) <= 0.010


@pytest.mark.parametrize(('recordings', 'nominal', 'at_most'), [
    (SQUARE, 0.065, 0.042),
    pytest.param(OTHER_SQUARE, 0.080, 0.042, marks=pytest.mark.xfail(
        reason='0.0445: on circles the separation is 1 mm larger than on squares, see '
        'doc/calibration_data.md')),
])
def test_circles_calibration_improves_squares(
        circular, recordings, nominal, at_most):
    assert median_final_error(NOMINAL, recordings) == pytest.approx(nominal, abs=1e-3)
    assert median_final_error(circular.drive, recordings) <= at_most


@pytest.fixture(scope='module')
def by_set(circular):
    """Return the calibrations by each set alone."""
    squares = {
        recordings: calibrate(runs(recordings), NOMINAL, keep_all=True)
        for recordings in (SQUARE, OTHER_SQUARE)}
    return squares | {CIRCULAR: circular}


@pytest.mark.parametrize(('fitted_on', 'judged'), list(itertools.permutations(
    [CIRCULAR, SQUARE, OTHER_SQUARE], 2)))
def test_calibration_of_one_set_gives_another_a_true_covariance(by_set, fitted_on, judged):
    assert 0.4 <= optiodom.mean_nees(by_set[fitted_on], judged) <= 2.0


@pytest.fixture(scope='module')
def by_circles_and():
    """Return the calibrations by the circles and one set of squares."""
    return {
        squares: calibrate(runs(CIRCULAR) + runs(squares), NOMINAL, keep_all=True)
        for squares in (SQUARE, OTHER_SQUARE)}


def test_circles_and_squares_calibration_improves_other_squares(by_circles_and):
    found = by_circles_and[SQUARE]
    assert median_final_error(found.drive, OTHER_SQUARE) <= 0.026
    assert median_final_error(found.drive, CIRCULAR) <= 0.025
    # The squares of this set are part of the fit.
    assert median_final_error(found.drive, SQUARE) <= 0.020


def plain_fit(*sets):
    """Return the least squares over positions of whole runs, with exact starts."""
    kept = [run for recordings in sets for run in runs(recordings)]

    def errors(geometry):
        drive = DiffDrive(*geometry)
        return np.concatenate([
            (integrate(drive, run.left, run.right, run.reference[0]) - run.reference)[::20, :2]
            for run in kept], axis=None)

    start = [NOMINAL.wheel_separation, NOMINAL.left_wheel_radius, NOMINAL.right_wheel_radius]
    return DiffDrive(*optimize.least_squares(errors, start, x_scale=start).x)


@pytest.mark.parametrize(('squares', 'others'), [(SQUARE, OTHER_SQUARE), (OTHER_SQUARE, SQUARE)])
def test_two_kinds_of_runs_generalise_better_than_a_plain_fit(
        by_circles_and, squares, others):
    found, plain = by_circles_and[squares], plain_fit(CIRCULAR, squares)
    assert median_final_error(found.drive, others) < 0.9 * median_final_error(plain, others)


def test_marker_and_reference_noise_are_those_of_the_capture(circular):
    assert np.abs(circular.marker[:2]).max() < 0.003
    assert circular.marker[2] == pytest.approx(-0.006, abs=0.002)
    assert 0.0003 < circular.reference_std[0] < 0.002
