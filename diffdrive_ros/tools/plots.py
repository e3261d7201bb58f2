"""Plots of results; matplotlib is imported only when one is drawn."""
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any, TYPE_CHECKING

from diffdrive_ros.core import se2
from diffdrive_ros.core.evaluation import distances_along
from diffdrive_ros.core.replay import Comparison, ReplayedOdometry
from diffdrive_ros.core.validation import Array
from diffdrive_ros.core.wheel_feedback import WheelSample
import numpy as np

if TYPE_CHECKING:  # the demo and replay do without scipy
    from diffdrive_ros.calibration.cross_validation import FinalErrors
    from diffdrive_ros.calibration.model import Calibration

COLOURS = {'before': 'tab:orange', 'after': 'tab:blue', 'odometry': 'tab:blue'}
ELLIPSES = 12  # along a trajectory
EQUAL = {'aspect': 'equal', 'adjustable': 'datalim'}  # both scales
LEGEND = {'loc': 'upper center', 'bbox_to_anchor': (0.5, -0.14)}


def draw_trajectories(
    path: Path, title: str, seconds: Array, odometry: Array, truth: Array,
) -> None:
    """
    Draw odometry and ground truth over each other, and the error over time, into an image file.

    seconds has the shape (N,); odometry and truth are poses at the same times, (N, 3).
    """
    with _page(path, title, 120, (1, 2), (10.0, 5.5), width_ratios=(1.2, 1.0)) as (
            trajectories, errors):
        trajectories.plot(
            truth[:, 0], truth[:, 1], color='0.6', linewidth=5.0, label='ground truth')
        trajectories.plot(
            odometry[:, 0], odometry[:, 1], color='tab:blue', linewidth=1.5, label='odometry')
        trajectories.plot(*truth[0, :2], 'o', color='black', label='start')
        trajectories.plot(*truth[-1, :2], 's', color='0.4', label='true end')
        trajectories.plot(
            *odometry[-1, :2], 'x', color='tab:blue', markersize=9.0, label='odometry end')
        _label(trajectories, 'x [m]', 'y [m]', 'Trajectories', **EQUAL)
        position = np.hypot(*(odometry[:, :2] - truth[:, :2]).T)
        errors.plot(seconds, 100.0 * position, color='tab:blue', label='position [cm]')
        errors.plot(
            seconds, np.degrees(odometry[:, 2] - truth[:, 2]), color='tab:orange',
            label='heading [deg]')
        _label(errors, 'time [s]', 'odometry against ground truth', 'Error')


def draw_replay(
    path: Path, title: str, samples: Sequence[WheelSample],
    results: Mapping[str, ReplayedOdometry], comparisons: Mapping[str, Comparison],
) -> None:
    """Draw a page of one log: trajectories with ellipses, errors over distance, wheel speeds."""
    with _page(path, title, 100, (2, 2), (12.0, 10.0)) as (
            (trajectories, errors), (headings, speeds)):
        for number, (name, comparison) in enumerate(comparisons.items()):
            label = name or 'odometry'
            colour = COLOURS[label]
            if number == 0:
                _reference(trajectories, comparison)
            _trajectory(trajectories, comparison, colour, label, has_ellipses=True)
            distance, error = _errors(comparison)
            errors.plot(
                distance, 1e3 * np.hypot(error[:, 0], error[:, 1]), color=colour, label=label)
            headings.plot(distance, 1e3 * error[:, 2], color=colour, label=label)
            bound = 1e3 * 2.0 * np.sqrt(comparison.covariances[:, 2, 2])
            headings.plot(
                distance, np.stack([bound, -bound], axis=-1), color=colour, linewidth=0.8,
                linestyle='--')
        if not comparisons:
            for name, replayed in results.items():
                trajectories.plot(
                    *replayed.poses[:, :2].T, color=COLOURS[name or 'odometry'], label=name)
        _label(trajectories, 'x [m]', 'y [m]', 'Trajectories, with ellipses of 2 std', **EQUAL)
        _label(errors, 'distance [m]', 'position error [mm]', 'Position error')
        _label(headings, 'distance [m]', 'heading error [mrad]', 'Heading error; dashed: 2 std')
        wheels = np.array([(each.left, each.right) for each in samples]).T
        seconds = np.array([each.stamp_ns - samples[0].stamp_ns for each in samples]) * 1e-9
        steps = np.diff(seconds)
        is_step = steps > 0.0
        for side, angles in zip(('left', 'right'), wheels, strict=True):
            speeds.plot(
                seconds[1:][is_step], np.diff(angles)[is_step] / steps[is_step], linewidth=0.8,
                label=side)
        _label(speeds, 'time [s]', 'wheel speed [rad/s]', 'Wheels')


def draw_calibration(
    path: Path, comparisons: Sequence[Mapping[str, Comparison]], found: 'Calibration',
    errors: 'Sequence[FinalErrors]',
) -> None:
    """Draw a page of a calibration: trajectories before and after, their errors, residuals."""
    stds = [f'{1e3 * each:.3f}' if each else 'unknown' for each in found.geometry_std]
    title = (
        f'Calibration: separation {1e3 * found.drive.wheel_separation:.2f} ± {stds[0]}, radii '
        f'left {1e3 * found.drive.left_wheel_radius:.3f} ± {stds[1]}, '
        f'right {1e3 * found.drive.right_wheel_radius:.3f} ± {stds[2]} mm')
    with _page(path, title, 80, (2, 3), (16.0, 10.0)) as (
            (trajectories, positions, ends), (bars, residuals, headings)):
        _reference(trajectories, comparisons[0]['before'])
        for number, both in enumerate(comparisons):
            for name, label in (('before', 'before'), ('after', 'calibrated')):
                colour = COLOURS[name]
                if number == 0:
                    _trajectory(trajectories, both[name], colour, label, name == 'after')
                distance, error = _errors(both[name])
                once = label if number == 0 else None
                positions.plot(
                    distance, 1e3 * np.hypot(error[:, 0], error[:, 1]), color=colour,
                    linewidth=0.8, label=once)
                ends.plot(*(-1e3 * error[-1, :2]), 'o', color=colour, label=once)
        _label(trajectories, 'x [m]', 'y [m]', f'{errors[0].name}, ellipses of 2 std', **EQUAL)
        _label(positions, 'distance [m]', 'position error [mm]', 'All runs')
        ends.axhline(0.0, color='0.5', linewidth=0.8)
        ends.axvline(0.0, color='0.5', linewidth=0.8)
        _label(ends, 'x [mm]', 'y [mm]', 'Errors of the final positions', **EQUAL)
        rows = np.arange(len(errors))
        for shift, (label, values, colour) in zip((-0.27, 0.0, 0.27), (
                ('before', [each.before for each in errors], 'tab:orange'),
                ('calibrated', [each.calibrated for each in errors], 'tab:blue'),
                ('cross-validated', [each.cross_validated for each in errors], 'tab:green')),
                strict=True):
            bars.barh(rows + shift, 1e3 * np.array(values, float), 0.25, color=colour, label=label)
        bars.set_yticks(rows, [each.name[-24:] for each in errors])
        bars.invert_yaxis()
        _label(bars, 'final position error [mm]', '', 'Final errors')
        for number, run in enumerate(each for each in found.runs if not each.outlier):
            colour = f'C{number % 10}'
            x, y, heading = 1e3 * run.residuals.T
            residuals.plot(run.distances, x, color=colour, linewidth=0.6)
            residuals.plot(run.distances, y, color=colour, linewidth=0.6, linestyle='--')
            headings.plot(run.distances, heading, color=colour, linewidth=0.6)
        _label(
            residuals, 'distance [m]', 'residual [mm]',
            'Position residuals: x solid, y dashed; a colour per run')
        _label(headings, 'distance [m]', 'residual [mrad]', 'Heading residuals')


def _errors(comparison: Comparison) -> tuple[Array, Array]:
    """Return the distance driven [m], (N,), and the error of each pose, (N, 3)."""
    errors = comparison.reference - comparison.poses
    errors[:, 2] = se2.wrap_angle(errors[:, 2])
    return distances_along(comparison.poses), errors


def _reference(axes: Any, comparison: Comparison) -> None:
    axes.plot(*comparison.reference[:, :2].T, color='0.7', linewidth=4.0, label='reference')


def _trajectory(
    axes: Any, comparison: Comparison, colour: str, label: str, has_ellipses: bool,
) -> None:
    """Draw a trajectory, with ellipses of 2 standard deviations along it."""
    axes.plot(*comparison.poses[:, :2].T, color=colour, linewidth=1.2, label=label)
    count = len(comparison.poses)
    angle = np.linspace(0.0, 2.0 * np.pi, 40)
    circle = np.stack([np.cos(angle), np.sin(angle)])
    for index in np.unique(np.linspace(0, count - 1, min(count, ELLIPSES)).astype(int)):
        if has_ellipses:
            values, vectors = np.linalg.eigh(comparison.covariances[index, :2, :2])
            x, y = comparison.poses[index, :2, np.newaxis] + (
                2.0 * vectors * np.sqrt(np.maximum(values, 0.0)) @ circle)
            axes.plot(x, y, color=colour, linewidth=0.7)


@contextmanager
def _page(
    path: Path, title: str, dpi: int, shape: tuple[int, int], size: tuple[float, float],
    width_ratios: tuple[float, ...] | None = None,
) -> Iterator[Any]:
    """Yield the axes of a page; save it as an image file."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=size, layout='constrained')
    figure.suptitle(title)
    yield figure.subplots(*shape, width_ratios=width_ratios)
    figure.savefig(path, dpi=dpi)


def _label(axes: Any, x: str, y: str, title: str, **properties: str) -> None:
    axes.set(xlabel=x, ylabel=y, title=title, **properties)
    axes.grid(alpha=0.3)
    if axes.get_legend_handles_labels()[0]:
        axes.legend(**LEGEND, ncols=3)
