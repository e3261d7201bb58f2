"""The .mcap of a replay has the messages that the node publishes for the same joint states."""
from collections.abc import Callable
from pathlib import Path

from diffdrive_ros.tools import replay
from nav_msgs.msg import Odometry
import numpy as np
import pytest
from rclpy.serialization import deserialize_message
from rosbags.rosbag2 import Reader
from support import bags
from support.station import joints, Process, Station, wait_until

PARAMETERS = """/robot/odometry:
  ros__parameters:
    wheel_separation: 0.31
    wheel_radius: 0.05
    left_wheel_direction: -1
    encoder_wrap: 6.0
    tf_frame_prefix: '~'
    odom_frame_id: /map
    qos_overrides./robot/joint_states.subscription: {reliability: reliable, depth: 10000}
"""


@pytest.mark.parametrize('extra', [
    {'publish_rate': 12.5},
    {'pose_covariance_diagonal': [0.1, 0.2, 0.0, 0.3, 0.0, 0.4],
     'twist_covariance_diagonal': [0.01, 0.0, 0.0, 0.0, 0.0, 0.02]},
    {'turn_variance': 1e7, 'left_wheel_travel_variance': 1e8, 'base_frame_id': 'base/link',
     'tf_frame_prefix_enable': False},
])
def test_replay_writes_the_messages_of_the_node(
        station: Station, start: Callable[..., Process], tmp_path: Path, extra: dict,
) -> None:
    path = tmp_path / 'robot.yaml'
    path.write_text(PARAMETERS + ''.join(
        f'    {name}: {str(value).lower() if value is False else value}\n'
        for name, value in extra.items()))
    random = np.random.default_rng(5)
    steps = random.uniform(-0.05, 0.3, size=(60, 2))
    angles = np.cumsum(steps, axis=0) % 6.0
    stamps = [bags.START_NS + 20_000_000 * k for k in range(60)]
    stamps[40:] = [stamp + 300_000_000 for stamp in stamps[40:]]
    bags.write(tmp_path / 'run', 'mcap', [
        ('/joint_states', stamp, bags.joints(
            stamp, ['left_wheel_joint', 'right_wheel_joint'], pair))
        for stamp, pair in zip(stamps, angles.tolist(), strict=True)])
    replay.main([str(tmp_path / 'run'), '--params-file', str(path), '--output',
                 str(tmp_path / 'odom.mcap')])
    with Reader(tmp_path / 'odom.mcap') as reader:
        # Not the bytes: what fills up between strings may be anything.
        expected = [deserialize_message(data, Odometry) for _, _, data in reader.messages()]

    start('odometry_node', '-r', '__ns:=/robot', '--params-file', str(path))
    received = station.subscribe(Odometry, '/robot/odom')
    wait_until(lambda: station.node.count_publishers('/robot/odom'))
    for stamp, (left, right) in zip(stamps, angles.tolist(), strict=True):
        station.publish('/robot/joint_states', joints(
            stamp, left_wheel_joint=left, right_wheel_joint=right))
    wait_until(lambda: received and received[-1][1].header == expected[-1].header)
    assert [message for _, message in received] == expected
