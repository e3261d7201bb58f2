"""Drives through all that happens to wheel messages, into the node as a process, over DDS."""
from collections.abc import Callable, Iterator, Sequence
import math
import signal
import time

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from diffdrive_ros.core.kinematics import DiffDrive
from hypothesis import HealthCheck, Phase, settings, strategies as st
from hypothesis.stateful import initialize, rule, RuleBasedStateMachine, run_state_machine_as_test
from nav_msgs.msg import Odometry
import numpy as np
import pytest
from sensor_msgs.msg import JointState
from std_srvs.srv import Trigger
from support.faulty_run import Expected, FaultyRun, NAMES, PARAMETERS
from support.station import (
    GEOMETRY,
    LEFT_RADIUS,
    Process,
    RIGHT_RADIUS,
    SEPARATION,
    stamp_ns,
    Station,
    twist,
    wait_until,
)

# So that DDS loses nothing, and what does not come was not sent.
DEEP_AND_RELIABLE = {
    f'qos_overrides./{end}.{name}': value
    for end in ('joint_states.subscription', 'odom.publisher')
    for name, value in (('reliability', 'reliable'), ('history', 'keep_last'), ('depth', 2000))}


class Robot:
    """A node as a process, the faulty run that it receives, and its odometry."""

    def __init__(self, station: Station) -> None:
        self.station = station
        self.odometry = station.subscribe(Odometry, 'odom')
        self.diagnostics = station.subscribe(DiagnosticArray, '/diagnostics')
        self.drive = FaultyRun(self.publish)
        self.expected = Expected(DiffDrive(SEPARATION, LEFT_RADIUS, RIGHT_RADIUS))

    def begin(self) -> None:
        """Stand still until the node is received: discovery loses the first messages."""
        self.drive.begin()
        wait_until(lambda: self.odometry or self.drive.stand(), pause=0.05)
        wait_until(lambda: stamp_ns(self.odometry[-1][1]) == self.drive.now)
        first = stamp_ns(self.odometry[0][1])
        while self.drive.expected[0][0] != first:
            self.drive.expected.pop(0)
        self.drive.counts.clear()
        self.counted_before = self.counters()

    def publish(self, names: Sequence[str], positions: Sequence[float],
                velocities: Sequence[float], stamp: int) -> None:
        """Publish a message."""
        message = JointState(name=list(names), position=positions, velocity=velocities)
        message.header.stamp.sec, message.header.stamp.nanosec = divmod(stamp, 10**9)
        self.station.publish('joint_states', message)

    def judge(self) -> None:
        """Compare every answer since the last time with what was due."""
        due, self.drive.expected = self.drive.expected, []
        wait_until(lambda: len(self.odometry) >= len(due), timeout=5.0)
        received = [message for _, message in self.odometry]
        self.odometry.clear()
        assert [stamp_ns(message) for message in received] == [stamp for stamp, *_ in due]
        poses = [message.pose.pose for message in received]
        off = np.array([
            (pose.position.x, pose.position.y,
             2.0 * math.atan2(pose.orientation.z, pose.orientation.w)) for pose in poses])
        off -= self.expected.of(due)
        off[:, 2] = [math.remainder(angle, math.tau) for angle in off[:, 2]]
        assert np.abs(off).max() < 1e-9

    def counters(self) -> dict[str, int]:
        """Return what diagnostics count of the wheels' messages, after the next look."""
        seen = len(self.diagnostics)
        wait_until(lambda: len(self.diagnostics) > seen)
        return {item.key: int(item.value) for item in self.feedback.values if '[' not in item.key}

    def counted(self) -> dict[str, int]:
        """Return what was counted since the beginning."""
        before = self.counted_before
        now = {name: count - before.get(name, 0) for name, count in self.counters().items()}
        return {name: count for name, count in now.items() if count}

    @property
    def feedback(self) -> DiagnosticStatus:
        """Return the last status of the feedback."""
        [status] = [status for status in self.diagnostics[-1][1].status
                    if status.name.endswith(': feedback')]
        return status


@pytest.fixture(scope='module')
def robot(domain_of_module: int) -> Iterator[Robot]:
    """Return a robot that drives from test to test."""
    process = Process('odometry_node', **GEOMETRY, **PARAMETERS, **DEEP_AND_RELIABLE)
    station = Station(domain_of_module)
    try:
        robot = Robot(station)
        robot.begin()
        yield robot
    finally:
        station.close()
        process.close()


@pytest.mark.parametrize('fault', FaultyRun.FAULTS)
def test_poses_match_the_undamaged_run_but_for_known_loss(
        robot: Robot, fault: str) -> None:
    """On the way through the fault, three times, and after it."""
    for _ in range(3):
        getattr(robot.drive, fault)()
        for _ in range(4):
            robot.drive.ordinary_sample()
    robot.judge()


class Mixture(RuleBasedStateMachine):
    """Any fault after any other."""

    robot: Robot

    @initialize(seed=st.integers(0, 2**32))
    def start_at_zero(self, seed: int) -> None:
        """Go on with the time and the encoders as they are, and the pose at zero."""
        robot = self.robot
        robot.drive.random.seed(seed)
        answer = robot.station.call(Trigger, 'odometry/reset_odometry', Trigger.Request())
        assert answer.success
        robot.expected.reset()

    @rule(fault=st.sampled_from(FaultyRun.FAULTS))
    def suffer(self, fault: str) -> None:
        """Let a fault happen."""
        getattr(self.robot.drive, fault)()

    def teardown(self) -> None:
        """Judge all poses of the way."""
        if self.robot.drive.expected:
            self.robot.judge()


def test_poses_are_right_through_any_mixture_of_faults(robot: Robot) -> None:
    """Drawn by Hypothesis; each begins with ~/reset_odometry."""
    class OfThisRobot(Mixture):
        pass

    OfThisRobot.robot = robot
    run_state_machine_as_test(OfThisRobot, settings=settings(
        max_examples=50, stateful_step_count=15, deadline=None, derandomize=True, database=None,
        # It is the same drive that goes on: what failed cannot be driven again, and not shrunk.
        phases=[Phase.generate], suppress_health_check=list(HealthCheck)))


def test_faults_are_counted(robot: Robot) -> None:
    """The counters of the diagnostics have the faults."""
    for fault in FaultyRun.FAULTS:
        getattr(robot.drive, fault)()
    robot.judge()
    assert robot.counted() == dict(robot.drive.counts)


def test_two_time_resets_before_all_wheels_publish_odom(
        robot: Robot) -> None:
    """The second reset counts: odom does not wait until the first time is reached."""
    left, right = NAMES
    now = robot.drive.now
    raw = robot.drive.raw()
    for name, back_ms in (
            (left, 50_000), (left, 49_980), (left, 90_000), (left, 89_980), (right, 90_000),
            (right, 89_980)):
        robot.publish([name], [raw[NAMES.index(name)]], [], now - back_ms * 1_000_000)
    wait_until(lambda: robot.odometry, timeout=5.0)
    [(_, message)] = robot.odometry
    assert stamp_ns(message) == now - 89_980_000_000


@pytest.fixture
def alone(station: Station, start: Callable[..., Process]) -> tuple[Robot, Process]:
    """Return a robot of its own, and its process."""
    process = start('odometry_node', feedback_timeout=0.4, cmd_vel_timeout=0, **GEOMETRY,
                    **PARAMETERS, **DEEP_AND_RELIABLE)
    return Robot(station), process


def test_missing_positions_and_silent_encoders_warn_once(
        alone: tuple[Robot, Process]) -> None:
    """The first positions are the baseline; a timeout stops the wheels; the motion is not lost."""
    robot, process = alone
    wheels = robot.station.subscribe(JointState, 'wheel_commands')

    def say_no_positions() -> None:
        for _ in range(10):
            robot.publish(NAMES, [], [7.0, 8.0], 1)

    # As often as it takes: discovery loses the first ones.
    wait_until(lambda: say_no_positions() or robot.counters().get('missing_values', 0) >= 20)
    assert robot.odometry == []
    robot.begin()
    position = robot.odometry[0][1].pose.pose.position
    assert (position.x, position.y) == (0.0, 0.0)

    def drive_on() -> None:
        robot.drive.ordinary_sample()
        robot.station.publish('cmd_vel', twist(0.2, 0.1))

    wait_until(lambda: (wheels and wheels[-1][1].velocity[0]) or drive_on(), pause=0.02)
    stopped_at = time.monotonic()
    wait_until(lambda: list(wheels[-1][1].velocity) == [0.0, 0.0])
    assert 0.3 < time.monotonic() - stopped_at < 0.7
    wait_until(lambda: robot.feedback.level == DiagnosticStatus.ERROR)
    robot.drive.pause_in_motion()
    robot.judge()
    wait_until(lambda: robot.feedback.level == DiagnosticStatus.OK)
    process.signal(signal.SIGINT)
    assert process.wait() == 0
    warnings = [line for line in process.output.splitlines() if 'WARN' in line]
    assert sum('set position_feedback to false' in line for line in warnings) == 1
    # Once more where discovery takes so long.
    assert sum('no message for 2 s' in line for line in warnings) in (1, 2)
