"""The demo's driver: publishes cmd_vel, subscribes to odometry and the true pose."""
import time
from typing import Any

from diffdrive_ros.core.quaternion import heading_of_quaternion
from diffdrive_ros.core.validation import Array
from geometry_msgs.msg import Twist
from nav_msgs.msg import Odometry
import numpy as np
from rclpy.node import Node
from sensor_msgs.msg import JointState


class DriverNode(Node):
    """Publishes commands, and records every pose by its timestamp [ns]."""

    def __init__(self) -> None:
        super().__init__('demo')
        self.odometry: dict[int, tuple[float, float, float]] = {}
        self.truth: dict[int, tuple[float, float, float]] = {}
        self.pose = (0.0, 0.0, 0.0)
        self.wheel_speeds = [0.0, 0.0]
        self._received_at = dict.fromkeys(('odom', 'ground_truth'), time.monotonic())
        self._commands = self.create_publisher(Twist, 'cmd_vel', 1)
        self.create_subscription(Odometry, 'odom', self._on_odometry, 50)
        self.create_subscription(Odometry, 'ground_truth', self._on_truth, 50)
        self.create_subscription(JointState, 'joint_states', self._on_joint_states, 50)

    def is_ready(self) -> bool:
        """Return whether the robot subscribes to commands and both poses are received."""
        subscriptions = self._commands.get_subscription_count()
        return bool(subscriptions and self.odometry and self.truth)

    def silent_topic(self, seconds: float) -> str | None:
        """Return a topic without a message for so long, None if there is none."""
        now = time.monotonic()
        return next((
            topic for topic, moment in self._received_at.items() if now - moment > seconds), None)

    def command(self, linear: float, angular: float) -> None:
        """Publish a command [m/s, rad/s]."""
        twist = Twist()
        twist.linear.x, twist.angular.z = linear, angular
        self._commands.publish(twist)

    def clear(self) -> None:
        """Discard the poses until now."""
        self.odometry.clear()
        self.truth.clear()

    def trajectories(self) -> tuple[Array, Array, Array]:
        """Return common times [s], (N,), and the poses of odometry and truth, (N, 3)."""
        stamps = sorted(self.odometry.keys() & self.truth.keys())
        odometry = np.array([self.odometry[stamp] for stamp in stamps])
        truth = np.array([self.truth[stamp] for stamp in stamps])
        for poses in (odometry, truth):
            poses[:, 2] = np.unwrap(poses[:, 2])
        return np.array([(stamp - stamps[0]) * 1e-9 for stamp in stamps]), odometry, truth

    def _on_odometry(self, message: Any) -> None:
        self._received_at['odom'] = time.monotonic()
        self.pose = self.odometry[_stamp_ns(message)] = _pose(message)

    def _on_truth(self, message: Any) -> None:
        self._received_at['ground_truth'] = time.monotonic()
        self.truth[_stamp_ns(message)] = _pose(message)

    def _on_joint_states(self, message: Any) -> None:
        self.wheel_speeds = list(message.velocity)


def _stamp_ns(message: Any) -> int:
    return int(message.header.stamp.sec * 1_000_000_000 + message.header.stamp.nanosec)


def _pose(message: Any) -> tuple[float, float, float]:
    position, q = message.pose.pose.position, message.pose.pose.orientation
    return position.x, position.y, heading_of_quaternion(q.x, q.y, q.z, q.w)
