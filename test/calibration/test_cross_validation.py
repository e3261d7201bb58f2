"""Cross-validation: each run is judged by a calibration without it."""
from checks.calibration_consistency import NOISE, NOMINAL, simulated_run
from diffdrive_ros.calibration.cross_validation import calibrate_without, compare_run, final_errors
from diffdrive_ros.calibration.fit import calibrate
from diffdrive_ros.calibration.model import Terms
from diffdrive_ros.core.kinematics import DiffDrive
from diffdrive_ros.core.odometry_config import OdometryConfig
from diffdrive_ros.core.parameter_specs import checked_values, ODOMETRY
import numpy as np
import pytest

TRUTH = DiffDrive(0.3021, 0.0497, 0.0504)
MARKER = np.array([0.031, -0.012, 0.4])
CONFIG = OdometryConfig.of(checked_values(
    ODOMETRY, {'wheel_separation': NOMINAL.wheel_separation, 'wheel_radius': 0.05}))


@pytest.fixture(scope='module')
def runs():
    """Return three runs with the noise of the wheels and of the capture."""
    random = np.random.default_rng(3)
    return [simulated_run(name, TRUTH, NOISE, MARKER, random)
            for name in ('square', 'circle back', 'eight')]


@pytest.fixture(scope='module')
def calibration(runs):
    """Return the calibration by all runs."""
    return calibrate(runs, NOMINAL)


def test_final_errors_a_run_are_smaller_by_either_calibration(runs, calibration):
    for index, run in enumerate(runs):
        without_run = calibrate_without(index, runs, NOMINAL, Terms(), calibration)
        assert without_run.drive != calibration.drive
        assert [report.name for report in without_run.runs] == [
            other.name for other in runs if other is not run]
        errors = final_errors(index, run, CONFIG, Terms(), calibration, without_run)
        assert errors.calibrated < 0.5 * errors.before
        assert errors.cross_validated < 0.5 * errors.before
        assert errors.clock_offset == calibration.runs[index].clock_offset
        assert not errors.is_outlier


def test_a_run_without_cross_validation_has_no_such_error(runs, calibration):
    assert final_errors(0, runs[0], CONFIG, Terms(), calibration, None).cross_validated is None


def test_failed_fold_is_reported_with_its_run_and_cause(runs, calibration):
    failure = calibrate_without(0, runs[:1], NOMINAL, Terms(), calibration)
    assert failure == 'square: no calibration without this run: no runs to calibrate from'
    errors = final_errors(0, runs[0], CONFIG, Terms(), calibration, failure)
    assert errors.cross_validated is None
    assert errors.failure == failure


def test_comparison_of_a_run_begins_with_its_first_pose(runs, calibration):
    offset = calibration.runs[0].clock_offset
    comparison = compare_run(runs[0], CONFIG, calibration, offset)
    assert comparison.poses[0] == pytest.approx(comparison.reference[0])
    stamps = runs[0].reference_seconds + offset
    assert comparison.seconds == pytest.approx(
        stamps[(stamps >= 0.0) & (stamps <= runs[0].seconds[-1])], abs=1e-9)
