"""
Rigid motions of the plane, SE(2), as plain arrays.

A pose is [x, y, theta], a twist [v_x, v_y, omega], a point or vector [x, y], each in the last
axis of an array of any shape (..., 3) or (..., 2); shapes broadcast. SI units, rad, theta
counter-clockwise positive. ``T_ab`` maps coordinates in frame b to frame a. Every function
raises ValueError, naming the argument, for a wrong shape and for values that are not finite.

The equations are derived in doc/kinematics.md; the closed form of exp is the planar case of
Lynch and Park, Modern Robotics (2017), section 3.3.3, in a form without cancellation.
"""
from diffdrive_ros.core.validation import Array, finite, vectors
import numpy as np
import numpy.typing as npt


def exp(twist: npt.ArrayLike) -> Array:
    """
    Return the pose T_ab reached from a by a constant body twist in unit time, (..., 3).

    The path is an arc. Its chord has the direction of the heading half-way and is shorter than
    the arc by sin(omega/2) / (omega/2). Exact for every turn, zero included.
    """
    twist = vectors('twist', twist, 3)
    half_turn = 0.5 * twist[..., 2]
    chord = rotate(half_turn, chord_over_arc(half_turn)[..., np.newaxis] * twist[..., :2])
    return _with_heading(chord, twist[..., 2])


def log(pose: npt.ArrayLike) -> Array:
    """
    Return the constant body twist that reaches the pose in unit time, (..., 3).

    The inverse of exp for turns of at most half a circle. Raises ValueError for a theta outside
    (-pi, pi], because a pose does not contain the number of whole turns.
    """
    pose = vectors('pose', pose, 3)
    theta = pose[..., 2]
    if (outside := (theta <= -np.pi) | (theta > np.pi)).any():
        raise ValueError(f'theta = {theta[outside][0]}: must be in (-pi, pi], see wrap_angle')
    half_turn = 0.5 * theta
    arc = rotate(-half_turn, pose[..., :2]) / chord_over_arc(half_turn)[..., np.newaxis]
    return _with_heading(arc, theta)


def compose(T_ab: npt.ArrayLike, T_bc: npt.ArrayLike) -> Array:
    """Return T_ac = T_ab T_bc, (..., 3). Headings are added and not wrapped."""
    T_ab, T_bc = vectors('T_ab', T_ab, 3), vectors('T_bc', T_bc, 3)
    return _with_heading(transform(T_ab, T_bc[..., :2]), T_ab[..., 2] + T_bc[..., 2])


def inverse(T_ab: npt.ArrayLike) -> Array:
    """Return T_ba, so that compose(T_ab, T_ba) is the identity, (..., 3)."""
    T_ab = vectors('T_ab', T_ab, 3)
    return _with_heading(-rotate(-T_ab[..., 2], T_ab[..., :2]), -T_ab[..., 2])


def between(T_wa: npt.ArrayLike, T_wb: npt.ArrayLike) -> Array:
    """Return T_ab, the pose of b in a, of two poses in one frame w, (..., 3)."""
    T_wa, T_wb = vectors('T_wa', T_wa, 3), vectors('T_wb', T_wb, 3)
    offset_w = T_wb[..., :2] - T_wa[..., :2]
    return _with_heading(rotate(-T_wa[..., 2], offset_w), T_wb[..., 2] - T_wa[..., 2])


def transform(T_ab: npt.ArrayLike, points_b: npt.ArrayLike) -> Array:
    """Return points given in frame b in frame a: R(theta) p_b + t, (..., 2)."""
    T_ab, points_b = vectors('T_ab', T_ab, 3), vectors('points_b', points_b, 2)
    return rotate(T_ab[..., 2], points_b) + T_ab[..., :2]


def rotate(theta: npt.ArrayLike, vectors_b: npt.ArrayLike) -> Array:
    """Return vectors (velocities, offsets) of a frame turned by theta: R(theta) v_b, (..., 2)."""
    theta, vectors_b = finite('theta', theta), vectors('vectors_b', vectors_b, 2)
    cos, sin = np.cos(theta), np.sin(theta)
    x, y = vectors_b[..., 0], vectors_b[..., 1]
    return np.stack([cos * x - sin * y, sin * x + cos * y], axis=-1)


def adjoint(T_ab: npt.ArrayLike) -> Array:
    """
    Return Ad(T_ab), (..., 3, 3), which maps a rigid body's twist in b to its twist in a.

    V_a = Ad(T_ab) V_b in the order [v_x, v_y, omega]: [[R, (y, -x)], [0, 0, 1]].
    """
    T_ab = vectors('T_ab', T_ab, 3)
    cos, sin = np.cos(T_ab[..., 2]), np.sin(T_ab[..., 2])
    matrix = np.zeros((*T_ab.shape, 3))
    matrix[..., 0, 0], matrix[..., 0, 1], matrix[..., 0, 2] = cos, -sin, T_ab[..., 1]
    matrix[..., 1, 0], matrix[..., 1, 1], matrix[..., 1, 2] = sin, cos, -T_ab[..., 0]
    matrix[..., 2, 2] = 1.0
    return matrix


def pose_rate(pose: npt.ArrayLike, twist: npt.ArrayLike) -> Array:
    """
    Return the rate of change of a pose driven by a body twist, (..., 3).

    q' = blkdiag(R(theta), 1) V_b, the continuous model; (cos theta v_x, sin theta v_x, omega)
    without sideways motion. It maps the coordinates of T_bb' to those of T_wb' - T_wb likewise.
    """
    pose, twist = vectors('pose', pose, 3), vectors('twist', twist, 3)
    return _with_heading(rotate(pose[..., 2], twist[..., :2]), twist[..., 2])


def wrap_angle(theta: npt.ArrayLike) -> Array:
    """Return angles wrapped to (-pi, pi] by whole turns; angles inside stay bit for bit."""
    turned = np.fmod(finite('theta', theta), 2.0 * np.pi)
    turned = np.where(turned > np.pi, turned - 2.0 * np.pi, turned)
    return np.where(turned <= -np.pi, turned + 2.0 * np.pi, turned)[()]


def chord_over_arc(half_turn: npt.ArrayLike) -> Array:
    """Return the ratio of chord and arc, sin(a) / a of half the turn, 1 at 0."""
    # Even in a; at the smallest a, sin(a) is a, so that the ratio is 1.
    angle = np.maximum(np.abs(finite('half_turn', half_turn)), np.finfo(np.float64).tiny)
    return np.sin(angle) / angle


def chord_over_arc_rate(half_turn: npt.ArrayLike) -> Array:
    """Return the derivative of chord_over_arc, to 5e-14: (cos a - sin a / a) / a, odd in a."""
    half_turn = finite('half_turn', half_turn)
    is_small = np.abs(half_turn) < 0.1  # where the difference cancels: the series
    square, angle = half_turn * half_turn, np.where(is_small, 1.0, half_turn)
    series = -half_turn / 3.0 * (
        1.0 - square / 10.0 * (1.0 - square / 28.0 * (1.0 - square / 54.0)))
    return np.where(is_small, series, (np.cos(angle) - np.sin(angle) / angle) / angle)


def _with_heading(xy: Array, theta: Array) -> Array:
    shape = np.broadcast_shapes(xy.shape[:-1], theta.shape)
    result = np.empty((*shape, 3))
    result[..., :2] = xy
    result[..., 2] = theta
    return result
