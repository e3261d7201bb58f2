"""Bags are read in every format, or rejected in one line; what is written is read back."""
import math

from diffdrive_ros.core import se2
from diffdrive_ros.core.cdr import WireError
from diffdrive_ros.core.odometry import UNKNOWN_VARIANCE
from diffdrive_ros.core.odometry_config import OdometryConfig
from diffdrive_ros.core.parameter_specs import checked_values, ODOMETRY
from diffdrive_ros.core.validation import UserError
from diffdrive_ros.core.wheel_feedback import WheelFeedback, WheelSample
from diffdrive_ros.tools import logs
from diffdrive_ros.tools.bags import (
    create_bag,
    JOINT_STATE,
    POSE_STAMPED,
    read_poses,
    REFERENCES,
    Topics,
    write_odometry,
)
import numpy as np
import pytest
from rosbags.rosbag2 import Reader
from support import bags
from support.bags import joints, reference, START_NS

WHEELS = ['left_wheel_joint', 'right_wheel_joint']
PERIOD_NS = 20_000_000


def feedback():
    """Return the feedback of two wheels."""
    return WheelFeedback(left_names=[WHEELS[0]], right_names=[WHEELS[1]])


def recorded(kind='nav_msgs/msg/Odometry', count=50, topic='/mocap', stamps=START_NS):
    """Return the messages of a robot that bends to the left."""
    messages = []
    for index in range(count):
        stamp = START_NS + index * PERIOD_NS
        messages.append(('/joint_states', stamp + 5, joints(
            stamp, ['arm', WHEELS[1], WHEELS[0]], [7.0, 0.11 * index, 0.1 * index])))
        if index % 2:
            seen = stamps + index * PERIOD_NS + 1
            messages.append((topic, stamp + 7, reference(
                kind, seen, (0.01 * index, 0.002 * index, 3.0 + 0.01 * index))))
    return messages


@pytest.mark.parametrize('storage', ['mcap', 'db3'])
@pytest.mark.parametrize('kind', REFERENCES)
def test_bag_has_wheels_and_reference(tmp_path, storage, kind):
    folder = bags.write(tmp_path / 'drive', storage, recorded(kind))
    for path in (folder, bags.file_of(folder)):
        log = logs.read(path, feedback(), Topics(reference='mocap'))
        stamps, left, right = log.wheels()
        assert stamps.tolist() == [START_NS + index * PERIOD_NS for index in range(50)]
        assert left == pytest.approx(0.1 * np.arange(50))
        assert right == pytest.approx(0.11 * np.arange(50))
        odd = np.arange(1, 50, 2)
        assert log.reference.stamps_ns.tolist() == (START_NS + odd * PERIOD_NS + 1).tolist()
        expected = np.stack([0.01 * odd, 0.002 * odd, 3.0 + 0.01 * odd], axis=-1)
        expected[:, 2] += 2.0 * math.pi * round((log.reference.poses[0, 2] - 3.0) / 2.0 / math.pi)
        assert log.reference.poses == pytest.approx(expected)


@pytest.mark.parametrize('kind', REFERENCES)
@pytest.mark.parametrize('frame', ['', 'a', 'map', 'world', 'base_link_long'])
def test_pose_is_read_back_and_no_prefix_of_it_is_accepted(kind, frame):
    message = reference(kind, START_NS, (1.5, -2.5, 0.75), frame, 'x' + frame)
    data = bytes(bags.STORE.serialize_cdr(message, kind))
    (pose,) = read_poses(data, kind)
    assert pose.pose == pytest.approx((1.5, -2.5, 0.75))
    assert (pose.stamp_ns, pose.frame) == (START_NS, frame)
    for size in range(4 + 8 + 4 + 7 * 8):  # head, stamp, frame and pose need at least as much
        with pytest.raises(WireError):
            read_poses(data[:size], kind)


def test_transform_is_selected_by_its_child_frame(tmp_path):
    kind = 'tf2_msgs/msg/TFMessage'
    messages = recorded(kind)
    messages += [('/mocap', stamp, reference(kind, stamp, (9.0, 9.0, 0.0), child='lamp'))
                 for stamp in (START_NS, START_NS + 1)]
    folder = bags.write(tmp_path / 'drive', 'mcap', messages)
    with pytest.raises(UserError, match='must be one of lamp in world, marker in world'):
        logs.read(folder, feedback(), Topics(reference='mocap'))
    log = logs.read(folder, feedback(), Topics(reference='mocap', reference_frame='marker'))
    assert len(log.reference.poses) == 25


def cut_off(path):
    """Cut the second half of a file away."""
    path.write_bytes(path.read_bytes()[:path.stat().st_size // 2])


@pytest.mark.parametrize('storage', ['mcap', 'db3'])
@pytest.mark.parametrize('damage', [cut_off, lambda path: path.write_bytes(b'')])
def test_damaged_bag_is_rejected_in_one_line(tmp_path, storage, damage):
    folder = bags.write(tmp_path / 'drive', storage, recorded(count=2000))
    file = bags.file_of(folder)
    damage(file)
    for path in (folder, file):
        with pytest.raises(UserError) as error:
            logs.read(path, feedback(), Topics(reference='mocap'))
        assert '\n' not in str(error.value)
        assert str(path) in str(error.value)
        assert 'was it cut off?' in str(error.value)
        assert ('mcap recover' in str(error.value)) == (storage == 'mcap')


def test_missing_topic_or_joint_is_reported_with_existing(tmp_path):
    folder = bags.write(tmp_path / 'drive', 'mcap', recorded())
    with pytest.raises(UserError, match=r'no JointState on wheels; it has /joint_states \(Joint'):
        logs.read(folder, feedback(), Topics(joint_states='wheels'))
    with pytest.raises(UserError, match=r'on /odom; it has .*/mocap \(Odometry\)'):
        logs.read(folder, feedback(), Topics(reference='/odom'))
    with pytest.raises(UserError, match=r'no sample of l on joint_s.*joints are arm, left_'):
        logs.read(folder, WheelFeedback(left_names=['l'], right_names=[WHEELS[1]]))


@pytest.fixture
def config():
    """Return the configuration of a robot in a namespace, with a fixed pose covariance."""
    return OdometryConfig.of(checked_values(ODOMETRY, {
        'wheel_separation': 0.3, 'wheel_radius': 0.05, 'tf_frame_prefix': '~',
        'odom_frame_id': '/map_3', 'pose_covariance_diagonal': [0.1, 0.2, 0.0, 0.0, 0.0, 0.3]}),
        '/robot')


def test_written_odometry_is_read_back(tmp_path, config):
    angles = np.cumsum(np.random.default_rng(1).uniform(-1.0, 1.0, size=(5, 2)), axis=0)
    samples = [WheelSample(left, right, START_NS + 10**8 * index)
               for index, (left, right) in enumerate(angles.tolist())]
    path = tmp_path / 'odom.mcap'
    write_odometry(path, config, samples)
    assert list(tmp_path.glob('tmp*')) == []
    odometry = config.odometry()
    with Reader(path) as reader:
        read = [bags.STORE.deserialize_cdr(data, connection.msgtype)
                for connection, _, data in reader.messages()]
    for message, sample in zip(read, samples, strict=True):
        odometry.update(sample.left, sample.right, sample.stamp_ns)
        assert message.header.stamp.sec * 10**9 + message.header.stamp.nanosec == sample.stamp_ns
        assert (message.header.frame_id, message.child_frame_id) == (
            'robot/map_3', 'robot/base_link')
        assert message.pose.pose.position.y == odometry.pose[1]
        q = message.pose.pose.orientation
        assert 2.0 * math.atan2(q.z, q.w) == pytest.approx(se2.wrap_angle(odometry.pose[2]))
        assert message.twist.twist.angular.z == odometry.twist[2]
        assert message.pose.covariance[[0, 7, 35]] == pytest.approx([0.1, 0.2, 0.3])
        assert message.twist.covariance[[0, 7, 35]] == pytest.approx(
            np.diag(odometry.twist_covariance))
        assert message.pose.covariance[14] == message.twist.covariance[14] == UNKNOWN_VARIANCE


def test_written_odometry_is_thinned_by_stamp(tmp_path):
    values = {'wheel_separation': 0.3, 'wheel_radius': 0.05, 'publish_rate': 10.0}
    samples = [WheelSample(0.1 * k, 0.1 * k, START_NS + 20_000_000 * k) for k in range(51)]
    write_odometry(
        tmp_path / 'odom.mcap', OdometryConfig.of(checked_values(ODOMETRY, values)), samples)
    with Reader(tmp_path / 'odom.mcap') as reader:
        stamps = [stamp for _, stamp, _ in reader.messages()]
    assert stamps == [START_NS + 100_000_000 * k for k in range(11)]


def test_written_joints_and_poses_are_read_back(tmp_path):
    path = tmp_path / 'run.mcap'
    with create_bag(path, {'/joint_states': JOINT_STATE, '/mocap': POSE_STAMPED}) as bag:
        for index in range(3):
            bag.write_joints(
                '/joint_states', START_NS + index, WHEELS, np.array([1.0, 2.0]) * index)
            bag.write_pose('/mocap', START_NS + index, 'world', (0.1 * index, 0.2, 0.3))
    log = logs.read(path, feedback(), Topics(reference='mocap'))
    assert log.samples[-1] == WheelSample(2.0, 4.0, START_NS + 2)
    assert log.reference.poses[-1] == pytest.approx([0.2, 0.2, 0.3])


def test_bag_is_not_written_after_an_error(tmp_path):
    with pytest.raises(ZeroDivisionError), create_bag(tmp_path / 'run.mcap', {}):
        raise ZeroDivisionError
    assert list(tmp_path.iterdir()) == []
