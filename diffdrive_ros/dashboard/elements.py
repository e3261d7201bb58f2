"""The elements that NiceGUI does not have; each has a file of its own in static/."""
from collections.abc import Awaitable, Callable, Mapping
import math
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


class Slider(PageElement, component='static/limit_slider.js'):
    """The slider of the browser: that of Quasar takes the focus at an element without a name."""


class SpeedLimit:
    """A speed limit on a slider, with its value above."""

    def __init__(self, name: str, low: float, high: float, step: float, start: float) -> None:
        self.value = start
        self._name, self._low, self._high = name, low, high
        self._label = ui.label().classes('text-sm')
        slider = Slider(name)
        slider.props['range'] = [low, high, step, start]
        slider.on_data('limit', self._on_limit)
        self._show()

    def _on_limit(self, data: Mapping[str, Any]) -> None:
        value = data.get('value')
        if isinstance(value, (int, float)) and math.isfinite(value):
            self.value = min(self._high, max(self._low, value))
        self._show()

    def _show(self) -> None:
        self._label.set_text(f'{self._name}: {self.value:.2f}')


async def notify_result(call: Awaitable[str]) -> None:
    """Show the message that a service responds, or why it does not."""
    try:
        ui.notify(await call, type='info')
    except ServiceError as error:
        ui.notify(str(error), type='negative')
