"""
Calibration without a reference: by where the robot is at the end of a path, found with a ruler.

UMBmark (Borenstein and Feng, Measurement and Correction of Systematic Odometry Errors in Mobile
Robots, IEEE T-RA 12, 1996): squares driven both ways tell the ratio of the diameters,
E_d = D_R / D_L, from that of the separation to its nominal, E_b. Their closed forms are to first
order; here the same square is solved exactly. Neither tells the mean radius: that takes a straight
line, and a line with a turn on the spot tells all three.
"""
from collections.abc import Sequence
from dataclasses import dataclass
import math

from diffdrive_ros.calibration.linearization import linearize
from diffdrive_ros.core import se2
from diffdrive_ros.core.kinematics import DiffDrive
from diffdrive_ros.core.validation import Array, finite, positive, vectors
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
    Return the geometry by squares of a side [m], driven both ways, turning on the spot.

    clockwise and counter_clockwise, (N, 2): for each drive, where the robot really is at the end
    minus where odometry with the nominal geometry has it [m]; the robot started along x, and
    clockwise turned right. The deviations come from how the ends of each way scatter; 0 is not
    known, for fewer than two drives of either way. Raises ValueError.
    """
    side = positive('side', side)
    ways = [vectors(name, errors, 2) for name, errors in (
        ('clockwise', clockwise), ('counter_clockwise', counter_clockwise))]
    for name, errors in zip(('clockwise', 'counter_clockwise'), ways, strict=True):
        if errors.ndim != 2 or len(errors) < 1:
            raise ValueError(f'{name} has shape {errors.shape}: must be (N, 2), N 1 or more')
    wheels = [square_angles(nominal, side, sign) for sign in (-1.0, 1.0)]
    expected = [linearize(nominal, *angles, chosen=[-1]).poses[0, :2] for angles in wheels]
    means = np.concatenate([errors.mean(axis=0) for errors in ways])
    measured = means + np.concatenate(expected)
    covariance = np.zeros((4, 4))
    if min(map(len, ways)) > 1:
        for index, errors in enumerate(ways):
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
        raise ValueError(
            f'the ends, {means.round(4).tolist()} m off, are not those of a square of {side} m')
    spread = solve @ covariance @ solve.T
    drive = _scaled(nominal, *logarithms)
    by_logarithms = _by_logarithms(drive)
    ratio_b, ratio_d = np.exp(logarithms).tolist()
    ratio_d *= nominal.right_wheel_radius / nominal.left_wheel_radius
    return EndPoseCalibration(
        drive, by_logarithms @ spread @ by_logarithms.T, False, ratio_b, ratio_d,
        (ratio_b * math.sqrt(spread[0, 0]), ratio_d * math.sqrt(spread[1, 1])))


def line_and_turn(
    line: Sequence[float], distance: float, sideways: float, turn: Sequence[float], turned: float,
    nominal: DiffDrive, deviations: Sequence[float] = (0.0, 0.0, 0.0),
) -> EndPoseCalibration:
    """
    Return the geometry by one straight line and one turn on the spot.

    line and turn: how far the left and right wheel turned in each [rad]; distance and sideways:
    where the line ended, ahead and to the left [m]; turned: the heading after the turn,
    counter-clockwise positive, whole turns counted [rad]. deviations: of distance, sideways and
    turned. Raises ValueError.
    """
    line_left, line_right = finite('line', line).tolist()
    turn_left, turn_right = finite('turn', turn).tolist()
    positive('distance', distance)
    positive('the size of turned', abs(turned))

    def solved(distance: float, sideways: float, turned: float) -> Array:
        # The line is an arc: its chord leaves at half its turn.
        bend = 2.0 * math.atan2(sideways, distance)
        length = math.hypot(distance, sideways) / float(se2.chord_over_arc(0.5 * bend))
        matrix = np.array([
            [0.0, 0.5 * line_left, 0.5 * line_right], [-bend, -line_left, line_right],
            [-turned, -turn_left, turn_right]])
        if np.linalg.cond(matrix) > 1e12:
            raise ValueError('line and turn do not tell the geometry: did the wheels turn?')
        return np.linalg.solve(matrix, [length, 0.0, 0.0])

    geometry = solved(distance, sideways, turned)
    steps = (1e-6 * distance, 1e-6 * distance, 1e-6 * turned)
    derivatives = np.stack([
        (solved(*(np.array([distance, sideways, turned]) + step * axis)) - geometry) / step
        for step, axis in zip(steps, np.eye(3), strict=True)], axis=-1)
    covariance = derivatives @ np.diag(np.square(deviations)) @ derivatives.T
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
    """Return a geometry by logarithms of E_b and of what E_d changes by; mean radius as it was."""
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
