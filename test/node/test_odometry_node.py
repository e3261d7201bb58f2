"""The node odometry, in this process: what it publishes for what it hears."""
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
    heard = station.hear(Odometry, 'odom')
    left, right = samples[0]
    station.say_until(lambda: heard, 'joint_states', (
        joints(START_NS - 10**9 + k, left_wheel_joint=left, right_wheel_joint=right)
        for k in itertools.count()))

    def answers() -> list[Odometry]:  # and not those to what was said until somebody heard it
        return [message for _, message in heard if stamp_ns(message) >= START_NS]

    for k, (left, right) in enumerate(samples):
        station.say('joint_states', joints(
            START_NS + k * STEP_NS, left_wheel_joint=left, right_wheel_joint=right))
        wait_until(lambda k=k: len(answers()) > k)
    return answers()


def planar_pose(message: Odometry) -> list[float]:
    """Return x, y and heading of a message."""
    pose = message.pose.pose
    heading = 2.0 * math.atan2(pose.orientation.z, pose.orientation.w)
    return [pose.position.x, pose.position.y, heading]


def test_odometry_has_the_stamp_of_the_message_that_it_answers(
        station: Station, make: Make) -> None:
    """The stamp is the message's own, to the nanosecond."""
    make()
    answers = feed(station, [(0.1 * k, 0.13 * k) for k in range(5)])
    assert [stamp_ns(answer) for answer in answers] == [START_NS + k * STEP_NS for k in range(5)]
    assert {(a.header.frame_id, a.child_frame_id) for a in answers} == {('odom', 'base_link')}


def test_the_pose_is_that_of_the_batch_integration_over_the_same_angles(
        station: Station, make: Make) -> None:
    """A curved drive with encoders that do not start at zero."""
    make()
    left = -17.3 + np.cumsum([0.0, 0.4, 0.5, -0.2, 1.1])
    right = 923.1 + np.cumsum([0.0, 0.7, 0.1, 0.9, 1.3])
    answers = feed(station, list(zip(left, right, strict=True)))
    poses = integrate(DRIVE, left, right)
    np.testing.assert_allclose([planar_pose(a) for a in answers], poses, atol=1e-12)


def test_the_twist_is_in_the_frame_of_the_body(station: Station, make: Make) -> None:
    """At a yaw of 90 degrees, a robot that drives on still has all of its speed in x."""
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


def test_the_quaternion_is_normalised_after_many_turns(station: Station, make: Make) -> None:
    """Heading is published as a rotation, whatever the number of turns was."""
    make()
    answers = feed(station, [(-31.0 * k, 37.0 * k) for k in range(4)])
    for answer in answers:
        q = answer.pose.pose.orientation
        assert math.hypot(q.x, q.y, q.z, q.w) == pytest.approx(1.0, abs=1e-15)
        assert q.w >= 0.0


def test_the_covariance_is_never_zero_never_above_a_million_and_grows(
        station: Station, make: Make) -> None:
    """What filters that fuse the message need."""
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
    """A driver that publishes velocities alone is enough with position_feedback false."""
    make(position_feedback=False)
    heard = station.hear(Odometry, 'odom')

    def messages() -> Iterator[JointState]:
        for k in itertools.count():
            message = JointState(
                name=['right_wheel_joint', 'left_wheel_joint'], velocity=[7.0, 3.0])
            message.header.stamp.sec, message.header.stamp.nanosec = 5, k * 10_000_000
            yield message

    station.say_until(lambda: len(heard) > 5, 'joint_states', messages())
    first, last = heard[0][1], heard[-1][1]
    seconds = (stamp_ns(last) - stamp_ns(first)) * 1e-9
    expected = integrate(
        DRIVE, [0.0, 3.0 * seconds], [0.0, 7.0 * seconds], planar_pose(first))[-1]
    assert planar_pose(last) == pytest.approx(expected, abs=1e-12)


def test_several_wheels_a_side_are_averaged(station: Station, make: Make) -> None:
    """Four wheels, in two messages: one answer, when the last wheel is known."""
    make(left_wheel_names=['fl', 'rl'], right_wheel_names=['fr', 'rr'])
    heard = station.hear(Odometry, 'odom')
    station.say_until(lambda: heard, 'joint_states', (
        joints(k, fl=0.0, fr=0.0, rl=0.0, rr=0.0) for k in itertools.count(1)))
    heard.clear()
    for k in range(3):
        station.say('joint_states', joints(10**9 * k + 10**6, rr=1.0 * k, arm=5.0, fl=2.0 * k))
        station.say('joint_states', joints(10**9 * k + 2 * 10**6, fr=3.0 * k, rl=4.0 * k))
        wait_until(lambda k=k: len(heard) > k)
    assert [stamp_ns(answer) - 2 * 10**6 for _, answer in heard] == [0, 10**9, 2 * 10**9]
    expected = integrate(DRIVE, [0.0, 6.0], [0.0, 4.0])[-1]
    got = planar_pose(heard[-1][1])
    assert got[:2] == pytest.approx(expected[:2], abs=1e-12)
    assert math.remainder(got[2] - expected[2], 2.0 * math.pi) == pytest.approx(0.0, abs=1e-12)


def test_open_loop_integrates_the_commands_as_applied(station: Station, make: Make) -> None:
    """The wheel that is too slow for the command is taken for what it is."""
    make(open_loop=True, max_wheel_speed=2.5, command_rate=100.0)
    odometry, commands = station.hear(Odometry, 'odom'), station.hear(JointState, 'wheel_commands')
    wait_until(lambda: odometry)
    assert planar_pose(odometry[-1][1]) == [0.0, 0.0, 0.0]
    station.say_until(
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
def test_a_command_turns_each_wheel_at_its_right_speed(
        station: Station, make: Make, linear: float, angular: float) -> None:
    """The default form is a JointState with the velocity of every wheel by its name."""
    make(left_wheel_names=['fl', 'rl'], right_wheel_names=['fr', 'rr'])
    heard = station.hear(JointState, 'wheel_commands')
    wait_until(lambda: station.node.count_publishers('wheel_commands'))
    station.say('cmd_vel', twist(linear, angular))
    wait_until(lambda: heard)
    left = (linear - 0.5 * SEPARATION * angular) / LEFT_RADIUS
    right = (linear + 0.5 * SEPARATION * angular) / RIGHT_RADIUS
    message = heard[0][1]
    assert message.name == ['fl', 'rl', 'fr', 'rr']
    assert list(message.velocity) == pytest.approx([left, left, right, right], rel=1e-12)
    assert message.header.stamp.sec > 0


def test_a_multi_array_has_the_left_wheels_first(station: Station, make: Make) -> None:
    """The form of motor drivers that take an array."""
    make(wheel_command_type='multi_array')
    heard = station.hear(Float64MultiArray, 'wheel_commands')
    wait_until(lambda: station.node.count_publishers('wheel_commands'))
    station.say('cmd_vel', twist(0.1, 0.9))
    wait_until(lambda: heard)
    assert list(heard[0][1].data) == pytest.approx(DRIVE.wheel_speeds(0.1, 0.9))


def test_every_wheel_has_a_topic_of_its_own_in_per_wheel(station: Station, make: Make) -> None:
    """The form of one motor driver a wheel."""
    make(wheel_command_type='per_wheel')
    left = station.hear(Float64, 'left_wheel_joint/command')
    right = station.hear(Float64, 'right_wheel_joint/command')
    wait_until(lambda: station.node.count_publishers('left_wheel_joint/command'))
    wait_until(lambda: station.node.count_publishers('right_wheel_joint/command'))
    station.say('cmd_vel', twist(0.1, 0.9))
    wait_until(lambda: left and right)
    got = left[0][1].data, right[0][1].data
    assert got == pytest.approx(DRIVE.wheel_speeds(0.1, 0.9))


def test_stamped_commands_are_taken_when_asked_for(station: Station, make: Make) -> None:
    """Nav2 and others publish TwistStamped."""
    make(enable_stamped_cmd_vel=True)
    heard = station.hear(JointState, 'wheel_commands')
    wait_until(lambda: station.node.count_publishers('wheel_commands'))
    station.say('cmd_vel', TwistStamped(twist=twist(0.1, 0.9)))
    wait_until(lambda: heard)
    assert list(heard[0][1].velocity) == pytest.approx(DRIVE.wheel_speeds(0.1, 0.9))


def test_no_wheel_command_goes_out_before_the_first_command(
        station: Station, make: Make) -> None:
    """Whoever wants odometry alone has a robot that nobody holds."""
    make(command_rate=200.0)
    heard = station.hear(JointState, 'wheel_commands')
    wait_until(lambda: station.node.count_publishers('wheel_commands'))
    feed(station, [(0.01 * k, 0.02 * k) for k in range(30)])
    assert heard == []


def set_parameters(station: Station, **values: object) -> list[str]:
    """Set parameters one by one; return the reason of each that was refused, '' if it was not."""
    request = SetParameters.Request(parameters=[
        Parameter(name, value=value).to_parameter_msg() for name, value in values.items()])
    answer = station.call(SetParameters, 'odometry/set_parameters', request)
    return ['' if result.successful else result.reason for result in answer.results]


def test_a_live_parameter_takes_effect_at_once(station: Station, make: Make) -> None:
    """The correction of a radius, found by calibration, goes into commands and odometry."""
    make()
    heard = station.hear(JointState, 'wheel_commands')
    wait_until(lambda: station.node.count_publishers('wheel_commands'))
    reasons = set_parameters(station, left_wheel_radius_multiplier=1.25, cmd_vel_timeout=3)
    assert reasons == ['', '']
    station.say('cmd_vel', twist(0.2, 0.3))
    wait_until(lambda: heard)
    longer = DiffDrive(SEPARATION, 1.25 * LEFT_RADIUS, RIGHT_RADIUS)
    assert list(heard[0][1].velocity) == pytest.approx(longer.wheel_speeds(0.2, 0.3))
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
def test_a_wrong_value_is_refused_with_its_rule_and_changes_nothing(
        station: Station, make: Make, name: str, value: float, rule: str) -> None:
    """What `ros2 param set` shows."""
    node = make()
    before = node.get_parameter(name).value
    [reason] = set_parameters(station, **{name: value})
    assert rule in reason
    assert node.get_parameter(name).value == before or math.isnan(before)


def test_a_set_of_changes_is_taken_as_a_whole_or_not_at_all(
        station: Station, make: Make) -> None:
    """Two multipliers from one calibration belong together."""
    node = make()
    request = SetParametersAtomically.Request(parameters=[
        Parameter('left_wheel_radius_multiplier', value=1.1).to_parameter_msg(),
        Parameter('wheel_separation_multiplier', value=-1.0).to_parameter_msg()])
    answer = station.call(
        SetParametersAtomically, 'odometry/set_parameters_atomically', request)
    assert not answer.result.successful
    assert 'wheel_separation_multiplier = -1.0' in answer.result.reason
    assert node.get_parameter('left_wheel_radius_multiplier').value == 1.0


def test_every_parameter_is_described(station: Station, make: Make) -> None:
    """What `ros2 param describe` shows."""
    node = make()
    names = [name for name in node.get_parameters_by_prefix('') if not name.startswith((
        'qos_overrides', 'use_sim_time', 'start_type_description'))]
    assert len(names) > 15
    answer = station.call(
        DescribeParameters, 'odometry/describe_parameters',
        DescribeParameters.Request(names=names))
    assert all(len(descriptor.description) > 20 for descriptor in answer.descriptors)
