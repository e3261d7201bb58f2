"""The dashboard as a process, its panels, and values that a person types; without a browser."""
from collections.abc import Callable, Iterator
import http.client
import math
import os
from pathlib import Path
import signal
import socket
from types import SimpleNamespace
from typing import Any

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


def test_port_in_use_exits_with_one_line(start_page: Callable[..., Dashboard]) -> None:
    """Before anything is started."""
    with socket.create_server(('127.0.0.1', 0)) as other:
        dashboard = start_page('--simulate', port=other.getsockname()[1])
        assert dashboard.wait() == 1
    assert dashboard.output.startswith('dashboard: cannot serve at 127.0.0.1 port')
    assert dashboard.output.count('\n') == 1


def test_unknown_argument_is_rejected(
        start_page: Callable[..., Dashboard]) -> None:
    """As by every executable."""
    assert start_page('--fly').wait() == 2


def test_odometry_of_another_namespace_exits_with_one_line(
        start_page: Callable[..., Dashboard]) -> None:
    """The one would be observed, and the robot of the other driven."""
    dashboard = start_page('--odometry', 'robot2/odometry')
    assert dashboard.wait() == 1
    assert dashboard.output == (
        'dashboard: /robot2/odometry is not in the namespace /, where the dashboard publishes '
        'cmd_vel; use --odometry odometry --ros-args -r __ns:=/robot2\n')


@pytest.mark.parametrize(('observed', 'namespace'), [
    ('/odometry', '/'), ('/robot2/odometry', '/robot2'), ('/a/b/odometry', '/a/b')])
def test_odometry_of_the_same_namespace_is_accepted(observed: str, namespace: str) -> None:
    """At any depth."""
    check_namespace(observed, namespace)


def test_simulation_is_not_started_on_topics_in_use(
        station: Station, start_page: Callable[..., Dashboard]) -> None:
    """A subscriber of cmd_vel may be a real robot."""
    station.hear(type(twist(0.0, 0.0)), 'cmd_vel')
    dashboard = start_page('--simulate')
    assert dashboard.wait() == 1
    assert 'topics in use: cmd_vel (station)' in dashboard.output


@pytest.mark.parametrize('victim', ['simulator_node', 'odometry_node'])
def test_dead_process_of_the_simulation_ends_it_with_1(
        start_page: Callable[..., Dashboard], victim: str) -> None:
    """And is named in its output."""
    dashboard = start_page('--simulate')
    dashboard.wait_until_it_serves()
    wait_until(lambda: victim in children(dashboard.pid))
    os.kill(children(dashboard.pid)[victim], signal.SIGKILL)
    assert dashboard.wait() == 1
    assert f'dashboard: {victim.removesuffix("_node")} ended with -9' in dashboard.output


def test_simulation_ends_with_a_killed_dashboard(
        start_page: Callable[..., Dashboard]) -> None:
    """No process is left to command wheels, or to prevent the next start."""
    dashboard = start_page('--simulate')
    dashboard.wait_until_it_serves()
    wait_until(lambda: len(children(dashboard.pid)) == 2)
    started = children(dashboard.pid).values()
    dashboard.signal(signal.SIGKILL)
    wait_until(lambda: not any(map(is_running, started)))


def test_no_response_can_be_embedded_by_another_page(
        start_page: Callable[..., Dashboard]) -> None:
    """Neither the page nor a refusal."""
    dashboard = start_page()
    dashboard.wait_until_it_serves()
    for host, status in (('127.0.0.1', 200), ('evil.example', 403)):
        connection = http.client.HTTPConnection('127.0.0.1', dashboard.port, timeout=10.0)
        connection.request('GET', '/', headers={'Host': host})
        response = connection.getresponse()
        assert response.status == status
        assert response.headers['x-frame-options'] == 'DENY'
        assert 'frame-ancestors' in response.headers['content-security-policy']
        connection.close()


def test_diagnostics_panel_lists_statuses_once_a_second(
        monkeypatch: pytest.MonkeyPatch) -> None:
    """Without a change, nothing is sent to the page; statuses that end are shown as silent."""
    from diffdrive_ros.dashboard.panels import DiagnosticsPanel
    from nicegui import Client, ui

    statuses, now = {}, 100.0
    monkeypatch.setattr(clock, 'steady', lambda: now)

    def receive(name: str, message: str) -> None:
        statuses[name] = now, DiagnosticStatus(name=name, message=message, level=b'\x01')

    def titles() -> list[str]:
        rows = panel._list.default_slot.children
        return [row.default_slot.children[0].text for row in rows]

    with Client(ui.page('/')) as client:
        panel = DiagnosticsPanel(SimpleNamespace(diagnostics=statuses))
        receive('b', 'well')
        panel.refresh()
        receive('b', 'ill')
        receive('a', 'well')
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
        now += 5.0
        receive('a', 'well')
        panel.refresh()
        assert titles() == ['WARN  a: well', 'SILENT  b: ill']
        client.delete()


def test_kinematics_panel_shows_dragged_then_live_wheels() -> None:
    """Writing one field is no input of a person while the other has its old value."""
    from diffdrive_ros.dashboard.panels import KinematicsPanel
    from nicegui import Client, ui

    drive = DiffDrive(0.3, 0.05, 0.051)
    robot = SimpleNamespace(
        odom=(0.1, 0.2, 0.3), wheels=(7.0, 8.0), is_silent=False,
        parameters=SimpleNamespace(drive=drive))
    texts, drawn, handlers = {}, [], {}
    robot_map = SimpleNamespace(
        on_data=handlers.setdefault, set_texts=texts.update,
        draw_measured=lambda: drawn.append(None),
        draw_dragged=lambda pose, wheels: drawn.append(wheels))
    permission = SimpleNamespace(on_current=lambda *_: None)
    with Client(ui.page('/')) as client:
        panel = KinematicsPanel(robot, robot_map, permission)
        assert "φ' = H V_b  = (7.00, 8.00)" in panel.equations()
        handlers['drag']({'wheels': [7.5, 8.5]})
        assert panel.wheels == (7.5, 8.5)
        assert drawn == []
        assert "φ' = H V_b  = (7.50, 8.50)" in texts['equations']
        assert drawn == []
        type_into(panel._left, 3.0)
        assert drawn.pop() == panel.wheels == (3.0, 8.5)
        panel._on_live()
        assert drawn == [None]
        assert "φ' = H V_b  = (7.00, 8.00)" in panel.equations()
        client.delete()


def type_into(field: Any, value: float) -> None:
    """Have a field receive the events of a browser where a person typed a value."""
    for listener in list(field._event_listeners.values()):
        if listener.type.startswith('update'):
            field._handle_event({'listener_id': listener.id, 'client_id': '', 'args': value})


def is_running(number: int) -> bool:
    """Return whether a process runs; a zombie does not."""
    try:
        return Path(f'/proc/{number}/stat').read_text().rsplit(')', 1)[1].split()[0] != 'Z'
    except OSError:
        return False


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
