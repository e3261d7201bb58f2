"""Logs give what was recorded, in every format, or say in one line why they cannot."""
import math

from diffdrive_ros.core import se2
from diffdrive_ros.core.cdr import WireError
from diffdrive_ros.core.wheel_feedback import WheelFeedback
from diffdrive_ros.tools import logs
from diffdrive_ros.tools.log_messages import POSES
from diffdrive_ros.tools.logs import LogError, Wanted
import numpy as np
import pytest
from support import bags
from support.bags import joints, reference, START_NS

KINDS = list(POSES)
WHEELS = ['left_wheel_joint', 'right_wheel_joint']
PERIOD_NS = 20_000_000


def feedback():
    """Return the way in of the wheels."""
    return WheelFeedback(left_names=[WHEELS[0]], right_names=[WHEELS[1]])


def recorded(kind='nav_msgs/msg/Odometry', count=50, topic='/mocap', stamps=START_NS):
    """Return what a robot that bends to the left would have recorded."""
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
@pytest.mark.parametrize('kind', KINDS)
def test_a_bag_gives_wheels_and_reference(tmp_path, storage, kind):
    folder = bags.write(tmp_path / 'drive', storage, recorded(kind))
    for path in (folder, bags.file_of(folder)):
        log = logs.read(path, feedback(), Wanted(reference='mocap'))
        stamps, left, right = log.wheels()
        assert stamps.tolist() == [START_NS + index * PERIOD_NS for index in range(50)]
        assert left == pytest.approx(0.1 * np.arange(50))
        assert right == pytest.approx(0.11 * np.arange(50))
        odd = np.arange(1, 50, 2)
        assert log.reference.stamps_ns.tolist() == (START_NS + odd * PERIOD_NS + 1).tolist()
        expected = np.stack([0.01 * odd, 0.002 * odd, 3.0 + 0.01 * odd], axis=-1)
        expected[:, 2] += 2.0 * math.pi * round((log.reference.poses[0, 2] - 3.0) / 2.0 / math.pi)
        assert log.reference.poses == pytest.approx(expected)
        assert log.reference.frame == 'world'


def test_a_csv_gives_wheels_and_reference_each_at_its_own_rate(tmp_path):
    path = tmp_path / 'drive.csv'
    path.write_text(
        'stamp,left,right,x,y,theta\n1700000000.123456789,0.0,0.5,,,\n'
        '1700000000.2,,,1.0,2.0,3.1\n1700000000.25,1.0,1.5,1.5,2.0,-3.1\n')
    log = logs.read(path, feedback())
    assert [sample.stamp_ns for sample in log.samples] == [
        1_700_000_000_123_456_789, 1_700_000_000_250_000_000]
    assert log.samples[1].right == 1.5
    assert log.reference.poses[:, 2] == pytest.approx([3.1, 2.0 * math.pi - 3.1])


def test_a_csv_may_begin_with_the_mark_of_its_encoding_and_have_blank_lines(tmp_path):
    path = tmp_path / 'drive.csv'
    path.write_bytes(b'\xef\xbb\xbfstamp,left,right\r\n0,0,0\r\n\r\n1,1,1\r\n  \r\n\r\n')
    assert len(logs.read(path, feedback()).samples) == 2


def test_a_csv_without_a_reference_has_none(tmp_path):
    path = tmp_path / 'drive.csv'
    path.write_text('stamp,left,right\n0,0,0\n0.5,1,1\n1,2,2\n')
    assert logs.read(path, feedback()).reference is None


@pytest.mark.parametrize('kind', KINDS)
@pytest.mark.parametrize('frame', ['', 'a', 'map', 'world', 'base_link_long'])
def test_the_bytes_of_a_pose_say_what_was_written_and_no_prefix_of_them_is_taken(kind, frame):
    message = reference(kind, START_NS, (1.5, -2.5, 0.75), frame, 'x' + frame)
    data = bytes(bags.STORE.serialize_cdr(message, kind))
    (pose,) = POSES[kind](data)
    assert pose.pose == pytest.approx((1.5, -2.5, 0.75))
    assert (pose.stamp_ns, pose.frame) == (START_NS, frame)
    for size in range(4 + 8 + 4 + 7 * 8):  # head, stamp, frame and pose need at least as much
        with pytest.raises(WireError):
            POSES[kind](data[:size])


def test_a_transform_among_several_is_asked_for_by_its_child(tmp_path):
    kind = 'tf2_msgs/msg/TFMessage'
    messages = recorded(kind)
    messages += [('/mocap', stamp, reference(kind, stamp, (9.0, 9.0, 0.0), child='lamp'))
                 for stamp in (START_NS, START_NS + 1)]
    folder = bags.write(tmp_path / 'drive', 'mcap', messages)
    with pytest.raises(LogError, match='lamp in world, marker in world'):
        logs.read(folder, feedback(), Wanted(reference='mocap'))
    log = logs.read(folder, feedback(), Wanted(reference='mocap', reference_child='marker'))
    assert len(log.reference.poses) == 25


def cut_off(path):
    """Cut the second half of a file away."""
    path.write_bytes(path.read_bytes()[:path.stat().st_size // 2])


@pytest.mark.parametrize('storage', ['mcap', 'db3'])
@pytest.mark.parametrize('damage', [cut_off, lambda path: path.write_bytes(b'')])
def test_a_damaged_bag_is_refused_in_one_line(tmp_path, storage, damage):
    folder = bags.write(tmp_path / 'drive', storage, recorded(count=2000))
    file = bags.file_of(folder)
    damage(file)
    for path in (folder, file):
        with pytest.raises(LogError) as error:
            logs.read(path, feedback(), Wanted(reference='mocap'))
        assert '\n' not in str(error.value)
        assert str(path) in str(error.value)
        assert 'was it cut off?' in str(error.value)
        assert ('mcap recover' in str(error.value)) == (storage == 'mcap')


@pytest.mark.parametrize(('content', 'rule'), [
    ('', 'the header is missing'),
    ('stamp,left\n', 'must be stamp,left,right or'),
    ('stamp,left,right\n0,0,0\n', '1 samples of all wheels, must be 2 or more'),
    ('stamp,left,right\n0,0,0\n1,nan,0\n', 'line 3: .*must be finite'),
    ('stamp,left,right\n0,0,0\n1,1\n', 'line 3: 2 columns, must be 3'),
    ('stamp,left,right,x,y,theta\n0,0,0,,,\n1,1,1,,,\n', 'the reference has 0 poses'),
    ('stamp,left,right\n0,0,0\n2,1,1\n1,2,2\n', 'line 4: stamp 1 is not later than .*must grow'),
    ('stamp,left,right\n0,0,0\n1,1,1\n0,0,0\n1,1,1\n', 'line 4: stamp 0 is not later'),
    ('stamp,left,right\n0,0,0\n1e300,1,1\n', r'line 3: stamp 1e300: must be within 9e\+09 s'),
    ('stamp,left,right\n0,0,0\n-1e300,1,1\n', 'line 3: stamp -1e300: must be within'),
    ('stamp,left,right\n0,0,0\n1,1,1.2', 'the last line does not end: was it cut off?'),
    (f'stamp,left,right\n0,0,0\n{"7" * 5000},1,1\n', 'line 3: .*must be finite numbers'),
    (f'stamp,left,right\n0,0,0\n{"7" * 50},1,1\n', 'line 3: stamp 7{40}: must be within'),
    ('stamp,left,right\n0,0,0\n1,1e300,1\n', r'line 3: 1e300,1: must be within 1e\+09 rad'),
])
def test_a_damaged_csv_is_refused_with_the_line(tmp_path, content, rule):
    path = tmp_path / 'drive.csv'
    path.write_text(content)
    with pytest.raises(LogError, match=rule):
        logs.read(path, feedback())


def test_what_a_bag_does_not_have_is_said_with_what_it_has(tmp_path):
    folder = bags.write(tmp_path / 'drive', 'mcap', recorded())
    with pytest.raises(LogError, match=r'no JointState on wheels; it has /joint_states \(Joint'):
        logs.read(folder, feedback(), Wanted(wheels='wheels'))
    with pytest.raises(LogError, match=r'on /odom; it has .*/mocap \(Odometry\)'):
        logs.read(folder, feedback(), Wanted(reference='/odom'))
    with pytest.raises(LogError, match=r'no sample of l on joint_s.*joints are arm, left_'):
        logs.read(folder, WheelFeedback(left_names=['l'], right_names=[WHEELS[1]]))
    with pytest.raises(LogError, match='no such file'):
        logs.read(tmp_path / 'nothing.mcap', feedback())
    (tmp_path / 'empty').mkdir()
    with pytest.raises(LogError, match=r'empty: is no rosbag2 folder: it has no metadata.yaml'):
        logs.read(tmp_path / 'empty', feedback())
    (tmp_path / 'notes.txt').write_text('')
    with pytest.raises(LogError, match='must be a rosbag2 folder'):
        logs.read(tmp_path / 'notes.txt', feedback())


def test_odometry_that_is_written_comes_back(tmp_path):
    random = np.random.default_rng(1)
    poses, twists = random.normal(size=(5, 3)), random.normal(size=(5, 3))
    covariances = [np.array([np.diag(row) for row in random.uniform(size=(5, 3))])
                   for _ in range(2)]
    for frames in (('odom', 'base_link'), ('o', 'robot/base'), ('map_3', 'b')):
        path = tmp_path / f'{frames[0]}.mcap'
        stamps = [START_NS + index for index in range(5)]
        logs.write_odometry(path, stamps, poses, twists, *covariances, *frames)
        from rosbags.rosbag2 import Reader
        with Reader(path) as reader:
            read = [bags.STORE.deserialize_cdr(data, connection.msgtype)
                    for connection, _, data in reader.messages()]
        assert list(tmp_path.glob('tmp*')) == []
        for message, pose, twist, of_pose, of_twist in zip(
                read, poses, twists, *covariances, strict=True):
            assert (message.header.frame_id, message.child_frame_id) == frames
            assert message.pose.pose.position.y == pose[1]
            q = message.pose.pose.orientation
            assert 2.0 * math.atan2(q.z, q.w) == pytest.approx(se2.wrap_angle(pose[2]))
            assert message.twist.twist.angular.z == twist[2]
            for covariance, planar in (
                    (message.pose.covariance, of_pose), (message.twist.covariance, of_twist)):
                assert covariance[[0, 7, 35]] == pytest.approx(np.diag(planar))
                assert covariance[14] == 1e6
