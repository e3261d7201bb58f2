"""What the node odometry says of itself once a second: warnings on change, and /diagnostics."""
from collections import Counter
import time

from diffdrive_ros.core.odometry_config import OdometryConfig
from diffdrive_ros.core.wheel_commander import Inhibit, WheelCommander
from diffdrive_ros.node.diagnostics import DiagnosticsSender, ERROR, OK, Status, WARN
from diffdrive_ros.node.odom_publisher import OdomPublisher
from rclpy.clock import Clock, ClockType
from rclpy.node import Node

LONGEST_SILENCE = 2.0  # [s] without a sample of the wheels until it is said
PARKED = 5.0  # [s] without a command: then it is no news that the wheels are stopped


class Monitor:
    """Looks at the paths of feedback and commands once a second, and reports what it sees."""

    def __init__(
        self, node: Node, config: OdometryConfig, odom: OdomPublisher, command: WheelCommander,
        is_example: bool,
    ) -> None:
        self._node, self._config, self._is_example = node, config, is_example
        self._odom, self._feedback, self._command = odom, odom.feedback, command
        self._looked_at = time.monotonic()
        self._samples_then = self._commands_then = 0
        self._sample_rate = self._command_rate = 0.0
        self._inhibits_then: set[Inhibit] = set()
        self._commanded_at = self._looked_at
        self._counts_then: Counter[str] = Counter()
        self._said: set[str] = set()
        self._sender = DiagnosticsSender(node)
        node.create_timer(1.0, self._look, clock=Clock(clock_type=ClockType.STEADY_TIME))

    def silence(self) -> float:
        """Return how long ago the last sample of the wheels was, or the start [s]."""
        return time.monotonic() - self._odom.sampled_at

    def look_at_inhibits(self) -> None:
        """Report at once when the wheels begin or cease to be held: it may be over in a moment."""
        if self._command.inhibits != self._inhibits_then:
            self._report()

    def _look(self) -> None:
        self._look_at_publishers()
        now = time.monotonic()
        elapsed, self._looked_at = now - self._looked_at, now
        samples, commands = self._feedback.samples, self._command.counts['commands']
        self._sample_rate = (samples - self._samples_then) / elapsed
        self._command_rate = (commands - self._commands_then) / elapsed
        self._samples_then, self._commands_then = samples, commands
        if self._command_rate:
            self._commanded_at = now
        self._report()

    def _report(self) -> None:
        self._inhibits_then = set(self._command.inhibits)
        self._sender.send(
            self._node.get_clock().now().to_msg(), self._feedback_status(),
            self._command_status(), self._geometry_status())

    def _feedback_status(self) -> Status:
        rate = self._sample_rate
        figures = {'rate [Hz]': f'{rate:.1f}', 'age [s]': f'{self.silence():.3f}',
                   'samples': self._feedback.samples, **dict(self._feedback.counts)}
        if self._config.open_loop:
            return Status('feedback', OK, 'open loop: the commands stand in', figures)
        was_heard = self._feedback.samples > 0
        if self.silence() <= LONGEST_SILENCE:
            if not was_heard:
                return Status('feedback', WARN, 'none yet', figures)
            self._said.discard('silence')
            self._odom.heard_in_vain.clear()
            self._counts_then = Counter(self._feedback.counts)
            return Status('feedback', OK, f'{rate:.0f} Hz', figures)
        reason = self._reason_of_silence()
        is_missed = (was_heard or self._odom.heard_in_vain or self._feedback.counts
                     or self._command.started)
        if is_missed and 'silence' not in self._said:
            self._said.add('silence')
            self._node.get_logger().warning(f'joint_states: {reason}')
        return Status('feedback', ERROR if was_heard else WARN, reason, figures)

    def _reason_of_silence(self) -> str:
        counts = self._feedback.counts - self._counts_then
        if not (self._odom.heard_in_vain or counts):
            return f'nothing for {LONGEST_SILENCE:g} s'
        heard, wanted = self._odom.heard_in_vain, self._feedback.waits_for
        reason = f'no usable sample of the wheels for {LONGEST_SILENCE:g} s'
        if not heard.issuperset(wanted):
            reason += f': heard {", ".join(sorted(heard))}; waiting for {", ".join(wanted)}'
        whys = [f'{count} {what}' for what, count in sorted(counts.items())]
        return f'{reason} ({", ".join(whys)})' if whys else reason

    def _command_status(self) -> Status:
        command, rate = self._command, self._command_rate
        figures = {'rate [Hz]': f'{rate:.1f}', 'inhibits': ','.join(sorted(command.inhibits)),
                   **dict(command.counts)}
        if command.complaint:
            is_parked = not command.inhibits and self._looked_at - self._commanded_at > PARKED
            return Status('commands', OK if is_parked else WARN, f'stopped: {command.complaint}',
                          figures)
        return Status(
            'commands', OK, f'{rate:.0f} Hz' if command.started else 'none yet', figures)

    def _geometry_status(self) -> Status:
        drive = self._command.drive
        figures = {'wheel separation [m]': drive.wheel_separation,
                   'left wheel radius [m]': drive.left_wheel_radius,
                   'right wheel radius [m]': drive.right_wheel_radius}
        if self._is_example:
            return Status('geometry', WARN, 'the example robot: none was given', figures)
        return Status('geometry', OK, 'as given', figures)

    def _look_at_publishers(self) -> None:
        """Say once what is wrong with those who publish to this node."""
        wanted = 'TwistStamped' if self._config.enable_stamped_cmd_vel else 'Twist'
        for end in self._node.get_publishers_info_by_topic('cmd_vel'):
            if end.topic_type != f'geometry_msgs/msg/{wanted}':
                self._say_once(
                    f'{end.node_name} publishes cmd_vel as {end.topic_type} and is not heard: '
                    'see enable_stamped_cmd_vel')
        self._look_at_drivers()
        joints = self._node.get_publishers_info_by_topic('joint_states')
        if len(joints) > 1:
            names = ', '.join(sorted(end.node_name for end in joints))
            self._say_once(
                f'{len(joints)} publish joint_states: {names}; no two may have the same wheels')

    def _look_at_drivers(self) -> None:
        """Say once who else commands the wheels, and who listens for another form of commands."""
        kind = {'joint_state': 'sensor_msgs/msg/JointState',
                'multi_array': 'std_msgs/msg/Float64MultiArray'}.get(
                    self._config.wheel_command_type)
        if not kind:
            return
        commanders = self._node.get_publishers_info_by_topic('wheel_commands')
        if len(commanders) > 1:
            names = ', '.join(sorted(end.node_name for end in commanders))
            self._say_once(
                f'{len(commanders)} publish wheel_commands: {names}; the wheels get both')
        for end in self._node.get_subscriptions_info_by_topic('wheel_commands'):
            if end.topic_type != kind:
                self._say_once(
                    f'{end.node_name} listens to wheel_commands as {end.topic_type} and hears '
                    'nothing: see wheel_command_type')

    def _say_once(self, text: str) -> None:
        if text not in self._said:
            self._said.add(text)
            self._node.get_logger().warning(text)
