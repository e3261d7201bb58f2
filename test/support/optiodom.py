"""
The OptiOdom recordings as runs and as logs: see ../shared/data/optiodom/README.md.

As a program it writes them as CSVs for the tools, into a folder:
python test/support/optiodom.py FOLDER.
"""
from dataclasses import astuple
import math
from pathlib import Path
import sys

from diffdrive_ros.calibration.linearization import linearize
from diffdrive_ros.calibration.model import Run
from diffdrive_ros.core import se2
from diffdrive_ros.core.kinematics import DiffDrive
from diffdrive_ros.core.odometry import integrate
import numpy as np

DATA = Path(__file__).resolve().parents[3] / 'shared' / 'data' / 'optiodom'
CIRCULAR, SQUARE, OTHER_SQUARE = (
    'circular/231220200121', 'square/231220200029', 'square/231220200040')
TICK = 2.0 * math.pi / 2796.8  # [rad]
NOMINAL = DiffDrive(0.200, 0.042, 0.042)


def runs(recordings):
    """Return the runs of a set; the data have right ticks before left ones."""
    folder, prefix = recordings.split('/')
    return [_run(path) for path in sorted((DATA / folder).glob(f'{prefix}_run-*.csv'))]


def _run(path):
    seconds, x, y, theta, right_ticks, left_ticks = np.loadtxt(path, delimiter=',').T
    seconds = seconds - seconds[0]
    return Run(
        path.stem, seconds, np.cumsum(left_ticks) * TICK, np.cumsum(right_ticks) * TICK, seconds,
        np.stack([x, y, np.unwrap(theta)], axis=-1))


def write_csv(run, path):
    """Write a run as a log for the tools."""
    rows = zip(run.seconds, run.left, run.right, *run.reference.T, strict=True)
    path.write_text('stamp,left,right,x,y,theta\n' + ''.join(
        ','.join(f'{value:.9f}' for value in row) + '\n' for row in rows))
    return path


def median_final_error(drive, recordings):
    """Return the median final position error of a set [m], aligned at the first pose."""
    return float(np.median([
        np.hypot(*(integrate(drive, run.left, run.right)[-1] - run.reference[-1])[:2])
        for run in runs(recordings)]))


def mean_nees(found, recordings):
    """
    Return the mean NEES/3 of the last poses of a set, by a calibration.

    The start is the median over the first second: some first headings are off by up to 80 mrad.
    """
    scores = []
    capture = np.diag(np.square([found.position_std, found.position_std, found.heading_std]))
    slow = np.diag(np.square(
        [found.slow_position_std, found.slow_position_std, found.slow_heading_std]))
    for run in runs(recordings):
        linear = linearize(found.drive, run.left, run.right)
        body = se2.compose(run.reference, se2.inverse(found.marker))
        frames = se2.compose(body[:20], se2.inverse(linear.poses[:20]))
        frame = np.median(frames, axis=0)
        error = se2.compose(se2.inverse(frame), body[-1]) - linear.poses[-1]
        error[2] = se2.wrap_angle(error[2])
        geometry, start = linear.by_geometry[-1], linear.by_start[-1]
        covariance = (
            noise_covariances(linear, found.noise)[-1]
            + geometry @ found.predictive_covariance @ geometry.T + capture + slow
            + start @ (0.5 * math.pi / 20.0 * capture + slow) @ start.T)
        scores.append(error @ np.linalg.solve(covariance, error) / 3.0)
    return float(np.mean(scores))


def noise_covariances(linear, noise):
    """Return the covariance of each pose of a linearization by the wheels' noise, (N, 3, 3)."""
    seen = sum(value * each for value, each in zip(astuple(noise), linear.noise, strict=True))
    return linear.seen_from @ seen @ linear.seen_from.transpose(0, 2, 1)


def main(folder):
    """Write the runs of all sets as logs into a folder."""
    folder.mkdir(exist_ok=True)
    for recordings in (CIRCULAR, SQUARE, OTHER_SQUARE):
        for run in runs(recordings):
            print(write_csv(run, folder / f'{run.name}.csv'))


if __name__ == '__main__':
    main(Path(sys.argv[1]))
