"""What users of comparable nodes ran into does not happen here: see doc/known_issues.md."""
from collections.abc import Callable, Iterator
import itertools
import math
from pathlib import Path
import re

from checks import mutants
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from diffdrive_ros.core.kinematics import DiffDrive
from diffdrive_ros.core.odometry import integrate
from diffdrive_ros.core.wheel_feedback import WheelFeedback
from diffdrive_ros.node import odom_publisher
from diffdrive_ros.node.odometry_node import OdometryNode
from diffdrive_ros.node.runner import StartError
from geometry_msgs.msg import Twist, TwistStamped
from nav_msgs.msg import Odometry
import pytest
from rclpy.qos import QoSProfile, ReliabilityPolicy
from sensor_msgs.msg import JointState
from support.station import (
    joints,
    LEFT_RADIUS,
    RIGHT_RADIUS,
    SEPARATION,
    stamp_ns,
    Station,
    twist,
    wait_until,
)

DRIVE = DiffDrive(SEPARATION, LEFT_RADIUS, RIGHT_RADIUS)
MS = 1_000_000  # [ns]

Make = Callable[..., OdometryNode]
Logged = Callable[[], str]


# Row 2: Twist and TwistStamped

@pytest.fixture
def elsewhere(domain: int) -> Iterator[Station]:
    """Return a second station, since one cannot have a topic in two types."""
    station = Station(domain)
    yield station
    station.close()


@pytest.mark.parametrize(('stamped', 'other'), [(False, TwistStamped), (True, Twist)])
def test_cmd_vel_of_the_other_type_warns_of_the_parameter(
        elsewhere: Station, make: Make, logged: Logged, stamped: bool, other: type) -> None:
    """Otherwise the robot does not move, without a reason."""
    make(enable_stamped_cmd_vel=stamped)
    elsewhere.node.create_publisher(other, 'cmd_vel', 1)
    wait_until(lambda: re.search(
        f'WARN.*/cmd_vel: station publishes geometry_msgs/msg/{other.__name__}, '
        '.*enable_stamped_cmd_vel', logged()))


# Row 5: covariances

def test_zero_variance_of_the_diagonal_is_not_published(station: Station, make: Make) -> None:
    """As in files that leave z, roll and pitch at zero: filters cannot invert it."""
    make(pose_covariance_diagonal=[0.001, 0.001, 0.0, 0.0, 0.0, 0.01])
    received = station.subscribe(Odometry, 'odom')
    station.publish_until(lambda: received, 'joint_states', (
        joints(k, left_wheel_joint=1.0, right_wheel_joint=2.0) for k in itertools.count(1)))
    covariance = received[0][1].pose.covariance
    assert all(0.0 < covariance[7 * axis] <= 1e6 for axis in range(6))


# Row 8: stamps

def test_out_of_order_joint_states_are_dropped_without_loss(
        station: Station, make: Make) -> None:
    """Duplicates and late ones, with other angles than the last: the next carries the motion."""
    make()
    received = station.subscribe(Odometry, 'odom')
    station.publish_until(lambda: received, 'joint_states', (
        joints(k, left_wheel_joint=0.0, right_wheel_joint=0.0) for k in itertools.count(1)))
    received.clear()
    for k, (ms, left, right) in enumerate([
            (100, 1.0, 2.0), (100, 1.1, 2.2), (90, 0.9, 1.8), (120, 2.0, 5.0), (120, 2.0, 5.0),
            (119, 9.0, 9.0), (140, 2.5, 5.5)]):
        station.publish('joint_states', joints(
            ms * MS, left_wheel_joint=left, right_wheel_joint=right))
        if k in (0, 3, 6):
            expected_ns = (100 + k // 3 * 20) * MS
            wait_until(lambda expected_ns=expected_ns: (
                received and stamp_ns(received[-1][1]) == expected_ns))
    assert [stamp_ns(message) for _, message in received] == [100 * MS, 120 * MS, 140 * MS]
    expected = integrate(DRIVE, [0.0, 1.0, 2.0, 2.5], [0.0, 2.0, 5.0, 5.5])
    position = received[-1][1].pose.pose.position
    assert (position.x, position.y) == pytest.approx(tuple(expected[-1, :2]), abs=1e-12)


# Row 9: counters

@pytest.mark.parametrize('by', [0.3, -0.3])
def test_encoder_wraparound_is_unwrapped_in_both_directions(by: float) -> None:
    """The angle continues."""
    feedback = WheelFeedback(left_names=['l'], right_names=['r'], encoder_wrap=10.0)
    samples = [feedback.update(['l', 'r'], [(k * by) % 10.0, 5.0], [], k * MS) for k in range(90)]
    assert [sample.left for sample in samples] == pytest.approx([k * by for k in range(90)])


@pytest.mark.parametrize(('after', 'angle'), [(1.2, 1.2), (40.1, 1.1)])
def test_implausible_step_is_classified_by_the_next_sample(
        after: float, angle: float) -> None:
    """A glitch loses nothing, an encoder reset the one step in which it happened."""
    feedback = WheelFeedback(left_names=['l'], right_names=['r'], max_plausible_speed=20.0)
    feedback.update(['l', 'r'], [1.0, 0.0], [], 0)
    assert feedback.update(['l', 'r'], [40.0, 0.0], [], 20 * MS) is None
    sample = feedback.update(['l', 'r'], [after, 0.0], [], 40 * MS)
    assert sample is not None
    assert sample.left == pytest.approx(angle)
    assert feedback.counts['glitches' if after < 2.0 else 'encoder_resets'] == 1


# Row 12: clocks that differ

@pytest.mark.parametrize('seconds', [0, 1, 2**31 - 1])
def test_age_of_a_command_counts_from_receipt(
        station: Station, make: Make, seconds: int) -> None:
    """Whatever its timestamp: none, of long ago, or of a clock that is far ahead."""
    make(enable_stamped_cmd_vel=True, cmd_vel_timeout=0.3)
    received = station.subscribe(JointState, 'wheel_commands')
    wait_until(lambda: station.node.count_publishers('wheel_commands'))
    message = TwistStamped(twist=twist(0.2, 0.3))
    message.header.stamp.sec = seconds
    station.publish('cmd_vel', message)
    wait_until(lambda: received)
    assert list(received[0][1].velocity) == pytest.approx(DRIVE.wheel_speeds(0.2, 0.3))
    wait_until(lambda: list(received[-1][1].velocity) == [0.0, 0.0])
    assert 0.2 < received[-1][0] - received[0][0] < 0.5


def test_joint_states_without_stamp_get_time_of_receipt(
        station: Station, make: Make, logged: Logged) -> None:
    """One warning is logged."""
    make()
    received = station.subscribe(Odometry, 'odom')
    station.publish_until(lambda: len(received) > 2, 'joint_states', (
        joints(0, left_wheel_joint=0.1 * k, right_wheel_joint=0.1 * k) for k in itertools.count()))
    stamps = [stamp_ns(message) for _, message in received]
    now_ns = station.node.get_clock().now().nanoseconds
    assert all(0 < now_ns - stamp < 10**10 for stamp in stamps)
    assert logged().count('without a timestamp') == 1


# Rows 14 and 15: frames and the transform

@pytest.mark.parametrize(('parameters', 'frames'), [
    ({}, ('odom', 'base_link')),
    ({'odom_frame_id': '/odom', 'base_frame_id': '/base'}, ('odom', 'base')),
    ({'tf_frame_prefix': '/r1/'}, ('r1/odom', 'r1/base_link')),
    ({'tf_frame_prefix': '~'}, ('fleet/r2/odom', 'fleet/r2/base_link')),
    ({'tf_frame_prefix': '~', 'tf_frame_prefix_enable': False}, ('odom', 'base_link')),
])
def test_frames_are_literal_without_tf_frame_prefix(
        station: Station, make: Make, parameters: dict[str, object], frames: tuple[str, str],
) -> None:
    """In a namespace, and never with a leading slash."""
    make('/fleet/r2', **parameters)
    received = station.subscribe(Odometry, '/fleet/r2/odom')
    station.publish_until(lambda: received, '/fleet/r2/joint_states', (
        joints(k, left_wheel_joint=0.0, right_wheel_joint=0.0) for k in itertools.count(1)))
    _, message = received[0]
    assert (message.header.frame_id, message.child_frame_id) == frames


@pytest.mark.parametrize('enabled', [True, False])
def test_transform_is_sent_only_with_enable_odom_tf(
        station: Station, make: Make, monkeypatch: pytest.MonkeyPatch, enabled: bool) -> None:
    """With enable_odom_tf false, /tf is left to another node."""
    sent = []

    class Sender:

        def __init__(self, *frames: object) -> None:
            pass

        def send(self, stamp: object, x: float, y: float, orientation: object) -> None:
            sent.append((x, y))

    monkeypatch.setattr(odom_publisher, 'TransformSender', Sender)
    make(enable_odom_tf=enabled)
    received = station.subscribe(Odometry, 'odom')
    station.publish_until(lambda: len(received) > 2, 'joint_states', (
        joints(k, left_wheel_joint=1.0, right_wheel_joint=2.0) for k in itertools.count(1)))
    assert bool(sent) == enabled


# Row 17: who is there, and is not received or should not be

def test_publisher_of_incompatible_qos_warns(
        station: Station, make: Make, logged: Logged) -> None:
    """A command of best effort does not reach a reliable subscription."""
    make()
    station.node.create_publisher(
        Twist, 'cmd_vel', QoSProfile(depth=1, reliability=ReliabilityPolicy.BEST_EFFORT))
    wait_until(lambda: re.search(r"\[odometry\].*'cmd_vel'.*incompatible QoS", logged()))


def test_second_publisher_of_joint_states_warns_once(
        station: Station, make: Make, logged: Logged) -> None:
    """If both have the same wheels, the pose jumps to and fro."""
    make()
    statuses = station.subscribe(DiagnosticArray, '/diagnostics')
    for _ in range(2):
        station.node.create_publisher(JointState, 'joint_states', 1)
    wait_until(lambda: '/joint_states: 2 publishers, station, station' in logged())
    count = len(statuses)
    wait_until(lambda: len(statuses) > count + 1)
    assert logged().count('/joint_states: 2 publishers') == 1


# Row 21: wheels that turn the other way

@pytest.mark.parametrize('directions', [(1, 1), (1, -1), (-1, 1), (-1, -1)])
def test_feedback_of_an_inverted_wheel_is_negated(directions: tuple[int, int]) -> None:
    """Each side has a sign of its own."""
    left, right = directions
    feedback = WheelFeedback(
        left_names=['l'], right_names=['r'], left_direction=left, right_direction=right)
    feedback.update(['l', 'r'], [0.0, 0.0], [], 0)
    sample = feedback.update(['l', 'r'], [3.0, 5.0], [], MS)
    assert (sample.left, sample.right) == (left * 3.0, right * 5.0)


@pytest.mark.parametrize('directions', [(1, -1), (-1, 1), (-1, -1)])
def test_command_of_an_inverted_wheel_is_negated(
        station: Station, make: Make, directions: tuple[int, int]) -> None:
    """It is the joint's own speed, as in joint_states."""
    left, right = directions
    make(left_wheel_direction=left, right_wheel_direction=right)
    received = station.subscribe(JointState, 'wheel_commands')
    station.publish_until(lambda: received, 'cmd_vel', itertools.repeat(twist(0.2, 0.3)))
    forward = DRIVE.wheel_speeds(0.2, 0.3)
    assert list(received[0][1].velocity) == pytest.approx([left * forward[0], right * forward[1]])


def test_inverted_wheel_drives_straight_in_open_loop(station: Station, make: Make) -> None:
    """Straight ahead stays straight ahead."""
    make(left_wheel_direction=-1, open_loop=True)
    received = station.subscribe(Odometry, 'odom')
    station.publish_until(
        lambda: received and received[-1][1].twist.twist != Twist(),
        'cmd_vel', itertools.repeat(twist(0.2, 0.0)))
    assert received[-1][1].twist.twist.angular.z == pytest.approx(0.0, abs=1e-9)


# Row 24: geometry

@pytest.mark.parametrize('name', ['wheel_separation', 'wheel_radius'])
@pytest.mark.parametrize('value', [0.0, -0.1, math.nan, math.inf])
def test_invalid_geometry_does_not_start(make: Make, name: str, value: float) -> None:
    """The line has the parameter, its value and the rule."""
    with pytest.raises(StartError, match=(
            f'^/odometry cannot start: {name} = {value}: must be positive and finite$')):
        make(**{name: value})


# Row 28: an encoder stops publishing

def test_silent_encoder_is_an_error_and_warns_once(
        station: Station, make: Make, logged: Logged) -> None:
    """Of one wheel alone, too: the received names and the missing one are logged."""
    make()
    received = station.subscribe(Odometry, 'odom')
    statuses = station.subscribe(DiagnosticArray, '/diagnostics')

    def level() -> object:
        return statuses and statuses[-1][1].status[0].level

    station.publish_until(lambda: received and level() == DiagnosticStatus.OK, 'joint_states', (
        joints(k, left_wheel_joint=1.0, right_wheel_joint=2.0) for k in itertools.count(1)))
    before = logged().count('WARN')  # until the station is discovered
    station.publish_until(lambda: level() == DiagnosticStatus.ERROR, 'joint_states', (
        joints(10**9 + k, left_wheel_joint=1.0) for k in itertools.count()))
    count = len(statuses)
    wait_until(lambda: len(statuses) > count + 1)
    warnings = [line for line in logged().splitlines() if 'WARN' in line][before:]
    assert len(warnings) == 1
    assert 'waiting for right_wheel_joint' in warnings[0]


# Row 30: velocities alone

def test_split_velocities_warn_of_position_feedback_once(
        station: Station, make: Make, logged: Logged) -> None:
    """Once, not each second."""
    make()
    statuses = station.subscribe(DiagnosticArray, '/diagnostics')
    names = itertools.cycle(['left_wheel_joint', 'right_wheel_joint'])
    station.publish_until(lambda: len(statuses) > 3, 'joint_states', (
        JointState(name=[name], velocity=[1.0]) for name in names))
    assert logged().count('position_feedback') == 1


# The table and the patches

def test_every_row_has_an_existing_test() -> None:
    """doc/known_issues.md names them, and test/checks/mutants.py reads it."""
    tests = mutants.tests_of_rows()
    assert list(tests) == list(range(1, 31))
    for name in itertools.chain(*tests.values()):
        file, _, function = name.partition('::')
        assert f'\ndef {function}(' in (mutants.TOP / file).read_text(), name
    assert all(tests[row] for row in tests)


def test_every_row_has_a_patch_that_applies(tmp_path: Path) -> None:
    """`make mutants` takes each behaviour away."""
    assert {row for row, _ in mutants.mutants()} == set(range(1, 31))
    for _, patch in mutants.mutants():
        mutants.copy(tmp_path)
        mutants.apply(patch.read_text(), tmp_path)
