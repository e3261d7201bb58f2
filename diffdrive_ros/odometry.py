"""
Odometry: from wheel angles to poses, for whole logs at once and online, sample by sample.

Between two samples each wheel is taken to turn at a constant speed; the robot then drives an
arc, and the integration is exact for it (doc/kinematics.md, rows 9 to 14). Wheel angles are in
rad, continuous (not wrapped), left before right. Poses are [x, y, theta] in the odom frame,
theta not wrapped; twists are [v_x, v_y, omega] in the body frame; SI units.
"""
from collections import deque
from dataclasses import dataclass, fields
import math

from diffdrive_ros import se2
from diffdrive_ros.arguments import Array, finite, not_negative, vectors
from diffdrive_ros.kinematics import DiffDrive
import numpy as np
import numpy.typing as npt

ORIGIN = (0.0, 0.0, 0.0)


def integrate(
    drive: DiffDrive, left: npt.ArrayLike, right: npt.ArrayLike, start: npt.ArrayLike = ORIGIN,
) -> Array:
    """
    Return the poses, (N, 3), of a whole log of wheel angles [rad] of shape (N,).

    The first pose is start. Exact, for any turn, if the speeds of the wheels keep their ratio
    between two samples. Raises ValueError for shapes that do not fit and for anything not finite.
    """
    distance, turn, start = _steps(drive, left, right, start)
    theta = np.cumsum(np.concatenate([start[2:], turn]))
    mid_heading = theta[:-1] + 0.5 * turn
    chord = distance * se2.chord_over_arc(0.5 * turn)
    return _track(start, chord, mid_heading, theta)[:np.size(left)]


def integrate_speeds(
    drive: DiffDrive, left: npt.ArrayLike, right: npt.ArrayLike, dt: npt.ArrayLike,
    start: npt.ArrayLike = ORIGIN,
) -> Array:
    """
    Return the poses, (N + 1, 3), of a history of wheel speeds [rad/s] of shape (N,).

    Each pair of speeds is held for dt [s], one for all or of shape (N,). Otherwise as integrate.
    """
    dt = finite('dt', dt)
    angles = (np.cumsum(finite(name, speeds) * dt) for name, speeds in (
        ('left', left), ('right', right)))
    left, right = (np.concatenate([[0.0], angle]) for angle in angles)
    return integrate(drive, left, right, start)


def integrate_euler(
    drive: DiffDrive, left: npt.ArrayLike, right: npt.ArrayLike, start: npt.ArrayLike = ORIGIN,
) -> Array:
    """
    Return the poses of integrate by the first-order rule q(k+1) = q(k) + q'(k) dt, (N, 3).

    Kept to show its error: each step leaves along the old heading, so a curve is driven too
    wide. Arguments and errors are those of integrate.
    """
    distance, turn, start = _steps(drive, left, right, start)
    theta = np.cumsum(np.concatenate([start[2:], turn]))
    return _track(start, distance, theta[:-1], theta)[:np.size(left)]


def _steps(
    drive: DiffDrive, left: npt.ArrayLike, right: npt.ArrayLike, start: npt.ArrayLike,
) -> tuple[Array, Array, Array]:
    left, right, start = finite('left', left), finite('right', right), _pose('start', start)
    if left.ndim != 1 or left.shape != right.shape:
        raise ValueError(
            f'left has shape {left.shape}, right {right.shape}: must be (N,) for both')
    return *drive.body_twist(np.diff(left), np.diff(right)), start  # times dt = 1 step


def _pose(name: str, value: npt.ArrayLike) -> Array:
    pose = vectors(name, value, 3)
    if pose.shape != (3,):
        raise ValueError(f'{name} has shape {pose.shape}: must be (3,)')
    return pose


def _track(start: Array, length: Array, heading: Array, theta: Array) -> Array:
    poses = np.empty((theta.size, 3))
    poses[:, 0] = np.cumsum(np.concatenate([start[:1], length * np.cos(heading)]))
    poses[:, 1] = np.cumsum(np.concatenate([start[1:2], length * np.sin(heading)]))
    poses[:, 2] = theta
    return poses


@dataclass(frozen=True)
class WheelNoise:
    """
    How far the wheels' travel over the floor can be trusted: white noise that grows with it.

    left_travel and right_travel are the variance of each wheel's travel per metre driven by it
    [m^2/m]; turn is the variance of the heading per radian turned, from wheels that scrub
    [rad^2/rad]. The defaults suit a small indoor robot. Raises ValueError for a value that is
    negative or not finite.
    """

    left_travel: float = 1e-5
    right_travel: float = 1e-5
    turn: float = 1e-4

    def __post_init__(self) -> None:
        for field in fields(self):
            not_negative(field.name, getattr(self, field.name))


# Variances below these serve nobody and break filters that invert them.
LEAST_POSE_VARIANCE = 1e-9  # [m^2], [rad^2]
LEAST_TWIST_VARIANCE = 1e-6  # [m^2/s^2], [rad^2/s^2]


class Odometry:
    """
    The pose of a robot, kept up to date with each sample of its wheel angles.

    window is the number of sample intervals over which the twist is measured, as displacement
    over time. Raises ValueError for a window below 1.
    """

    def __init__(
        self, drive: DiffDrive, *, window: int = 10, noise: WheelNoise | None = None,
        start: npt.ArrayLike = ORIGIN,
    ) -> None:
        if window < 1:
            raise ValueError(f'window = {window!r}: must be 1 or more')
        self.drive = drive
        self.noise = noise or WheelNoise()
        # Stamp and wheel angles, and the sums of the noise until then: along, cross, turning.
        self._samples: deque[tuple[int, float, float, float, float, float]] = deque(
            maxlen=window + 1)
        self.reset(_pose('start', start))

    def reset(self, pose: npt.ArrayLike = ORIGIN) -> None:
        """Set the pose, and its covariance to the least; the wheels' last sample stays."""
        self._x, self._y, self._theta = _pose('pose', pose).tolist()
        # The upper triangle of the covariance, in the odom frame: xx, xy, xt, yy, yt, tt.
        least = LEAST_POSE_VARIANCE
        self._covariance = (least, 0.0, 0.0, least, 0.0, least)

    def update(self, left: float, right: float, stamp_ns: int) -> bool:
        """
        Take a sample of the wheel angles [rad] at a time [ns]; True if the pose is now of it.

        The first sample is the baseline: the pose stays. A sample that is not newer than the
        last is passed over, and the next one carries its motion. Raises ValueError for angles
        that are not finite, or so far from the last that the pose would not be; nothing has
        changed then.
        """
        if not (math.isfinite(left) and math.isfinite(right)):
            raise ValueError(f'left, right = {left!r}, {right!r}: must be finite')
        if not self._samples:
            self._samples.append((stamp_ns, left, right, 0.0, 0.0, 0.0))
            return True
        last_ns, last_left, last_right, along, cross, turning = self._samples[-1]
        if stamp_ns <= last_ns:
            return False
        noise = self._drive_arc(
            self.drive.left_wheel_radius * (left - last_left),
            self.drive.right_wheel_radius * (right - last_right))
        self._samples.append((
            stamp_ns, left, right, along + noise[0], cross + noise[1], turning + noise[2]))
        return True

    @property
    def pose(self) -> Array:
        """Return the pose [x, y, theta] in the odom frame, (3,), theta not wrapped."""
        return np.array([self._x, self._y, self._theta])

    @property
    def twist(self) -> Array:
        """Return the mean body twist [v_x, 0, omega] of the window, (3,); exactly zero at rest."""
        left, right, _, _, _, seconds = self._window()
        linear, angular = self.drive.body_twist(left / seconds, right / seconds)
        return np.array([linear, 0.0, angular])

    @property
    def pose_covariance(self) -> Array:
        """Return the covariance of the pose in the odom frame, (3, 3), order x, y, theta."""
        xx, xy, xt, yy, yt, tt = self._covariance
        return np.array([[xx, xy, xt], [xy, yy, yt], [xt, yt, tt]])

    @property
    def twist_covariance(self) -> Array:
        """
        Return the covariance of the twist, (3, 3), order v_x, v_y, omega, never below a floor.

        From the noise of the travel in the window; sideways slip is taken to be as large as
        slip along, since wheels that lose their grip lose it in both directions.
        """
        _, _, along, cross, turning, seconds = self._window()
        covariance = np.array([[along, 0.0, cross], [0.0, along, 0.0], [cross, 0.0, turning]])
        return covariance / seconds**2 + LEAST_TWIST_VARIANCE * np.eye(3)

    def _window(self) -> tuple[float, ...]:
        """Return what the window added to the wheels' angles and the noise, and its length [s]."""
        if len(self._samples) < 2:
            return 0.0, 0.0, 0.0, 0.0, 0.0, 1.0
        first_ns, *first = self._samples[0]
        last_ns, *last = self._samples[-1]
        added = (new - old for new, old in zip(last, first, strict=True))
        return *added, (last_ns - first_ns) * 1e-9

    def _drive_arc(self, left: float, right: float) -> tuple[float, float, float]:
        """Move along the arc of the wheels' travel [m], with its noise, and return that."""
        distance, turn = 0.5 * (right + left), (right - left) / self.drive.wheel_separation
        if not math.isfinite(distance * distance + turn * turn):
            raise ValueError(f'travel = {left!r}, {right!r} m in one step: must be finite')
        half_turn = 0.5 * turn
        shrink = math.sin(half_turn) / half_turn if half_turn else 1.0
        cos, sin = math.cos(self._theta + half_turn), math.sin(self._theta + half_turn)
        dx, dy = distance * shrink * cos, distance * shrink * sin
        bend = _shrink_rate(half_turn)
        noise = self._noise_of(left, right)
        self._spread(
            dx, dy,
            along=(shrink * cos, shrink * sin),
            turning=(
                0.5 * distance * (bend * cos - shrink * sin),
                0.5 * distance * (bend * sin + shrink * cos)),
            noise=noise)
        self._x += dx
        self._y += dy
        self._theta += turn
        return noise

    def _spread(
        self, dx: float, dy: float, along: tuple[float, float], turning: tuple[float, float],
        noise: tuple[float, float, float],
    ) -> None:
        """
        Propagate the covariance, P <- F P F^T + G Q G^T, by the exact Jacobians of the arc.

        F = [[1, 0, -dy], [0, 1, dx], [0, 0, 1]] is that of the pose; the columns of G are the
        change of the pose with the distance, (along, 0), and with the turn, (turning, 1).
        """
        xx, xy, xt, yy, yt, tt = self._covariance
        (ax, ay), (tx, ty), (q_along, q_cross, q_turning) = along, turning, noise
        gx, gy = q_along * ax + q_cross * tx, q_along * ay + q_cross * ty
        hx, hy = q_cross * ax + q_turning * tx, q_cross * ay + q_turning * ty
        self._covariance = (
            xx - 2.0 * dy * xt + dy * dy * tt + gx * ax + hx * tx,
            xy + dx * xt - dy * yt - dx * dy * tt + gx * ay + hx * ty,
            xt - dy * tt + hx,
            yy + 2.0 * dx * yt + dx * dx * tt + gy * ay + hy * ty,
            yt + dx * tt + hy,
            tt + q_turning)

    def _noise_of(self, left: float, right: float) -> tuple[float, float, float]:
        """Return the variance of distance, its covariance with turn, and the variance of turn."""
        separation = self.drive.wheel_separation
        var_left = self.noise.left_travel * abs(left)
        var_right = self.noise.right_travel * abs(right)
        var_turn = self.noise.turn * abs(right - left) / separation
        return (
            0.25 * (var_left + var_right),
            0.5 * (var_right - var_left) / separation,
            (var_left + var_right) / (separation * separation) + var_turn)


def _shrink_rate(half_turn: float) -> float:
    """Return the derivative of sin(a) / a to 5e-14, by its series where the rest cancels."""
    if abs(half_turn) < 0.1:
        square = half_turn * half_turn
        return -half_turn / 3.0 * (1.0 - square / 10.0 * (1.0 - square / 28.0 * (
            1.0 - square / 54.0)))
    return (math.cos(half_turn) - math.sin(half_turn) / half_turn) / half_turn
