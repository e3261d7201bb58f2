"""Pictures; matplotlib is imported only when one is drawn."""
from pathlib import Path

from diffdrive_ros.arguments import Array
import numpy as np


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
