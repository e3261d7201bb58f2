"""The panels beside the map: the equations with their numbers, parameters, diagnostics."""
from collections.abc import Callable, Mapping, Sequence
import math
from typing import Any, Protocol

from diffdrive_ros.dashboard import equations
from diffdrive_ros.dashboard.dashboard_node import NoAnswerError
from diffdrive_ros.dashboard.remote_parameters import RemoteParameter
from diffdrive_ros.dashboard.robot import DashboardRobot, DIAGNOSTICS_SILENT
from diffdrive_ros.dashboard.view import View
from diffdrive_ros.node import clock
from nicegui import ui
from rcl_interfaces.msg import ParameterType

LEVELS = ('OK', 'WARN', 'ERROR', 'STALE')
STATUS_PERIOD = 1.0  # [s] between two looks at what comes once a second
TOUCH_STANDS = 1.0  # [s] that a pose is shown after it was dragged
EQUATIONS = 'equations'  # the text of this name


class Hands(Protocol):
    """What a panel needs of its page."""

    def do_now(self, element: ui.element, event: str, act: Callable[[], Any]) -> None:
        """Have an event do something to the robot, unless it was held up on its way."""

    def set_pose(self, pose: Any) -> None:
        """Set odometry to a pose, if the page may."""

    def draw_touch(self, pose: Any, wheels: Any) -> None:
        """Draw a pose and wheel speeds in place of those of the robot."""

    def forget_touch(self) -> None:
        """Draw the robot as it is."""

    def tell(self, texts: Mapping[str, str]) -> None:
        """Renew texts, by their names."""

    def refuses(self) -> bool:
        """Return whether the page may change nothing now, and say so if that is so."""

    async def attempt(self, work: Any) -> bool:
        """Wait for a service; say what it answers, or that it does not."""


class KinematicsPanel:
    """The numbers of the robot, or of what a hand makes of it."""

    def __init__(self, page: Hands, robot: DashboardRobot) -> None:
        self._page, self._robot = page, robot
        self._pose: Sequence[float] | None = None
        self._touched_at = -math.inf
        self.wheels: tuple[float, float] = (0.0, 0.0)
        self._are_wheels_touched = False
        self._is_filling = False
        with ui.row().classes('gap-2 items-end'):
            self._x, self._y, self._theta = (
                ui.number(name, value=0.0, format='%.3f', step=step).props('dense').classes('w-20')
                for name, step in (('x [m]', 0.1), ('y [m]', 0.1), ('θ [rad]', 0.1)))
            page.do_now(ui.button('Set pose').props('no-caps dense'), 'click', self._on_set)
            page.do_now(
                ui.button('Reset odometry').props('no-caps dense outline'), 'click',
                self._on_reset)
        with ui.row().classes('gap-1 items-end'):
            self._left, self._right = (
                ui.number(name, value=0.0, format='%.2f', step=0.5, on_change=self._on_speeds
                          ).props('dense').classes('w-24')
                for name in ('left wheel [rad/s]', 'right wheel [rad/s]'))
            View('hold', 'Hold to drive')
            ui.button('Live', on_click=self._forget).props('no-caps dense outline')
        self._source = ui.label().classes('text-sm quiet told')
        View('text', EQUATIONS).classes('numbers')

    def touch(self, pose: Any, wheels: Any) -> None:
        """Take what is being dragged on the map."""
        if pose is not None and len(pose) == 3 and all(map(math.isfinite, pose)):
            self._pose, self._touched_at = pose, clock.steady()
        if wheels is not None and len(wheels) == 2 and all(map(math.isfinite, wheels)):
            self._take_wheels(*map(float, wheels))
            self._fill()
        self.refresh()
        self._page.tell({EQUATIONS: self.equations()})

    def refresh(self) -> None:
        """Say what the numbers are of."""
        is_touched = self._touched_pose is not None or self._are_wheels_touched
        self._source.set_text('As you touch it' if is_touched else (
            'Not known yet: nothing on odom' if self._robot.odom is None
            else 'As it was last: odom is silent' if self._robot.is_silent else 'As it is now'))

    def equations(self) -> str:
        """Return the equations with their numbers."""
        pose = self._touched_pose or self._robot.odom or (0.0, 0.0, 0.0)
        wheels = self.wheels if self._are_wheels_touched else self._robot.wheels
        return equations.equations(
            self._robot.drive, pose, wheels or (math.nan, math.nan))

    @property
    def _touched_pose(self) -> Sequence[float] | None:
        return self._pose if clock.steady() - self._touched_at < TOUCH_STANDS else None

    def _take_wheels(self, left: float, right: float) -> None:
        self.wheels, self._are_wheels_touched = (left, right), True

    def _fill(self) -> None:
        """Show the speeds of the wheels in their fields, which is no word of a person."""
        self._is_filling = True  # each field tells of its change before the other one changes
        self._left.set_value(round(self.wheels[0], 2))
        self._right.set_value(round(self.wheels[1], 2))
        self._is_filling = False

    def _on_speeds(self) -> None:
        if self._is_filling:
            return
        left, right = self._left.value or 0.0, self._right.value or 0.0
        if (left, right) == (round(self.wheels[0], 2), round(self.wheels[1], 2)):
            return
        self._take_wheels(left, right)
        self._page.draw_touch(None, self.wheels)

    def _on_set(self) -> None:
        self._page.set_pose([field.value or 0.0 for field in (self._x, self._y, self._theta)])

    async def _on_reset(self) -> None:
        if not self._page.refuses():
            await self._page.attempt(self._robot.reset())

    def _forget(self) -> None:
        self._pose, self._are_wheels_touched = None, False
        self.wheels = (0.0, 0.0)
        self._fill()
        self._page.forget_touch()


class ParametersPanel:
    """The live parameters, each with its description, its rule and the node's word on it."""

    def __init__(self, page: Hands, robot: DashboardRobot) -> None:
        self._page, self._robot = page, robot
        self._shown: list[RemoteParameter] = []
        self._fields: dict[str, Any] = {}
        self._answers: dict[str, ui.label] = {}
        self._list = ui.column().classes('w-full gap-3')

    def refresh(self) -> None:
        """Follow the node."""
        live = sorted(  # the limits of the axes, which are many, last
            (each for each in self._robot.parameters if each.is_live),
            key=lambda each: ('.' in each.name, each.name))
        if live == self._shown or repr(live) == repr(self._shown):
            return
        before = {each.name: each.text for each in self._shown}
        self._shown = live
        if before.keys() != {each.name for each in live}:
            self._build()
            return
        for each in live:  # but for those, what is typed stays
            if each.text != before[each.name]:
                self._fields[each.name].set_value(each.text)

    def _build(self) -> None:
        self._list.clear()
        self._fields.clear()
        self._answers.clear()
        with self._list:
            for each in self._shown:
                self._build_one(each)

    def _build_one(self, parameter: RemoteParameter) -> None:
        name = parameter.name
        with ui.column().classes('w-full gap-0'):
            with ui.row().classes('w-full items-center no-wrap gap-2'):
                if parameter.kind == ParameterType.PARAMETER_BOOL:
                    field: Any = ui.select(
                        ['True', 'False'], label=name, value=parameter.text)
                else:
                    field = ui.input(name, value=parameter.text)
                field.props('dense outlined').classes('grow')
                self._fields[name] = field
                button = ui.button('Set').props(f'no-caps dense aria-label="Set {name}"')
                self._page.do_now(button, 'click', lambda: self._set(name))
            rule = f'It {parameter.rule}.' if parameter.rule else ''
            ui.label(f'{parameter.description} {rule}').classes(
                'text-sm quiet')
            answer = ui.label().classes('text-sm font-bold').props('role=status')
            self._answers[name] = answer
        field.on('update:model-value', lambda: answer.set_text(''), args=[])
        if isinstance(field, ui.input):
            self._page.do_now(field, 'keydown.enter', lambda: self._set(name))

    async def _set(self, name: str) -> None:
        if self._page.refuses():
            return
        try:
            reason = await self._robot.set_parameter(name, str(self._fields[name].value))
        except NoAnswerError as error:
            reason = str(error)
        if reason:
            now = next((each.text for each in self._shown if each.name == name), 'not known')
            reason = f'Refused: {reason}. It is {now}'
        self._answers[name].set_text(reason or 'Set')
        self._answers[name].classes(**{'add' if reason else 'remove': 'refused'})


class DiagnosticsPanel:
    """
    What the nodes say of themselves: of a large robot, hundreds of statuses a second.

    So it is renewed only while it is looked at, as often as statuses come, and where they changed.
    """

    def __init__(self, robot: DashboardRobot) -> None:
        self._robot = robot
        self._renewed_at = -math.inf
        self._nothing = ui.label('Nothing on /diagnostics yet')
        self._list = ui.column().classes('w-full gap-2 statuses')
        self._rows: dict[str, StatusRow] = {}

    def refresh(self) -> None:
        """Renew what has changed."""
        now = clock.steady()
        if now - self._renewed_at < STATUS_PERIOD:
            return
        self._renewed_at = now
        told = dict(self._robot.node.diagnostics)
        self._nothing.set_visibility(not told)
        for name in self._rows.keys() - told.keys():
            self._rows.pop(name).remove()
        for place, name in enumerate(sorted(told)):
            if name not in self._rows:
                with self._list:
                    self._rows[name] = StatusRow(place)
            heard_at, status = told[name]
            self._rows[name].tell(status, now - heard_at > DIAGNOSTICS_SILENT)


class StatusRow:
    """One status, at a place among the others."""

    def __init__(self, place: int) -> None:
        self._column = ui.column().classes('w-full gap-0')
        with self._column:
            self._title = ui.label().classes('font-bold')
            self._figures = ui.label().classes('text-sm quiet')
        self._column.move(target_index=place)

    def tell(self, status: Any, is_old: bool) -> None:
        """Show a status; what has not changed is not sent to the page."""
        level = 'SILENT' if is_old else LEVELS[min(status.level[0], 3)]
        self._title.set_text(f'{level}  {status.name}: {status.message}')
        self._figures.set_text(', '.join(f'{each.key} {each.value}' for each in status.values))

    def remove(self) -> None:
        """Take it off the page."""
        self._column.delete()
