"""The dashboard as a process; without a browser."""
from collections.abc import Callable, Iterator
import http.client
import os
from pathlib import Path
import signal
import socket

from diffdrive_ros.dashboard.main import check_namespace
import pytest
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
    station.subscribe(type(twist(0.0, 0.0)), 'cmd_vel')
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


def is_running(number: int) -> bool:
    """Return whether a process runs; a zombie does not."""
    try:
        return Path(f'/proc/{number}/stat').read_text().rsplit(')', 1)[1].split()[0] != 'Z'
    except OSError:
        return False
