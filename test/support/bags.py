"""Bags for the tests: wheels and a reference as a robot's recorder would write them."""
from pathlib import Path

import numpy as np
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.typesys import get_typestore, Stores

STORE = get_typestore(Stores.ROS2_JAZZY)
TYPES = STORE.types
Time = TYPES['builtin_interfaces/msg/Time']
Header = TYPES['std_msgs/msg/Header']
Point = TYPES['geometry_msgs/msg/Point']
Vector = TYPES['geometry_msgs/msg/Vector3']
Quaternion = TYPES['geometry_msgs/msg/Quaternion']
Pose = TYPES['geometry_msgs/msg/Pose']
WithCovariance = TYPES['geometry_msgs/msg/PoseWithCovariance']

PLUGINS = {'mcap': StoragePlugin.MCAP, 'db3': StoragePlugin.SQLITE3}
START_NS = 1_700_000_000_123_456_789


def header(stamp_ns, frame='odom'):
    """Return a header."""
    return Header(Time(*divmod(int(stamp_ns), 10**9)), frame)


def pose_of(x, y, theta):
    """Return a Pose in the plane."""
    return Pose(
        Point(x, y, 0.1), Quaternion(0.0, 0.0, float(np.sin(theta / 2)), float(np.cos(theta / 2))))


def joints(stamp_ns, names, positions, velocities=()):
    """Return a JointState."""
    return TYPES['sensor_msgs/msg/JointState'](
        header(stamp_ns, ''), list(names), np.array(positions, float),
        np.array(velocities, float), np.array([], float))


def reference(kind, stamp_ns, pose, frame='world', child='marker'):
    """Return a message of a kind that brings a pose."""
    if kind == 'tf2_msgs/msg/TFMessage':
        transform = TYPES['geometry_msgs/msg/Transform'](
            Vector(pose[0], pose[1], 0.0), pose_of(*pose).orientation)
        return TYPES[kind]([TYPES['geometry_msgs/msg/TransformStamped'](
            header(stamp_ns, frame), child, transform)])
    if kind == 'geometry_msgs/msg/PoseStamped':
        return TYPES[kind](header(stamp_ns, frame), pose_of(*pose))
    with_covariance = WithCovariance(pose_of(*pose), np.zeros(36))
    if kind == 'geometry_msgs/msg/PoseWithCovarianceStamped':
        return TYPES[kind](header(stamp_ns, frame), with_covariance)
    zero = Vector(0.0, 0.0, 0.0)
    twist = TYPES['geometry_msgs/msg/TwistWithCovariance'](
        TYPES['geometry_msgs/msg/Twist'](zero, zero), np.zeros(36))
    return TYPES[kind](header(stamp_ns, frame), child, with_covariance, twist)


def write(folder: Path, storage: str, messages) -> Path:
    """Write (topic, stamp_ns, message) as a bag in a new folder."""
    with Writer(folder, version=9, storage_plugin=PLUGINS[storage]) as writer:
        connections = {}
        for topic, stamp_ns, message in messages:
            kind = message.__msgtype__
            if (topic, kind) not in connections:
                connections[topic, kind] = writer.add_connection(topic, kind, typestore=STORE)
            writer.write(
                connections[topic, kind], int(stamp_ns), STORE.serialize_cdr(message, kind))
    return folder


def file_of(folder: Path) -> Path:
    """Return the one file with messages in a bag's folder."""
    (file,) = (path for path in folder.iterdir() if path.suffix in ('.mcap', '.db3'))
    return file
