"""The node odometry: cmd_vel to wheel commands, joint_states to odom."""
from collections.abc import Sequence
import math
import sys
import time
from typing import Any

from builtin_interfaces.msg import Time
from diffdrive_ros import parameters, spinning
from diffdrive_ros.command import CommandPath, STOP
from diffdrive_ros.feedback import WheelFeedback
from diffdrive_ros.odometry import Odometry
from diffdrive_ros.parameters import Config
from diffdrive_ros.se2 import wrap_angle
from diffdrive_ros.wheel_commands import NEWEST_ONLY, of_each, SENDERS
from geometry_msgs.msg import Twist, TwistStamped
from nav_msgs.msg import Odometry as OdometryMessage
from rclpy.clock import Clock, ClockType
from rclpy.duration import Duration
from rclpy.node import Node
from rclpy.qos import QoSProfile, ReliabilityPolicy
from rclpy.qos_overriding_options import QoSOverridingOptions
from sensor_msgs.msg import JointState

SPECS = parameters.GEOMETRY + parameters.ODOMETRY

# Best effort hears every publisher; the depth bridges a pause of this process.
FROM_ANY_DRIVER = QoSProfile(depth=50, reliability=ReliabilityPolicy.BEST_EFFORT)

# The variance of what wheels do not measure: large, yet such that filters can still invert it.
UNKNOWN = 1e6

# Where x, y and yaw stand in the six rows and columns of a message's covariance.
PLANAR = (0, 1, 5)
NOT_PLANAR = (2, 3, 4)


class OdometryNode(Node):
    """
    The shell around the pure core: messages and parameters in, messages out.

    parameter_file tells whether the process was given one: then the geometry has to be in it.
    Raises spinning.StartError for parameters that are incomplete or wrong.
    """

    def __init__(self, *, parameter_file: bool = False, **kwargs: Any) -> None:
        super().__init__('odometry', **kwargs)
        try:
            values = parameters.declare(self, SPECS)
            is_example = parameters.is_example_robot(self, parameter_file)
            config = Config.of(values)
        except ValueError as error:
            raise spinning.StartError(
                f'{self.get_fully_qualified_name()} cannot start: {error}') from None
        self._config = config
        self._feedback = WheelFeedback(
            config.left_wheel_names, config.right_wheel_names,
            config.position_feedback and not config.open_loop)
        self._odometry = Odometry(
            config.drive, window=config.velocity_rolling_window_size, noise=config.noise)
        self._command = CommandPath(
            config.drive, config.cmd_vel_timeout, config.max_wheel_speed)
        parameters.follow_changes(self, SPECS, Config.of, self._apply)
        self._sent = STOP
        self._command_complaint = self._feedback_complaint = ''
        self._message = _message(config)
        self._create_interfaces(config)
        self._say_what_runs(config, is_example)

    def stop_wheels(self) -> None:
        """Send zero to the wheels, if they were ever commanded, and wait until it was heard."""
        if self._command.started:
            self._sender.send(0.0, 0.0, self._now())
            for publisher in self._sender.publishers:
                publisher.wait_for_all_acked(Duration(seconds=0.5))

    def _create_interfaces(self, config: Config) -> None:
        overrides = QoSOverridingOptions.with_default_policies()
        self._publisher = self.create_publisher(
            OdometryMessage, 'odom', QoSProfile(depth=10), qos_overriding_options=overrides)
        self._sender = SENDERS[config.command_interface](
            self, config.left_wheel_names, config.right_wheel_names)
        self._timer = self.create_timer(
            1.0 / config.command_rate, self._on_timer,
            clock=Clock(clock_type=ClockType.STEADY_TIME))
        if config.enable_stamped_cmd_vel:
            self.create_subscription(
                TwistStamped, 'cmd_vel', self._on_twist_stamped, NEWEST_ONLY)
        else:
            self.create_subscription(Twist, 'cmd_vel', self._on_twist, NEWEST_ONLY)
        if not config.open_loop:
            self._timer.cancel()  # until the first command
            self.create_subscription(
                JointState, 'joint_states', self._on_joint_states, FROM_ANY_DRIVER,
                qos_overriding_options=overrides)

    def _say_what_runs(self, config: Config, is_example: bool) -> None:
        drive = config.drive
        robot = (f'wheel_separation {drive.wheel_separation:g} m, wheel radii '
                 f'{drive.left_wheel_radius:g} and {drive.right_wheel_radius:g} m')
        if is_example:
            self.get_logger().warning(
                f'no geometry was given: this is the example robot, {robot}; set '
                'wheel_separation and wheel_radius for yours')
        else:
            self.get_logger().info(robot)
        if not config.cmd_vel_timeout:
            self.get_logger().warning(
                'cmd_vel_timeout = 0.0: when commands stop coming, the wheels turn on')

    def _apply(self, config: Config) -> None:
        self._odometry.drive = self._command.drive = config.drive
        self._command.timeout = config.cmd_vel_timeout
        self._command.max_wheel_speed = config.max_wheel_speed

    def _on_twist_stamped(self, message: Any) -> None:
        self._on_twist(message.twist)

    def _on_twist(self, twist: Any) -> None:
        self._command.accept(twist.linear.x, twist.angular.z, time.monotonic_ns())
        if self._timer.is_canceled():
            self._timer.reset()

    def _on_timer(self) -> None:
        """Send the wheels what holds now; without encoders, take it for what they did."""
        stamp = self._now()
        if self._config.open_loop:
            joints = (*self._config.left_wheel_names, *self._config.right_wheel_names)
            speeds = of_each(joints, self._sent.left, self._sent.right)
            self._on_wheels(joints, (), speeds, stamp)
        self._sent = self._command.step(time.monotonic_ns())
        if self._command.started:
            self._sender.send(self._sent.left, self._sent.right, stamp)
        if self._command.complaint != self._command_complaint:
            self._command_complaint = self._command.complaint
            if self._command_complaint:
                self.get_logger().warning(
                    f'{self._command_complaint}; wheels stopped', throttle_duration_sec=1.0)

    def _on_joint_states(self, joints: JointState) -> None:
        stamp = joints.header.stamp
        if not (stamp.sec or stamp.nanosec):
            self.get_logger().warning(
                'joint_states come without a stamp: the time of receipt stands in', once=True)
            stamp = self._now()
        self._on_wheels(joints.name, joints.position, joints.velocity, stamp)

    def _on_wheels(
        self, names: Sequence[str], positions: Sequence[float], velocities: Sequence[float],
        stamp: Time,
    ) -> None:
        sample = self._feedback.update(
            names, positions, velocities, stamp.sec * 1_000_000_000 + stamp.nanosec)
        if self._feedback.complaint != self._feedback_complaint:
            self._feedback_complaint = self._feedback.complaint
            if self._feedback_complaint:
                self.get_logger().warning(
                    f'joint_states: {self._feedback_complaint}', throttle_duration_sec=1.0)
        if sample and self._odometry.update(sample.left, sample.right, sample.stamp_ns):
            self._publish_odometry(stamp)

    def _publish_odometry(self, stamp: Time) -> None:
        message, odometry = self._message, self._odometry
        x, y, theta = odometry.pose.tolist()
        half = 0.5 * float(wrap_angle(theta))
        message.header.stamp = stamp
        message.pose.pose.position.x = x
        message.pose.pose.position.y = y
        message.pose.pose.orientation.z = math.sin(half)
        message.pose.pose.orientation.w = math.cos(half)
        message.twist.twist.linear.x, _, message.twist.twist.angular.z = odometry.twist.tolist()
        _fill_covariance(message.pose.covariance, odometry.pose_covariance.tolist())
        _fill_covariance(message.twist.covariance, odometry.twist_covariance.tolist())
        self._publisher.publish(message)

    def _now(self) -> Time:
        return self.get_clock().now().to_msg()


def _message(config: Config) -> OdometryMessage:
    """Return the message with all in it that stays."""
    message = OdometryMessage()
    message.header.frame_id = config.odom_frame_id
    message.child_frame_id = config.base_frame_id
    for covariance in (message.pose.covariance, message.twist.covariance):
        for axis in NOT_PLANAR:
            covariance[7 * axis] = UNKNOWN
    return message


def _fill_covariance(covariance: Any, planar: list[list[float]]) -> None:
    for row, values in zip(PLANAR, planar, strict=True):
        for column, value in zip(PLANAR, values, strict=True):
            covariance[6 * row + column] = min(value, UNKNOWN)


def main() -> None:
    """Run the node as a process."""
    sys.exit(spinning.run(
        'odometry', __doc__,
        lambda: OdometryNode(parameter_file=spinning.has_parameter_file()),
        OdometryNode.stop_wheels))


if __name__ == '__main__':
    main()
