"""
From joint_states to odom and its transform, as bytes.

This runs per message: few calls, few objects, no attribute lookup that can be saved. What it costs
is measured by test/benchmark/benchmark.py.
"""
from collections.abc import Sequence
from time import monotonic

from diffdrive_ros.core.cdr import (
    JointStateReader,
    OdometryWriter,
    STAMP_END_NS,
    STAMP_RULE,
    TransformWriter,
    WireError,
)
from diffdrive_ros.core.odometry_config import OdometryConfig
from diffdrive_ros.core.stamp_thinning import StampThinning
from diffdrive_ros.node.rclpy_internals import raw_publish
from diffdrive_ros.node.throttled_warning import ThrottledWarning
from nav_msgs.msg import Odometry as OdometryMessage
from rclpy.node import Node
from rclpy.qos import QoSProfile, ReliabilityPolicy
from rclpy.qos_overriding_options import QoSOverridingOptions
from sensor_msgs.msg import JointState

# Best effort matches every publisher; the depth bridges a pause of this process.
FROM_ANY_DRIVER = QoSProfile(depth=50, reliability=ReliabilityPolicy.BEST_EFFORT)

MAX_NAMES = 20  # of other joints, kept for the log


class TransformSender:
    """Publishes the transform from odom to base; raises ImportError without tf2_msgs."""

    def __init__(self, node: Node, odom_frame: str, base_frame: str) -> None:
        from tf2_msgs.msg import TFMessage

        # Absolute and of depth 100, as every transform broadcaster.
        self._publish = raw_publish(node.create_publisher(TFMessage, '/tf', QoSProfile(depth=100)))
        self._writer = TransformWriter(odom_frame, base_frame)

    def send(self, stamp_ns: int, x: float, y: float, theta: float) -> None:
        """Publish a pose [m, rad]."""
        self._publish(self._writer.write(stamp_ns, x, y, theta))


class OdomPublisher:
    """Updates the odometry with each message of the wheels, and publishes it."""

    def __init__(self, node: Node, config: OdometryConfig) -> None:
        self.feedback = config.wheel_feedback()
        self.odometry = config.odometry()
        self.sampled_at = monotonic()
        """When the last sample of the wheels was used, on the monotonic clock; or the start."""
        self.unused_names: set[str] = set()
        """The joints of messages that completed no sample."""
        self._node = node
        self._reader = JointStateReader((*config.left_wheel_names, *config.right_wheel_names))
        self._writer = OdometryWriter(
            config.odom_frame, config.base_frame, config.pose_variances, config.twist_variances)
        publisher = node.create_publisher(
            OdometryMessage, 'odom', QoSProfile(depth=10),
            qos_overriding_options=QoSOverridingOptions.with_default_policies())
        self._publish = raw_publish(publisher)
        self.odom_topic = publisher.topic_name
        self.joint_states_topic = node.resolve_topic_name('joint_states')
        self._warning = ThrottledWarning(
            node.get_logger().warning, f'{self.joint_states_topic}: {{}}')
        self._transforms = None
        if config.enable_odom_tf:
            try:
                self._transforms = TransformSender(node, config.odom_frame, config.base_frame)
            except ImportError:
                node.get_logger().info(
                    '/tf: tf2_msgs is not installed, no transform is published; install '
                    'tf2_msgs, or use the pose in odom')
        self._thinning = StampThinning(config.publish_rate)
        if not config.open_loop:
            node.create_subscription(
                JointState, 'joint_states', self.on_joint_states, FROM_ANY_DRIVER, raw=True,
                qos_overriding_options=QoSOverridingOptions.with_default_policies())

    def on_joint_states(self, payload: bytes) -> None:
        """Update the odometry with the bytes of a JointState."""
        try:
            names, positions, velocities, stamp_ns, all_names = self._reader.read(payload)
        except WireError as error:
            self._reject(f'unreadable: {error}')
            return
        if not stamp_ns:
            self._node.get_logger().warning(
                f'{self.joint_states_topic}: without a timestamp; the time of receipt is used, '
                'set header.stamp in the driver', once=True)
            stamp_ns = self._node.get_clock().now().nanoseconds
            if not self.has_stamp(stamp_ns):
                return
        is_sample = self.take(names, positions, velocities, stamp_ns)
        if not is_sample and len(self.unused_names) < MAX_NAMES:
            self.unused_names.update(all_names)

    def take(
        self, names: Sequence[str], positions: Sequence[float], velocities: Sequence[float],
        stamp_ns: int, odom_ns: int | None = None,
    ) -> bool:
        """
        Update the odometry with joints [rad, rad/s]; return whether they completed a sample.

        odom_ns is the timestamp of odom if it differs from that of the sample.
        """
        sample = self.feedback.take(names, positions, velocities, stamp_ns)
        warning = self.feedback.warning
        if warning != self._warning.logged:
            self._warning.update(warning)
        if sample is None:
            return False
        left, right, sample_ns, time_reset_ns = sample
        if time_reset_ns is not None:
            self.odometry.reset_time(time_reset_ns)
            self._thinning.reset_time()
        try:
            is_new = self.odometry.update(left, right, sample_ns)
        except ValueError as error:  # a step that overflows, by its noise or geometry
            self._reject(str(error))
            return False
        self.sampled_at = monotonic()
        if odom_ns is None:
            odom_ns = sample_ns
        if is_new and self._thinning.is_due(odom_ns):
            estimate = self.odometry.estimate()
            self._publish(self._writer.write(odom_ns, estimate))
            if self._transforms is not None:
                x, y, theta = estimate[0]
                self._transforms.send(odom_ns, x, y, theta)
        return True

    def has_stamp(self, clock_ns: int) -> bool:
        """Return whether the clock is in the range of timestamps; warn if it is not."""
        if clock_ns < STAMP_END_NS:
            return True
        self._reject(f'the clock is at {clock_ns * 1e-9:.0f} s: {STAMP_RULE}')
        return False

    def _reject(self, warning: str) -> None:
        self.feedback.reject(warning)
        self._warning.update(warning)
