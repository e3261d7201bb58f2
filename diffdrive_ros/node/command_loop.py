"""From cmd_vel to wheel_commands: the last command, sent at command_rate under its timeout."""
from collections.abc import Callable
import math
import time
from typing import Any

from diffdrive_ros.core.lateness import ALIKE_NS, Lateness
from diffdrive_ros.core.odometry_config import OdometryConfig
from diffdrive_ros.core.wheel_commander import Inhibit, STOP, WheelCommander
from diffdrive_ros.node import rclpy_internals
from diffdrive_ros.node.command_clock import CommandClock
from diffdrive_ros.node.odom_publisher import OdomPublisher
from diffdrive_ros.node.steady_clock import steady_ns
from diffdrive_ros.node.throttled_warning import ThrottledWarning
from diffdrive_ros.node.wheel_commands import NEWEST_ONLY, of_each, SENDERS
from geometry_msgs.msg import Twist, TwistStamped
from rclpy.clock import Clock, ClockType
from rclpy.duration import Duration
from rclpy.node import Node
from rclpy.qos import QoSProfile
from std_srvs.srv import SetBool

ACKNOWLEDGEMENT_S = 0.5  # that a driver may take to acknowledge the last zero


class CommandLoop:
    """
    Receives commands and sends wheel speeds.

    The timer, which is the watchdog, runs on the steady clock from the first command on.
    on_inhibit is called where inhibits may have changed.
    """

    def __init__(
        self, node: Node, config: OdometryConfig, odom: OdomPublisher, commander: WheelCommander,
        on_inhibit: Callable[[], None],
    ) -> None:
        self._node, self._config, self._odom = node, config, odom
        self._commander, self._on_inhibit = commander, on_inhibit
        self._lateness = Lateness(_max_offset_ns(config.cmd_vel_timeout))
        self._clock = CommandClock(node)
        self._sent = STOP
        self._is_commanding = False
        self._has_warned_of_axes = False
        self._ticked_at = math.inf  # on the monotonic clock
        self._overdue_s = 2.0 * commander.period
        self._warning = ThrottledWarning(node.get_logger().warning, '{}; wheels stopped')
        self._sender = SENDERS[config.wheel_command_type](
            node, config.left_wheel_names, config.right_wheel_names)
        self._applied_publisher = None
        if config.publish_limited_velocity:
            self._applied_publisher = node.create_publisher(
                TwistStamped, '~/cmd_vel_out', QoSProfile(depth=10))
            self._applied = TwistStamped()
            self._applied.header.frame_id = config.base_frame
        self._timer = node.create_timer(
            commander.period, self._on_timer, clock=Clock(clock_type=ClockType.STEADY_TIME))
        if not config.open_loop:
            self._timer.cancel()  # until the first command: an idle node costs nothing
        is_stamped = config.enable_stamped_cmd_vel
        self._cmd_vel = node.create_subscription(
            TwistStamped if is_stamped else Twist, 'cmd_vel',
            rclpy_internals.with_source_timestamp(
                self._on_twist_stamped if is_stamped else self._on_twist), NEWEST_ONLY)
        self._enable = node.create_service(SetBool, '~/enable', self._on_enable)

    @property
    def topics(self) -> list[str]:
        """Return the topics of the wheel commands."""
        return [publisher.topic_name for publisher in self._sender.publishers]

    def apply(self, config: OdometryConfig) -> None:
        """Use changed parameters from now on."""
        self._config = config
        self._commander.drive = config.drive
        self._commander.timeout = config.cmd_vel_timeout
        self._commander.max_wheel_speed = config.max_wheel_speed
        self._commander.linear_limits = config.linear_limits
        self._commander.angular_limits = config.angular_limits
        self._lateness.alike_ns = _max_offset_ns(config.cmd_vel_timeout)

    def stop(self) -> None:
        """Send zero to wheels that were ever commanded, and wait for its acknowledgement."""
        if self._is_commanding:
            self._sender.send(0.0, 0.0, self._node.get_clock().now().to_msg())
            deadline = time.monotonic() + ACKNOWLEDGEMENT_S
            for publisher in self._sender.publishers:
                left = max(0.0, deadline - time.monotonic())
                publisher.wait_for_all_acked(Duration(seconds=left))

    def tick_if_overdue(self) -> None:
        """
        Do an overdue timer's work, after a waiting command and ~/enable request.

        To be called between two callbacks: where messages arrive faster than they are processed,
        EventsExecutor's queue delays timers and stops by seconds.
        """
        if time.monotonic() - self._ticked_at > self._overdue_s:
            rclpy_internals.take_message(self._cmd_vel)
            rclpy_internals.take_requests(self._enable)
            self._tick(time.monotonic())

    def _on_timer(self) -> None:
        now = time.monotonic()
        # Not again right after tick_if_overdue.
        if not 0.0 < now - self._ticked_at < 0.25 * self._commander.period:
            self._tick(now)

    def _on_twist_stamped(self, message: Any, sent_ns: int) -> None:
        self._on_twist(message.twist, sent_ns)

    def _on_twist(self, twist: Any, sent_ns: int) -> None:
        linear, angular = twist.linear, twist.angular
        if not self._has_warned_of_axes and (
                linear.y or linear.z or angular.x or angular.y):
            self._has_warned_of_axes = True
            self._node.get_logger().warning(
                f'{self._cmd_vel.topic_name}: more than linear.x and angular.z, which wheels '
                'cannot drive; the rest is ignored')
        late_ns = 0
        if not self._clock.is_simulated:
            late_ns, offset_ns = self._lateness.of(sent_ns, steady_ns(), time.time_ns())
            if offset_ns:
                self._commander.counts['clock_offsets'] += 1
                self._node.get_logger().warning(
                    f'{self._cmd_vel.topic_name}: a sender has a clock offset of '
                    f'{-offset_ns * 1e-9:.1f} s; its commands are driven from now on, '
                    'synchronize the clocks')
        self._follow_clock()
        now_ns = self._clock.now_ns()
        if self._timer.is_canceled():
            self._update_inhibits(now_ns)
        self._commander.accept(linear.x, angular.z, now_ns, late_ns)
        self._start()

    def _on_enable(self, request: Any, response: Any) -> Any:
        self._commander.inhibit(Inhibit.DISABLED, not request.data)
        self._start()
        self._on_inhibit()
        response.success = True
        inhibits = self._commander.stop_reason if self._commander.inhibits else ''
        response.message = (
            f'the wheels are inhibited: {inhibits}' if inhibits else 'the next command is driven')
        return response

    def _start(self) -> None:
        self._is_commanding = True
        if self._timer.is_canceled():
            self._timer.reset()
            self._ticked_at = time.monotonic()

    def _tick(self, now: float) -> None:
        """Send the wheel speeds that are due; in open loop, integrate the last ones before."""
        self._ticked_at = now
        self._follow_clock()
        clock_now, now_ns = self._node.get_clock().now(), self._clock.now_ns()
        stamp, stamp_ns = clock_now.to_msg(), clock_now.nanoseconds
        if self._config.open_loop and self._odom.has_stamp(stamp_ns):
            joints = (*self._config.left_wheel_names, *self._config.right_wheel_names)
            speeds = of_each(joints, self._sent.left, self._sent.right)
            self._odom.take(joints, (), speeds, now_ns, stamp_ns)
        self._update_inhibits(now_ns)
        self._sent = self._commander.step(now_ns)
        if self._is_commanding:
            self._sender.send(self._sent.left, self._sent.right, stamp)
            if self._applied_publisher:
                self._applied.header.stamp = stamp
                self._applied.twist.linear.x = self._sent.linear
                self._applied.twist.angular.z = self._sent.angular
                self._applied_publisher.publish(self._applied)
        self._warning.update(self._commander.stop_reason)
        self._on_inhibit()

    def _follow_clock(self) -> None:
        if self._clock.has_changed():
            self._commander.reset_clock()

    def _update_inhibits(self, now_ns: int) -> None:
        self._commander.inhibit(Inhibit.CLOCK_STALL, self._clock.is_stalled(now_ns))
        self._commander.inhibit(Inhibit.FEEDBACK_TIMEOUT, self._is_feedback_timeout())

    def _is_feedback_timeout(self) -> bool:
        timeout = self._config.feedback_timeout
        return (timeout > 0.0 and not self._config.open_loop
                and time.monotonic() - self._odom.sampled_at > timeout)


def _max_offset_ns(timeout: float) -> int:
    """Return how far clocks may differ, or latency vary, and count as none [ns]."""
    return min(ALIKE_NS, round(0.25e9 * timeout)) if timeout else ALIKE_NS
