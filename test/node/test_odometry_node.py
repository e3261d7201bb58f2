"""Test the odometry node in this process: outputs for given inputs."""
from collections.abc import Callable, Iterator
import itertools
import math

from diffdrive_ros.core.kinematics import DiffDrive
from diffdrive_ros.core.odometry import integrate
from diffdrive_ros.node import rclpy_internals
from diffdrive_ros.node.odometry_node import OdometryNode
from geometry_msgs.msg import TwistStamped
from nav_msgs.msg import Odometry
import numpy as np
import pytest
from rcl_interfaces.srv import DescribeParameters, SetParameters, SetParametersAtomically
from rclpy.parameter import Parameter
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64, Float64MultiArray
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
START_NS = 1_700_000_000 * 10**9 + 987_654_321  # a float of it is off by a tenth of a microsecond
STEP_NS = 20_000_001

Make = Callable[..., OdometryNode]


@pytest.fixture(autouse=True, params=['internals', 'public API'])
def rclpy_api(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> None:
    """Run each test with rclpy's internals, and with their fallbacks."""
    if request.param == 'public API':
        monkeypatch.setattr(rclpy_internals, 'private', lambda *path: None)


def feed(station: Station, samples: list[tuple[float, float]]) -> list[Odometry]:
    """Publish wheel angles, one message after the other; return what odom answers."""
    received = station.subscribe(Odometry, 'odom')
    left, right = samples[0]
    station.publish_until(lambda: received, 'joint_states', (
        joints(START_NS - 10**9 + k, left_wheel_joint=left, right_wheel_joint=right)
        for k in itertools.count()))

    def answers() -> list[Odometry]:  # and not those to what was logged until somebody received it
        return [message for _, message in received if stamp_ns(message) >= START_NS]

    for k, (left, right) in enumerate(samples):
        station.publish('joint_states', joints(
            START_NS + k * STEP_NS, left_wheel_joint=left, right_wheel_joint=right))
        wait_until(lambda k=k: len(answers()) > k)
    return answers()


def planar_pose(message: Odometry) -> list[float]:
    """Return x, y and heading of a message."""
    pose = message.pose.pose
    heading = 2.0 * math.atan2(pose.orientation.z, pose.orientation.w)
    return [pose.position.x, pose.position.y, heading]


def test_odom_has_the_timestamp_of_joint_states(
        station: Station, make: Make) -> None:
    """It is equal to the nanosecond."""
    make()
    answers = feed(station, [(0.1 * k, 0.13 * k) for k in range(5)])
    assert [stamp_ns(answer) for answer in answers] == [START_NS + k * STEP_NS for k in range(5)]
    assert {(a.header.frame_id, a.child_frame_id) for a in answers} == {('odom', 'base_link')}


def test_pose_equals_batch_integration_of_the_same_angles(
        station: Station, make: Make) -> None:
    """A curve, with encoders that do not start at zero."""
    make()
    left = -17.3 + np.cumsum([0.0, 0.4, 0.5, -0.2, 1.1])
    right = 923.1 + np.cumsum([0.0, 0.7, 0.1, 0.9, 1.3])
    answers = feed(station, list(zip(left, right, strict=True)))
    poses = integrate(DRIVE, left, right)
    np.testing.assert_allclose([planar_pose(a) for a in answers], poses, atol=1e-12)


def test_twist_is_in_the_body_frame(station: Station, make: Make) -> None:
    """At a yaw of 90 degrees the speed of a robot driving forward is in x."""
    make(velocity_rolling_window_size=1)
    quarter_right = 0.25 * math.pi * SEPARATION / RIGHT_RADIUS
    quarter_left = -0.25 * math.pi * SEPARATION / LEFT_RADIUS
    ahead = (quarter_left + 0.01 / LEFT_RADIUS, quarter_right + 0.01 / RIGHT_RADIUS)
    last = feed(station, [(0.0, 0.0), (quarter_left, quarter_right), ahead])[-1]
    assert planar_pose(last) == pytest.approx([0.0, 0.01, 0.5 * math.pi], abs=1e-12)
    speed = 0.01 / (STEP_NS * 1e-9)
    twist = last.twist.twist
    assert (twist.linear.x, twist.linear.y, twist.angular.z) == pytest.approx(
        (speed, 0.0, 0.0), abs=1e-9)


def test_quaternion_is_normalised_after_many_turns(station: Station, make: Make) -> None:
    """The heading is published as a rotation, whatever the number of turns."""
    make()
    answers = feed(station, [(-31.0 * k, 37.0 * k) for k in range(4)])
    for answer in answers:
        q = answer.pose.pose.orientation
        assert math.hypot(q.x, q.y, q.z, q.w) == pytest.approx(1.0, abs=1e-15)
        assert q.w >= 0.0


def test_covariance_is_positive_bounded_and_grows(
        station: Station, make: Make) -> None:
    """Filters that fuse the message need this."""
    make()
    answers = feed(station, [(0.0, 0.0), (0.0, 0.0), (3.0, 5.0), (3.0, 5.0)])
    for answer in answers:
        for covariance in (answer.pose.covariance, answer.twist.covariance):
            matrix = np.reshape(covariance, (6, 6))
            np.testing.assert_array_equal(matrix, matrix.T)
            assert (np.linalg.eigvalsh(matrix) > 0.0).all()
            assert matrix.max() <= 1e6
    assert answers[2].pose.covariance[0] > answers[1].pose.covariance[0]
    assert answers[2].pose.covariance[35] > answers[1].pose.covariance[35]


def test_velocities_are_integrated_without_position_feedback(
        station: Station, make: Make) -> None:
    """A driver of velocities alone suffices with position_feedback false."""
    make(position_feedback=False)
    received = station.subscribe(Odometry, 'odom')

    def messages() -> Iterator[JointState]:
        for k in itertools.count():
            message = JointState(
                name=['right_wheel_joint', 'left_wheel_joint'], velocity=[7.0, 3.0])
            message.header.stamp.sec, message.header.stamp.nanosec = 5, k * 10_000_000
            yield message

    station.publish_until(lambda: len(received) > 5, 'joint_states', messages())
    first, last = received[0][1], received[-1][1]
    seconds = (stamp_ns(last) - stamp_ns(first)) * 1e-9
    expected = integrate(
        DRIVE, [0.0, 3.0 * seconds], [0.0, 7.0 * seconds], planar_pose(first))[-1]
    assert planar_pose(last) == pytest.approx(expected, abs=1e-12)


def test_wheels_of_a_side_are_averaged(station: Station, make: Make) -> None:
    """Four wheels in two messages: one odom, when the last wheel is renewed."""
    make(left_wheel_names=['fl', 'rl'], right_wheel_names=['fr', 'rr'])
    received = station.subscribe(Odometry, 'odom')
    station.publish_until(lambda: received, 'joint_states', (
        joints(k, fl=0.0, fr=0.0, rl=0.0, rr=0.0) for k in itertools.count(1)))
    received.clear()
    for k in range(3):
        station.publish('joint_states', joints(10**9 * k + 10**6, rr=1.0 * k, arm=5.0, fl=2.0 * k))
        station.publish('joint_states', joints(10**9 * k + 2 * 10**6, fr=3.0 * k, rl=4.0 * k))
        wait_until(lambda k=k: len(received) > k)
    assert [stamp_ns(answer) - 2 * 10**6 for _, answer in received] == [0, 10**9, 2 * 10**9]
    expected = integrate(DRIVE, [0.0, 6.0], [0.0, 4.0])[-1]
    got = planar_pose(received[-1][1])
    assert got[:2] == pytest.approx(expected[:2], abs=1e-12)
    assert math.remainder(got[2] - expected[2], 2.0 * math.pi) == pytest.approx(0.0, abs=1e-12)


def test_open_loop_integrates_commands_as_applied(station: Station, make: Make) -> None:
    """Saturation of a wheel is part of the odometry."""
    make(open_loop=True, max_wheel_speed=2.5, command_rate=100.0)
    odometry = station.subscribe(Odometry, 'odom')
    commands = station.subscribe(JointState, 'wheel_commands')
    wait_until(lambda: odometry)
    assert planar_pose(odometry[-1][1]) == [0.0, 0.0, 0.0]
    station.publish_until(
        lambda: planar_pose(odometry[-1][1])[2] > 0.1,
        'cmd_vel', itertools.repeat(twist(0.9, 0.7)))
    left, right = commands[-1][1].velocity
    assert max(left, right) == 2.5
    linear, angular = DRIVE.body_twist(left, right)
    last = odometry[-1][1].twist.twist
    assert (last.linear.x, last.angular.z) == pytest.approx((linear, angular), rel=1e-6)
    x, y, _ = planar_pose(odometry[-1][1])
    # On the circle of radius v/omega that touches the origin.
    assert math.hypot(x, y - linear / angular) == pytest.approx(linear / angular, rel=1e-9)


@pytest.mark.parametrize(('linear', 'angular'), [(0.21, 0.53), (-0.3, 0.4), (0.0, -1.1)])
def test_command_turns_each_wheel_at_its_speed(
        station: Station, make: Make, linear: float, angular: float) -> None:
    """The default type is a JointState with the velocity of every wheel by its name."""
    make(left_wheel_names=['fl', 'rl'], right_wheel_names=['fr', 'rr'])
    received = station.subscribe(JointState, 'wheel_commands')
    wait_until(lambda: station.node.count_publishers('wheel_commands'))
    station.publish('cmd_vel', twist(linear, angular))
    wait_until(lambda: received)
    left = (linear - 0.5 * SEPARATION * angular) / LEFT_RADIUS
    right = (linear + 0.5 * SEPARATION * angular) / RIGHT_RADIUS
    message = received[0][1]
    assert message.name == ['fl', 'rl', 'fr', 'rr']
    assert list(message.velocity) == pytest.approx([left, left, right, right], rel=1e-12)
    assert message.header.stamp.sec > 0


def test_multi_array_has_the_left_wheels_first(station: Station, make: Make) -> None:
    """The type of motor drivers that subscribe to an array."""
    make(wheel_command_type='multi_array')
    received = station.subscribe(Float64MultiArray, 'wheel_commands')
    wait_until(lambda: station.node.count_publishers('wheel_commands'))
    station.publish('cmd_vel', twist(0.1, 0.9))
    wait_until(lambda: received)
    assert list(received[0][1].data) == pytest.approx(DRIVE.wheel_speeds(0.1, 0.9))


def test_per_wheel_has_one_topic_per_joint(station: Station, make: Make) -> None:
    """The type of one motor driver per wheel."""
    make(wheel_command_type='per_wheel')
    left = station.subscribe(Float64, 'left_wheel_joint/command')
    right = station.subscribe(Float64, 'right_wheel_joint/command')
    wait_until(lambda: station.node.count_publishers('left_wheel_joint/command'))
    wait_until(lambda: station.node.count_publishers('right_wheel_joint/command'))
    station.publish('cmd_vel', twist(0.1, 0.9))
    wait_until(lambda: left and right)
    got = left[0][1].data, right[0][1].data
    assert got == pytest.approx(DRIVE.wheel_speeds(0.1, 0.9))


def test_twist_stamped_is_driven_where_enabled(station: Station, make: Make) -> None:
    """Nav2 and others publish TwistStamped."""
    make(enable_stamped_cmd_vel=True)
    received = station.subscribe(JointState, 'wheel_commands')
    wait_until(lambda: station.node.count_publishers('wheel_commands'))
    station.publish('cmd_vel', TwistStamped(twist=twist(0.1, 0.9)))
    wait_until(lambda: received)
    assert list(received[0][1].velocity) == pytest.approx(DRIVE.wheel_speeds(0.1, 0.9))


def test_no_wheel_command_is_sent_before_the_first_command(
        station: Station, make: Make) -> None:
    """With odometry alone, no wheel is held."""
    make(command_rate=200.0)
    received = station.subscribe(JointState, 'wheel_commands')
    wait_until(lambda: station.node.count_publishers('wheel_commands'))
    feed(station, [(0.01 * k, 0.02 * k) for k in range(30)])
    assert received == []


def set_parameters(station: Station, **values: object) -> list[str]:
    """Set parameters one by one; return the reason of each that was refused, '' if it was not."""
    request = SetParameters.Request(parameters=[
        Parameter(name, value=value).to_parameter_msg() for name, value in values.items()])
    answer = station.call(SetParameters, 'odometry/set_parameters', request)
    return ['' if result.successful else result.reason for result in answer.results]


def test_live_parameter_takes_effect_at_once(station: Station, make: Make) -> None:
    """A calibrated radius changes commands and odometry."""
    make()
    received = station.subscribe(JointState, 'wheel_commands')
    wait_until(lambda: station.node.count_publishers('wheel_commands'))
    reasons = set_parameters(station, left_wheel_radius_multiplier=1.25, cmd_vel_timeout=3)
    assert reasons == ['', '']
    station.publish('cmd_vel', twist(0.2, 0.3))
    wait_until(lambda: received)
    longer = DiffDrive(SEPARATION, 1.25 * LEFT_RADIUS, RIGHT_RADIUS)
    assert list(received[0][1].velocity) == pytest.approx(longer.wheel_speeds(0.2, 0.3))
    answers = feed(station, [(0.0, 0.0), (1.0, 2.0)])
    expected = integrate(longer, [0.0, 1.0], [0.0, 2.0])[-1]
    assert planar_pose(answers[-1]) == pytest.approx(expected, abs=1e-12)


@pytest.mark.parametrize(('name', 'value', 'rule'), [
    ('left_wheel_radius_multiplier', 0.0, 'left_wheel_radius_multiplier = 0.0: must be from 0.1'),
    ('left_wheel_radius_multiplier', math.nan, 'must be from 0.1 to 10'),
    ('cmd_vel_timeout', -1.0, 'cmd_vel_timeout = -1.0: must be finite and zero or more'),
    ('max_wheel_speed', math.inf, 'max_wheel_speed = inf: must be positive'),
    ('wheel_radius', 0.05, 'read-only'),
])
def test_wrong_value_is_rejected_with_its_rule(
        station: Station, make: Make, name: str, value: float, rule: str) -> None:
    """`ros2 param set` shows the reason, and nothing changes."""
    node = make()
    before = node.get_parameter(name).value
    [reason] = set_parameters(station, **{name: value})
    assert rule in reason
    assert node.get_parameter(name).value == before or math.isnan(before)


def test_atomic_change_is_applied_whole_or_not_at_all(
        station: Station, make: Make) -> None:
    """Two multipliers of one calibration belong together."""
    node = make()
    request = SetParametersAtomically.Request(parameters=[
        Parameter('left_wheel_radius_multiplier', value=1.1).to_parameter_msg(),
        Parameter('wheel_separation_multiplier', value=-1.0).to_parameter_msg()])
    answer = station.call(
        SetParametersAtomically, 'odometry/set_parameters_atomically', request)
    assert not answer.result.successful
    assert 'wheel_separation_multiplier = -1.0' in answer.result.reason
    assert node.get_parameter('left_wheel_radius_multiplier').value == 1.0


def test_every_parameter_has_a_description(station: Station, make: Make) -> None:
    """`ros2 param describe` shows it."""
    node = make()
    names = [name for name in node.get_parameters_by_prefix('') if not name.startswith((
        'qos_overrides', 'use_sim_time', 'start_type_description'))]
    assert len(names) > 15
    answer = station.call(
        DescribeParameters, 'odometry/describe_parameters',
        DescribeParameters.Request(names=names))
    assert all(len(descriptor.description) > 20 for descriptor in answer.descriptors)
