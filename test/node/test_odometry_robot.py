"""The node odometry among the things that happen on a robot, in this process."""
from collections.abc import Callable, Iterator
import itertools
import math
import re
import time
from types import SimpleNamespace

from builtin_interfaces.msg import Time
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from diffdrive_ros.core.kinematics import DiffDrive
from diffdrive_ros.node.odometry_node import OdometryNode
from geometry_msgs.msg import PoseWithCovarianceStamped, TwistStamped
from nav_msgs.msg import Odometry
import numpy as np
import pytest
from rcl_interfaces.msg import Parameter as ParameterMessage, ParameterType, ParameterValue
from rcl_interfaces.srv import SetParameters
from rclpy.parameter import Parameter
from rclpy.qos import QoSProfile, ReliabilityPolicy
from rclpy.serialization import serialize_message
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import JointState
from std_srvs.srv import SetBool, Trigger
from support.station import (
    is_ramp,
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

Make = Callable[..., OdometryNode]
Logged = Callable[[], str]


def angles(start_ns: int = 10**9, period_ns: int = 10_000_000) -> itertools.count:
    """Return messages of wheels that turn, without end."""
    return (
        joints(start_ns + k * period_ns, left_wheel_joint=0.03 * k, right_wheel_joint=0.05 * k)
        for k in itertools.count())


def driving(station: Station) -> list:
    """Return what is received of the wheels once they turn."""
    received = station.subscribe(JointState, 'wheel_commands')
    station.publish_until(
        lambda: received and received[-1][1].velocity[0], 'cmd_vel',
        itertools.repeat(twist(0.4, 0.1)))
    return received


def stands(message: JointState) -> bool:
    """Return whether a wheel command is zero."""
    return list(message.velocity) == [0.0, 0.0]


def test_reset_odometry_answers_when_the_pose_is_zero(station: Station, make: Make) -> None:
    """The next odom starts at zero."""
    make()
    received = station.subscribe(Odometry, 'odom')
    messages = angles()
    station.publish_until(lambda: len(received) > 5, 'joint_states', messages)
    assert received[-1][1].pose.pose.position.x > 0.001
    answer = station.call(Trigger, 'odometry/reset_odometry', Trigger.Request())
    assert answer.success
    count = len(received)
    station.publish('joint_states', next(messages))
    wait_until(lambda: len(received) > count)
    moved = 0.5 * (0.03 * LEFT_RADIUS + 0.05 * RIGHT_RADIUS)
    assert 0.0 < received[count][1].pose.pose.position.x < 3.0 * moved


def pose_message(
        frame: str, x: float, y: float, yaw: float, variance: float = 0.04,
) -> PoseWithCovarianceStamped:
    """Return a pose with a covariance of its own."""
    message = PoseWithCovarianceStamped()
    message.header.frame_id = frame
    message.pose.pose.position.x, message.pose.pose.position.y = x, y
    message.pose.pose.orientation.z = math.sin(0.5 * yaw)
    message.pose.pose.orientation.w = math.cos(0.5 * yaw)
    for place, value in ((0, variance), (7, 0.09), (35, 0.01)):
        message.pose.covariance[place] = value
    return message


def test_set_pose_sets_pose_and_covariance(station: Station, make: Make) -> None:
    """As robot_localization's, but private, so that both run in one namespace."""
    node = make()
    station.publish('odometry/set_pose', pose_message('odom', 3.0, -4.0, 2.0))
    wait_until(lambda: node._odom.odometry.pose[0] == 3.0)
    received = station.subscribe(Odometry, 'odom')
    station.publish_until(lambda: received, 'joint_states', (
        joints(k, left_wheel_joint=1.0, right_wheel_joint=2.0) for k in itertools.count(1)))
    pose = received[0][1].pose
    assert (pose.pose.position.x, pose.pose.position.y) == (3.0, -4.0)
    assert 2.0 * math.atan2(pose.pose.orientation.z, pose.pose.orientation.w) == pytest.approx(2.0)
    assert [pose.covariance[place] for place in (0, 7, 35)] == pytest.approx([0.04, 0.09, 0.01])


@pytest.mark.parametrize(('message', 'rule'), [
    (pose_message('map', 1.0, 2.0, 0.0), "frame_id = 'map': must be 'odom'"),
    (pose_message('', 1.0, 2.0, 0.0), "frame_id = '': must be 'odom'"),
    (pose_message('odom', math.nan, 2.0, 0.0), 'must be finite'),
    (PoseWithCovarianceStamped(), "frame_id = '': must be 'odom'"),
    (pose_message('odom', 1e300, 2.0, 0.0), 'must be finite and below 1e+09 m'),
    (pose_message('odom', 1.0, 2.0, 0.0, variance=1e308), 'must have no variance above 1e+12'),
])
def test_invalid_set_pose_is_rejected(
        station: Station, make: Make, logged: Callable[[], str],
        message: PoseWithCovarianceStamped, rule: str) -> None:
    """Nothing changes, and the reason is logged."""
    node = make()
    station.publish('odometry/set_pose', message)
    wait_until(lambda: rule in logged())
    assert node._odom.odometry.pose.tolist() == [0.0, 0.0, 0.0]


def test_disabled_wheels_stay_zero_until_a_new_command(
        station: Station, make: Make) -> None:
    """Commands during the inhibit are not driven after it."""
    make()
    received = driving(station)
    answer = station.call(SetBool, 'odometry/enable', SetBool.Request(data=False))
    assert answer.success
    wait_until(lambda: stands(received[-1][1]))
    count = len(received)
    for _ in range(10):
        station.publish('cmd_vel', twist(0.4, 0.1))
        time.sleep(0.02)
    station.call(SetBool, 'odometry/enable', SetBool.Request(data=True))
    after = len(received)
    wait_until(lambda: len(received) > after + 5)
    assert all(stands(message) for _, message in received[count:])
    station.publish_until(
        lambda: not stands(received[-1][1]), 'cmd_vel', itertools.repeat(twist(0.4, 0.1)))


def test_short_inhibit_is_in_diagnostics(
        station: Station, make: Make) -> None:
    """The status of once a second would miss it."""
    make()
    received = station.subscribe(DiagnosticArray, '/diagnostics')
    wait_until(lambda: received)
    for data in (False, True):
        station.call(SetBool, 'odometry/enable', SetBool.Request(data=data))

    def commands() -> list[tuple[str, str]]:
        return [(status.message, value.value) for _, message in received
                for status in message.status for value in status.values
                if status.name.endswith('commands') and value.key == 'inhibits']

    wait_until(lambda: commands()[-1] == ('no command yet', '') and len(commands()) > 2)
    assert ('stopped: disabled by ~/enable', 'disabled') in commands()


def test_new_reason_of_a_stop_is_logged_after_another(
        station: Station, make: Make, logged: Logged) -> None:
    """The last reason counts."""
    make()
    driving(station)
    station.publish('cmd_vel', twist(math.nan, 0.0))
    wait_until(lambda: 'must be finite; wheels stopped' in logged())
    station.call(SetBool, 'odometry/enable', SetBool.Request(data=False))
    wait_until(lambda: 'disabled by ~/enable; wheels stopped' in logged())


def test_enable_answers_with_the_remaining_inhibits(station: Station, make: Make) -> None:
    """The next command is driven only without any."""
    make(feedback_timeout=0.1, cmd_vel_timeout=0)
    station.publish_until(
        lambda: station.call(SetBool, 'odometry/enable', SetBool.Request(data=True)).message
        == 'the wheels are inhibited: no usable joint_states', 'cmd_vel',
        itertools.repeat(twist(0.4, 0.1)))


def test_first_command_is_inhibited_by_feedback_timeout(
        station: Station, make: Make) -> None:
    """It is counted with the others."""
    node = make(feedback_timeout=0.1, cmd_vel_timeout=0)
    wait_until(lambda: time.monotonic() - node._odom.sampled_at > 0.2)
    station.publish('cmd_vel', twist(0.4, 0.1))
    wait_until(lambda: node._commander.counts['commands'])
    assert node._commander.counts['inhibited'] == node._commander.counts['commands']


def test_clock_beyond_2038_is_rejected(
        station: Station, make: Make, logged: Logged) -> None:
    """The seconds of timestamps end there; joint_states without one would get it."""
    node = make()
    node.get_clock = lambda: SimpleNamespace(
        now=lambda: SimpleNamespace(nanoseconds=2**31 * 10**9 + 7))
    station.publish_until(lambda: 'must be before 2038' in logged(), 'joint_states', (
        joints(0, left_wheel_joint=0.1 * k, right_wheel_joint=0.2 * k) for k in itertools.count()))
    assert node._odom.feedback.counts['unreadable']


def test_limits_without_effect_warn_once_also_live(
        station: Station, make: Make, logged: Logged) -> None:
    """A minimum without its maximum has no effect; without acceleration the robot stays."""
    node = make(angular__z__min_velocity=-1.0)
    assert 'angular.z: without effect, since their maximum is not set: min_velocity' in logged()
    for value in (-0.1, -0.2):
        node.set_parameters([Parameter('linear.x.min_velocity', value=value)])
    node.set_parameters([Parameter('linear.x.max_acceleration', value=0.0)])
    assert logged().count('linear.x: without effect') == 1
    assert logged().count('angular.z: without effect') == 1
    assert 'linear.x.max_acceleration = 0.0: the robot never starts' in logged()


def test_missing_wheel_is_logged_without_any_command(
        station: Station, make: Make, logged: Logged) -> None:
    """No odom, and a new robot's user reads the log first."""
    make()
    station.publish_until(lambda: 'waiting for right_wheel_joint' in logged(), 'joint_states', (
        joints(k, left_wheel_joint=1.0) for k in itertools.count(1)))


def test_names_of_a_late_driver_are_logged_after_silence(
        station: Station, make: Make, logged: Logged) -> None:
    """The driver starts when the node has warned of no message already."""
    make()
    wait_until(lambda: 'no message for 2 s' in logged())
    station.publish_until(
        lambda: 'received other; waiting for left_wheel_joint' in logged(), 'joint_states',
        (joints(k, other=1.0) for k in itertools.count(1)))
    assert logged().count('no message for 2 s') == 1


def test_open_loop_rejects_a_clock_beyond_2038(
        station: Station, make: Make, logged: Logged) -> None:
    """The wheels are commanded all the same."""
    node = make(open_loop=True)
    received = driving(station)
    ticks = []
    node._command_loop._sender.send = lambda *arguments: ticks.append(arguments)
    node.get_clock = lambda: SimpleNamespace(now=lambda: SimpleNamespace(
        nanoseconds=2**31 * 10**9 + 7, to_msg=lambda: Time(sec=2**31 - 1)))
    wait_until(lambda: len(ticks) > 3)
    assert 'joint_states: the clock is at 2147483648 s: must be before 2038' in logged()
    assert received


def test_change_of_clock_stops_by_the_deceleration_limit(
        station: Station, make: Make, logged: Logged) -> None:
    """The time since the last step is unknown, which is no reason to stop at once."""
    node = make(linear__x__max_acceleration=100.0, linear__x__max_deceleration=-1.0)
    received = driving(station)
    node.set_parameters([Parameter('use_sim_time', value=True)])
    wait_until(lambda: stands(received[-1][1]))
    speeds = [message.velocity[0] for _, message in received]
    assert max(-np.diff(speeds)) < 0.3 * max(speeds)
    assert 'clock' in logged()


def test_disable_before_any_command_sends_zeros(
        station: Station, make: Make) -> None:
    """Another node may have set the wheels turning."""
    make()
    received = station.subscribe(JointState, 'wheel_commands')
    wait_until(lambda: station.node.count_publishers('wheel_commands'))
    station.call(SetBool, 'odometry/enable', SetBool.Request(data=False))
    wait_until(lambda: len(received) > 3)
    assert all(stands(message) for _, message in received)


def test_applied_twist_is_published_where_enabled(station: Station, make: Make) -> None:
    """Limited by the acceleration, step by step."""
    make(publish_limited_velocity=True, linear__x__max_acceleration=1.0)
    received = station.subscribe(TwistStamped, 'odometry/cmd_vel_out')
    station.publish_until(
        lambda: received and received[-1][1].twist.linear.x == 0.4, 'cmd_vel',
        itertools.repeat(twist(0.4, 0.1)))
    ramp = [message for _, message in received if message.twist.linear.x < 0.4]
    assert is_ramp(ramp, [message.twist.linear.x for message in ramp], 1.0)
    assert received[0][1].header.frame_id == 'base_link'


def test_stop_uses_the_deceleration_but_no_jerk_limit(
        station: Station, make: Make) -> None:
    """After the timeout the wheels slow down evenly to exactly zero."""
    make(linear__x__max_acceleration=100.0, linear__x__max_deceleration=-2.0,
         linear__x__max_jerk=1e6, linear__x__min_jerk=-0.1, cmd_vel_timeout=0.2)
    received = station.subscribe(JointState, 'wheel_commands')
    station.publish_until(
        lambda: received and received[-1][1].velocity[0] > 8.0, 'cmd_vel',
        itertools.repeat(twist(0.4, 0.0)))
    wait_until(lambda: stands(received[-1][1]))
    left = [message.velocity[0] * LEFT_RADIUS for _, message in received]
    last_full = max(k for k, speed in enumerate(left) if speed == pytest.approx(0.4))
    end = left.index(0.0, last_full)
    ramp = [message for _, message in received[last_full:end]]
    assert is_ramp(ramp, left[last_full:end], -2.0)
    assert not any(left[end:])


def test_odom_is_thinned_to_publish_rate_by_timestamp(station: Station, make: Make) -> None:
    """Of a hundred messages a second, each fourth."""
    make(publish_rate=25.0)
    received = station.subscribe(Odometry, 'odom')
    station.publish_until(lambda: received, 'joint_states', angles())
    received.clear()
    for message in itertools.islice(angles(start_ns=10**10), 41):
        station.publish('joint_states', message)
    wait_until(lambda: received and stamp_ns(received[-1][1]) >= 10**10 + 400_000_000)
    steps = np.diff([stamp_ns(message) for _, message in received])
    assert len(received) >= 10
    assert set(steps.tolist()) == {40_000_000}


def test_split_wheels_get_the_newest_timestamp(station: Station, make: Make) -> None:
    """The older message may arrive last."""
    make()
    received = station.subscribe(Odometry, 'odom')
    station.publish_until(lambda: received, 'joint_states', angles())
    received.clear()
    for k in range(1, 4):
        station.publish('joint_states', joints(10**10 * k + 9_000_000, left_wheel_joint=0.1))
        station.publish('joint_states', joints(10**10 * k, right_wheel_joint=0.1))
        wait_until(lambda k=k: len(received) == k)
    assert [stamp_ns(message) for _, message in received] == [
        10**10 * k + 9_000_000 for k in range(1, 4)]


def test_time_reset_continues_with_the_same_pose(station: Station, make: Make) -> None:
    """A bag loops: odom has the new timestamps, and the pose does not jump."""
    make()
    received = station.subscribe(Odometry, 'odom')
    station.publish_until(lambda: received, 'joint_states', angles(start_ns=10**12))
    for message in itertools.islice(angles(start_ns=10**12 + 10**10), 20):
        station.publish('joint_states', message)
    wait_until(lambda: stamp_ns(received[-1][1]) == 10**12 + 10**10 + 190_000_000)
    before = received[-1][1].pose.pose.position
    received.clear()
    for message in itertools.islice(angles(start_ns=10**9), 5):
        station.publish('joint_states', message)
    wait_until(lambda: len(received) == 4)
    assert stamp_ns(received[0][1]) == 10**9 + 10_000_000
    after = received[0][1].pose.pose.position
    assert math.hypot(after.x - before.x, after.y - before.y) < 0.01
    assert received[-1][1].twist.twist.angular.z == pytest.approx(
        DRIVE.body_twist(3.0, 5.0)[1], rel=1e-9)


def test_best_effort_driver_is_received(station: Station, make: Make) -> None:
    """As micro-ROS boards and sensor data are."""
    make()
    received = station.subscribe(Odometry, 'odom')
    publisher = station.node.create_publisher(
        JointState, 'joint_states',
        QoSProfile(depth=5, reliability=ReliabilityPolicy.BEST_EFFORT))
    messages = angles()
    wait_until(lambda: received or publisher.publish(next(messages)), pause=0.05)


def diagnostics(station: Station) -> Callable[[], dict[str, DiagnosticStatus]]:
    """Return a function that returns the last status by its short name."""
    received = station.subscribe(DiagnosticArray, '/diagnostics')

    def last() -> dict[str, DiagnosticStatus]:
        if not received:
            return {}
        return {status.name.partition(': ')[2]: status for status in received[-1][1].status}

    return last


def test_diagnostics_have_rates_and_counters(
        station: Station, make: Make) -> None:
    """Under the full name of the node."""
    make(max_plausible_wheel_speed=60.0)
    last = diagnostics(station)
    wait_until(last)
    assert last()['feedback'].level == DiagnosticStatus.WARN
    assert last()['commands'].level == last()['geometry'].level == DiagnosticStatus.OK
    assert last()['feedback'].hardware_id == '/odometry'
    received = station.subscribe(Odometry, 'odom')
    messages = angles()
    station.publish_until(lambda: len(received) > 5, 'joint_states', messages)
    glitch = next(messages)
    glitch.position = [glitch.position[0] + 100.0, glitch.position[1]]
    station.publish('joint_states', glitch)
    station.publish('joint_states', next(messages))
    station.publish('joint_states', joints(1, arm=3.0))
    station.publish('cmd_vel', twist(math.nan, 0.0))

    def figures(name: str) -> dict[str, str]:
        return {item.key: item.value for item in last()[name].values}

    wait_until(lambda: figures('feedback').get('glitches') == '1')
    assert figures('feedback')['without_wheels'] == '1'
    assert float(figures('feedback')['rate [Hz]']) > 0.0
    assert last()['feedback'].level == DiagnosticStatus.OK
    wait_until(lambda: figures('commands').get('not_finite') == '1')
    assert last()['commands'].level == DiagnosticStatus.WARN
    assert 'must be finite' in last()['commands'].message
    wait_until(lambda: last()['feedback'].level == DiagnosticStatus.ERROR)
    assert 'no message' in last()['feedback'].message


def test_unreadable_payload_is_counted_and_loses_nothing(
        station: Station, make: Make, logged: Logged) -> None:
    """Bytes that claim to be a JointState, between two that are."""
    make()
    last, odom = diagnostics(station), station.subscribe(Odometry, 'odom')
    wait_until(last)
    messages = angles()
    station.publish_until(lambda: odom, 'joint_states', messages)
    whole = serialize_message(next(messages))
    station.publish('joint_states', whole[:60])
    wait_until(lambda: 'unreadable' in logged())
    assert re.search(r'joint_states: unreadable: a \w+ ends at byte \d+ of 60: must end', logged())
    count = len(odom)
    station.publish('joint_states', next(messages))
    wait_until(lambda: len(odom) > count)
    wait_until(lambda: {item.key: item.value for item in last()['feedback'].values}.get(
        'unreadable') == '1')


@pytest.mark.parametrize(('stamps', 'why'), [
    (itertools.repeat(5 * 10**9), r'\d+ out_of_order'),
    (itertools.repeat(2 * 10**9), r'\d+ out_of_order'),
])
def test_stuck_timestamp_is_logged_as_the_reason(
        station: Station, make: Make, logged: Logged, stamps: Iterator[int], why: str) -> None:
    """All are received, and none is usable."""
    make()
    odom = station.subscribe(Odometry, 'odom')
    station.publish_until(lambda: odom, 'joint_states', angles(start_ns=5 * 10**9 - 20_000_000))
    station.publish_until(lambda: 'no usable sample' in logged(), 'joint_states', (
        joints(stamp, left_wheel_joint=1.0, right_wheel_joint=2.0) for stamp in stamps))
    assert re.search(rf'no usable sample for 2 s \({why}\)', logged())


def test_second_kind_of_faulty_feedback_is_logged_too(
        station: Station, make: Make, logged: Logged) -> None:
    """A failing encoder glitches, and then has no value."""
    make(max_plausible_wheel_speed=60.0)
    odom = station.subscribe(Odometry, 'odom')
    messages = angles()
    station.publish_until(lambda: odom, 'joint_states', messages)
    glitch = next(messages)
    glitch.position = [glitch.position[0] + 100.0, glitch.position[1]]
    station.publish('joint_states', glitch)
    wait_until(lambda: 'faster than max_plausible_wheel_speed' in logged())

    def broken() -> Iterator[JointState]:
        for message in messages:
            message.position = [math.nan, message.position[1]]
            yield message

    station.publish_until(lambda: 'left_wheel_joint = nan' in logged(), 'joint_states', broken())


def test_parameter_of_wrong_type_is_rejected_live(
        station: Station, make: Make) -> None:
    """An empty list for a number, as no command line sends it."""
    make()
    for kind in (
            ParameterType.PARAMETER_DOUBLE_ARRAY, ParameterType.PARAMETER_INTEGER_ARRAY,
            ParameterType.PARAMETER_STRING):
        answer = station.call(SetParameters, 'odometry/set_parameters', SetParameters.Request(
            parameters=[ParameterMessage(
                name='cmd_vel_timeout', value=ParameterValue(type=kind))]))
        assert not answer.results[0].successful
    driving(station)


def test_unknown_qos_override_warns(
        station: Station, make: Make, logged: Logged) -> None:
    """A typo would leave the defaults without a word."""
    make(**{'qos_overrides./odmo.publisher.depth': 5})
    assert 'qos_overrides./odmo.publisher.depth: no parameter' in logged()
    assert 'the nearest is qos_overrides./odom.publisher.depth' in logged()


def test_example_robot_keeps_diagnostics_at_warn(station: Station) -> None:
    """Until a geometry is given."""
    station.add(OdometryNode(context=station.context))
    last = diagnostics(station)
    wait_until(last)
    assert last()['geometry'].level == DiagnosticStatus.WARN


def test_wrong_joint_names_are_logged_with_the_missing(
        station: Station, make: Make, logged: Callable[[], str]) -> None:
    """The driver's names are not the parameters'."""
    make()
    wait_until(lambda: station.publish('joint_states', joints(1, wheel_l=1.0, wheel_r=2.0))
               or 'received wheel_l, wheel_r; waiting for left_wheel_joint, right_wheel_joint'
               in logged(), pause=0.2)


def test_velocities_alone_warn_of_position_feedback_once(
        station: Station, make: Make, logged: Callable[[], str]) -> None:
    """Once, not with every message."""
    make()
    for k in range(20):
        station.publish('joint_states', JointState(
            name=['left_wheel_joint', 'right_wheel_joint'], velocity=[1.0, float(k)]))
        station.publish('joint_states', joints(1, arm=1.0))
    wait_until(lambda: 'position_feedback' in logged())
    time.sleep(0.1)
    assert logged().count('position_feedback') == 1


def test_sideways_command_warns_once_and_is_ignored(
        station: Station, make: Make, logged: Callable[[], str]) -> None:
    """No wheel can drive it."""
    make()
    received = station.subscribe(JointState, 'wheel_commands')
    message = twist(0.2, 0.0)
    message.linear.y = 0.5
    station.publish_until(lambda: len(received) > 3, 'cmd_vel', itertools.repeat(message))
    assert list(received[-1][1].velocity) == pytest.approx(DRIVE.wheel_speeds(0.2, 0.0))
    assert logged().count('more than linear.x and angular.z') == 1


def test_feedback_timeout_stops_the_wheels(station: Station, make: Make) -> None:
    """The next command after feedback is back is driven."""
    make(feedback_timeout=0.3, cmd_vel_timeout=0)
    messages, odometry = angles(), station.subscribe(Odometry, 'odom')
    station.publish_until(lambda: odometry, 'joint_states', messages)
    received = driving(station)
    wait_until(lambda: stands(received[-1][1]))
    for _ in range(5):
        station.publish('joint_states', next(messages))
        station.publish('cmd_vel', twist(0.4, 0.1))
        time.sleep(0.05)
    assert not stands(received[-1][1])


def test_clock_stall_stops_the_wheels(station: Station, make: Make) -> None:
    """Commands age in simulation time; a second of real time without it is a timeout."""
    make(use_sim_time=True, cmd_vel_timeout=100.0)
    received = station.subscribe(JointState, 'wheel_commands')

    def tick(k: int) -> None:
        clock = Clock()
        clock.clock.sec, clock.clock.nanosec = 5, k * 1_000_000
        station.publish('/clock', clock)
        station.publish('cmd_vel', twist(0.4, 0.1))

    ticks = itertools.count()
    wait_until(
        lambda: (received and not stands(received[-1][1])) or tick(next(ticks)), pause=0.02)
    stopped_ticking = time.monotonic()
    wait_until(lambda: stands(received[-1][1]))
    assert 0.7 < received[-1][0] - stopped_ticking < 1.5


def test_commands_age_in_simulation_time(station: Station, make: Make) -> None:
    """A simulation at a tenth of real time gives them ten times as long."""
    make(use_sim_time=True, cmd_vel_timeout=0.1)
    received = station.subscribe(JointState, 'wheel_commands')
    ticks = itertools.count()

    def tick() -> int:
        k = next(ticks)
        clock = Clock()
        clock.clock.sec, clock.clock.nanosec = 5 + k // 1000, k % 1000 * 1_000_000
        station.publish('/clock', clock)
        return k

    wait_until(lambda: (received and not stands(received[-1][1])) or (
        tick() >= 0 and station.publish('cmd_vel', twist(0.4, 0.1))), pause=0.01)
    first = tick()
    wait_until(lambda: stands(received[-1][1]) or tick() < 0, pause=0.01)
    assert 90 <= next(ticks) - first < 115


def test_open_loop_has_no_feedback_timeout(
        station: Station, make: Make, logged: Logged) -> None:
    """Also where simulation time stands for longer than the timeout."""
    node = make(open_loop=True, use_sim_time=True, feedback_timeout=0.1, cmd_vel_timeout=0)
    clock = Clock()
    clock.clock.sec = 5
    station.publish_until(
        lambda: node.get_clock().now().nanoseconds, '/clock', itertools.repeat(clock))
    station.publish_until(
        lambda: (time.monotonic() - node._odom.sampled_at > 0.3
                 and node._commander.counts['commands'] > 9),
        'cmd_vel', itertools.repeat(twist(0.4, 0.1)))
    assert 'joint_states' not in node._commander.stop_reason
    assert 'no usable joint_states' not in logged()


def test_stop_waits_for_the_acknowledgement(station: Station, make: Make) -> None:
    """On every topic of the wheels, after all were sent."""
    node = make(wheel_command_type='per_wheel')
    node._command_loop._is_commanding = True
    order = []

    class Publisher:

        def publish(self, message: object) -> None:
            order.append(('publish', message.data))

        def wait_for_all_acked(self, timeout: object) -> None:
            order.append(('wait', timeout.nanoseconds <= 500_000_000))

    node._command_loop._sender.publishers = [Publisher(), Publisher()]
    node.stop_wheels()
    assert order == [('publish', 0.0), ('publish', 0.0), ('wait', True), ('wait', True)]


def test_transform_equals_odom(station: Station, make: Make) -> None:
    """Same timestamp, frames and pose, where tf2_msgs is."""
    tf2_msgs = pytest.importorskip('tf2_msgs.msg', reason='no tf2_msgs: see .ci/tf2_msgs')
    make(tf_frame_prefix='robot1')
    odometry = station.subscribe(Odometry, 'odom')
    transforms = station.subscribe(tf2_msgs.TFMessage, '/tf')
    station.publish_until(
        lambda: len(odometry) > 5 and len(transforms) > 5, 'joint_states', angles())
    by_stamp = {stamp_ns(message): message for _, message in odometry}
    [transform] = transforms[-1][1].transforms
    message = by_stamp[stamp_ns(transform)]
    assert transform.header.frame_id == message.header.frame_id == 'robot1/odom'
    assert transform.child_frame_id == message.child_frame_id == 'robot1/base_link'
    position, translation = message.pose.pose.position, transform.transform.translation
    assert (translation.x, translation.y) == (position.x, position.y)
    assert transform.transform.rotation == message.pose.pose.orientation


def test_no_transform_is_published_where_disabled(station: Station, make: Make) -> None:
    """A filter beside it publishes it."""
    pytest.importorskip('tf2_msgs.msg', reason='no tf2_msgs: see .ci/tf2_msgs')
    node = make(enable_odom_tf=False)
    assert '/tf' not in [publisher.topic_name for publisher in node.publishers]


def test_tilde_prefixes_frames_with_the_namespace(station: Station) -> None:
    """As diff_drive_controller does for an empty prefix."""
    node = OdometryNode(context=station.context, namespace='fleet/r2', parameter_overrides=[
        Parameter('tf_frame_prefix', value='~')])
    assert (node._config.odom_frame, node._config.base_frame) == (
        'fleet/r2/odom', 'fleet/r2/base_link')
    node.destroy_node()


def test_covariance_diagonal_replaces_the_covariance(
        station: Station, make: Make) -> None:
    """The parameters of diff_drive_controller; zeros are not set."""
    diagonal = [0.001, 0.002, 1e6, 1e5, 1e4, 0.03]
    make(pose_covariance_diagonal=diagonal)
    received = station.subscribe(Odometry, 'odom')
    station.publish_until(lambda: len(received) > 3, 'joint_states', angles())
    pose, twist = (np.reshape(part.covariance, (6, 6)) for part in (
        received[-1][1].pose, received[-1][1].twist))
    np.testing.assert_array_equal(pose, np.diag(diagonal))
    assert twist[0, 0] > 0.0


def test_only_documented_names_are_used(station: Station, make: Make) -> None:
    """Others have set_pose, enable, reset, cmd_vel_out and odometry/filtered in a namespace."""
    node = make(publish_limited_velocity=True)

    def names(found: list[tuple[str, list[str]]]) -> dict[str, str]:
        return {name: kinds[0] for name, kinds in found
                if not name.startswith(('/rosout', '/parameter_events')) and 'param' not in name}

    published = names(node.get_publisher_names_and_types_by_node('odometry', '/'))
    published.pop('/tf', None)  # where tf2_msgs is
    assert published == {
        '/diagnostics': 'diagnostic_msgs/msg/DiagnosticArray',
        '/odom': 'nav_msgs/msg/Odometry',
        '/odometry/cmd_vel_out': 'geometry_msgs/msg/TwistStamped',
        '/wheel_commands': 'sensor_msgs/msg/JointState'}
    assert names(node.get_subscriber_names_and_types_by_node('odometry', '/')) == {
        '/cmd_vel': 'geometry_msgs/msg/Twist',
        '/joint_states': 'sensor_msgs/msg/JointState',
        '/odometry/set_pose': 'geometry_msgs/msg/PoseWithCovarianceStamped'}
    services = names(node.get_service_names_and_types_by_node('odometry', '/'))
    services.pop('/odometry/get_type_description', None)
    assert services == {
        '/odometry/enable': 'std_srvs/srv/SetBool',
        '/odometry/reset_odometry': 'std_srvs/srv/Trigger'}


def test_namespaces_separate_robots_in_one_domain(station: Station) -> None:
    """The wheels of one do not move the odometry of the other."""
    nodes = [station.add(OdometryNode(context=station.context, namespace=name)) for name in 'ab']
    received = {name: station.subscribe(Odometry, f'/{name}/odom') for name in 'ab'}
    station.publish_until(lambda: len(received['a']) > 5, '/a/joint_states', angles())
    assert received['b'] == []
    assert nodes[0]._odom.odometry.pose[0] > 0.0
    assert nodes[1]._odom.odometry.pose[0] == 0.0
