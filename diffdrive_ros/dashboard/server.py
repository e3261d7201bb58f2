"""The server of the pages, and the periodic tasks that update robot and pages."""
import asyncio
from collections.abc import Awaitable, Callable
import logging
import secrets
import time

from diffdrive_ros.dashboard.access_control import AccessControl, address, HEADERS, LOOPBACK
from diffdrive_ros.dashboard.dashboard_node import DashboardNode, ServiceError, SpinThread
from diffdrive_ros.dashboard.page import Page
from diffdrive_ros.dashboard.robot import DashboardRobot
from diffdrive_ros.dashboard.teleop import STOP
from diffdrive_ros.node import steady_clock
from diffdrive_ros.node.robot_processes import RobotEndedError, RobotProcesses
from nicegui import app, background_tasks, Client, ui

# Periods of the tasks.
HEARTBEAT_CHECK_S, FRAME_S, NUMBERS_S, PARAMETERS_S, GRAPH_S = 0.02, 0.05, 0.2, 0.2, 1.0
PAUSE_S = 0.003  # within a frame, so that a thread of odometry does not wait for all of it
RECONNECT_S = 3.0  # after which a page that lost its connection is removed


class Server:
    """Updates the robot and its pages until the server ends."""

    def __init__(self, node: DashboardNode, processes: RobotProcesses | None) -> None:
        self.failure: RobotEndedError | None = None
        self._robot = DashboardRobot(node)
        self._processes = processes
        self._pages: dict[str, Page] = {}

    def start(self) -> None:
        """Start the periodic tasks; in the loop of the server."""
        for period, act in (
                (HEARTBEAT_CHECK_S, self._check_heartbeats), (FRAME_S, self._show_frame),
                (NUMBERS_S, self._refresh_numbers), (PARAMETERS_S, self._read_parameters),
                (PARAMETERS_S, self._robot.software_stop.maintain), (GRAPH_S, self._check_graph)):
            background_tasks.create(_every(period, act))

    def add_page(self, client: Client) -> None:
        """Build the page of a browser."""
        page = Page(self._robot, client.id)

        def close() -> None:
            page.close()
            if not client.has_socket_connection:  # it may reconnect before its loss is noticed
                self._pages.pop(client.id, None)

        def join() -> None:
            self._pages[client.id] = page
            page.refresh()  # so that no text is empty at first sight

        client.on_connect(join)
        client.on_disconnect(close)
        client.on_delete(close)

    def close(self) -> None:
        """Stop the robot if a page drives it."""
        if self._robot.teleop.is_moving:
            self._robot.publish(STOP)
        self._robot.node.flush_commands()

    async def _check_heartbeats(self) -> None:
        self._robot.publish(self._robot.teleop.check_timeout(steady_clock.steady()))

    async def _show_frame(self) -> None:
        now = steady_clock.steady()  # before the update: latency is never underestimated
        try:
            self._robot.update()
        finally:  # the pages show the rest, whatever is wrong with a message
            await asyncio.sleep(PAUSE_S)
            for page in list(self._pages.values()):
                page.show(now)

    async def _refresh_numbers(self) -> None:
        for page in list(self._pages.values()):
            page.refresh()

    async def _check_graph(self) -> None:
        if self._processes:
            try:
                self._processes.check()
            except RobotEndedError as error:
                self.failure = error
                app.shutdown()
        self._robot.update_graph()

    async def _read_parameters(self) -> None:
        if self._robot.parameters.are_outdated:
            await self._robot.parameters.read()


async def _every(period: float, act: Callable[[], Awaitable[None]]) -> None:
    """Call a function periodically; log its errors, and continue."""
    logged = ''
    while True:
        due = time.monotonic() + period
        try:
            await act()
        except ServiceError as error:
            logging.getLogger('dashboard').debug('%s', error)
        except Exception as error:  # the heartbeat check must not end
            if str(error) != logged:
                logging.getLogger('dashboard').exception('%s', act.__name__)
            logged = str(error)
        await asyncio.sleep(max(0.001, due - time.monotonic()))


def serve(
    node: DashboardNode, host: str, port: int, processes: RobotProcesses | None,
) -> None:
    """Serve the pages of a node until a signal ends it; raises RobotEndedError."""
    token = None if host in LOOPBACK else secrets.token_urlsafe(24)
    server = Server(node, processes)
    app.add_middleware(AccessControl, token=token)
    app.on_startup(server.start)
    app.config.quasar_config['loadingBar']['skipHijack'] = True  # no request here is a page load

    @ui.page('/', title='diffdrive_ros', language='en-US', reconnect_timeout=RECONNECT_S)
    def build(client: Client) -> None:
        server.add_page(client)

    app.on_startup(lambda: print(f'dashboard: {address(host, port, token)}', flush=True))
    spin_thread = SpinThread(node)
    try:
        ui.run(
            host=host, port=port, reload=False, show=False, show_welcome_message=False,
            dark=None, message_history_length=0, reconnect_timeout=RECONNECT_S,
            timeout_graceful_shutdown=1, headers=HEADERS,
            ws_per_message_deflate=False)  # frames are small
    finally:
        server.close()
        spin_thread.close()
    if server.failure:
        raise server.failure
