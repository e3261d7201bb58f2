"""A simulated robot and its odometry as processes, for the shells that bring one along."""
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

# [s] DDS announces a participant every 3 s, and what it says first may be lost.
DISCOVERY = 3.5
NAMELESS = '_NODE_NAME_UNKNOWN_'  # rmw's, until what it is called has come too
# Of util-linux: the kernel interrupts the process if whoever started it is killed.
END_WITH_PARENT = ['setpriv', '--pdeathsig', 'INT'] if shutil.which('setpriv') else []

TOPICS = ('cmd_vel', 'wheel_commands', 'joint_states', 'odom', 'ground_truth')


class RobotEndedError(Exception):
    """One of the processes has ended; the message says which, and what it said."""


class RobotProcesses:
    """
    The processes simulator and odometry; what they print is kept for when they fail.

    odometry_settings are parameters of odometry, name:=value, besides the geometry.
    """

    def __init__(self, *odometry_settings: str) -> None:
        self._settings = odometry_settings
        self._said = tempfile.TemporaryFile()  # noqa: SIM115, closed in stop
        self._processes: dict[str, subprocess.Popen[bytes]] = {}

    def start(self) -> None:
        """Start the processes."""
        self._processes['simulator'] = self._start('simulator_node', *ROBOT, *FLOOR)
        self._processes['odometry'] = self._start('odometry_node', *ROBOT, *self._settings)

    def check(self) -> None:
        """Raise RobotEndedError if one of the processes has ended."""
        for name, process in self._processes.items():
            if process.poll() is not None:
                self._said.seek(0)
                said = self._said.read().decode(errors='replace').strip()
                raise RobotEndedError(f'{name} ended with {process.returncode}\n{said}'.strip())

    def stop(self) -> None:
        """End the processes that still run; nothing interrupts that."""
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
        self._said.close()

    def _start(self, module: str, *settings: str) -> 'subprocess.Popen[bytes]':
        ros_arguments = [word for setting in settings for word in ('-p', setting)]
        return subprocess.Popen(
            [*END_WITH_PARENT, sys.executable, '-m', f'diffdrive_ros.node.{module}', '--ros-args',
             *ros_arguments],
            stdin=subprocess.DEVNULL, stdout=self._said, stderr=self._said)


@contextmanager
def running_robot(*odometry_settings: str) -> Iterator[RobotProcesses]:
    """Start a robot; stop it in the end, whatever happened."""
    robot = RobotProcesses(*odometry_settings)
    try:
        robot.start()
        yield robot
    finally:
        robot.stop()


def used_topics(node: Node) -> Sequence[str]:
    """
    Return the topics of such a robot on which somebody else than a node is already, and who.

    Takes until somebody is found there and has a name, or until all are found who can be.
    """
    deadline = time.monotonic() + DISCOVERY
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
