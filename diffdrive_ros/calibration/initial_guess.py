"""Where the search for the geometry starts: estimates without noise model or clock offset."""
from collections.abc import Sequence
from dataclasses import replace

from diffdrive_ros.calibration.model import Run
from diffdrive_ros.calibration.residuals import resampled
from diffdrive_ros.core import se2
from diffdrive_ros.core.kinematics import DiffDrive
from diffdrive_ros.core.odometry import integrate
from diffdrive_ros.core.validation import Array
import numpy as np
from scipy import optimize

POSES = 50  # of each run


def geometry_of(runs: Sequence[Run]) -> DiffDrive | None:
    """
    Return a rough geometry of runs that turn and travel, without a nominal one; or None.

    Headings are linear in the wheel angles, by radii over separation; the distance that the robot
    travels then gives the separation. The marker's offset is neglected.
    """
    angles, headings, distances = [], [], []
    for index, run in enumerate(runs):
        inside = run.overlap()
        run = replace(
            run, reference=run.reference[inside], reference_seconds=run.reference_seconds[inside])
        _, left, right, indices = resampled(run, 0.0)
        own = np.zeros((len(indices), len(runs)))
        own[:, index] = 1.0
        # Thinned only here: headings further apart could not be unwrapped.
        few = np.linspace(0, len(indices) - 1, min(len(indices), POSES)).astype(int)
        angles.append(np.column_stack([-left[indices], right[indices], own])[few])
        headings.append(np.unwrap(run.reference[:, 2])[few])
        distances.append(np.hypot(*np.diff(run.reference[few, :2], axis=0).T))
    matrix, heading = np.concatenate(angles), np.concatenate(headings)
    # Robust against one wrong run: the sum of errors rather than of their squares.
    ratios: Array = optimize.least_squares(
        lambda unknown: matrix @ unknown - heading, np.zeros(matrix.shape[1]),
        lambda unknown: matrix, loss='soft_l1', f_scale=0.1).x[:2]
    if not (ratios > 0.0).all():
        return None
    arcs = np.concatenate([
        0.5 * np.diff(each[:, :2], axis=0) @ [-ratios[0], ratios[1]] for each in angles])
    turns = np.concatenate([np.diff(each) for each in headings])
    chords = np.abs(arcs * se2.chord_over_arc(0.5 * turns))
    is_long = (chords >= np.median(chords)) & (chords > 0.0)
    separation = float(
        np.median(np.concatenate(distances)[is_long] / chords[is_long])) if is_long.any() else 0.0
    if not separation > 0.0:
        return None
    left_radius, right_radius = (ratios * separation).tolist()
    return DiffDrive(separation, left_radius, right_radius)


def marker_heading(runs: Sequence[Run], drive: DiffDrive) -> float:
    """Return a rough heading of the marker in the body frame, by the directions of travel."""
    product = 0.0 + 0.0j
    for run in runs:
        _, left, right, indices = resampled(run, 0.0)
        moves = []
        for poses in (integrate(drive, left, right)[indices], run.reference):
            x, y, _ = se2.between(poses[:-1], poses[1:]).T
            moves.append(x + 1j * y)
        product += np.vdot(moves[1], moves[0])
    return float(np.angle(product))
