"""Browser, dashboard and robot; for tests without a browser, the robot as it is observed."""
from collections.abc import Callable, Iterator
import importlib.util
import os
from types import SimpleNamespace

from diffdrive_ros.dashboard.dashboard_node import DashboardNode
from diffdrive_ros.dashboard.robot import DashboardRobot
from nav_msgs.msg import Odometry
import pytest
from support.browser import CHROMIUM, Dashboard, missing, OBSERVER, Person, Robot
from support.station import Station, wait_until

if not os.environ.get('CI') and not importlib.util.find_spec('nicegui'):
    collect_ignore = ['test_access_control.py']  # starlette comes with nicegui


@pytest.fixture(scope='module')
def chromium() -> Iterator:
    """Return the browser."""
    assert not missing(), missing()
    from playwright.sync_api import sync_playwright

    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=CHROMIUM, args=['--no-sandbox'])
        yield browser
        browser.close()


@pytest.fixture(scope='module')
def shared(domain_of_module: int) -> Iterator[SimpleNamespace]:
    """Return a dashboard with its simulated robot, for the tests that leave them whole."""
    dashboard = Dashboard('--simulate')
    dashboard.wait_until_it_serves()
    station = Station(domain_of_module, OBSERVER)
    yield SimpleNamespace(dashboard=dashboard, robot=Robot(station))
    station.close()
    dashboard.close()


@pytest.fixture
def visit(chromium: object) -> Iterator[Callable[..., Person]]:
    """Return a function that opens a page and returns its user."""
    contexts = []

    def open_page(url: str, **options: object) -> Person:
        contexts.append(chromium.new_context(**options))
        page = contexts[-1].new_page()
        page.goto(url)
        page.wait_for_selector('canvas[data-drawn]')
        return Person(page)

    yield open_page
    for context in contexts:
        context.close()


@pytest.fixture
def robot(shared: SimpleNamespace) -> Robot:
    """Return the shared robot."""
    return shared.robot


@pytest.fixture
def person(shared: SimpleNamespace, visit: Callable[..., Person]) -> Person:
    """Return the user of the only page of the shared dashboard."""
    person = visit(shared.dashboard.url)
    person.wait_for('Nobody drives')
    return person


@pytest.fixture
def serve(domain: int) -> Iterator[Callable[..., Dashboard]]:
    """Return a function that starts a dashboard without a robot."""
    started = []

    def serve_page(*arguments: str, port: int | None = None) -> Dashboard:
        started.append(Dashboard(*arguments, port=port))
        started[-1].wait_until_it_serves()
        return started[-1]

    yield serve_page
    for dashboard in started:
        dashboard.close()


@pytest.fixture
def observer(domain: int) -> Iterator[Station]:
    """Return a station that subscribes as ros2 topic echo does."""
    station = Station(domain, OBSERVER)
    yield station
    station.close()


@pytest.fixture
def node(station: Station) -> DashboardNode:
    """Return the node of the dashboard."""
    return station.add(DashboardNode(context=station.context))


@pytest.fixture
def observed(node: DashboardNode) -> DashboardRobot:
    """Return the robot that the dashboard observes, without a browser."""
    return DashboardRobot(node)


@pytest.fixture
def receive_odom(station: Station, observed: DashboardRobot) -> Callable[[], DashboardRobot]:
    """Return a function that has the robot receive a message on odom, and update."""
    def receive() -> DashboardRobot:
        def is_received() -> bool:
            station.publish('odom', Odometry())
            observed.update()
            return observed.node.odom.age < 0.1

        wait_until(is_received, pause=0.01)
        observed.update()
        return observed

    return receive
