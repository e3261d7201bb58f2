"""The driver of the nodes under test: it publishes joint states, and records their odometry."""
import math
import os
from pathlib import Path
import signal
import subprocess
import threading
import time

from diffdrive_ros.node.rclpy_internals import make_executor
from nav_msgs.msg import Odometry
import rclpy
from rclpy.qos import QoSProfile
from rclpy.serialization import deserialize_message, serialize_message
from sensor_msgs.msg import JointState

DEEP = QoSProfile(depth=1000)
LEFT_SPEED, RIGHT_SPEED = 6.0, 7.0  # [rad/s]
WHEEL_RADIUS, WHEEL_SEPARATION = 0.033, 0.16
TOLERANCE = 1e-6  # [m, rad]
MAX_START_S = 30.0
MAX_DELAY_S = 2.0  # of the last answers


class Node:
    """A process under test."""

    def __init__(self, arguments: list[str], environment: dict[str, str]) -> None:
        self._process = subprocess.Popen(
            arguments, env={**os.environ, **environment}, stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL)

    @property
    def seconds(self) -> float:
        """Return its CPU time and that of its children [s], user and system."""
        # The clock of another process, as of clock_getcpuclockid(3), in nanoseconds.
        return sum(time.clock_gettime((~pid << 3) | 2) for pid in self._process_tree())

    @property
    def resident(self) -> float:
        """Return its resident memory and that of its children [MB]."""
        pages = sum(int(Path(f'/proc/{pid}/statm').read_text().split()[1])
                    for pid in self._process_tree())
        return pages * os.sysconf('SC_PAGE_SIZE') / 1e6

    def end(self) -> None:
        """End the process, and wait for its exit."""
        self._process.send_signal(signal.SIGTERM)
        try:
            self._process.wait(10.0)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()

    def _process_tree(self) -> list[int]:
        pids = [self._process.pid]
        for pid in pids:  # grows in the loop
            for each in Path(f'/proc/{pid}/task').glob('*/children'):
                pids += map(int, each.read_text().split())
        return pids


class Driver:
    """A driver of robots, each in a namespace; answers are (time of receipt [s], bytes)."""

    def __init__(self, namespaces: list[str], rate: float) -> None:
        self._period_ns = round(1e9 / rate)
        self._sent = 0
        rclpy.init()
        self._node = rclpy.create_node('driver')
        self._publishers = [
            self._node.create_publisher(JointState, f'{name}/joint_states', DEEP)
            for name in namespaces]
        self.answers: list[list[tuple[float, bytes]]] = [[] for _ in namespaces]
        for name, answers in zip(namespaces, self.answers, strict=True):
            # Deserialized after the run, so that this process uses little CPU.
            self._node.create_subscription(
                Odometry, f'{name}/odom', self._append_to(answers), DEEP, raw=True)
        self._executor = make_executor()
        self._executor.add_node(self._node)
        self._is_over = False
        self._thread = threading.Thread(target=self._spin)
        self._thread.start()

    def close(self) -> None:
        """Shut down."""
        self._is_over = True
        self._executor.wake()
        self._thread.join()
        self._executor.remove_node(self._node)
        self._node.destroy_node()
        rclpy.shutdown()

    def wait_for_answers(self, count: int, pause: float) -> None:
        """Send a sample to all robots after each pause [s] until each has a count of answers."""
        deadline = time.monotonic() + MAX_START_S
        while min(map(len, self.answers)) < count:
            if time.monotonic() > deadline:
                raise SystemExit('no answer')
            for publisher in self._publishers:
                publisher.publish(self._samples(1)[0])
            self._sent += 1
            time.sleep(pause)

    def wait_for_no_subscribers(self) -> None:
        """Wait until no node is subscribed."""
        deadline = time.monotonic() + MAX_START_S
        while any(publisher.get_subscription_count() for publisher in self._publishers):
            if time.monotonic() > deadline:
                raise SystemExit('a node did not exit')
            time.sleep(0.01)

    def drive(self, seconds: float) -> dict[bytes, list[float]]:
        """Drive all at the rate, wait for answers; return the times of sending [s] by stamp."""
        count = len(self._publishers)
        received = [len(answers) for answers in self.answers]
        samples = self._samples(round(seconds / self._period_ns * 1e9))
        self._sent += len(samples)
        sent: dict[bytes, list[float]] = {stamp_of(sample): [] for sample in samples}
        pause = self._period_ns * 1e-9 / count  # robots are not in step with each other
        start = time.perf_counter()
        for number, sample in enumerate(samples):
            times = sent[stamp_of(sample)]
            for index, publisher in enumerate(self._publishers):
                wait = start + (number * count + index) * pause - time.perf_counter()
                if wait > 0.0:
                    time.sleep(wait)
                times.append(time.perf_counter())
                publisher.publish(sample)
        deadline = time.monotonic() + MAX_DELAY_S
        while time.monotonic() < deadline and any(
                len(answers) < before + len(samples)
                for answers, before in zip(self.answers, received, strict=True)):
            time.sleep(0.01)
        return sent

    def _samples(self, count: int) -> list[bytes]:
        """Return the next messages."""
        message, samples = JointState(name=['left_wheel_joint', 'right_wheel_joint']), []
        message.velocity = [LEFT_SPEED, RIGHT_SPEED]
        for number in range(self._sent, self._sent + count):
            stamp = number * self._period_ns
            message.header.stamp.sec, message.header.stamp.nanosec = (
                1_700_000_000 + stamp // 10**9, stamp % 10**9)
            message.position = [LEFT_SPEED * stamp * 1e-9, RIGHT_SPEED * stamp * 1e-9]
            samples.append(serialize_message(message))
        return samples

    def _spin(self) -> None:
        while not self._is_over:
            self._executor.spin_once(timeout_sec=0.5)

    @staticmethod
    def _append_to(answers: list[tuple[float, bytes]]) -> object:
        return lambda payload: answers.append((time.perf_counter(), payload))


def stamp_of(payload: bytes) -> bytes:
    """Return the stamp of a message, the first of its fields after the four bytes of CDR."""
    return bytes(payload[4:12])


def pose_error(first: bytes, last: bytes) -> str:
    """
    Return the error of the last of two answers, given the first, as text; '' if it is right.

    The wheels turn at constant speeds, so the motion between both is one arc.
    """
    first, last = (deserialize_message(each, Odometry) for each in (first, last))
    (start_ns, x, y, theta), (end_ns, *end) = _planar(first), _planar(last)
    seconds = (end_ns - start_ns) * 1e-9
    distance = 0.5 * WHEEL_RADIUS * (LEFT_SPEED + RIGHT_SPEED) * seconds
    turn = WHEEL_RADIUS * (RIGHT_SPEED - LEFT_SPEED) * seconds / WHEEL_SEPARATION
    radius = distance / turn
    off = math.hypot(
        end[0] - x - radius * (math.sin(theta + turn) - math.sin(theta)),
        end[1] - y + radius * (math.cos(theta + turn) - math.cos(theta)),
        math.remainder(end[2] - theta - turn, math.tau))
    if not off < TOLERANCE:
        return f'the last pose is {off:.1e} off'
    if not last.pose.covariance[0] > first.pose.covariance[0] > 0.0:
        return 'the covariance did not grow'
    return ''


def _planar(message: Odometry) -> tuple[int, float, float, float]:
    position, orientation = message.pose.pose.position, message.pose.pose.orientation
    return (message.header.stamp.sec * 10**9 + message.header.stamp.nanosec, position.x,
            position.y, 2.0 * math.atan2(orientation.z, orientation.w))
