"""Simulated runs of one robot, for the tests of the calibration."""
from checks.calibration_consistency import NOISE, simulated_run
from diffdrive_ros.calibration.model import Run
from diffdrive_ros.core.kinematics import DiffDrive
from diffdrive_ros.core.odometry import integrate, WheelNoise
import numpy as np

TRUTH = DiffDrive(0.3021, 0.0497, 0.0504)
MARKER = np.array([0.031, -0.012, 1.4])


def geometry_of(drive):
    """Return the parameters of a geometry, (3,)."""
    return np.array([drive.wheel_separation, drive.left_wheel_radius, drive.right_wheel_radius])


def noiseless_run(name, marker=MARKER, seed=5):
    """Return a run without noise but for the discretisation of the truth."""
    random = np.random.default_rng(seed)
    return simulated_run(name, TRUTH, WheelNoise(0.0, 0.0, 0.0), marker, random, 0.0, 0.0)


def noisy_runs(seed=3, names=('square', 'circle back', 'eight', 'there and back')):
    """Return runs with the noise of the wheels and of the reference."""
    random = np.random.default_rng(seed)
    return [simulated_run(name, TRUTH, NOISE, MARKER, random) for name in names]


def straight_run(name='straight', drive=TRUTH, seed=1):
    """Return a run along a straight line, with noise of the reference."""
    random = np.random.default_rng(seed)
    angles = np.linspace(0.0, 100.0, 401)
    left, right = angles / drive.left_wheel_radius * 0.05, angles / drive.right_wheel_radius * 0.05
    poses = integrate(drive, left, right, [1.0, 2.0, 0.5])
    noisy = poses + random.normal(size=poses.shape) * [1e-3, 1e-3, 4e-3]
    seconds = 0.05 * np.arange(401)
    return Run(name, seconds, left, right, seconds, noisy)
