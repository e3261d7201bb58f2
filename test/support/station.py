"""A driver's station for tests: what is published and heard around the nodes under test."""
from collections.abc import Callable, Iterable, Iterator
import os
from pathlib import Path
import signal
import subprocess
import sys
import threading
import time

from geometry_msgs.msg import Twist
from nav_msgs.msg import Odometry
import numpy as np
from rclpy.context import Context
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.qos import QoSProfile
from rclpy.task import Future
from sensor_msgs.msg import JointState

DEEP = QoSProfile(depth=10000)

# Odd numbers that survive no mix-up of sides, of half and full, or of diameter and radius.
SEPARATION, LEFT_RADIUS, RIGHT_RADIUS = 0.317, 0.0471, 0.0533
GEOMETRY = {
    'wheel_separation': SEPARATION,
    'wheel_radius': LEFT_RADIUS,
    'right_wheel_radius_multiplier': RIGHT_RADIUS / LEFT_RADIUS,
}


class Station:
    """A node with an executor of its own in a thread; what it hears is kept in lists."""

    def __init__(self, domain: int, name: str = 'station') -> None:
        self.context = Context()
        self.context.init(domain_id=domain)
        self.node = Node(name, context=self.context)
        self._executor = SingleThreadedExecutor(context=self.context)
        self._executor.add_node(self.node)
        self._ended = Future()
        self._thread = threading.Thread(
            target=self._executor.spin_until_future_complete, args=[self._ended])
        self._thread.start()
        self._publishers = {}

    def close(self) -> None:
        """Shut down, and wait until the thread has ended."""
        nodes = self._executor.get_nodes()
        # Not by shutdown alone: that takes from the thread what it is about to wait for.
        self._ended.set_result(None)
        self._thread.join()
        self._executor.shutdown()
        for node in nodes:  # those under test too, or the next test in the domain meets them
            node.destroy_node()
        self.context.try_shutdown()

    def add(self, node: Node) -> Node:
        """Let a node under test run in this process."""
        self._executor.add_node(node)
        return node

    def hear(self, kind: type, topic: str) -> list:
        """Return a list that fills with (time of receipt, message)."""
        heard = []
        self.node.create_subscription(
            kind, topic, lambda message: heard.append((time.monotonic(), message)), DEEP)
        return heard

    def say(self, topic: str, message: object, listeners: int = 1) -> None:
        """Publish a message, once somebody listens."""
        if topic not in self._publishers:
            self._publishers[topic] = self.node.create_publisher(type(message), topic, DEEP)
        publisher = self._publishers[topic]
        wait_until(lambda: publisher.get_subscription_count() >= listeners)
        publisher.publish(message)

    def say_until(self, is_so: Callable[[], object], topic: str, messages: Iterator) -> None:
        """Publish message after message until something is so: discovery loses the first ones."""
        wait_until(lambda: is_so() or self.say(topic, next(messages)), pause=0.05)

    def call(self, kind: type, service: str, request: object) -> object:
        """Return the answer of a service."""
        client = self.node.create_client(kind, service)
        assert client.wait_for_service(timeout_sec=10.0)
        future = client.call_async(request)
        wait_until(future.done)
        return future.result()


class Process:
    """A node as a process; what it prints is read when it has ended."""

    def __init__(self, module: str, *arguments: str, **parameters: object) -> None:
        given = [word for name, value in parameters.items() for word in ('-p', f'{name}:={value}')]
        self._process = subprocess.Popen(
            [sys.executable, '-m', f'diffdrive_ros.node.{module}', '--ros-args', *arguments,
             *given],
            stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True)
        self.output = ''

    @property
    def is_running(self) -> bool:
        """Return whether the process has not ended."""
        return self._process.poll() is None

    def signal(self, number: signal.Signals) -> None:
        """Send a signal."""
        self._process.send_signal(number)

    def wait(self, timeout: float = 10.0) -> int:
        """Return the exit code; output is complete then."""
        self.output = self._process.communicate(timeout=timeout)[0]
        return self._process.returncode

    def close(self) -> None:
        """End the process if it still runs."""
        if self.is_running:
            self._process.kill()
        self._process.communicate()


def children(number: int) -> dict[str, int]:
    """Return the process numbers of what a process started, by the names of the modules."""
    found = {}
    for each in filter(str.isdigit, os.listdir('/proc')):
        try:
            parent = Path(f'/proc/{each}/stat').read_text().rsplit(')', 1)[1].split()[1]
            words = Path(f'/proc/{each}/cmdline').read_bytes().split(b'\0')
        except OSError:  # it ended meanwhile
            continue
        if int(parent) == number and len(words) > 2:
            found[words[2].decode().removeprefix('diffdrive_ros.node.')] = int(each)
    return found


def wait_until(
        is_so: Callable[[], object], timeout: float = 15.0, pause: float = 0.002) -> None:
    """Return as soon as something is so; fail if it does not become so."""
    deadline = time.monotonic() + timeout
    while not is_so():
        assert time.monotonic() < deadline, 'it did not become so in time'
        time.sleep(pause)


def is_ramp(messages: Iterable[object], speeds: Iterable[float], rate: float) -> bool:
    """
    Return whether speeds change at a rate, by the stamps of the messages that have them.

    A busy machine may stop the node between its two looks at the time, but seldom: most of the
    speeds lie on one line, and all of them near it.
    """
    seconds = np.array([message.header.stamp.sec + 1e-9 * message.header.stamp.nanosec
                        for message in messages])
    if len(seconds) < 2:
        return False
    lines = np.array(list(speeds)) - rate * (seconds - seconds[0])
    errors = np.abs(lines - np.median(lines))
    return bool(np.median(errors) < abs(rate) * 2e-4 and errors.max() < abs(rate) * 0.02)


def twist(linear: float, angular: float) -> Twist:
    """Return a command [m/s, rad/s]."""
    message = Twist()
    message.linear.x, message.angular.z = linear, angular
    return message


def joints(stamp_ns: int, **angles: float) -> JointState:
    """Return a message with the positions of joints [rad] by their names."""
    message = JointState(name=list(angles), position=[float(angle) for angle in angles.values()])
    message.header.stamp.sec, message.header.stamp.nanosec = divmod(stamp_ns, 10**9)
    return message


def stamp_ns(message: Odometry | JointState) -> int:
    """Return the stamp of a message [ns]."""
    return message.header.stamp.sec * 10**9 + message.header.stamp.nanosec
