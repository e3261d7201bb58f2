"""The node simulator: a driver's topics, with the truth beside them."""
from collections.abc import Callable
import itertools
import math
import signal

from diffdrive_ros.core.kinematics import DiffDrive
from diffdrive_ros.core.odometry import integrate
from diffdrive_ros.node.simulator_node import SimulatorNode
from nav_msgs.msg import Odometry
import pytest
from rclpy.parameter import Parameter
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64, Float64MultiArray
from support.station import (
    GEOMETRY,
    LEFT_RADIUS,
    Process,
    RIGHT_RADIUS,
    SEPARATION,
    stamp_ns,
    Station,
    wait_until,
)

Make = Callable[..., SimulatorNode]

NAMES = {'left_wheel_names': ['fl', 'rl'], 'right_wheel_names': ['fr', 'rr']}


@pytest.fixture
def make(station: Station) -> Make:
    """Return a function that runs the simulator with some parameters."""
    def make_node(**parameters: object) -> SimulatorNode:
        overrides = [Parameter(name, value=value) for name, value in (
            GEOMETRY | NAMES | {'publish_rate': 200.0} | parameters).items()]
        return station.add(SimulatorNode(context=station.context, parameter_overrides=overrides))
    return make_node


def velocities(message: JointState) -> dict[str, float]:
    """Return the speed of each joint [rad/s]."""
    return dict(zip(message.name, message.velocity, strict=True))


def is_turning(received: list, left: float, right: float) -> bool:
    """Return whether the last message has both sides at these speeds [rad/s]."""
    if not received:
        return False
    expected = {'fl': left, 'rl': left, 'fr': right, 'rr': right}
    return velocities(received[-1][1]) == pytest.approx(expected, abs=0.5)


@pytest.mark.parametrize(('form', 'messages'), [
    ('joint_state', {'wheel_commands': JointState(
        name=['rr', 'fl', 'fr', 'rl'], velocity=[5.0, -3.0, 5.0, -3.0])}),
    ('multi_array', {'wheel_commands': Float64MultiArray(data=[-3.0, -3.0, 5.0, 5.0])}),
    ('per_wheel', {f'{name}/command': Float64(data=speed) for name, speed in (
        ('fl', -3.0), ('rl', -3.0), ('fr', 5.0), ('rr', 5.0))}),
])
def test_simulated_wheels_follow_each_command_type(
        station: Station, make: Make, form: str, messages: dict) -> None:
    """They stop on timeout."""
    make(wheel_command_type=form, command_timeout=0.2)
    received = station.subscribe(JointState, 'joint_states')
    wait_until(lambda: is_turning(received, 0.0, 0.0))

    def publish_all() -> None:
        for topic, message in messages.items():
            station.publish(topic, message)

    wait_until(lambda: is_turning(received, -3.0, 5.0) or publish_all(), pause=0.05)
    wait_until(lambda: is_turning(received, 0.0, 0.0))


def test_nan_command_stops_the_simulated_wheel(station: Station, make: Make) -> None:
    """As in a motor driver."""
    make()
    received = station.subscribe(JointState, 'joint_states')
    names = ['fl', 'rl', 'fr', 'rr']
    for speed, turning in ((4.0, 4.0), (math.nan, 0.0)):
        command = JointState(name=names, velocity=[speed] * 4)
        station.publish_until(
            lambda turning=turning: is_turning(received, turning, turning),
            'wheel_commands', itertools.repeat(command))


def test_ground_truth_equals_odometry_of_ideal_wheels(
        station: Station, make: Make) -> None:
    """Without slip, noise and encoder steps, at the timestamps of joint_states."""
    make(ticks_per_revolution=0)
    joints = station.subscribe(JointState, 'joint_states')
    truth = station.subscribe(Odometry, 'ground_truth')
    command = JointState(name=['fl', 'rl', 'fr', 'rr'], velocity=[3.0, 3.0, 5.0, 5.0])
    station.publish_until(
        lambda: truth and truth[-1][1].pose.pose.position.x > 0.1,
        'wheel_commands', itertools.repeat(command))
    angles = {stamp_ns(message): message.position for _, message in joints}
    poses = {stamp_ns(message): message for _, message in truth}
    shared = sorted(angles.keys() & poses.keys())
    assert len(shared) > 20
    left, right = ([angles[stamp][side] for stamp in shared] for side in (0, 2))
    first = poses[shared[0]].pose.pose
    start = (first.position.x, first.position.y,
             2.0 * math.atan2(first.orientation.z, first.orientation.w))
    expected = integrate(DiffDrive(SEPARATION, LEFT_RADIUS, RIGHT_RADIUS), left, right, start)[-1]
    last = poses[shared[-1]]
    assert (last.header.frame_id, last.child_frame_id) == ('odom', 'base_link')
    assert last.pose.pose.position.x == pytest.approx(expected[0], abs=1e-5)
    assert last.pose.pose.position.y == pytest.approx(expected[1], abs=1e-5)
    heading = 2.0 * math.atan2(last.pose.pose.orientation.z, last.pose.pose.orientation.w)
    assert heading == pytest.approx(expected[2], abs=1e-5)


def test_swap_wheels_swaps_motors_and_encoders(
        station: Station, make: Make) -> None:
    """The true pose turns the other way, and joint_states does not show it."""
    make(swap_wheels=True)
    received = station.subscribe(JointState, 'joint_states')
    truth = station.subscribe(Odometry, 'ground_truth')
    command = JointState(name=['fl', 'rl', 'fr', 'rr'], velocity=[1.0, 1.0, 6.0, 6.0])
    station.publish_until(
        lambda: is_turning(received, 1.0, 6.0), 'wheel_commands', itertools.repeat(command))
    wait_until(lambda: truth[-1][1].twist.twist.angular.z < -0.1)


@pytest.mark.parametrize(('parameters', 'line'), [
    ({'slip': 1.0}, 'slip = 1.0: must be zero or more and below 1'),
    ({'wheel_radius': 0.0}, 'wheel_radius = 0.0: must be positive and finite'),
    ({'wheel_radius': 0.1}, 'wheel_separation = (not set): must be positive and finite; '
     'wheel_radius came without it'),
    ({'ticks_per_revolution': 0.5}, 'ticks_per_revolution = 0.5: must be an integer'),
])
def test_simulator_rejects_wrong_parameters(
        start: Callable[..., Process], parameters: dict, line: str) -> None:
    """As odometry does."""
    process = start('simulator_node', **parameters)
    assert process.wait() == 1
    assert process.output.strip() == f'simulator: /simulator cannot start: {line}'


def test_unknown_parameter_warns_with_the_nearest(
        station: Station, start: Callable[..., Process]) -> None:
    """A typo would simulate another robot."""
    process = start('simulator_node', slipp=0.1)
    wait_until(lambda: station.node.count_publishers('joint_states'))
    process.signal(signal.SIGINT)
    assert process.wait() == 0
    assert 'slipp: no parameter of this node, not used; the nearest is slip' in (
        process.output)
