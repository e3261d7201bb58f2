"""
Odometry: poses from wheel angles, for whole logs and online for each sample.

Between two samples each wheel turns at a constant speed. The robot then drives an arc, and the
integration is exact for it (doc/kinematics.md, rows 9 to 14). Wheel angles are in
rad, continuous (not wrapped), left before right. Poses are [x, y, theta] in the odom frame,
theta not wrapped; twists are [v_x, v_y, omega] in the body frame; SI units.
"""
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from dataclasses import astuple, dataclass, fields
from math import cos, isfinite, sin

from diffdrive_ros.core import se2
from diffdrive_ros.core.kinematics import DiffDrive
from diffdrive_ros.core.validation import Array, finite, not_negative, vectors
import numpy as np
import numpy.typing as npt

ORIGIN = (0.0, 0.0, 0.0)


def integrate(
    drive: DiffDrive, left: npt.ArrayLike, right: npt.ArrayLike, start: npt.ArrayLike = ORIGIN,
) -> Array:
    """
    Return the poses, (N, 3), of a whole log of wheel angles [rad] of shape (N,).

    The first pose is start. The result is exact for any turn if the ratio of the wheel speeds is
    constant between two samples. Raises ValueError for different shapes and for values that are
    not finite.
    """
    return _follow(drive, *_log(left, right), _pose('start', start), _arc)


def integrate_chunks(
    drive: DiffDrive, chunks: Iterable[tuple[npt.ArrayLike, npt.ArrayLike]],
    start: npt.ArrayLike = ORIGIN,
) -> Iterator[Array]:
    """
    Return an iterator over the poses of a log in chunks, larger than memory or live.

    A chunk is a pair (left, right) of wheel angles [rad] of shape (N,), N may be zero. Its poses,
    (N, 3), are those of integrate for the same samples of the whole log. Chunks are read one at a
    time and not kept. Raises ValueError as integrate does, when the chunk is read; the message
    has its index from 0.
    """
    return _follow_chunks(drive, chunks, _pose('start', start))


def integrate_speeds(
    drive: DiffDrive, left: npt.ArrayLike, right: npt.ArrayLike, dt: npt.ArrayLike,
    start: npt.ArrayLike = ORIGIN,
) -> Array:
    """
    Return the poses, (N + 1, 3), of wheel speeds [rad/s] of shape (N,).

    Each pair of speeds lasts for dt [s], a scalar or of shape (N,). Otherwise as integrate.
    """
    left, right, dt = finite('left', left), finite('right', right), finite('dt', dt)
    for name, speeds in (('left', left), ('right', right)):
        if speeds.ndim != 1 or dt.shape not in ((), speeds.shape):
            raise ValueError(
                f'{name} has shape {speeds.shape}, dt {dt.shape}: must be (N,), and () or (N,)')
    left, right = (np.concatenate([[0.0], np.cumsum(speeds * dt)]) for speeds in (left, right))
    return integrate(drive, left, right, start)


def integrate_euler(
    drive: DiffDrive, left: npt.ArrayLike, right: npt.ArrayLike, start: npt.ArrayLike = ORIGIN,
) -> Array:
    """
    Return the poses by explicit Euler, q(k+1) = q(k) + q'(k) dt, (N, 3).

    For comparison only: each step follows the old heading, so that curves come out too wide.
    Arguments and errors are those of integrate.
    """
    return _follow(drive, *_log(left, right), _pose('start', start), _tangent)


# Intermediate arrays of a block stay in a core's cache.
BLOCK_STEPS = 8192

StepRule = Callable[[Array, Array, Array], tuple[Array, Array]]
"""A function of distances, turns and initial headings that returns the steps in x and y."""


def _follow(drive: DiffDrive, left: Array, right: Array, start: Array, rule: StepRule) -> Array:
    """Return the poses integrated from wheel angles, (N, 3)."""
    poses = np.empty((left.size, 3))
    poses[:1] = start
    for first in range(0, left.size - 1, BLOCK_STEPS):
        block = slice(first, first + BLOCK_STEPS + 1)
        _follow_block(drive, left[block], right[block], poses[block], rule)
    return poses


def _follow_block(
    drive: DiffDrive, left: Array, right: Array, poses: Array, rule: StepRule,
) -> None:
    """Write the poses, (N, 3), after the first."""
    def add_up(axis: int, steps: Array) -> None:
        column = poses[:, axis]
        column[1:] = steps
        np.add.accumulate(column, out=column)
        if not isfinite(column[-1]):  # a value that is not finite stays in the sum
            bad = int(np.argmin(np.isfinite(column)))
            raise ValueError(
                f'left, right = {left[bad]}, {right[bad]} after {left[bad - 1]}, '
                f'{right[bad - 1]}: must lead to a finite pose')

    with np.errstate(over='ignore', invalid='ignore'):  # add_up raises
        distance, turn = _steps(drive, left, right)
        add_up(2, turn)
        dx, dy = rule(distance, turn, poses[:-1, 2])
        add_up(0, dx)
        add_up(1, dy)


def _steps(drive: DiffDrive, left: Array, right: Array) -> tuple[Array, Array]:
    """Return drive.body_twist of the wheel steps, without its checks."""
    left_rim = drive.left_wheel_radius * (left[1:] - left[:-1])
    right_rim = drive.right_wheel_radius * (right[1:] - right[:-1])
    return 0.5 * (right_rim + left_rim), (right_rim - left_rim) / drive.wheel_separation


def _arc(distance: Array, turn: Array, heading: Array) -> tuple[Array, Array]:
    half_turn = 0.5 * turn
    chord, mid_heading = distance * se2.chord_over_arc(half_turn), heading + half_turn
    return chord * np.cos(mid_heading), chord * np.sin(mid_heading)


def _tangent(distance: Array, turn: Array, heading: Array) -> tuple[Array, Array]:
    return distance * np.cos(heading), distance * np.sin(heading)


def _follow_chunks(
    drive: DiffDrive, chunks: Iterable[tuple[npt.ArrayLike, npt.ArrayLike]], pose: Array,
) -> Iterator[Array]:
    last: Array = np.empty((2, 0))  # left and right angle of the last sample
    for number, chunk in enumerate(chunks):
        try:
            left, right = chunk
        except (TypeError, ValueError):
            raise ValueError(
                f'chunk {number} = {chunk!r}: must be a pair (left, right)') from None
        try:
            angles = np.concatenate([last, _log(left, right)], axis=1)
            poses = _follow(drive, angles[0], angles[1], pose, _arc)
        except ValueError as error:
            raise ValueError(f'chunk {number}: {error}') from None
        old = last.shape[1]
        last = angles[:, -1:].copy()
        pose = poses[-1].copy() if poses.size else pose  # the caller may change the yielded array
        yield poses[old:]


def _log(left: npt.ArrayLike, right: npt.ArrayLike) -> tuple[Array, Array]:
    left, right = finite('left', left), finite('right', right)
    if left.ndim != 1 or left.shape != right.shape:
        raise ValueError(
            f'left has shape {left.shape}, right {right.shape}: must be (N,) for both')
    return left, right


def _pose(name: str, value: npt.ArrayLike) -> Array:
    pose = vectors(name, value, 3)
    if pose.shape != (3,):
        raise ValueError(f'{name} has shape {pose.shape}: must be (3,)')
    return pose


def _covariance(name: str, value: npt.ArrayLike) -> Array:
    """Return a covariance of a pose, (3, 3); raises ValueError unless it is one."""
    matrix = finite(name, value)
    if matrix.shape != (3, 3):
        raise ValueError(f'{name} has shape {matrix.shape}: must be (3, 3)')
    if np.diag(matrix).max() > MAX_VARIANCE:
        raise ValueError(
            f'{name} = {matrix.tolist()}: must have no variance above {MAX_VARIANCE:g}')
    deviations = np.sqrt(np.abs(np.diag(matrix)))
    deviations[deviations == 0.0] = 1.0
    correlation = matrix / deviations[:, np.newaxis] / deviations  # free of units
    if np.abs(correlation - correlation.T).max() > 1e-9:
        raise ValueError(f'{name} = {matrix.tolist()}: must be symmetric')
    if np.linalg.eigvalsh(correlation).min() < -1e-9:
        raise ValueError(f'{name} = {matrix.tolist()}: must be positive semidefinite')
    return matrix


@dataclass(frozen=True, slots=True)
class WheelNoise:
    """
    White noise of the wheels' travel over the floor; its variance grows with the travel.

    left_travel and right_travel are the variance of each wheel's travel per metre [m^2/m]. turn is
    the variance of the heading per radian turned, from tyre scrub [rad^2/rad]. The defaults suit a
    small indoor robot. Raises ValueError for a value that is negative or not finite.
    """

    left_travel: float = 5e-6
    right_travel: float = 5e-6
    turn: float = 5e-5

    def __post_init__(self) -> None:
        for field in fields(self):
            not_negative(field.name, getattr(self, field.name))


@dataclass(frozen=True, slots=True)
class GeometryUncertainty:
    """
    Standard deviations of the geometry: one of each measure of DiffDrive, in m.

    An error of the geometry is constant along the path. Unlike noise it never averages out: the
    deviation grows with the path, not with its square root. The three errors are independent.
    Zero, the default, is an exact geometry. Raises ValueError for a value that is negative or not
    finite.
    """

    wheel_separation: float = 0.0
    left_wheel_radius: float = 0.0
    right_wheel_radius: float = 0.0

    def __post_init__(self) -> None:
        for field in fields(self):
            not_negative(field.name, getattr(self, field.name))


# Smaller variances break filters that invert them.
MIN_POSE_VARIANCE = 1e-9  # [m^2], [rad^2]
MIN_TWIST_VARIANCE = 1e-6  # [m^2/s^2], [rad^2/s^2]

# A larger initial variance soon overflows when it is propagated.
MAX_VARIANCE = 1e12  # [m^2], [rad^2]

# In messages, of components without a measurement: large, yet filters can still invert it.
UNKNOWN_VARIANCE = 1e6  # [m^2], [rad^2] and their rates

Triangle = tuple[float, float, float, float, float, float]
"""The upper triangle of a covariance of [x, y, theta] or its rates: xx, xy, xt, yy, yt, tt."""


# Stamp, wheel angles, and the accumulated variances of left travel, right travel and turn.
_Sample = tuple[int, float, float, float, float, float]
NO_SAMPLE: _Sample = (0, 0.0, 0.0, 0.0, 0.0, 0.0)

Estimate = tuple[tuple[float, float, float], Triangle, tuple[float, float], Triangle]
"""Pose and its covariance, twist [v_x, omega] and the covariance of [v_x, v_y, omega]."""


class Odometry:
    """
    Pose, twist and covariances of a robot, updated by each sample of its wheel angles.

    window is the number of sample intervals of which the twist is the mean, as displacement over
    time. drive and noise may be assigned at any time, with effect from the next sample on.
    geometry_uncertainty is of the whole path since the last reset, even if drive changes.
    Raises ValueError for a window below 1.
    """

    def __init__(
        self, drive: DiffDrive, *, window: int = 10, noise: WheelNoise | None = None,
        geometry_uncertainty: GeometryUncertainty | None = None, start: npt.ArrayLike = ORIGIN,
    ) -> None:
        if not isinstance(window, int) or window < 1:
            raise ValueError(f'window = {window!r}: must be an integer of 1 or more')
        self.drive = drive
        self.noise = noise or WheelNoise()
        known = geometry_uncertainty or GeometryUncertainty()
        self._is_exact = known == GeometryUncertainty()
        self._geometry_variances = tuple(std * std for std in astuple(known))
        self._samples: deque[_Sample] = deque(maxlen=window + 1)
        self.reset(_pose('start', start))

    def reset(self, pose: npt.ArrayLike = ORIGIN, covariance: npt.ArrayLike | None = None) -> None:
        """
        Set the pose, (3,), and its covariance, (3, 3); the last wheel angles stay the baseline.

        The default covariance is MIN_POSE_VARIANCE times the identity. A smaller one is increased
        by a multiple of the identity to that smallest eigenvalue. The error of the pose is assumed
        to be independent of that of the geometry, whose effect restarts from zero. Raises
        ValueError, without effect, for an invalid pose and for a covariance that is not finite,
        symmetric and positive semidefinite.
        """
        pose = _pose('pose', pose)
        spread = np.zeros((3, 3)) if covariance is None else _covariance('covariance', covariance)
        lacking = MIN_POSE_VARIANCE - np.linalg.eigvalsh(spread).min()
        spread = spread + max(lacking, 0.0) * np.eye(3)
        self._x, self._y, self._theta = pose.tolist()
        # The covariance of the pose by the noise, in the odom frame: its upper triangle.
        (xx, xy, xt), (_, yy, yt), (_, _, tt) = spread.tolist()
        self._noise_covariance = xx, xy, xt, yy, yt, tt
        # The derivatives of the pose by wheel separation, left radius and right radius.
        self._sensitivity = (*ORIGIN, *ORIGIN, *ORIGIN)

    def update(self, left: float, right: float, stamp_ns: int) -> bool:
        """
        Integrate a sample of wheel angles [rad] at a stamp [ns]; return whether it was newer.

        The first sample is the baseline: the pose stays. An out-of-order sample is dropped, and
        the next one contains its motion. Raises ValueError, without effect, for angles that are
        not finite, or so far from the last that the pose or its covariance overflows.

        The scalar form, in plain floats, of integrate (and so of se2.exp and se2.chord_over_arc)
        and of calibration's linearize. test_online_and_batch_end_at_the_same_pose and
        test_linearization.py hold them equal. Cost: doc/performance.md, "The core".
        """
        if not (isfinite(left) and isfinite(right)):
            raise ValueError(f'left, right = {left!r}, {right!r}: must be finite')
        samples = self._samples
        if not samples:
            samples.append((stamp_ns, left, right, 0.0, 0.0, 0.0))
            return True
        last_ns, last_left, last_right, sum_left, sum_right, sum_turn = samples[-1]
        if stamp_ns <= last_ns:
            return False
        left_step, right_step = left - last_left, right - last_right
        if left_step == 0.0 and right_step == 0.0:
            samples.append((stamp_ns, left, right, sum_left, sum_right, sum_turn))
            return True
        drive, noise = self.drive, self.noise
        separation = drive.wheel_separation
        left_travel = drive.left_wheel_radius * left_step
        right_travel = drive.right_wheel_radius * right_step
        distance = 0.5 * (right_travel + left_travel)
        turn = (right_travel - left_travel) / separation
        if not isfinite(distance * distance + turn * turn):
            raise ValueError(
                f'travel = {left_travel!r}, {right_travel!r} m in one step: must be finite')
        half_turn = 0.5 * turn
        chord_over_arc = sin(half_turn) / half_turn if half_turn != 0.0 else 1.0
        if -0.1 < half_turn < 0.1:  # as in se2.chord_over_arc_rate
            square = half_turn * half_turn
            chord_over_arc_rate = -half_turn / 3.0 * (
                1.0 - square / 10.0 * (1.0 - square / 28.0 * (1.0 - square / 54.0)))
        else:
            chord_over_arc_rate = (cos(half_turn) - chord_over_arc) / half_turn
        mid_heading = self._theta + half_turn
        cos_mid, sin_mid = cos(mid_heading), sin(mid_heading)
        # Derivatives of the new pose: a = (ax, ay, 0) by the distance, t = (tx, ty, 1) by the
        # turn, F = [[1, 0, -dy], [0, 1, dx], [0, 0, 1]] by the old pose.
        ax, ay = chord_over_arc * cos_mid, chord_over_arc * sin_mid
        dx, dy = distance * ax, distance * ay
        bend = 0.5 * distance * chord_over_arc_rate
        tx, ty = bend * cos_mid - 0.5 * dy, bend * sin_mid + 0.5 * dx
        # Variances of distance (a) and turn (t) by the noise, and their covariance.
        var_left = noise.left_travel * abs(left_travel)
        var_right = noise.right_travel * abs(right_travel)
        var_turn = noise.turn * abs(turn)
        v_aa = 0.25 * (var_left + var_right)
        v_at = 0.5 * (var_right - var_left) / separation
        v_tt = (var_left + var_right) / (separation * separation) + var_turn
        # P <- F P F^T + v_aa a a^T + v_at (a t^T + t a^T) + v_tt t t^T.
        p_xx, p_xy, p_xt, p_yy, p_yt, p_tt = self._noise_covariance
        f_xt, f_yt = p_xt - dy * p_tt, p_yt + dx * p_tt
        of_ax, of_ay = v_aa * ax + v_at * tx, v_aa * ay + v_at * ty
        of_tx, of_ty = v_at * ax + v_tt * tx, v_at * ay + v_tt * ty
        xx = p_xx - dy * (p_xt + f_xt) + of_ax * ax + of_tx * tx
        yy = p_yy + dx * (p_yt + f_yt) + of_ay * ay + of_ty * ty
        xy = p_xy + dx * f_xt - dy * p_yt + of_ax * ay + of_tx * ty
        if not isfinite(xx + yy + p_tt + v_tt):
            raise ValueError(
                f'travel = {left_travel!r}, {right_travel!r} m in one step: must be less, for '
                'a finite covariance')
        self._noise_covariance = xx, xy, f_xt + of_tx, yy, f_yt + of_ty, p_tt + v_tt
        if not self._is_exact:  # the separation has an effect on turns, a radius on both
            # s <- F s + along a + around t, of its effects on distance and turn.
            sx, sy, st, lx, ly, lt, rx, ry, rt = self._sensitivity
            s_around = -turn / separation
            l_along, l_around = 0.5 * left_step, -left_step / separation
            r_along, r_around = 0.5 * right_step, right_step / separation
            self._sensitivity = (
                sx - dy * st + s_around * tx, sy + dx * st + s_around * ty, st + s_around,
                lx - dy * lt + l_along * ax + l_around * tx,
                ly + dx * lt + l_along * ay + l_around * ty, lt + l_around,
                rx - dy * rt + r_along * ax + r_around * tx,
                ry + dx * rt + r_along * ay + r_around * ty, rt + r_around)
        self._x += dx
        self._y += dy
        self._theta += turn
        samples.append((
            stamp_ns, left, right,
            sum_left + var_left, sum_right + var_right, sum_turn + var_turn))
        return True

    def reset_time(self, stamp_ns: int) -> None:
        """Move the last sample to a stamp [ns] of a time that was reset; the pose stays."""
        if self._samples:
            _, left, right, sum_left, sum_right, sum_turn = self._samples[-1]
            self._samples.clear()
            self._samples.append((stamp_ns, left, right, sum_left, sum_right, sum_turn))

    @property
    def pose(self) -> Array:
        """Return the pose [x, y, theta] in the odom frame, (3,), theta not wrapped."""
        return np.array([self._x, self._y, self._theta])

    @property
    def twist(self) -> Array:
        """Return the mean body twist [v_x, 0, omega] of the window, (3,); exactly 0 at rest."""
        _, _, (linear, angular), _ = self.estimate()
        return np.array([linear, 0.0, angular])

    @property
    def pose_covariance(self) -> Array:
        """
        Return the covariance of the pose in the odom frame, (3, 3), order x, y, theta.

        The sum of that by the noise and S diag(deviations^2) S^T, S its sensitivity.
        """
        _, covariance, _, _ = self.estimate()
        return _matrix(covariance)

    @property
    def twist_covariance(self) -> Array:
        """
        Return the covariance of the twist, (3, 3), order v_x, v_y, omega, floor included.

        From the noise in the window and the geometry. Sideways slip is assumed to be as large as
        longitudinal slip, because wheels lose their grip in both directions.
        """
        _, _, _, covariance = self.estimate()
        return _matrix(covariance)

    def estimate(self) -> Estimate:
        """
        Return pose, twist and both covariances in plain floats, for a message.

        The scalar form of drive.body_twist over the window and of S diag(deviations^2) S^T;
        test_estimate_has_the_values_of_the_arrays and test_odometry_covariance.py hold them equal.
        Cost: doc/performance.md, "read-out".
        """
        samples = self._samples or [NO_SAMPLE]
        then_ns, left_then, right_then, var_left_then, var_right_then, var_turn_then = samples[0]
        now_ns, left, right, var_left, var_right, var_turn = samples[-1]
        left, right = left - left_then, right - right_then
        var_left, var_right = var_left - var_left_then, var_right - var_right_then
        var_turn -= var_turn_then
        rate = 1e9 / (now_ns - then_ns) if now_ns > then_ns else 1.0
        drive = self.drive
        separation = drive.wheel_separation
        left_travel = drive.left_wheel_radius * left
        right_travel = drive.right_wheel_radius * right
        turn = (right_travel - left_travel) / separation

        sideways = 0.25 * (var_left + var_right)
        pose_covariance = self._noise_covariance
        if not self._is_exact:
            s_var, l_var, r_var = self._geometry_variances
            # P + sum of variance s s^T, over the columns s.
            sx, sy, st, lx, ly, lt, rx, ry, rt = self._sensitivity
            xx, xy, xt, yy, yt, tt = pose_covariance
            pose_covariance = (
                xx + s_var * sx * sx + l_var * lx * lx + r_var * rx * rx,
                xy + s_var * sx * sy + l_var * lx * ly + r_var * rx * ry,
                xt + s_var * sx * st + l_var * lx * lt + r_var * rx * rt,
                yy + s_var * sy * sy + l_var * ly * ly + r_var * ry * ry,
                yt + s_var * sy * st + l_var * ly * lt + r_var * ry * rt,
                tt + s_var * st * st + l_var * lt * lt + r_var * rt * rt)
            relative_turn = turn / separation
            var_left += l_var * left * left
            var_right += r_var * right * right
            var_turn += s_var * relative_turn * relative_turn
        along = 0.25 * (var_left + var_right)
        cross = 0.5 * (var_right - var_left) / separation
        turning = (var_left + var_right) / (separation * separation) + var_turn
        square = rate * rate
        return (
            (self._x, self._y, self._theta), pose_covariance,
            (0.5 * (right_travel + left_travel) * rate, turn * rate),
            (square * along + MIN_TWIST_VARIANCE, 0.0, square * cross,
             square * sideways + MIN_TWIST_VARIANCE, 0.0,
             square * turning + MIN_TWIST_VARIANCE))


def _matrix(covariance: Triangle) -> Array:
    xx, xy, xt, yy, yt, tt = covariance
    return np.array([[xx, xy, xt], [xy, yy, yt], [xt, yt, tt]])
