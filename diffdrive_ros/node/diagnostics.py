"""/diagnostics of the node odometry, and warnings: once a second, and when an inhibit changes."""
from collections import Counter
from collections.abc import Iterable, Mapping
import time
from typing import Any, NamedTuple

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from diffdrive_ros.core.odometry_config import OdometryConfig
from diffdrive_ros.core.wheel_commander import Inhibit, WheelCommander
from diffdrive_ros.node.odom_publisher import OdomPublisher
from rclpy.clock import Clock, ClockType
from rclpy.node import Node
from rclpy.qos import QoSProfile

OK, WARN, ERROR = DiagnosticStatus.OK, DiagnosticStatus.WARN, DiagnosticStatus.ERROR

FEEDBACK_WARNING_S = 2.0  # without a sample of the wheels until a warning
PARKED_S = 5.0  # without a command until stopped wheels are no warning


class Status(NamedTuple):
    """One status: level and message for people, values by fixed keys for programs."""

    name: str
    level: Any
    message: str
    values: Mapping[str, object]


class Diagnostics:
    """Observes feedback and commands once a second, and reports them."""

    def __init__(
        self, node: Node, config: OdometryConfig, odom: OdomPublisher, commander: WheelCommander,
        is_example: bool,
    ) -> None:
        self._node, self._config, self._is_example = node, config, is_example
        self._odom, self._feedback, self._commander = odom, odom.feedback, commander
        self._name = node.get_fully_qualified_name()
        self._updated_at = self._commanded_at = time.monotonic()
        self._last_samples = self._last_commands = 0
        self._sample_rate = self._command_rate = 0.0
        self._reported_inhibits: set[Inhibit] = set()
        self._last_counts: Counter[str] = Counter()
        self._logged_faults: set[bool] = set()  # of feedback; True is that of no message
        self._logged: set[str] = set()
        self._publisher = node.create_publisher(
            DiagnosticArray, '/diagnostics', QoSProfile(depth=10))
        node.create_timer(1.0, self._on_timer, clock=Clock(clock_type=ClockType.STEADY_TIME))

    def report_inhibits(self) -> None:
        """Report at once if inhibits have changed, for the change may be over in a moment."""
        if self._commander.inhibits != self._reported_inhibits:
            self._report()

    def _on_timer(self) -> None:
        self._check_publishers()
        self._check_drivers()
        now = time.monotonic()
        elapsed, self._updated_at = now - self._updated_at, now
        samples, commands = self._feedback.samples, self._commander.counts['commands']
        self._sample_rate = (samples - self._last_samples) / elapsed
        self._command_rate = (commands - self._last_commands) / elapsed
        self._last_samples, self._last_commands = samples, commands
        if self._command_rate:
            self._commanded_at = now
        self._report()

    def _report(self) -> None:
        self._reported_inhibits = set(self._commander.inhibits)
        message = DiagnosticArray(status=[
            DiagnosticStatus(
                name=f'{self._name}: {status.name}', hardware_id=self._name, level=status.level,
                message=status.message, values=[
                    KeyValue(key=key, value=str(value)) for key, value in status.values.items()])
            for status in (
                self._feedback_status(), self._command_status(), self._geometry_status())])
        message.header.stamp = self._node.get_clock().now().to_msg()
        self._publisher.publish(message)

    def _feedback_status(self) -> Status:
        age = time.monotonic() - self._odom.sampled_at
        values = {'rate [Hz]': f'{self._sample_rate:.1f}', 'age [s]': f'{age:.3f}',
                  'samples': self._feedback.samples, **self._feedback.counts}
        if self._config.open_loop:
            return Status('feedback', OK, 'open loop: commands as applied', values)
        has_samples = self._feedback.samples > 0
        if age <= FEEDBACK_WARNING_S:
            if not has_samples:
                return Status('feedback', WARN, 'no sample yet', values)
            self._logged_faults.clear()
            self._odom.unused_names.clear()
            self._last_counts = Counter(self._feedback.counts)
            return Status('feedback', OK, f'{self._sample_rate:.0f} Hz', values)
        is_silent = not self._odom.unused_names and not self._feedback.counts - self._last_counts
        reason = self._reason_of_no_sample()
        if is_silent not in self._logged_faults:  # a driver may start later, with wrong names
            self._logged_faults.add(is_silent)
            self._node.get_logger().warning(f'{self._odom.joint_states_topic}: {reason}')
        return Status('feedback', ERROR if has_samples else WARN, reason, values)

    def _reason_of_no_sample(self) -> str:
        counts = self._feedback.counts - self._last_counts
        received, missing = self._odom.unused_names, self._feedback.missing_wheels
        publishers = _names(
            self._node.get_publishers_info_by_topic('joint_states')) or 'no node'
        if not received and not counts:
            return (f'no message for {FEEDBACK_WARNING_S:g} s, so no {self._odom.odom_topic}; '
                    f'published by {publishers}')
        reason = f'no usable sample for {FEEDBACK_WARNING_S:g} s'
        if not received.issuperset(missing):
            reason += (f': received {", ".join(sorted(received))}; waiting for '
                       f'{", ".join(missing)}')
        if counts:
            reason += f' ({", ".join(f"{counts[key]} {key}" for key in sorted(counts))})'
        return f'{reason}; published by {publishers}'

    def _command_status(self) -> Status:
        commander, rate = self._commander, self._command_rate
        values = {'rate [Hz]': f'{rate:.1f}', 'inhibits': ','.join(sorted(commander.inhibits)),
                  **commander.counts}
        if commander.stop_reason:
            is_parked = (not commander.inhibits
                         and self._updated_at - self._commanded_at > PARKED_S)
            return Status('commands', OK if is_parked else WARN,
                          f'stopped: {commander.stop_reason}', values)
        return Status(
            'commands', OK, f'{rate:.0f} Hz' if commander.started else 'no command yet', values)

    def _geometry_status(self) -> Status:
        drive = self._commander.drive
        values = {'wheel_separation [m]': drive.wheel_separation,
                  'left_wheel_radius [m]': drive.left_wheel_radius,
                  'right_wheel_radius [m]': drive.right_wheel_radius}
        if self._is_example:
            return Status('geometry', WARN, 'the example robot: no geometry is given', values)
        return Status('geometry', OK, 'as given', values)

    def _check_publishers(self) -> None:
        """Warn once of publishers that do not match this node's subscriptions."""
        cmd_vel = self._node.resolve_topic_name('cmd_vel')
        kind = 'TwistStamped' if self._config.enable_stamped_cmd_vel else 'Twist'
        for end in self._node.get_publishers_info_by_topic('cmd_vel'):
            if end.topic_type != f'geometry_msgs/msg/{kind}':
                self._warn_once(
                    f'{cmd_vel}: {end.node_name} publishes {end.topic_type}, which is not '
                    'received; set enable_stamped_cmd_vel')
        joint_states = self._odom.joint_states_topic
        publishers = self._node.get_publishers_info_by_topic('joint_states')
        if len(publishers) > 1:
            self._warn_once(
                f'{joint_states}: {len(publishers)} publishers, {_names(publishers)}; no two may '
                'have the same wheels')

    def _check_drivers(self) -> None:
        """Warn once of other publishers of wheel_commands, and of subscribers of another type."""
        kind = {'joint_state': 'sensor_msgs/msg/JointState',
                'multi_array': 'std_msgs/msg/Float64MultiArray'}.get(
                    self._config.wheel_command_type)
        if not kind:
            return
        topic = self._node.resolve_topic_name('wheel_commands')
        publishers = self._node.get_publishers_info_by_topic('wheel_commands')
        if len(publishers) > 1:
            self._warn_once(f'{topic}: {len(publishers)} publishers, {_names(publishers)}; the '
                            'wheels receive commands from all of them')
        for end in self._node.get_subscriptions_info_by_topic('wheel_commands'):
            if end.topic_type != kind:
                self._warn_once(
                    f'{topic}: {end.node_name} subscribes to {end.topic_type} and receives '
                    'nothing; set wheel_command_type')

    def _warn_once(self, text: str) -> None:
        if text not in self._logged:
            self._logged.add(text)
            self._node.get_logger().warning(text)


def _names(ends: Iterable[Any]) -> str:
    return ', '.join(sorted(end.node_name for end in ends))
