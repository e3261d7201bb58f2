"""Test the comparison of replayed odometry with a reference."""
from diffdrive_ros.core.kinematics import DiffDrive
from diffdrive_ros.core.odometry import integrate
from diffdrive_ros.core.odometry_config import OdometryConfig
from diffdrive_ros.core.parameter_specs import checked_values, ODOMETRY
from diffdrive_ros.core.replay import compare, comparison_start_ns, replay, Trajectory
from diffdrive_ros.core.wheel_feedback import WheelSample
import numpy as np
import pytest


def runs_with_noise(count):
    """Yield samples and true trajectories of runs whose left wheel has random slip."""
    drive, random = DiffDrive(0.30, 0.049, 0.051), np.random.default_rng(9)
    for _ in range(count):
        speeds = np.tile(np.repeat([[8.0, 8.5], [8.0, 6.0]], 50, axis=0), (2, 1)) * 0.05
        angles = np.cumsum(np.vstack([[0.0, 0.0], speeds]), axis=0)
        # 1e-5 m^2/m of 0.049 m a radian.
        slips = np.sqrt(1e-5 * speeds[:, 0] / 0.049) * random.normal(size=200)
        true = integrate(drive, angles[:, 0] + np.append(0.0, np.cumsum(slips)), angles[:, 1])
        stamps = np.arange(201) * 50_000_000
        samples = [WheelSample(left, right, stamp) for (left, right), stamp in zip(
            angles.tolist(), stamps.tolist(), strict=True)]
        yield samples, Trajectory(stamps, true + 1e-4 * random.normal(size=true.shape))


@pytest.mark.parametrize('begin', [0, 120])
def test_nees_of_a_late_reference_is_one(begin):
    config = OdometryConfig.of(checked_values(ODOMETRY, {
        'wheel_separation': 0.30, 'wheel_radius': 0.05, 'left_wheel_radius_multiplier': 0.98,
        'right_wheel_radius_multiplier': 1.02, 'left_wheel_travel_variance': 1e-5,
        'right_wheel_travel_variance': 1e-9, 'turn_variance': 0.0}))
    scores = []
    for samples, reference in runs_with_noise(200):
        part = Trajectory(reference.stamps_ns[begin:], reference.poses[begin:])
        reset_ns = comparison_start_ns(samples, part, 0.0)
        compared = compare(
            replay(config, samples, reset_ns=reset_ns), part,
            reference_std=(1e-4, 1e-4))
        scores.append(compared.figures.nees_final)
    assert np.mean(scores) == pytest.approx(1.0, abs=0.12)
