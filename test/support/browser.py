"""A browser, a dashboard and the network between them, for tests."""
from collections.abc import Callable
import http.client
import math
import os
from pathlib import Path
import re
import select
import shutil
import signal
import socket
import subprocess
import sys
import threading
import time
from typing import Any

from geometry_msgs.msg import Twist
from nav_msgs.msg import Odometry
from sensor_msgs.msg import JointState
from support.station import Station, wait_until

CHROMIUM = shutil.which('chromium')
OBSERVER = '_ros2cli_station'  # subscribes as ros2 topic echo does, and is no motor driver


def missing() -> str:
    """Return what is missing for tests in a browser, or nothing."""
    if not CHROMIUM:
        return 'chromium is not installed: apt-get install chromium'
    for module, package in (
            ('nicegui', 'nicegui'), ('playwright', 'playwright'),
            ('axe_playwright_python', 'axe-playwright-python')):
        try:
            __import__(module)
        except ImportError:
            return f'{package} is not installed'
    return ''


def free_port() -> int:
    """Return a port that is not in use."""
    with socket.socket() as probe:
        probe.bind(('127.0.0.1', 0))
        return probe.getsockname()[1]


class Dashboard:
    """The dashboard as a process."""

    def __init__(self, *arguments: str, port: int | None = None) -> None:
        self.port = port or free_port()
        # NiceGUI serves in another way if these variables are set.
        environment = {
            name: value for name, value in os.environ.items() if not name.startswith('PYTEST_')}
        self._process = subprocess.Popen(
            [sys.executable, '-m', 'diffdrive_ros.dashboard.main', '--port', str(self.port),
             *arguments], stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True,
            env=environment)
        self.output = ''
        self.url = f'http://127.0.0.1:{self.port}/'

    def wait_until_it_serves(self) -> str:
        """Return the address that it prints."""
        deadline = time.monotonic() + 30.0
        while 'dashboard: http' not in self.output:
            assert time.monotonic() < deadline, self.output
            line = self._process.stdout.readline()
            assert line, f'it exited: {self.output}'
            self.output += line
        wait_until(self._accepts)
        return re.search(r'dashboard: (\S+)', self.output)[1]

    def _accepts(self) -> bool:
        try:
            with socket.create_connection(('127.0.0.1', self.port), 1.0):
                return True
        except OSError:
            return False

    def get(self, path: str = '/', method: str = 'GET', **headers: str) -> tuple[int, str]:
        """Return status and body of a response; header_name is header-name."""
        connection = http.client.HTTPConnection('127.0.0.1', self.port, timeout=10.0)
        connection.request(method, path, headers={
            name.replace('_', '-'): value for name, value in headers.items()})
        response = connection.getresponse()
        body = '' if response.status == 101 else response.read().decode(errors='replace')
        connection.close()
        return response.status, body

    @property
    def pid(self) -> int:
        """Return the process ID."""
        return self._process.pid

    def signal(self, number: signal.Signals) -> None:
        """Send a signal."""
        self._process.send_signal(number)

    def wait(self) -> int:
        """Return the exit code; output is complete then."""
        self.output += self._process.communicate(timeout=60)[0]
        return self._process.returncode

    def close(self) -> None:
        """End it, and its child processes."""
        if self._process.poll() is None:
            self._process.send_signal(signal.SIGINT)
            try:
                self._process.wait(10)
            except subprocess.TimeoutExpired:
                self._process.kill()
        self._process.communicate()


class Link:
    """A connection to a local port that can be cut, and mended, while it is used."""

    def __init__(self, port: int) -> None:
        self._target = port
        self._is_cut = threading.Event()
        self._ends = threading.Event()
        self._listener = socket.create_server(('127.0.0.1', 0))
        self.url = f'http://127.0.0.1:{self._listener.getsockname()[1]}/'
        self._threads = [threading.Thread(target=self._accept)]
        self._threads[0].start()

    def cut(self) -> None:
        """Hold back all data, as on a network that loses packets."""
        self._is_cut.set()

    def mend(self) -> None:
        """Pass on the data again, in order."""
        self._is_cut.clear()

    def close(self) -> None:
        """End it."""
        self._ends.set()
        self._is_cut.clear()
        for thread in self._threads:
            thread.join()
        self._listener.close()

    def _accept(self) -> None:
        while not self._ends.is_set():
            if select.select([self._listener], [], [], 0.1)[0]:
                ours, _ = self._listener.accept()
                theirs = socket.create_connection(('127.0.0.1', self._target))
                for pair in ((ours, theirs), (theirs, ours)):
                    self._threads.append(threading.Thread(target=self._pass_on, args=pair))
                    self._threads[-1].start()

    def _pass_on(self, source: socket.socket, target: socket.socket) -> None:
        with source:
            while not self._ends.is_set():
                if self._is_cut.is_set():
                    self._ends.wait(0.01)
                    continue
                try:
                    if select.select([source], [], [], 0.02)[0] and not self._is_cut.is_set():
                        target.sendall(source.recv(65536) or self._raise())
                except (OSError, ValueError):  # one end is closed, maybe by the other thread
                    target.close()
                    return

    @staticmethod
    def _raise() -> bytes:
        raise OSError('the other end is closed')


class Browsers:
    """The processes of the browser of this process, to suspend and resume them."""

    def __init__(self) -> None:
        self._numbers = _descendants(os.getpid(), 'chromium')
        assert self._numbers

    def signal(self, number: signal.Signals) -> None:
        """Send a signal to all of them."""
        for each in self._numbers:
            os.kill(each, number)


def _descendants(root: int, name: str) -> list[int]:
    parents, names = {}, {}
    for number in map(int, filter(str.isdigit, os.listdir('/proc'))):
        try:
            head, tail = Path(f'/proc/{number}/stat').read_text().rsplit(')', 1)
        except OSError:  # it exited meanwhile
            continue
        parents[number], names[number] = int(tail.split()[1]), head.partition('(')[2]
    found = {root}
    while True:
        more = {number for number, parent in parents.items() if parent in found} - found
        if not more:
            return [number for number in found if names[number].startswith(name)]
        found |= more


class Person:
    """What a person does on a page, and sees there."""

    def __init__(self, page: Any) -> None:
        self.page = page

    @property
    def status(self) -> str:
        """Return the status line."""
        return self.page.locator('header [role=status]').inner_text()

    def wait_for(self, words: str) -> None:
        """Wait until the status line has some words."""
        from playwright.sync_api import TimeoutError as TooLateError

        try:
            self.page.wait_for_function(
                'it => document.querySelector("header [role=status]").innerText.includes(it)',
                arg=words, timeout=20000)
        except TooLateError:
            raise AssertionError(f'{words!r} is not in the status line: {self.status!r}') from None

    def press(self, key: str, until: Callable[[], object], timeout: float = 40.0) -> None:
        """
        Press a key until a condition holds, and keep it down.

        On a busy machine heartbeats are late, and the key has to be pressed again.
        """
        deadline = time.monotonic() + timeout
        self.page.keyboard.down(key)
        pressed = time.monotonic()
        while not until():
            assert time.monotonic() < deadline, self.status
            self.page.wait_for_timeout(5)
            if 'press again' in self.status or time.monotonic() - pressed > 3.0:
                self.page.keyboard.up(key)
                self.page.wait_for_timeout(200)
                self.page.keyboard.down(key)
                pressed = time.monotonic()

    def hold(self, key: str, until: Callable[[], object], timeout: float = 40.0) -> None:
        """Hold a key until a condition holds, and release it."""
        try:
            self.press(key, until, timeout)
        finally:
            self.page.keyboard.up(key)

    def handles(self) -> dict[str, tuple[float, float]]:
        """Return the positions on the page of the handles of the robot."""
        box = self.page.locator('canvas').bounding_box()
        found = self.page.evaluate(
            'getElement(Number(document.querySelector("canvas").id.slice(1))).handles()')
        return {name: (box['x'] + x, box['y'] + y) for name, (x, y) in found.items()}

    def drag(self, start: tuple[float, float], right: float, down: float) -> None:
        """Drag from a position on the page by a number of pixels."""
        mouse = self.page.mouse
        mouse.move(*start)
        mouse.down()
        mouse.move(start[0] + right / 2, start[1] + down / 2)
        mouse.move(start[0] + right, start[1] + down)
        mouse.up()


class Robot:
    """What the robot of a test does, as a station receives it."""

    def __init__(self, station: Station) -> None:
        self.station = station
        self.odom = station.subscribe(Odometry, 'odom')
        self.wheels = station.subscribe(JointState, 'wheel_commands')
        self.commands = station.subscribe(Twist, 'cmd_vel')
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


def start_driving(person: Person, robot: Robot, key: str = 'w') -> None:
    """Press a key until the robot is driven, and hold it."""
    person.press(key, robot.is_driven)


def open_tab(person: Person, name: str) -> None:
    """Open one of the panels."""
    person.page.get_by_role('tab', name=name).click()


def press_stop(person: Person) -> None:
    """Click STOP."""
    person.page.get_by_role('button', name='STOP the robot').click()


def release(person: Person) -> None:
    """Release the stop, and wait until the page shows it."""
    person.page.get_by_role('button', name='Release the stop').click()
    person.wait_for('drive')


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


def barriers(person: Person) -> list[tuple[str, str]]:
    """Return the serious barriers that axe-core finds."""
    from axe_playwright_python.sync_playwright import Axe

    found = Axe().run(person.page).response['violations']
    return [(each['id'], each['nodes'][0]['html']) for each in found
            if each['impact'] in ('serious', 'critical')]
