"""Whether one page may drive the robot, or change anything of it."""
from collections.abc import Callable
import math
from typing import Any

from diffdrive_ros.dashboard.robot import DashboardRobot
from diffdrive_ros.node import steady_clock
from nicegui import ui
from nicegui.events import GenericEventArguments


class PagePermission:
    """What a page may do; a real robot has to be unlocked first, and anew after each restart."""

    def __init__(self, robot: DashboardRobot, page: str) -> None:
        self._robot, self.page = robot, page
        self._unlocked_arrival: int | None = None

    @property
    def is_driver(self) -> bool:
        """Return whether this page drives."""
        return self._robot.teleop.driver == self.page

    @property
    def is_unlocked(self) -> bool:
        """Return whether the real robot that is present was unlocked."""
        return self._unlocked_arrival == self._robot.commands.arrivals

    @property
    def may_change(self) -> bool:
        """Return whether this page may change anything of the robot."""
        return self._robot.is_simulated or self.is_unlocked

    @property
    def may_drive(self) -> bool:
        """Return whether this page may drive the robot."""
        return not self._robot.reason_not_to_drive and self.may_change

    def unlock(self, arrival: int) -> None:
        """Permit to drive the real robot of an arrival."""
        self._unlocked_arrival = arrival

    def lock(self) -> None:
        """Withdraw that permission."""
        self._unlocked_arrival = None
        self.enforce()

    def enforce(self) -> None:
        """Stop a robot that this page drives and may drive no more."""
        if self.is_driver and not self.may_drive:
            self.leave()

    def leave(self) -> None:
        """Give up control; stop if this page drives."""
        self._robot.publish(self._robot.teleop.leave(self.page))

    def check_change(self) -> bool:
        """Return whether this page may change something now; notify if not."""
        if not self.may_change:
            ui.notify('This is a real robot: choose “Drive this real robot” first.',
                      type='warning')
        elif self._robot.teleop.driver not in (None, self.page):
            ui.notify('Another page drives: take control first.', type='warning')
        else:
            return True
        return False

    def check_current(self, frame: Any) -> bool:
        """Return whether an event was made on a current frame; notify if not."""
        try:
            frame_time, stop_count = float(frame['frameTime']) / 1e3, int(frame['stopCount'])
        except (KeyError, TypeError, ValueError, OverflowError):
            frame_time, stop_count = math.nan, 0
        if self._robot.teleop.is_current(frame_time, stop_count, steady_clock.steady()):
            return True
        ui.notify('The latency was too high, or STOP was pressed meanwhile: nothing was changed. '
                  'Check the page, and try again.', type='warning')
        return False

    def on_current(
        self, element: ui.element, event: str, act: Callable[[], Any], *, is_change: bool = True,
    ) -> None:
        """Call a function at an event, unless its latency is too high, or it may not change."""
        def handle(arguments: GenericEventArguments) -> Any:
            may_act = self.check_current(arguments.args) and (
                not is_change or self.check_change())
            return act() if may_act else None

        element.on(event, handle, js_handler='() => emit(window.drawnFrame)')
