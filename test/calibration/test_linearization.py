"""The linearization of whole runs agrees with Odometry, which works sample by sample."""
from diffdrive_ros.calibration.linearization import linearize
from diffdrive_ros.core.kinematics import DiffDrive
from diffdrive_ros.core.odometry import GeometryUncertainty, integrate, Odometry, WheelNoise
from hypothesis import given, strategies as st
import numpy as np
import pytest
from support.optiodom import noise_covariances
from support.sensitivity import geometry_sensitivity
from support.strategies import drives, metres, poses

NOISE = WheelNoise(3e-5, 7e-5, 2e-4)
ROBOT = DiffDrive(0.317, 0.0471, 0.0533)
few_steps = st.lists(
    st.tuples(st.floats(-9.0, 9.0), st.floats(-9.0, 9.0)), min_size=1, max_size=5)


def angles_of(steps):
    """Return the angles of the wheels, left and right, (2, N)."""
    return np.cumsum([(0.0, 0.0), *steps], axis=0).T


def driven(odometry, left, right):
    """Return an odometry after the wheel angles."""
    for stamp, (one, other) in enumerate(zip(left.tolist(), right.tolist(), strict=True)):
        odometry.update(one, other, stamp)
    return odometry


@given(drives, few_steps, st.tuples(metres, metres, st.floats(-3.0, 3.0)))
def test_linearize_whole_run_agrees_with_odometry(drive, steps, start):
    left, right = angles_of(steps)
    odometry = driven(Odometry(drive, noise=NOISE, start=start), left, right)
    uncertain = driven(Odometry(
        drive, geometry_uncertainty=GeometryUncertainty(1e-3), start=start), left, right)
    noiseless = driven(Odometry(drive, noise=WheelNoise(0.0, 0.0, 0.0), start=start), left, right)
    linear = linearize(drive, left, right, start)
    size = 1.0 + np.abs(linear.poses).max()
    assert linear.poses[-1] == pytest.approx(odometry.pose, abs=1e-12 * size)
    sensitivity = geometry_sensitivity(uncertain)
    assert linear.by_geometry[-1] == pytest.approx(
        sensitivity, abs=1e-11 * size * (1.0 + np.abs(sensitivity).max()))
    # Both contain the least covariance of the start pose.
    assert noise_covariances(linear, NOISE)[-1] == pytest.approx(
        odometry.pose_covariance - noiseless.pose_covariance,
        rel=1e-9, abs=1e-11 * size**2 * (1.0 + np.abs(odometry.pose_covariance).max()))


@given(few_steps, poses)
def test_linearize_by_start_is_the_derivative_of_integrate(steps, start):
    left, right = angles_of(steps)
    start = np.array(start)
    columns = [
        (integrate(ROBOT, left, right, start + step) - integrate(ROBOT, left, right, start - step))
        / 2e-6 for step in 1e-6 * np.eye(3)]
    assert linearize(ROBOT, left, right, start).by_start == pytest.approx(
        np.stack(columns, axis=-1), abs=1e-6)


def test_linearize_chosen_samples_agree_with_the_whole_run():
    left, right = angles_of([(0.3, 0.5), (2.0, -1.0), (0.0, 0.7), (1.5, 1.5)])
    whole, chosen = (linearize(ROBOT, left, right, chosen=which) for which in (
        slice(None), [0, 2, 4]))
    assert np.array_equal(chosen.poses, whole.poses[[0, 2, 4]])
    assert np.array_equal(chosen.by_geometry, whole.by_geometry[[0, 2, 4]])
    assert np.array_equal(
        noise_covariances(chosen, NOISE), noise_covariances(whole, NOISE)[[0, 2, 4]])
