"""
The odometry of the node for a real robot's wheels, against motion capture.

OptiOdom (Sousa et al., doi 10.1007/s10846-022-01630-3) recorded a two-wheeled robot, nominally
with wheels of 84 mm diameter, 200 mm apart, and encoders of 2796.8 ticks a turn.
"""
from collections.abc import Callable
import itertools
import math
from pathlib import Path

from diffdrive_ros.core.kinematics import DiffDrive
from diffdrive_ros.core.odometry import integrate
from nav_msgs.msg import Odometry
import numpy as np
import pytest
from support.station import joints, Process, stamp_ns, Station, wait_until

DATA = Path(__file__).resolve().parents[3] / 'shared' / 'data' / 'optiodom'
TICK = 2.0 * math.pi / 2796.8
DRIVE = DiffDrive(0.200, 0.042, 0.042)
START_NS = 1_600_000_000 * 10**9

pytestmark = pytest.mark.skipif(
    not DATA.is_dir(), reason='the OptiOdom recordings are not in ../shared/data/optiodom')


def read(run: Path) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Return stamps [ns], left and right angles [rad] and the true poses of a run."""
    seconds, x, y, theta, right_ticks, left_ticks = np.loadtxt(run, delimiter=',').T
    stamps = START_NS + np.round((seconds - seconds[0]) * 1e9).astype(int)
    left, right = np.cumsum(left_ticks) * TICK, np.cumsum(right_ticks) * TICK
    return stamps, left, right, np.stack([x, y, theta], axis=-1)


def last_pose(station: Station, robot: str, received: list, run: Path) -> list[float]:
    """Publish a run to a node, and return its final pose."""
    stamps, left, right, _ = read(run)
    topic = f'/{robot}/joint_states'
    # The robot stands while the connection is made: the same angles, before the start.
    station.publish_until(lambda: received, topic, (
        joints(START_NS - 10**9 + k, left_wheel_joint=left[0], right_wheel_joint=right[0])
        for k in itertools.count()))
    for stamp, angle_left, angle_right in zip(stamps.tolist(), left, right, strict=True):
        station.publish(topic, joints(
            stamp, left_wheel_joint=angle_left, right_wheel_joint=angle_right))
    wait_until(lambda: stamp_ns(received[-1][1]) == stamps[-1])
    pose = received[-1][1].pose.pose
    heading = 2.0 * math.atan2(pose.orientation.z, pose.orientation.w)
    return [pose.position.x, pose.position.y, heading]


@pytest.mark.parametrize(('recordings', 'median_error'), [
    ('square/231220200029', 0.0651),
    ('square/231220200040', 0.0804),
    ('circular/231220200121', 0.1074),
])
def test_node_integrates_ticks_with_the_known_final_error(
        station: Station, start: Callable[..., Process], recordings: str, median_error: float,
) -> None:
    """Median of the final position errors, with the nominal geometry, to 0.1 mm."""
    folder, prefix = recordings.split('/')
    runs = sorted((DATA / folder).glob(f'{prefix}_run-*.csv'))
    assert len(runs) == 6
    robots = [f'run{number}' for number in range(6)]
    for robot in robots:
        start('odometry_node', '-r', f'__ns:=/{robot}', wheel_separation=0.200,
              wheel_radius=0.042, **{
                  'qos_overrides./' + robot + '/joint_states.subscription.reliability': 'reliable',
                  'qos_overrides./' + robot + '/joint_states.subscription.depth': 10000})
    received = {robot: station.subscribe(Odometry, f'/{robot}/odom') for robot in robots}
    errors = []
    for robot, run in zip(robots, runs, strict=True):
        x, y, heading = last_pose(station, robot, received[robot], run)
        _, left, right, truth = read(run)
        expected = integrate(DRIVE, left, right)[-1]
        assert (x, y) == pytest.approx(expected[:2], abs=1e-6)
        assert math.remainder(heading - expected[2], 2.0 * math.pi) == pytest.approx(
            0.0, abs=1e-6)
        errors.append(math.hypot(x - truth[-1, 0], y - truth[-1, 1]))
    assert np.median(errors) == pytest.approx(median_error, abs=0.5e-4)
