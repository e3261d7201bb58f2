"""The page: its layout, and what its controls do; one for each browser."""
from collections.abc import Awaitable, Mapping
from functools import partial
from pathlib import Path
from typing import Any

from diffdrive_ros.dashboard.elements import (
    LiveText,
    notify_result,
    RobotMap,
    SpeedLimit,
    StopButton,
    TeleopPad,
)
from diffdrive_ros.dashboard.page_permission import PagePermission
from diffdrive_ros.dashboard.panels import (
    DiagnosticsPanel,
    EQUATIONS,
    KinematicsPanel,
    ParametersPanel,
)
from diffdrive_ros.dashboard.robot import DashboardRobot
from diffdrive_ros.dashboard.status_text import ellipse_text, speeds_text, status_text
from diffdrive_ros.dashboard.teleop import (
    Heartbeat,
    saturate,
    STOP,
    Twist,
    twist_of_joystick,
    twist_of_keys,
)
from diffdrive_ros.node import steady_clock
from nicegui import ui

DIAGNOSTICS = 'Diagnostics'
SPEEDS, ELLIPSE = 'speeds', 'ellipse'  # labels of their texts

STYLE = Path(__file__).parent / 'static' / 'dashboard.css'


class Page:
    """What one browser shows, and what its controls do."""

    def __init__(self, robot: DashboardRobot, identity: str) -> None:
        self._robot = robot
        self._permission = PagePermission(robot, identity)
        self._build()

    def show(self, now: float) -> None:
        """Show the robot at a moment: status line, buttons and a frame of the map."""
        robot, permission = self._robot, self._permission
        permission.enforce()
        self._resume.set_visibility(robot.software_stop.is_active)
        self._take_control.set_visibility(
            permission.may_drive and robot.teleop.driver is not None and not permission.is_driver)
        self._unlock.set_visibility(robot.odom is not None and not permission.may_change)
        self._lock.set_visibility(permission.is_unlocked and not robot.is_simulated)
        self._status.set_text(status_text(robot, permission))
        self._map.send_frame(now)

    def refresh(self) -> None:
        """Update the numbers; less often than the frame."""
        self._map.set_texts({
            SPEEDS: speeds_text(self._robot), ELLIPSE: ellipse_text(self._robot),
            EQUATIONS: self._kinematics.equations()})
        self._kinematics.refresh()
        if self._tabs.value == DIAGNOSTICS:
            self._diagnostics.refresh()
        self._parameters.refresh()

    def close(self) -> None:
        """Give up control."""
        self._permission.leave()

    def _build(self) -> None:
        ui.add_css(STYLE)
        self._dark = ui.dark_mode(None)
        ui.colors(primary='#0b57b7', info='#0b57b7', negative='#a31515', warning='#ffd28a')
        with ui.header().classes('items-center gap-x-3 gap-y-1 py-2').style(
                'background: #1b2733; color: #ffffff'):
            StopButton('STOP the robot').on_data('stop', self._on_stop)
            ui.label('diffdrive_ros').classes('text-lg font-bold').props(
                'role=heading aria-level=1')
            self._status = ui.label('Waiting for odom').props(
                'role=status aria-live=polite').classes('grow basis-0')
            ui.label('Connection lost').props('role=alert').classes('grow basis-0')
            ui.button('Light or dark', on_click=self._on_light_or_dark).props(
                'flat dense color=white no-caps')
        with ui.element('div').classes('layout'):
            with ui.element('section').classes('panel at-map').props('aria-label="Map"'):
                self._build_map()
            with ui.element('section').classes('panel at-drive').props('aria-label="Drive"'):
                self._build_drive()
            with ui.element('section').classes('panel at-numbers').props(
                    'aria-label="Kinematics, parameters, diagnostics"'):
                self._build_panels()

    def _build_map(self) -> None:
        self._map = RobotMap(self._robot)
        self._map.on_data('follow', self._on_follow)
        with ui.row().classes('items-center gap-2 pt-2'):
            for name, *method in (('Zoom in', 'zoom', 1.4), ('Zoom out', 'zoom', 1.0 / 1.4)):
                self._map_button(name, *method)
            self._follow = self._map_button('Follow', 'fit')
            self._on_follow({'isFollowing': True})
            with ui.row().classes('gap-x-3 gap-y-0 text-sm'):
                ui.label('━ odometry').style('color: var(--map-odom)')
                ui.label('╍ ground truth').style('color: var(--map-truth)')
                LiveText(ELLIPSE).classes('received ellipse').style('color: var(--map-odom)')

    def _map_button(self, name: str, *method: Any) -> ui.button:
        return ui.button(name, on_click=lambda: self._map.run_method(*method)).props(
            'dense outline no-caps').classes('px-2')

    def _build_drive(self) -> None:
        with ui.row().classes('gap-2 choices'):
            self._resume = ui.button('Release the stop').props('no-caps color=green-10')
            self._permission.on_current(self._resume, 'click', self._on_resume)
            self._take_control = ui.button('Take control').props('no-caps')
            self._permission.on_current(
                self._take_control, 'click', self._on_take_control, is_change=False)
            self._unlock = ui.button('Drive this real robot', on_click=self._ask_to_unlock).props(
                'no-caps color=deep-orange-10')
            self._lock = ui.button('Display only', on_click=self._permission.lock).props('no-caps')
        with ui.row().classes('items-center gap-4 no-wrap pt-2'):
            pad = TeleopPad('Joystick; by the keyboard W A S D or the arrow keys, held')
            pad.on_data('heartbeat', self._on_heartbeat)
            pad.on_data('stop', self._on_stop)
            with ui.column().classes('gap-1 grow'):
                self._max_speed = SpeedLimit('Max speed [m/s]', 0.05, 1.0, 0.05, 0.3)
                self._max_turn_rate = SpeedLimit('Max turn rate [rad/s]', 0.1, 3.0, 0.1, 1.5)
        ui.label('Hold W A S D, the arrow keys or the joystick to drive; release to stop. '
                 'Esc is STOP.').classes('quiet text-sm pt-1 with-keys')
        ui.label('Hold the joystick to drive; release it to stop.').classes(
            'quiet text-sm pt-1 without-keys')
        LiveText(SPEEDS).classes('numbers pt-1')

    def _build_panels(self) -> None:
        with ui.tabs().props('dense no-caps align=justify').classes('w-full') as self._tabs:
            kinematics = ui.tab('Kinematics')
            parameters = ui.tab('Parameters')
            diagnostics = ui.tab(DIAGNOSTICS)
        with ui.tab_panels(self._tabs, value=kinematics).classes('w-full bg-transparent'):
            with ui.tab_panel(kinematics).classes('p-1 gap-2'):
                self._kinematics = KinematicsPanel(self._robot, self._map, self._permission)
            with ui.tab_panel(parameters).classes('p-1'):
                self._parameters = ParametersPanel(self._robot, self._permission)
            with ui.tab_panel(diagnostics).classes('p-1'):
                self._diagnostics = DiagnosticsPanel(self._robot.node)

    def _on_heartbeat(self, data: Mapping[str, Any]) -> None:
        """Publish what the controls of this page command."""
        teleop = self._robot.teleop
        try:
            heartbeat = Heartbeat(
                int(data['sequenceNumber']), float(data['frameTime']) / 1e3,
                self._commanded_twist(data), bool(data.get('isInterrupted')),
                self._permission.may_drive and not self._robot.inhibits)
        except (KeyError, TypeError, ValueError, OverflowError):
            self._robot.publish(teleop.reject(self._permission.page))
            return
        self._map.acknowledge(heartbeat.frame_time, bool(data.get('isVisible')))
        self._robot.publish(teleop.accept(self._permission.page, heartbeat, steady_clock.steady()))

    def _commanded_twist(self, data: Mapping[str, Any]) -> Twist:
        limits = self._max_speed.of(data), self._max_turn_rate.of(data)
        if data.get('wheels'):
            drive = self._robot.parameters.drive
            return saturate(drive.body_twist(*(self._kinematics.wheels or STOP)), limits)
        if data.get('joystick'):
            return twist_of_joystick(data['joystick'], limits)
        return twist_of_keys(data['keys'], limits)

    def _on_follow(self, data: Mapping[str, Any]) -> None:
        self._follow.props(f'aria-pressed={"true" if data.get("isFollowing") else "false"}')

    def _on_stop(self, data: Mapping[str, Any]) -> None:
        """Stop the robot, whichever page drives it, and disable the node."""
        self._robot.publish(self._robot.teleop.stop())
        ui.timer(
            0.0, lambda: notify_result(self._robot.software_stop.enable(False)), once=True)

    def _on_resume(self) -> Awaitable[None]:
        # The count of this moment: a stop that is pressed from now on is not released.
        return notify_result(
            self._robot.software_stop.release(self._robot.teleop.stop_count))

    def _on_take_control(self) -> None:
        if self._permission.may_drive:
            self._robot.publish(self._robot.teleop.take_control(self._permission.page))

    async def _ask_to_unlock(self) -> None:
        arrival = self._robot.commands.arrivals
        with ui.dialog() as dialog, ui.card():
            ui.label('This moves a real robot').classes('text-lg font-bold')
            ui.label('Make sure that nobody is near it, and that a person is at its emergency '
                     'stop. Your keys and the joystick will drive it.')
            with ui.row():
                self._permission.on_current(
                    ui.button('Drive it').props('no-caps color=deep-orange-10'), 'click',
                    partial(dialog.submit, True), is_change=False)
                ui.button('Display only', on_click=dialog.close).props('no-caps flat')
        if await dialog is True:
            self._permission.unlock(arrival)

    def _on_light_or_dark(self) -> None:
        self._dark.value = not self._dark.value if self._dark.value is not None else True
