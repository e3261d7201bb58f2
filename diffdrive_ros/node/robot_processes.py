"""Run simulator and odometry as processes, for demo and dashboard."""
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
import shutil
import signal
import subprocess
import sys
import tempfile
import time

from diffdrive_ros.node.runner import STOP_SIGNALS
from rclpy.node import Node

ROBOT = ('wheel_separation:=0.160', 'wheel_radius:=0.033')
FLOOR = ('slip:=0.01', 'travel_noise:=0.001', 'seed:=1')

# DDS announces a participant every 3 s, and the first announcement may be lost.
DISCOVERY_S = 3.5
NAMELESS = '_NODE_NAME_UNKNOWN_'  # rmw's, until the name is discovered too
# Of util-linux: the kernel interrupts the process when its parent is killed.
END_WITH_PARENT = ['setpriv', '--pdeathsig', 'INT'] if shutil.which('setpriv') else []

TOPICS = ('cmd_vel', 'wheel_commands', 'joint_states', 'odom', 'ground_truth')


class RobotEndedError(Exception):
    """One of the processes has ended; the message has its name and output."""


class RobotProcesses:
    """
    The processes simulator and odometry; their output is kept for a failure.

    odometry_settings are parameters of odometry, name:=value, besides the geometry.
    """

    def __init__(self, *odometry_settings: str) -> None:
        self._settings = odometry_settings
        self._output = tempfile.TemporaryFile()  # noqa: SIM115, closed in stop
        self._processes: dict[str, subprocess.Popen[bytes]] = {}

    def start(self) -> None:
        """Start the processes."""
        self._processes['simulator'] = self._start('simulator_node', *ROBOT, *FLOOR)
        self._processes['odometry'] = self._start('odometry_node', *ROBOT, *self._settings)

    def check(self) -> None:
        """Raise RobotEndedError if one of the processes has ended."""
        for name, process in self._processes.items():
            if process.poll() is not None:
                self._output.seek(0)
                output = self._output.read().decode(errors='replace').strip()
                raise RobotEndedError(f'{name} ended with {process.returncode}\n{output}'.strip())

    def stop(self) -> None:
        """End the processes that still run, without interruption by a signal."""
        for each in STOP_SIGNALS:
            signal.signal(each, signal.SIG_IGN)
        for process in self._processes.values():
            process.send_signal(signal.SIGINT)
        for process in self._processes.values():
            try:
                process.wait(timeout=2.0)
            except subprocess.TimeoutExpired:
                process.kill()
                process.wait()
        self._output.close()

    def _start(self, module: str, *settings: str) -> 'subprocess.Popen[bytes]':
        ros_arguments = [word for setting in settings for word in ('-p', setting)]
        return subprocess.Popen(
            [*END_WITH_PARENT, sys.executable, '-m', f'diffdrive_ros.node.{module}', '--ros-args',
             *ros_arguments],
            stdin=subprocess.DEVNULL, stdout=self._output, stderr=self._output)


@contextmanager
def running_robot(*odometry_settings: str) -> Iterator[RobotProcesses]:
    """Start a robot, and stop it on exit in any case."""
    robot = RobotProcesses(*odometry_settings)
    try:
        robot.start()
        yield robot
    finally:
        robot.stop()


def used_topics(node: Node) -> Sequence[str]:
    """
    Return the topics of such a robot that other nodes than this use, with their names.

    It returns once one is found with a name, or after the time of discovery.
    """
    deadline = time.monotonic() + DISCOVERY_S
    topics: Sequence[str] = ()
    while (not topics or NAMELESS in ' '.join(topics)) and time.monotonic() < deadline:
        time.sleep(0.05)
        topics = _topics_of_others(node)
    return topics


def _topics_of_others(node: Node) -> Sequence[str]:
    found = {topic: sorted({
        end.node_name for end in (
            *node.get_publishers_info_by_topic(topic),
            *node.get_subscriptions_info_by_topic(topic))} - {node.get_name()})
        for topic in TOPICS}
    return [f'{topic} ({", ".join(names)})' for topic, names in found.items() if names]
