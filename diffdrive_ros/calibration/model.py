"""Data of a calibration: the recorded runs it takes, the geometry and noise it returns."""
from dataclasses import dataclass, field, replace
import math

from diffdrive_ros.core.kinematics import DiffDrive
from diffdrive_ros.core.odometry import GeometryUncertainty, WheelNoise
from diffdrive_ros.core.replay import Trajectory
from diffdrive_ros.core.validation import Array, UserError
from diffdrive_ros.core.wheel_feedback import WheelSample
import numpy as np
import numpy.typing as npt

GEOMETRY_PARAMETERS = ('wheel_separation', 'left_wheel_radius', 'right_wheel_radius')

# A calibrated parameter outside these multiples of its nominal value is rejected.
PLAUSIBLE_RATIOS = (0.5, 2.0)

# Least standard deviation of the separation between kinds of motion, relative to the separation:
# runs of one kind cannot show it. Borenstein and Feng (1996) report up to a hundredth.
MIN_SEPARATION_SPREAD = 0.003


def check_geometry(found: DiffDrive, nominal: DiffDrive, causes: str) -> None:
    """Raise UserError, ending in the likely causes, for a geometry far from the nominal one."""
    least, most = PLAUSIBLE_RATIOS
    for name in GEOMETRY_PARAMETERS:
        value, expected = getattr(found, name), getattr(nominal, name)
        if not least <= value / expected <= most:
            raise UserError(
                f'{name} = {1e3 * value:.4g} mm: must be {least:g} to {most:g} times '
                f'{1e3 * expected:.4g} mm: {causes}')


@dataclass(frozen=True)
class Run:
    """
    A recorded run: wheel angles [rad] and reference poses, with timestamps [s] of one clock.

    seconds, left, right: (N,), seconds increasing. reference_seconds: (M,), increasing;
    reference: (M, 3), poses of a marker on the robot in any frame, headings wrapped or not.
    Raises UserError.
    """

    name: str
    seconds: Array
    left: Array
    right: Array
    reference_seconds: Array
    reference: Array

    def __post_init__(self) -> None:
        for what, stamps in (('wheels', self.seconds), ('reference', self.reference_seconds)):
            if stamps.size < 2:
                raise UserError(
                    f'{self.name}: samples of the {what} = {stamps.size}: must be 2 or more')
            if not (np.diff(stamps) > 0.0).all():
                raise UserError(f'{self.name}: timestamps of the {what}: must increase')
        if np.count_nonzero(self.overlap()) < 3:
            raise UserError(
                f'{self.name}: the reference, from {self.reference_seconds[0]:.3f} to '
                f'{self.reference_seconds[-1]:.3f} s, does not overlap the wheels, from '
                f'{self.seconds[0]:.3f} to {self.seconds[-1]:.3f} s')
        if not self.wheel_travel()[-1] > 0.0:
            raise UserError(f'{self.name}: the wheels do not turn')

    def overlap(self) -> Array:
        """Return which reference poses lie between the first and last wheel sample, (M,)."""
        stamps = self.reference_seconds
        is_inside: Array = (stamps >= self.seconds[0]) & (stamps <= self.seconds[-1])
        return is_inside

    def wheel_travel(self) -> Array:
        """Return the travel of both wheels together up to each sample [rad], (N,)."""
        steps = np.abs(np.diff(self.left)) + np.abs(np.diff(self.right))
        return np.concatenate([[0.0], np.cumsum(steps)])

    def thinned(self, count: int) -> 'Run':
        """Return the run with at most so many reference poses, evenly spaced along the path."""
        inside = np.flatnonzero(self.overlap())
        travel = np.interp(self.reference_seconds[inside], self.seconds, self.wheel_travel())
        wanted = np.linspace(travel[0], travel[-1], count)
        chosen = inside[np.unique(np.minimum(np.searchsorted(travel, wanted), len(inside) - 1))]
        chosen[-1] = inside[-1]
        return replace(
            self, reference_seconds=self.reference_seconds[chosen],
            reference=self.reference[chosen])

    def samples(self) -> list[WheelSample]:
        """Return the wheel samples, for a replay."""
        columns = self.left.tolist(), self.right.tolist(), _nanoseconds(self.seconds).tolist()
        return [WheelSample(*sample) for sample in zip(*columns, strict=True)]

    def trajectory(self) -> Trajectory:
        """Return the reference, for a comparison."""
        return Trajectory(_nanoseconds(self.reference_seconds), self.reference)


def _nanoseconds(seconds: Array) -> npt.NDArray[np.int64]:
    return np.rint(seconds * 1e9).astype(np.int64)


@dataclass(frozen=True)
class Terms:
    """What is estimated besides geometry and noise: clock offsets, the pose of the marker."""

    clock_offset: bool = True
    marker: bool = True


@dataclass(frozen=True)
class RunReport:
    """Result of a calibration for one run; residuals are (K, 3), at distances (K,) [m]."""

    name: str
    clock_offset: float
    """Offset of the wheels' clock from the reference's, positive if it is ahead [s]."""
    outlier: str
    """Why the run is an outlier, which the fit leaves out; '' if it is none."""
    distances: Array = field(repr=False)
    residuals: Array = field(repr=False)


@dataclass(frozen=True)
class Calibration:
    """
    The geometry with its covariance, (3, 3), in the order of GEOMETRY_PARAMETERS, and the noise.

    separation_spread [m] is the standard deviation of the separation between runs, 0 where they
    do not determine it. position_std, heading_std and time_std are the white noise of the
    reference's poses and timestamps; slow_position_std and slow_heading_std its noise that is
    correlated over seconds. unobservable names in words what the runs do not determine: it keeps
    its nominal value, and the noise of turns is 0 where no run turns. marker is the pose of the
    marker in the body frame, marker_std its standard deviations, (3,), 0 if it is not estimated.
    """

    drive: DiffDrive
    covariance: Array
    noise: WheelNoise
    separation_spread: float
    position_std: float
    heading_std: float
    time_std: float
    slow_position_std: float
    slow_heading_std: float
    marker: Array
    marker_std: Array
    unobservable: tuple[str, ...]
    runs: tuple[RunReport, ...]

    @property
    def geometry_std(self) -> Array:
        """Return the standard deviations of the geometry [m], (3,); 0 if unobservable."""
        return np.sqrt(np.diag(self.covariance))

    @property
    def predictive_covariance(self) -> Array:
        """Return the covariance of the geometry in a future run, of any kind of motion."""
        covariance = self.covariance.copy()
        if covariance[0, 0]:
            covariance[0, 0] += max(
                self.separation_spread, MIN_SEPARATION_SPREAD * self.drive.wheel_separation)**2
        return covariance

    @property
    def uncertainty(self) -> GeometryUncertainty:
        """Return the uncertainty of the geometry in a future run, for Odometry."""
        return GeometryUncertainty(*np.sqrt(np.diag(self.predictive_covariance)).tolist())

    @property
    def reference_std(self) -> tuple[float, float]:
        """Return the standard deviations of a reference pose: position [m], heading [rad]."""
        return (math.hypot(self.position_std, self.slow_position_std),
                math.hypot(self.heading_std, self.slow_heading_std))
