"""Runs that contradict the others are outliers; good runs are none."""
from dataclasses import replace

from checks.calibration_consistency import NOISE, NOMINAL, SHAPES, simulated_run
from diffdrive_ros.calibration.fit import calibrate
from diffdrive_ros.core import se2
from diffdrive_ros.core.odometry import WheelNoise
import numpy as np
import pytest
from support.calibration_runs import geometry_of, MARKER, noisy_runs, straight_run, TRUTH


def test_run_with_a_slip_is_an_outlier():
    runs = noisy_runs()
    slipped = runs[2]
    half = len(slipped.reference) // 2
    turned = se2.compose(slipped.reference[half], se2.compose(
        [0.05, 0.02, 0.4], se2.between(slipped.reference[half], slipped.reference[half:])))
    slipped.reference[half:] = turned
    found = calibrate(runs, NOMINAL)
    assert [run.name for run in found.runs if run.outlier] == [slipped.name]
    errors = geometry_of(found.drive) - geometry_of(TRUTH)
    assert (np.abs(errors) < 3.5 * found.geometry_std).all()


@pytest.mark.parametrize('seed', [11, 12])
def test_good_runs_are_no_outliers(seed):
    """Circles at one speed too, which determine neither the clock nor three of six unknowns."""
    found = calibrate(noisy_runs(seed, tuple(SHAPES)), NOMINAL)
    assert [run.outlier for run in found.runs] == [''] * len(SHAPES)


def test_the_only_run_with_turns_is_no_outlier():
    lines = [straight_run(f'line {seed}', seed=seed) for seed in range(4)]
    found = calibrate([*lines, *noisy_runs(names=('square',))], NOMINAL)
    assert [run.outlier for run in found.runs] == [''] * 5
    assert found.unobservable == ()
    errors = geometry_of(found.drive) - geometry_of(TRUTH)
    assert (np.abs(errors) < 3.5 * found.geometry_std).all()


@pytest.mark.parametrize('seed', [21, 22])
def test_run_with_another_separation_is_an_outlier(seed):
    """It does not widen the separation spread by which it is judged."""
    random, names = np.random.default_rng(seed), ('square', 'square back', 'eight',
                                                  'there and back')
    wrong = replace(TRUTH, wheel_separation=1.06 * TRUTH.wheel_separation)
    found = calibrate([
        simulated_run(name, wrong if name == 'eight' else TRUTH, NOISE, MARKER, random)
        for name in names], NOMINAL)
    assert [run.name for run in found.runs if run.outlier] == ['eight']
    assert abs(found.drive.wheel_separation - TRUTH.wheel_separation) < 3.0 * found.geometry_std[0]


def test_run_of_another_motion_with_near_separation_is_kept():
    """Runs of one kind of motion alone do not show the difference."""
    random, quiet = np.random.default_rng(1), WheelNoise(5e-7, 5e-7, 5e-6)
    squares = replace(TRUTH, wheel_separation=0.99 * TRUTH.wheel_separation)
    found = calibrate([
        simulated_run(name, TRUTH if name == 'eight' else squares, quiet, MARKER, random)
        for name in (*2 * ('square', 'square back'), 'eight')], NOMINAL)
    assert [run.outlier for run in found.runs] == [''] * 5
    assert found.uncertainty.wheel_separation > 0.003 * TRUTH.wheel_separation


def test_run_with_a_distant_clock_is_an_outlier():
    runs = noisy_runs()
    runs[0] = replace(runs[0], reference_seconds=runs[0].reference_seconds + 3.0)
    found = calibrate(runs, NOMINAL)
    (outlier,) = [run for run in found.runs if run.outlier]
    assert outlier.name == runs[0].name
    assert 'must be' in outlier.outlier
    errors = geometry_of(found.drive) - geometry_of(TRUTH)
    assert (np.abs(errors) < 3.5 * found.geometry_std).all()
