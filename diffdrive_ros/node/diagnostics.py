"""/diagnostics: what the node does, how fast, and what it had to leave out, once a second."""
from collections.abc import Mapping
from typing import Any, NamedTuple

from builtin_interfaces.msg import Time
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from rclpy.node import Node
from rclpy.qos import QoSProfile

OK, WARN, ERROR = DiagnosticStatus.OK, DiagnosticStatus.WARN, DiagnosticStatus.ERROR


class Status(NamedTuple):
    """One line of rqt_robot_monitor, with the figures under it."""

    name: str
    level: Any
    message: str
    figures: Mapping[str, object]


class DiagnosticsSender:
    """Publishes the statuses of a node, named after it in full."""

    def __init__(self, node: Node) -> None:
        self._name = node.get_fully_qualified_name()
        self._publisher = node.create_publisher(
            DiagnosticArray, '/diagnostics', QoSProfile(depth=10))

    def send(self, stamp: Time, *statuses: Status) -> None:
        """Publish the statuses."""
        message = DiagnosticArray(status=[
            DiagnosticStatus(
                name=f'{self._name}: {status.name}', hardware_id=self._name, level=status.level,
                message=status.message, values=[
                    KeyValue(key=key, value=str(value))
                    for key, value in status.figures.items()])
            for status in statuses])
        message.header.stamp = stamp
        self._publisher.publish(message)
