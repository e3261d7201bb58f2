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
from support.browser import Browsers, CHROMIUM, Dashboard, Hands, Link, missing
from support.station import Process, Station, wait_until

if missing() and not os.environ.get('CI'):
    pytest.skip(f'no tests in a browser: {missing()}', allow_module_level=True)

pytestmark = pytest.mark.browser

TIMEOUT = 0.5  # [s] cmd_vel_timeout, its default
PERIOD = 0.02  # [s] of wheel commands
SLACK = 0.15  # [s] for a machine that does other things too

LOOKER = '_ros2cli_station'  # one who listens as ros2 topic echo does, and does not move


class Robot:
    """What the robot of a test did, as heard by a station."""

    def __init__(self, station: Station) -> None:
        self.station = station
        self.odom = station.hear(Odometry, 'odom')
        self.wheels = station.hear(JointState, 'wheel_commands')
        self.commands = station.hear(Twist, 'cmd_vel')
        wait_until(lambda: self.odom, 40.0)  # of processes that have just been started

    @property
    def pose(self) -> tuple[float, float, float]:
        """Return where odometry is."""
        pose = self.odom[-1][1].pose.pose
        return (pose.position.x, pose.position.y,
                2.0 * math.atan2(pose.orientation.z, pose.orientation.w))

    def turns(self) -> bool:
        """Return whether the wheels are asked to turn."""
        return bool(self.wheels) and any(self.wheels[-1][1].velocity)

    def stopped_after(self, moment: float, patience: float = 10.0) -> float:
        """Return how long after a moment the wheels' command became zero, to stay there [s]."""
        wait_until(lambda: time.monotonic() > moment + 1.0 and not self.turns(), patience)
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
    station = Station(domain_of_module, LOOKER)
    yield SimpleNamespace(dashboard=dashboard, robot=Robot(station))
    station.close()
    dashboard.close()


@pytest.fixture
def visit(chromium: object) -> Iterator[Callable[..., Hands]]:
    """Return a function that opens a page and returns the hands on it."""
    contexts = []

    def open_page(url: str, **options: object) -> Hands:
        contexts.append(chromium.new_context(**options))
        page = contexts[-1].new_page()
        page.goto(url)
        page.wait_for_selector('canvas[data-drawn]')
        return Hands(page)

    yield open_page
    for context in contexts:
        context.close()


@pytest.fixture
def robot(shared: SimpleNamespace) -> Robot:
    """Return the shared robot."""
    return shared.robot


@pytest.fixture
def hands(shared: SimpleNamespace, visit: Callable[..., Hands]) -> Hands:
    """Return the only page of the shared dashboard."""
    hands = visit(shared.dashboard.url)
    hands.wait_for('Nobody drives')
    return hands


def drive_off(hands: Hands, robot: Robot, key: str = 'w') -> None:
    """Press a key, and leave it pressed, until the wheels turn."""
    hands.press(key, robot.turns)


def open_tab(hands: Hands, name: str) -> None:
    """Open one of the panels."""
    hands.page.get_by_role('tab', name=name).click()


# See it


def test_the_page_shows_the_robot_smoothly_and_asks_nobody_else(
        shared: SimpleNamespace, chromium: object) -> None:
    """Every file comes from the dashboard itself; nothing is wrong on the console."""
    asked, wrong = [], []
    page = chromium.new_page()
    try:
        page.on('request', lambda request: asked.append(request.url))
        page.on('websocket', lambda socket: asked.append(socket.url.replace('ws', 'http', 1)))
        page.on('pageerror', lambda error: wrong.append(error))
        page.on('console', lambda line: line.type == 'error' and wrong.append(line.text))
        page.goto(shared.dashboard.url)
        page.wait_for_selector('canvas[data-drawn]')
        drawn = 'Number(document.querySelector("canvas").dataset.drawn)'
        before, start = page.evaluate(drawn), time.monotonic()
        page.wait_for_timeout(2000)
        rate = (page.evaluate(drawn) - before) / (time.monotonic() - start)
    finally:
        page.close()
    assert wrong == []
    assert len(asked) > 5
    assert [url for url in asked if not url.startswith(
        (shared.dashboard.url, 'data:', 'blob:'))] == []
    assert 5.0 < rate < 25.0  # 20 where nothing else runs


def test_the_numbers_are_on_the_page(hands: Hands) -> None:
    """Pose, matrices, speeds and diagnostics."""
    hands.page.get_by_text('T_odom_base =').wait_for()
    text = hands.page.locator('.layout').inner_text()
    for words in ('T_odom_base =', 'T_odom_left', 'H =', 'H⁺ =', '30.3030', 'applied'):
        assert words in text
    open_tab(hands, 'Diagnostics')
    hands.page.get_by_text('OK /odometry: feedback: 50 Hz').wait_for()


def test_the_map_keeps_the_robot_in_sight_until_it_is_dragged_away(hands: Hands) -> None:
    """However far one zooms; Follow says whether it does, and does it again."""
    follow = hands.page.get_by_role('button', name='Follow')
    canvas = hands.page.locator('canvas').bounding_box()

    def is_in_sight() -> bool:
        x, y = hands.handles()['body']
        return (canvas['x'] < x < canvas['x'] + canvas['width']
                and canvas['y'] < y < canvas['y'] + canvas['height'])

    hands.page.get_by_label('x [m]').fill('0.7')
    hands.page.get_by_role('button', name='Set pose').click()
    hands.page.get_by_text('x = 0.700 m').wait_for()
    for _ in range(6):
        hands.page.get_by_role('button', name='Zoom in').click()
    wait_until(is_in_sight)
    assert follow.get_attribute('aria-pressed') == 'true'
    hands.drag((canvas['x'] + 15, canvas['y'] + 15), canvas['width'] - 30, 0)
    hands.page.locator('[aria-pressed=false]').get_by_text('Follow').wait_for()
    assert not is_in_sight()
    follow.click()
    hands.page.locator('[aria-pressed=true]').get_by_text('Follow').wait_for()
    wait_until(is_in_sight)
    hands.page.get_by_role('button', name='Reset odometry').click()
    hands.page.get_by_text('x = 0.000 m').wait_for()


# Drive it


def test_a_square_by_keyboard(hands: Hands, robot: Robot) -> None:
    """Forward and left, four times; back where it began."""
    start = robot.pose
    for side in range(4):
        x, y, _ = robot.pose
        hands.hold('w', lambda x=x, y=y: math.dist(robot.pose[:2], (x, y)) > 0.25)
        target = start[2] + (side + 1) * math.pi / 2.0
        hands.hold('ArrowLeft', lambda target=target: math.remainder(
            robot.pose[2] - target, 2.0 * math.pi) > -0.12)
        wait_until(lambda: not robot.turns())
    assert math.dist(robot.pose[:2], start[:2]) < 0.2
    assert abs(math.remainder(robot.pose[2] - start[2], 2.0 * math.pi)) < 0.5


def fingers_on(hands: Hands) -> Callable[..., None]:
    """Return a function that tells the page where how many fingers are."""
    session = hands.page.context.new_cdp_session(hands.page)

    def touch(kind: str, *places: tuple[float, float]) -> None:
        session.send('Input.dispatchTouchEvent', {'type': kind, 'touchPoints': [
            {'x': right, 'y': down, 'id': number}
            for number, (right, down) in enumerate(places)]})

    return touch


def middle_of(place: object) -> tuple[float, float]:
    """Return where on the page something is."""
    box = place.bounding_box()
    return box['x'] + box['width'] / 2, box['y'] + box['height'] / 2


@pytest.mark.parametrize('device', ['mouse', 'touch'])
def test_the_joystick_drives_while_it_is_held(
        shared: SimpleNamespace, visit: Callable[..., Hands], robot: Robot, device: str) -> None:
    """Ahead and to the right is forward and clockwise."""
    hands = visit(shared.dashboard.url, has_touch=True)
    hands.wait_for('Nobody drives')
    x, y = middle_of(hands.page.locator('.stick'))
    count = len(robot.commands)
    if device == 'mouse':
        hands.page.mouse.move(x, y)
        hands.page.mouse.down()
        hands.page.mouse.move(x + 40, y - 40)
        wait_until(robot.turns)
        hands.page.mouse.up()
    else:
        touch = fingers_on(hands)
        touch('touchStart', (x, y))
        touch('touchMove', (x + 40, y - 40))
        wait_until(robot.turns)
        touch('touchEnd')
    released = time.monotonic()
    assert robot.stopped_after(released) < TIMEOUT
    asked = [twist for twist in robot.twists_since(count) if twist.linear.x]
    assert all(twist.linear.x > 0.0 > twist.angular.z for twist in asked)


def test_the_joystick_drives_at_the_first_press_after_a_button_had_the_focus(
        hands: Hands, robot: Robot) -> None:
    """The focus leaves the button then, but not the page."""
    hands.page.get_by_role('button', name='Zoom in').click()
    x, y = middle_of(hands.page.locator('.stick'))
    hands.page.mouse.move(x, y)
    hands.page.mouse.down()
    hands.page.mouse.move(x, y - 40)
    wait_until(robot.turns)
    hands.page.mouse.up()
    released = time.monotonic()
    assert robot.stopped_after(released) < TIMEOUT


def test_no_notice_takes_the_touch_that_is_for_what_is_below_it(
        shared: SimpleNamespace, visit: Callable[..., Hands]) -> None:
    """On a phone they lie over the joystick."""
    small = visit(shared.dashboard.url, has_touch=True, viewport={'width': 390, 'height': 844})
    press_stop(small)
    small.wait_for('STOPPED')
    notice = small.page.locator('.q-notification').first
    wait_until(lambda: middle_of(notice)[1] < 830.0)  # it comes from below
    below = small.page.evaluate(
        '([x, y]) => document.elementFromPoint(x, y).closest(".q-notification")?.className',
        middle_of(notice))
    release(small)
    assert below is None


def test_the_limits_are_kept(hands: Hands, robot: Robot) -> None:
    """By the keyboard too, which sets them."""
    slider = hands.page.get_by_role('slider', name='Fastest [m/s]')
    slider.focus()
    for _ in range(5):
        slider.press('ArrowLeft')
    hands.page.get_by_text('Fastest [m/s]: 0.05').wait_for()
    count = len(robot.commands)
    slider.press('ArrowRight')
    hands.page.get_by_text('Fastest [m/s]: 0.10').wait_for()
    assert robot.twists_since(count) == []  # that arrow was for the slider
    drive_off(hands, robot)
    hands.page.keyboard.up('w')
    assert max(twist.linear.x for twist in robot.twists_since(count)) == pytest.approx(0.1)


# Stop it


def let_go(hands: Hands) -> None:
    """Release the key."""
    hands.page.keyboard.up('w')


def lose_focus(hands: Hands) -> None:
    """Let another window have the keyboard."""
    hands.page.evaluate('window.dispatchEvent(new Event("blur"))')


def hide(hands: Hands) -> None:
    """Let another tab cover the page."""
    hands.page.evaluate("""
        Object.defineProperty(document, 'visibilityState', { get: () => 'hidden' });
        document.dispatchEvent(new Event('visibilitychange'));""")


def close(hands: Hands) -> None:
    """Close the page."""
    hands.page.close()


def leave(hands: Hands) -> None:
    """Go elsewhere."""
    hands.page.goto('about:blank')


def hang(hands: Hands) -> None:
    """Let the page compute for ever."""
    hands.page.evaluate('setTimeout(() => { while (true); }, 0)')


def press_stop(hands: Hands) -> None:
    """Press the large button."""
    hands.page.get_by_role('button', name='STOP the robot').click()


def release(hands: Hands) -> None:
    """Let the robot be driven again, once that is to be seen."""
    hands.page.get_by_role('button', name='Release the stop').click()
    hands.wait_for('drive')


def press_escape(hands: Hands) -> None:
    """Press the key that is the large button."""
    hands.page.keyboard.press('Escape')


@pytest.mark.parametrize('act', [
    let_go, lose_focus, hide, close, leave, hang, press_stop, press_escape])
def test_the_robot_stops_when_it_is_let_go(
        hands: Hands, robot: Robot, act: Callable[[Hands], None]) -> None:
    """In whatever way, within the node's timeout; a key that is still down drives no more."""
    drive_off(hands, robot)
    moment = time.monotonic()
    act(hands)
    done = time.monotonic()
    assert robot.stopped_after(moment) < done - moment + TIMEOUT
    if act in (press_stop, press_escape):
        hands.wait_for('STOPPED')
        hands.page.keyboard.up('w')
        hands.page.get_by_role('button', name='Release the stop').click()
        hands.wait_for('You drive')
        assert not robot.turns()
        drive_off(hands, robot)


def test_a_second_finger_stops_while_the_first_holds_the_joystick(
        shared: SimpleNamespace, visit: Callable[..., Hands], robot: Robot) -> None:
    """Browsers make no click of its touch."""
    hands = visit(shared.dashboard.url, has_touch=True)
    hands.wait_for('Nobody drives')
    touch = fingers_on(hands)
    x, y = middle_of(hands.page.locator('.stick'))
    touch('touchStart', (x, y))
    touch('touchMove', (x, y - 50))
    wait_until(robot.turns)
    moment = time.monotonic()
    touch('touchStart', (x, y - 50), middle_of(hands.page.locator('.stop')))
    assert robot.stopped_after(moment) < TIMEOUT
    hands.wait_for('STOPPED')
    touch('touchEnd')
    release(hands)


def test_a_page_that_moves_under_a_held_joystick_changes_nothing_of_what_it_asks(
        shared: SimpleNamespace, visit: Callable[..., Hands], robot: Robot) -> None:
    """The finger did not move; where it is on the glass is what it asks for."""
    hands = visit(shared.dashboard.url, has_touch=True)
    hands.wait_for('Nobody drives')
    stick = hands.page.locator('.stick')
    (x, y), place = middle_of(stick), stick.bounding_box()
    touch = fingers_on(hands)
    touch('touchStart', (x, y))
    touch('touchMove', (x, y - 20))
    wait_until(robot.turns)
    asked = robot.commands[-1][1].linear.x
    hands.page.evaluate('document.querySelector(".layout").style.marginTop = "40px"')
    wait_until(lambda: stick.bounding_box()['y'] > place['y'] + 20.0)
    count = len(robot.commands)
    touch('touchMove', (x, y - 20.5))
    wait_until(lambda: len(robot.commands) > count + 5)
    touch('touchEnd')
    assert robot.twists_since(count)[4].linear.x == pytest.approx(asked, abs=0.01)


@pytest.mark.parametrize(('width', 'height'), [(320, 640), (390, 844), (667, 375), (861, 600)])
def test_no_button_that_comes_moves_the_joystick(
        shared: SimpleNamespace, visit: Callable[..., Hands], hands: Hands,
        robot: Robot, width: int, height: int) -> None:
    """A finger is on it, or on its way to it; nor does STOP move, on the smallest phone."""
    drive_off(hands, robot)
    small = visit(
        shared.dashboard.url, has_touch=True, viewport={'width': width, 'height': height})
    pages = {hands: '.stick', small: '.stick, .stop'}

    def places() -> list[object]:
        small.page.evaluate('scrollTo(0, 0)')  # a click scrolls to what it clicks
        return [each.bounding_box() for page, what in pages.items()
                for each in page.page.locator(what).all()]

    small.wait_for('Another page drives')
    small.page.get_by_role('button', name='Take the wheel').wait_for()
    before = places()
    assert len(before) == 3
    press_stop(small)
    for page in pages:
        page.wait_for('STOPPED')
        page.page.get_by_role('button', name='Release the stop').wait_for()
    assert places() == before
    hands.page.keyboard.up('w')
    release(hands)
    small.wait_for('Another page drives')
    assert places() == before


def test_a_click_on_stop_is_one_stop(hands: Hands) -> None:
    """Though it is a press of the pointer too; a click without one, and a key, are one each."""
    stop = hands.page.get_by_role('button', name='STOP the robot')
    shown = hands.page.evaluate('window.glance.stops')
    for number, press in enumerate((
            stop.click, lambda: stop.press('Enter'), lambda: stop.dispatch_event('click')), 1):
        press()
        hands.page.wait_for_function(
            'stops => window.glance.stops >= stops', arg=shown + number)
        hands.page.wait_for_timeout(200)
        assert hands.page.evaluate('window.glance.stops') == shown + number
    release(hands)


def test_escape_is_stop_while_a_list_is_open(hands: Hands, robot: Robot) -> None:
    """It closes the list too."""
    open_tab(hands, 'Parameters')
    hands.page.get_by_label('linear.x.has_jerk_limits', exact=True).click()
    hands.page.locator('.q-menu').wait_for()
    hands.page.keyboard.press('Escape')
    hands.wait_for('STOPPED')
    hands.page.locator('.q-menu').wait_for(state='detached')
    hands.page.get_by_role('button', name='Release the stop').click()
    hands.wait_for('press')


def test_meta_lets_go_of_a_key_whose_release_would_not_be_told(
        hands: Hands, robot: Robot) -> None:
    """As on macOS, for every key while Meta is down."""
    drive_off(hands, robot)
    moment = time.monotonic()
    hands.page.keyboard.down('Meta')
    assert robot.stopped_after(moment) < TIMEOUT
    hands.page.keyboard.up('Meta')


def test_a_held_key_that_was_stopped_needs_a_new_press(hands: Hands, robot: Robot) -> None:
    """The keyboard goes on repeating it, and that is no new press."""
    drive_off(hands, robot)
    moment = time.monotonic()
    lose_focus(hands)
    robot.stopped_after(moment)
    count = len(robot.commands)
    for _ in range(5):
        hands.page.keyboard.down('w')  # a repetition, for it was never released
        hands.page.wait_for_timeout(50)
    assert robot.twists_since(count) == []


def test_a_browser_that_hangs_stops_the_robot_within_the_timeout(
        hands: Hands, robot: Robot) -> None:
    """Its beats end; when it goes on, its hands have let go."""
    drive_off(hands, robot)
    browsers = Browsers()
    moment = time.monotonic()
    browsers.signal(signal.SIGSTOP)
    try:
        assert robot.stopped_after(moment) < TIMEOUT
        count = len(robot.commands)
    finally:
        browsers.signal(signal.SIGCONT)
    hands.page.wait_for_timeout(1000)
    assert not any(twist.linear.x for twist in robot.twists_since(count))


def test_packets_that_are_held_up_stop_the_robot_and_are_not_driven_later(
        shared: SimpleNamespace, visit: Callable[..., Hands], robot: Robot) -> None:
    """The key stays down all the while."""
    link = Link(shared.dashboard.port)
    try:
        hands = visit(link.url)
        hands.wait_for('Nobody drives')
        drive_off(hands, robot)
        moment = time.monotonic()
        link.cut()
        assert robot.stopped_after(moment) < TIMEOUT
        hands.page.wait_for_selector('body.lost', timeout=1500)  # [ms]; it was cut 1 s ago
        count = len(robot.commands)
        link.mend()
        hands.page.wait_for_selector('body:not(.lost)')
        hands.page.wait_for_timeout(1500)
        assert not any(twist.linear.x for twist in robot.twists_since(count))
    finally:
        for context in [hands.page.context]:
            context.close()
        link.close()


def test_clicks_that_were_held_up_change_nothing(
        shared: SimpleNamespace, visit: Callable[..., Hands], hands: Hands,
        robot: Robot) -> None:
    """Least of all a stop that was pressed since."""
    link = Link(shared.dashboard.port)
    try:
        other = visit(link.url)
        press_stop(other)
        hands.wait_for('STOPPED')
        other.wait_for('STOPPED')
        pose = robot.pose
        link.cut()
        other.page.get_by_role('button', name='Release the stop').click()
        other.page.get_by_label('x [m]').fill('9')
        other.page.get_by_role('button', name='Set pose').click()
        release(hands)
        hands.wait_for('Nobody drives')
        press_stop(hands)
        hands.wait_for('STOPPED')
        link.mend()
        other.page.get_by_text('That came late').first.wait_for()
        hands.page.wait_for_timeout(500)
        hands.wait_for('STOPPED')
        assert robot.pose == pose
        release(hands)
    finally:
        other.page.context.close()
        link.close()


# Two pages


def test_one_page_drives_and_taking_over_is_explicit(
        shared: SimpleNamespace, visit: Callable[..., Hands], hands: Hands,
        robot: Robot) -> None:
    """What the other one presses does nothing, until it takes the wheel."""
    drive_off(hands, robot)
    hands.page.keyboard.up('w')
    wait_until(lambda: not robot.turns())
    other = visit(shared.dashboard.url)
    other.wait_for('Another page drives')
    count = len(robot.commands)
    other.page.keyboard.down('w')
    other.page.wait_for_timeout(500)
    other.page.keyboard.up('w')
    assert not any(twist.linear.x for twist in robot.twists_since(count))
    drive_off(hands, robot)
    moment = time.monotonic()
    other.page.get_by_role('button', name='Take the wheel').click()
    assert robot.stopped_after(moment) < TIMEOUT + 0.5
    other.wait_for('You drive')
    hands.wait_for('Another page drives')
    drive_off(other, robot)


def test_whoever_watches_can_stop(
        shared: SimpleNamespace, visit: Callable[..., Hands], hands: Hands,
        robot: Robot) -> None:
    """And the one who drives cannot go on before the stop is released."""
    drive_off(hands, robot)
    other = visit(shared.dashboard.url)
    moment = time.monotonic()
    press_stop(other)
    assert robot.stopped_after(moment) < TIMEOUT + 0.5
    hands.wait_for('STOPPED')
    hands.page.keyboard.up('w')
    hands.page.get_by_role('button', name='Release the stop').click()
    drive_off(hands, robot)


# Touch it


def test_dragging_the_robot_sets_the_pose(hands: Hands, robot: Robot) -> None:
    """To the place where it is dropped; the numbers follow."""
    x, y, theta = robot.pose
    hands.drag(hands.handles()['body'], 100, -60)  # at 200 px a metre
    wait_until(lambda: math.dist(robot.pose[:2], (x + 0.5, y + 0.3)) < 0.02)
    assert robot.pose[2] == pytest.approx(theta, abs=0.01)
    hands.page.get_by_text(f'x = {robot.pose[0]:.3f} m').wait_for()


def test_turning_the_robot_by_the_tip_of_its_arrow_sets_the_heading(
        hands: Hands, robot: Robot) -> None:
    """It stays where it is."""
    x, y, _ = robot.pose
    handles = hands.handles()
    (cx, cy), (tx, ty) = handles['body'], handles['tip']
    hands.drag(handles['tip'], cx - tx, cy - 80 - ty)  # straight up
    wait_until(lambda: abs(robot.pose[2] - math.pi / 2.0) < 0.05)
    assert math.dist(robot.pose[:2], (x, y)) < 0.01


def test_wheels_that_are_dragged_give_their_twist_and_drive_while_held(
        hands: Hands, robot: Robot) -> None:
    """The right one alone turns the robot to the left."""
    hands.page.get_by_role('button', name='Set pose').click()
    wait_until(lambda: abs(robot.pose[2]) < 0.05)
    hands.page.wait_for_timeout(1500)
    hands.drag(hands.handles()['right'], 30, 0)  # 6 rad/s
    hands.page.get_by_text("φ' = H V_b  = (0.00, 6.00) rad/s").wait_for()
    assert not robot.turns()
    button = hands.page.get_by_role('button', name='Hold to drive')
    button.focus()
    hands.page.keyboard.down(' ')
    wait_until(robot.turns)
    left, right = robot.wheels[-1][1].velocity
    hands.page.keyboard.up(' ')
    moment = time.monotonic()
    assert (left, right) == pytest.approx((0.0, 6.0), abs=0.1)
    assert robot.stopped_after(moment) < TIMEOUT


def test_reset_sets_the_pose_to_zero(hands: Hands, robot: Robot) -> None:
    """By the service of the node."""
    hands.page.get_by_label('x [m]').fill('1.5')
    hands.page.get_by_role('button', name='Set pose').click()
    wait_until(lambda: abs(robot.pose[0] - 1.5) < 0.05)
    hands.page.get_by_role('button', name='Reset odometry').click()
    wait_until(lambda: math.hypot(*robot.pose) < 0.05)


# Set it


def test_a_parameter_set_wrongly_shows_the_reason_of_the_node(
        hands: Hands, robot: Robot) -> None:
    """And set rightly, it is set."""
    name = 'left_wheel_radius_multiplier'

    def value() -> float:
        return robot.station.call(
            GetParameters, 'odometry/get_parameters',
            GetParameters.Request(names=[name])).values[0].double_value

    open_tab(hands, 'Parameters')
    field = hands.page.get_by_label(name, exact=True)
    field.fill('-1')
    field.press('Enter')
    hands.page.get_by_text(f'Refused: {name} = -1.0: must be from 0.1 to 10').wait_for()
    assert value() == 1.0
    field.fill('fast')
    hands.page.get_by_role('button', name=f'Set {name}').click()
    hands.page.get_by_text(f'Refused: {name} = fast: must be a number').wait_for()
    hands.page.get_by_text('must be a number. It is 1.0').wait_for()
    other = hands.page.get_by_label('max_wheel_speed', exact=True)
    other.fill('12')
    for text, wanted in (('1.25', 1.25), ('1.0', 1.0)):
        field.fill(text)
        hands.page.get_by_text('Refused').wait_for(state='detached')
        field.press('Enter')
        wait_until(lambda wanted=wanted: value() == wanted)
        hands.page.get_by_text('Set', exact=True).and_(
            hands.page.locator('[role=status]')).wait_for()
        hands.page.wait_for_timeout(500)  # for the page to have read it again
        assert (field.input_value(), other.input_value()) == (text, '12')
    assert not robot.turns()


# Others


SOCKET = '/_nicegui_ws/socket.io/?EIO=4&transport='


@pytest.mark.parametrize('path', [f'{SOCKET}websocket', f'{SOCKET}polling', '/'])
def test_another_origin_gets_nothing(shared: SimpleNamespace, path: str) -> None:
    """Neither a socket nor the page; the page's own origin gets both."""
    socket = {'Connection': 'Upgrade', 'Upgrade': 'websocket', 'Sec_WebSocket_Version': '13',
              'Sec_WebSocket_Key': 'dGhlIHNhbXBsZSBub25jZQ=='} if 'websocket' in path else {}
    ours = shared.dashboard.url.rstrip('/')
    assert shared.dashboard.get(path, Origin=ours, **socket)[0] == (101 if socket else 200)
    for origin in ('http://evil.example', 'http://127.0.0.1:1', 'null'):
        assert shared.dashboard.get(path, Origin=origin, **socket)[0] == 403


def test_a_page_of_another_origin_cannot_open_the_socket(
        shared: SimpleNamespace, chromium: object) -> None:
    """In the very browser in which the dashboard is open."""
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


def test_from_other_machines_only_the_address_with_the_token_works(
        domain: int, chromium: object) -> None:
    """Bound to all addresses, which here stands for another one."""
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
def watch(domain: int) -> Iterator[Callable[..., Dashboard]]:
    """Return a function that starts a dashboard without a robot."""
    started = []

    def start_dashboard(*arguments: str, port: int | None = None) -> Dashboard:
        started.append(Dashboard(*arguments, port=port))
        started[-1].wait_until_it_serves()
        return started[-1]

    yield start_dashboard
    for dashboard in started:
        dashboard.close()


@pytest.fixture
def looker(domain: int) -> Iterator[Station]:
    """Return a station that only looks."""
    station = Station(domain, LOOKER)
    yield station
    station.close()


def test_an_odometry_that_is_started_after_the_stop_is_held_too(
        watch: Callable[..., Dashboard], start: Callable[..., Process], looker: Station,
        visit: Callable[..., Hands]) -> None:
    """It knows of no stop, and another one who drives would move it; the page says how it is."""
    start('simulator_node')
    first = start('odometry_node')
    robot = Robot(looker)
    hands = visit(watch().url)
    hands.wait_for('Nobody drives')
    ahead = Twist()
    ahead.linear.x = 0.1

    def drives() -> bool:
        looker.say('cmd_vel', ahead)
        return robot.turns()

    wait_until(drives, pause=0.05)
    hands.page.keyboard.press('Escape')
    hands.wait_for('the wheels are held')
    first.signal(signal.SIGKILL)
    hands.page.get_by_text('odom is silent').wait_for()
    hands.wait_for('has not said yet that it holds the wheels')
    start('odometry_node')
    hands.wait_for('the wheels are held')
    count = len(robot.wheels)
    wait_until(lambda: drives() or len(robot.wheels) > count + 50, pause=0.05)
    assert not any(any(message.velocity) for _, message in robot.wheels[count:])
    # Until DDS has forgotten the dead one, this is not the robot that is known to be simulated.
    hands.page.get_by_role('button', name='Drive this real robot').wait_for(
        state='hidden', timeout=60000)
    release(hands)
    wait_until(drives, pause=0.05)


def test_a_server_that_dies_stops_the_robot_and_one_that_comes_back_is_driven_again(
        watch: Callable[..., Dashboard], start: Callable[..., Process], looker: Station,
        visit: Callable[..., Hands]) -> None:
    """The page finds it by itself; the key that was down all the while drives nothing."""
    start('simulator_node')
    start('odometry_node')
    robot = Robot(looker)
    dashboard = watch()
    hands = visit(dashboard.url)
    hands.wait_for('Nobody drives')
    drive_off(hands, robot)
    moment = time.monotonic()
    dashboard.signal(signal.SIGKILL)
    assert robot.stopped_after(moment) < TIMEOUT + PERIOD + SLACK
    hands.page.get_by_role('alert').get_by_text('Connection lost').wait_for()
    assert not hands.page.locator('header [role=status]').is_visible()
    count = len(robot.commands)
    watch(port=dashboard.port)
    hands.wait_for('press')  # a key, or again
    hands.page.wait_for_timeout(500)
    assert not any(twist.linear.x for twist in robot.twists_since(count))
    hands.page.keyboard.up('w')
    drive_off(hands, robot)


@pytest.mark.parametrize('number', [signal.SIGINT, signal.SIGTERM, signal.SIGHUP])
def test_a_dashboard_that_is_ended_stops_the_robot_first(
        domain: int, visit: Callable[..., Hands], number: signal.Signals) -> None:
    """It ends with 0, and its simulated robot with it."""
    dashboard = Dashboard('--simulate')
    try:
        dashboard.wait_until_it_serves()
        station = Station(domain, LOOKER)
        try:
            robot = Robot(station)
            hands = visit(dashboard.url)
            hands.wait_for('Nobody drives')
            drive_off(hands, robot)
            dashboard.signal(number)
            assert dashboard.wait() == 0, dashboard.output
            assert not robot.turns()
        finally:
            station.close()
    finally:
        dashboard.close()


def test_a_real_robot_is_only_shown_until_the_user_says_otherwise(
        watch: Callable[..., Dashboard], start: Callable[..., Process], looker: Station,
        station: Station,
        visit: Callable[..., Hands]) -> None:
    """Of this robot: not of what comes after it. Who listens and is no simulator is a real one."""
    start('simulator_node')
    odometry = start('odometry_node')
    robot = Robot(looker)
    station.hear(JointState, 'wheel_commands')  # as a motor driver
    hands = visit(watch().url)
    hands.wait_for('A real robot')
    assert barriers(hands) == []
    hands.page.keyboard.down('w')
    hands.page.wait_for_timeout(500)
    hands.page.keyboard.up('w')
    x, y, theta = robot.pose
    hands.drag(hands.handles()['body'], 60, 0)
    hands.page.get_by_text('This robot is a real one').wait_for()
    hands.page.get_by_role('button', name='Reset odometry').click()
    assert robot.commands == []
    assert robot.pose == (x, y, theta)
    unlock, agree, refuse = (hands.page.get_by_role('button', name=name, exact=True) for name in (
        'Drive this real robot', 'Drive it', 'Only look'))
    unlock.click()
    refuse.click()
    hands.page.wait_for_timeout(300)
    hands.wait_for('A real robot')
    unlock.click()
    agree.wait_for()
    press_stop(hands)  # beside the question, which covers all else
    hands.wait_for('STOPPED')
    agree.click()
    hands.page.get_by_role('button', name='Release the stop').click()
    hands.wait_for('Nobody drives')
    drive_off(hands, robot)
    refuse.click()
    hands.wait_for('A real robot')
    wait_until(lambda: not robot.turns())
    hands.page.keyboard.up('w')
    unlock.click()
    agree.click()
    hands.wait_for('Nobody drives')
    odometry.signal(signal.SIGKILL)
    start('odometry_node')
    hands.wait_for('A real robot')


def test_a_key_held_since_a_real_robot_was_there_does_not_drive_the_simulated_one(
        watch: Callable[..., Dashboard], start: Callable[..., Process], looker: Station,
        station: Station, visit: Callable[..., Hands]) -> None:
    """It has to be released first."""
    start('simulator_node')
    start('odometry_node')
    robot = Robot(looker)
    driver = station.node.create_subscription(JointState, 'wheel_commands', print, 1)
    hands = visit(watch().url)
    hands.wait_for('A real robot')
    hands.page.keyboard.down('w')
    hands.page.wait_for_timeout(200)
    station.node.destroy_subscription(driver)
    hands.wait_for('Let go, and press again')
    assert robot.commands == []
    hands.page.keyboard.up('w')
    drive_off(hands, robot)


def test_an_odometry_that_is_killed_and_started_anew_is_looked_at_anew(
        watch: Callable[..., Dashboard], start: Callable[..., Process], looker: Station,
        visit: Callable[..., Hands]) -> None:
    """It has no timeout now, so it is driven no more."""
    start('simulator_node')
    odometry = start('odometry_node')
    robot = Robot(looker)
    hands = visit(watch().url)
    hands.wait_for('Nobody drives')
    drive_off(hands, robot)
    odometry.signal(signal.SIGKILL)
    hands.wait_for('odom is silent')
    hands.page.get_by_text('measured not told').wait_for()
    hands.page.get_by_text('As it was last').wait_for()
    hands.page.wait_for_selector('body.silent')
    hands.page.keyboard.up('w')
    start('odometry_node', cmd_vel_timeout=0.0)
    hands.wait_for('cmd_vel_timeout is 0')
    hands.page.keyboard.down('w')
    count = len(robot.commands)
    hands.page.wait_for_timeout(500)
    assert robot.twists_since(count) == []


def test_a_robot_without_a_timeout_is_not_driven(
        watch: Callable[..., Dashboard], start: Callable[..., Process], looker: Station,
        visit: Callable[..., Hands]) -> None:
    """Nothing would stop it if the dashboard were to fail."""
    start('simulator_node')
    start('odometry_node', cmd_vel_timeout=0.0)
    robot = Robot(looker)
    hands = visit(watch().url)
    hands.wait_for('cmd_vel_timeout is 0')
    hands.page.keyboard.down('w')
    hands.page.wait_for_timeout(500)
    hands.page.keyboard.up('w')
    assert robot.commands == []
    # Who is there comes once a second; until then it passes for a real robot, and nothing is set.
    hands.page.get_by_role('button', name='Drive this real robot').wait_for(state='hidden')
    open_tab(hands, 'Parameters')
    field = hands.page.get_by_label('cmd_vel_timeout', exact=True)
    field.fill('0.5')
    field.press('Enter')
    field.blur()
    hands.wait_for('Nobody drives')
    drive_off(hands, robot)


# For everybody


def barriers(hands: Hands) -> list[tuple[str, str]]:
    """Return the serious ones that axe-core finds on a page as it is."""
    from axe_playwright_python.sync_playwright import Axe

    found = Axe().run(hands.page).response['violations']
    return [(each['id'], each['nodes'][0]['html']) for each in found
            if each['impact'] in ('serious', 'critical')]


@pytest.mark.parametrize('theme', ['light', 'dark'])
def test_no_serious_barrier_is_found(
        shared: SimpleNamespace, visit: Callable[..., Hands], theme: str) -> None:
    """By axe-core, in each panel, desktop and phone."""
    for size in ((1280, 900), (390, 844)):
        hands = visit(shared.dashboard.url, color_scheme=theme, viewport={
            'width': size[0], 'height': size[1]})
        for panel in ('Kinematics', 'Parameters', 'Diagnostics'):
            open_tab(hands, panel)
            hands.page.wait_for_timeout(500)  # for the panels to have slid into their place
            assert barriers(hands) == []
        assert hands.page.evaluate(
            'document.documentElement.scrollWidth <= window.innerWidth')


def test_everything_can_be_reached_by_the_keyboard(hands: Hands, robot: Robot) -> None:
    """By Tab, and STOP by Enter."""
    reached = []
    for _ in range(40):
        hands.page.keyboard.press('Tab')
        reached.append(hands.page.evaluate(
            '(document.activeElement.ariaLabel || document.activeElement.innerText || "").trim()'))
        if reached[-1] == 'STOP the robot':
            break
    hands.page.keyboard.press('Enter')
    hands.wait_for('STOPPED')
    hands.page.wait_for_timeout(1000)  # for the notification to have faded in
    assert barriers(hands) == []
    for _ in range(40):
        hands.page.keyboard.press('Tab')
        reached.append(hands.page.evaluate(
            '(document.activeElement.ariaLabel || document.activeElement.innerText || "").trim()'))
        if reached[-1] == 'Release the stop':
            hands.page.keyboard.press('Enter')
            hands.wait_for('press')  # a key, or again
    assert {'Zoom in', 'Follow', 'Fastest [m/s]', 'Fastest turn [rad/s]', 'Kinematics', 'Set pose',
            'Reset odometry', 'Hold to drive', 'Live'} <= set(reached)
