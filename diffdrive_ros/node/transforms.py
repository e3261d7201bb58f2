"""The transform from odom to base on /tf, where tf2_msgs is installed."""
from diffdrive_ros.core.cdr import TransformWriter
from rclpy.node import Node
from rclpy.qos import QoSProfile


class TransformSender:
    """Publishes one transform; raises ImportError where there is no tf2_msgs."""

    def __init__(self, node: Node, odom_frame: str, base_frame: str) -> None:
        from tf2_msgs.msg import TFMessage

        # Absolute and of depth 100, as every broadcaster of transforms has it.
        publisher = node.create_publisher(TFMessage, '/tf', QoSProfile(depth=100))
        self._publish = publisher.handle.publish_raw  # as in OdomPublisher
        self._writer = TransformWriter(odom_frame, base_frame)

    def send(self, stamp_ns: int, x: float, y: float, theta: float) -> None:
        """Publish the transform to a pose."""
        self._publish(self._writer.write(stamp_ns, x, y, theta))
