"""Hands on keys and joystick to the twist that they ask for."""
from collections.abc import Collection, Sequence
import math

from diffdrive_ros.dashboard.teleop import Twist

FORWARD, BACKWARD, LEFT, RIGHT = 'forward', 'backward', 'left', 'right'


def of_keys(keys: Collection[str], fastest: Twist) -> Twist:
    """
    Return the twist of the keys that are down, at the speeds [m/s, rad/s] that are the fastest.

    Opposite keys cancel out. Driving backward, left still turns the robot to its left.
    """
    ahead = (FORWARD in keys) - (BACKWARD in keys)
    aside = (LEFT in keys) - (RIGHT in keys)
    return ahead * fastest[0], aside * fastest[1]


def of_stick(stick: Sequence[float], fastest: Twist) -> Twist:
    """
    Return the twist of a joystick at (to the right, ahead), each from -1 to 1.

    The middle tenth is rest; from its edge on, the speed grows with the square of the way, for
    fine moves. Raises ValueError unless there are two finite numbers.
    """
    right, ahead = map(float, stick)
    if not (math.isfinite(right) and math.isfinite(ahead)):
        raise ValueError(f'stick = ({right}, {ahead}): must be finite')
    way = min(1.0, math.hypot(right, ahead))
    if way <= 0.1:
        return 0.0, 0.0
    share = ((way - 0.1) / 0.9) ** 2 / math.hypot(right, ahead)
    return share * ahead * fastest[0], -share * right * fastest[1]


def within(twist: Twist, fastest: Twist) -> Twist:
    """Return a twist slowed down by one factor until neither speed is above the fastest."""
    factor = 1.0
    for value, limit in zip(twist, fastest, strict=True):
        if abs(value) > limit:
            factor = min(factor, limit / abs(value))
    return factor * twist[0], factor * twist[1]
