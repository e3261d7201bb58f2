"""The server of the page: its guard, and the beat in which robot and pages are kept."""
import asyncio
from collections.abc import Awaitable, Callable
import logging
import time

from diffdrive_ros.dashboard.access_control import address, WebGuard
from diffdrive_ros.dashboard.dashboard_node import DashboardNode, NoAnswerError, Spinner
from diffdrive_ros.dashboard.page import Page
from diffdrive_ros.dashboard.robot import DashboardRobot
from diffdrive_ros.dashboard.teleop import STOP
from diffdrive_ros.node import clock
from diffdrive_ros.node.robot_processes import RobotEndedError, RobotProcesses
from nicegui import app, Client, ui

WATCH, PICTURE, LEARN, SURROUNDINGS = 0.02, 0.05, 0.2, 1.0  # [s] between two
PICTURES = 4  # for each of which the numbers are renewed once
PAUSE = 0.003  # [s] within a picture, so that no thread of odometry waits until all of it is done
RECONNECT = 3.0  # [s] after which a page that lost its connection is forgotten


class Server:
    """Keeps the robot and its pages until the server ends."""

    def __init__(self, node: DashboardNode, processes: RobotProcesses | None) -> None:
        self.failure: RobotEndedError | None = None
        self._robot = DashboardRobot(node)
        self._processes = processes
        self._pages: dict[str, Page] = {}
        self._shown = 0
        self._tasks: list[asyncio.Task[None]] = []

    def start(self) -> None:
        """Begin to keep them; in the loop of the server."""
        for period, act in (
                (WATCH, self._watch), (PICTURE, self._picture), (LEARN, self._learn),
                (LEARN, self._robot.keep_stopped), (SURROUNDINGS, self._surroundings)):
            self._tasks.append(asyncio.get_running_loop().create_task(_every(period, act)))

    def welcome(self, client: Client) -> None:
        """Build the page of a browser."""
        page = Page(self._robot, client.id)

        def close() -> None:
            page.close()
            if not client.has_socket_connection:  # it may be back before its loss is noticed
                self._pages.pop(client.id, None)

        def join() -> None:
            self._pages[client.id] = page
            page.refresh()  # nothing on it is empty while it is looked at

        client.on_connect(join)
        client.on_disconnect(close)
        client.on_delete(close)

    def close(self) -> None:
        """Stop the robot if a page drives it."""
        if self._robot.pilot.is_moving:
            self._robot.publish(STOP)
        self._robot.node.last_words()

    async def _watch(self) -> None:
        self._robot.publish(self._robot.pilot.watch(clock.steady()))

    async def _picture(self) -> None:
        now = clock.steady()  # by which hands are judged: what is shown is not newer
        try:
            self._robot.look()
        finally:  # whatever is wrong with a message, the pages tell what is known
            self._shown += 1
            await asyncio.sleep(PAUSE)
            for page in list(self._pages.values()):
                page.show(now)
            if self._shown % PICTURES == 0:
                await asyncio.sleep(PAUSE)
                for page in list(self._pages.values()):
                    page.refresh()

    async def _surroundings(self) -> None:
        if self._processes:
            try:
                self._processes.check()
            except RobotEndedError as error:
                self.failure = error
                app.shutdown()
        self._robot.look_around()

    async def _learn(self) -> None:
        if self._robot.needs_to_learn:
            await self._robot.learn()


async def _every(period: float, act: Callable[[], Awaitable[None]]) -> None:
    """Do something again and again; what goes wrong with it is said, and it goes on."""
    said = ''
    while True:
        due = time.monotonic() + period
        try:
            await act()
        except NoAnswerError as error:
            logging.getLogger('dashboard').debug('%s', error)
        except Exception as error:  # the watch over the robot must not end
            if str(error) != said:
                logging.getLogger('dashboard').exception('%s', act.__name__)
            said = str(error)
        await asyncio.sleep(max(0.001, due - time.monotonic()))


def serve(
    node: DashboardNode, host: str, port: int, token: str | None,
    processes: RobotProcesses | None,
) -> None:
    """Serve the page of a node until a signal comes; raises RobotEndedError."""
    server = Server(node, processes)
    app.add_middleware(WebGuard, token=token)
    app.on_startup(server.start)
    app.config.quasar_config['loadingBar']['skipHijack'] = True  # it is nothing that loads

    @ui.page('/', title='diffdrive_ros', language='en-US', reconnect_timeout=RECONNECT)
    def build(client: Client) -> None:
        server.welcome(client)

    app.on_startup(lambda: print(f'dashboard: {address(host, port, token)}', flush=True))
    spinner = Spinner(node)
    try:
        ui.run(
            host=host, port=port, reload=False, show=False, show_welcome_message=False,
            dark=None, message_history_length=0, reconnect_timeout=RECONNECT,
            timeout_graceful_shutdown=1,
            ws_per_message_deflate=False)  # pictures are small
    finally:
        server.close()
        spinner.close()
    if server.failure:
        raise server.failure
