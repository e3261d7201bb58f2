"""The robot as the dashboard sees it, and when it may be driven; over DDS, without a browser."""
import asyncio
from collections.abc import Callable
import math
from types import SimpleNamespace

from diagnostic_msgs.msg import DiagnosticStatus, KeyValue
from diffdrive_ros.dashboard.dashboard_node import DashboardNode, NoAnswerError
from diffdrive_ros.dashboard.robot import DashboardRobot, DISABLED, PATIENCE
from diffdrive_ros.dashboard.teleop import Beat, STOP
from diffdrive_ros.node import clock
from diffdrive_ros.node.odometry_node import OdometryNode
from geometry_msgs.msg import Twist
from nav_msgs.msg import Odometry
import pytest
from rclpy.node import Node
from rclpy.parameter import Parameter
from sensor_msgs.msg import JointState
from support.station import GEOMETRY, Station, twist, wait_until

AHEAD = (0.3, 0.0)


@pytest.fixture
def node(station: Station) -> DashboardNode:
    """Return the dashboard's side of ROS."""
    return station.add(DashboardNode(context=station.context))


@pytest.fixture
def robot(node: DashboardNode) -> DashboardRobot:
    """Return the robot as it sees it."""
    return DashboardRobot(node)


@pytest.fixture
def hear_odom(station: Station, robot: DashboardRobot) -> Callable[[], DashboardRobot]:
    """Return a function that lets the robot hear odom, just now, and look."""
    def hear() -> DashboardRobot:
        def is_heard() -> bool:
            station.say('odom', Odometry())
            robot.look()
            return robot.node.odom.age < 0.1

        wait_until(is_heard, pause=0.01)
        robot.look()
        return robot

    return hear


def learn(robot: DashboardRobot) -> None:
    """Let the robot learn its parameters."""
    asyncio.run(robot.learn())


def drive(robot: DashboardRobot) -> None:
    """Let a page drive."""
    for number, asked in enumerate((STOP, AHEAD)):
        now = clock.steady()
        robot.publish(robot.pilot.beat('a', Beat(number, now, asked), now))
    assert robot.pilot.is_moving


def test_a_node_that_was_started_after_the_stop_is_made_to_hold_the_wheels_too(
        make: Callable[..., OdometryNode], hear_odom: Callable[[], DashboardRobot]) -> None:
    """Or others would drive it while the page says STOPPED; once released it is let go."""
    make()
    robot = hear_odom()

    def is_disabled_when_kept() -> bool:
        asyncio.run(robot.keep_stopped())
        return robot.is_disabled

    wait_until(lambda: robot.tells, 5.0)
    assert not is_disabled_when_kept()  # nobody pressed STOP
    robot.pilot.stop()
    wait_until(is_disabled_when_kept, 5.0)
    asyncio.run(robot.release(robot.pilot.stops))
    wait_until(lambda: robot.tells, 5.0)
    assert not is_disabled_when_kept()


def test_what_an_odometry_told_is_not_taken_for_the_word_of_the_next_one(
        make: Callable[..., OdometryNode], hear_odom: Callable[[], DashboardRobot]) -> None:
    """For it may not hold the wheels as the first one did."""
    make()
    robot = hear_odom()
    wait_until(lambda: robot.tells, 5.0)
    arrivals = robot.arrivals
    make()

    def is_there() -> bool:
        robot.look()
        return robot.arrivals > arrivals

    wait_until(is_there, pause=0.01)
    assert not robot.tells
    wait_until(lambda: robot.tells, 5.0)


def test_a_robot_is_not_driven_before_its_parameters_are_known(
        make: Callable[..., OdometryNode], hear_odom: Callable[[], DashboardRobot]) -> None:
    """And then it is."""
    make()
    robot = hear_odom()
    assert 'not known yet' in robot.reason_not_to_drive
    learn(hear_odom())
    assert hear_odom().reason_not_to_drive == ''


@pytest.mark.parametrize(('timeout', 'words'), [
    (0.0, 'is 0'), (2.001, 'above 2 s'), (1e9, 'above 2 s')])
def test_a_robot_that_would_drive_on_for_long_is_not_driven(
        make: Callable[..., OdometryNode], hear_odom: Callable[[], DashboardRobot],
        timeout: float, words: str) -> None:
    """Should this computer fail."""
    make(cmd_vel_timeout=timeout)
    learn(hear_odom())
    assert words in hear_odom().reason_not_to_drive


def test_a_robot_that_tells_its_pose_too_seldom_is_not_driven(
        make: Callable[..., OdometryNode], hear_odom: Callable[[], DashboardRobot]) -> None:
    """Nor is it taken for another one each time; after some while it is silent."""
    make(publish_rate=0.5)
    learn(hear_odom())
    robot = hear_odom()
    message = robot.node.odom.message
    robot.node.parameters_changed_at = 0.0  # the events of the start may come late
    for age, words, is_forgotten in (
            (0.0, 'below 2 Hz', False), (2.9, 'below 2 Hz', False), (3.1, 'silent', True)):
        robot.node.odom = SimpleNamespace(age=age, message=message)
        robot.look()
        assert words in robot.reason_not_to_drive
        assert robot.needs_to_learn is is_forgotten


def test_a_node_of_another_kind_is_named_and_not_asked_all_the_time(
        station: Station, hear_odom: Callable[[], DashboardRobot],
        monkeypatch: pytest.MonkeyPatch) -> None:
    """But after a while, when it has set a parameter, or when somebody else publishes odom."""
    station.add(Node('odometry', context=station.context))
    robot = hear_odom()
    with pytest.raises(NoAnswerError, match='another node than odometry'):
        learn(robot)
    assert not robot.needs_to_learn
    assert hear_odom().reason_not_to_drive == (
        "/odometry is another node than odometry: it has no parameter 'cmd_vel_timeout'")
    robot.node.parameters_changed_at = clock.steady()
    assert robot.needs_to_learn
    robot.node.parameters_changed_at = 0.0
    later = clock.steady() + PATIENCE
    with monkeypatch.context() as patch:
        patch.setattr(clock, 'steady', lambda: later)
        assert robot.needs_to_learn
    station.node.create_publisher(Odometry, 'odom', 1)
    wait_until(lambda: 'not known yet' in hear_odom().reason_not_to_drive)
    assert robot.needs_to_learn


def test_an_odometry_that_started_anew_is_not_driven_before_it_is_known(
        station: Station, make: Callable[..., OdometryNode],
        hear_odom: Callable[[], DashboardRobot]) -> None:
    """A new publisher of odom may have other parameters than the last."""
    odometry = make()
    learn(hear_odom())
    robot = hear_odom()
    drive(robot)
    station.node.create_publisher(Odometry, 'odom', 1)
    wait_until(lambda: 'not known yet' in hear_odom().reason_not_to_drive)
    assert not robot.pilot.is_moving
    assert robot.needs_to_learn
    odometry.set_parameters([Parameter('cmd_vel_timeout', value=0.0)])
    learn(robot)
    assert 'is 0' in hear_odom().reason_not_to_drive


def test_what_was_asked_of_the_odometry_before_is_not_believed(
        station: Station, make: Callable[..., OdometryNode],
        hear_odom: Callable[[], DashboardRobot]) -> None:
    """The answer came from a process that is no more."""
    make()
    robot = hear_odom()
    ask = robot.node.ask

    async def ask_slowly(service: str, request: object) -> object:
        answer = await ask(service, request)
        if service == 'get_parameters':
            station.node.create_publisher(Odometry, 'odom', 1)
            wait_until(lambda: hear_odom() and robot._forgotten > forgotten)
        return answer

    forgotten, robot.node.ask = robot._forgotten, ask_slowly
    learn(robot)
    assert 'not known yet' in robot.reason_not_to_drive


def test_a_robot_whose_odom_falls_silent_is_stopped_and_not_driven(
        make: Callable[..., OdometryNode], hear_odom: Callable[[], DashboardRobot]) -> None:
    """Its driver would be blind; when it is back, it is learned anew."""
    make()
    learn(hear_odom())
    robot = hear_odom()
    assert robot.twist == (0.0, 0.0)
    drive(robot)
    wait_until(lambda: robot.look() or robot.reason_not_to_drive == 'odom is silent')
    assert not robot.pilot.is_moving
    assert robot.pilot.complaint('a') == 'odom is silent'
    assert robot.twist is None
    assert 'not known yet' in hear_odom().reason_not_to_drive


def test_a_message_that_cannot_be_opened_does_not_hide_a_reason_to_stop(
        make: Callable[..., OdometryNode], hear_odom: Callable[[], DashboardRobot]) -> None:
    """It is looked at after the stop."""
    odometry = make()
    learn(hear_odom())
    robot = hear_odom()
    drive(robot)
    odometry.set_parameters([Parameter('cmd_vel_timeout', value=0.0)])
    learn(robot)
    robot.node.odom = SimpleNamespace(age=0.0)
    with pytest.raises(AttributeError):
        robot.look()
    assert not robot.pilot.is_moving


def test_in_open_loop_the_first_command_comes_before_the_first_odom(
        make: Callable[..., OdometryNode], robot: DashboardRobot) -> None:
    """The node is silent until then, and not by a fault."""
    make(open_loop=True)
    wait_until(lambda: robot.look() or robot.node.newcomers_on_odom() or robot._forgotten)
    learn(robot)
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
def test_the_wheels_are_told_however_their_messages_are_cut(
        station: Station, make: Callable[..., OdometryNode], robot: DashboardRobot,
        messages: list[JointState]) -> None:
    """In one, each in its own, beside those of an arm, one after another, or not at all."""
    make()
    learn(robot)

    def is_told() -> bool:
        for message in messages:
            station.say('joint_states', message, listeners=2)
        robot.look()
        return robot.wheels == (5.0, 6.0)

    wait_until(is_told, pause=0.02)


def test_wheels_that_tell_no_speeds_turn_as_the_robot_moves(
        make: Callable[..., OdometryNode], hear_odom: Callable[[], DashboardRobot],
        station: Station) -> None:
    """By its odometry; and where that is silent too, nothing is told."""
    make()
    robot = hear_odom()
    learn(robot)
    assert hear_odom().wheels == (0.0, 0.0)
    message = Odometry()
    message.twist.twist.linear.x = GEOMETRY['wheel_radius']
    station.say_until(
        lambda: robot.look() or robot.wheels == pytest.approx(
            (1.0, 1.0 / GEOMETRY['right_wheel_radius_multiplier'])),
        'odom', iter(lambda: message, None))
    wait_until(lambda: robot.look() or robot.wheels is None)


def test_what_was_asked_long_ago_is_not_told(station: Station, robot: DashboardRobot) -> None:
    """As of everything else that is told."""
    robot.node.prepare(False)
    station.say('cmd_vel', twist(0.2, 0.1))
    wait_until(lambda: robot.asked == (0.2, 0.1))
    wait_until(lambda: robot.asked is None)


def test_others_who_command_are_told_also_if_they_are_called_the_same(
        station: Station, node: DashboardNode) -> None:
    """A second dashboard on the same robot is one too."""
    node.prepare(False)
    wait_until(lambda: node.get_publishers_info_by_topic('cmd_vel'))
    assert node.other_commanders() == []
    others = [DashboardNode(context=station.context), Node('teleop', context=station.context)]
    others[0].prepare(False)
    others[1].create_publisher(Twist, 'cmd_vel', 1)
    wait_until(lambda: node.other_commanders() == ['/dashboard', '/teleop'])
    for other in others:
        other.destroy_node()


def test_a_reset_starts_the_tracks_anew(
        make: Callable[..., OdometryNode], hear_odom: Callable[[], DashboardRobot]) -> None:
    """What was driven before belongs to another origin."""
    make()
    robot = hear_odom()
    assert robot.tracks['odom'].points
    asyncio.run(robot.reset())
    assert not robot.tracks['odom'].points


def answering(robot: DashboardRobot, act: Callable[[], object]) -> list[str]:
    """Let something happen while the node answers; return what it is asked."""
    asked = []

    async def ask(service: str, request: object) -> object:
        asked.append(f'{service} {request.data}')
        act()
        return SimpleNamespace(message='')

    robot.node.ask = ask
    return asked


def test_a_stop_that_is_released_is_released(robot: DashboardRobot) -> None:
    """At the node, and for the pages."""
    robot.pilot.stop()
    asked = answering(robot, lambda: None)
    asyncio.run(robot.release(1))
    assert (asked, robot.pilot.is_stopped) == (['enable True'], False)


def test_a_stop_pressed_while_one_is_released_holds(robot: DashboardRobot) -> None:
    """And the node is held again."""
    robot.pilot.stop()
    asked = answering(robot, robot.pilot.stop)
    asyncio.run(robot.release(1))
    assert (asked, robot.pilot.is_stopped) == (['enable True', 'enable False'], True)


def test_a_release_of_a_stop_does_not_undo_the_next_one(robot: DashboardRobot) -> None:
    """The node is not let go even for a moment."""
    robot.pilot.stop()
    robot.pilot.stop()
    asked = answering(robot, lambda: None)
    asyncio.run(robot.release(1))
    assert (asked, robot.pilot.is_stopped) == (['enable False'], True)


def test_a_parameter_that_was_set_is_no_refusal_if_the_node_falls_silent_then(
        make: Callable[..., OdometryNode], hear_odom: Callable[[], DashboardRobot]) -> None:
    """But the robot is not driven before it is known again."""
    make()
    robot = hear_odom()
    learn(robot)
    ask = robot.node.ask

    async def ask_in_vain(service: str, request: object) -> object:
        if service == 'list_parameters':
            raise NoAnswerError('list_parameters does not answer')
        return await ask(service, request)

    robot.node.ask = ask_in_vain
    assert asyncio.run(robot.set_parameter('cmd_vel_timeout', '0.4')) == ''
    assert 'not known yet' in hear_odom().reason_not_to_drive


def test_only_the_odometry_that_is_watched_counts_as_disabled(robot: DashboardRobot) -> None:
    """Not that of another robot on the same network."""
    status = clock.steady(), SimpleNamespace(message=DISABLED)
    robot.node.diagnostics['/robot2/odometry: commands'] = status
    robot.node.diagnostics['/odometry2: commands'] = status
    assert not robot.is_disabled
    robot.node.diagnostics['/odometry: commands'] = status
    assert robot.is_disabled


def test_a_hold_by_the_node_has_every_key_released_first_however_short_it_was(
        make: Callable[..., OdometryNode], hear_odom: Callable[[], DashboardRobot]) -> None:
    """It began and ended between two looks."""
    make()
    robot = hear_odom()
    learn(robot)
    drive(hear_odom())

    async def hold_for_a_moment() -> None:
        await robot.enable(False)
        await robot.enable(True)

    asyncio.run(hold_for_a_moment())
    wait_until(lambda: robot.look() or not robot.pilot.is_moving)
    assert DISABLED in robot.pilot.complaint('a')


@pytest.mark.parametrize(('statuses', 'stops'), [
    ([('20 Hz', 7), ('20 Hz', 7)], False),
    ([('20 Hz', 7), ('20 Hz', 8)], True),
    ([('20 Hz', 7), ('stopped: no command for 0.5 s', 7)], False),
    ([('20 Hz', 7), ('stopped: no usable joint_states', 7), ('20 Hz', 7)], True),
    ([('stopped: /clock stands still', None)], True)])
def test_a_hold_is_told_by_its_reason_or_by_a_command_that_was_refused(
        make: Callable[..., OdometryNode], hear_odom: Callable[[], DashboardRobot],
        statuses: list[tuple[str, int | None]], stops: bool) -> None:
    """As the node counts them; how many it had refused before is no news."""
    make()
    learn(hear_odom())
    robot = hear_odom()
    drive(robot)
    robot.node.told_of_commands = lambda: [DiagnosticStatus(
        message=message, values=[] if held is None else [
            KeyValue(key='inhibited', value=str(held))])
        for message, held in statuses]
    robot.look()
    assert robot.pilot.is_moving is not stops


@pytest.mark.parametrize(('name', 'namespace', 'topic'), [
    ('odometry', '/', '/cmd_vel'), ('odometry', '/robot2', '/cmd_vel'),
    ('simulator', '/', '/wheel_commands'), ('simulator', '/robot2', '/wheel_commands'),
    ('motor_driver', '/', '/wheel_commands')])
def test_a_robot_is_simulated_where_one_odometry_and_one_simulator_listen_alone(
        station: Station, make: Callable[..., OdometryNode], node: DashboardNode,
        name: str, namespace: str, topic: str) -> None:
    """Whatever a further listener is called, and wherever it lives."""
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
def test_a_robot_is_real_where_another_than_the_watched_node_may_command_the_wheels(
        station: Station, make: Callable[..., OdometryNode], node: DashboardNode,
        interface: str, others: list[str]) -> None:
    """Or where its own commands go elsewhere, as to motors by a topic for each wheel."""
    odometry = make(wheel_command_type=interface)
    simulator = station.add(Node('simulator', context=station.context))
    simulator.create_subscription(JointState, 'wheel_commands', print, 1)
    for name in others:
        other = station.add(Node(name.strip('/'), context=station.context))
        other.create_publisher(JointState, 'wheel_commands', 1)
    names = [odometry.get_fully_qualified_name()] if interface == 'joint_state' else []
    wait_until(lambda: node._listeners('wheel_commands') == ['/simulator']
               and node._listeners('cmd_vel') == ['/odometry']
               and node._senders('wheel_commands') == names + others)
    assert not node.is_simulated()
