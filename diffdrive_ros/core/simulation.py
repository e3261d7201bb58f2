"""
A simulated robot: motors with lag, wheels with slip, encoders with a resolution.

It shares no code with the odometry that it tests. The time step is much shorter than the period
of messages, and the true pose is the plain sum of those short steps. The response of the motors
is a first-order lag, in closed form.
"""
from dataclasses import dataclass
import math

from diffdrive_ros.core.validation import Array, finite, not_negative, positive
import numpy as np
import numpy.typing as npt


@dataclass(frozen=True)
class RobotModel:
    """
    Parameters of the simulated robot; SI units, rad, full wheel_separation.

    motor_time_constant [s]: time to 63 % of a change of wheel speed. ticks_per_revolution: ticks
    of an encoder per turn of its wheel, 0 for infinite resolution. slip: fraction of their travel
    that both wheels lose on the floor, below 1. travel_noise [m/sqrt(m)]: standard deviation of a
    wheel's travel over the floor after one metre. Raises ValueError with the name of a parameter
    out of its range.
    """

    wheel_separation: float
    left_wheel_radius: float
    right_wheel_radius: float
    motor_time_constant: float = 0.05
    ticks_per_revolution: int = 4096
    slip: float = 0.0
    travel_noise: float = 0.0

    def __post_init__(self) -> None:
        for name in ('wheel_separation', 'left_wheel_radius', 'right_wheel_radius'):
            positive(name, getattr(self, name))
        for name in ('motor_time_constant', 'ticks_per_revolution', 'slip', 'travel_noise'):
            not_negative(name, getattr(self, name))
        if self.slip >= 1.0:
            raise ValueError(f'slip = {self.slip!r}: must be below 1')


class SimulatedRobot:
    """
    A robot, or with runs > 1 several at once, each with independent noise.

    Arrays have the shape (2,) or (2, runs), left before right; poses have (3,) or (3, runs). step
    [s] is the time step. The same seed gives the same noise.
    """

    def __init__(
        self, model: RobotModel, *, seed: int = 0, runs: int = 1, step: float = 1e-3,
    ) -> None:
        self.model = model
        self._step = positive('step', step)
        self._noise = np.random.default_rng(seed)
        shape = () if runs == 1 else (runs,)
        self.pose: Array = np.zeros((3, *shape))
        """The true pose x, y, theta of the robot in the world."""
        self.speeds: Array = np.zeros((2, *shape))
        """The true speeds of the wheels [rad/s]."""
        self._angles: Array = np.zeros((2, *shape))
        self._targets: Array = np.zeros((2, *shape))
        self._lasts = 0.0
        self._radii = np.array([model.left_wheel_radius, model.right_wheel_radius])

    def command(
        self, left: npt.ArrayLike, right: npt.ArrayLike, lasts: float = math.inf,
    ) -> None:
        """
        Set the target speeds [rad/s] of the motors; after lasts [s] they become zero.

        Raises ValueError, without effect, for speeds that are not finite.
        """
        left, right = finite('left', left), finite('right', right)
        self._targets[0], self._targets[1] = left, right
        self._lasts = lasts

    def advance(self, seconds: float) -> None:
        """Advance the time [s]; raises ValueError if it is negative or not finite."""
        seconds = not_negative('seconds', seconds)
        driven = min(seconds, self._lasts)
        self._drive(driven)
        self._lasts -= driven
        if driven < seconds:
            self._targets[:] = 0.0
            self._drive(seconds - driven)

    @property
    def encoders(self) -> Array:
        """Return the wheel angles [rad] at the resolution of the encoders."""
        if not self.model.ticks_per_revolution:
            return self._angles.copy()
        tick = 2.0 * math.pi / self.model.ticks_per_revolution
        counts: Array = np.floor(self._angles / tick)
        return counts * tick

    @property
    def twist(self) -> Array:
        """Return the true body twist [v_x, 0, omega], without the noise."""
        left, right = self._rims() * self.speeds * (1.0 - self.model.slip)
        zero = np.zeros_like(left)
        return np.stack([(left + right) / 2.0, zero, (right - left) / self.model.wheel_separation])

    def _drive(self, seconds: float) -> None:
        if seconds == 0.0:
            return
        steps = math.ceil(seconds / self._step)
        times: Array = np.linspace(0.0, seconds, steps + 1, dtype=np.float64)
        moved = np.diff(self._angles_over(times), axis=0)
        rolled = self._rims() * moved
        travel = (1.0 - self.model.slip) * rolled
        if self.model.travel_noise:
            spread = self.model.travel_noise * np.sqrt(np.abs(rolled))
            travel = travel + spread * self._noise.standard_normal(rolled.shape)
        left, right = travel[:, 0], travel[:, 1]
        turns = (right - left) / self.model.wheel_separation
        headings = self.pose[2] + np.cumsum(turns, axis=0)
        halfway = headings - turns / 2.0
        self.pose[0] += np.sum((left + right) / 2.0 * np.cos(halfway), axis=0)
        self.pose[1] += np.sum((left + right) / 2.0 * np.sin(halfway), axis=0)
        self.pose[2] = headings[-1]
        self._angles += np.sum(moved, axis=0)
        decay = self._decay(np.array(seconds))
        self.speeds = self._targets + (self.speeds - self._targets) * decay

    def _angles_over(self, times: Array) -> Array:
        """Return the turn of the wheels until each time, (N, 2) or (N, 2, runs)."""
        times = times.reshape(-1, *(1 for _ in self._targets.shape))
        behind = self.speeds - self._targets
        lag = self.model.motor_time_constant * (1.0 - self._decay(times))
        angles: Array = self._targets * times + behind * lag
        return angles

    def _decay(self, times: Array) -> Array:
        """Return the remaining fraction of a difference in speed after some time."""
        if self.model.motor_time_constant == 0.0:
            return np.where(times > 0.0, 0.0, 1.0)
        return np.exp(-times / self.model.motor_time_constant)

    def _rims(self) -> Array:
        return self._radii.reshape(2, *(1 for _ in self._targets.shape[1:]))
