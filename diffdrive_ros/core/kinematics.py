"""
Kinematics of a differential drive: body twists, wheel speeds and the Jacobians between them.

Body frame: x forward, y left, origin between the wheels' contact points. Both wheels turning
positive drive along +x. Left before right. Twists are [v_x, v_y, omega]; SI units, rad.
"""
from dataclasses import dataclass, fields
from typing import overload

from diffdrive_ros.core import se2
from diffdrive_ros.core.validation import Array, finite, positive, vectors
import numpy as np
import numpy.typing as npt


@dataclass(frozen=True, slots=True)
class DiffDrive:
    """
    The geometry of two driven wheels, or of two sides of wheels that turn together.

    wheel_separation is the FULL distance between the left and right contact points, in m, twice
    the d of the equations. Too large: the robot turns further than commanded, and odometry
    reports too little. Half of it: every turn is wrong by a factor of two. The radii are in m and
    may differ. Raises ValueError unless all are positive and finite.
    """

    wheel_separation: float
    left_wheel_radius: float
    right_wheel_radius: float

    def __post_init__(self) -> None:
        for field in fields(self):
            value = positive(field.name, getattr(self, field.name))
            object.__setattr__(self, field.name, value)

    @overload
    def wheel_speeds(self, linear: float, angular: float) -> tuple[float, float]: ...

    @overload
    def wheel_speeds(
        self, linear: npt.ArrayLike, angular: npt.ArrayLike,
    ) -> tuple[Array, Array]: ...

    def wheel_speeds(
        self, linear: npt.ArrayLike, angular: npt.ArrayLike,
    ) -> tuple[npt.ArrayLike, npt.ArrayLike]:
        """
        Return the left and right wheel speeds [rad/s] of a body twist, as scalars or arrays.

        linear is v_x [m/s], angular omega [rad/s]: phi' = (v_x -/+ d omega) / r, d = s/2.
        Raises ValueError for anything not finite.
        """
        linear, angular = finite('linear', linear), finite('angular', angular)
        rim = self._d * angular
        return (linear - rim) / self.left_wheel_radius, (linear + rim) / self.right_wheel_radius

    @overload
    def body_twist(self, left: float, right: float) -> tuple[float, float]: ...

    @overload
    def body_twist(self, left: npt.ArrayLike, right: npt.ArrayLike) -> tuple[Array, Array]: ...

    def body_twist(
        self, left: npt.ArrayLike, right: npt.ArrayLike,
    ) -> tuple[npt.ArrayLike, npt.ArrayLike]:
        """
        Return v_x [m/s] and omega [rad/s] of wheel speeds [rad/s], as scalars or arrays.

        v_x = (r_R phi'_R + r_L phi'_L) / 2, omega = (r_R phi'_R - r_L phi'_L) / s.
        Raises ValueError for anything not finite.
        """
        left_rim = self.left_wheel_radius * finite('left', left)
        right_rim = self.right_wheel_radius * finite('right', right)
        return 0.5 * (right_rim + left_rim), (right_rim - left_rim) / self.wheel_separation

    def displacement(self, delta_left: npt.ArrayLike, delta_right: npt.ArrayLike) -> Array:
        """
        Return V_b dt, (..., 3), of wheel angle increments [rad].

        V_b dt = H+ (delta phi_L, delta phi_R); se2.exp of it is the motion. Raises ValueError
        for anything not finite.
        """
        distance, turn = self.body_twist(delta_left, delta_right)
        return np.stack([distance, np.zeros_like(distance), turn], axis=-1)

    @property
    def wheel_jacobian(self) -> Array:
        """H, (2, 3): phi' = H V_b, one row a wheel, [1, 0, -/+ d] / r."""
        d, left, right = self._d, self.left_wheel_radius, self.right_wheel_radius
        return np.array([[1.0 / left, 0.0, -d / left], [1.0 / right, 0.0, +d / right]])

    @property
    def body_jacobian(self) -> Array:
        """H+, (3, 2), the pseudo-inverse of H: V_b = H+ phi'."""
        s, left, right = self.wheel_separation, self.left_wheel_radius, self.right_wheel_radius
        return np.array([[0.5 * left, 0.5 * right], [0.0, 0.0], [-left / s, right / s]])

    @property
    def wheel_frames(self) -> Array:
        """T_bl and T_br, (2, 3): each wheel's pose in the body frame."""
        return np.array([[0.0, +self._d, 0.0], [0.0, -self._d, 0.0]])

    @property
    def _d(self) -> float:
        """Half of the separation: the d of the equations."""
        return 0.5 * self.wheel_separation

    def wheel_twists(self, body_twist: npt.ArrayLike) -> Array:
        """
        Return the twist of the left and right wheel frames, (..., 2, 3).

        V_i = A_ib V_b with the adjoint of T_ib: omega_i = omega, v_xi = v_x -/+ d omega,
        v_yi = v_y. Raises ValueError for a wrong shape or anything not finite.
        """
        A_ib = se2.adjoint(se2.inverse(self.wheel_frames))
        twists: Array = np.einsum('wij,...j->...wi', A_ib, vectors('body_twist', body_twist, 3))
        return twists

    def contact_velocities(
        self, left: npt.ArrayLike, right: npt.ArrayLike, body_twist: npt.ArrayLike,
    ) -> Array:
        """
        Return the sliding velocity of each wheel's contact point, (..., 2, 2) [m/s].

        A conventional wheel that rolls has V_i = (r_i phi'_i, 0, omega). Both components, forward
        and sideways, are zero then: the rolling constraint. left and right are wheel speeds
        [rad/s]. Raises ValueError for a wrong shape or anything not finite.
        """
        rims = np.stack(np.broadcast_arrays(
            self.left_wheel_radius * finite('left', left),
            self.right_wheel_radius * finite('right', right),
        ), axis=-1)
        rolling = np.stack([rims, np.zeros_like(rims)], axis=-1)
        sliding: Array = self.wheel_twists(body_twist)[..., :2] - rolling
        return sliding


@overload
def desaturate(left: float, right: float, limit: float) -> tuple[float, float]: ...


@overload
def desaturate(
    left: npt.ArrayLike, right: npt.ArrayLike, limit: float,
) -> tuple[Array, Array]: ...


def desaturate(
    left: npt.ArrayLike, right: npt.ArrayLike, limit: float,
) -> tuple[npt.ArrayLike, npt.ArrayLike]:
    """
    Return wheel speeds scaled to a limit by one factor, so that the curvature stays.

    Scalars or arrays; each pair has its own factor, at most 1. Raises ValueError for
    speeds that are not finite and for a limit that is not positive and finite.
    """
    left, right = finite('left', left), finite('right', right)
    limit = positive('limit', limit)
    factor = limit / np.maximum(np.maximum(np.abs(left), np.abs(right)), limit)
    # Clipped as well, because the rounded product may be one unit above the limit.
    return np.clip(left * factor, -limit, limit), np.clip(right * factor, -limit, limit)
