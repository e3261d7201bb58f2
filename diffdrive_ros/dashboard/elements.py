"""The elements that NiceGUI does not have; each has a file of its own in static/."""
from collections.abc import Awaitable, Callable, Mapping
from typing import Any

from diffdrive_ros.dashboard.dashboard_node import ServiceError
from diffdrive_ros.dashboard.robot import DashboardRobot
from nicegui import ui
from nicegui.events import GenericEventArguments

MAX_PENDING_FRAMES = 6  # sent and not drawn yet; a browser that draws nothing gets no more
SLOW_PERIOD_S = 1.0  # of the frames for such a browser


class PageElement(ui.element):
    """An element with a label for screen readers, whose events carry a mapping."""

    def __init__(self, label: str) -> None:
        super().__init__()
        self.props['label'] = label

    def on_data(self, event: str, act: Callable[[Mapping[str, Any]], None]) -> None:
        """Call a function with the data of an event."""
        def handle(arguments: GenericEventArguments) -> None:
            act(arguments.args if isinstance(arguments.args, dict) else {})

        self.on(event, handle)


class TeleopPad(
        PageElement, component='static/teleop_pad.js', dependencies=['static/page_state.js']):
    """Joystick and keyboard, which send heartbeats; events heartbeat and stop."""


class HoldButton(PageElement, component='static/hold_button.js'):
    """A button that drives the chosen wheel speeds while it is held."""


class StopButton(PageElement, component='static/stop_button.js'):
    """The button STOP; event stop."""


class LiveText(PageElement, component='static/live_text.js'):
    """A text that is updated by its label, without an update of the page."""


class SpeedLimit(
        PageElement, component='static/speed_limit.js', dependencies=['static/page_state.js']):
    """
    A speed limit on a slider, with its value above; heartbeats carry it by its label.

    A slider of the browser: that of Quasar takes the focus at an element without a name.
    """

    def __init__(self, label: str, low: float, high: float, step: float, start: float) -> None:
        super().__init__(label)
        self.props['range'] = [low, high, step, start]
        self._low, self._high = low, high

    def of(self, heartbeat: Mapping[str, Any]) -> float:
        """Return the limit in the data of a heartbeat, within its range."""
        return min(self._high, max(self._low, float(heartbeat['limits'][self.props['label']])))


class RobotMap(
        PageElement, component='static/robot_map.js', dependencies=['static/map_drawing.js']):
    """The map of a robot; events drag and follow."""

    def __init__(self, robot: DashboardRobot) -> None:
        super().__init__(
            'Map of the robot. Drag it, turn it by the tip of its arrow, drag the arrows of its '
            'wheels; the panel Kinematics does the same by the keyboard.')
        self._robot = robot
        self._sent_at = self._drawn_at = 0.0
        self._pending = 0
        self._sent_points = dict.fromkeys(robot.trajectories, (-1, 0))

    def send_frame(self, now: float) -> None:
        """Send the frame of a moment, unless too many are pending."""
        if self._pending >= MAX_PENDING_FRAMES and now - self._sent_at < SLOW_PERIOD_S:
            return
        robot, drive = self._robot, self._robot.parameters.drive
        self._sent_at = now
        self._pending += 1
        self.run_method('show', {
            'frameTime': now * 1e3, 'stopCount': robot.teleop.stop_count,
            'isSilent': robot.is_silent, 'odom': robot.odom or (0.0, 0.0, 0.0),
            'groundTruth': robot.ground_truth, 'ellipse': robot.ellipse, 'wheels': robot.wheels,
            'trajectories': self._new_points(), 'wheelSeparation': drive.wheel_separation})

    def acknowledge(self, frame_time: float, is_visible: bool) -> None:
        """Record the newest frame that the browser has drawn, from a heartbeat."""
        if frame_time > self._drawn_at:
            self._drawn_at, self._pending = frame_time, 0
        elif is_visible:
            self._pending = min(self._pending, MAX_PENDING_FRAMES - 1)

    def set_texts(self, texts: Mapping[str, str]) -> None:
        """Update texts by the labels of their elements."""
        self.run_method('setTexts', texts)

    def draw_dragged(self, pose: Any, wheels: Any) -> None:
        """Draw a pose and wheel speeds in place of those of the robot."""
        self.run_method('drawDragged', pose, wheels)

    def draw_measured(self) -> None:
        """Draw the robot as it is measured."""
        self.run_method('drawMeasured')

    def _new_points(self) -> dict[str, Any]:
        """Return what was added to the trajectories since the last frame, by their names."""
        added = {}
        for name, trajectory in self._robot.trajectories.items():
            version, count = self._sent_points[name]
            start = count if version == trajectory.version else 0
            self._sent_points[name] = trajectory.version, len(trajectory.points)
            if start != len(trajectory.points) or not start:
                added[name] = {'from': start, 'points': [
                    (round(x, 4), round(y, 4), int(is_start))
                    for x, y, is_start in trajectory.points[start:]]}
        return added


async def notify_result(call: Awaitable[str]) -> None:
    """Show the message that a service responds, or why it does not."""
    try:
        ui.notify(await call, type='info')
    except ServiceError as error:
        ui.notify(str(error), type='negative')
