"""The dashboard in a real browser: see the robot, drive it, and stop whatever happens."""
from collections.abc import Callable, Iterator
import math
import os
import signal
import socket
import time
from types import SimpleNamespace

from geometry_msgs.msg import Twist
from nav_msgs.msg import Odometry
import pytest
from rcl_interfaces.srv import GetParameters
from sensor_msgs.msg import JointState
from support.browser import Browsers, CHROMIUM, Dashboard, Link, missing, Person
from support.station import Process, Station, wait_until

if missing() and not os.environ.get('CI'):
    pytest.skip(f'no tests in a browser: {missing()}', allow_module_level=True)

pytestmark = pytest.mark.browser

TIMEOUT = 0.5  # [s] cmd_vel_timeout, its default
PERIOD = 0.02  # [s] of wheel commands
SLACK = 0.15  # [s] for a machine that does other things too

OBSERVER = '_ros2cli_station'  # subscribes as ros2 topic echo does, and is no motor driver


class Robot:
    """What the robot of a test does, as a station receives it."""

    def __init__(self, station: Station) -> None:
        self.station = station
        self.odom = station.hear(Odometry, 'odom')
        self.wheels = station.hear(JointState, 'wheel_commands')
        self.commands = station.hear(Twist, 'cmd_vel')
        wait_until(lambda: self.odom, 40.0)  # processes may have just been started

    @property
    def pose(self) -> tuple[float, float, float]:
        """Return the pose of the odometry."""
        pose = self.odom[-1][1].pose.pose
        return (pose.position.x, pose.position.y,
                2.0 * math.atan2(pose.orientation.z, pose.orientation.w))

    def is_driven(self) -> bool:
        """Return whether the newest wheel command is not zero."""
        return bool(self.wheels) and any(self.wheels[-1][1].velocity)

    def stopped_after(self, moment: float, patience: float = 10.0) -> float:
        """Return the time from a moment to the last wheel command that is not zero [s]."""
        wait_until(lambda: time.monotonic() > moment + 1.0 and not self.is_driven(), patience)
        last = max((at for at, message in list(self.wheels) if any(message.velocity)), default=0)
        return last - moment

    def twists_since(self, count: int) -> list[Twist]:
        """Return the commands since there were count of them."""
        return [message for _, message in self.commands[count:]]


@pytest.fixture(scope='module')
def chromium() -> Iterator:
    """Return the browser."""
    assert not missing(), missing()
    from playwright.sync_api import sync_playwright

    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=CHROMIUM, args=['--no-sandbox'])
        yield browser
        browser.close()


@pytest.fixture(scope='module')
def shared(domain_of_module: int) -> Iterator[SimpleNamespace]:
    """Return a dashboard with its simulated robot, for the tests that leave them whole."""
    dashboard = Dashboard('--simulate')
    dashboard.wait_until_it_serves()
    station = Station(domain_of_module, OBSERVER)
    yield SimpleNamespace(dashboard=dashboard, robot=Robot(station))
    station.close()
    dashboard.close()


@pytest.fixture
def visit(chromium: object) -> Iterator[Callable[..., Person]]:
    """Return a function that opens a page and returns its user."""
    contexts = []

    def open_page(url: str, **options: object) -> Person:
        contexts.append(chromium.new_context(**options))
        page = contexts[-1].new_page()
        page.goto(url)
        page.wait_for_selector('canvas[data-drawn]')
        return Person(page)

    yield open_page
    for context in contexts:
        context.close()


@pytest.fixture
def robot(shared: SimpleNamespace) -> Robot:
    """Return the shared robot."""
    return shared.robot


@pytest.fixture
def person(shared: SimpleNamespace, visit: Callable[..., Person]) -> Person:
    """Return the user of the only page of the shared dashboard."""
    person = visit(shared.dashboard.url)
    person.wait_for('Nobody drives')
    return person


def start_driving(person: Person, robot: Robot, key: str = 'w') -> None:
    """Press a key until the robot is driven, and hold it."""
    person.press(key, robot.is_driven)


def open_tab(person: Person, name: str) -> None:
    """Open one of the panels."""
    person.page.get_by_role('tab', name=name).click()


# See it


def test_page_draws_smoothly_from_its_own_server_alone(
        shared: SimpleNamespace, chromium: object) -> None:
    """And logs no error on the console."""
    requests, errors = [], []
    page = chromium.new_page()
    try:
        page.on('request', lambda request: requests.append(request.url))
        page.on('websocket', lambda socket: requests.append(socket.url.replace('ws', 'http', 1)))
        page.on('pageerror', lambda error: errors.append(error))
        page.on('console', lambda line: line.type == 'error' and errors.append(line.text))
        page.goto(shared.dashboard.url)
        page.wait_for_selector('canvas[data-drawn]')
        drawn = 'Number(document.querySelector("canvas").dataset.drawn)'
        before, start = page.evaluate(drawn), time.monotonic()
        page.wait_for_timeout(2000)
        rate = (page.evaluate(drawn) - before) / (time.monotonic() - start)
    finally:
        page.close()
    assert errors == []
    assert len(requests) > 5
    assert [url for url in requests if not url.startswith(
        (shared.dashboard.url, 'data:', 'blob:'))] == []
    assert 5.0 < rate < 25.0  # 20 where nothing else runs


def test_page_shows_numbers_and_diagnostics(person: Person) -> None:
    """Pose, matrices, speeds and statuses."""
    person.page.get_by_text('T_odom_base =').wait_for()
    text = person.page.locator('.layout').inner_text()
    for words in ('T_odom_base =', 'T_odom_left', 'H =', 'H⁺ =', '30.3030', 'applied'):
        assert words in text
    open_tab(person, 'Diagnostics')
    person.page.get_by_text('OK /odometry: feedback: 50 Hz').wait_for()


def test_map_follows_the_robot_until_it_is_dragged(person: Person) -> None:
    """At any zoom; Follow shows whether it does, and makes it do so again."""
    follow = person.page.get_by_role('button', name='Follow')
    canvas = person.page.locator('canvas').bounding_box()

    def is_visible() -> bool:
        x, y = person.handles()['body']
        return (canvas['x'] < x < canvas['x'] + canvas['width']
                and canvas['y'] < y < canvas['y'] + canvas['height'])

    person.page.get_by_label('x [m]').fill('0.7')
    person.page.get_by_role('button', name='Set pose').click()
    person.page.get_by_text('x = 0.700 m').wait_for()
    for _ in range(6):
        person.page.get_by_role('button', name='Zoom in').click()
    wait_until(is_visible)
    assert follow.get_attribute('aria-pressed') == 'true'
    person.drag((canvas['x'] + 15, canvas['y'] + 15), canvas['width'] - 30, 0)
    person.page.locator('[aria-pressed=false]').get_by_text('Follow').wait_for()
    assert not is_visible()
    follow.click()
    person.page.locator('[aria-pressed=true]').get_by_text('Follow').wait_for()
    wait_until(is_visible)
    person.page.get_by_role('button', name='Reset odometry').click()
    person.page.get_by_text('x = 0.000 m').wait_for()


# Drive it


def test_keyboard_drives_a_square(person: Person, robot: Robot) -> None:
    """Forward and left, four times, back to the start."""
    start = robot.pose
    for side in range(4):
        x, y, _ = robot.pose
        person.hold('w', lambda x=x, y=y: math.dist(robot.pose[:2], (x, y)) > 0.25)
        target = start[2] + (side + 1) * math.pi / 2.0
        person.hold('ArrowLeft', lambda target=target: math.remainder(
            robot.pose[2] - target, 2.0 * math.pi) > -0.12)
        wait_until(lambda: not robot.is_driven())
    assert math.dist(robot.pose[:2], start[:2]) < 0.2
    assert abs(math.remainder(robot.pose[2] - start[2], 2.0 * math.pi)) < 0.5


def fingers_on(person: Person) -> Callable[..., None]:
    """Return a function that sends touch events with any number of fingers."""
    session = person.page.context.new_cdp_session(person.page)

    def touch(kind: str, *places: tuple[float, float]) -> None:
        session.send('Input.dispatchTouchEvent', {'type': kind, 'touchPoints': [
            {'x': right, 'y': down, 'id': number}
            for number, (right, down) in enumerate(places)]})

    return touch


def centre_of(element: object) -> tuple[float, float]:
    """Return the centre of an element on the page."""
    box = element.bounding_box()
    return box['x'] + box['width'] / 2, box['y'] + box['height'] / 2


@pytest.mark.parametrize('device', ['mouse', 'touch'])
def test_joystick_drives_while_it_is_held(
        shared: SimpleNamespace, visit: Callable[..., Person], robot: Robot, device: str) -> None:
    """Up and right is forward and clockwise."""
    person = visit(shared.dashboard.url, has_touch=True)
    person.wait_for('Nobody drives')
    x, y = centre_of(person.page.locator('.joystick'))
    count = len(robot.commands)
    if device == 'mouse':
        person.page.mouse.move(x, y)
        person.page.mouse.down()
        person.page.mouse.move(x + 40, y - 40)
        wait_until(robot.is_driven)
        person.page.mouse.up()
    else:
        touch = fingers_on(person)
        touch('touchStart', (x, y))
        touch('touchMove', (x + 40, y - 40))
        wait_until(robot.is_driven)
        touch('touchEnd')
    released = time.monotonic()
    assert robot.stopped_after(released) < TIMEOUT
    driven = [twist for twist in robot.twists_since(count) if twist.linear.x]
    assert all(twist.linear.x > 0.0 > twist.angular.z for twist in driven)


def test_joystick_drives_after_a_button_loses_the_focus(
        person: Person, robot: Robot) -> None:
    """The button loses the focus, and the page keeps it."""
    person.page.get_by_role('button', name='Zoom in').click()
    x, y = centre_of(person.page.locator('.joystick'))
    person.page.mouse.move(x, y)
    person.page.mouse.down()
    person.page.mouse.move(x, y - 40)
    wait_until(robot.is_driven)
    person.page.mouse.up()
    released = time.monotonic()
    assert robot.stopped_after(released) < TIMEOUT


def test_notification_does_not_take_touches(
        shared: SimpleNamespace, visit: Callable[..., Person]) -> None:
    """On a phone it covers the joystick."""
    small = visit(shared.dashboard.url, has_touch=True, viewport={'width': 390, 'height': 844})
    press_stop(small)
    small.wait_for('STOPPED')
    notice = small.page.locator('.q-notification').first
    wait_until(lambda: centre_of(notice)[1] < 830.0)  # it comes from below
    below = small.page.evaluate(
        '([x, y]) => document.elementFromPoint(x, y).closest(".q-notification")?.className',
        centre_of(notice))
    release(small)
    assert below is None


def test_speed_limits_are_kept(person: Person, robot: Robot) -> None:
    """And can be set by the keyboard."""
    slider = person.page.get_by_role('slider', name='Max speed [m/s]')
    slider.focus()
    for _ in range(5):
        slider.press('ArrowLeft')
    person.page.get_by_text('Max speed [m/s]: 0.05').wait_for()
    count = len(robot.commands)
    slider.press('ArrowRight')
    person.page.get_by_text('Max speed [m/s]: 0.10').wait_for()
    assert robot.twists_since(count) == []  # that arrow was for the slider
    start_driving(person, robot)
    person.page.keyboard.up('w')
    assert max(twist.linear.x for twist in robot.twists_since(count)) == pytest.approx(0.1)


# Stop it


def release_key(person: Person) -> None:
    """Release the key that drives."""
    person.page.keyboard.up('w')


def lose_focus(person: Person) -> None:
    """Give the focus to another window."""
    person.page.evaluate('window.dispatchEvent(new Event("blur"))')


def hide(person: Person) -> None:
    """Cover the page by another tab."""
    person.page.evaluate("""
        Object.defineProperty(document, 'visibilityState', { get: () => 'hidden' });
        document.dispatchEvent(new Event('visibilitychange'));""")


def close(person: Person) -> None:
    """Close the page."""
    person.page.close()


def leave(person: Person) -> None:
    """Open another address."""
    person.page.goto('about:blank')


def hang(person: Person) -> None:
    """Have the page compute for ever."""
    person.page.evaluate('setTimeout(() => { while (true); }, 0)')


def press_stop(person: Person) -> None:
    """Click STOP."""
    person.page.get_by_role('button', name='STOP the robot').click()


def release(person: Person) -> None:
    """Release the stop, and wait until the page shows it."""
    person.page.get_by_role('button', name='Release the stop').click()
    person.wait_for('drive')


def press_escape(person: Person) -> None:
    """Press the key of STOP."""
    person.page.keyboard.press('Escape')


@pytest.mark.parametrize('act', [
    release_key, lose_focus, hide, close, leave, hang, press_stop, press_escape])
def test_robot_stops_when_its_controls_are_released(
        person: Person, robot: Robot, act: Callable[[Person], None]) -> None:
    """In any way, within cmd_vel_timeout; a key that is still down does not drive."""
    start_driving(person, robot)
    moment = time.monotonic()
    act(person)
    done = time.monotonic()
    assert robot.stopped_after(moment) < done - moment + TIMEOUT
    if act in (press_stop, press_escape):
        person.wait_for('STOPPED')
        person.page.keyboard.up('w')
        person.page.get_by_role('button', name='Release the stop').click()
        person.wait_for('You drive')
        assert not robot.is_driven()
        start_driving(person, robot)


def test_second_finger_on_stop_stops_the_robot(
        shared: SimpleNamespace, visit: Callable[..., Person], robot: Robot) -> None:
    """Browsers send no click for its touch."""
    person = visit(shared.dashboard.url, has_touch=True)
    person.wait_for('Nobody drives')
    touch = fingers_on(person)
    x, y = centre_of(person.page.locator('.joystick'))
    touch('touchStart', (x, y))
    touch('touchMove', (x, y - 50))
    wait_until(robot.is_driven)
    moment = time.monotonic()
    touch('touchStart', (x, y - 50), centre_of(person.page.locator('.stop')))
    assert robot.stopped_after(moment) < TIMEOUT
    person.wait_for('STOPPED')
    touch('touchEnd')
    release(person)


def test_page_that_moves_under_a_finger_keeps_the_command(
        shared: SimpleNamespace, visit: Callable[..., Person], robot: Robot) -> None:
    """The finger did not move on the screen."""
    person = visit(shared.dashboard.url, has_touch=True)
    person.wait_for('Nobody drives')
    stick = person.page.locator('.joystick')
    (x, y), place = centre_of(stick), stick.bounding_box()
    touch = fingers_on(person)
    touch('touchStart', (x, y))
    touch('touchMove', (x, y - 20))
    wait_until(robot.is_driven)
    before = robot.commands[-1][1].linear.x
    person.page.evaluate('document.querySelector(".layout").style.marginTop = "40px"')
    wait_until(lambda: stick.bounding_box()['y'] > place['y'] + 20.0)
    count = len(robot.commands)
    touch('touchMove', (x, y - 20.5))
    wait_until(lambda: len(robot.commands) > count + 5)
    touch('touchEnd')
    assert robot.twists_since(count)[4].linear.x == pytest.approx(before, abs=0.01)


@pytest.mark.parametrize(('width', 'height'), [(320, 640), (390, 844), (667, 375), (861, 600)])
def test_joystick_does_not_move_when_buttons_appear(
        shared: SimpleNamespace, visit: Callable[..., Person], person: Person,
        robot: Robot, width: int, height: int) -> None:
    """A finger may be on it; nor does STOP move, on the smallest phone."""
    start_driving(person, robot)
    small = visit(
        shared.dashboard.url, has_touch=True, viewport={'width': width, 'height': height})
    pages = {person: '.joystick', small: '.joystick, .stop'}

    def places() -> list[object]:
        small.page.evaluate('scrollTo(0, 0)')  # a click scrolls to its element
        return [each.bounding_box() for page, what in pages.items()
                for each in page.page.locator(what).all()]

    small.wait_for('Another page drives')
    small.page.get_by_role('button', name='Take control').wait_for()
    before = places()
    assert len(before) == 3
    press_stop(small)
    for page in pages:
        page.wait_for('STOPPED')
        page.page.get_by_role('button', name='Release the stop').wait_for()
    assert places() == before
    person.page.keyboard.up('w')
    release(person)
    small.wait_for('Another page drives')
    assert places() == before


def test_click_on_stop_is_one_stop(person: Person) -> None:
    """With or without a pointer event; a key is one too."""
    stop = person.page.get_by_role('button', name='STOP the robot')
    shown = person.page.evaluate('window.drawnFrame.stopCount')
    for number, press in enumerate((
            stop.click, lambda: stop.press('Enter'), lambda: stop.dispatch_event('click')), 1):
        press()
        person.page.wait_for_function(
            'count => window.drawnFrame.stopCount >= count', arg=shown + number)
        person.page.wait_for_timeout(200)
        assert person.page.evaluate('window.drawnFrame.stopCount') == shown + number
    release(person)


def test_escape_is_stop_while_a_list_is_open(person: Person, robot: Robot) -> None:
    """It closes the list too."""
    open_tab(person, 'Parameters')
    person.page.get_by_label('linear.x.has_jerk_limits', exact=True).click()
    person.page.locator('.q-menu').wait_for()
    person.page.keyboard.press('Escape')
    person.wait_for('STOPPED')
    person.page.locator('.q-menu').wait_for(state='detached')
    person.page.get_by_role('button', name='Release the stop').click()
    person.wait_for('press')


def test_meta_releases_keys_whose_keyup_would_be_missing(
        person: Person, robot: Robot) -> None:
    """As on macOS while Meta is down."""
    start_driving(person, robot)
    moment = time.monotonic()
    person.page.keyboard.down('Meta')
    assert robot.stopped_after(moment) < TIMEOUT
    person.page.keyboard.up('Meta')


def test_held_key_needs_a_new_press_after_a_stop(person: Person, robot: Robot) -> None:
    """Repetitions by the keyboard are no new press."""
    start_driving(person, robot)
    moment = time.monotonic()
    lose_focus(person)
    robot.stopped_after(moment)
    count = len(robot.commands)
    for _ in range(5):
        person.page.keyboard.down('w')  # a repetition, for it was never released
        person.page.wait_for_timeout(50)
    assert robot.twists_since(count) == []


def test_suspended_browser_stops_the_robot(
        person: Person, robot: Robot) -> None:
    """Its heartbeats end; when it resumes, its controls are released."""
    start_driving(person, robot)
    browsers = Browsers()
    moment = time.monotonic()
    browsers.signal(signal.SIGSTOP)
    try:
        assert robot.stopped_after(moment) < TIMEOUT
        count = len(robot.commands)
    finally:
        browsers.signal(signal.SIGCONT)
    person.page.wait_for_timeout(1000)
    assert not any(twist.linear.x for twist in robot.twists_since(count))


def test_delayed_packets_stop_the_robot_and_are_dropped(
        shared: SimpleNamespace, visit: Callable[..., Person], robot: Robot) -> None:
    """The key stays down meanwhile."""
    link = Link(shared.dashboard.port)
    try:
        person = visit(link.url)
        person.wait_for('Nobody drives')
        start_driving(person, robot)
        moment = time.monotonic()
        link.cut()
        assert robot.stopped_after(moment) < TIMEOUT
        person.page.wait_for_selector('body.lost', timeout=1500)  # [ms]; it was cut 1 s ago
        count = len(robot.commands)
        link.mend()
        person.page.wait_for_selector('body:not(.lost)')
        person.page.wait_for_timeout(1500)
        assert not any(twist.linear.x for twist in robot.twists_since(count))
    finally:
        for context in [person.page.context]:
            context.close()
        link.close()


def test_delayed_clicks_change_nothing(
        shared: SimpleNamespace, visit: Callable[..., Person], person: Person,
        robot: Robot) -> None:
    """Least of all a later stop."""
    link = Link(shared.dashboard.port)
    try:
        other = visit(link.url)
        press_stop(other)
        person.wait_for('STOPPED')
        other.wait_for('STOPPED')
        pose = robot.pose
        link.cut()
        other.page.get_by_role('button', name='Release the stop').click()
        other.page.get_by_label('x [m]').fill('9')
        other.page.get_by_role('button', name='Set pose').click()
        release(person)
        person.wait_for('Nobody drives')
        press_stop(person)
        person.wait_for('STOPPED')
        link.mend()
        other.page.get_by_text('The latency was too high').first.wait_for()
        person.page.wait_for_timeout(500)
        person.wait_for('STOPPED')
        assert robot.pose == pose
        release(person)
    finally:
        other.page.context.close()
        link.close()


# Two pages


def test_one_page_drives_until_another_takes_control(
        shared: SimpleNamespace, visit: Callable[..., Person], person: Person,
        robot: Robot) -> None:
    """Keys on the other page are ignored until then."""
    start_driving(person, robot)
    person.page.keyboard.up('w')
    wait_until(lambda: not robot.is_driven())
    other = visit(shared.dashboard.url)
    other.wait_for('Another page drives')
    count = len(robot.commands)
    other.page.keyboard.down('w')
    other.page.wait_for_timeout(500)
    other.page.keyboard.up('w')
    assert not any(twist.linear.x for twist in robot.twists_since(count))
    start_driving(person, robot)
    moment = time.monotonic()
    other.page.get_by_role('button', name='Take control').click()
    assert robot.stopped_after(moment) < TIMEOUT + 0.5
    other.wait_for('You drive')
    person.wait_for('Another page drives')
    start_driving(other, robot)


def test_any_page_can_stop(
        shared: SimpleNamespace, visit: Callable[..., Person], person: Person,
        robot: Robot) -> None:
    """And the driver cannot drive before the stop is released."""
    start_driving(person, robot)
    other = visit(shared.dashboard.url)
    moment = time.monotonic()
    press_stop(other)
    assert robot.stopped_after(moment) < TIMEOUT + 0.5
    person.wait_for('STOPPED')
    person.page.keyboard.up('w')
    person.page.get_by_role('button', name='Release the stop').click()
    start_driving(person, robot)


# Drag it


def test_dragged_robot_sets_the_pose(person: Person, robot: Robot) -> None:
    """To the position where it is dropped; the numbers follow."""
    x, y, theta = robot.pose
    person.drag(person.handles()['body'], 100, -60)  # at 200 px a metre
    wait_until(lambda: math.dist(robot.pose[:2], (x + 0.5, y + 0.3)) < 0.02)
    assert robot.pose[2] == pytest.approx(theta, abs=0.01)
    person.page.get_by_text(f'x = {robot.pose[0]:.3f} m').wait_for()


def test_dragged_arrow_sets_the_heading(
        person: Person, robot: Robot) -> None:
    """The position stays."""
    x, y, _ = robot.pose
    handles = person.handles()
    (cx, cy), (tx, ty) = handles['body'], handles['tip']
    person.drag(handles['tip'], cx - tx, cy - 80 - ty)  # straight up
    wait_until(lambda: abs(robot.pose[2] - math.pi / 2.0) < 0.05)
    assert math.dist(robot.pose[:2], (x, y)) < 0.01


def test_dragged_wheels_drive_while_the_button_is_held(
        person: Person, robot: Robot) -> None:
    """The right one alone turns the robot to the left."""
    person.page.get_by_role('button', name='Set pose').click()
    wait_until(lambda: abs(robot.pose[2]) < 0.05)
    person.page.wait_for_timeout(1500)
    person.drag(person.handles()['right'], 30, 0)  # 6 rad/s
    person.page.get_by_text("φ' = H V_b  = (0.00, 6.00) rad/s").wait_for()
    assert not robot.is_driven()
    button = person.page.get_by_role('button', name='Hold to drive')
    button.focus()
    person.page.keyboard.down(' ')
    wait_until(robot.is_driven)
    left, right = robot.wheels[-1][1].velocity
    person.page.keyboard.up(' ')
    moment = time.monotonic()
    assert (left, right) == pytest.approx((0.0, 6.0), abs=0.1)
    assert robot.stopped_after(moment) < TIMEOUT


def test_reset_sets_the_pose_to_zero(person: Person, robot: Robot) -> None:
    """By the service of the node."""
    person.page.get_by_label('x [m]').fill('1.5')
    person.page.get_by_role('button', name='Set pose').click()
    wait_until(lambda: abs(robot.pose[0] - 1.5) < 0.05)
    person.page.get_by_role('button', name='Reset odometry').click()
    wait_until(lambda: math.hypot(*robot.pose) < 0.05)


# Set it


def test_refused_parameter_shows_the_reason_of_the_node(
        person: Person, robot: Robot) -> None:
    """And an accepted one is set."""
    name = 'left_wheel_radius_multiplier'

    def value() -> float:
        return robot.station.call(
            GetParameters, 'odometry/get_parameters',
            GetParameters.Request(names=[name])).values[0].double_value

    open_tab(person, 'Parameters')
    field = person.page.get_by_label(name, exact=True)
    field.fill('-1')
    field.press('Enter')
    person.page.get_by_text(f'Refused: {name} = -1.0: must be from 0.1 to 10').wait_for()
    assert value() == 1.0
    field.fill('fast')
    person.page.get_by_role('button', name=f'Set {name}').click()
    person.page.get_by_text(f'Refused: {name} = fast: must be a number').wait_for()
    person.page.get_by_text('must be a number. It is 1.0').wait_for()
    other = person.page.get_by_label('max_wheel_speed', exact=True)
    other.fill('12')
    for text, wanted in (('1.25', 1.25), ('1.0', 1.0)):
        field.fill(text)
        person.page.get_by_text('Refused').wait_for(state='detached')
        field.press('Enter')
        wait_until(lambda wanted=wanted: value() == wanted)
        person.page.get_by_text('Set', exact=True).and_(
            person.page.locator('[role=status]')).wait_for()
        person.page.wait_for_timeout(500)  # until the page has read it again
        assert (field.input_value(), other.input_value()) == (text, '12')
    assert not robot.is_driven()


# Others


SOCKET = '/_nicegui_ws/socket.io/?EIO=4&transport='


@pytest.mark.parametrize('path', [f'{SOCKET}websocket', f'{SOCKET}polling', '/'])
def test_other_origin_is_refused(shared: SimpleNamespace, path: str) -> None:
    """For the socket and the page; its own origin gets both."""
    socket = {'Connection': 'Upgrade', 'Upgrade': 'websocket', 'Sec_WebSocket_Version': '13',
              'Sec_WebSocket_Key': 'dGhlIHNhbXBsZSBub25jZQ=='} if 'websocket' in path else {}
    ours = shared.dashboard.url.rstrip('/')
    assert shared.dashboard.get(path, Origin=ours, **socket)[0] == (101 if socket else 200)
    for origin in ('http://evil.example', 'http://127.0.0.1:1', 'null'):
        assert shared.dashboard.get(path, Origin=origin, **socket)[0] == 403


def test_page_of_another_origin_cannot_open_the_socket(
        shared: SimpleNamespace, chromium: object) -> None:
    """In the same browser."""
    foreign = Dashboard('--odometry', 'nobody')
    page = chromium.new_page()
    try:
        foreign.wait_until_it_serves()
        page.goto(foreign.url)
        opened = page.evaluate("""url => new Promise(done => {
            const socket = new WebSocket(url);
            socket.onopen = () => done(true);
            socket.onerror = () => done(false);
        })""", f'ws://127.0.0.1:{shared.dashboard.port}{SOCKET}websocket')
        assert opened is False
    finally:
        page.close()
        foreign.close()


def test_other_machines_need_the_token(
        domain: int, chromium: object) -> None:
    """Bound to all addresses, as for another machine."""
    dashboard = Dashboard('--host', '0.0.0.0')
    context = chromium.new_context()
    try:
        address = dashboard.wait_until_it_serves()
        assert 'token=' in address
        assert dashboard.get()[0] == 403
        page = context.new_page()
        assert page.goto(dashboard.url).status == 403
        page.goto(address.replace(socket.gethostname(), '127.0.0.1'))
        assert page.url == dashboard.url
        page.wait_for_selector('canvas[data-drawn]')
    finally:
        context.close()
        dashboard.close()


# A robot of its own


@pytest.fixture
def serve(domain: int) -> Iterator[Callable[..., Dashboard]]:
    """Return a function that starts a dashboard without a robot."""
    started = []

    def serve_page(*arguments: str, port: int | None = None) -> Dashboard:
        started.append(Dashboard(*arguments, port=port))
        started[-1].wait_until_it_serves()
        return started[-1]

    yield serve_page
    for dashboard in started:
        dashboard.close()


@pytest.fixture
def observer(domain: int) -> Iterator[Station]:
    """Return a station that subscribes as ros2 topic echo does."""
    station = Station(domain, OBSERVER)
    yield station
    station.close()


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
        observer.say('cmd_vel', ahead)
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
    station.hear(JointState, 'wheel_commands')  # as a motor driver
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


# Accessibility


def barriers(person: Person) -> list[tuple[str, str]]:
    """Return the serious barriers that axe-core finds."""
    from axe_playwright_python.sync_playwright import Axe

    found = Axe().run(person.page).response['violations']
    return [(each['id'], each['nodes'][0]['html']) for each in found
            if each['impact'] in ('serious', 'critical')]


@pytest.mark.parametrize('theme', ['light', 'dark'])
def test_no_serious_accessibility_barrier_is_found(
        shared: SimpleNamespace, visit: Callable[..., Person], theme: str) -> None:
    """By axe-core, in each panel, desktop and phone."""
    for size in ((1280, 900), (390, 844)):
        person = visit(shared.dashboard.url, color_scheme=theme, viewport={
            'width': size[0], 'height': size[1]})
        for panel in ('Kinematics', 'Parameters', 'Diagnostics'):
            open_tab(person, panel)
            person.page.wait_for_timeout(500)  # until the panels have slid into place
            assert barriers(person) == []
        assert person.page.evaluate(
            'document.documentElement.scrollWidth <= window.innerWidth')


def test_all_controls_can_be_reached_by_the_keyboard(person: Person, robot: Robot) -> None:
    """By Tab, and STOP by Enter."""
    reached = []
    for _ in range(40):
        person.page.keyboard.press('Tab')
        reached.append(person.page.evaluate(
            '(document.activeElement.ariaLabel || document.activeElement.innerText || "").trim()'))
        if reached[-1] == 'STOP the robot':
            break
    person.page.keyboard.press('Enter')
    person.wait_for('STOPPED')
    person.page.wait_for_timeout(1000)  # until the notification has faded in
    assert barriers(person) == []
    for _ in range(40):
        person.page.keyboard.press('Tab')
        reached.append(person.page.evaluate(
            '(document.activeElement.ariaLabel || document.activeElement.innerText || "").trim()'))
        if reached[-1] == 'Release the stop':
            person.page.keyboard.press('Enter')
            person.wait_for('press')  # a key, or again
    assert {'Zoom in', 'Follow', 'Max speed [m/s]', 'Max turn rate [rad/s]', 'Kinematics',
            'Set pose', 'Reset odometry', 'Hold to drive', 'Live'} <= set(reached)
