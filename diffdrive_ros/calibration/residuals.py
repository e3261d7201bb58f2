"""
Residuals of a run and their derivatives by the unknowns.

The poses that odometry gives a marker on the robot are linear, to first order, in the unknowns:
the geometry and the marker's pose on the robot, common to all runs; the start pose and the clock
offset, of each run.
"""
from dataclasses import dataclass, replace
import math

from diffdrive_ros.calibration.covariance import components
from diffdrive_ros.calibration.linearization import (
    Linearization,
    linearize,
    seen_from_origin,
)
from diffdrive_ros.calibration.model import Run, RunReport, Terms
from diffdrive_ros.core import se2
from diffdrive_ros.core.kinematics import DiffDrive
from diffdrive_ros.core.odometry import integrate
from diffdrive_ros.core.validation import Array
import numpy as np

RATE_INTERVAL_S = 0.02  # over which the rate of the poses is measured


@dataclass
class Estimate:
    """
    The unknowns that all runs share, and which of them are estimated.

    geometry: logarithms of the separation, of the mean radius and of the ratio of the radii; free
    are the indices of those that are estimated. variances: of covariance.components.
    """

    geometry: Array
    marker: Array
    variances: Array
    free: tuple[int, ...]
    terms: Terms
    turns: bool
    """Whether the robot turns; else no run determines the noise of turns."""
    has_spread: bool
    """Whether the separation differs by run; that of a single run is the common one."""

    @property
    def drive(self) -> DiffDrive:
        """Return the geometry."""
        separation, radius, ratio = np.exp(self.geometry).tolist()
        return DiffDrive(separation, radius / math.sqrt(ratio), radius * math.sqrt(ratio))

    def relative_std(self, covariance: Array) -> Array:
        """Return the relative standard deviations of the free geometry, by a covariance."""
        deviations: Array = np.sqrt(np.diag(covariance))[:len(self.free)]
        return deviations


def logarithms(drive: DiffDrive) -> Array:
    """Return a geometry as Estimate has it, (3,)."""
    return np.log([
        drive.wheel_separation, math.sqrt(drive.left_wheel_radius * drive.right_wheel_radius),
        drive.right_wheel_radius / drive.left_wheel_radius])


def by_logarithms(drive: DiffDrive) -> Array:
    """Return the derivatives of GEOMETRY_PARAMETERS by Estimate.geometry, (3, 3)."""
    left, right = drive.left_wheel_radius, drive.right_wheel_radius
    return np.array([
        [drive.wheel_separation, 0.0, 0.0], [0.0, left, -0.5 * left], [0.0, right, 0.5 * right]])


@dataclass
class RunState:
    """The unknowns of one run, and the weights of its poses."""

    run: Run
    start: Array
    clock_offset: float
    weights: Array
    slip: Array
    """Likeliest travel of the left and right wheel beyond its rotation, (2, N) [m]."""


@dataclass(frozen=True)
class Residuals:
    """
    Residuals of one run, (n,), their derivatives and their covariance.

    own, (n, p), and common, (n, q): derivatives by the unknowns of the run and of all runs.
    components, (8, n, n): see covariance.components.
    """

    seconds: Array
    indices: list[int]
    """Of the poses among the samples with these stamps."""
    linear: Linearization
    from_origin: Array
    values: Array
    own: Array
    common: Array
    components: Array


def residuals_of(state: RunState, estimate: Estimate) -> Residuals:
    """Return the residuals of a run at an estimate, linearized there."""
    run, drive = state.run, estimate.drive
    seconds, left, right, indices = _slipped(state, drive, state.clock_offset)
    linear = linearize(drive, left, right, state.start, indices)
    poses, markers = linear.poses, se2.compose(linear.poses, estimate.marker)
    later, earlier = (
        marker_poses(state, estimate, state.clock_offset + 0.5 * interval)
        for interval in (RATE_INTERVAL_S, -RATE_INTERVAL_S))
    rate = (later - earlier) / RATE_INTERVAL_S
    # Errors of the body's pose and of the marker on it, as errors of the marker's pose.
    moves = seen_from_origin(markers - poses)
    geometry = moves @ linear.by_geometry @ by_logarithms(drive)
    common, own = [geometry[:, :, estimate.free]], [moves @ linear.by_start]
    if estimate.terms.marker:
        common.append(se2.adjoint(poses * [0.0, 0.0, 1.0]))  # the rotation alone
    if estimate.terms.clock_offset:
        own.append(rate[:, :, np.newaxis])
    values = run.reference - markers
    values[:, 2] = se2.wrap_angle(values[:, 2])
    from_origin = moves @ linear.seen_from
    # The poses include the slip of the wheels; the residuals are of wheels without.
    steps = np.einsum('mij,mj->mi', linear.by_steps[:, :, :2], np.diff(
        [np.interp(seconds, run.seconds, slip) for slip in state.slip]).T)
    slipped = np.concatenate([np.zeros((1, 3)), np.cumsum(steps, axis=0)])[indices]
    values += np.einsum('kij,kj->ki', from_origin, slipped)
    matrices = components(
        from_origin, linear, geometry[:, :, 0].ravel(), rate, run.reference_seconds,
        state.weights)
    matrices[1] *= estimate.turns
    matrices[2] *= estimate.has_spread
    rows = values.size
    return Residuals(
        seconds, indices, linear, from_origin, values.ravel(),
        np.concatenate(own, axis=-1).reshape(rows, -1),
        np.concatenate(common, axis=-1).reshape(rows, -1), matrices)


def marker_poses(state: RunState, estimate: Estimate, offset: float) -> Array:
    """Return the poses of the marker at the timestamps of the reference, (K, 3)."""
    drive = estimate.drive
    _, left, right, indices = _slipped(state, drive, offset)
    return se2.compose(integrate(drive, left, right, state.start)[indices], estimate.marker)


def _slipped(
    state: RunState, drive: DiffDrive, offset: float,
) -> tuple[Array, Array, Array, list[int]]:
    """Return timestamps and wheel angles that include the slip, as resampled does."""
    run, (left_slip, right_slip) = state.run, state.slip
    return resampled(replace(
        run, left=run.left + left_slip / drive.left_wheel_radius,
        right=run.right + right_slip / drive.right_wheel_radius), offset)


def resampled(run: Run, offset: float) -> tuple[Array, Array, Array, list[int]]:
    """Return timestamps and wheel angles, also at those of the reference, and their indices."""
    wanted = np.clip(run.reference_seconds + offset, run.seconds[0], run.seconds[-1])
    seconds = np.union1d(run.seconds, wanted)
    return (
        seconds, np.interp(seconds, run.seconds, run.left),
        np.interp(seconds, run.seconds, run.right), np.searchsorted(seconds, wanted).tolist())


def report_of(state: RunState, estimate: Estimate) -> RunReport:
    """Return the result for a run, with its residuals without slip."""
    run, drive = state.run, estimate.drive
    residuals = run.reference - marker_poses(
        replace(state, slip=np.zeros_like(state.slip)), estimate, state.clock_offset)
    residuals[:, 2] = se2.wrap_angle(residuals[:, 2])
    radius = 0.25 * (drive.left_wheel_radius + drive.right_wheel_radius)
    return RunReport(
        run.name, state.clock_offset, '',
        radius * np.interp(run.reference_seconds, run.seconds, run.wheel_travel()), residuals)
