"""The dashboard in a real browser: the robot stops, whatever happens."""
from collections.abc import Callable
import os
import signal
import time
from types import SimpleNamespace

import pytest
from support.browser import (
    Browsers,
    centre_of,
    fingers_on,
    Link,
    missing,
    open_tab,
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
