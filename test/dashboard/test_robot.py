"""The robot as the dashboard observes it, and when it may be driven; over DDS, no browser."""
import asyncio
from collections.abc import Callable
import math
from types import SimpleNamespace

from diffdrive_ros.dashboard.robot import AXES_95, DashboardRobot, ellipse_of
from diffdrive_ros.node.odometry_node import OdometryNode
from hypothesis import given, strategies as st
from nav_msgs.msg import Odometry
import numpy as np
import pytest
from rclpy.parameter import Parameter
from sensor_msgs.msg import JointState
from support.observed_robot import drive, read_parameters
from support.station import GEOMETRY, Station, twist, wait_until


def test_robot_is_not_driven_before_its_parameters_are_known(
        make: Callable[..., OdometryNode], receive_odom: Callable[[], DashboardRobot]) -> None:
    """And then it is."""
    make()
    robot = receive_odom()
    assert 'not read yet' in robot.reason_not_to_drive
    read_parameters(receive_odom())
    assert receive_odom().reason_not_to_drive == ''


@pytest.mark.parametrize(('timeout', 'words'), [
    (0.0, 'is 0'), (2.001, 'above 2 s'), (1e9, 'above 2 s')])
def test_robot_with_an_unsafe_cmd_vel_timeout_is_not_driven(
        make: Callable[..., OdometryNode], receive_odom: Callable[[], DashboardRobot],
        timeout: float, words: str) -> None:
    """Should this computer fail."""
    make(cmd_vel_timeout=timeout)
    read_parameters(receive_odom())
    assert words in receive_odom().reason_not_to_drive


def test_robot_with_slow_odom_is_not_driven(
        make: Callable[..., OdometryNode], receive_odom: Callable[[], DashboardRobot]) -> None:
    """Its parameters stay known between two messages; after a timeout it is silent."""
    make(publish_rate=0.5)
    read_parameters(receive_odom())
    robot = receive_odom()
    message = robot.node.odom.message
    robot.node.parameters_changed_at = 0.0  # the events of the start may be late
    for age, words, are_outdated in (
            (0.0, 'below 2 Hz', False), (2.9, 'below 2 Hz', False), (3.1, 'silent', True)):
        robot.node.odom = SimpleNamespace(age=age, message=message)
        robot.update()
        assert words in robot.reason_not_to_drive
        assert robot.parameters.are_outdated is are_outdated


def test_restarted_odometry_is_not_driven_before_it_is_read(
        station: Station, make: Callable[..., OdometryNode],
        receive_odom: Callable[[], DashboardRobot]) -> None:
    """A new publisher of odom may have other parameters."""
    odometry = make()
    read_parameters(receive_odom())
    robot = receive_odom()
    drive(robot)
    station.node.create_publisher(Odometry, 'odom', 1)
    wait_until(lambda: 'not read yet' in receive_odom().reason_not_to_drive)
    assert not robot.teleop.is_moving
    assert robot.parameters.are_outdated
    odometry.set_parameters([Parameter('cmd_vel_timeout', value=0.0)])
    read_parameters(robot)
    assert 'is 0' in receive_odom().reason_not_to_drive


def test_robot_whose_odom_falls_silent_is_stopped(
        make: Callable[..., OdometryNode], receive_odom: Callable[[], DashboardRobot]) -> None:
    """Its driver would not see it; when odom is back, the parameters are read again."""
    make()
    read_parameters(receive_odom())
    robot = receive_odom()
    assert robot.twist == (0.0, 0.0)
    drive(robot)
    wait_until(lambda: robot.update() or robot.reason_not_to_drive == 'odom is silent')
    assert not robot.teleop.is_moving
    assert robot.teleop.stop_reason('a') == 'odom is silent'
    assert robot.twist is None
    assert 'not read yet' in receive_odom().reason_not_to_drive


def test_invalid_message_does_not_prevent_the_stop(
        make: Callable[..., OdometryNode], receive_odom: Callable[[], DashboardRobot]) -> None:
    """It is deserialized after the stop."""
    odometry = make()
    read_parameters(receive_odom())
    robot = receive_odom()
    drive(robot)
    odometry.set_parameters([Parameter('cmd_vel_timeout', value=0.0)])
    read_parameters(robot)
    robot.node.odom = SimpleNamespace(age=0.0)
    with pytest.raises(AttributeError):
        robot.update()
    assert not robot.teleop.is_moving


def test_open_loop_is_driven_before_its_first_odom(
        make: Callable[..., OdometryNode], observed: DashboardRobot) -> None:
    """The node publishes nothing before the first command."""
    make(open_loop=True)
    wait_until(lambda: observed.update() or observed.node.has_new_odom_publisher()
               or observed.parameters.invalidations)
    read_parameters(observed)
    assert observed.reason_not_to_drive == ''


def speeds(**wheels: float) -> JointState:
    """Return a message with speeds of joints [rad/s] by their names, and no positions."""
    return JointState(name=list(wheels), velocity=[float(speed) for speed in wheels.values()])


@pytest.mark.parametrize('messages', [
    [speeds(left_wheel_joint=5.0, right_wheel_joint=6.0)],
    [speeds(left_wheel_joint=5.0), speeds(right_wheel_joint=6.0)],
    [speeds(left_wheel_joint=5.0, right_wheel_joint=6.0), speeds(elbow=1.0),
     JointState(name=['left_wheel_joint'], position=[1.0])],
    [speeds(left_wheel_joint=1.0, right_wheel_joint=2.0),
     speeds(left_wheel_joint=5.0, right_wheel_joint=6.0)],
    [speeds(left_wheel_joint=5.0, right_wheel_joint=6.0),
     speeds(left_wheel_joint=math.nan, right_wheel_joint=math.nan)]])
def test_wheel_speeds_are_shown_from_any_messages(
        station: Station, make: Callable[..., OdometryNode], observed: DashboardRobot,
        messages: list[JointState]) -> None:
    """In one, each in its own, beside those of an arm, one after another, or not at all."""
    make()
    read_parameters(observed)

    def are_shown() -> bool:
        for message in messages:
            station.publish('joint_states', message, subscribers=2)
        observed.update()
        return observed.wheels == (5.0, 6.0)

    wait_until(are_shown, pause=0.02)


def test_wheels_without_speeds_are_shown_by_odometry(
        make: Callable[..., OdometryNode], receive_odom: Callable[[], DashboardRobot],
        station: Station) -> None:
    """And if that is silent too, there are none."""
    make()
    robot = receive_odom()
    read_parameters(robot)
    assert receive_odom().wheels == (0.0, 0.0)
    message = Odometry()
    message.twist.twist.linear.x = GEOMETRY['wheel_radius']
    station.publish_until(
        lambda: robot.update() or robot.wheels == pytest.approx(
            (1.0, 1.0 / GEOMETRY['right_wheel_radius_multiplier'])),
        'odom', iter(lambda: message, None))
    wait_until(lambda: robot.update() or robot.wheels is None)


def test_command_is_not_shown_after_a_timeout(station: Station, observed: DashboardRobot) -> None:
    """Nor is anything else that was received."""
    observed.node.advertise_commands(False)
    station.publish('cmd_vel', twist(0.2, 0.1))
    wait_until(lambda: observed.commanded == (0.2, 0.1))
    wait_until(lambda: observed.commanded is None)


def test_reset_clears_the_trajectories(
        make: Callable[..., OdometryNode], receive_odom: Callable[[], DashboardRobot]) -> None:
    """They belong to another origin."""
    make()
    robot = receive_odom()
    assert robot.trajectories['odom'].points
    asyncio.run(robot.reset())
    assert not robot.trajectories['odom'].points


@given(st.floats(0.01, 3.0), st.floats(0.01, 1.0), st.floats(-1.5, 1.5))
def test_ellipse_of_a_covariance_has_its_axes(long: float, share: float, angle: float) -> None:
    """Whatever its direction."""
    short = 0.9 * share * long
    turn = np.array([[math.cos(angle), -math.sin(angle)], [math.sin(angle), math.cos(angle)]])
    got = ellipse_of(turn @ np.diag([long**2, short**2]) @ turn.T)
    assert got[:2] == pytest.approx((AXES_95 * long, AXES_95 * short))
    assert math.sin(got[2] - angle) == pytest.approx(0.0, abs=1e-6)


def test_invalid_covariance_has_no_ellipse() -> None:
    """One that is not finite, or not positive semidefinite."""
    assert ellipse_of([[math.nan, 0.0], [0.0, 1.0]]) is None
    assert ellipse_of([[math.inf, 0.0], [0.0, 1.0]]) is None
    assert ellipse_of([[-1.0, 0.0], [0.0, 1.0]]) is None
    assert ellipse_of([[1.0, 2.0], [2.0, 1.0]]) is None
