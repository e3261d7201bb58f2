"""The robot as the dashboard observes it, and when it may be driven; over DDS, no browser."""
import asyncio
from collections.abc import Callable
import math
from types import SimpleNamespace

from diagnostic_msgs.msg import DiagnosticStatus, KeyValue
from diffdrive_ros.core.wheel_commander import Inhibit, REASONS
from diffdrive_ros.dashboard.dashboard_node import DashboardNode, ServiceError
from diffdrive_ros.dashboard.remote_parameters import MISMATCH_RETRY_S
from diffdrive_ros.dashboard.robot import AXES_95, DashboardRobot, ellipse_of
from diffdrive_ros.dashboard.teleop import Heartbeat, STOP
from diffdrive_ros.node import clock
from diffdrive_ros.node.odometry_node import OdometryNode
from geometry_msgs.msg import Twist
from hypothesis import given, strategies as st
from nav_msgs.msg import Odometry
import numpy as np
import pytest
from rclpy.node import Node
from rclpy.parameter import Parameter
from sensor_msgs.msg import JointState
from support.station import GEOMETRY, Station, twist, wait_until

FORWARD = (0.3, 0.0)


@pytest.fixture
def node(station: Station) -> DashboardNode:
    """Return the node of the dashboard."""
    return station.add(DashboardNode(context=station.context))


@pytest.fixture
def robot(node: DashboardNode) -> DashboardRobot:
    """Return the robot that it observes."""
    return DashboardRobot(node)


@pytest.fixture
def receive_odom(station: Station, robot: DashboardRobot) -> Callable[[], DashboardRobot]:
    """Return a function that has the robot receive a message on odom, and update."""
    def receive() -> DashboardRobot:
        def is_received() -> bool:
            station.say('odom', Odometry())
            robot.update()
            return robot.node.odom.age < 0.1

        wait_until(is_received, pause=0.01)
        robot.update()
        return robot

    return receive


def read_parameters(robot: DashboardRobot) -> None:
    """Have the parameters of the robot read."""
    asyncio.run(robot.parameters.read())


def drive(robot: DashboardRobot) -> None:
    """Have a page drive."""
    for number, command in enumerate((STOP, FORWARD)):
        now = clock.steady()
        robot.publish(robot.teleop.accept('a', Heartbeat(number, now, command), now))
    assert robot.teleop.is_moving


def test_node_started_after_the_stop_is_disabled_too(
        make: Callable[..., OdometryNode], receive_odom: Callable[[], DashboardRobot]) -> None:
    """Or others would drive it while the page shows STOPPED; a release enables it."""
    make()
    robot = receive_odom()

    def is_disabled_when_maintained() -> bool:
        asyncio.run(robot.software_stop.maintain())
        return robot.software_stop.is_confirmed

    wait_until(lambda: robot.commands.is_current, 5.0)
    assert not is_disabled_when_maintained()  # STOP was not pressed
    robot.teleop.stop()
    wait_until(is_disabled_when_maintained, 5.0)
    asyncio.run(robot.software_stop.release(robot.teleop.stop_count))
    wait_until(lambda: robot.commands.is_current, 5.0)
    assert not is_disabled_when_maintained()


def test_status_of_an_earlier_odometry_is_not_current(
        make: Callable[..., OdometryNode], receive_odom: Callable[[], DashboardRobot]) -> None:
    """The next one may not be disabled as the first one was."""
    make()
    robot = receive_odom()
    wait_until(lambda: robot.commands.is_current, 5.0)
    arrivals = robot.commands.arrivals
    make()

    def is_there() -> bool:
        robot.update()
        return robot.commands.arrivals > arrivals

    wait_until(is_there, pause=0.01)
    assert not robot.commands.is_current
    wait_until(lambda: robot.commands.is_current, 5.0)


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


def test_node_that_is_no_odometry_is_named_and_read_rarely(
        station: Station, receive_odom: Callable[[], DashboardRobot],
        monkeypatch: pytest.MonkeyPatch) -> None:
    """After a while, after a change of its parameters, or with a new publisher of odom."""
    station.add(Node('odometry', context=station.context))
    robot = receive_odom()
    with pytest.raises(ServiceError, match='another node than odometry'):
        read_parameters(robot)
    assert not robot.parameters.are_outdated
    assert receive_odom().reason_not_to_drive == (
        "/odometry is another node than odometry: it has no parameter 'cmd_vel_timeout'")
    robot.node.parameters_changed_at = clock.steady()
    assert robot.parameters.are_outdated
    robot.node.parameters_changed_at = 0.0
    later = clock.steady() + MISMATCH_RETRY_S
    with monkeypatch.context() as patch:
        patch.setattr(clock, 'steady', lambda: later)
        assert robot.parameters.are_outdated
    station.node.create_publisher(Odometry, 'odom', 1)
    wait_until(lambda: 'not read yet' in receive_odom().reason_not_to_drive)
    assert robot.parameters.are_outdated


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


def test_parameters_of_an_earlier_odometry_are_discarded(
        station: Station, make: Callable[..., OdometryNode],
        receive_odom: Callable[[], DashboardRobot]) -> None:
    """The response came from a process that ended."""
    make()
    robot = receive_odom()
    call = robot.node.call

    async def call_slowly(service: str, request: object) -> object:
        response = await call(service, request)
        if service == 'get_parameters':
            station.node.create_publisher(Odometry, 'odom', 1)
            wait_until(lambda: receive_odom() and robot.parameters.invalidations > before)
        return response

    before, robot.node.call = robot.parameters.invalidations, call_slowly
    read_parameters(robot)
    assert 'not read yet' in robot.reason_not_to_drive


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
        make: Callable[..., OdometryNode], robot: DashboardRobot) -> None:
    """The node publishes nothing before the first command."""
    make(open_loop=True)
    wait_until(lambda: robot.update() or robot.node.has_new_odom_publisher()
               or robot.parameters.invalidations)
    read_parameters(robot)
    assert robot.reason_not_to_drive == ''


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
        station: Station, make: Callable[..., OdometryNode], robot: DashboardRobot,
        messages: list[JointState]) -> None:
    """In one, each in its own, beside those of an arm, one after another, or not at all."""
    make()
    read_parameters(robot)

    def are_shown() -> bool:
        for message in messages:
            station.say('joint_states', message, listeners=2)
        robot.update()
        return robot.wheels == (5.0, 6.0)

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
    station.say_until(
        lambda: robot.update() or robot.wheels == pytest.approx(
            (1.0, 1.0 / GEOMETRY['right_wheel_radius_multiplier'])),
        'odom', iter(lambda: message, None))
    wait_until(lambda: robot.update() or robot.wheels is None)


def test_command_is_not_shown_after_a_timeout(station: Station, robot: DashboardRobot) -> None:
    """Nor is anything else that was received."""
    robot.node.advertise_commands(False)
    station.say('cmd_vel', twist(0.2, 0.1))
    wait_until(lambda: robot.commanded == (0.2, 0.1))
    wait_until(lambda: robot.commanded is None)


def test_other_commanders_are_found_also_by_the_same_name(
        station: Station, node: DashboardNode) -> None:
    """A second dashboard on the same robot is one."""
    node.advertise_commands(False)
    wait_until(lambda: node.get_publishers_info_by_topic('cmd_vel'))
    assert node.other_commanders() == []
    others = [DashboardNode(context=station.context), Node('teleop', context=station.context)]
    others[0].advertise_commands(False)
    others[1].create_publisher(Twist, 'cmd_vel', 1)
    wait_until(lambda: node.other_commanders() == ['/dashboard', '/teleop'])
    for other in others:
        other.destroy_node()


def test_reset_clears_the_trajectories(
        make: Callable[..., OdometryNode], receive_odom: Callable[[], DashboardRobot]) -> None:
    """They belong to another origin."""
    make()
    robot = receive_odom()
    assert robot.trajectories['odom'].points
    asyncio.run(robot.reset())
    assert not robot.trajectories['odom'].points


def record_calls(robot: DashboardRobot, act: Callable[[], object]) -> list[str]:
    """Act at each call of a service; return the calls."""
    calls = []

    async def call(service: str, request: object) -> object:
        calls.append(f'{service} {request.data}')
        act()
        return SimpleNamespace(message='')

    robot.node.call = call
    return calls


def test_released_stop_enables_node_and_pages(robot: DashboardRobot) -> None:
    """Once."""
    robot.teleop.stop()
    calls = record_calls(robot, lambda: None)
    asyncio.run(robot.software_stop.release(1))
    assert (calls, robot.teleop.is_stopped) == (['enable True'], False)


def test_stop_during_a_release_lasts(robot: DashboardRobot) -> None:
    """The node is disabled again."""
    robot.teleop.stop()
    calls = record_calls(robot, robot.teleop.stop)
    asyncio.run(robot.software_stop.release(1))
    assert (calls, robot.teleop.is_stopped) == (['enable True', 'enable False'], True)


def test_release_of_a_stop_does_not_release_the_next_one(robot: DashboardRobot) -> None:
    """The node is not enabled even for a moment."""
    robot.teleop.stop()
    robot.teleop.stop()
    calls = record_calls(robot, lambda: None)
    asyncio.run(robot.software_stop.release(1))
    assert (calls, robot.teleop.is_stopped) == (['enable False'], True)


def test_parameter_is_set_though_it_cannot_be_read_again(
        make: Callable[..., OdometryNode], receive_odom: Callable[[], DashboardRobot]) -> None:
    """But the robot is not driven before the parameters are read."""
    make()
    robot = receive_odom()
    read_parameters(robot)
    call = robot.node.call

    async def call_in_vain(service: str, request: object) -> object:
        if service == 'list_parameters':
            raise ServiceError('list_parameters does not respond')
        return await call(service, request)

    robot.node.call = call_in_vain
    assert asyncio.run(robot.parameters.change('cmd_vel_timeout', '0.4')) == ''
    assert 'not read yet' in receive_odom().reason_not_to_drive


def test_only_the_observed_odometry_counts_as_disabled(robot: DashboardRobot) -> None:
    """Not that of another robot on the same network."""
    status = clock.steady(), SimpleNamespace(
        values=[KeyValue(key='inhibits', value='disabled')])
    robot.node.diagnostics['/robot2/odometry: commands'] = status
    robot.node.diagnostics['/odometry2: commands'] = status
    assert not robot.software_stop.is_confirmed
    robot.node.diagnostics['/odometry: commands'] = status
    assert robot.software_stop.is_confirmed


def test_short_inhibit_stops_the_robot_too(
        make: Callable[..., OdometryNode], receive_odom: Callable[[], DashboardRobot]) -> None:
    """It began and ended between two updates."""
    make()
    robot = receive_odom()
    read_parameters(robot)
    drive(receive_odom())

    async def inhibit_for_a_moment() -> None:
        await robot.software_stop.enable(False)
        await robot.software_stop.enable(True)

    asyncio.run(inhibit_for_a_moment())
    wait_until(lambda: robot.update() or not robot.teleop.is_moving)
    assert REASONS[Inhibit.DISABLED] in robot.teleop.stop_reason('a')


@pytest.mark.parametrize(('statuses', 'stops'), [
    ([('', 7), ('', 7)], False),
    ([('', 7), ('', 8)], True),
    ([('', 7), (None, 7)], False),
    ([('', 7), ('feedback_timeout', 7), ('', 7)], True),
    ([('clock_stall,disabled', 7)], True),
    ([('of_a_later_version', 7)], True),
    ([('clock_stall', None)], True)])
def test_inhibits_and_ignored_commands_stop_the_robot(
        make: Callable[..., OdometryNode], receive_odom: Callable[[], DashboardRobot],
        statuses: list[tuple[str | None, int | None]], stops: bool) -> None:
    """By keys of the status; how many commands were ignored before does not count."""
    make()
    read_parameters(receive_odom())
    robot = receive_odom()
    drive(robot)
    robot.node.take_command_statuses = lambda: [DiagnosticStatus(values=[
        KeyValue(key=key, value=str(value))
        for key, value in (('inhibits', inhibits), ('inhibited', count)) if value is not None])
        for inhibits, count in statuses]
    robot.update()
    assert robot.teleop.is_moving is not stops


@pytest.mark.parametrize(('name', 'namespace', 'topic'), [
    ('odometry', '/', '/cmd_vel'), ('odometry', '/robot2', '/cmd_vel'),
    ('simulator', '/', '/wheel_commands'), ('simulator', '/robot2', '/wheel_commands'),
    ('motor_driver', '/', '/wheel_commands')])
def test_robot_is_simulated_without_any_other_subscriber(
        station: Station, make: Callable[..., OdometryNode], node: DashboardNode,
        name: str, namespace: str, topic: str) -> None:
    """Of any name, in any namespace."""
    make()
    simulator = Node('simulator', context=station.context)
    simulator.create_subscription(JointState, 'wheel_commands', print, 1)
    wait_until(node.is_simulated)
    other = Node(name, namespace=namespace, context=station.context)
    kind = Twist if topic == '/cmd_vel' else JointState
    other.create_subscription(kind, topic, print, 1)
    wait_until(lambda: not node.is_simulated())
    other.destroy_node()
    simulator.destroy_node()


@pytest.mark.parametrize(('interface', 'others'), [
    ('per_wheel', []), ('none', ['/odometry2']), ('joint_state', ['/odometry2'])])
def test_robot_is_real_if_other_nodes_may_command_the_wheels(
        station: Station, make: Callable[..., OdometryNode], node: DashboardNode,
        interface: str, others: list[str]) -> None:
    """Or if the commands go elsewhere, as on a topic for each wheel."""
    odometry = make(wheel_command_type=interface)
    simulator = station.add(Node('simulator', context=station.context))
    simulator.create_subscription(JointState, 'wheel_commands', print, 1)
    for name in others:
        other = station.add(Node(name.strip('/'), context=station.context))
        other.create_publisher(JointState, 'wheel_commands', 1)
    names = [odometry.get_fully_qualified_name()] if interface == 'joint_state' else []
    wait_until(lambda: node._subscriber_names('wheel_commands') == ['/simulator']
               and node._subscriber_names('cmd_vel') == ['/odometry']
               and node._publisher_names('wheel_commands') == names + others)
    assert not node.is_simulated()


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
