"""A log of a run: the samples of its wheels and its reference, from a bag or a CSV."""
from dataclasses import dataclass
import math
from pathlib import Path

from diffdrive_ros.core.replay import Trajectory
from diffdrive_ros.core.validation import Array, UserError
from diffdrive_ros.core.wheel_feedback import WheelFeedback, WheelSample
from diffdrive_ros.tools import bags, csv_logs
from diffdrive_ros.tools.bags import StampedPose, Topics
import numpy as np
import numpy.typing as npt

HELP = (
    'rosbag2 folder, .mcap, .db3, or .csv with the header stamp,left,right[,x,y,theta]: stamps '
    '[s] that increase, wheel angles [rad] that are continuous and forward-positive (directions '
    'and wraps of the parameters are for bags), pose of the reference [m, m, rad]')


@dataclass(frozen=True)
class Log:
    """The samples of the wheels, as the node accepts them, and the reference, if any."""

    path: Path
    samples: list[WheelSample]
    reference: Trajectory | None

    def wheels(self) -> tuple[npt.NDArray[np.int64], Array, Array]:
        """
        Return stamps [ns], left and right angles [rad], (N,), stamps increasing.

        Raises UserError if the clock restarts in the log: its stamps are ambiguous then.
        """
        for sample in self.samples:
            if sample.time_reset_ns is not None:
                raise UserError(
                    f'{self.path}: the clock restarts at {sample.time_reset_ns * 1e-9:.3f} s: cut '
                    'the log there')
        stamps = np.array([sample.stamp_ns for sample in self.samples])
        angles = np.array([(sample.left, sample.right) for sample in self.samples])
        keep = np.concatenate([[True], stamps[1:] > np.maximum.accumulate(stamps)[:-1]])
        return stamps[keep], angles[keep, 0], angles[keep, 1]


def read(path: Path, feedback: WheelFeedback, topics: Topics | None = None) -> Log:
    """
    Return a log; feedback decodes the wheels of a bag as in the node.

    Raises UserError.
    """
    if not path.exists():
        raise UserError(f'{path}: no such file or folder')
    if path.is_dir() and not (path / 'metadata.yaml').is_file():
        raise UserError(f'{path}: is no rosbag2 folder: it has no metadata.yaml')
    if path.is_dir() or path.suffix in bags.SUFFIXES:
        samples, poses = bags.read_bag(path, feedback, topics or Topics())
    elif path.suffix == '.csv':
        samples, poses = csv_logs.read_csv(path)
    else:
        raise UserError(f'{path}: must be a rosbag2 folder, .mcap, .db3 or .csv')
    if len(samples) < 2:
        warning = f': {feedback.warning}' if feedback.warning else ''
        raise UserError(
            f'{path}: {len(samples)} samples of all wheels, must be 2 or more{warning}')
    return Log(path, samples, None if poses is None else _trajectory(path, poses))


def _trajectory(path: Path, poses: list[StampedPose]) -> Trajectory:
    """Return the finite poses in the order of their stamps; raises UserError below two."""
    finite = {pose.stamp_ns: pose for pose in poses if all(map(math.isfinite, pose.pose))}
    if len(finite) < 2:
        raise UserError(f'{path}: the reference has {len(finite)} poses, must be 2 or more')
    stamps = sorted(finite)
    array = np.array([finite[stamp].pose for stamp in stamps])
    array[:, 2] = np.unwrap(array[:, 2])
    return Trajectory(np.array(stamps), array)
