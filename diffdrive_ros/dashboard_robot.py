"""The robot as all pages see it: what was heard of it, its tracks, its geometry, its driver."""
from collections.abc import Sequence
import math
import time
from typing import Any

from diffdrive_ros import ellipse, parameters, remote_parameters
from diffdrive_ros.dashboard_node import DashboardNode, NoAnswerError
from diffdrive_ros.pilot import Pilot, Twist
from diffdrive_ros.remote_parameters import RemoteParameter
from diffdrive_ros.track import Track
from std_srvs.srv import SetBool, Trigger

RECENT = 1.0  # [s] that a message stands for the robot as it is
DIAGNOSTICS_SILENT = 3.0  # [s] after which a status, which comes once a second, is an old one
DISABLED = 'disabled by ~/enable'  # as /diagnostics has it

Pose = tuple[float, float, float]


class DashboardRobot:
    """One robot, seen through a node; used from one thread."""

    def __init__(self, node: DashboardNode) -> None:
        self.node = node
        self.pilot = Pilot()
        self.tracks = {'odom': Track(), 'truth': Track()}
        self.drive = parameters.drive({spec.name: spec.default for spec in parameters.GEOMETRY})
        self.parameters: list[RemoteParameter] = []
        self.is_simulated = False
        self.other_commanders: Sequence[str] = ()
        self.odom: Pose | None = None
        self.truth: Pose | None = None
        self.wheels = (0.0, 0.0)
        self.ellipse: tuple[float, float, float] | None = None
        self._frame = 'odom'
        self._joints: tuple[tuple[str, ...], tuple[str, ...]] = ((), ())
        self._directions = (1.0, 1.0)

    def publish(self, twist: Twist | None) -> None:
        """Publish what the pilot decided."""
        if twist is not None:
            self.node.command(twist)

    def look(self) -> None:
        """Take in what has been heard."""
        odom, truth = self.node.odom, self.node.truth
        if odom.age < RECENT:
            message = odom.message
            self.odom = pose_of(message) or self.odom
            if self.odom:
                self.tracks['odom'].add(*self.odom[:2])
            self._frame = message.header.frame_id
            covariance = message.pose.covariance
            self.ellipse = ellipse.of_covariance(
                [[covariance[0], covariance[1]], [covariance[6], covariance[7]]])
        self.truth = None
        if truth.age < RECENT:
            self.truth = pose_of(truth.message)
            if self.truth:
                self.tracks['truth'].add(*self.truth[:2])
        self.wheels = self._wheel_speeds()
        reason = self.reason_not_to_drive or ('the node is disabled' if self.is_disabled else '')
        if reason:
            self.publish(self.pilot.disarm(reason))

    def look_around(self) -> None:
        """Take in who is there; slower than what they say."""
        self.is_simulated = self.node.is_simulated()
        self.other_commanders = self.node.other_commanders()

    @property
    def twist(self) -> Twist:
        """Return how the robot moves by its odometry."""
        if self.node.odom.age > RECENT:
            return 0.0, 0.0
        measured = self.node.odom.message.twist.twist
        return measured.linear.x, measured.angular.z

    @property
    def applied(self) -> Twist | None:
        """Return the twist that the node has the wheels do, if it tells."""
        if self.node.applied.age > RECENT:
            return None
        twist = self.node.applied.message.twist
        return twist.linear.x, twist.angular.z

    @property
    def is_disabled(self) -> bool:
        """Return whether the node holds the wheels because somebody asked it to."""
        now = time.monotonic()
        return any(DISABLED in status.message and now - heard_at < DIAGNOSTICS_SILENT
                   for heard_at, status in list(self.node.diagnostics.values()))

    @property
    def reason_not_to_drive(self) -> str:
        """Return why no page may drive this robot, if so."""
        timeout = next((
            each.value for each in self.parameters if each.name == 'cmd_vel_timeout'), None)
        if timeout is None:
            return 'its parameters are not known yet'
        if not timeout:
            return 'its cmd_vel_timeout is 0, so that nothing would stop it if this computer fails'
        return ''

    async def learn(self) -> None:
        """Read the parameters of the node, and what follows from them; raises NoAnswerError."""
        self.parameters = await remote_parameters.read_all(self.node.ask)
        values = {each.name: each.value for each in self.parameters}
        try:
            self.drive = parameters.drive(values)
            self._joints = parameters.wheel_names(values)
            self._directions = (
                float(values['left_wheel_direction']), float(values['right_wheel_direction']))
            self.node.prepare(bool(values['enable_stamped_cmd_vel']))
        except (KeyError, ValueError) as error:
            raise NoAnswerError(f'this is another node than odometry: {error}') from None

    async def set_parameter(self, name: str, text: str) -> str:
        """Set a parameter to what a person wrote; return why not, or nothing."""
        kind = next(each.kind for each in self.parameters if each.name == name)
        reason = await remote_parameters.write(self.node.ask, name, kind, text)
        await self.learn()
        return reason

    async def hold(self, is_held: bool) -> str:
        """Have the node hold the wheels at zero, or no longer; return its word."""
        answer = await self.node.ask('enable', SetBool.Request(data=not is_held))
        self.node.diagnostics.clear()  # they tell of before
        return str(answer.message)

    async def reset(self) -> str:
        """Set odometry to zero; return the node's word."""
        answer = await self.node.ask('reset_odometry', Trigger.Request())
        return str(answer.message)

    def set_pose(self, pose: Sequence[float]) -> None:
        """Set odometry to a pose."""
        x, y, theta = pose
        self.node.set_pose(x, y, theta, self._frame)

    def _wheel_speeds(self) -> tuple[float, float]:
        """Return the mean speed of each side, forward positive [rad/s]."""
        if self.node.joints.age > RECENT:
            return 0.0, 0.0
        message = self.node.joints.message
        speeds = dict(zip(message.name, message.velocity, strict=False))
        left, right = (
            direction * _mean([speeds[name] for name in names if name in speeds])
            for names, direction in zip(self._joints, self._directions, strict=True))
        return left, right


def pose_of(message: Any) -> Pose | None:
    """Return the pose of an Odometry message, theta in [-pi, pi]; None if it is not finite."""
    position, orientation = message.pose.pose.position, message.pose.pose.orientation
    theta = 2.0 * math.atan2(orientation.z, orientation.w)
    if not all(map(math.isfinite, (position.x, position.y, theta))):
        return None
    return position.x, position.y, math.remainder(theta, 2.0 * math.pi)


def _mean(values: Sequence[float]) -> float:
    finite = [value for value in values if math.isfinite(value)]
    return sum(finite) / len(finite) if finite else 0.0
