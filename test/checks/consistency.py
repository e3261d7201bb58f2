"""
Check the covariance of the odometry. As a script: tables, and exit code 1 if it is not true.

Thousands of simulated robots have the same wheel angles, each with its own noise and, in half of
the cells, its own radii and separation. One odometry receives the wheel
angles at a tenth of the rate. If its covariance P is true, e^T P^-1 e / 3 (NEES/3, e the error of
the last pose) has a mean of 1 over the robots, within the bounds of chi-square. The noise of the
wheels on the floor is drawn by code that shares nothing with the package.

A covariance is a linear approximation. Cells with a standard deviation of the final heading of
0.01 rad are checked; larger ones are printed only. On a straight line of length l, NEES/3 of white
noise is 1 + 0.19 (l sigma / s)^2 for a heading with the standard deviation sigma and a separation
s. Then each noise parameter of the odometry is halved, and the same check has to fail.

With --calibrations, the error bars of calibrations are checked: see calibration_consistency.py.
With --optiodom, a real robot under motion capture: noise fitted on one set of runs is checked on
the others.
"""
import argparse
from dataclasses import dataclass, fields, replace
import itertools
import math
from pathlib import Path
from statistics import NormalDist
import sys

from diffdrive_ros.core import se2
from diffdrive_ros.core.kinematics import DiffDrive
from diffdrive_ros.core.odometry import GeometryUncertainty, Odometry, WheelNoise
from diffdrive_ros.core.simulation import RobotModel, SimulatedRobot
import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]

RUNS = 2000
CONFIDENCE = 0.99  # for all checked cells together
CHECKED_STD_RAD = 0.01  # of the final heading
PRINTED_STDS_RAD = (0.02, 0.04, 0.1)

STEP_S = 0.005  # of the truth
STEPS_PER_SAMPLE = 10
START = (3.0, -2.0, 0.7)


@dataclass(frozen=True)
class Robot:
    """A robot; its noise and the uncertainty of its geometry are proportions, scaled per cell."""

    drive: DiffDrive
    noise: WheelNoise
    uncertainty: GeometryUncertainty


ROBOTS = {
    'equal': Robot(
        DiffDrive(0.30, 0.05, 0.05), WheelNoise(1e-5, 1e-5, 6e-5),
        GeometryUncertainty(1.2e-3, 7e-5, 7e-5)),
    'unequal': Robot(
        DiffDrive(0.317, 0.0471, 0.0533), WheelNoise(1e-5, 3e-5, 1.2e-4),
        GeometryUncertainty(1.5e-3, 1.2e-4, 8e-5)),
    'small': Robot(
        DiffDrive(0.16, 0.033, 0.033), WheelNoise(1e-5, 1e-5, 1e-4), GeometryUncertainty()),
}

# Linear [m/s] and angular [rad/s] speed, and for how long [s].
PATHS = {
    'straight': [(0.5, 0.0, 10.0)],
    'arc': [(0.5, 0.5, 6.0)],
    'spin': [(0.0, 1.5, 8.0)],
    'eight': [(0.5, 1.0, 2.0 * math.pi), (0.5, -1.0, 2.0 * math.pi)],
    '20 m': [(0.5, 0.0, 40.0)],
}


@dataclass(frozen=True)
class Cell:
    """One combination; heading is the standard deviation of the final heading [rad]."""

    path: str
    wheels: str
    systematic: bool
    heading: float = CHECKED_STD_RAD

    @property
    def drive(self) -> DiffDrive:
        """Return the geometry of the odometry."""
        return ROBOTS[self.wheels].drive


CHECKED_CELLS = tuple(
    Cell(path, wheels, systematic) for path, wheels, systematic in itertools.product(
        ('straight', 'arc', 'spin', 'eight'), ('equal', 'unequal'), (False, True)))
BENT_CELL = Cell('20 m', 'small', False)
"""Too long for a linear covariance even at the checked standard deviation: printed only."""


def wheel_angles(cell: Cell) -> Array:
    """Return the angles of the wheels [rad] at each step of the truth, (N, 2)."""
    drive = cell.drive
    robot = SimulatedRobot(RobotModel(
        drive.wheel_separation, drive.left_wheel_radius, drive.right_wheel_radius,
        ticks_per_revolution=0))
    angles = [robot.encoders]
    for linear, angular, seconds in PATHS[cell.path]:
        robot.command(*drive.wheel_speeds(linear, angular))
        for _ in range(STEPS_PER_SAMPLE * round(seconds / STEP_S / STEPS_PER_SAMPLE)):
            robot.advance(STEP_S)
            angles.append(robot.encoders)
    return np.array(angles)


def scaled(cell: Cell, angles: Array) -> tuple[WheelNoise, GeometryUncertainty]:
    """Return noise and uncertainty of the robot, scaled to the cell's heading."""
    robot, drive = ROBOTS[cell.wheels], cell.drive
    noise, uncertainty, s = robot.noise, robot.uncertainty, drive.wheel_separation
    moved = np.diff(angles, axis=0) * [drive.left_wheel_radius, drive.right_wheel_radius]
    left, right = np.abs(moved).sum(axis=0)
    turns = (moved[:, 1] - moved[:, 0]) / s
    variance = (
        (noise.left_travel * left + noise.right_travel * right) / s**2
        + noise.turn * np.abs(turns).sum())
    if cell.systematic:
        left_angle, right_angle = angles[-1] - angles[0]
        variance += (
            (uncertainty.left_wheel_radius * left_angle)**2
            + (uncertainty.right_wheel_radius * right_angle)**2
            + (uncertainty.wheel_separation * turns.sum())**2) / s**2
    size = cell.heading / math.sqrt(variance)
    return (
        WheelNoise(*(size**2 * getattr(noise, field.name) for field in fields(noise))),
        GeometryUncertainty(*(
            size * cell.systematic * getattr(uncertainty, field.name)
            for field in fields(uncertainty))))


def true_ends(
    drive: DiffDrive, noise: WheelNoise, uncertainty: GeometryUncertainty, angles: Array,
    runs: int, random: np.random.Generator,
) -> Array:
    """Return the last poses, (3, runs), of robots with these wheel angles and their own noise."""
    separation = drive.wheel_separation + (
        uncertainty.wheel_separation * random.standard_normal(runs))
    left_radius = drive.left_wheel_radius + (
        uncertainty.left_wheel_radius * random.standard_normal(runs))
    right_radius = drive.right_wheel_radius + (
        uncertainty.right_wheel_radius * random.standard_normal(runs))
    x, y, heading = (np.full(runs, coordinate) for coordinate in START)
    for left_angle, right_angle in np.diff(angles, axis=0):
        left, right = left_radius * left_angle, right_radius * right_angle
        scrub = np.sqrt(noise.turn * np.abs(right - left) / separation)
        left = left + np.sqrt(noise.left_travel * np.abs(left)) * random.standard_normal(runs)
        right = right + np.sqrt(noise.right_travel * np.abs(right)) * random.standard_normal(runs)
        turn = (right - left) / separation + scrub * random.standard_normal(runs)
        x += 0.5 * (left + right) * np.cos(heading + 0.5 * turn)
        y += 0.5 * (left + right) * np.sin(heading + 0.5 * turn)
        heading += turn
    return np.stack([x, y, heading])


def mean_nees(odometry: Odometry, ends: Array) -> float:
    """Return the mean of e^T P^-1 e / 3 of the odometry's last pose over the true ones."""
    errors = ends - odometry.pose[:, np.newaxis]
    squares = np.sum(errors * np.linalg.solve(odometry.pose_covariance, errors), axis=0)
    return float(squares.mean()) / 3.0


def odometry_of(
    cell: Cell, noise: WheelNoise, uncertainty: GeometryUncertainty, angles: Array,
) -> Odometry:
    """Return the odometry after these angles, at a tenth of their rate."""
    odometry = Odometry(
        cell.drive, noise=noise, geometry_uncertainty=uncertainty, start=START)
    period_ns = round(STEPS_PER_SAMPLE * STEP_S * 1e9)
    for number, (left, right) in enumerate(angles[::STEPS_PER_SAMPLE].tolist()):
        odometry.update(left, right, number * period_ns)
    return odometry


PARAMETERS = tuple(field.name for field in (*fields(WheelNoise), *fields(GeometryUncertainty)))


def halved(
    name: str, noise: WheelNoise, uncertainty: GeometryUncertainty,
) -> tuple[WheelNoise, GeometryUncertainty]:
    """Return noise and uncertainty with the parameter of this name, if any, halved."""
    if hasattr(noise, name):
        return replace(noise, **{name: 0.5 * getattr(noise, name)}), uncertainty
    if hasattr(uncertainty, name):
        return noise, replace(uncertainty, **{name: 0.5 * getattr(uncertainty, name)})
    return noise, uncertainty


def nees_of(
    cell: Cell, names: tuple[str, ...] = ('',), *, runs: int = RUNS, seed: int = 0,
) -> list[float]:
    """Return the mean NEES/3 of a cell, once for each name of a halved parameter."""
    angles = wheel_angles(cell)
    noise, uncertainty = scaled(cell, angles)
    ends = true_ends(
        cell.drive, noise, uncertainty, angles, runs, np.random.default_rng(seed))
    return [
        mean_nees(odometry_of(cell, *halved(name, noise, uncertainty), angles), ends)
        for name in names]


def band(cells: int, runs: int = RUNS) -> tuple[float, float]:
    """
    Return the bounds of the mean NEES/3 of each of the cells.

    If the covariance is true, all of them are within with a probability of CONFIDENCE: two-sided
    quantiles of chi-square with 3 degrees of freedom a run, by Wilson and Hilferty, with
    Bonferroni's correction for the number of cells.
    """
    z = NormalDist().inv_cdf(1.0 - 0.5 * (1.0 - CONFIDENCE) / cells)
    spread = 2.0 / (9.0 * 3.0 * runs)
    low, high = ((1.0 - spread + sign * z * math.sqrt(spread))**3 for sign in (-1.0, 1.0))
    return low, high


def check(runs: int, seed: int, halve: str) -> bool:
    """Print the tables of the simulated runs; return whether the covariance is true."""
    low, high = band(len(CHECKED_CELLS), runs)
    names = (halve,) if halve else ('', *PARAMETERS)
    print(f'Mean NEES/3 of {runs} runs a cell, by the std of the final heading [rad].')
    print(f'Checked: {CHECKED_STD_RAD} rad, must be within {low:.3f} and {high:.3f}.\n')
    print(f'{"path":9}{"wheels":9}{"geometry":11}' + ''.join(
        f'{heading:8}' for heading in (CHECKED_STD_RAD, *PRINTED_STDS_RAD)))
    table = []
    for number, cell in enumerate((*CHECKED_CELLS, BENT_CELL)):
        checked = nees_of(cell, names, runs=runs, seed=seed + number)
        beyond = (
            nees_of(replace(cell, heading=heading), names[:1], runs=runs, seed=seed + number)
            for heading in PRINTED_STDS_RAD)
        print(f'{cell.path:9}{cell.wheels:9}{"uncertain" if cell.systematic else "exact":11}'
              + ''.join(f'{nees:8.3f}' for nees in (checked[0], *itertools.chain(*beyond)))
              + ('   not checked' if cell is BENT_CELL else
                 '' if low < checked[0] < high else '   FAILED'), flush=True)
        if cell is not BENT_CELL:
            table.append(checked)
    print()
    is_true = all(low < row[0] < high for row in table)
    for name, column in zip(names[1:], list(zip(*table, strict=True))[1:], strict=True):
        is_detected = not all(low < nees < high for nees in column)
        is_true = is_true and is_detected
        print(f'{name} halved: {min(column):.3f} to {max(column):.3f}, '
              + ('the check fails, as it must' if is_detected else 'NOT DETECTED'))
    return is_true


# The real robot: see ../shared/data/optiodom/README.md.

OPTIODOM = Path(__file__).resolve().parents[3] / 'shared' / 'data' / 'optiodom'
SETS = ('square/231220200029', 'square/231220200040', 'circular/231220200121')
TICK = 2.0 * math.pi / 2796.8  # [rad]
CALIBRATED = DiffDrive(0.2022, 0.0419, 0.04185)
# Of one captured pose, from its jitter along the runs: position [m] and heading [rad].
CAPTURE = (0.0005, 0.004)
# The runs do not separate travel and scrub: one size k of the noise, in these proportions.
PROPORTIONS = WheelNoise(1.0, 1.0, 10.0)


@dataclass(frozen=True)
class RealRuns:
    """Real runs: errors of their last poses, (N, 3), and the covariances, (N, 3, 3)."""

    errors: Array
    noise: Array  # for k = 1
    capture: Array

    def nees(self, k: float) -> float:
        """Return the mean NEES/3 for noise of size k."""
        covariances = k * self.noise + self.capture
        solved = np.linalg.solve(covariances, self.errors[..., np.newaxis])[..., 0]
        return float(np.sum(self.errors * solved, axis=-1).mean()) / 3.0

    def likelihood(self, k: float) -> float:
        """Return the logarithm of the likelihood of the errors, but for a constant."""
        determinants = np.linalg.slogdet(k * self.noise + self.capture)[1]
        return -0.5 * (3.0 * self.nees(k) * len(self.errors) + float(determinants.sum()))

    def fitted(self) -> float:
        """Return the size k of the noise [m^2/m] that makes the errors the likeliest."""
        return max(np.geomspace(1e-8, 1e-3, 501).tolist(), key=self.likelihood)


def real_runs(recordings: str, parts: int) -> RealRuns:
    """Return the runs of a set, each cut into parts of equal travel."""
    folder, prefix = recordings.split('/')
    runs = [
        part for path in sorted((OPTIODOM / folder).glob(f'{prefix}_run-*.csv'))
        for part in _parts_of(np.loadtxt(path, delimiter=',').T, parts)]
    return RealRuns(*(np.array(column) for column in zip(*runs, strict=True)))


def _parts_of(columns: Array, parts: int) -> list[tuple[Array, Array, Array]]:
    _, x, y, theta, right_ticks, left_ticks = columns
    truth = np.stack([x, y, np.unwrap(theta)], axis=-1)
    wheels = np.cumsum(np.stack([left_ticks, right_ticks], axis=-1), axis=0) * TICK
    travel = np.cumsum(np.abs(left_ticks) + np.abs(right_ticks))
    cuts = np.searchsorted(travel, travel[-1] * np.arange(1, parts) / parts)
    runs = []
    for first, last in itertools.pairwise([0, *cuts.tolist(), len(travel) - 1]):
        odometry = Odometry(CALIBRATED, noise=PROPORTIONS)
        for stamp, (left, right) in enumerate(wheels[first:last + 1].tolist()):
            odometry.update(left, right, stamp)
        pose, true_pose = odometry.pose, se2.between(truth[first], truth[last])
        # An error of the first captured heading rotates the whole run about its start.
        turned = np.array([-pose[1], pose[0], 1.0])
        capture = CAPTURE[1]**2 * (np.outer(turned, turned) + np.diag([0.0, 0.0, 1.0]))
        capture += 2.0 * CAPTURE[0]**2 * np.diag([1.0, 1.0, 0.0])
        error = true_pose - pose
        error[2] = se2.wrap_angle(error[2])
        runs.append((error, odometry.pose_covariance, capture))
    return runs


def print_optiodom() -> None:
    """Print the mean NEES/3 of all sets by the noise fitted on the quarter runs of each set."""
    print('k [m^2/m] fitted on the quarter runs of a set; mean NEES/3 of the last poses of')
    print(f'{"fitted on":24}{"k":>9}' + ''.join(f'{recordings:>24}' for recordings in SETS))
    for fitted_on in SETS:
        k = real_runs(fitted_on, 4).fitted()
        print(f'{fitted_on:24}{k:9.1e}' + ''.join(
            f'{real_runs(recordings, 1).nees(k):24.2f}' for recordings in SETS))


def main() -> int:
    """Print the tables; return 0 if the covariance is true."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument('--runs', type=int, default=RUNS, help='of each cell; default %(default)s')
    parser.add_argument('--seed', type=int, default=0, help='of the truth; default %(default)s')
    parser.add_argument(
        '--halve', choices=PARAMETERS, default='', help='halve this one in the odometry')
    parser.add_argument(
        '--calibrations', type=int, default=0, help='check the error bars of so many instead')
    parser.add_argument('--optiodom', action='store_true', help=f'check the runs in {OPTIODOM}')
    arguments = parser.parse_args()
    if arguments.optiodom:
        print_optiodom()
        return 0
    if arguments.calibrations:
        from checks.calibration_consistency import check as check_calibrations
        is_true = check_calibrations(arguments.calibrations, arguments.seed)
        print('\nThe error bars are ' + ('true.' if is_true else 'NOT true.'))
        return 0 if is_true else 1
    is_true = check(arguments.runs, arguments.seed, arguments.halve)
    print('\nThe covariance is ' + ('true.' if is_true else 'NOT true.'))
    return 0 if is_true else 1


if __name__ == '__main__':
    sys.exit(main())
