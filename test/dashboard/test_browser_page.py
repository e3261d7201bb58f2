"""The dashboard in a real browser: map, panels, access and accessibility."""
from collections.abc import Callable
import math
import os
import socket
import time
from types import SimpleNamespace

import pytest
from rcl_interfaces.srv import GetParameters
from support.browser import barriers, Dashboard, missing, open_tab, Person, Robot
from support.station import wait_until

if missing() and not os.environ.get('CI'):
    pytest.skip(f'no tests in a browser: {missing()}', allow_module_level=True)

pytestmark = pytest.mark.browser

TIMEOUT = 0.5  # [s] cmd_vel_timeout, its default


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


def test_typed_wheel_speeds_drive_too(person: Person, robot: Robot) -> None:
    """As those that are dragged, which the fields show; Live shows the measured ones."""
    person.drag(person.handles()['right'], 30, 0)  # 6 rad/s
    person.page.get_by_text("φ' = H V_b  = (0.00, 6.00) rad/s").wait_for()
    right = person.page.get_by_label('right wheel [rad/s]')
    assert right.input_value() == '6.00'
    person.page.get_by_label('left wheel [rad/s]').fill('2.5')
    person.page.get_by_text("φ' = H V_b  = (2.50, 6.00) rad/s").wait_for()
    person.page.get_by_role('button', name='Live').click()
    person.page.get_by_text("φ' = H V_b  = (0.00, 0.00) rad/s").wait_for()
    assert right.input_value() == '0.00'
    assert not robot.is_driven()


def test_reset_sets_the_pose_to_zero(person: Person, robot: Robot) -> None:
    """By the service of the node."""
    person.page.get_by_label('x [m]').fill('1.5')
    person.page.get_by_role('button', name='Set pose').click()
    wait_until(lambda: abs(robot.pose[0] - 1.5) < 0.05)
    person.page.get_by_role('button', name='Reset odometry').click()
    wait_until(lambda: math.hypot(*robot.pose) < 0.05)


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
