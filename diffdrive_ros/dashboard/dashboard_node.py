"""The dashboard's ear and hand on ROS: what it hears is kept raw and opened when it is drawn."""
import asyncio
from collections import deque
from collections.abc import Iterable, Mapping, Sequence
import math
import threading
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray
from diffdrive_ros.core.quaternion import quaternion_of_heading
from diffdrive_ros.dashboard.teleop import Twist as PilotTwist
from diffdrive_ros.node import clock, runner
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

ASLEEP, AWAKE = 0.018, 0.002  # [s]

# Best effort: the node that is watched has nobody more to wait for or to send to again.
WATCHING = QoSProfile(depth=1, reliability=ReliabilityPolicy.BEST_EFFORT)
NEWEST_ONLY = QoSProfile(depth=1)
WHEELS = QoSProfile(depth=20, reliability=ReliabilityPolicy.BEST_EFFORT)

LONGEST_ANSWER = 3.0  # [s] that a service may take
LONGEST_LAST_WORD = 0.5  # [s] to wait until the last stop was heard
SIMULATOR = 'simulator'
LOOKERS = '_ros2cli'  # how the names of ros2 topic echo and its like begin

SERVICES = {
    'reset_odometry': Trigger, 'enable': SetBool, 'list_parameters': ListParameters,
    'describe_parameters': DescribeParameters, 'get_parameters': GetParameters,
    'set_parameters': SetParameters}


class NoAnswerError(Exception):
    """A service did not answer; the message says which."""


class Heard:
    """The newest message of a topic, opened when somebody asks for it."""

    def __init__(self, node: Node, kind: type, topic: str) -> None:
        self._kind = kind
        self._raw: bytes | None = None
        self._opened: tuple[bytes, Any] | None = None
        self._at = -math.inf
        self.subscription = node.create_subscription(
            kind, topic, self._take, WATCHING, raw=True)

    @property
    def age(self) -> float:
        """Return how long ago it came [s]."""
        return clock.steady() - self._at

    @property
    def message(self) -> Any:
        """Return the message, or None if none has come."""
        raw = self._raw
        if raw is not None and (self._opened is None or self._opened[0] is not raw):
            self._opened = raw, deserialize_message(raw, self._kind)
        return self._opened and self._opened[1]

    def _take(self, raw: bytes) -> None:
        self._raw, self._at = raw, clock.steady()


class HeardJoints:
    """The newest speed of each joint, whoever tells it and with whichever others."""

    def __init__(self, node: Node, topic: str) -> None:
        self._raw: deque[tuple[float, bytes]] = deque(maxlen=WHEELS.depth)
        self._speeds: dict[str, tuple[float, float]] = {}
        node.create_subscription(JointState, topic, self._take, WHEELS, raw=True)

    def speeds(self, names: Iterable[str], recent: float) -> Mapping[str, float]:
        """Return the finite speeds of joints that were told within the last seconds [rad/s]."""
        wanted = set(names)
        told = [self._raw.popleft() for _ in range(len(self._raw))]
        while told and wanted:  # the newest first, and none in vain
            at, raw = told.pop()
            message = deserialize_message(raw, JointState)
            found = {
                name: (at, speed)
                for name, speed in zip(message.name, message.velocity, strict=False)
                if name in wanted and math.isfinite(speed)}
            self._speeds.update(found)
            wanted -= found.keys()
        now = clock.steady()
        return {name: speed for name, (at, speed) in self._speeds.items() if now - at < recent}

    def _take(self, raw: bytes) -> None:
        self._raw.append((clock.steady(), raw))


class DashboardNode(Node):
    """
    Hears the robot, and commands it when the page says so.

    odometry is the name of the node that is shown. Its methods may be called from another thread
    than the one that spins.
    """

    def __init__(self, odometry: str = 'odometry', **kwargs: Any) -> None:
        super().__init__('dashboard', **kwargs)
        self.watched = (  # as /parameter_events and /diagnostics have it
            odometry if odometry.startswith('/')
            else f'{self.get_namespace().rstrip("/")}/{odometry}')
        self.odom = Heard(self, Odometry, 'odom')
        self.truth = Heard(self, Odometry, 'ground_truth')
        self.joints = HeardJoints(self, 'joint_states')
        self.applied = Heard(self, TwistStamped, f'{odometry}/cmd_vel_out')
        self.diagnostics: dict[str, tuple[float, Any]] = {}
        self.commands_status = f'{self.watched}: commands'
        self._told_of_commands: deque[Any] = deque(maxlen=100)
        self.parameters_changed_at = 0.0
        self.commands: Heard | None = None
        self.is_stamped = False
        self._odom_publishers: set[bytes] = set()
        self._commander: Any = None
        self._set_pose = self.create_publisher(
            PoseWithCovarianceStamped, f'{odometry}/set_pose', QoSProfile(depth=10))
        self.create_subscription(
            DiagnosticArray, '/diagnostics', self._on_diagnostics, QoSProfile(depth=10))
        self.create_subscription(
            ParameterEvent, '/parameter_events', self._on_parameters, QoSProfile(depth=100))
        self._clients_of = {
            name: self.create_client(kind, f'{odometry}/{name}')
            for name, kind in SERVICES.items()}

    def prepare(self, is_stamped: bool) -> None:
        """Choose the form of commands, so that the first one finds its listener known."""
        if self._commander and is_stamped == self.is_stamped:
            return
        if self._commander:
            self.destroy_publisher(self._commander)
        if self.commands:
            self.destroy_subscription(self.commands.subscription)
        kind = TwistStamped if is_stamped else Twist
        self.is_stamped = is_stamped
        self._commander = self.create_publisher(kind, 'cmd_vel', NEWEST_ONLY)
        self.commands = Heard(self, kind, 'cmd_vel')

    def command(self, twist: PilotTwist) -> None:
        """Publish a command, once."""
        if self._commander is None:
            self.prepare(self.is_stamped)
        message = TwistStamped() if self.is_stamped else Twist()
        plain = message
        if self.is_stamped:
            message.header.stamp = self.get_clock().now().to_msg()
            plain = message.twist
        plain.linear.x, plain.angular.z = map(float, twist)
        self._commander.publish(message)

    def last_words(self) -> None:
        """Wait until a stop that was sent is heard."""
        if self._commander:
            self._commander.wait_for_all_acked(Duration(seconds=LONGEST_LAST_WORD))

    def set_pose(self, x: float, y: float, theta: float, frame: str) -> None:
        """Ask odometry to be at a pose; it keeps its own word on the covariance."""
        message = PoseWithCovarianceStamped()
        message.header.frame_id = frame
        message.header.stamp = self.get_clock().now().to_msg()
        pose = message.pose.pose
        pose.position.x, pose.position.y = float(x), float(y)
        pose.orientation.z, pose.orientation.w = quaternion_of_heading(theta)
        self._set_pose.publish(message)

    async def ask(self, service: str, request: Any) -> Any:
        """Return the answer of a service of odometry; raises NoAnswerError."""
        client = self._clients_of[service]
        loop = asyncio.get_running_loop()
        deadline = loop.time() + LONGEST_ANSWER
        while not client.service_is_ready():
            if loop.time() > deadline:
                raise NoAnswerError(f'{client.srv_name} is not there: does odometry run?')
            await asyncio.sleep(0.05)
        answered: asyncio.Future[Any] = loop.create_future()

        def pass_on(future: Any) -> None:
            loop.call_soon_threadsafe(finish, future.result())

        def finish(result: Any) -> None:
            if not answered.done():
                answered.set_result(result)

        pending = client.call_async(request)
        pending.add_done_callback(pass_on)
        try:
            return await asyncio.wait_for(answered, LONGEST_ANSWER)
        except asyncio.TimeoutError:
            client.remove_pending_request(pending)
            raise NoAnswerError(f'{client.srv_name} does not answer') from None

    def is_simulated(self) -> bool:
        """Return whether a command moves nothing but a simulator, by way of the watched node."""
        simulator = f'{self.get_namespace().rstrip("/")}/{SIMULATOR}'
        return (self._listeners('cmd_vel') == [self.watched]
                and self._senders('wheel_commands') == [self.watched]
                and self._listeners('wheel_commands') == [simulator])

    def other_commanders(self) -> Sequence[str]:
        """Return who else publishes on cmd_vel: a second one of this name is another."""
        found = self._senders('cmd_vel')
        if self._commander and self.get_fully_qualified_name() in found:
            found.remove(self.get_fully_qualified_name())
        return found

    def told_of_commands(self) -> list[Any]:
        """Return the statuses of the watched node's commands since this was asked last."""
        return [self._told_of_commands.popleft() for _ in range(len(self._told_of_commands))]

    def newcomers_on_odom(self) -> bool:
        """Return whether somebody publishes odom who did not when this was asked last."""
        known, self._odom_publishers = self._odom_publishers, {
            bytes(end.endpoint_gid) for end in self.get_publishers_info_by_topic('odom')}
        return not self._odom_publishers <= known

    def _senders(self, topic: str) -> list[str]:
        return sorted(map(full_name, self.get_publishers_info_by_topic(topic)))

    def _listeners(self, topic: str) -> list[str]:
        """Return the full names of those who listen, but for those who only look."""
        return sorted(
            full_name(end) for end in self.get_subscriptions_info_by_topic(topic)
            if full_name(end) != self.get_fully_qualified_name()
            and not end.node_name.startswith(LOOKERS))

    def _on_diagnostics(self, message: Any) -> None:
        now = clock.steady()
        for status in message.status:
            self.diagnostics[status.name] = now, status
            if status.name == self.commands_status:
                self._told_of_commands.append(status)

    def _on_parameters(self, message: Any) -> None:
        if message.node == self.watched:
            self.parameters_changed_at = clock.steady()


def full_name(end: Any) -> str:
    """Return the name of the node of an endpoint, with its namespace."""
    return f'{end.node_namespace.rstrip("/")}/{end.node_name}'


class Spinner:
    """
    Spins a node in a thread of its own until it is closed, now and then.

    Pictures need no more, and no message of the robot wakes a processor that odometry may want.
    """

    def __init__(self, node: Node) -> None:
        self._executor = runner.make_executor()
        self._executor.add_node(node)
        self._ends = threading.Event()
        self._thread = threading.Thread(target=self._spin, name='ros')
        self._thread.start()

    def close(self) -> None:
        """End the thread, and wait for it."""
        self._ends.set()
        self._executor.wake()
        self._thread.join()

    def _spin(self) -> None:
        while not self._ends.wait(ASLEEP):
            self._executor.spin_until_future_complete(Future(), timeout_sec=AWAKE)
