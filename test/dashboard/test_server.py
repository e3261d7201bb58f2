"""The dashboard as a process, and what it makes of what a person writes; without a browser."""
from collections.abc import Callable, Iterator
import math
import os
from pathlib import Path
import signal
import socket
from types import SimpleNamespace

from diagnostic_msgs.msg import DiagnosticStatus
from diffdrive_ros.core.kinematics import DiffDrive
from diffdrive_ros.dashboard.main import check_namespace
from diffdrive_ros.dashboard.remote_parameters import parse
from diffdrive_ros.node import clock
import pytest
from rcl_interfaces.msg import ParameterType
from support.browser import Dashboard
from support.station import children, Station, twist, wait_until

if not os.environ.get('CI'):
    pytest.importorskip('nicegui', reason='nicegui is not installed')


@pytest.fixture
def start_page(domain: int) -> Iterator[Callable[..., Dashboard]]:
    """Return a function that starts a dashboard."""
    started = []

    def start_dashboard(*arguments: str, port: int | None = None) -> Dashboard:
        started.append(Dashboard(*arguments, port=port))
        return started[-1]

    yield start_dashboard
    for dashboard in started:
        dashboard.close()


def test_a_port_that_is_used_is_said_in_one_line(start_page: Callable[..., Dashboard]) -> None:
    """Before anything is started."""
    with socket.create_server(('127.0.0.1', 0)) as other:
        dashboard = start_page('--simulate', port=other.getsockname()[1])
        assert dashboard.wait() == 1
    assert dashboard.output.startswith('dashboard: cannot serve at 127.0.0.1 port')
    assert dashboard.output.count('\n') == 1


def test_an_argument_that_is_none_of_its_own_is_refused(
        start_page: Callable[..., Dashboard]) -> None:
    """As of every executable here."""
    assert start_page('--fly').wait() == 2


def test_an_odometry_of_another_namespace_is_refused_in_one_line(
        start_page: Callable[..., Dashboard]) -> None:
    """The one would be watched, and the robot of the other driven."""
    dashboard = start_page('--odometry', 'robot2/odometry')
    assert dashboard.wait() == 1
    assert dashboard.output == (
        'dashboard: /robot2/odometry is not in the namespace /, whose cmd_vel would be driven; '
        'use --odometry odometry --ros-args -r __ns:=/robot2\n')


@pytest.mark.parametrize(('watched', 'namespace'), [
    ('/odometry', '/'), ('/robot2/odometry', '/robot2'), ('/a/b/odometry', '/a/b')])
def test_an_odometry_of_the_same_namespace_is_watched(watched: str, namespace: str) -> None:
    """However it was named."""
    check_namespace(watched, namespace)


def test_it_brings_no_second_robot_to_topics_that_are_used(
        station: Station, start_page: Callable[..., Dashboard]) -> None:
    """Somebody listens to cmd_vel already: it may be a real one."""
    station.hear(type(twist(0.0, 0.0)), 'cmd_vel')
    dashboard = start_page('--simulate')
    assert dashboard.wait() == 1
    assert 'somebody is on cmd_vel (station)' in dashboard.output


@pytest.mark.parametrize('victim', ['simulator_node', 'odometry_node'])
def test_a_process_of_its_robot_that_dies_ends_it_with_1(
        start_page: Callable[..., Dashboard], victim: str) -> None:
    """And is named."""
    dashboard = start_page('--simulate')
    dashboard.wait_until_it_serves()
    wait_until(lambda: victim in children(dashboard.number))
    os.kill(children(dashboard.number)[victim], signal.SIGKILL)
    assert dashboard.wait() == 1
    assert f'dashboard: {victim.removesuffix("_node")} ended with -9' in dashboard.output


def test_its_robot_ends_with_it_also_if_it_is_killed(
        start_page: Callable[..., Dashboard]) -> None:
    """Nobody is left to command wheels, or to be in the way of the next one."""
    dashboard = start_page('--simulate')
    dashboard.wait_until_it_serves()
    wait_until(lambda: len(children(dashboard.number)) == 2)
    started = children(dashboard.number).values()
    dashboard.signal(signal.SIGKILL)
    wait_until(lambda: not any(map(is_running, started)))


def test_the_statuses_of_all_nodes_are_listed_by_name_and_renewed_once_a_second(
        monkeypatch: pytest.MonkeyPatch) -> None:
    """One that is told no more goes; where none has changed, nothing is sent to the page."""
    from diffdrive_ros.dashboard.panels import DiagnosticsPanel
    from nicegui import Client, ui

    statuses, now = {}, 100.0
    monkeypatch.setattr(clock, 'steady', lambda: now)

    def tell(name: str, message: str) -> None:
        statuses[name] = now, DiagnosticStatus(name=name, message=message, level=b'\x01')

    def titles() -> list[str]:
        rows = panel._list.default_slot.children
        return [row.default_slot.children[0].text for row in rows]

    with Client(ui.page('/')) as client:
        panel = DiagnosticsPanel(SimpleNamespace(node=SimpleNamespace(diagnostics=statuses)))
        tell('b', 'well')
        panel.refresh()
        tell('b', 'ill')
        tell('a', 'well')
        panel.refresh()
        assert titles() == ['WARN  b: well']
        now += 1.0
        panel.refresh()
        assert titles() == ['WARN  a: well', 'WARN  b: ill']
        sent = []
        monkeypatch.setattr(client.outbox, 'enqueue_update', sent.append)
        now += 1.0
        panel.refresh()
        assert sent == []
        del statuses['a']
        now += 5.0
        panel.refresh()
        assert titles() == ['SILENT  b: ill']
        client.delete()


def test_dragged_wheels_are_both_shown_and_live_shows_those_of_the_robot_again() -> None:
    """Neither field is taken for the word of a person while the other is still the old one."""
    from diffdrive_ros.dashboard.panels import KinematicsPanel
    from nicegui import Client, ui

    drive = DiffDrive(0.3, 0.05, 0.051)
    robot = SimpleNamespace(odom=(0.1, 0.2, 0.3), wheels=(7.0, 8.0), is_silent=False, drive=drive)
    told, drawn = {}, []
    page = SimpleNamespace(
        do_now=lambda *_: None, tell=told.update, forget_touch=lambda: drawn.append(None),
        draw_touch=lambda pose, wheels: drawn.append(wheels))
    with Client(ui.page('/')) as client:
        panel = KinematicsPanel(page, robot)
        assert "φ' = H V_b  = (7.00, 8.00)" in panel.equations()
        panel.touch(None, [7.5, 8.5])
        assert panel.wheels == (7.5, 8.5)
        assert drawn == []
        assert "φ' = H V_b  = (7.50, 8.50)" in told['equations']
        panel._left.set_value(3.0)  # by hand
        assert drawn.pop() == panel.wheels == (3.0, 8.5)
        panel._forget()
        assert drawn == [None]
        assert "φ' = H V_b  = (7.00, 8.00)" in panel.equations()
        client.delete()


def is_running(number: int) -> bool:
    """Return whether a process has not ended; one that nobody has waited for has."""
    try:
        return Path(f'/proc/{number}/stat').read_text().rsplit(')', 1)[1].split()[0] != 'Z'
    except OSError:
        return False


@pytest.mark.parametrize(('text', 'value'), [
    ('1', 1.0), (' -2.5e-3 ', -2.5e-3), ('.inf', math.inf), ('-inf', -math.inf)])
def test_a_number_is_taken_as_it_is_written(text: str, value: float) -> None:
    """A whole one for a double too."""
    assert parse(ParameterType.PARAMETER_DOUBLE, text).double_value == value


@pytest.mark.parametrize('text', ['.nan', 'nan', 'NaN'])
def test_not_a_number_is_a_value(text: str) -> None:
    """It is what none is."""
    assert math.isnan(parse(ParameterType.PARAMETER_DOUBLE, text).double_value)


def test_other_types_are_taken_as_they_are_written() -> None:
    """Truth, integers, texts."""
    assert parse(ParameterType.PARAMETER_BOOL, 'True').bool_value is True
    assert parse(ParameterType.PARAMETER_BOOL, 'false').bool_value is False
    assert parse(ParameterType.PARAMETER_INTEGER, '-7').integer_value == -7
    assert parse(ParameterType.PARAMETER_STRING, 'odom').string_value == 'odom'


@pytest.mark.parametrize(('kind', 'text', 'rule'), [
    (ParameterType.PARAMETER_DOUBLE, 'fast', 'must be a number'),
    (ParameterType.PARAMETER_DOUBLE, '', 'must be a number'),
    (ParameterType.PARAMETER_INTEGER, '1.5', 'must be an integer'),
    (ParameterType.PARAMETER_INTEGER, str(2**63), 'must fit into 64 bits'),
    (ParameterType.PARAMETER_BOOL, 'yes', 'must be true or false'),
    (ParameterType.PARAMETER_DOUBLE_ARRAY, '[1.0]', 'lists cannot be set here')])
def test_what_is_none_is_refused_with_the_rule(kind: int, text: str, rule: str) -> None:
    """Before the node is asked."""
    with pytest.raises(ValueError, match=rule):
        parse(kind, text)
