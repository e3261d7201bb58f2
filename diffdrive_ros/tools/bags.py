"""
Bags: a rosbag2 folder, .mcap or .db3, read and written by rosbags.

Wheels come from JointStates by the names of the joints, poses of the reference from Odometry,
PoseStamped, PoseWithCovarianceStamped or TF by topic; other messages are skipped unread. Messages
are read from their bytes by core/cdr.py: rosbags' deserialiser takes 3 to 7 times as long.
"""
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
import tempfile
from typing import Any, NamedTuple, TYPE_CHECKING

from diffdrive_ros.core.cdr import JointStateReader, OdometryWriter, Scan, WireError
from diffdrive_ros.core.odometry_config import OdometryConfig
from diffdrive_ros.core.quaternion import heading_of_quaternion, quaternion_of_heading
from diffdrive_ros.core.stamp_thinning import StampThinning
from diffdrive_ros.core.validation import Array, UserError
from diffdrive_ros.core.wheel_feedback import WheelFeedback, WheelSample
import numpy as np

if TYPE_CHECKING:
    from rosbags.interfaces import Connection
    from rosbags.rosbag2 import Writer
    from rosbags.typesys.store import Typestore

SUFFIXES = ('.mcap', '.db3')

JOINT_STATE = 'sensor_msgs/msg/JointState'
ODOMETRY = 'nav_msgs/msg/Odometry'
POSE_STAMPED = 'geometry_msgs/msg/PoseStamped'
TF = 'tf2_msgs/msg/TFMessage'
REFERENCES = (ODOMETRY, POSE_STAMPED, 'geometry_msgs/msg/PoseWithCovarianceStamped', TF)


class Topics(NamedTuple):
    """What to read of a bag: topics, and the child frame where the reference has several."""

    joint_states: str = 'joint_states'
    reference: str | None = None
    reference_frame: str | None = None


class StampedPose(NamedTuple):
    """A pose in the plane: x, y [m], theta [rad]; child is '' where the type has none."""

    stamp_ns: int
    frame: str
    child: str
    pose: tuple[float, float, float]


# Reading

def read_bag(
    path: Path, feedback: WheelFeedback, topics: Topics,
) -> tuple[list[WheelSample], list[StampedPose] | None]:
    """Return the samples of the wheels, and the poses if topics has a reference; UserError."""
    samples: list[WheelSample] = []
    poses: list[StampedPose] = []
    wanted: dict[str, Sequence[str]] = {topics.joint_states: (JOINT_STATE,)}
    if topics.reference is not None:
        wanted[topics.reference] = REFERENCES
    reader = JointStateReader((*feedback.left_names, *feedback.right_names))
    other_joints: set[str] = set()
    for connection, received_ns, data in _messages(path, wanted):
        try:
            if connection.msgtype != JOINT_STATE:
                poses += read_poses(data, connection.msgtype)
                continue
            names, positions, velocities, stamp_ns, all_names = reader.read(data)
        except WireError as error:
            raise UserError(f'{path}: a message on {connection.topic}: {error}') from None
        # As in the node, the time of receipt replaces a missing stamp.
        sample = feedback.update(names, positions, velocities, stamp_ns or received_ns)
        if sample:
            samples.append(sample)
        else:
            other_joints.update(all_names)
    if not samples:
        joints = {*feedback.left_names, *feedback.right_names}
        raise UserError(
            f'{path}: no sample of {", ".join(sorted(joints - other_joints or joints))} on '
            + topics.joint_states
            + (f': {feedback.warning}' if feedback.warning else '')
            + f'; its joints are {", ".join(sorted(other_joints)) or "none"}')
    if topics.reference is None:
        return samples, None
    return samples, _of_one_frame(path, topics, poses)


def read_poses(payload: bytes, kind: str) -> list[StampedPose]:
    """Return the poses of a message of one of REFERENCES; raises WireError."""
    scan = Scan(payload)
    has_child = kind in (ODOMETRY, TF)
    return [
        StampedPose(
            scan.stamp_ns(), scan.string(), scan.string() if has_child else '', _planar(scan))
        for _ in range(scan.count() if kind == TF else 1)]


def _planar(scan: Scan) -> tuple[float, float, float]:
    """Return a Pose in the plane; the heading is nan if the quaternion is no rotation."""
    x, y, _, *rotation = scan.pose()
    return x, y, heading_of_quaternion(*rotation)


def _of_one_frame(path: Path, topics: Topics, poses: list[StampedPose]) -> list[StampedPose]:
    """Return the poses of the child frame that is wanted, or of the only one."""
    if not poses:
        raise UserError(f'{path}: no message on {topics.reference}')
    frames = {(pose.frame, pose.child) for pose in poses}
    chosen = {each for each in frames if topics.reference_frame in (None, each[1])}
    if len(chosen) != 1:
        listed = ', '.join(f'{child or "-"} in {frame}' for frame, child in sorted(frames))
        raise UserError(
            f'{path}: {topics.reference} has poses of several frames: --reference-frame must be '
            f'one of {listed}')
    return [pose for pose in poses if (pose.frame, pose.child) in chosen]


def _messages(
    path: Path, wanted: Mapping[str, Sequence[str]],
) -> 'Iterator[tuple[Connection, int, bytes]]':
    """Yield connection, time of receipt [ns] and bytes of messages, by topics and their types."""
    from rosbags.rosbag2 import Reader

    # A damaged file raises errors of rosbags, and of the parsers that rosbags uses; an error where
    # a message is processed is not raised in here.
    try:
        with Reader(path) as bag:
            yield from bag.messages([
                connection for topic, kinds in wanted.items()
                for connection in _connections(path, bag.connections, topic, kinds)])
    except (UserError, MemoryError):
        raise
    except Exception as error:
        detail = ' '.join(str(error).split()) or type(error).__name__
        repair = ' (mcap recover saves what is whole)' * (
            path.suffix == '.mcap' or any(path.glob('*.mcap')))
        raise UserError(
            f'{path}: cannot be read as a bag, was it cut off?{repair} {detail}') from None


def _connections(
    path: Path, connections: 'Sequence[Connection]', topic: str, kinds: Sequence[str],
) -> 'list[Connection]':
    """Return the connections of a topic, with or without its first slash."""
    found = [
        connection for connection in connections
        if connection.topic.strip('/') == topic.strip('/') and connection.msgtype in kinds]
    if not found:
        has = sorted({
            f'{connection.topic} ({connection.msgtype.rpartition("/")[2]})'
            for connection in connections})
        wanted = ' or '.join(kind.rpartition('/')[2] for kind in kinds)
        raise UserError(f'{path}: no {wanted} on {topic}; it has {", ".join(has) or "no topic"}')
    return found


# Writing

@contextmanager
def create_bag(path: Path, topics: Mapping[str, str]) -> 'Iterator[BagWriter]':
    """
    Create an .mcap file of messages on topics of known types; no file after an exception.

    rosbags writes a folder around the file.
    """
    from rosbags.rosbag2 import StoragePlugin, Writer
    from rosbags.typesys import get_typestore, Stores

    store = get_typestore(Stores.ROS2_JAZZY)
    with tempfile.TemporaryDirectory(dir=path.resolve().parent) as folder:
        with Writer(Path(folder) / 'bag', version=9, storage_plugin=StoragePlugin.MCAP) as writer:
            yield BagWriter(store, writer, {
                topic: writer.add_connection(topic, kind, typestore=store)
                for topic, kind in topics.items()})
        (Path(folder) / 'bag' / 'bag.mcap').replace(path)


@dataclass(frozen=True)
class BagWriter:
    """Writes messages into an open bag."""

    store: 'Typestore'
    writer: 'Writer'
    connections: 'Mapping[str, Connection]'

    def write(self, topic: str, stamp_ns: int, message: Any) -> None:
        """Write a message, or its bytes, as received at its stamp."""
        if not isinstance(message, bytes):
            message = self.store.serialize_cdr(message, message.__msgtype__)
        self.writer.write(self.connections[topic], stamp_ns, message)

    def header(self, stamp_ns: int, frame: str) -> Any:
        """Return a header."""
        return self.store.types['std_msgs/msg/Header'](
            self.store.types['builtin_interfaces/msg/Time'](*divmod(stamp_ns, 10**9)), frame)

    def write_joints(
        self, topic: str, stamp_ns: int, names: Sequence[str], positions: Array,
    ) -> None:
        """Write a JointState with positions [rad]."""
        self.write(topic, stamp_ns, self.store.types[JOINT_STATE](
            self.header(stamp_ns, ''), list(names), positions, np.zeros(0), np.zeros(0)))

    def write_pose(
        self, topic: str, stamp_ns: int, frame: str, pose: Iterable[float],
    ) -> None:
        """Write a PoseStamped of a pose in the plane."""
        x, y, theta = map(float, pose)
        types = self.store.types
        self.write(topic, stamp_ns, types[POSE_STAMPED](
            self.header(stamp_ns, frame), types['geometry_msgs/msg/Pose'](
                types['geometry_msgs/msg/Point'](x, y, 0.0),
                types['geometry_msgs/msg/Quaternion'](
                    0.0, 0.0, *quaternion_of_heading(theta)))))


def write_odometry(path: Path, config: OdometryConfig, samples: Sequence[WheelSample]) -> None:
    """Write /odom as the node publishes it for these samples, byte by byte, as an .mcap."""
    odometry = config.odometry()
    messages = OdometryWriter(
        config.odom_frame, config.base_frame, config.pose_variances, config.twist_variances)
    thinning = StampThinning(config.publish_rate)
    with create_bag(path, {'/odom': ODOMETRY}) as bag:
        for sample in samples:
            if sample.time_reset_ns is not None:
                odometry.reset_time(sample.time_reset_ns)
                thinning.reset_time()
            is_new = odometry.update(sample.left, sample.right, sample.stamp_ns)
            if is_new and thinning.is_due(sample.stamp_ns):
                bag.write(
                    '/odom', sample.stamp_ns, messages.write(sample.stamp_ns, odometry.estimate()))
