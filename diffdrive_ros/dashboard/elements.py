"""The elements that NiceGUI does not have; each has a file of its own in static/."""
from collections.abc import Awaitable, Callable, Mapping
from typing import Any

from diffdrive_ros.dashboard.dashboard_node import ServiceError
from nicegui import ui
from nicegui.events import GenericEventArguments


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


async def notify_result(call: Awaitable[str]) -> None:
    """Show the message that a service responds, or why it does not."""
    try:
        ui.notify(await call, type='info')
    except ServiceError as error:
        ui.notify(str(error), type='negative')
