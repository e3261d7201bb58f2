"""
Check the error bars of calibrations by z-scores, as consistency.py checks covariances.

Each robot has its own radii, separation and noise, and drives along several shapes. The truth has
ten times the rate of the runs, by code that shares nothing with the package. Each run has a
reference with its own noise, frame, clock and marker. If the error bars are true, the errors of
the geometry over its standard deviations have a standard deviation of 1.
"""
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor
import functools
import math
import os

from diffdrive_ros.calibration.fit import calibrate
from diffdrive_ros.calibration.model import Run
from diffdrive_ros.core import se2
from diffdrive_ros.core.kinematics import DiffDrive
from diffdrive_ros.core.odometry import WheelNoise
import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]

CALIBRATIONS = 500
BAND = 0.1  # around 1, for that many: three deviations of chance; wider for fewer
NOMINAL = DiffDrive(0.30, 0.05, 0.05)
NOISE = WheelNoise(6e-6, 6e-6, 4e-5)

STEP_S = 0.005  # of the truth
STEPS_PER_SAMPLE = 10

# Linear [m/s] and angular [rad/s] speed, and for how long [s].
SHAPES = {
    'square': 4 * [(0.4, 0.0, 4.0), (0.0, 1.0, 0.5 * math.pi)],
    'square back': 4 * [(0.4, 0.0, 4.0), (0.0, -1.0, 0.5 * math.pi)],
    'circle': [(0.4, 0.5, 20.0)],
    'circle back': [(0.4, -0.5, 20.0)],
    'eight': [(0.4, 0.8, 7.9), (0.4, -0.8, 7.9)],
    'there and back': [(0.4, 0.05, 8.0), (0.0, 1.2, 2.6), (0.4, -0.05, 8.0)],
}


def simulated_run(
    name: str, drive: DiffDrive, noise: WheelNoise, marker: Array, random: np.random.Generator,
    position_std: float = 1e-3, heading_std: float = 4e-3,
) -> Run:
    """Return a run along a shape; the reference has its own frame and clock."""
    rim_left = np.concatenate([
        np.full(round(seconds / STEP_S), linear - 0.5 * drive.wheel_separation * angular)
        for linear, angular, seconds in SHAPES[name]]) * STEP_S
    rim_right = np.concatenate([
        np.full(round(seconds / STEP_S), linear + 0.5 * drive.wheel_separation * angular)
        for linear, angular, seconds in SHAPES[name]]) * STEP_S
    count = len(rim_left)
    turn = (rim_right - rim_left) / drive.wheel_separation
    left = rim_left + np.sqrt(noise.left_travel * np.abs(rim_left)) * random.normal(size=count)
    right = rim_right + np.sqrt(noise.right_travel * np.abs(rim_right)) * random.normal(size=count)
    turn = (right - left) / drive.wheel_separation + (
        np.sqrt(noise.turn * np.abs(turn)) * random.normal(size=count))
    x, y, theta = np.array([*random.uniform(-2.0, 2.0, 2), random.uniform(-3.0, 3.0)])
    headings = theta + np.concatenate([[0.0], np.cumsum(turn)])
    middle, distance = headings[:-1] + 0.5 * turn, 0.5 * (left + right)
    poses = np.stack([
        x + np.concatenate([[0.0], np.cumsum(distance * np.cos(middle))]),
        y + np.concatenate([[0.0], np.cumsum(distance * np.sin(middle))]), headings], axis=-1)
    seconds = STEP_S * np.arange(count + 1)
    reference = se2.compose(poses, marker)[::STEPS_PER_SAMPLE]
    noise_std = [position_std, position_std, heading_std]
    reference = reference + random.normal(size=reference.shape) * noise_std
    left_angles, right_angles = (
        np.concatenate([[0.0], np.cumsum(rim)])[::STEPS_PER_SAMPLE] / radius
        for rim, radius in (
            (rim_left, drive.left_wheel_radius), (rim_right, drive.right_wheel_radius)))
    seconds = seconds[::STEPS_PER_SAMPLE]
    return Run(
        name, seconds, left_angles, right_angles, seconds + random.normal() * 0.02, reference)


def z_scores(seed: int) -> Array:
    """Return the errors of one calibration's geometry over its standard deviations, (3,)."""
    random = np.random.default_rng(seed)
    truth = DiffDrive(*(
        np.array([0.30, 0.05, 0.05]) * (1.0 + random.normal(size=3) * [0.01, 0.003, 0.003])))
    marker = random.normal(size=3) * [0.02, 0.02, 0.1]
    found = calibrate(
        [simulated_run(name, truth, NOISE, marker, random) for name in SHAPES], NOMINAL,
        keep_all=True)
    errors = [
        found.drive.wheel_separation - truth.wheel_separation,
        found.drive.left_wheel_radius - truth.left_wheel_radius,
        found.drive.right_wheel_radius - truth.right_wheel_radius]
    return np.array(errors) / found.geometry_std


def scores(count: int, seed: int) -> Iterator[Array]:
    """Yield the z-scores of so many calibrations, on all cores."""
    with ProcessPoolExecutor(os.cpu_count()) as pool:
        yield from pool.map(functools.partial(z_scores), range(seed, seed + count), chunksize=5)


def check(count: int, seed: int) -> bool:
    """Print the table; return whether the error bars are true."""
    table = np.array(list(scores(count, seed)))
    band = BAND * math.sqrt(CALIBRATIONS / count)
    print(f'z-scores of {count} calibrations by {len(SHAPES)} runs each: must be within '
          f'{1.0 - band:.2f} and {1.0 + band:.2f} in standard deviation.')
    is_true = True
    for name, column in zip(('separation', 'left radius', 'right radius'), table.T, strict=True):
        spread = float(column.std())
        is_within = abs(spread - 1.0) < band
        is_true = is_true and is_within
        print(f'{name:13}mean {column.mean():6.3f}   standard deviation {spread:.3f}'
              + ('' if is_within else '   FAILED'))
    return is_true
