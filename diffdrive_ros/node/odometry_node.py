"""The node odometry: cmd_vel to wheel commands, joint_states to odom."""
import math
import sys
import time
from typing import Any

from builtin_interfaces.msg import Time
from diffdrive_ros.core.lateness import ALIKE_NS, Lateness
from diffdrive_ros.core.odometry_config import OdometryConfig
from diffdrive_ros.core.parameter_specs import ODOMETRY, RETIRED, Values
from diffdrive_ros.core.wheel_commander import Inhibit, STOP
from diffdrive_ros.node import parameters, rclpy_internals, runner
from diffdrive_ros.node.clock import steady_ns
from diffdrive_ros.node.message_info import with_time_sent
from diffdrive_ros.node.monitor import Monitor
from diffdrive_ros.node.odom_publisher import OdomPublisher
from diffdrive_ros.node.pose_conversion import read_pose
from diffdrive_ros.node.throttled_warning import Complaints
from diffdrive_ros.node.wheel_commands import NEWEST_ONLY, of_each, SENDERS
from geometry_msgs.msg import PoseWithCovarianceStamped, Twist, TwistStamped
from rclpy.clock import Clock, ClockType
from rclpy.duration import Duration
from rclpy.node import Node
from rclpy.qos import QoSProfile, ReliabilityPolicy
from rclpy.qos_overriding_options import QoSOverridingOptions
from sensor_msgs.msg import JointState
from std_srvs.srv import SetBool, Trigger

# Best effort hears every publisher; the depth bridges a pause of this process.
FROM_ANY_DRIVER = QoSProfile(depth=50, reliability=ReliabilityPolicy.BEST_EFFORT)

LONGEST_WITHOUT_CLOCK = 1.0  # [s] until a /clock that stands still is a timeout
LONGEST_LAST_WORD = 0.5  # [s] that the node waits for drivers to acknowledge its last zero


class OdometryNode(Node):
    """
    The shell around the pure core: messages and parameters in, messages out.

    parameter_file tells whether the process was given one: then the geometry has to be in it.
    Raises runner.StartError for parameters that are incomplete or wrong.
    """

    def __init__(self, *, parameter_file: bool = False, **kwargs: Any) -> None:
        super().__init__('odometry', **kwargs)
        try:
            values = parameters.declare(self, ODOMETRY)
            is_example = parameters.is_example_robot(self, parameter_file)
            config = self._config = self._config_of(values)
        except ValueError as error:
            raise runner.StartError(
                f'{self.get_fully_qualified_name()} cannot start: {error}') from None
        self._odom = OdomPublisher(self, config)
        self._command = config.wheel_commander()
        parameters.follow_changes(self, ODOMETRY, self._config_of, self._apply)
        self._lateness = Lateness(_alike_ns(config.cmd_vel_timeout))
        self._sent = STOP
        self._is_commanding = False
        self._other_axes_said = False
        self._limits_said: set[str] = set()
        self._command_complaints = Complaints(
            self.get_logger().warning, '{}; wheels stopped')
        self._was_simulated = self._is_simulated
        self._clock_ns, self._clock_moved_at = -1, time.monotonic()
        self._ticked_at = math.inf  # on the monotonic clock
        self._overdue = 2.0 * self._command.period
        self._create_publishers(config)
        self._create_subscriptions(config)
        self._create_services()
        self._monitor = Monitor(self, config, self._odom, self._command, is_example)
        self._say_what_runs(config, is_example)

    def stop_wheels(self) -> None:
        """Send zero to the wheels, if they were ever commanded, and wait until it was heard."""
        if self._is_commanding:
            self._sender.send(0.0, 0.0, self._now())
            deadline = time.monotonic() + LONGEST_LAST_WORD
            for publisher in self._sender.publishers:
                left = max(0.0, deadline - time.monotonic())
                publisher.wait_for_all_acked(Duration(seconds=left))

    def _create_publishers(self, config: OdometryConfig) -> None:
        self._sender = SENDERS[config.wheel_command_type](
            self, config.left_wheel_names, config.right_wheel_names)
        self._applied_publisher = None
        if config.publish_limited_velocity:
            self._applied_publisher = self.create_publisher(
                TwistStamped, '~/cmd_vel_out', QoSProfile(depth=10))
            self._applied_message = TwistStamped()
            self._applied_message.header.frame_id = config.base_frame

    def _create_subscriptions(self, config: OdometryConfig) -> None:
        self._timer = self.create_timer(
            1.0 / config.command_rate, self._on_timer,
            clock=Clock(clock_type=ClockType.STEADY_TIME))
        if config.enable_stamped_cmd_vel:
            self._cmd_vel = self.create_subscription(
                TwistStamped, 'cmd_vel', with_time_sent(self._on_twist_stamped), NEWEST_ONLY)
        else:
            self._cmd_vel = self.create_subscription(
                Twist, 'cmd_vel', with_time_sent(self._on_twist), NEWEST_ONLY)
        if not config.open_loop:
            self._timer.cancel()  # until the first command: an idle node costs nothing
            self.create_subscription(
                JointState, 'joint_states', self._odom.on_joint_states, FROM_ANY_DRIVER,
                raw=True,
                qos_overriding_options=QoSOverridingOptions.with_default_policies())
        self.create_subscription(
            PoseWithCovarianceStamped, '~/set_pose', self._on_set_pose, QoSProfile(depth=10))

    def _create_services(self) -> None:
        self.create_service(Trigger, '~/reset_odometry', self._on_reset)
        self._enable = self.create_service(SetBool, '~/enable', self._on_enable)

    def _say_what_runs(self, config: OdometryConfig, is_example: bool) -> None:
        parameters.say_unknown_names(self, ODOMETRY, RETIRED)
        drive = config.drive
        robot = (f'wheel_separation {drive.wheel_separation:g} m, wheel radii '
                 f'{drive.left_wheel_radius:g} and {drive.right_wheel_radius:g} m')
        if is_example:
            self.get_logger().warning(
                f'no geometry was given: this is the example robot, {robot}; set '
                'wheel_separation and wheel_radius for yours')
        else:
            self.get_logger().info(robot)
        fastest = ('any speed' if config.max_wheel_speed is None
                   else f'at most {config.max_wheel_speed:g} rad/s')
        self.get_logger().info(
            f'{"TwistStamped" if config.enable_stamped_cmd_vel else "Twist"} on cmd_vel drives '
            f'{", ".join(config.left_wheel_names)} | {", ".join(config.right_wheel_names)} by '
            f'{config.wheel_command_type}, {fastest}'
            + (f'; wheels stop after {config.cmd_vel_timeout:g} s of silence'
               if config.cmd_vel_timeout else ''))
        self._warn_of_no_timeout(config)
        self._warn_of_limits(config)

    def _warn_of_limits(self, config: OdometryConfig) -> None:
        """Say what is new of limits that may not be what was meant."""
        said, self._limits_said = self._limits_said, set()
        for axis, limits in (
                ('linear.x', config.linear_limits), ('angular.z', config.angular_limits)):
            if limits.without_effect:
                self._limits_said.add(
                    f'{axis}: without effect, for their maximum is not set: '
                    f'{", ".join(limits.without_effect)}')
            if limits.max_acceleration == 0.0:
                self._limits_said.add(f'{axis}.max_acceleration = 0.0: the robot never starts')
        for text in sorted(self._limits_said - said):
            self.get_logger().warning(text)

    def _warn_of_no_timeout(self, config: OdometryConfig) -> None:
        if not config.cmd_vel_timeout:
            self.get_logger().warning(
                'cmd_vel_timeout = 0.0: when commands stop coming, the wheels keep turning')

    def _config_of(self, values: Values) -> OdometryConfig:
        return OdometryConfig.of(values, self.get_namespace())

    def _apply(self, config: OdometryConfig) -> None:
        if config.cmd_vel_timeout != self._config.cmd_vel_timeout:
            self._warn_of_no_timeout(config)
        self._warn_of_limits(config)
        self._config = config
        self._odom.odometry.drive = self._command.drive = config.drive
        self._command.timeout = config.cmd_vel_timeout
        self._lateness.alike_ns = _alike_ns(config.cmd_vel_timeout)
        self._command.max_wheel_speed = config.max_wheel_speed
        self._command.linear_limits = config.linear_limits
        self._command.angular_limits = config.angular_limits

    def _on_twist_stamped(self, message: Any, sent_ns: int) -> None:
        self._on_twist(message.twist, sent_ns)

    def _on_twist(self, twist: Any, sent_ns: int) -> None:
        linear, angular = twist.linear, twist.angular
        if not self._other_axes_said and (
                linear.y or linear.z or angular.x or angular.y):
            self._other_axes_said = True
            self.get_logger().warning(
                'cmd_vel asks for more than linear.x and angular.z: no wheel can do that, it is '
                'ignored')
        late_ns = 0
        if not self._is_simulated:
            late_ns, believed_ns = self._lateness.of(sent_ns, steady_ns(), time.time_ns())
            if believed_ns:
                self._command.counts['clock_offsets'] += 1
                self.get_logger().warning(
                    f'cmd_vel goes on to come {abs(believed_ns) * 1e-9:.1f} s '
                    f'{"late" if believed_ns > 0 else "early"}: taken for that of another clock')
        self._follow_the_clock()
        now_ns = self._command_ns()
        if self._timer.is_canceled():
            self._inhibit_where_due(now_ns)
        self._command.accept(linear.x, angular.z, now_ns, late_ns)
        self._start_commanding()

    def _start_commanding(self) -> None:
        self._is_commanding = True
        if self._timer.is_canceled():
            self._timer.reset()
            self._ticked_at = time.monotonic()

    def keep_time(self) -> None:
        """
        Do the timer's work if it is overdue, after taking what asks for a stop.

        To be called between two callbacks.
        """
        if time.monotonic() - self._ticked_at > self._overdue:
            rclpy_internals.take_message(self._cmd_vel)
            rclpy_internals.take_requests(self._enable)
            self._tick(time.monotonic())

    def _on_timer(self) -> None:
        now = time.monotonic()
        if not 0.0 < now - self._ticked_at < 0.25 * self._command.period:  # see keep_time
            self._tick(now)

    def _command_ns(self) -> int:
        """Return the time in which commands age [ns]: simulation time, or a steady clock's."""
        if self._is_simulated:
            return int(self.get_clock().now().nanoseconds)
        return steady_ns()

    def _follow_the_clock(self) -> None:
        if self._is_simulated != self._was_simulated:
            self._was_simulated = self._is_simulated
            self._command.forget_time()

    @property
    def _is_simulated(self) -> bool:
        return bool(self.get_parameter('use_sim_time').value)

    def _tick(self, now: float) -> None:
        """Send the wheels what holds now; without encoders, take it for what they did."""
        self._ticked_at = now
        self._follow_the_clock()
        clock_now, now_ns = self.get_clock().now(), self._command_ns()
        stamp, stamp_ns = clock_now.to_msg(), clock_now.nanoseconds
        if self._config.open_loop and self._odom.has_stamp(stamp_ns):
            joints = (*self._config.left_wheel_names, *self._config.right_wheel_names)
            speeds = of_each(joints, self._sent.left, self._sent.right)
            self._odom.take(joints, (), speeds, now_ns, stamp_ns)
        self._inhibit_where_due(now_ns)
        self._sent = self._command.step(now_ns)
        if self._is_commanding:
            self._sender.send(self._sent.left, self._sent.right, stamp)
            if self._applied_publisher:
                self._applied_message.header.stamp = stamp
                self._applied_message.twist.linear.x = self._sent.linear
                self._applied_message.twist.angular.z = self._sent.angular
                self._applied_publisher.publish(self._applied_message)
        self._command_complaints.look(self._command.complaint)
        self._monitor.look_at_inhibits()

    def _inhibit_where_due(self, now_ns: int) -> None:
        self._command.inhibit(Inhibit.CLOCK_STALL, self._clock_stands_still(now_ns))
        self._command.inhibit(Inhibit.FEEDBACK_TIMEOUT, self._feedback_is_lost())

    def _clock_stands_still(self, now_ns: int) -> bool:
        """Return whether simulation time has not moved for long, on the steady clock."""
        if not self._is_simulated:
            return False
        if now_ns != self._clock_ns:
            self._clock_ns, self._clock_moved_at = now_ns, time.monotonic()
        return not now_ns or time.monotonic() - self._clock_moved_at > LONGEST_WITHOUT_CLOCK

    def _feedback_is_lost(self) -> bool:
        longest = self._config.feedback_timeout
        return bool(longest) and not self._config.open_loop and self._monitor.silence() > longest

    def _on_set_pose(self, message: PoseWithCovarianceStamped) -> None:
        try:
            if message.header.frame_id != self._config.odom_frame:
                raise ValueError(
                    f'frame_id = {message.header.frame_id!r}: must be '
                    f'{self._config.odom_frame!r}')
            self._odom.odometry.reset(*read_pose(message))
        except ValueError as error:
            self.get_logger().warning(
                f'set_pose was refused: {error}', throttle_duration_sec=1.0)
        else:
            x, y, theta = self._odom.odometry.pose
            self.get_logger().info(
                f'pose set to {x:g} m, {y:g} m, {theta:g} rad', throttle_duration_sec=1.0)

    def _on_reset(self, request: Any, response: Any) -> Any:
        self._odom.odometry.reset()
        response.success, response.message = True, 'the pose is zero'
        return response

    def _on_enable(self, request: Any, response: Any) -> Any:
        self._command.inhibit(Inhibit.DISABLED, not request.data)
        self._start_commanding()
        self._monitor.look_at_inhibits()
        response.success = True
        held = self._command.complaint if self._command.inhibits else ''
        response.message = f'the wheels are held: {held}' if held else 'the next command is driven'
        return response

    def _now(self) -> Time:
        return self.get_clock().now().to_msg()


def _alike_ns(timeout: float) -> int:
    """Return by how much commands may come late, or clocks be wrong, as if they were not [ns]."""
    return min(ALIKE_NS, round(0.25e9 * timeout)) if timeout else ALIKE_NS


def main() -> None:
    """Run the node as a process."""
    sys.exit(runner.run(
        'odometry', __doc__,
        lambda: OdometryNode(parameter_file=runner.has_parameter_file()),
        OdometryNode.stop_wheels, keep_time=OdometryNode.keep_time))


if __name__ == '__main__':
    main()
