"""The software stop, and what else inhibits the wheels of the observed node; over DDS."""
import asyncio
from collections.abc import Callable
from types import SimpleNamespace

from diagnostic_msgs.msg import DiagnosticStatus, KeyValue
from diffdrive_ros.core.wheel_commander import Inhibit, REASONS
from diffdrive_ros.dashboard.robot import DashboardRobot
from diffdrive_ros.node import steady_clock
from diffdrive_ros.node.odometry_node import OdometryNode
import pytest
from support.observed_robot import drive, read_parameters
from support.station import wait_until


def test_node_started_after_the_stop_is_disabled_too(
        make: Callable[..., OdometryNode], receive_odom: Callable[[], DashboardRobot]) -> None:
    """Or others would drive it while the page shows STOPPED; a release enables it."""
    make()
    robot = receive_odom()

    def is_disabled_when_maintained() -> bool:
        asyncio.run(robot.software_stop.maintain())
        return robot.software_stop.is_confirmed

    wait_until(lambda: robot.commands.is_current, 5.0)
    assert not is_disabled_when_maintained()  # STOP was not pressed
    robot.teleop.stop()
    wait_until(is_disabled_when_maintained, 5.0)
    asyncio.run(robot.software_stop.release(robot.teleop.stop_count))
    wait_until(lambda: robot.commands.is_current, 5.0)
    assert not is_disabled_when_maintained()


def test_status_of_an_earlier_odometry_is_not_current(
        make: Callable[..., OdometryNode], receive_odom: Callable[[], DashboardRobot]) -> None:
    """The next one may not be disabled as the first one was."""
    make()
    robot = receive_odom()
    wait_until(lambda: robot.commands.is_current, 5.0)
    arrivals = robot.commands.arrivals
    make()

    def is_there() -> bool:
        robot.update()
        return robot.commands.arrivals > arrivals

    wait_until(is_there, pause=0.01)
    assert not robot.commands.is_current
    wait_until(lambda: robot.commands.is_current, 5.0)


def record_calls(robot: DashboardRobot, act: Callable[[], object]) -> list[str]:
    """Act at each call of a service; return the calls."""
    calls = []

    async def call(service: str, request: object) -> object:
        calls.append(f'{service} {request.data}')
        act()
        return SimpleNamespace(message='')

    robot.node.call = call
    return calls


def test_released_stop_enables_node_and_pages(observed: DashboardRobot) -> None:
    """Once."""
    observed.teleop.stop()
    calls = record_calls(observed, lambda: None)
    asyncio.run(observed.software_stop.release(1))
    assert (calls, observed.teleop.is_stopped) == (['enable True'], False)


def test_stop_during_a_release_lasts(observed: DashboardRobot) -> None:
    """The node is disabled again."""
    observed.teleop.stop()
    calls = record_calls(observed, observed.teleop.stop)
    asyncio.run(observed.software_stop.release(1))
    assert (calls, observed.teleop.is_stopped) == (['enable True', 'enable False'], True)


def test_release_of_a_stop_does_not_release_the_next_one(observed: DashboardRobot) -> None:
    """The node is not enabled even for a moment."""
    observed.teleop.stop()
    observed.teleop.stop()
    calls = record_calls(observed, lambda: None)
    asyncio.run(observed.software_stop.release(1))
    assert (calls, observed.teleop.is_stopped) == (['enable False'], True)


def test_only_the_observed_odometry_counts_as_disabled(observed: DashboardRobot) -> None:
    """Not that of another observed on the same network."""
    status = steady_clock.steady(), SimpleNamespace(
        values=[KeyValue(key='inhibits', value='disabled')])
    observed.node.diagnostics['/robot2/odometry: commands'] = status
    observed.node.diagnostics['/odometry2: commands'] = status
    assert not observed.software_stop.is_confirmed
    observed.node.diagnostics['/odometry: commands'] = status
    assert observed.software_stop.is_confirmed


def test_short_inhibit_stops_the_robot_too(
        make: Callable[..., OdometryNode], receive_odom: Callable[[], DashboardRobot]) -> None:
    """It began and ended between two updates."""
    make()
    robot = receive_odom()
    read_parameters(robot)
    drive(receive_odom())

    async def inhibit_for_a_moment() -> None:
        await robot.software_stop.enable(False)
        await robot.software_stop.enable(True)

    asyncio.run(inhibit_for_a_moment())
    wait_until(lambda: robot.update() or not robot.teleop.is_moving)
    assert REASONS[Inhibit.DISABLED] in robot.teleop.stop_reason('a')


@pytest.mark.parametrize(('statuses', 'stops'), [
    ([('', 7), ('', 7)], False),
    ([('', 7), ('', 8)], True),
    ([('', 7), (None, 7)], False),
    ([('', 7), ('feedback_timeout', 7), ('', 7)], True),
    ([('clock_stall,disabled', 7)], True),
    ([('of_a_later_version', 7)], True),
    ([('clock_stall', None)], True)])
def test_inhibits_and_ignored_commands_stop_the_robot(
        make: Callable[..., OdometryNode], receive_odom: Callable[[], DashboardRobot],
        statuses: list[tuple[str | None, int | None]], stops: bool) -> None:
    """By keys of the status; how many commands were ignored before does not count."""
    make()
    read_parameters(receive_odom())
    robot = receive_odom()
    drive(robot)
    robot.node.take_command_statuses = lambda: [DiagnosticStatus(values=[
        KeyValue(key=key, value=str(value))
        for key, value in (('inhibits', inhibits), ('inhibited', count)) if value is not None])
        for inhibits, count in statuses]
    robot.update()
    assert robot.teleop.is_moving is not stops
