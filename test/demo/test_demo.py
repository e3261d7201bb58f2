"""The demo ends with 0 only if the robot was driven and its odometry was right."""
from collections.abc import Iterator
import os
from pathlib import Path
import signal
import subprocess
import sys

from diffdrive_ros.demo.main import commands_to_type
from nav_msgs.msg import Odometry
import pytest
from rcl_interfaces.srv import SetParameters
from rclpy.parameter import Parameter
from support.station import children, Station, twist, wait_until

PNG = b'\x89PNG\r\n\x1a\n'


class Demo:
    """The demo as a process, with the processes that it starts."""

    def __init__(self, picture: Path, *arguments: str) -> None:
        self._process = subprocess.Popen(
            [sys.executable, '-m', 'diffdrive_ros.demo.main', '--output', str(picture),
             *arguments],
            stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True)
        self.output = ''

    def children(self) -> dict[str, int]:
        """Return the process numbers of simulator_node and odometry_node."""
        return children(self._process.pid)

    def signal(self, number: signal.Signals) -> None:
        """Send a signal to the demo."""
        self._process.send_signal(number)

    def wait(self) -> int:
        """Return the exit code; output is complete then, and nothing is left running."""
        children = self.children()
        self.output = self._process.communicate(timeout=60)[0]
        for number in children.values():
            wait_until(lambda number=number: not Path(f'/proc/{number}').exists())
        return self._process.returncode

    def close(self) -> None:
        """End what still runs."""
        for number in self.children().values():
            os.kill(number, signal.SIGKILL)
        self._process.kill()
        self._process.communicate()


@pytest.fixture
def demo(domain: int, tmp_path: Path) -> Iterator[Demo]:
    """Return a demo that drives a circle."""
    demo = Demo(tmp_path / 'demo.png', '--path', 'circle')
    yield demo
    demo.close()


def wait_until_driving(station: Station) -> None:
    """Return when the robot has left its place."""
    received = station.subscribe(Odometry, 'odom')
    wait_until(lambda: received and received[-1][1].pose.pose.position.x > 0.1)


def test_good_run_exits_with_0_and_a_picture(demo: Demo, tmp_path: Path) -> None:
    """The figures are shown with their bounds."""
    assert demo.wait() == 0, demo.output
    assert (tmp_path / 'demo.png').read_bytes().startswith(PNG)
    assert 'position error at the end' in demo.output
    assert demo.output.splitlines()[-1] == 'PASSED'


@pytest.mark.parametrize('victim', ['simulator', 'odometry'])
def test_death_of_a_process_exits_with_1(
        demo: Demo, domain: int, victim: str) -> None:
    """The line names the process."""
    wait_until(lambda: len(demo.children()) == 2, timeout=60.0)
    station = Station(domain)
    try:
        wait_until_driving(station)
        os.kill(demo.children()[f'{victim}_node'], signal.SIGKILL)
        assert demo.wait() == 1
    finally:
        station.close()
    assert f'demo: FAILED: {victim} ended with -9' in demo.output


def test_hung_process_exits_with_1(demo: Demo, domain: int) -> None:
    """It runs, and publishes nothing."""
    wait_until(lambda: len(demo.children()) == 2, timeout=60.0)
    station = Station(domain)
    try:
        wait_until_driving(station)
        os.kill(demo.children()['odometry_node'], signal.SIGSTOP)
        assert demo.wait() == 1
    finally:
        station.close()
    assert 'demo: FAILED: odom: no message for 2 s' in demo.output


def test_wheels_swapped_while_driving_exit_with_1(demo: Demo, domain: int) -> None:
    """The odometry follows its encoders; the true pose does not."""
    wait_until(lambda: len(demo.children()) == 2, timeout=60.0)
    station = Station(domain)
    try:
        wait_until_driving(station)
        answer = station.call(SetParameters, 'simulator/set_parameters', SetParameters.Request(
            parameters=[Parameter('swap_wheels', value=True).to_parameter_msg()]))
        assert answer.results[0].successful
        assert demo.wait() == 1
    finally:
        station.close()
    assert 'must be at most' in demo.output


@pytest.mark.parametrize('has_ros2', [False, True])
def test_commands_to_type_are_those_that_this_machine_has(
        monkeypatch: pytest.MonkeyPatch, has_ros2: bool) -> None:
    """The dashboard of this environment, or teleop and echo, in the domain of the demo."""
    monkeypatch.setattr('shutil.which', lambda name: '/bin/ros2' if has_ros2 else None)
    monkeypatch.setenv('ROS_DOMAIN_ID', '7')
    monkeypatch.setenv('ROS_AUTOMATIC_DISCOVERY_RANGE', 'LOCALHOST')
    text = '\n'.join(commands_to_type())
    assert 'ROS_DOMAIN_ID=7 ROS_AUTOMATIC_DISCOVERY_RANGE=LOCALHOST' in text
    assert ('ros2 topic echo /odom' in text) == has_ros2
    assert (str(Path(sys.executable).with_name('dashboard')) in text) != has_ros2


def test_interrupted_demo_exits_with_1(demo: Demo) -> None:
    """Half a run is none; the robot's processes end with it."""
    wait_until(lambda: len(demo.children()) == 2, timeout=60.0)
    demo.signal(signal.SIGINT)
    assert demo.wait() == 1
    assert demo.output.strip().endswith('demo: interrupted')


def test_demo_does_not_drive_another_robot(station: Station, domain: int, tmp_path: Path) -> None:
    """A subscriber of cmd_vel exists already: it may be a real one."""
    station.subscribe(type(twist(0.0, 0.0)), 'cmd_vel')
    demo = Demo(tmp_path / 'demo.png')
    try:
        assert demo.wait() == 1
    finally:
        demo.close()
    assert 'cmd_vel (station): in use already' in demo.output
