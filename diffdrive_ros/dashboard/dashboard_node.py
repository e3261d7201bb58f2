"""The dashboard's ROS node: subscriptions keep messages serialized until they are displayed."""
import asyncio
from collections import deque
from collections.abc import Iterable, Mapping, Sequence
import concurrent.futures
from functools import lru_cache
import math
import threading
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray
from diffdrive_ros.core.quaternion import quaternion_of_heading
from diffdrive_ros.dashboard.teleop import Twist as TeleopTwist
from diffdrive_ros.node import rclpy_internals, steady_clock
from geometry_msgs.msg import PoseWithCovarianceStamped, Twist, TwistStamped
from nav_msgs.msg import Odometry
from rcl_interfaces.msg import ParameterEvent
from rcl_interfaces.srv import DescribeParameters, GetParameters, ListParameters, SetParameters
from rclpy.duration import Duration
from rclpy.node import Node
from rclpy.qos import QoSProfile, ReliabilityPolicy
from rclpy.serialization import deserialize_message
from rclpy.task import Future
from sensor_msgs.msg import JointState
from std_srvs.srv import SetBool, Trigger

SPIN_PAUSE_S, SPIN_SLICE_S = 0.018, 0.002

# Best effort: the observed node neither waits for the dashboard nor sends anything again.
LATEST = QoSProfile(depth=1, reliability=ReliabilityPolicy.BEST_EFFORT)
JOINT_STATES = QoSProfile(depth=20, reliability=ReliabilityPolicy.BEST_EFFORT)
COMMANDS = QoSProfile(depth=1)

SERVICE_TIMEOUT_S = 3.0
FLUSH_TIMEOUT_S = 0.5
SIMULATOR = 'simulator'
ROS2CLI_PREFIX = '_ros2cli'  # of the node names of ros2 topic echo and the like

SERVICES = {
    'reset_odometry': Trigger, 'enable': SetBool, 'list_parameters': ListParameters,
    'describe_parameters': DescribeParameters, 'get_parameters': GetParameters,
    'set_parameters': SetParameters}


class ServiceError(Exception):
    """A service of the observed node is of no use; the message names it."""


class LatestMessage:
    """The newest message of a topic, deserialized on demand."""

    def __init__(self, node: Node, kind: type, topic: str) -> None:
        self._kind = kind
        self._serialized: bytes | None = None
        self._deserialize = lru_cache(maxsize=1)(deserialize_message)
        self._received_at = -math.inf
        self.subscription = node.create_subscription(
            kind, topic, self._receive, LATEST, raw=True)

    @property
    def age(self) -> float:
        """Return the time since its receipt [s]."""
        return steady_clock.steady() - self._received_at

    @property
    def message(self) -> Any:
        """Return the message, or None before the first one."""
        raw = self._serialized
        return raw and self._deserialize(raw, self._kind)

    def _receive(self, raw: bytes) -> None:
        self._serialized, self._received_at = raw, steady_clock.steady()


class LatestJointSpeeds:
    """The newest speed of each joint, however joints are distributed over messages."""

    def __init__(self, node: Node, topic: str) -> None:
        self._queue: deque[tuple[float, bytes]] = deque(maxlen=JOINT_STATES.depth)
        self._speeds: dict[str, tuple[float, float]] = {}
        node.create_subscription(JointState, topic, self._receive, JOINT_STATES, raw=True)

    def speeds(self, names: Iterable[str], max_age: float) -> Mapping[str, float]:
        """Return the finite speeds of joints, received at most max_age [s] ago [rad/s]."""
        missing = set(names)
        received = [self._queue.popleft() for _ in range(len(self._queue))]
        while received and missing:  # the newest first, and no more than needed
            at, raw = received.pop()
            message = deserialize_message(raw, JointState)
            found = {
                name: (at, speed)
                for name, speed in zip(message.name, message.velocity, strict=False)
                if name in missing and math.isfinite(speed)}
            self._speeds.update(found)
            missing -= found.keys()
        now = steady_clock.steady()
        return {name: speed for name, (at, speed) in self._speeds.items() if now - at < max_age}

    def _receive(self, raw: bytes) -> None:
        self._queue.append((steady_clock.steady(), raw))


class DashboardNode(Node):
    """
    Observes an odometry node, calls its services and publishes commands.

    odometry is the name of the observed node. Its methods may be called from another thread than
    the one that spins.
    """

    def __init__(self, odometry: str = 'odometry', **kwargs: Any) -> None:
        super().__init__('dashboard', **kwargs)
        self.observed = (  # as in /parameter_events and /diagnostics
            odometry if odometry.startswith('/')
            else f'{self.get_namespace().rstrip("/")}/{odometry}')
        self.odom = LatestMessage(self, Odometry, 'odom')
        self.ground_truth = LatestMessage(self, Odometry, 'ground_truth')
        self.joints = LatestJointSpeeds(self, 'joint_states')
        self.applied = LatestMessage(self, TwistStamped, f'{odometry}/cmd_vel_out')
        self.commands: LatestMessage | None = None
        self.diagnostics: dict[str, tuple[float, Any]] = {}
        """Time of receipt and status, by the name of the status."""
        self.commands_status = f'{self.observed}: commands'
        self.parameters_changed_at = 0.0
        self.is_stamped = False
        self._new_command_statuses: deque[Any] = deque(maxlen=100)
        self._odom_publishers: set[bytes] = set()
        self._command_publisher: Any = None
        self._pose_publisher = self.create_publisher(
            PoseWithCovarianceStamped, f'{odometry}/set_pose', QoSProfile(depth=10))
        self.create_subscription(
            DiagnosticArray, '/diagnostics', self._on_diagnostics, QoSProfile(depth=10))
        self.create_subscription(
            ParameterEvent, '/parameter_events', self._on_parameters, QoSProfile(depth=100))
        self._service_clients = {
            name: self.create_client(kind, f'{odometry}/{name}')
            for name, kind in SERVICES.items()}

    def advertise_commands(self, is_stamped: bool) -> None:
        """Create the publisher of cmd_vel, so that it is matched before the first command."""
        if self._command_publisher and is_stamped == self.is_stamped:
            return
        if self.commands:
            self.destroy_publisher(self._command_publisher)
            self.destroy_subscription(self.commands.subscription)
        kind = TwistStamped if is_stamped else Twist
        self.is_stamped = is_stamped
        self._command_publisher = self.create_publisher(kind, 'cmd_vel', COMMANDS)
        self.commands = LatestMessage(self, kind, 'cmd_vel')

    def publish_command(self, twist: TeleopTwist) -> None:
        """Publish a command, once."""
        self.advertise_commands(self.is_stamped)
        message = TwistStamped() if self.is_stamped else Twist()
        plain = message
        if self.is_stamped:
            message.header.stamp = self.get_clock().now().to_msg()
            plain = message.twist
        plain.linear.x, plain.angular.z = map(float, twist)
        self._command_publisher.publish(message)

    def flush_commands(self) -> None:
        """Wait until the last command is acknowledged."""
        if self._command_publisher:
            self._command_publisher.wait_for_all_acked(Duration(seconds=FLUSH_TIMEOUT_S))

    def set_pose(self, x: float, y: float, theta: float, frame: str) -> None:
        """Set the pose of the odometry, which keeps its covariance."""
        message = PoseWithCovarianceStamped()
        message.header.frame_id = frame
        message.header.stamp = self.get_clock().now().to_msg()
        pose = message.pose.pose
        pose.position.x, pose.position.y = float(x), float(y)
        pose.orientation.z, pose.orientation.w = quaternion_of_heading(theta)
        self._pose_publisher.publish(message)

    async def call(self, service: str, request: Any) -> Any:
        """Return the response of a service of the observed node; raises ServiceError."""
        client = self._service_clients[service]
        loop = asyncio.get_running_loop()
        deadline = loop.time() + SERVICE_TIMEOUT_S
        while not client.service_is_ready():
            if loop.time() > deadline:
                raise ServiceError(f'{client.srv_name} is not available: does odometry run?')
            await asyncio.sleep(0.05)
        response: concurrent.futures.Future[Any] = concurrent.futures.Future()
        response.set_running_or_notify_cancel()  # no error for a response after the timeout
        pending = client.call_async(request)
        pending.add_done_callback(lambda future: response.set_result(future.result()))
        try:
            return await asyncio.wait_for(asyncio.wrap_future(response), SERVICE_TIMEOUT_S)
        except asyncio.TimeoutError:
            client.remove_pending_request(pending)
            raise ServiceError(f'{client.srv_name} does not respond') from None

    def is_simulated(self) -> bool:
        """Return whether commands reach nothing but a simulator, through the observed node."""
        simulator = f'{self.get_namespace().rstrip("/")}/{SIMULATOR}'
        return (self._subscriber_names('cmd_vel') == [self.observed]
                and self._publisher_names('wheel_commands') == [self.observed]
                and self._subscriber_names('wheel_commands') == [simulator])

    def other_commanders(self) -> Sequence[str]:
        """Return the other nodes that publish cmd_vel, one of the dashboard's name included."""
        found = self._publisher_names('cmd_vel')
        if self._command_publisher and self.get_fully_qualified_name() in found:
            found.remove(self.get_fully_qualified_name())
        return found

    def take_command_statuses(self) -> list[Any]:
        """Return the statuses `commands` of the observed node since the last call."""
        return [self._new_command_statuses.popleft()
                for _ in range(len(self._new_command_statuses))]

    def has_new_odom_publisher(self) -> bool:
        """Return whether odom has a publisher that it did not have at the last call."""
        known, self._odom_publishers = self._odom_publishers, {
            bytes(end.endpoint_gid) for end in self.get_publishers_info_by_topic('odom')}
        return not self._odom_publishers <= known

    def _publisher_names(self, topic: str) -> list[str]:
        return sorted(map(full_name, self.get_publishers_info_by_topic(topic)))

    def _subscriber_names(self, topic: str) -> list[str]:
        """Return the full names of the subscribers but this node and those of ros2cli."""
        return sorted(
            full_name(end) for end in self.get_subscriptions_info_by_topic(topic)
            if full_name(end) != self.get_fully_qualified_name()
            and not end.node_name.startswith(ROS2CLI_PREFIX))

    def _on_diagnostics(self, message: Any) -> None:
        now = steady_clock.steady()
        for status in message.status:
            self.diagnostics[status.name] = now, status
            if status.name == self.commands_status:
                self._new_command_statuses.append(status)

    def _on_parameters(self, message: Any) -> None:
        if message.node == self.observed:
            self.parameters_changed_at = steady_clock.steady()


def full_name(end: Any) -> str:
    """Return the name of the node of an endpoint, with its namespace."""
    return f'{end.node_namespace.rstrip("/")}/{end.node_name}'


class SpinThread:
    """
    A thread that spins a node in short slices until it is closed.

    Frames need no more, and messages of the robot do not wake a processor that odometry may need.
    """

    def __init__(self, node: Node) -> None:
        self._executor = rclpy_internals.make_executor()
        self._executor.add_node(node)
        self._is_closed = threading.Event()
        self._thread = threading.Thread(target=self._spin, name='ros')
        self._thread.start()

    def close(self) -> None:
        """End the thread, and wait for it."""
        self._is_closed.set()
        self._thread.join()

    def _spin(self) -> None:
        while not self._is_closed.wait(SPIN_PAUSE_S):
            self._executor.spin_until_future_complete(Future(), timeout_sec=SPIN_SLICE_S)
