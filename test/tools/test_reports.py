"""Reports: what is unobservable, headings without information, medians without outliers."""
from diffdrive_ros.calibration import fit, node_parameters
from diffdrive_ros.calibration.cross_validation import FinalErrors
from diffdrive_ros.calibration.model import Run
from diffdrive_ros.core.odometry import integrate
from diffdrive_ros.tools import calibrate, parameter_file, reports
from diffdrive_ros.tools.bags import Topics
from diffdrive_ros.tools.parameter_file import RobotParameters
import numpy as np
import pytest


def test_unobservable_parameter_keeps_its_value():
    robot = RobotParameters.of({
        'wheel_separation': 0.30, 'wheel_radius': 0.05, 'wheel_separation_multiplier': 1.01,
        'left_wheel_radius_multiplier': 0.994, 'right_wheel_radius_multiplier': 1.008,
        'wheel_separation_std': 0.0007})
    random = np.random.default_rng(3)
    angles, seconds = np.linspace(0.0, 100.0, 401), 0.05 * np.arange(401)
    left, right = angles * 1.008, angles * 0.994
    noisy = integrate(robot.config.drive, left, right) + 1e-3 * random.normal(size=(401, 3))
    found = fit.calibrate(
        [Run('line', seconds, left, right, seconds, noisy)], robot.config.drive)
    assert found.unobservable
    after = calibrate._with(
        robot, node_parameters.from_runs(found, robot.config, robot.nominal))
    assert after.config.drive.wheel_separation == pytest.approx(0.303)
    assert after.config.geometry_uncertainty.wheel_separation == 0.0007
    errors = [FinalErrors('line', None, 0.0, 0.0, None, is_outlier=False)]
    content = reports.calibration_json(found, errors, after)
    assert content['wheel_separation_std'] == 0.0007


def test_headings_without_information_are_reported(runs):
    """In degrees, beside a run that is right, they pass for noise."""
    rows = (runs / 'square.csv').read_text().splitlines()
    for number, row in enumerate(rows[1:], 1):
        *others, theta = row.split(',')
        rows[number] = ','.join([*others, theta and f'{np.degrees(float(theta)):.9f}'])
    (runs / 'degrees.csv').write_text('\n'.join(rows) + '\n')
    robot = parameter_file.read(runs / 'nominal.yaml')
    read = [calibrate._read_run(runs / name, robot, Topics())
            for name in ('degrees.csv', 'eight.csv', 'circle_back.csv')]
    summaries = [reports.calibration_summary(
        robot.config.drive, fit.calibrate(kept, robot.config.drive)) for kept in (read, read[1:])]
    assert ['in degrees, or none?' in each for each in summaries] == [True, False]


def test_medians_are_without_outliers():
    errors = [FinalErrors(f'run{number}', 0.02, error, error, error, is_outlier=False)
              for number, error in enumerate([1.0, 2.0, 3.0])]
    errors.append(FinalErrors('run3', None, 9.0, 9.0, None, is_outlier=True))
    *_, outlier, medians = reports.final_errors_table(errors).splitlines()
    assert outlier.split() == ['run3', '9.0000', '9.0000', '-', '-']
    assert medians.split() == ['median', '2.0000', '2.0000', '2.0000']


def test_failed_fold_is_named_below_the_table():
    errors = [FinalErrors('a', 0.0, 1.0, 1.0, None, is_outlier=False, failure='a: too short')]
    *_, medians, failure = reports.final_errors_table(errors).splitlines()
    assert medians.split() == ['median', '1.0000', '1.0000', '-']
    assert failure == 'not cross-validated: a: too short'
