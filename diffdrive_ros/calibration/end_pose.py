"""
Calibrate without a reference, by end poses of paths, measured with a ruler.

UMBmark (Borenstein and Feng, Measurement and Correction of Systematic Odometry Errors in Mobile
Robots, IEEE T-RA 12, 1996): squares in both directions give the ratio of the diameters,
E_d = D_R / D_L, and that of the separation to its nominal value, E_b. Their closed forms are to
first order; here the same square is solved exactly. Squares do not give the mean radius, which
takes a straight line; a line and a turn on the spot give all three.
"""
from collections.abc import Sequence
from dataclasses import dataclass
import math

from diffdrive_ros.calibration.linearization import linearize
from diffdrive_ros.core import se2
from diffdrive_ros.core.kinematics import DiffDrive
from diffdrive_ros.core.validation import Array, finite, positive, UserError, vectors
import numpy as np
import numpy.typing as npt


@dataclass(frozen=True)
class EndPoseCalibration:
    """
    The geometry by end poses; covariance, (3, 3), in the order of GEOMETRY_PARAMETERS.

    It is singular where the mean radius is not observed, but fixed to the nominal one.
    """

    drive: DiffDrive
    covariance: Array
    has_mean_radius: bool
    separation_ratio: float
    """E_b: the separation over the nominal one."""
    diameter_ratio: float
    """E_d: the right diameter over the left one."""
    ratio_std: tuple[float, float]
    """Of E_b and E_d."""

    @property
    def geometry_std(self) -> Array:
        """Return the standard deviations of the geometry [m], (3,); 0 if not known."""
        # Where the sum of both radii is fixed, their covariance is that of the ratio alone.
        return np.sqrt(np.diag(self.covariance)) * [1, self.has_mean_radius, self.has_mean_radius]


def umbmark(
    clockwise: npt.ArrayLike, counter_clockwise: npt.ArrayLike, side: float, nominal: DiffDrive,
) -> EndPoseCalibration:
    """
    Return the geometry by squares of a side [m] in both directions, with turns on the spot.

    clockwise and counter_clockwise, (N, 2): of each square, the measured end position minus that
    of odometry with the nominal geometry [m]. The robot starts along x; clockwise turns right.
    The standard deviations come from the scatter of the end positions in each direction; they are
    0, for unknown, with fewer than two squares in a direction. Raises UserError if the end
    positions are not those of a square, ValueError for an argument of a wrong shape or value.
    """
    side = positive('side', side)
    directions = [vectors(name, errors, 2) for name, errors in (
        ('clockwise', clockwise), ('counter_clockwise', counter_clockwise))]
    for name, errors in zip(('clockwise', 'counter_clockwise'), directions, strict=True):
        if errors.ndim != 2 or len(errors) < 1:
            raise ValueError(f'{name} has shape {errors.shape}: must be (N, 2), N 1 or more')
    wheels = [square_angles(nominal, side, sign) for sign in (-1.0, 1.0)]
    expected = [linearize(nominal, *angles, chosen=[-1]).poses[0, :2] for angles in wheels]
    means = np.concatenate([errors.mean(axis=0) for errors in directions])
    measured = means + np.concatenate(expected)
    covariance = np.zeros((4, 4))
    if min(map(len, directions)) > 1:
        for index, errors in enumerate(directions):
            part = slice(2 * index, 2 * index + 2)
            covariance[part, part] = np.cov(errors.T) / len(errors)
    logarithms = np.zeros(2)
    for _ in range(20):
        drive = _scaled(nominal, *logarithms)
        ends = [linearize(drive, *angles, chosen=[-1]) for angles in wheels]
        residuals = measured - np.concatenate([end.poses[0, :2] for end in ends])
        derivatives = np.concatenate([
            end.by_geometry[0, :2] @ _by_logarithms(drive) for end in ends])
        solve = np.linalg.pinv(derivatives)
        step = np.clip(solve @ residuals, -0.1, 0.1)
        logarithms = logarithms + step
        if np.abs(step).max() < 1e-13:
            break
    else:
        raise UserError(
            f'end position errors = {means.round(4).tolist()} m: must be those of a square of '
            f'{side} m')
    spread = solve @ covariance @ solve.T
    drive = _scaled(nominal, *logarithms)
    by_logarithms = _by_logarithms(drive)
    ratio_b, ratio_d = np.exp(logarithms).tolist()
    ratio_d *= nominal.right_wheel_radius / nominal.left_wheel_radius
    return EndPoseCalibration(
        drive, by_logarithms @ spread @ by_logarithms.T, False, ratio_b, ratio_d,
        (ratio_b * math.sqrt(spread[0, 0]), ratio_d * math.sqrt(spread[1, 1])))


def line_and_turn(
    line: Sequence[float], distance: float, sideways: float, turn: Sequence[float], heading: float,
    nominal: DiffDrive, stds: Sequence[float] = (0.0, 0.0, 0.0),
) -> EndPoseCalibration:
    """
    Return the geometry by one straight line and one turn on the spot.

    line and turn: rotation of the left and right wheel in each [rad]. distance and sideways: end
    position of the line, ahead and to the left [m]. heading: after the turn, counter-clockwise
    positive, whole turns counted [rad]. stds: standard deviations of distance, sideways and
    heading. Raises UserError if the two do not determine the geometry, ValueError for an argument
    of a wrong value.
    """
    line_left, line_right = finite('line', line).tolist()
    turn_left, turn_right = finite('turn', turn).tolist()
    positive('distance', distance)
    positive('abs(heading)', abs(heading))

    def solved(distance: float, sideways: float, heading: float) -> Array:
        # The line is an arc, whose chord has half its turn as direction.
        bend = 2.0 * math.atan2(sideways, distance)
        length = math.hypot(distance, sideways) / float(se2.chord_over_arc(0.5 * bend))
        matrix = np.array([
            [0.0, 0.5 * line_left, 0.5 * line_right], [-bend, -line_left, line_right],
            [-heading, -turn_left, turn_right]])
        if np.linalg.cond(matrix) > 1e12:
            raise UserError('line, turn: must determine the geometry: do the wheels turn?')
        return np.linalg.solve(matrix, [length, 0.0, 0.0])

    geometry = solved(distance, sideways, heading)
    steps = (1e-6 * distance, 1e-6 * distance, 1e-6 * heading)
    derivatives = np.stack([
        (solved(*(np.array([distance, sideways, heading]) + step * axis)) - geometry) / step
        for step, axis in zip(steps, np.eye(3), strict=True)], axis=-1)
    covariance = derivatives @ np.diag(np.square(stds)) @ derivatives.T
    drive = DiffDrive(*geometry.tolist())
    ratio = drive.right_wheel_radius / drive.left_wheel_radius
    of_ratio = np.array([0.0, -ratio / drive.left_wheel_radius, 1.0 / drive.left_wheel_radius])
    return EndPoseCalibration(
        drive, covariance, True, drive.wheel_separation / nominal.wheel_separation, ratio,
        (math.sqrt(covariance[0, 0]) / nominal.wheel_separation,
         math.sqrt(of_ratio @ covariance @ of_ratio)))


def square_angles(drive: DiffDrive, side: float, sign: float) -> tuple[Array, Array]:
    """Return the wheel angles [rad] at the corners of a square; sign 1 turns left, -1 right."""
    legs = np.array(drive.wheel_speeds(side, 0.0)), np.array(
        drive.wheel_speeds(0.0, sign * 0.5 * math.pi))
    steps = np.concatenate([[np.zeros(2)], np.tile(legs, (4, 1))])
    left, right = np.cumsum(steps, axis=0).T
    return left, right


def _scaled(nominal: DiffDrive, separation: float, ratio: float) -> DiffDrive:
    """Return a geometry by logarithms of E_b and of the change of E_d; the mean radius stays."""
    left, right = nominal.left_wheel_radius, nominal.right_wheel_radius
    factor = math.exp(ratio)
    new_left = (left + right) / (1.0 + factor * right / left)
    return DiffDrive(
        nominal.wheel_separation * math.exp(separation), new_left, left + right - new_left)


def _by_logarithms(drive: DiffDrive) -> Array:
    """Return the derivatives of the geometry by the logarithms of _scaled, (3, 2)."""
    left, right = drive.left_wheel_radius, drive.right_wheel_radius
    moved = left * right / (left + right)
    return np.array([[drive.wheel_separation, 0.0], [0.0, -moved], [0.0, moved]])
