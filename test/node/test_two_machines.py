"""Test node and robot on one host, the operator station on another, and faults of the link."""
from collections.abc import Iterator
import itertools
import math
import time

from diffdrive_ros.core.kinematics import DiffDrive
from diffdrive_ros.core.odometry import integrate
from nav_msgs.msg import Odometry
import numpy as np
import pytest
from support.hosts import Hosts, HostsError, Program
from support.station import GEOMETRY, LEFT_RADIUS, RIGHT_RADIUS, SEPARATION, stamp_ns, wait_until

DRIVE = DiffDrive(SEPARATION, LEFT_RADIUS, RIGHT_RADIUS)
TIMEOUT, PERIOD = 0.5, 0.02  # of the commands, and of the wheels', by default
TOLERANCE = 0.1  # [s] of any time below, on a loaded machine


@pytest.fixture(scope='module')
def hosts() -> Iterator[Hosts]:
    """Return the hosts robot and station."""
    try:
        hosts = Hosts()
    except HostsError as error:
        pytest.skip(f'network namespaces are not available: {error}')
    yield hosts
    hosts.close()


@pytest.fixture(scope='module')
def robot(hosts: Hosts) -> Program:
    """Start the robot and its node; return a recorder of their topics, on their host."""
    recorder = hosts.record('robot', 'cmd_vel', 'diagnostics', 'ground_truth', 'joint_states',
                            'odom', 'wheel_commands')
    given = [word for name, value in GEOMETRY.items() for word in ('-p', f'{name}:={value}')]
    hosts.start('robot', '-m', 'diffdrive_ros.node.simulator_node', '--ros-args', *given,
                '-p', 'ticks_per_revolution:=0')
    wait_until(lambda: recorder.received['joint_states'] and recorder.received['ground_truth'])
    hosts.start('robot', '-m', 'diffdrive_ros.node.odometry_node', '--ros-args', *given)
    wait_until(lambda: recorder.received['odom'])
    return recorder


@pytest.fixture(scope='module')
def station(hosts: Hosts) -> Program:
    """Start the operator station, which publishes cmd_vel at 20 Hz and records odom."""
    return hosts.record('station', 'odom')


@pytest.fixture
def link(hosts: Hosts, robot: Program, station: Program) -> Iterator[Hosts]:
    """Return the hosts while the station drives; at the end, check all odometry."""
    station.send('0.3 0.7')
    wait_until(lambda: (
        is_driving(robot) and robot.received['cmd_vel'] and station.received['odom']))
    yield hosts
    hosts.set_up(is_up=True)
    hosts.set_impairment()
    station.send('0.0 0.0')
    wait_until(lambda: speeds(robot.received['wheel_commands'][-1]) == [0.0, 0.0])
    station.send('')
    wait_until(lambda: np.abs(speeds(robot.received['joint_states'][-1])).max() < 1e-6)
    check_odometry(robot, station)


def speeds(received: tuple) -> list[float]:
    """Return the wheel speeds of a received message [rad/s]."""
    return list(received[1].velocity)


def is_driving(robot: Program) -> bool:
    """Return whether the last wheel command is not zero."""
    return robot.received['wheel_commands'] and any(speeds(robot.received['wheel_commands'][-1]))


def timeouts(robot: Program) -> int:
    """Return the number of timeouts, by the next diagnostics."""
    received = robot.received['diagnostics']
    count = len(received)
    wait_until(lambda: len(received) > count)
    [status] = [each for each in received[-1][1].status if each.name.endswith('commands')]
    return int({pair.key: pair.value for pair in status.values}.get('timeouts', 0))


def timeouts_while_steady(robot: Program) -> int:
    """Return the same, as soon as commands arrive without gaps: a busy machine has some."""
    counts = []

    def is_steady() -> bool:
        since = time.monotonic()
        counts.append(timeouts(robot))
        arrived = [since, *(at for at, _ in list(robot.received['cmd_vel']) if at > since)]
        return np.diff([*arrived, time.monotonic()]).max() < TIMEOUT / 2.0

    wait_until(is_steady)
    return counts[-1]


def check_stop(robot: Program, cut_at: float, delay: float = 0.0) -> float:
    """Check that the wheels stop in time after a cut; return the time of the stop."""
    received = robot.received['wheel_commands']
    wait_until(lambda: received[-1][0] > cut_at and not is_driving(robot))
    stopped_at = next(each[0] for each in received if each[0] > cut_at and not any(speeds(each)))
    assert stopped_at - cut_at < delay + TIMEOUT + PERIOD + TOLERANCE
    wait_until(lambda: np.abs(speeds(robot.received['joint_states'][-1])).max() < 0.01)
    print(f'zero {stopped_at - cut_at:.3f} s after the cut', end=', ')
    return stopped_at


def check_age(robot: Program, stopped_at: float, delay: float = 0.0) -> None:
    """Check the age of the last command at the stop, from its sending."""
    age = stopped_at - robot.received['cmd_vel'][-1][0] + delay
    assert TIMEOUT - TOLERANCE < age < TIMEOUT + PERIOD + TOLERANCE
    print(f'{age:.3f} s after the last command', end=', ')


def check_return(robot: Program, station: Program, back_at: float) -> None:
    """Wait until the wheels turn and the station receives odom again."""
    wait_until(lambda: is_driving(robot) and station.received['odom'][-1][0] > back_at)
    drives_at = next(each[0] for each in robot.received['wheel_commands']
                     if each[0] > back_at and any(speeds(each)))
    received_at = next(at for at, _ in station.received['odom'] if at > back_at)
    print(f'{drives_at - back_at:.3f} s after the link is back the wheels turn, '
          f'and the station receives odom after {received_at - back_at:.3f} s')


def poses(received: list[tuple[float, Odometry]]) -> dict[int, np.ndarray]:
    """Return [x, y, theta] by stamp."""
    return {stamp_ns(message): np.array([
        message.pose.pose.position.x, message.pose.pose.position.y,
        2.0 * math.atan2(message.pose.pose.orientation.z, message.pose.pose.orientation.w)])
        for _, message in list(received)}


def distance(one: np.ndarray, other: np.ndarray) -> float:
    """Return the largest difference of poses, with wrapped angles."""
    difference = one - other
    difference[..., 2] = np.remainder(difference[..., 2] + math.pi, 2.0 * math.pi) - math.pi
    return np.abs(difference).max()


def check_odometry(robot: Program, station: Program) -> None:
    """Check each odom since the start against the joint_states of its stamp, and the truth."""
    now_ns = stamp_ns(robot.received['joint_states'][-1][1])
    wait_until(lambda: all(stamp_ns(received[-1][1]) > now_ns for received in (
        robot.received['odom'], robot.received['ground_truth'], station.received['odom'])))
    found, truth = poses(robot.received['odom']), poses(robot.received['ground_truth'])
    first_ns = min(found)
    joints = {stamp_ns(message): list(message.position)
              for _, message in robot.received['joint_states']
              if first_ns <= stamp_ns(message) <= now_ns}
    left, right = np.array(list(joints.values())).T
    expected = dict(zip(joints, integrate(DRIVE, left, right), strict=True))
    error = max(distance(found[ns], expected[ns]) for ns in joints)
    assert error < 1e-6
    from_truth = max(distance(found[ns], truth[ns]) for ns in joints)
    assert from_truth < 1e-3
    received = poses(station.received['odom'])
    assert max(distance(received[ns], found[ns]) for ns in received if ns in found) == 0.0
    x, y, theta = expected[max(expected)]
    print(f'{len(joints)} poses to {x:.3f} m, {y:.3f} m, {theta:.3f} rad: '
          f'{error:.1e} from the integral, {from_truth:.1e} from the truth')


@pytest.mark.parametrize('cut', ['all frames are lost', 'the interfaces are down'])
def test_cut_link_stops_the_wheels_until_it_is_back(
        link: Hosts, robot: Program, station: Program, cut: str) -> None:
    """The station keeps publishing; nothing is restarted."""
    before = timeouts_while_steady(robot)
    is_down = cut == 'the interfaces are down'
    cut_at = link.set_up(is_up=False) if is_down else link.set_impairment(loss=1.0)
    check_age(robot, check_stop(robot, cut_at))
    assert timeouts(robot) == before + 1
    assert not is_driving(robot)
    assert station.received['odom'][-1][0] < cut_at + TOLERANCE
    check_return(robot, station, link.set_up(is_up=True) if is_down else link.set_impairment())


@pytest.mark.parametrize('cut', ['all frames are lost', 'the interfaces are down'])
def test_late_commands_of_a_cut_link_are_not_driven(
        link: Hosts, robot: Program, station: Program, cut: str) -> None:
    """The operator has released the stick without a zero; resent commands are dropped."""
    is_down = cut == 'the interfaces are down'
    check_stop(robot, link.set_up(is_up=False) if is_down else link.set_impairment(loss=1.0))
    station.send('')
    released_at = time.monotonic()
    wait_until(lambda: time.monotonic() > released_at + TIMEOUT + 0.1)
    back_at = link.set_up(is_up=True) if is_down else link.set_impairment()
    wait_until(lambda: (station.received['odom'][-1][0] > back_at
                        and robot.received['wheel_commands'][-1][0] > back_at + 1.5))
    arrived = [at - back_at for at, _ in robot.received['cmd_vel'] if at > back_at]
    print(f'{len(arrived)} commands from before were resent, {arrived[:1]} s after')
    assert not any(
        any(speeds(each)) for each in robot.received['wheel_commands'] if each[0] > back_at)
    station.send('0.3 0.7')
    wait_until(lambda: is_driving(robot))


def test_link_with_20_percent_loss_drives_on(
        link: Hosts, robot: Program, station: Program) -> None:
    """A command arrives before the timeout of the last, and a new one reaches the wheels."""
    before = timeouts(robot)
    lossy_at = link.set_impairment(loss=0.2)
    wait_until(lambda: time.monotonic() > lossy_at + 10.0, pause=0.05)  # long enough for a mean
    for command, speed in (('0.2 -0.4', (0.2, -0.4)), ('0.3 0.7', (0.3, 0.7))):
        expected = pytest.approx(DRIVE.wheel_speeds(*speed))
        station.send(command)
        wait_until(lambda expected=expected: (
            speeds(robot.received['wheel_commands'][-1]) == expected), timeout=2.0)
    sent = [any(speeds(each)) for each in robot.received['wheel_commands'] if each[0] > lossy_at]
    assert sum(sent) > 0.8 * len(sent)
    arrived = [at for at, _ in robot.received['cmd_vel'] if at > lossy_at]
    longest = max(b - a for a, b in itertools.pairwise(arrived))
    received = [at for at, _ in station.received['odom'] if at > lossy_at]
    print(f'{len(arrived)} commands, at most {longest:.3f} s apart, {timeouts(robot) - before} '
          f'timeouts, wheels at zero {len(sent) - sum(sent)} times of {len(sent)}; odom at most '
          f'{max(b - a for a, b in itertools.pairwise(received)):.3f} s apart at the station')
    check_stop(robot, link.set_impairment(loss=1.0))


def test_link_with_100_ms_latency_drives_and_stops(
        link: Hosts, robot: Program, station: Program) -> None:
    """The age of a command is from its sending; latency alone is no timeout."""
    before = timeouts_while_steady(robot)
    late_at = link.set_impairment(delay=0.1)
    wait_until(lambda: time.monotonic() > late_at + 1.5, pause=0.05)
    to_system_time = time.time() - time.monotonic()
    ages = [at + to_system_time - stamp_ns(message) * 1e-9
            for at, message in station.received['odom'] if at > late_at + 0.2]
    assert 0.1 < min(ages) < 0.1 + TOLERANCE
    assert is_driving(robot)
    assert timeouts_while_steady(robot) == before
    cut_at = link.set_impairment(loss=1.0, delay=0.1)
    check_age(robot, check_stop(robot, cut_at, delay=0.1), delay=0.1)
    assert robot.received['cmd_vel'][-1][0] > cut_at
    print(f'odom was {min(ages):.3f} to {max(ages):.3f} s old')
    check_return(robot, station, link.set_impairment(delay=0.1))
