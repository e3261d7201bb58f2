"""The operator station of the tests: publishers and subscriptions around the nodes under test."""
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

# Numbers that detect swapped sides, half for full, and diameter for radius.
SEPARATION, LEFT_RADIUS, RIGHT_RADIUS = 0.317, 0.0471, 0.0533
GEOMETRY = {
    'wheel_separation': SEPARATION,
    'wheel_radius': LEFT_RADIUS,
    'right_wheel_radius_multiplier': RIGHT_RADIUS / LEFT_RADIUS,
}


class Station:
    """A node with its own executor in a thread; received messages are recorded in lists."""

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
        # Not by shutdown alone, which destroys objects that the thread is about to wait for.
        self._ended.set_result(None)
        self._thread.join()
        self._executor.shutdown()
        for node in nodes:  # those under test too, or the next test in the domain discovers them
            node.destroy_node()
        self.context.try_shutdown()

    def add(self, node: Node) -> Node:
        """Add a node under test to this process."""
        self._executor.add_node(node)
        return node

    def subscribe(self, kind: type, topic: str) -> list:
        """Return a list of (time of receipt, message), extended by each message."""
        received = []
        self.node.create_subscription(
            kind, topic, lambda message: received.append((time.monotonic(), message)), DEEP)
        return received

    def publish(self, topic: str, message: object, subscribers: int = 1) -> None:
        """Publish a message as soon as a number of subscribers is matched."""
        if topic not in self._publishers:
            self._publishers[topic] = self.node.create_publisher(type(message), topic, DEEP)
        publisher = self._publishers[topic]
        wait_until(lambda: publisher.get_subscription_count() >= subscribers)
        publisher.publish(message)

    def publish_until(
            self, is_met: Callable[[], object], topic: str, messages: Iterator) -> None:
        """Publish messages until a condition is met: discovery loses the first ones."""
        wait_until(lambda: is_met() or self.publish(topic, next(messages)), pause=0.05)

    def call(self, kind: type, service: str, request: object) -> object:
        """Return the response of a service."""
        client = self.node.create_client(kind, service)
        assert client.wait_for_service(timeout_sec=10.0)
        future = client.call_async(request)
        wait_until(future.done)
        return future.result()


class Process:
    """A node as a process; its output is read after its exit."""

    def __init__(self, module: str, *arguments: str, **parameters: object) -> None:
        given = [word for name, value in parameters.items() for word in ('-p', f'{name}:={value}')]
        self._process = subprocess.Popen(
            [sys.executable, '-m', f'diffdrive_ros.node.{module}', '--ros-args', *arguments,
             *given],
            stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True)
        self.output = ''

    @property
    def is_running(self) -> bool:
        """Return whether the process has not exited."""
        return self._process.poll() is None

    def signal(self, number: signal.Signals) -> None:
        """Send a signal."""
        self._process.send_signal(number)

    def wait(self, timeout: float = 10.0) -> int:
        """Wait for the exit, and return the exit code; the output is complete then."""
        self.output = self._process.communicate(timeout=timeout)[0]
        return self._process.returncode

    def close(self) -> None:
        """End the process if it still runs."""
        if self.is_running:
            self._process.kill()
        self._process.communicate()


def children(number: int) -> dict[str, int]:
    """Return the ids of the child processes of a process, by the names of their modules."""
    found = {}
    for each in filter(str.isdigit, os.listdir('/proc')):
        try:
            parent = Path(f'/proc/{each}/stat').read_text().rsplit(')', 1)[1].split()[1]
            words = Path(f'/proc/{each}/cmdline').read_bytes().split(b'\0')
        except OSError:  # the process has exited
            continue
        if int(parent) == number and len(words) > 2:
            found[words[2].decode().removeprefix('diffdrive_ros.node.')] = int(each)
    return found


def wait_until(
        is_met: Callable[[], object], timeout: float = 15.0, pause: float = 0.002) -> None:
    """Return as soon as a condition is met; fail after a timeout [s]."""
    deadline = time.monotonic() + timeout
    while not is_met():
        assert time.monotonic() < deadline, f'the condition is not met within {timeout} s'
        time.sleep(pause)


def is_ramp(messages: Iterable[object], speeds: Iterable[float], rate: float) -> bool:
    """
    Return whether speeds change at a rate, by the stamps of the messages that have them.

    A busy machine may pause the node between its two readings of the clock, but rarely: most of
    the speeds are on one line, and all of them near it.
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
