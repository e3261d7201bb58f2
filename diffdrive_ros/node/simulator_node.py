"""The node simulator: a simulated robot behind the topics of a motor driver."""
from collections.abc import Mapping, Sequence
import math
import sys
import time
from typing import Any

from builtin_interfaces.msg import Time
from diffdrive_ros.core.odometry_config import diff_drive, wheel_names
from diffdrive_ros.core.parameter_specs import SIMULATOR
from diffdrive_ros.core.quaternion import quaternion_of_heading
from diffdrive_ros.core.simulation import RobotModel, SimulatedRobot
from diffdrive_ros.node import parameters, runner, wheel_commands
from diffdrive_ros.node.rclpy_internals import parameter_overrides
from nav_msgs.msg import Odometry as OdometryMessage
from rclpy.clock import Clock, ClockType
from rclpy.node import Node
from rclpy.qos import QoSProfile
from sensor_msgs.msg import JointState


class SimulatorNode(Node):
    """
    A motor driver's topics around a SimulatedRobot, which runs on the steady clock.

    Raises runner.StartError for wrong parameters.
    """

    def __init__(self, **kwargs: Any) -> None:
        super().__init__('simulator', **kwargs)
        try:
            overrides = parameter_overrides(self, 'simulator', **kwargs)
            values = parameters.declare(self, SIMULATOR, overrides)
            parameters.is_example_robot(self, overrides, has_parameter_file=False)
            self._left_names, self._right_names = wheel_names(values)
            drive = diff_drive(values)
            model = RobotModel(
                drive.wheel_separation, drive.left_wheel_radius, drive.right_wheel_radius,
                **{name: values[name] for name in (
                    'motor_time_constant', 'ticks_per_revolution', 'slip', 'travel_noise')})
        except ValueError as error:
            raise runner.StartError(
                f'{self.get_fully_qualified_name()} cannot start: {error}') from None
        self._robot = SimulatedRobot(model, seed=values['seed'])
        self._timeout = values['command_timeout']
        self._targets = dict.fromkeys((*self._left_names, *self._right_names), 0.0)
        self._swap_wheels = values['swap_wheels']
        self._simulated_ns = self._published_ns = time.monotonic_ns()
        self._published_encoders = self._robot.encoders
        self._joints = JointState(name=list(self._targets))
        self._truth = OdometryMessage()
        self._truth.header.frame_id = values['odom_frame_id']
        self._truth.child_frame_id = values['base_frame_id']
        topics = wheel_commands.receive(
            self, values['wheel_command_type'], list(self._targets), self._on_speeds)
        self._joints_publisher = self.create_publisher(
            JointState, 'joint_states', QoSProfile(depth=50))
        self._truth_publisher = self.create_publisher(
            OdometryMessage, 'ground_truth', QoSProfile(depth=10))
        parameters.follow_changes(self, SIMULATOR, dict, self._apply)
        parameters.log_unknown_names(self, overrides, SIMULATOR)
        self.get_logger().info(
            f'wheel_separation {model.wheel_separation:g} m, wheel radii '
            f'{model.left_wheel_radius:g} and {model.right_wheel_radius:g} m; subscribes to '
            f'{", ".join(topics)} ({values["wheel_command_type"]})')
        self.create_timer(
            1.0 / values['publish_rate'], self._on_timer,
            clock=Clock(clock_type=ClockType.STEADY_TIME))

    def _apply(self, values: dict[str, Any]) -> None:
        self._swap_wheels = values['swap_wheels']

    def _on_speeds(self, speeds: Mapping[str, float]) -> None:
        ours = {name: speed for name, speed in speeds.items() if name in self._targets}
        for name, speed in ours.items():
            if not math.isfinite(speed):
                self.get_logger().warning(
                    f'{name} = {speed}: must be finite; wheel stopped', throttle_duration_sec=1.0)
                ours[name] = 0.0
        if ours:
            self._advance()
            self._targets.update(ours)
            sides = self._mean(self._left_names), self._mean(self._right_names)
            left, right = reversed(sides) if self._swap_wheels else sides
            self._robot.command(left, right, self._timeout)

    def _mean(self, names: Sequence[str]) -> float:
        return sum(self._targets[name] for name in names) / len(names)

    def _advance(self) -> None:
        """Simulate the robot up to now."""
        now_ns = time.monotonic_ns()
        self._robot.advance((now_ns - self._simulated_ns) * 1e-9)
        self._simulated_ns = now_ns

    def _on_timer(self) -> None:
        self._advance()
        stamp = self.get_clock().now().to_msg()
        self._publish_joints(stamp)
        self._publish_truth(stamp)

    def _publish_joints(self, stamp: Time) -> None:
        encoders = self._robot.encoders
        seconds = (self._simulated_ns - self._published_ns) * 1e-9
        velocities = (encoders - self._published_encoders) / seconds
        self._published_ns, self._published_encoders = self._simulated_ns, encoders
        if self._swap_wheels:
            encoders, velocities = encoders[::-1], velocities[::-1]
        joints = tuple(self._targets)
        self._joints.header.stamp = stamp
        self._joints.position = wheel_commands.of_each(joints, *encoders.tolist())
        self._joints.velocity = wheel_commands.of_each(joints, *velocities.tolist())
        self._joints_publisher.publish(self._joints)

    def _publish_truth(self, stamp: Time) -> None:
        x, y, theta = self._robot.pose.tolist()
        linear, _, angular = self._robot.twist.tolist()
        pose, twist = self._truth.pose.pose, self._truth.twist.twist
        self._truth.header.stamp = stamp
        pose.position.x, pose.position.y = x, y
        pose.orientation.z, pose.orientation.w = quaternion_of_heading(theta)
        twist.linear.x, twist.angular.z = linear, angular
        self._truth_publisher.publish(self._truth)


def main() -> None:
    """Run the node as a process."""
    sys.exit(runner.run('simulator', __doc__, SimulatorNode))


if __name__ == '__main__':
    main()
