"""The parameters of the observed node: read, set, and texts that a person types."""
import asyncio
from collections.abc import Callable
import math

from diffdrive_ros.dashboard.dashboard_node import ServiceError
from diffdrive_ros.dashboard.remote_parameters import MISMATCH_RETRY_S, parse
from diffdrive_ros.dashboard.robot import DashboardRobot
from diffdrive_ros.node import steady_clock
from diffdrive_ros.node.odometry_node import OdometryNode
from nav_msgs.msg import Odometry
import pytest
from rcl_interfaces.msg import ParameterType
from rclpy.node import Node
from support.observed_robot import read_parameters
from support.station import Station, wait_until


def test_node_that_is_no_odometry_is_named_and_read_rarely(
        station: Station, receive_odom: Callable[[], DashboardRobot],
        monkeypatch: pytest.MonkeyPatch) -> None:
    """After a while, after a change of its parameters, or with a new publisher of odom."""
    station.add(Node('odometry', context=station.context))
    robot = receive_odom()
    with pytest.raises(ServiceError, match='another node than odometry'):
        read_parameters(robot)
    assert not robot.parameters.are_outdated
    assert receive_odom().reason_not_to_drive == (
        "/odometry is another node than odometry: it has no parameter 'cmd_vel_timeout'")
    robot.node.parameters_changed_at = steady_clock.steady()
    assert robot.parameters.are_outdated
    robot.node.parameters_changed_at = 0.0
    later = steady_clock.steady() + MISMATCH_RETRY_S
    with monkeypatch.context() as patch:
        patch.setattr(steady_clock, 'steady', lambda: later)
        assert robot.parameters.are_outdated
    station.node.create_publisher(Odometry, 'odom', 1)
    wait_until(lambda: 'not read yet' in receive_odom().reason_not_to_drive)
    assert robot.parameters.are_outdated


def test_parameters_of_an_earlier_odometry_are_discarded(
        station: Station, make: Callable[..., OdometryNode],
        receive_odom: Callable[[], DashboardRobot]) -> None:
    """The response came from a process that ended."""
    make()
    robot = receive_odom()
    call = robot.node.call

    async def call_slowly(service: str, request: object) -> object:
        response = await call(service, request)
        if service == 'get_parameters':
            station.node.create_publisher(Odometry, 'odom', 1)
            wait_until(lambda: receive_odom() and robot.parameters.invalidations > before)
        return response

    before, robot.node.call = robot.parameters.invalidations, call_slowly
    read_parameters(robot)
    assert 'not read yet' in robot.reason_not_to_drive


def test_parameter_is_set_though_it_cannot_be_read_again(
        make: Callable[..., OdometryNode], receive_odom: Callable[[], DashboardRobot]) -> None:
    """But the robot is not driven before the parameters are read."""
    make()
    robot = receive_odom()
    read_parameters(robot)
    call = robot.node.call

    async def call_in_vain(service: str, request: object) -> object:
        if service == 'list_parameters':
            raise ServiceError('list_parameters does not respond')
        return await call(service, request)

    robot.node.call = call_in_vain
    assert asyncio.run(robot.parameters.change('cmd_vel_timeout', '0.4')) == ''
    assert 'not read yet' in receive_odom().reason_not_to_drive


@pytest.mark.parametrize(('text', 'value'), [
    ('1', 1.0), (' -2.5e-3 ', -2.5e-3), ('.inf', math.inf), ('-inf', -math.inf)])
def test_number_is_parsed(text: str, value: float) -> None:
    """An integer for a double too."""
    assert parse(ParameterType.PARAMETER_DOUBLE, text) == value


@pytest.mark.parametrize('text', ['.nan', 'nan', 'NaN'])
def test_nan_is_parsed(text: str) -> None:
    """It means not set."""
    assert math.isnan(parse(ParameterType.PARAMETER_DOUBLE, text))


def test_other_types_are_parsed() -> None:
    """Booleans, integers, strings."""
    assert parse(ParameterType.PARAMETER_BOOL, 'True') is True
    assert parse(ParameterType.PARAMETER_BOOL, 'false') is False
    assert parse(ParameterType.PARAMETER_INTEGER, '-7') == -7
    assert parse(ParameterType.PARAMETER_STRING, 'odom') == 'odom'


@pytest.mark.parametrize(('kind', 'text', 'rule'), [
    (ParameterType.PARAMETER_DOUBLE, 'fast', 'must be a number'),
    (ParameterType.PARAMETER_DOUBLE, '', 'must be a number'),
    (ParameterType.PARAMETER_INTEGER, '1.5', 'must be an integer'),
    (ParameterType.PARAMETER_INTEGER, str(2**63), 'must fit into 64 bits'),
    (ParameterType.PARAMETER_BOOL, 'yes', 'must be true or false'),
    (ParameterType.PARAMETER_DOUBLE_ARRAY, '[1.0]', 'lists cannot be set here')])
def test_invalid_text_is_rejected_with_the_rule(kind: int, text: str, rule: str) -> None:
    """Before a service is called."""
    with pytest.raises(ValueError, match=rule):
        parse(kind, text)
