"""Pictures; matplotlib is imported only when one is drawn."""
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, TYPE_CHECKING

from diffdrive_ros.core.evaluation import distances_along
from diffdrive_ros.core.replay import Comparison, ReplayedOdometry
from diffdrive_ros.core.validation import Array
import numpy as np

if TYPE_CHECKING:
    from diffdrive_ros.calibration.cross_validation import FinalErrors
    from diffdrive_ros.calibration.model import Calibration
    from diffdrive_ros.tools.logs import Log

COLOURS = {'before': 'tab:orange', 'after': 'tab:blue', 'odometry': 'tab:blue'}
ELLIPSES = 12  # along a track
LEGEND = {'loc': 'upper center', 'bbox_to_anchor': (0.5, -0.14)}


def draw_tracks(path: Path, title: str, seconds: Array, odometry: Array, truth: Array) -> None:
    """
    Draw two tracks over each other, and how far they are apart, into an image file.

    seconds has the shape (N,); odometry and truth are poses of the same moments, (N, 3).
    """
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(10.0, 5.5), layout='constrained')
    FigureCanvasAgg(figure)
    tracks, errors = figure.subplots(1, 2, width_ratios=(1.2, 1.0))
    figure.suptitle(title)

    tracks.plot(truth[:, 0], truth[:, 1], color='0.6', linewidth=5.0, label='true')
    tracks.plot(odometry[:, 0], odometry[:, 1], color='tab:blue', linewidth=1.5, label='odometry')
    tracks.plot(*truth[0, :2], 'o', color='black', label='start')
    tracks.plot(*truth[-1, :2], 's', color='0.4', label='true end')
    tracks.plot(*odometry[-1, :2], 'x', color='tab:blue', markersize=9.0, label='odometry end')
    tracks.set(xlabel='x [m]', ylabel='y [m]', title='Tracks')
    tracks.set_aspect('equal', adjustable='datalim')
    tracks.grid(alpha=0.3)
    tracks.legend(loc='upper center', bbox_to_anchor=(0.5, -0.12), ncols=3)

    apart = np.hypot(*(odometry[:, :2] - truth[:, :2]).T)
    errors.plot(seconds, 100.0 * apart, color='tab:blue', label='position [cm]')
    errors.plot(
        seconds, np.degrees(odometry[:, 2] - truth[:, 2]), color='tab:orange',
        label='heading [deg]')
    errors.set(xlabel='time [s]', ylabel='odometry against truth', title='Error')
    errors.grid(alpha=0.3)
    errors.legend(loc='upper center', bbox_to_anchor=(0.5, -0.12), ncols=2)
    figure.savefig(path, dpi=120)


def draw_replay(
    path: Path, log: 'Log', results: Mapping[str, ReplayedOdometry],
    comparisons: Mapping[str, Comparison],
) -> None:
    """Draw a page of one log: tracks with ellipses, errors along the way, speeds of the wheels."""
    figure, ((tracks, errors), (headings, speeds)) = _page(2, 2, (12.0, 10.0))
    figure.suptitle(log.name)
    for name, comparison in comparisons.items():
        label = name or 'odometry'
        colour = COLOURS[label]
        if name == next(iter(comparisons)):
            tracks.plot(
                *comparison.reference[:, :2].T, color='0.7', linewidth=4.0, label='reference')
        tracks.plot(*comparison.poses[:, :2].T, color=colour, linewidth=1.2, label=label)
        for index in _spread_out(len(comparison.poses)):
            _ellipse(
                tracks, comparison.poses[index], comparison.covariances[index], colour)
        apart = comparison.reference - comparison.poses
        way = distances_along(comparison.poses)
        errors.plot(way, 1e3 * np.hypot(apart[:, 0], apart[:, 1]), color=colour, label=label)
        wrapped = np.arctan2(np.sin(apart[:, 2]), np.cos(apart[:, 2]))
        headings.plot(way, 1e3 * wrapped, color=colour, label=label)
        known = 1e3 * 2.0 * np.sqrt(comparison.covariances[:, 2, 2])
        headings.plot(way, known, color=colour, linewidth=0.8, linestyle='--')
        headings.plot(way, -known, color=colour, linewidth=0.8, linestyle='--')
    if not comparisons:
        for name, replayed in results.items():
            tracks.plot(*replayed.poses[:, :2].T, color=COLOURS[name or 'odometry'], label=name)
    _label(tracks, 'x [m]', 'y [m]', 'Tracks, with ellipses of 2 deviations')
    tracks.set_aspect('equal', adjustable='datalim')
    _label(errors, 'way [m]', 'position error [mm]', 'Position against the reference')
    _label(headings, 'way [m]', 'heading error [mrad]', 'Heading; dashed: 2 deviations')
    stamps = np.array([sample.stamp_ns for sample in log.samples])
    seconds = (stamps - stamps[0]) * 1e-9
    angles = np.array([(sample.left, sample.right) for sample in log.samples])
    growing = np.flatnonzero(np.diff(seconds) > 0.0)
    for side, column in (('left', 0), ('right', 1)):
        rate = np.diff(angles[:, column])[growing] / np.diff(seconds)[growing]
        speeds.plot(seconds[1:][growing], rate, linewidth=0.8, label=side)
    _label(speeds, 'time [s]', 'speed [rad/s]', 'Wheels')
    figure.savefig(path, dpi=100)


def draw_calibration(
    path: Path, comparisons: Sequence[Mapping[str, Comparison]], found: 'Calibration',
    judged: 'Sequence[FinalErrors]',
) -> None:
    """Draw a page of a calibration: tracks before and after, their errors, and the residuals."""
    figure, axes = _page(2, 3, (16.0, 10.0))
    (tracks, errors, ends), (bars, positions, headings) = axes
    known = [f'{1e3 * each:.3f}' if each else 'not known' for each in found.geometry_std]
    figure.suptitle(
        f'Calibration: separation {1e3 * found.drive.wheel_separation:.2f} ± {known[0]}, radii '
        f'left {1e3 * found.drive.left_wheel_radius:.3f} ± {known[1]}, '
        f'right {1e3 * found.drive.right_wheel_radius:.3f} ± {known[2]} mm')
    for number, both in enumerate(comparisons):
        for name, label in (('before', 'before'), ('after', 'calibrated')):
            each, colour = both[name], COLOURS[name]
            once = label if number == 0 else None
            if number == 0:
                if name == 'before':
                    tracks.plot(
                        *each.reference[:, :2].T, color='0.7', linewidth=4.0, label='reference')
                tracks.plot(*each.poses[:, :2].T, color=colour, linewidth=1.2, label=label)
                for index in _spread_out(len(each.poses)) if name == 'after' else ():
                    _ellipse(tracks, each.poses[index], each.covariances[index], colour)
            apart = each.poses - each.reference
            way = distances_along(each.poses)
            errors.plot(
                way, 1e3 * np.hypot(apart[:, 0], apart[:, 1]), color=colour, linewidth=0.8,
                label=once)
            ends.plot(
                1e3 * apart[-1, 0], 1e3 * apart[-1, 1], 'o', color=colour, label=once)
    tracks.set_aspect('equal', adjustable='datalim')
    _label(tracks, 'x [m]', 'y [m]', f'{judged[0].name}, ellipses of 2 deviations')
    _label(errors, 'way [m]', 'position error [mm]', 'All drives')
    ends.axhline(0.0, color='0.5', linewidth=0.8)
    ends.axvline(0.0, color='0.5', linewidth=0.8)
    ends.set_aspect('equal', adjustable='datalim')
    _label(ends, 'x [mm]', 'y [mm]', 'Errors of the last positions')
    places = np.arange(len(judged))
    for offset, (label, values, colour) in zip((-0.27, 0.0, 0.27), (
            ('before', [each.before for each in judged], 'tab:orange'),
            ('calibrated', [each.calibrated for each in judged], 'tab:blue'),
            ('by the others only', [each.cross_validated for each in judged], 'tab:green')),
            strict=True):
        bars.barh(places + offset, 1e3 * np.array(values, float), 0.25, color=colour, label=label)
    bars.set_yticks(places, [each.name[-24:] for each in judged])
    bars.invert_yaxis()
    _label(bars, 'final position error [mm]', '', 'Final errors')
    for number, drive in enumerate(each for each in found.runs if not each.outlier):
        colour = f'C{number % 10}'
        x, y, heading = 1e3 * drive.residuals.T
        positions.plot(drive.distances, x, color=colour, linewidth=0.6)
        positions.plot(drive.distances, y, color=colour, linewidth=0.6, linestyle='--')
        headings.plot(drive.distances, heading, color=colour, linewidth=0.6)
    _label(
        positions, 'way [m]', 'residual [mm]', 'Residuals: x solid, y dashed; a colour a drive')
    _label(headings, 'way [m]', 'residual [mrad]', 'Residuals: heading')
    figure.savefig(path, dpi=80)


def _page(rows: int, columns: int, size: tuple[float, float]) -> tuple[Any, Any]:
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=size, layout='constrained')
    FigureCanvasAgg(figure)
    return figure, figure.subplots(rows, columns)


def _label(axes: Any, x: str, y: str, title: str) -> None:
    axes.set(xlabel=x, ylabel=y, title=title)
    axes.grid(alpha=0.3)
    if axes.get_legend_handles_labels()[0]:
        axes.legend(**LEGEND, ncols=3)


def _spread_out(count: int) -> Array:
    return np.unique(np.linspace(0, count - 1, min(count, ELLIPSES)).astype(int))


def _ellipse(axes: Any, pose: Array, covariance: Array, colour: str) -> None:
    """Draw the ellipse of 2 deviations of a position."""
    values, vectors = np.linalg.eigh(covariance[:2, :2])
    angle = np.linspace(0.0, 2.0 * np.pi, 40)
    circle = np.stack([np.cos(angle), np.sin(angle)])
    x, y = pose[:2, np.newaxis] + 2.0 * vectors * np.sqrt(np.maximum(values, 0.0)) @ circle
    axes.plot(x, y, color=colour, linewidth=0.7)
