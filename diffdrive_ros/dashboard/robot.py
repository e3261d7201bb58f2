"""The observed robot as all pages show it, and why it may not be driven."""
from collections.abc import Callable, Sequence
import itertools
import math
from typing import Any

from diffdrive_ros.core.quaternion import heading_of_quaternion
from diffdrive_ros.dashboard.dashboard_node import DashboardNode, LatestMessage
from diffdrive_ros.dashboard.remote_parameters import RemoteParameters
from diffdrive_ros.dashboard.software_stop import CommandsStatus, describe, SoftwareStop
from diffdrive_ros.dashboard.teleop import Teleop, Twist
from diffdrive_ros.dashboard.trajectory import DrawnTrajectory
from std_srvs.srv import Trigger

MESSAGE_TIMEOUT_S = 1.0
MIN_ODOM_RATE_HZ = 2.0  # to drive by
MAX_CMD_VEL_TIMEOUT_S = 2.0  # for which a robot drives on when this computer fails
AXES_95 = math.sqrt(5.991)
"""Semi-axes, in standard deviations, of the ellipse with 95 % of a normal distribution."""

Pose = tuple[float, float, float]


class DashboardRobot:
    """One robot, observed through a node; used from one thread."""

    def __init__(self, node: DashboardNode) -> None:
        self.node = node
        self.teleop = Teleop()
        self.parameters = RemoteParameters(node)
        self.commands = CommandsStatus(node)
        self.software_stop = SoftwareStop(node, self.teleop, self.commands)
        self.trajectories = {'odom': DrawnTrajectory(), 'ground_truth': DrawnTrajectory()}
        self.is_silent = True
        self.is_simulated = False
        self.other_commanders: Sequence[str] = ()
        self.odom: Pose | None = None
        self.ground_truth: Pose | None = None
        self.wheels: tuple[float, float] | None = None
        self.ellipse: tuple[float, float, float] | None = None
        self._frame = 'odom'

    def publish(self, twist: Twist | None) -> None:
        """Publish what the teleoperation decided."""
        if twist is not None:
            self.node.publish_command(twist)

    def update(self) -> None:
        """Evaluate what was received; stop a robot that may not be driven."""
        self._check_odom()
        # Before any message is deserialized, so that an invalid one cannot prevent the stop.
        inhibits = self.commands.new_inhibits()
        if reason := self.reason_not_to_drive or inhibits:
            self.publish(self.teleop.disarm(reason))
        if not self.is_silent:
            message = self.node.odom.message
            self.odom = pose_of(message) or self.odom
            if self.odom:
                self.trajectories['odom'].add(*self.odom[:2])
            self._frame = message.header.frame_id
            covariance = message.pose.covariance
            self.ellipse = ellipse_of(
                [[covariance[0], covariance[1]], [covariance[6], covariance[7]]])
        self.ground_truth = None
        if self.node.ground_truth.age < MESSAGE_TIMEOUT_S:
            self.ground_truth = pose_of(self.node.ground_truth.message)
            if self.ground_truth:
                self.trajectories['ground_truth'].add(*self.ground_truth[:2])
        self.wheels = self._wheel_speeds()

    def update_graph(self) -> None:
        """Update which nodes take part; more slowly than their messages."""
        self.is_simulated = self.node.is_simulated()
        self.other_commanders = self.node.other_commanders()

    @property
    def twist(self) -> Twist | None:
        """Return the twist that odometry measures, or None after a timeout."""
        return _twist(self.node.odom, lambda message: message.twist.twist)

    @property
    def commanded(self) -> Twist | None:
        """Return the newest command of any node, or None after a timeout."""
        return _twist(self.node.commands, lambda message: (
            message.twist if self.node.is_stamped else message))

    @property
    def applied(self) -> Twist | None:
        """Return the twist that the node applies, or None after a timeout."""
        return _twist(self.node.applied, lambda message: message.twist)

    @property
    def inhibits(self) -> str:
        """Return what inhibits the wheels, for a person to read."""
        return describe(self.commands.inhibits)

    @property
    def reason_not_to_drive(self) -> str:
        """Return why no page may drive this robot, or ''."""
        parameters = self.parameters
        waits_for_command = (
            parameters.is_known and self.odom is None and parameters.value('open_loop'))
        if self.is_silent and not waits_for_command:
            return 'odom is silent'
        if not parameters.is_known:
            return parameters.mismatch or 'its parameters are not read yet'
        if self._is_slow:
            return f'its publish_rate is below {MIN_ODOM_RATE_HZ:g} Hz, too slow to drive by'
        timeout = float(parameters.value('cmd_vel_timeout'))
        if not timeout:
            return 'its cmd_vel_timeout is 0, so that nothing would stop it if this computer fails'
        if not timeout <= MAX_CMD_VEL_TIMEOUT_S:
            return (f'its cmd_vel_timeout is {timeout:g} s, above {MAX_CMD_VEL_TIMEOUT_S:g} s: so '
                    'long it would drive on if this computer fails')
        return ''

    async def reset(self) -> str:
        """Reset the odometry; return the message of the node; raises ServiceError."""
        response = await self.node.call('reset_odometry', Trigger.Request())
        for trajectory in self.trajectories.values():
            trajectory.clear()
        return str(response.message)

    def set_pose(self, pose: Sequence[float]) -> None:
        """Set the pose of the odometry."""
        x, y, theta = pose
        self.node.set_pose(x, y, theta, self._frame)

    def _check_odom(self) -> None:
        """Detect that odom fell silent, came back, or has a new publisher."""
        timeout = MESSAGE_TIMEOUT_S
        if self._is_slow:
            timeout += 1.0 / float(self.parameters.value('publish_rate'))
        was_silent, self.is_silent = self.is_silent, self.node.odom.age > timeout
        has_new_publisher = self.node.has_new_odom_publisher()
        if has_new_publisher or self.is_silent != was_silent:
            self.parameters.invalidate()
        if has_new_publisher:
            self.odom = None
            self.commands.restart()

    @property
    def _is_slow(self) -> bool:
        return self.parameters.is_known and (
            0.0 < float(self.parameters.value('publish_rate')) < MIN_ODOM_RATE_HZ)

    def _wheel_speeds(self) -> tuple[float, float] | None:
        """Return the mean joint speed of each side, forward positive [rad/s], or by odometry."""
        joints = self.parameters.joints
        found = self.node.joints.speeds([*itertools.chain(*joints)], MESSAGE_TIMEOUT_S)
        sides = [[found[name] for name in names if name in found] for names in joints]
        if all(sides):
            left, right = (
                float(self.parameters.value(f'{name}_wheel_direction')) * sum(side) / len(side)
                for name, side in zip(('left', 'right'), sides, strict=True))
            return left, right
        twist = self.twist
        if twist is None:
            return None
        left, right = map(float, self.parameters.drive.wheel_speeds(*twist))
        return left, right


def _twist(latest: LatestMessage | None, get: Callable[[Any], Any]) -> Twist | None:
    """Return the twist in the newest message of a topic, or None after a timeout."""
    if latest is None or latest.age > MESSAGE_TIMEOUT_S:
        return None
    twist = get(latest.message)
    return twist.linear.x, twist.angular.z


def pose_of(message: Any) -> Pose | None:
    """Return the pose of an Odometry message, theta in [-pi, pi]; None if it is not finite."""
    position, q = message.pose.pose.position, message.pose.pose.orientation
    theta = heading_of_quaternion(q.x, q.y, q.z, q.w)
    if not all(map(math.isfinite, (position.x, position.y, theta))):
        return None
    return position.x, position.y, theta


def ellipse_of(covariance: Sequence[Sequence[float]]) -> tuple[float, float, float] | None:
    """
    Return the semi-axes [m] of the 95 % ellipse, longer first, and the longer one's angle [rad].

    Of a covariance of x and y, (2, 2); None if it is not positive semidefinite. By the double
    angle of the principal axes in plain floats, as numpy's eigh costs ten times that.
    """
    (xx, xy), (yx, yy) = covariance
    mean, difference, shared = 0.5 * (xx + yy), 0.5 * (xx - yy), 0.5 * (xy + yx)
    spread = math.hypot(difference, shared)
    if not math.isfinite(mean + spread) or mean - spread < -1e-9 * max(mean + spread, 1e-12):
        return None
    long = AXES_95 * math.sqrt(max(0.0, mean + spread))
    short = AXES_95 * math.sqrt(max(0.0, mean - spread))
    return long, short, 0.5 * math.atan2(shared, difference)
