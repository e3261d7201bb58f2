"""
Teleoperation: which page drives, and which of its heartbeats become commands.

Pages in browsers send heartbeats with the state of their keys and joystick. Each heartbeat is
published at most once, so that the robot moves only while heartbeats arrive. It carries the
timestamp of the newest frame that its page has drawn: the latency since then covers commands that
waited on the network, and a driver who does not see the robot as it is. All times are of a steady
clock [s].
"""
from collections.abc import Collection, Sequence
from dataclasses import dataclass
import math

HEARTBEAT_TIMEOUT_S = 0.3  # of a moving robot; below the usual cmd_vel_timeout
MAX_LATENCY_S = 0.4  # since the newest frame that the page has drawn
JOYSTICK_DEAD_ZONE = 0.1  # share of the way to its edge

Twist = tuple[float, float]
"""Forward speed [m/s] and turn rate [rad/s]."""
STOP: Twist = (0.0, 0.0)


@dataclass(frozen=True)
class Heartbeat:
    """
    The state of a page's controls; frame_time is when the server sent its newest frame.

    is_interrupted: the page released controls that the driver may still hold. may_drive: whether
    this page may drive the robot.
    """

    sequence_number: int
    frame_time: float
    twist: Twist
    is_interrupted: bool = False
    may_drive: bool = True


@dataclass
class _Client:
    """
    A page: its last sequence number, and the state of its dead-man switch.

    is_armed: its controls were at rest since the last stop. is_held: its command was ignored.
    """

    sequence_number: int = -1
    is_armed: bool = False
    is_held: bool = False
    stop_reason: str = ''


class Teleop:
    """
    Decides on each heartbeat; the methods return the twist to publish now, or None.

    One page drives. The first that asks for motion takes control while no page has it; afterwards
    only take_control changes the driver. The dead-man switch: after every stop but the driver's
    own, the controls have to return to rest before they count again.
    """

    def __init__(self) -> None:
        self.driver: str | None = None
        """The page that drives."""
        self.is_stopped = False
        """Whether STOP was pressed; nothing is driven until resume."""
        self.stop_count = 0
        """How often STOP was pressed."""
        self._clients: dict[str, _Client] = {}
        self._moving_since: float | None = None

    @property
    def is_moving(self) -> bool:
        """Return whether the last twist was no stop."""
        return self._moving_since is not None

    def stop_reason(self, page: str) -> str:
        """Return why the commands of a page are not driven, for a person to read."""
        client = self._clients.get(page, _Client())
        return client.stop_reason or (
            'keys or joystick were held before' if client.is_held else '')

    def accept(self, page: str, heartbeat: Heartbeat, now: float) -> Twist | None:
        """Accept a heartbeat of a page."""
        client = self._clients.setdefault(page, _Client())
        if heartbeat.sequence_number <= client.sequence_number:  # a duplicate, or out of order
            return None
        client.sequence_number = heartbeat.sequence_number
        if heartbeat.is_interrupted:
            client.stop_reason = 'this page lost the focus, or was suspended'
        if not all(map(math.isfinite, (*heartbeat.twist, heartbeat.frame_time))):
            return self._trip(page, 'a command is not finite')
        if heartbeat.twist != STOP and not heartbeat.may_drive:
            return self._ignore(page)
        if heartbeat.twist == STOP:  # controls at rest count whatever the latency
            client.is_armed, client.is_held = True, False
            return self._halt() if page == self.driver else None
        if not _is_current(heartbeat.frame_time, now):
            return self._trip(page, f'the latency is above {MAX_LATENCY_S:g} s')
        if self.is_stopped or not client.is_armed or self.driver not in (None, page):
            return self._ignore(page)
        self.driver = page
        client.stop_reason = ''
        self._moving_since = now
        return heartbeat.twist

    def is_current(self, frame_time: float, stop_count: int, now: float) -> bool:
        """
        Return whether a page shows the present state, so that a click on it is meant for that.

        frame_time is when its newest frame was sent, stop_count how often STOP was pressed then.
        """
        return stop_count == self.stop_count and _is_current(frame_time, now)

    def reject(self, page: str) -> Twist | None:
        """Stop for a heartbeat that cannot be decoded."""
        self._clients.setdefault(page, _Client())
        return self._trip(page, 'a heartbeat of this page is invalid')

    def check_timeout(self, now: float) -> Twist | None:
        """Stop a robot whose driver's heartbeats ended; to be called periodically."""
        if self.driver and self._moving_since is not None and (
                now - self._moving_since > HEARTBEAT_TIMEOUT_S):
            return self._trip(self.driver, 'heartbeat timeout')
        return None

    def take_control(self, page: str) -> Twist | None:
        """Make a page the driver, in place of any other."""
        self._clients.setdefault(page, _Client()).is_armed = False
        self.driver = page
        return self._halt()

    def leave(self, page: str) -> Twist | None:
        """Remove a page; if it drives, stop and have no driver."""
        self._clients.pop(page, None)
        if page != self.driver:
            return None
        self.driver = None
        return self._halt()

    def stop(self) -> Twist:
        """Stop on request of any page, whichever drives, until resume."""
        self.is_stopped = True
        self.stop_count += 1
        for client in self._clients.values():
            client.is_armed, client.stop_reason = False, ''
        self._halt()
        return STOP

    def disarm(self, reason: str) -> Twist | None:
        """Stop a robot that may not be driven now; the dead-man switch of every page opens."""
        if self.driver and self.is_moving:
            self._clients[self.driver].stop_reason = reason
        for client in self._clients.values():
            client.is_armed = False
        return self._halt()

    def resume(self) -> None:
        """Release the stop."""
        self.is_stopped = False

    def _trip(self, page: str, reason: str) -> Twist | None:
        self._clients[page].stop_reason = reason
        self._clients[page].is_armed = False
        return self._halt() if page == self.driver else None

    def _ignore(self, page: str) -> Twist | None:
        self._clients[page].is_held = True
        self._clients[page].is_armed = False
        return self._halt() if page == self.driver else None

    def _halt(self) -> Twist | None:
        if self._moving_since is None:
            return None
        self._moving_since = None
        return STOP


def twist_of_keys(keys: Collection[str], limits: Twist) -> Twist:
    """
    Return the twist of the keys that are down, at the speed limits.

    Opposite keys cancel out. Driving backward, left still turns the robot to its left.
    """
    forward = ('forward' in keys) - ('backward' in keys)
    left = ('left' in keys) - ('right' in keys)
    return forward * limits[0], left * limits[1]


def twist_of_joystick(position: Sequence[float], limits: Twist) -> Twist:
    """
    Return the twist of a joystick at (right, forward), each from -1 to 1.

    Outside the dead zone the speed grows with the square of the deflection, for fine motion.
    Raises ValueError unless there are two finite numbers.
    """
    right, forward = map(float, position)
    if not (math.isfinite(right) and math.isfinite(forward)):
        raise ValueError(f'joystick = ({right}, {forward}): must be finite')
    deflection = min(1.0, math.hypot(right, forward))
    if deflection <= JOYSTICK_DEAD_ZONE:
        return STOP
    share = (deflection - JOYSTICK_DEAD_ZONE) / (1.0 - JOYSTICK_DEAD_ZONE)
    scale = share ** 2 / math.hypot(right, forward)
    return scale * forward * limits[0], -scale * right * limits[1]


def saturate(twist: Twist, limits: Twist) -> Twist:
    """Return a twist scaled by one factor to the limits, so that its curvature stays."""
    factor = 1.0
    for value, limit in zip(twist, limits, strict=True):
        if abs(value) > limit:
            factor = min(factor, limit / abs(value))
    return factor * twist[0], factor * twist[1]


def _is_current(frame_time: float, now: float) -> bool:
    return 0.0 <= now - frame_time <= MAX_LATENCY_S
