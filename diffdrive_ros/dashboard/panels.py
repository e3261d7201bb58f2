"""The panels beside the map: the equations with their numbers, parameters, diagnostics."""
from collections.abc import Mapping, Sequence
from functools import partial
import math
from typing import Any

from diffdrive_ros.dashboard import equations
from diffdrive_ros.dashboard.dashboard_node import DashboardNode, ServiceError
from diffdrive_ros.dashboard.elements import HoldButton, LiveText, notify_result, RobotMap
from diffdrive_ros.dashboard.page_permission import PagePermission
from diffdrive_ros.dashboard.remote_parameters import RemoteParameter
from diffdrive_ros.dashboard.robot import DashboardRobot
from diffdrive_ros.dashboard.software_stop import DIAGNOSTICS_TIMEOUT_S
from diffdrive_ros.node import steady_clock
from nicegui import ui
from rcl_interfaces.msg import ParameterType

LEVELS = ('OK', 'WARN', 'ERROR', 'STALE')
STATUS_PERIOD_S = 1.0
DRAGGED_POSE_S = 1.0  # for which a pose is shown after it was dragged
EQUATIONS = 'equations'  # label of its text


class KinematicsPanel:
    """The equations with the numbers of the robot, or with those that are dragged on the map."""

    def __init__(
        self, robot: DashboardRobot, robot_map: RobotMap, permission: PagePermission,
    ) -> None:
        self._robot, self._map, self._permission = robot, robot_map, permission
        self._pose: Sequence[float] | None = None
        self._dragged_at = -math.inf
        self.wheels: tuple[float, float] | None = None
        """The wheel speeds that were dragged or typed [rad/s]."""
        robot_map.on_data('drag', self._on_drag)
        with ui.row().classes('gap-2 items-end'):
            self._x, self._y, self._theta = (
                ui.number(name, value=0.0, format='%.3f', step=step).props('dense').classes('w-20')
                for name, step in (('x [m]', 0.1), ('y [m]', 0.1), ('θ [rad]', 0.1)))
            permission.on_current(
                ui.button('Set pose').props('no-caps dense'), 'click', lambda: robot.set_pose(
                    [field.value or 0.0 for field in (self._x, self._y, self._theta)]))
            permission.on_current(
                ui.button('Reset odometry').props('no-caps dense outline'), 'click',
                lambda: notify_result(robot.reset()))
        with ui.row().classes('gap-1 items-end'):
            self._left, self._right = (
                ui.number(name, value=0.0, format='%.2f', step=0.5).props('dense').classes('w-24')
                .on('update:model-value', self._on_speeds, args=[])  # not what is set here
                for name in ('left wheel [rad/s]', 'right wheel [rad/s]'))
            HoldButton('Hold to drive')
            ui.button('Live', on_click=self._on_live).props('no-caps dense outline')
        self._source = ui.label().classes('text-sm quiet received')
        LiveText(EQUATIONS).classes('numbers')

    def refresh(self) -> None:
        """Update the source of the numbers."""
        is_dragged = self._dragged_pose is not None or self.wheels is not None
        self._source.set_text('Dragged or typed values' if is_dragged else (
            'No values: nothing received on odom' if self._robot.odom is None
            else 'Last values: odom is silent' if self._robot.is_silent else 'Live values'))

    def equations(self) -> str:
        """Return the equations with their numbers."""
        pose = self._dragged_pose or self._robot.odom or (0.0, 0.0, 0.0)
        wheels = self.wheels or self._robot.wheels or (math.nan, math.nan)
        return equations.equations(self._robot.parameters.drive, pose, wheels)

    @property
    def _dragged_pose(self) -> Sequence[float] | None:
        return self._pose if steady_clock.steady() - self._dragged_at < DRAGGED_POSE_S else None

    def _on_drag(self, data: Mapping[str, Any]) -> None:
        """Show what is dragged on the map; set the pose where it is dropped."""
        pose, wheels = data.get('pose'), data.get('wheels')
        if pose is not None and len(pose) == 3 and all(map(math.isfinite, pose)):
            self._pose, self._dragged_at = pose, steady_clock.steady()
        if wheels is not None and len(wheels) == 2 and all(map(math.isfinite, wheels)):
            self.wheels = float(wheels[0]), float(wheels[1])
            self._fill(self.wheels)
        self.refresh()
        self._map.set_texts({EQUATIONS: self.equations()})
        if data.get('isDropped') and pose:
            if self._permission.check_current(data) and self._permission.check_change():
                self._robot.set_pose(pose)
            else:
                self._map.draw_measured()

    def _fill(self, wheels: tuple[float, float]) -> None:
        """Write wheel speeds into their fields."""
        self._left.set_value(round(wheels[0], 2))
        self._right.set_value(round(wheels[1], 2))

    def _on_speeds(self) -> None:
        self.wheels = self._left.value or 0.0, self._right.value or 0.0
        self._map.draw_dragged(None, self.wheels)

    def _on_live(self) -> None:
        self._pose = self.wheels = None
        self._fill((0.0, 0.0))
        self._map.draw_measured()


class ParametersPanel:
    """The live parameters, each with its description, its rule and the response of the node."""

    def __init__(self, robot: DashboardRobot, permission: PagePermission) -> None:
        self._parameters, self._permission = robot.parameters, permission
        self._shown: Mapping[str, RemoteParameter] = {}
        self._fields: dict[str, Any] = {}
        self._list = ui.column().classes('w-full gap-3')

    def refresh(self) -> None:
        """Show the parameters as they were read last."""
        before, self._shown = self._shown, self._parameters.all
        if self._shown is before:
            return
        live = sorted(  # the limits of the axes, which are many, last
            (name for name, each in self._shown.items() if not each.descriptor.read_only),
            key=lambda name: ('.' in name, name))
        if live != [*self._fields]:
            self._list.clear()
            with self._list:
                self._fields = {name: self._build(name, self._shown[name]) for name in live}
            return
        for name, field in self._fields.items():  # what is typed into the others stays
            if self._shown[name].text != before[name].text:
                field.set_value(self._shown[name].text)

    def _build(self, name: str, parameter: RemoteParameter) -> Any:
        """Return the field of a parameter."""
        descriptor = parameter.descriptor
        with ui.column().classes('w-full gap-0'):
            with ui.row().classes('w-full items-center no-wrap gap-2'):
                if descriptor.type == ParameterType.PARAMETER_BOOL:
                    field: Any = ui.select(
                        ['True', 'False'], label=name, value=parameter.text)
                else:
                    field = ui.input(name, value=parameter.text)
                field.props('dense outlined').classes('grow')
                button = ui.button('Set').props(f'no-caps dense aria-label="Set {name}"')
            rule = descriptor.additional_constraints
            ui.label(descriptor.description + (rule and f' It {rule}.')).classes('text-sm quiet')
            result = ui.label().classes('text-sm font-bold').props('role=status')
        act = partial(self._set, name, field, result)
        self._permission.on_current(button, 'click', act)
        field.on('update:model-value', lambda: result.set_text(''), args=[])
        if isinstance(field, ui.input):
            self._permission.on_current(field, 'keydown.enter', act)
        return field

    async def _set(self, name: str, field: Any, result: ui.label) -> None:
        try:
            reason = await self._parameters.change(name, str(field.value))
        except ServiceError as error:
            reason = str(error)
        if reason:
            now = self._parameters.all.get(name)
            reason = f'Refused: {reason}. It is {now.text if now else "not read"}'
        result.set_text(reason or 'Set')
        result.classes(**{'add' if reason else 'remove': 'refused'})


class DiagnosticsPanel:
    """
    The statuses of all nodes: of a large robot, hundreds a second.

    So it is refreshed only while it is open, at the rate of the statuses, and where they changed.
    """

    def __init__(self, node: DashboardNode) -> None:
        self._node = node
        self._refreshed_at = -math.inf
        self._placeholder = ui.label('Nothing received on /diagnostics')
        self._list = ui.column().classes('w-full gap-2 statuses')
        self._rows: list[tuple[ui.label, ui.label]] = []
        """Title and values of each status; labels that do not change are not sent."""

    def refresh(self) -> None:
        """Show the newest statuses, sorted by their names."""
        now = steady_clock.steady()
        if now - self._refreshed_at < STATUS_PERIOD_S:
            return
        self._refreshed_at = now
        statuses = sorted(dict(self._node.diagnostics).items())
        self._placeholder.set_visibility(not statuses)
        while len(self._rows) < len(statuses):
            with self._list, ui.column().classes('w-full gap-0'):
                self._rows.append((
                    ui.label().classes('font-bold'), ui.label().classes('text-sm quiet')))
        for (title, values), (name, (received_at, status)) in zip(
                self._rows, statuses, strict=True):
            is_old = now - received_at > DIAGNOSTICS_TIMEOUT_S
            level = 'SILENT' if is_old else LEVELS[min(status.level[0], 3)]
            title.set_text(f'{level}  {name}: {status.message}')
            values.set_text(', '.join(f'{each.key} {each.value}' for each in status.values))
