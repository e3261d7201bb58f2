"""The transform from odom to base on /tf, where tf2_msgs is installed."""
from typing import Any

from builtin_interfaces.msg import Time
from geometry_msgs.msg import TransformStamped
from rclpy.node import Node
from rclpy.qos import QoSProfile


class TransformSender:
    """Publishes one transform; raises ImportError where there is no tf2_msgs."""

    def __init__(self, node: Node, odom_frame: str, base_frame: str) -> None:
        from tf2_msgs.msg import TFMessage

        # Absolute and of depth 100, as every broadcaster of transforms has it.
        self._publisher = node.create_publisher(TFMessage, '/tf', QoSProfile(depth=100))
        self._transform = TransformStamped(child_frame_id=base_frame)
        self._transform.header.frame_id = odom_frame
        self._message = TFMessage(transforms=[self._transform])

    def send(self, stamp: Time, x: float, y: float, orientation: Any) -> None:
        """Publish the transform to a pose; orientation is a quaternion message."""
        self._transform.header.stamp = stamp
        self._transform.transform.translation.x = x
        self._transform.transform.translation.y = y
        self._transform.transform.rotation = orientation
        self._publisher.publish(self._message)
