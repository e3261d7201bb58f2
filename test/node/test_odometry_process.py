"""The node odometry as a process: how it starts, how it refuses to, and how it stops."""
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
import itertools
import math
import os
from pathlib import Path
import re
import signal
import subprocess
import sys
import time

from diagnostic_msgs.msg import DiagnosticArray
from diffdrive_ros.core.kinematics import DiffDrive
from nav_msgs.msg import Odometry
import pytest
from sensor_msgs.msg import JointState
from std_srvs.srv import SetBool
from support.station import (
    GEOMETRY,
    is_ramp,
    joints,
    Process,
    SEPARATION,
    stamp_ns,
    Station,
    twist,
    wait_until,
)

Start = Callable[..., Process]

EXAMPLE = DiffDrive(0.160, 0.033, 0.033)
PERIOD = 0.02  # of the wheel commands at the default rate
LATE = 0.1  # what a loaded machine may add to any of the times below


def drive(station: Station) -> list[tuple[float, JointState]]:
    """Command a curve until the wheels turn; return what was and will be received of them."""
    received = station.subscribe(JointState, 'wheel_commands')
    wait_until(lambda: station.node.count_publishers('wheel_commands'))
    while not received:
        station.publish('cmd_vel', twist(0.2, 0.7))
        time.sleep(0.01)
    return received


def is_zero(message: JointState) -> bool:
    """Return whether a wheel command stops all wheels."""
    return list(message.velocity) == [0.0, 0.0]


def test_command_is_sent_to_the_wheels_within_two_periods(
        station: Station, start: Start) -> None:
    """The first command, and each change."""
    start('odometry_node')
    received = drive(station)
    wait_until(lambda: len(received) > 10)
    for speed in (0.1, -0.3, 0.25):
        station.publish('cmd_vel', twist(speed, 0.7))
        sent_at = time.monotonic()
        expected = pytest.approx(EXAMPLE.wheel_speeds(speed, 0.7))
        wait_until(lambda expected=expected: list(received[-1][1].velocity) == expected)
        first = next(at for at, message in received if list(message.velocity) == expected)
        assert first - sent_at < 2.0 * PERIOD + LATE


@pytest.mark.parametrize(('linear', 'angular'), [
    (math.nan, 0.1), (0.1, math.nan), (math.inf, 0.0), (-math.inf, 0.0), (1e308, -1e308)])
def test_nan_command_stops_the_wheels(
        station: Station, start: Start, linear: float, angular: float) -> None:
    """The next valid one is driven; the reason is logged once, not per command."""
    process = start('odometry_node')
    received = drive(station)
    for _ in range(5):
        station.publish('cmd_vel', twist(linear, angular))
    sent_at = time.monotonic()
    wait_until(lambda: is_zero(received[-1][1]))
    assert received[-1][0] - sent_at < 2.0 * PERIOD + LATE
    station.publish('cmd_vel', twist(0.2, 0.7))
    wait_until(lambda: not is_zero(received[-1][1]))
    process.signal(signal.SIGINT)
    assert process.wait() == 0
    assert process.output.count('must be finite') == 1


def test_cmd_vel_timeout_stops_the_wheels(station: Station, start: Start) -> None:
    """The command source died: zero within the timeout and one period, logged once."""
    process = start('odometry_node', cmd_vel_timeout=0.31)
    received = drive(station)
    sent_at = received[0][0]
    wait_until(lambda: is_zero(received[-1][1]))
    assert 0.31 - 2.0 * PERIOD < received[-1][0] - sent_at < 0.31 + PERIOD + LATE
    count = len(received)
    wait_until(lambda: len(received) > count + 20)
    assert all(is_zero(message) for _, message in received[count:])
    process.signal(signal.SIGTERM)
    assert process.wait() == 0
    assert process.output.count('no command for 0.31 s') == 1


def test_pause_of_the_process_counts_as_deceleration(station: Station, start: Start) -> None:
    """It does not continue with the speed from before."""
    process = start('odometry_node', cmd_vel_timeout=0.3, **{
        'linear.x.max_acceleration': 5.0, 'linear.x.max_deceleration': -0.5})
    received = station.subscribe(JointState, 'wheel_commands')
    station.publish_until(
        lambda: received and received[-1][1].velocity[0] > 20.0, 'cmd_vel',
        itertools.repeat(twist(1.0, 0.0)))
    process.signal(signal.SIGSTOP)
    time.sleep(2.5)
    before = len(received)
    process.signal(signal.SIGCONT)
    wait_until(lambda: len(received) > before + 5)
    assert all(is_zero(message) for _, message in received[before + 1:])


def full_pipe() -> tuple[int, int]:
    """Return the ends of a pipe that takes no more; it blocks, as a console does."""
    reader, writer = os.pipe()
    os.set_blocking(writer, False)
    with suppress(BlockingIOError):
        while True:
            os.write(writer, bytes(4096))
    os.set_blocking(writer, True)
    return reader, writer


def test_blocked_console_stops_no_node(station: Station) -> None:
    """Ctrl-S in a terminal or a full pipe: it drives, stops and ends all the same."""
    reader, writer = full_pipe()
    process = subprocess.Popen(
        [sys.executable, '-m', 'diffdrive_ros.node.odometry_node'], stderr=writer)
    try:
        received = drive(station)
        wait_until(lambda: is_zero(received[-1][1]), timeout=0.5 + PERIOD + 10 * LATE)
        process.send_signal(signal.SIGTERM)
        assert process.wait(timeout=3.0) == 0
    finally:
        process.kill()
        process.wait()
        os.close(reader)
        os.close(writer)


def test_crash_of_the_interpreter_prints_a_trace(station: Station, start: Start) -> None:
    """The wheels keep turning, and the trace is all that explains it."""
    process = start('odometry_node')
    drive(station)
    process.signal(signal.SIGSEGV)
    assert process.wait() == -signal.SIGSEGV
    assert 'Fatal Python error: Segmentation fault' in process.output


def test_crash_ends_the_process_on_a_blocked_console(station: Station) -> None:
    """Otherwise nothing would restart it."""
    reader, writer = full_pipe()
    process = subprocess.Popen(
        [sys.executable, '-m', 'diffdrive_ros.node.odometry_node'], stderr=writer)
    try:
        drive(station)
        process.send_signal(signal.SIGSEGV)
        assert process.wait(timeout=3.0) == -signal.SIGSEGV
    finally:
        process.kill()
        process.wait()
        os.close(reader)
        os.close(writer)


def test_timeout_of_zero_never_stops_and_warns(
        station: Station, start: Start) -> None:
    """It has to be chosen explicitly."""
    process = start('odometry_node', cmd_vel_timeout=0)
    received = drive(station)
    wait_until(lambda: len(received) > 60)
    assert not any(is_zero(message) for _, message in received)
    process.signal(signal.SIGINT)
    assert process.wait() == 0
    assert 'cmd_vel_timeout = 0.0' in process.output


@pytest.mark.parametrize('form', ['joint_state', 'per_wheel'])
@pytest.mark.parametrize(
    'number', [signal.SIGINT, signal.SIGTERM, signal.SIGHUP, signal.SIGQUIT])
def test_signal_stops_the_wheels_and_the_zero_arrives(
        station: Station, start: Start, number: signal.Signals, form: str) -> None:
    """Exit code 0, no traceback, and nothing after the zero."""
    from std_msgs.msg import Float64
    process = start('odometry_node', wheel_command_type=form, **GEOMETRY)
    if form == 'joint_state':
        received = drive(station)
    else:
        received = station.subscribe(Float64, 'right_wheel_joint/command')
        station.subscribe(Float64, 'left_wheel_joint/command')
        wait_until(lambda: station.node.count_publishers('right_wheel_joint/command'))
        station.publish('cmd_vel', twist(0.2, 0.7))
        wait_until(lambda: received)
    sent_at = time.monotonic()
    process.signal(number)
    assert process.wait() == 0
    wait_until(lambda: received[-1][0] > sent_at)
    at, last = received[-1]
    assert is_zero(last) if form == 'joint_state' else last.data == 0.0
    assert at - sent_at < PERIOD + LATE
    assert 'Traceback' not in process.output


def test_signal_while_idle_sends_no_wheel_command(
        station: Station, start: Start) -> None:
    """Wheels that were never commanded are left alone."""
    process = start('odometry_node')
    received = station.subscribe(JointState, 'wheel_commands')
    wait_until(lambda: station.node.count_publishers('wheel_commands'))
    sent_at = time.monotonic()
    process.signal(signal.SIGTERM)
    assert process.wait() == 0
    assert time.monotonic() - sent_at < 3.0
    assert received == []


def test_bare_start_runs_the_example_robot_and_warns(
        station: Station, start: Start) -> None:
    """It can be driven at once."""
    process = start('odometry_node')
    odometry = station.subscribe(Odometry, 'odom')
    station.publish_until(lambda: odometry, 'joint_states', (
        joints(k, left_wheel_joint=1.0, right_wheel_joint=2.0) for k in itertools.count(1)))
    process.signal(signal.SIGINT)
    assert process.wait() == 0
    [warning] = [line for line in process.output.splitlines()
                 if 'WARN' in line and 'no message for 2 s' not in line]
    assert 'example robot, wheel_separation 0.16 m, wheel radii 0.033 and 0.033 m' in warning


def test_given_geometry_starts_without_a_warning(station: Station, start: Start) -> None:
    """The geometry is logged: a wrong number is seen best where it is used."""
    process = start('odometry_node', **GEOMETRY)
    wait_until(lambda: station.node.count_publishers('odom'))
    process.signal(signal.SIGINT)
    assert process.wait() == 0
    assert not [line for line in process.output.splitlines()
                if 'WARN' in line and 'no message for 2 s' not in line]
    assert f'wheel_separation {SEPARATION} m, wheel radii 0.0471 and 0.0533 m' in process.output


GOOD = 'wheel_separation: 0.3\n    wheel_radius: 0.05\n    '

REFUSALS = [
    ('wheel_radius: -1', 'wheel_radius = -1.0: must be positive and finite'),
    ('wheel_radius: 0.05\n    wheel_seperation: 0.3',
     'wheel_radius came without it; wheel_seperation is no parameter of this node'),
    ('wheel_radius: "a"', "wheel_radius = 'a': must be a double"),
    ('wheel_radius: .nan', 'wheel_radius = nan: must be positive and finite'),
    ('wheel_radius: .inf', 'wheel_radius = inf: must be positive and finite'),
    ('wheel_separation: 0', 'wheel_separation = 0.0: must be positive and finite'),
    ('wheel_radius: 0.05', 'wheel_separation = (not set): must be positive'),
    ('wheel_separation: 0.3', 'wheel_radius = (not set): must be positive'),
    (GOOD + 'left_wheel_names: [fl]', 'right_wheel_names = (not set): must be a list'),
    (GOOD + 'left_wheel_names: [fl, rl]\n    right_wheel_names: [fr]',
     "right_wheel_names = ['fr']: must be as many as left_wheel_names, 2"),
    (GOOD + 'left_wheel_names: [a]\n    right_wheel_names: [a]',
     "right_wheel_names = ['a']: must not share a with left_wheel_names"),
    (GOOD + 'left_wheel_names: []\n    right_wheel_names: []', 'left_wheel_names = '),
    (GOOD + 'left_wheel_names: wheel\n    right_wheel_names: [fr]',
     "left_wheel_names = 'wheel': must be a list of strings"),
    (GOOD + 'wheel_command_type: pwm',
     "wheel_command_type = 'pwm': must be one of joint_state, multi_array, per_wheel, none"),
    (GOOD + 'cmd_vel_timeout: -0.5', 'cmd_vel_timeout = -0.5: must be finite and zero or more'),
    (GOOD + 'command_rate: 0.0', 'command_rate = 0.0: must be from 1 to 1000 Hz'),
    (GOOD + 'open_loop: 1', 'open_loop = 1: must be a bool'),
    (GOOD + 'velocity_rolling_window_size: 0',
     'velocity_rolling_window_size = 0: must be from 1 to 10000'),
    (GOOD + 'base_frame_id: odom', "base_frame_id = 'odom': must differ from odom_frame_id"),
    (GOOD + 'left_wheel_names: [a-b]\n    right_wheel_names: [c]\n    '
     'wheel_command_type: per_wheel', 'wheel_command_type = '),
]


def test_wrong_parameters_exit_with_one_line(
        station: Station, start: Start, tmp_path: Path) -> None:
    """Parameter, value, rule and node in the line; exit code 1; no wheel is commanded."""
    received = station.subscribe(JointState, '/robot/wheel_commands')
    refused = []
    for number, (text, line) in enumerate(REFUSALS):
        file = tmp_path / f'{number}.yaml'
        file.write_text(f'/robot/odometry:\n  ros__parameters:\n    {text}\n')
        refused.append((line, start(
            'odometry_node', '-r', '__ns:=/robot', '--params-file', str(file))))
        if number % 4 == 3:
            wait_until(lambda: not refused[-4][1].is_running)
    for line, process in refused:
        assert process.wait() == 1, line
        [logged] = process.output.strip().splitlines()
        assert logged.startswith('odometry: /robot/odometry cannot start: ')
        assert line in logged
    assert received == []


def test_parameter_file_for_another_node_is_rejected(start: Start, tmp_path: Path) -> None:
    """The commonest mistake: a key that does not match the node, and defaults on the robot."""
    file = tmp_path / 'robot.yaml'
    file.write_text(f'diff_drive:\n  ros__parameters:\n    {GOOD}\n')
    process = start('odometry_node', '--params-file', str(file))
    assert process.wait() == 1
    [logged] = process.output.strip().splitlines()
    assert 'wheel_separation = (not set): must be positive' in logged
    assert 'gives /odometry no geometry: its key must be /odometry or /**/odometry' in logged


@pytest.mark.parametrize('text', ['odometry:\n  ros__parameters:\n    wheel_rad', '', '{'])
def test_truncated_parameter_file_is_rejected(start: Start, tmp_path: Path, text: str) -> None:
    """The line names the file or the missing parameter."""
    file = tmp_path / 'half.yaml'
    file.write_text(text)
    process = start('odometry_node', '--params-file', str(file))
    assert process.wait() == 1
    assert 'Traceback' not in process.output
    assert 'wheel_separation = (not set)' in process.output or 'half.yaml' in process.output


def test_parameter_file_without_ros_args_is_rejected(tmp_path: Path) -> None:
    """Ignored, it would leave the example robot's geometry on a real one."""
    ended = subprocess.run(
        [sys.executable, '-m', 'diffdrive_ros.node.odometry_node', '--params-file', 'robot.yaml'],
        capture_output=True, text=True, timeout=20)
    assert ended.returncode == 2
    assert 'unrecognized arguments: --params-file robot.yaml' in ended.stderr


PLAIN_RCLPY = """
import sys

sys.modules['rclpy.experimental'] = None  # an rclpy without EventsExecutor
from diffdrive_ros.node import odometry_node, rclpy_internals

rclpy_internals.private = lambda *path: None
odometry_node.main()
"""


@pytest.mark.parametrize('program', [
    ['-m', 'diffdrive_ros.node.odometry_node'], ['-c', PLAIN_RCLPY]])
def test_node_drives_and_stops_with_any_rclpy(station: Station, program: list[str]) -> None:
    """With EventsExecutor and rclpy's internals, and by the public API alone."""
    process = subprocess.Popen([sys.executable, *program])
    try:
        received, odom = drive(station), station.subscribe(Odometry, 'odom')
        station.publish_until(lambda: odom, 'joint_states', (
            joints(k, left_wheel_joint=0.1 * k, right_wheel_joint=0.2)
            for k in itertools.count(1)))
        process.send_signal(signal.SIGTERM)
        assert process.wait(timeout=10.0) == 0
        wait_until(lambda: is_zero(received[-1][1]))
    finally:
        process.kill()
        process.wait()


def test_missing_joint_states_are_a_warning(station: Station, start: Start) -> None:
    """With the topic as remapped, and who publishes it."""
    process = start('odometry_node', '-r', '__ns:=/robot', '-r', 'joint_states:=wheels')
    statuses = station.subscribe(DiagnosticArray, '/diagnostics')
    wait_until(lambda: statuses)
    station.node.create_publisher(JointState, '/robot/wheels', 1)
    start_at = time.monotonic()
    wait_until(lambda: 'no message' in statuses[-1][1].status[0].message
               and time.monotonic() - start_at > 2.0)
    process.signal(signal.SIGINT)
    assert process.wait() == 0
    assert re.search(r'WARN.*/robot/wheels: no message for 2 s, so no /robot/odom; published by '
                     r'(no node|station)', process.output)
    assert process.output.count('no message') == 1
    assert '/robot/odom: odom to base_link, from /robot/wheels' in process.output
    assert re.search(r'/robot/wheel_commands: .*from /robot/cmd_vel \(Twist\)', process.output)


def test_wheel_commands_are_sent_at_command_rate(station: Station, start: Start) -> None:
    """Zeros too: watchdogs of drivers rely on it."""
    start('odometry_node', command_rate=20, cmd_vel_timeout=0.3)
    received = drive(station)
    wait_until(lambda: len(received) > 30)
    moments = [at for at, _ in received]
    gaps = sorted(b - a for a, b in itertools.pairwise(moments))
    assert gaps[len(gaps) // 2] == pytest.approx(0.05, abs=0.01)


def test_command_is_sent_within_two_slow_periods(
        station: Station, start: Start) -> None:
    """At 5 Hz, where nothing but the rule takes that long."""
    start('odometry_node', command_rate=5)
    received = station.subscribe(JointState, 'wheel_commands')
    wait_until(lambda: station.node.count_publishers('wheel_commands'))
    station.publish_until(lambda: received, 'cmd_vel', itertools.repeat(twist(0.2, 0.7)))
    sent_at = time.monotonic()
    station.publish('cmd_vel', twist(-0.1, 0.7))
    expected = pytest.approx(EXAMPLE.wheel_speeds(-0.1, 0.7))
    wait_until(lambda: list(received[-1][1].velocity) == expected)
    first = next(at for at, message in received if list(message.velocity) == expected)
    assert first - sent_at < 2.0 * 0.2


@pytest.mark.parametrize('topic', [
    'joint_states', 'odometry/set_pose', 'odometry/get_parameters'])
def test_message_flood_does_not_delay_the_timeout(
        station: Station, start: Start, topic: str) -> None:
    """More messages of any kind than can be processed: the watchdog comes first."""
    start('odometry_node')
    received = drive(station)
    with flood(station, topic):
        for _ in range(50):
            station.publish('cmd_vel', twist(0.2, 0.7))
            time.sleep(0.02)
        due_at = time.time() + 0.5 + PERIOD + LATE

        def sent() -> list[tuple[float, JointState]]:
            """Return the commands by their stamps: the flood delays their receipt too."""
            return [(stamp_ns(message) * 1e-9, message) for _, message in list(received)]

        wait_until(lambda: sent()[-1][0] > due_at + 1.0)
        assert all(is_zero(message) for at, message in sent() if at > due_at)
        moments = [at for at, _ in sent()]
        assert max(b - a for a, b in itertools.pairwise(moments)) < 0.5  # it was seconds


@pytest.mark.parametrize('by_service', [False, True])
def test_stop_command_does_not_wait_behind_a_flood(
        station: Station, start: Start, by_service: bool) -> None:
    """By a zero command, or by ~/enable, while no timeout is due."""
    process = start('odometry_node', cmd_vel_timeout=0.0)
    received = drive(station)
    enable = station.node.create_client(SetBool, 'odometry/enable')

    def ask() -> None:
        if by_service:
            enable.call_async(SetBool.Request(data=False))
        else:
            station.publish('cmd_vel', twist(0.0, 0.0))

    with flood(station, 'odometry/set_pose'):
        time.sleep(2.0)  # what it takes to have seconds of it wait
        asked_at = time.time()
        # Again and again: of what DDS loses in a flood, it notices with the next message.
        wait_until(lambda: is_zero(received[-1][1]) or ask(), pause=0.1)
    first = next(stamp_ns(message) * 1e-9 for _, message in received if is_zero(message))
    assert first - asked_at < 1.0  # it was 4 to more than 15
    # Its turn comes all the same, and finds nothing.
    if by_service:
        station.call(SetBool, 'odometry/enable', SetBool.Request(data=True))
    station.publish_until(
        lambda: not is_zero(received[-1][1]), 'cmd_vel', itertools.repeat(twist(0.2, 0.7)))
    process.signal(signal.SIGINT)
    assert process.wait() == 0
    assert 'Traceback' not in process.output


@contextmanager
def flood(station: Station, topic: str) -> Iterator[None]:
    """Start a process that publishes to the node at the highest rate."""
    process = subprocess.Popen([sys.executable, '-c', FLOOD, topic], stdout=subprocess.DEVNULL)
    try:
        wait_until(lambda: (
            station.node.count_publishers(topic) or station.node.count_clients(topic)))
        yield
    finally:
        process.kill()
        process.wait()


FLOOD = """
import itertools
import struct
import sys

from geometry_msgs.msg import PoseWithCovarianceStamped
from rcl_interfaces.srv import GetParameters
import rclpy
from rclpy.serialization import serialize_message
from sensor_msgs.msg import JointState

rclpy.init()
node = rclpy.create_node('flood')
if sys.argv[1] == 'odometry/get_parameters':
    client = node.create_client(GetParameters, sys.argv[1])
    request = GetParameters.Request(names=['wheel_radius'] * 100)
    while True:
        client.call_async(request)
if sys.argv[1] == 'joint_states':
    message = JointState(name=['left_wheel_joint', 'right_wheel_joint'], position=[0.0, 0.0])
else:
    message = PoseWithCovarianceStamped()
    message.header.frame_id, message.pose.pose.orientation.w = 'odom', 1.0
publisher = node.create_publisher(type(message), sys.argv[1], 50)
payload = bytearray(serialize_message(message))
for k in itertools.count():
    struct.pack_into('<iI', payload, 4, k // 10**9, k % 10**9)  # the stamp: each is newer
    publisher.publish(bytes(payload))
"""


def test_commands_from_a_pause_of_the_process_are_not_driven(
        station: Station, start: Start) -> None:
    """The driver released the stick long before the process continues."""
    process = start('odometry_node')
    received = drive(station)
    process.signal(signal.SIGSTOP)
    for _ in range(20):
        station.publish('cmd_vel', twist(0.2, 0.7))
        time.sleep(0.02)
    time.sleep(0.6)
    freed_at = time.monotonic()
    process.signal(signal.SIGCONT)
    wait_until(lambda: received[-1][0] > freed_at + 0.6)
    after = [message for at, message in received if at > freed_at]
    assert len(after) > 10
    assert sum(not is_zero(message) for message in after) <= 1  # sent before it was noticed
    station.publish_until(
        lambda: not is_zero(received[-1][1]), 'cmd_vel', itertools.repeat(twist(0.2, 0.7)))


BROKEN = """
import sys
from diffdrive_ros.node import odometry_node, runner
from diffdrive_ros.node.odom_publisher import OdomPublisher


def broken(self, payload):
    raise RuntimeError('broken on purpose')


OdomPublisher.on_joint_states = broken
sys.exit(runner.run(
    'odometry', '', odometry_node.OdometryNode, odometry_node.OdometryNode.stop_wheels))
"""


def test_exception_stops_the_wheels_before_the_node_ends(
        station: Station, start: Start) -> None:
    """A defect is no reason to drive on."""
    broken = subprocess.Popen(
        [sys.executable, '-c', BROKEN], stdout=subprocess.PIPE, stderr=subprocess.STDOUT,
        text=True)
    try:
        received = drive(station)
        publisher = station.node.create_publisher(JointState, 'joint_states', 1)
        wait_until(lambda: broken.poll() is not None or publisher.publish(JointState()), pause=0.1)
        assert broken.returncode == 1
        wait_until(lambda: is_zero(received[-1][1]))
    finally:
        broken.kill()
    assert 'RuntimeError: broken on purpose' in broken.communicate()[0]


THEIRS_4 = """
diff_drive_controller:
  ros__parameters:
    left_wheel_names: ["left_wheel_joint"]
    right_wheel_names: ["right_wheel_joint"]
    wheels_per_side: 1
    wheel_separation: 0.10
    wheel_radius: 0.015
    wheel_separation_multiplier: 1.0
    left_wheel_radius_multiplier: 1.0
    right_wheel_radius_multiplier: 1.0
    publish_rate: 50.0
    odom_frame_id: odom
    base_frame_id: base_link
    pose_covariance_diagonal : [0.001, 0.001, 0.001, 0.001, 0.001, 0.01]
    twist_covariance_diagonal: [0.001, 0.001, 0.001, 0.001, 0.001, 0.01]
    open_loop: true
    enable_odom_tf: true
    cmd_vel_timeout: 0.5
    publish_limited_velocity: true
    use_stamped_vel: false
    linear.x.has_velocity_limits: true
    linear.x.has_acceleration_limits: true
    linear.x.has_jerk_limits: false
    linear.x.max_velocity: 0.2
    linear.x.min_velocity: -0.1
    linear.x.max_acceleration: 1.0
    linear.x.min_acceleration: -0.1
    linear.x.max_jerk: 0.0
    linear.x.min_jerk: 0.0
    angular.z.has_velocity_limits: true
    angular.z.has_acceleration_limits: true
    angular.z.has_jerk_limits: false
    angular.z.max_velocity: 1.0
    angular.z.min_velocity: -1.0
    angular.z.max_acceleration: 1.0
    angular.z.min_acceleration: -1.0
    angular.z.max_jerk: 0.0
    angular.z.min_jerk: 0.0
"""

THEIRS_6 = """
controller_manager:
  ros__parameters:
    update_rate: 10
    diff_drive_controller:
      type: diff_drive_controller/DiffDriveController
diff_drive_controller:
  ros__parameters:
    type: diff_drive_controller/DiffDriveController
    left_wheel_names: ["left_wheel_joint"]
    right_wheel_names: ["right_wheel_joint"]
    wheel_separation: 0.10
    wheel_radius: 0.015
    tf_frame_prefix_enable: false
    open_loop: true
    publish_limited_velocity: true
    velocity_rolling_window_size: 10
    linear:
      x:
        max_velocity: 0.2
        min_velocity: -0.1
        max_acceleration: 1.0
        max_acceleration_reverse: -1.0
        max_jerk: .NAN
        min_jerk: .NAN
    angular:
      z:
        max_velocity: 1.0
        min_velocity: -1.0
        max_acceleration: 1.0
        max_jerk: .NAN
    wheel_seperation: 0.3
"""


@pytest.mark.parametrize('theirs', [THEIRS_4, THEIRS_6])
@pytest.mark.parametrize(('asked', 'fastest'), [(0.9, 0.2), (-0.9, -0.1)])
def test_file_of_diff_drive_controller_drives_as_there(
        station: Station, start: Start, tmp_path: Path, theirs: str, asked: float,
        fastest: float) -> None:
    """Up to the maximum velocity at 1 m/s^2, and no faster."""
    file = tmp_path / 'theirs.yaml'
    file.write_text(theirs)
    process = start('odometry_node', '-r', '__node:=diff_drive_controller',
                    '--params-file', str(file))
    received = station.subscribe(JointState, 'wheel_commands')
    wait_until(lambda: station.node.count_publishers('wheel_commands'))
    station.publish_until(
        lambda: received and received[-1][1].velocity[0] * 0.015 == pytest.approx(fastest),
        'cmd_vel', itertools.repeat(twist(asked, 0.0)))
    ramp = [message for _, message in received
            if message.velocity[0] * 0.015 != pytest.approx(fastest)]
    speeds = [message.velocity[0] * 0.015 for message in ramp]
    assert is_ramp(ramp, speeds, math.copysign(1.0, fastest))
    process.signal(signal.SIGINT)
    assert process.wait() == 0
    if theirs is THEIRS_4:
        assert 'WARN' not in process.output
        assert 'wheels_per_side: not used any more' in process.output
        assert 'linear.x.min_acceleration: not used any more' in process.output
    else:
        [warning] = [line for line in process.output.splitlines() if 'WARN' in line]
        assert 'wheel_seperation: no parameter' in warning
        assert 'the nearest is wheel_separation' in warning
