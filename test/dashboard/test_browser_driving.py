"""The dashboard in a real browser: keyboard, joystick, and several pages."""
from collections.abc import Callable
import math
import os
import time
from types import SimpleNamespace

import pytest
from support.browser import (
    centre_of,
    fingers_on,
    missing,
    Person,
    press_stop,
    release,
    Robot,
    start_driving,
)
from support.station import wait_until

if missing() and not os.environ.get('CI'):
    pytest.skip(f'no tests in a browser: {missing()}', allow_module_level=True)

pytestmark = pytest.mark.browser

TIMEOUT = 0.5  # [s] cmd_vel_timeout, its default


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
