"""The way of what the wheels did: from joint_states, in bytes, to odom and its transform."""
from collections.abc import Sequence
from time import monotonic

from diffdrive_ros.core.cdr import (
    BEFORE_ITS_END,
    END_OF_TIME_NS,
    JointStateReader,
    OdometryWriter,
    WireError,
)
from diffdrive_ros.core.odometry_config import OdometryConfig
from diffdrive_ros.node.throttled_warning import Complaints
from diffdrive_ros.node.transforms import TransformSender
from nav_msgs.msg import Odometry as OdometryMessage
from rclpy.node import Node
from rclpy.qos import QoSProfile
from rclpy.qos_overriding_options import QoSOverridingOptions

MOST_NAMES = 20  # of joints that are not ours, in a message


class OdomPublisher:
    """
    Keeps the odometry up to date with each message, and publishes it.

    This is done for every message of the wheels, so that what it needs is kept together here, and
    nothing else is done on the way.
    """

    def __init__(self, node: Node, config: OdometryConfig) -> None:
        self.feedback = config.wheel_feedback()
        self.odometry = config.odometry()
        self.sampled_at = monotonic()
        """When the last sample of the wheels was taken, on the monotonic clock; or the start."""
        self.heard_in_vain: set[str] = set()
        """The joints of messages that completed no sample."""
        self._node = node
        self._complaints = Complaints(node.get_logger().warning, 'joint_states: {}')
        self._reader = JointStateReader((*config.left_wheel_names, *config.right_wheel_names))
        self._writer = OdometryWriter(
            config.odom_frame, config.base_frame, config.pose_variances, config.twist_variances)
        publisher = node.create_publisher(
            OdometryMessage, 'odom', QoSProfile(depth=10),
            qos_overriding_options=QoSOverridingOptions.with_default_policies())
        # What Publisher.publish calls for bytes; its look at their type and its guard against
        # being destroyed meanwhile are dear, and needless where one thread does both.
        self._publish = publisher.handle.publish_raw
        self._transforms = None
        if config.enable_odom_tf:
            try:
                self._transforms = TransformSender(node, config.odom_frame, config.base_frame)
            except ImportError:
                node.get_logger().info(
                    'tf2_msgs is not installed: no transform is published; odom has the pose')
        self._period_ns = round(1e9 / config.publish_rate) if config.publish_rate else None
        self._due_ns: int | None = None

    def on_joint_states(self, payload: bytes) -> None:
        """Take what a JointState says, as bytes."""
        try:
            names, positions, velocities, stamp_ns, all_names = self._reader.read(payload)
        except WireError as error:
            self._refuse(f'unreadable: {error}')
            return
        if not stamp_ns:
            self._node.get_logger().warning(
                'joint_states come without a stamp: the time of receipt stands in', once=True)
            stamp_ns = self._node.get_clock().now().nanoseconds
            if not self.has_stamp(stamp_ns):
                return
        is_sample = self.take(names, positions, velocities, stamp_ns)
        if not is_sample and len(self.heard_in_vain) < MOST_NAMES:
            self.heard_in_vain.update(all_names)

    def take(
        self, names: Sequence[str], positions: Sequence[float], velocities: Sequence[float],
        stamp_ns: int, odom_ns: int | None = None,
    ) -> bool:
        """
        Take what the wheels did; return whether that was a sample of all.

        odom_ns is the stamp of odom if it is not the sample's own.
        """
        sample = self.feedback.take(names, positions, velocities, stamp_ns)
        complaint = self.feedback.complaint
        if complaint != self._complaints.said:
            self._complaints.look(complaint)
        if sample is None:
            return False
        left, right, sample_ns, restarted_ns = sample
        if restarted_ns is not None:
            self.odometry.restart(restarted_ns)
            self._due_ns = None
        try:
            is_new = self.odometry.update(left, right, sample_ns)
        except ValueError as error:  # a step without bounds, by a noise or geometry without
            self._refuse(str(error))
            return False
        self.sampled_at = monotonic()
        if odom_ns is None:
            odom_ns = sample_ns
        if is_new and (self._period_ns is None or self._is_due(odom_ns, self._period_ns)):
            estimate = self.odometry.estimate()
            self._publish(self._writer.write(odom_ns, estimate))
            if self._transforms is not None:
                x, y, theta = estimate[0]
                self._transforms.send(odom_ns, x, y, theta)
        return True

    def has_stamp(self, clock_ns: int) -> bool:
        """Return whether a time of our clock can be the stamp of odom; complain if not."""
        if clock_ns < END_OF_TIME_NS:
            return True
        self._refuse(f'the clock is at {clock_ns * 1e-9:.0f} s: {BEFORE_ITS_END}')
        return False

    def _refuse(self, complaint: str) -> None:
        self.feedback.refuse(complaint)
        self._complaints.look(complaint)

    def _is_due(self, stamp_ns: int, period_ns: int) -> bool:
        """Return whether odom is to be published for a stamp."""
        if (self._due_ns is None
                or not self._due_ns - period_ns <= stamp_ns < self._due_ns + period_ns):
            self._due_ns = stamp_ns  # at the start, after a gap, by a clock that was set
        if stamp_ns < self._due_ns:
            return False
        self._due_ns += period_ns
        return True
