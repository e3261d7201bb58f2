"""The dashboard in a real browser: processes that start, end and change."""
from collections.abc import Callable
import os
import signal
import time

from geometry_msgs.msg import Twist
import pytest
from sensor_msgs.msg import JointState
from support.browser import (
    barriers,
    Dashboard,
    missing,
    OBSERVER,
    open_tab,
    Person,
    press_stop,
    release,
    Robot,
    start_driving,
)
from support.station import Process, Station, wait_until

if missing() and not os.environ.get('CI'):
    pytest.skip(f'no tests in a browser: {missing()}', allow_module_level=True)

pytestmark = pytest.mark.browser

TIMEOUT = 0.5  # [s] cmd_vel_timeout, its default
PERIOD = 0.02  # [s] of wheel commands
SLACK = 0.15  # [s] for a machine that does other things too


def test_odometry_started_after_the_stop_is_disabled_too(
        serve: Callable[..., Dashboard], start: Callable[..., Process], observer: Station,
        visit: Callable[..., Person]) -> None:
    """Or other publishers of cmd_vel would drive it; the page shows its state."""
    start('simulator_node')
    first = start('odometry_node')
    robot = Robot(observer)
    person = visit(serve().url)
    person.wait_for('Nobody drives')
    ahead = Twist()
    ahead.linear.x = 0.1

    def is_driven() -> bool:
        observer.publish('cmd_vel', ahead)
        return robot.is_driven()

    wait_until(is_driven, pause=0.05)
    person.page.keyboard.press('Escape')
    person.wait_for('the node inhibits the wheels')
    first.signal(signal.SIGKILL)
    person.page.get_by_text('odom is silent').wait_for()
    person.wait_for('has not confirmed it yet')
    start('odometry_node')
    person.wait_for('the node inhibits the wheels')
    count = len(robot.wheels)
    wait_until(lambda: is_driven() or len(robot.wheels) > count + 50, pause=0.05)
    assert not any(any(message.velocity) for _, message in robot.wheels[count:])
    # Until DDS has removed the dead one, the robot does not count as simulated.
    person.page.get_by_role('button', name='Drive this real robot').wait_for(
        state='hidden', timeout=60000)
    release(person)
    wait_until(is_driven, pause=0.05)


def test_killed_server_stops_the_robot_and_may_be_restarted(
        serve: Callable[..., Dashboard], start: Callable[..., Process], observer: Station,
        visit: Callable[..., Person]) -> None:
    """The page reconnects by itself; the key that stayed down does not drive."""
    start('simulator_node')
    start('odometry_node')
    robot = Robot(observer)
    dashboard = serve()
    person = visit(dashboard.url)
    person.wait_for('Nobody drives')
    start_driving(person, robot)
    moment = time.monotonic()
    dashboard.signal(signal.SIGKILL)
    assert robot.stopped_after(moment) < TIMEOUT + PERIOD + SLACK
    person.page.get_by_role('alert').get_by_text('Connection lost').wait_for()
    assert not person.page.locator('header [role=status]').is_visible()
    count = len(robot.commands)
    serve(port=dashboard.port)
    person.wait_for('press')  # a key, or again
    person.page.wait_for_timeout(500)
    assert not any(twist.linear.x for twist in robot.twists_since(count))
    person.page.keyboard.up('w')
    start_driving(person, robot)


@pytest.mark.parametrize('number', [signal.SIGINT, signal.SIGTERM, signal.SIGHUP])
def test_dashboard_stops_the_robot_before_it_exits(
        domain: int, visit: Callable[..., Person], number: signal.Signals) -> None:
    """With code 0, and its simulated robot exits too."""
    dashboard = Dashboard('--simulate')
    try:
        dashboard.wait_until_it_serves()
        station = Station(domain, OBSERVER)
        try:
            robot = Robot(station)
            person = visit(dashboard.url)
            person.wait_for('Nobody drives')
            start_driving(person, robot)
            dashboard.signal(number)
            assert dashboard.wait() == 0, dashboard.output
            assert not robot.is_driven()
        finally:
            station.close()
    finally:
        dashboard.close()


def test_real_robot_is_display_only_until_it_is_unlocked(
        serve: Callable[..., Dashboard], start: Callable[..., Process], observer: Station,
        station: Station,
        visit: Callable[..., Person]) -> None:
    """Until its next restart; a subscriber that is no simulator makes it a real one."""
    start('simulator_node')
    odometry = start('odometry_node')
    robot = Robot(observer)
    station.subscribe(JointState, 'wheel_commands')  # as a motor driver
    person = visit(serve().url)
    person.wait_for('a real robot')
    assert barriers(person) == []
    person.page.keyboard.down('w')
    person.page.wait_for_timeout(500)
    person.page.keyboard.up('w')
    x, y, theta = robot.pose
    person.drag(person.handles()['body'], 60, 0)
    person.page.get_by_text('This is a real robot').wait_for()
    person.page.get_by_role('button', name='Reset odometry').click()
    assert robot.commands == []
    assert robot.pose == (x, y, theta)
    unlock, agree, refuse = (person.page.get_by_role('button', name=name, exact=True) for name in (
        'Drive this real robot', 'Drive it', 'Display only'))
    unlock.click()
    refuse.click()
    person.page.wait_for_timeout(300)
    person.wait_for('a real robot')
    unlock.click()
    agree.wait_for()
    press_stop(person)  # above the dialog, which covers everything else
    person.wait_for('STOPPED')
    agree.click()
    person.page.get_by_role('button', name='Release the stop').click()
    person.wait_for('Nobody drives')
    start_driving(person, robot)
    refuse.click()
    person.wait_for('a real robot')
    wait_until(lambda: not robot.is_driven())
    person.page.keyboard.up('w')
    unlock.click()
    agree.click()
    person.wait_for('Nobody drives')
    odometry.signal(signal.SIGKILL)
    start('odometry_node')
    person.wait_for('a real robot')


def test_key_held_at_a_real_robot_needs_a_release(
        serve: Callable[..., Dashboard], start: Callable[..., Process], observer: Station,
        station: Station, visit: Callable[..., Person]) -> None:
    """Before it drives a simulated one."""
    start('simulator_node')
    start('odometry_node')
    robot = Robot(observer)
    driver = station.node.create_subscription(JointState, 'wheel_commands', print, 1)
    person = visit(serve().url)
    person.wait_for('a real robot')
    person.page.keyboard.down('w')
    person.page.wait_for_timeout(200)
    station.node.destroy_subscription(driver)
    person.wait_for('Release the controls, and press again')
    assert robot.commands == []
    person.page.keyboard.up('w')
    start_driving(person, robot)


def test_restarted_odometry_is_checked_again(
        serve: Callable[..., Dashboard], start: Callable[..., Process], observer: Station,
        visit: Callable[..., Person]) -> None:
    """Without a cmd_vel_timeout, it is not driven."""
    start('simulator_node')
    odometry = start('odometry_node')
    robot = Robot(observer)
    person = visit(serve().url)
    person.wait_for('Nobody drives')
    start_driving(person, robot)
    odometry.signal(signal.SIGKILL)
    person.wait_for('odom is silent')
    person.page.get_by_text('measured no data').wait_for()
    person.page.get_by_text('Last values').wait_for()
    person.page.wait_for_selector('body.silent')
    person.page.keyboard.up('w')
    start('odometry_node', cmd_vel_timeout=0.0)
    person.wait_for('cmd_vel_timeout is 0')
    person.page.keyboard.down('w')
    count = len(robot.commands)
    person.page.wait_for_timeout(500)
    assert robot.twists_since(count) == []


def test_robot_without_a_cmd_vel_timeout_is_not_driven(
        serve: Callable[..., Dashboard], start: Callable[..., Process], observer: Station,
        visit: Callable[..., Person]) -> None:
    """Nothing would stop it if the dashboard failed."""
    start('simulator_node')
    start('odometry_node', cmd_vel_timeout=0.0)
    robot = Robot(observer)
    person = visit(serve().url)
    person.wait_for('cmd_vel_timeout is 0')
    person.page.keyboard.down('w')
    person.page.wait_for_timeout(500)
    person.page.keyboard.up('w')
    assert robot.commands == []
    # The graph is checked once a second; before that, it counts as real and nothing is set.
    person.page.get_by_role('button', name='Drive this real robot').wait_for(state='hidden')
    open_tab(person, 'Parameters')
    field = person.page.get_by_label('cmd_vel_timeout', exact=True)
    field.fill('0.5')
    field.press('Enter')
    field.blur()
    person.wait_for('Nobody drives')
    start_driving(person, robot)
