"""The types of wheel commands: senders, and the subscriptions that receive them."""
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from typing import Any, Protocol

from builtin_interfaces.msg import Time
from rclpy.node import Node
from rclpy.publisher import Publisher
from rclpy.qos import QoSProfile
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64, Float64MultiArray

# Depth 1: an old command must never reach the motors after a newer one.
NEWEST_ONLY = QoSProfile(depth=1)


class Sender(Protocol):
    """Publishes wheel speeds in one message type."""

    @property
    def publishers(self) -> Sequence[Publisher]:
        """Return its publishers."""

    def send(self, left: float, right: float, stamp: Time) -> None:
        """Publish the speed of the left and of the right wheels [rad/s]."""


class JointStateSender:
    """One JointState with the velocity of every wheel."""

    def __init__(self, node: Node, left: Sequence[str], right: Sequence[str]) -> None:
        self.publishers = [node.create_publisher(JointState, 'wheel_commands', NEWEST_ONLY)]
        self._joints = (*left, *right)
        self._message = JointState(name=list(self._joints))

    def send(self, left: float, right: float, stamp: Time) -> None:
        """Publish the speed of the left and of the right wheels [rad/s]."""
        self._message.header.stamp = stamp
        self._message.velocity = of_each(self._joints, left, right)
        self.publishers[0].publish(self._message)


class MultiArraySender:
    """One Float64MultiArray, the left wheels then the right ones."""

    def __init__(self, node: Node, left: Sequence[str], right: Sequence[str]) -> None:
        self.publishers = [node.create_publisher(Float64MultiArray, 'wheel_commands', NEWEST_ONLY)]
        self._message = Float64MultiArray()
        self._joints = (*left, *right)

    def send(self, left: float, right: float, stamp: Time) -> None:
        """Publish the speed of the left and of the right wheels [rad/s]."""
        self._message.data = of_each(self._joints, left, right)
        self.publishers[0].publish(self._message)


class PerWheelSender:
    """A Float64 for each wheel, on a topic named after its joint."""

    def __init__(self, node: Node, left: Sequence[str], right: Sequence[str]) -> None:
        self.publishers = [
            node.create_publisher(Float64, f'{name}/command', NEWEST_ONLY)
            for name in (*left, *right)]
        self._joints = (*left, *right)

    def send(self, left: float, right: float, stamp: Time) -> None:
        """Publish the speed of the left and of the right wheels [rad/s]."""
        speeds = of_each(self._joints, left, right)
        for publisher, speed in zip(self.publishers, speeds, strict=True):
            publisher.publish(Float64(data=speed))


class NoSender:
    """Nothing: for odometry alone."""

    def __init__(self, node: Node, left: Sequence[str], right: Sequence[str]) -> None:
        self.publishers: list[Publisher] = []

    def send(self, left: float, right: float, stamp: Time) -> None:
        """Publish nothing."""


SENDERS: Mapping[str, Callable[[Node, Sequence[str], Sequence[str]], Sender]] = {
    'joint_state': JointStateSender,
    'multi_array': MultiArraySender,
    'per_wheel': PerWheelSender,
    'none': NoSender,
}


def receive(
    node: Node, wheel_command_type: str, names: Sequence[str],
    on_speeds: Callable[[Mapping[str, float]], None],
) -> list[str]:
    """
    Subscribe to wheel commands of a type; return the topics.

    names are the left joints, then the right. on_speeds receives speeds [rad/s] by joint name, of
    some wheels or of all.
    """
    def on_joint_state(message: Any) -> None:
        on_speeds(dict(zip(message.name, message.velocity, strict=False)))

    def on_multi_array(message: Any) -> None:
        on_speeds(dict(zip(names, message.data, strict=False)))

    def on_wheel(name: str, message: Any) -> None:
        on_speeds({name: message.data})

    wanted: dict[str, list[tuple[type, str, Callable[[Any], None]]]] = {
        'joint_state': [(JointState, 'wheel_commands', on_joint_state)],
        'multi_array': [(Float64MultiArray, 'wheel_commands', on_multi_array)],
        'per_wheel': [(Float64, f'{name}/command', partial(on_wheel, name)) for name in names],
        'none': [],
    }
    return [node.create_subscription(kind, topic, callback, NEWEST_ONLY).topic_name
            for kind, topic, callback in wanted[wheel_command_type]]


def of_each(joints: Sequence[str], left: float, right: float) -> list[float]:
    """Return a value per joint, that of its side, left joints first."""
    wheels_a_side = len(joints) // 2
    return [left] * wheels_a_side + [right] * wheels_a_side
