"""The elements that NiceGUI does not have: joystick with heartbeat, map, plain slider, text."""
from collections.abc import Callable, Mapping
import math
from typing import Any

from nicegui import ui
from nicegui.events import GenericEventArguments

Handler = Callable[[Mapping[str, Any]], None]


class View(ui.element, component='static/dashboard.js'):
    """One element of dashboard.js, by its kind: pad, hold, stop, limit, text or map."""

    def __init__(self, kind: str, label: str) -> None:
        super().__init__()
        self.props['kind'] = kind
        self.props['label'] = label

    def hear(self, event: str, act: Handler) -> None:
        """Call a function with what the element tells."""
        def on_event(arguments: GenericEventArguments) -> None:
            act(arguments.args if isinstance(arguments.args, dict) else {})

        self.on(event, on_event)


class Limit:
    """
    A speed limit on a slider of the browser's own, with its value above.

    The one of Quasar takes the keyboard at an element without a name.
    """

    def __init__(self, name: str, low: float, high: float, step: float, start: float) -> None:
        self.value = start
        self._name, self._low, self._high = name, low, high
        self._label = ui.label().classes('text-sm')
        slider = View('limit', name)
        slider.props['range'] = [low, high, step, start]
        slider.hear('limit', self._take)
        self._tell()

    def _take(self, said: Mapping[str, Any]) -> None:
        value = said.get('value')
        if not isinstance(value, (int, float)):
            return
        if math.isfinite(value):
            self.value = min(self._high, max(self._low, value))
        self._tell()

    def _tell(self) -> None:
        self._label.set_text(f'{self._name}: {self.value:.2f}')
