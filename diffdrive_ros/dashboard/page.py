"""The page: one of it for each browser that looks at the robot."""
from collections.abc import Awaitable, Callable, Mapping
from functools import partial
import math
from pathlib import Path
from typing import Any

from diffdrive_ros.dashboard import steering
from diffdrive_ros.dashboard.dashboard_node import NoAnswerError
from diffdrive_ros.dashboard.panels import (
    DiagnosticsPanel,
    EQUATIONS,
    KinematicsPanel,
    ParametersPanel,
)
from diffdrive_ros.dashboard.robot import DashboardRobot
from diffdrive_ros.dashboard.teleop import Beat, Twist
from diffdrive_ros.dashboard.view import Limit, View
from diffdrive_ros.node import clock
from nicegui import ui
from nicegui.events import GenericEventArguments

MOST_UNSEEN = 6  # pictures on their way to a page; one that draws nothing gets no more
SLOWLY = 1.0  # [s] between pictures for such a page

DIAGNOSTICS = 'Diagnostics'
SPEEDS, ELLIPSE = 'speeds', 'ellipse'  # texts

STYLE = Path(__file__).parent / 'static' / 'dashboard.css'


class Page:
    """What one browser sees, and what its hands do."""

    def __init__(self, robot: DashboardRobot, identity: str) -> None:
        self.identity = identity
        self._robot = robot
        self._unlocked: int | None = None  # the arrival of the robot that it was said of
        self._sent_at = self._seen = 0.0
        self._unseen = 0
        self._drawn = dict.fromkeys(robot.tracks, (-1, 0))
        self._build()

    @property
    def may_drive(self) -> bool:
        """Return whether this page may move the robot that is there."""
        return not self._robot.reason_not_to_drive and self._may_touch

    @property
    def _may_touch(self) -> bool:
        return self._robot.is_simulated or self._is_unlocked

    @property
    def _is_unlocked(self) -> bool:
        return self._unlocked == self._robot.arrivals

    def show(self, now: float) -> None:
        """Send a picture of a moment, unless those before it were not even drawn."""
        self._look_at_the_lock()
        self._tell()
        if self._unseen >= MOST_UNSEEN and now - self._sent_at < SLOWLY:
            return
        robot = self._robot
        self._sent_at = now
        self._unseen += 1
        tracks = {}
        for name, track in robot.tracks.items():
            version, count = self._drawn[name]
            start = count if version == track.version else 0
            self._drawn[name] = track.version, len(track.points)
            if start != len(track.points) or not start:
                tracks[name] = {'from': start, 'points': [
                    (round(x, 4), round(y, 4), int(is_start))
                    for x, y, is_start in track.points[start:]]}
        drive = robot.drive
        self._map.run_method('show', {
            'tick': now * 1e3, 'stops': robot.pilot.stops,
            'silent': robot.is_silent, 'odom': robot.odom or (0.0, 0.0, 0.0),
            'truth': robot.truth, 'ellipse': robot.ellipse,
            'wheels': robot.wheels, 'tracks': tracks,
            'geometry': (drive.wheel_separation, drive.left_wheel_radius,
                         drive.right_wheel_radius)})

    def refresh(self) -> None:
        """Renew the numbers; slower than the picture."""
        self.tell(self._texts())
        self._kinematics.refresh()
        if self._tabs.value == DIAGNOSTICS:
            self._diagnostics.refresh()
        self._parameters.refresh()

    def close(self) -> None:
        """Take the hands of this page off the robot."""
        self._robot.publish(self._robot.pilot.leave(self.identity))

    def tell(self, texts: Mapping[str, str]) -> None:
        """Renew texts, by their names."""
        self._map.run_method('tell', texts)

    def _texts(self) -> dict[str, str]:
        robot = self._robot
        hint = '' if robot.applied or robot.value('publish_limited_velocity') else (
            '\n(publish_limited_velocity is false)')
        return {
            SPEEDS: (f'wheels   {_numbers(robot.wheels, "", "rad/s")}\n'
                     f'asked    {_said(robot.asked)}\n'
                     f'applied  {_said(robot.applied)}{hint}\n'
                     f'measured {_said(robot.twist)}'),
            ELLIPSE: '● 95 % of the position' + (
                f': ±{robot.ellipse[0]:.3f} × {robot.ellipse[1]:.3f} m' if robot.ellipse else ''),
            EQUATIONS: self._kinematics.equations()}

    def _build(self) -> None:
        ui.add_css(STYLE)
        self._dark = ui.dark_mode(None)
        ui.colors(primary='#0b57b7', info='#0b57b7', negative='#a31515', warning='#ffd28a')
        with ui.header().classes('items-center gap-x-3 gap-y-1 py-2').style(
                'background: #1b2733; color: #ffffff'):
            View('stop', 'STOP the robot').hear('halt', lambda arguments: self.halt())
            ui.label('diffdrive_ros').classes('text-lg font-bold').props(
                'role=heading aria-level=1')
            self._status = ui.label('Looking for the robot').props(
                'role=status aria-live=polite').classes('grow basis-0')
            ui.label('Connection lost').props('role=alert').classes('grow basis-0')
            ui.button('Light or dark', on_click=self._turn_light).props(
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
        self._map = View(
            'map', 'Map of the robot. Drag it, turn it by the tip of its arrow, drag the arrows '
            'of its wheels; the panel Kinematics does the same by the keyboard.')
        self._map.hear('touch', self._on_touch)
        self._map.hear('follow', self._on_follow)
        with ui.row().classes('items-center gap-2 pt-2'):
            for name, *method in (('Zoom in', 'zoom', 1.4), ('Zoom out', 'zoom', 1.0 / 1.4)):
                self._small_button(name, *method)
            self._follow = self._small_button('Follow', 'fit')
            self._on_follow({'follows': True})
            with ui.row().classes('gap-x-3 gap-y-0 text-sm'):
                ui.label('━ odometry').style('color: var(--map-odom)')
                ui.label('╍ truth').style('color: var(--map-truth)')
                View('text', ELLIPSE).classes('told ellipse').style('color: var(--map-odom)')

    def _small_button(self, name: str, *method: Any) -> ui.button:
        return ui.button(name, on_click=lambda: self._map.run_method(*method)).props(
            'dense outline no-caps').classes('px-2')

    def _build_drive(self) -> None:
        with ui.row().classes('gap-2 choices'):
            self._resume = ui.button('Release the stop').props('no-caps color=green-10')
            self.do_now(self._resume, 'click', self._on_resume)
            self._take = ui.button('Take the wheel').props('no-caps')
            self.do_now(self._take, 'click', self._on_take)
            self._unlock = ui.button('Drive this real robot', on_click=self._ask_to_unlock).props(
                'no-caps color=deep-orange-10')
            self._only_look = ui.button('Only look', on_click=self._lock).props('no-caps')
        with ui.row().classes('items-center gap-4 no-wrap pt-2'):
            pad = View('pad', 'Joystick; by the keyboard W A S D or the arrow keys, held')
            pad.hear('beat', self._on_beat)
            pad.hear('halt', lambda arguments: self.halt())
            with ui.column().classes('gap-1 grow'):
                self._linear = Limit('Fastest [m/s]', 0.05, 1.0, 0.05, 0.3)
                self._angular = Limit('Fastest turn [rad/s]', 0.1, 3.0, 0.1, 1.5)
        ui.label('Hold W A S D, the arrow keys or the joystick to drive; let go to stop. '
                 'Esc is STOP.').classes('quiet text-sm pt-1 with-keys')
        ui.label('Hold the joystick to drive; let go to stop.').classes(
            'quiet text-sm pt-1 without-keys')
        View('text', SPEEDS).classes('numbers pt-1')

    def _build_panels(self) -> None:
        with ui.tabs().props('dense no-caps align=justify').classes('w-full') as self._tabs:
            kinematics = ui.tab('Kinematics')
            parameters = ui.tab('Parameters')
            diagnostics = ui.tab(DIAGNOSTICS)
        with ui.tab_panels(self._tabs, value=kinematics).classes('w-full bg-transparent'):
            with ui.tab_panel(kinematics).classes('p-1 gap-2'):
                self._kinematics = KinematicsPanel(self, self._robot)
            with ui.tab_panel(parameters).classes('p-1'):
                self._parameters = ParametersPanel(self, self._robot)
            with ui.tab_panel(diagnostics).classes('p-1'):
                self._diagnostics = DiagnosticsPanel(self._robot)

    def _on_beat(self, said: Mapping[str, Any]) -> None:
        """Take what the hands of this page ask for at this moment."""
        try:
            number, sight = int(said['number']), float(said['sight']) / 1e3
            twist = self._asked(said)
        except (KeyError, TypeError, ValueError, OverflowError):
            self._robot.publish(self._robot.pilot.distrust(self.identity))
            return
        if sight > self._seen:
            self._seen, self._unseen = sight, 0
        elif said.get('visible'):
            self._unseen = min(self._unseen, MOST_UNSEEN - 1)
        self._robot.publish(self._robot.pilot.beat(
            self.identity, Beat(
                number, sight, twist, bool(said.get('lost')),
                self.may_drive and not self._robot.hold), clock.steady()))

    def _asked(self, said: Mapping[str, Any]) -> Twist:
        fastest = self._linear.value, self._angular.value
        if said.get('wheels'):
            return steering.within(
                self._robot.drive.body_twist(*self._kinematics.wheels), fastest)
        if said.get('stick'):
            return steering.of_stick(said['stick'], fastest)
        return steering.of_keys(said['keys'], fastest)

    def _on_touch(self, said: Mapping[str, Any]) -> None:
        self._kinematics.touch(said.get('pose'), said.get('wheels'))
        if said.get('done') and said.get('pose'):
            if self._is_of_now(said):
                self.set_pose(said['pose'])
            else:
                self.forget_touch()

    def _on_follow(self, said: Mapping[str, Any]) -> None:
        self._follow.props(f'aria-pressed={"true" if said.get("follows") else "false"}')

    def do_now(self, element: ui.element, event: str, act: Callable[[], Any]) -> None:
        """Have an event do something to the robot, unless it was held up on its way."""
        def hear(arguments: GenericEventArguments) -> Any:
            return act() if self._is_of_now(arguments.args) else None

        element.on(event, hear, js_handler='() => emit(window.glance)')

    def _is_of_now(self, glance: Any) -> bool:
        """Return whether a hand on the page saw the robot as it is, and say so if not."""
        try:
            sight, stops = float(glance['sight']) / 1e3, int(glance['stops'])
        except (KeyError, TypeError, ValueError, OverflowError):
            sight, stops = math.nan, 0
        if self._robot.pilot.sees(sight, stops, clock.steady()):
            return True
        ui.notify('That came late, or stop was pressed meanwhile: nothing was changed. Look, and '
                  'do it again.', type='warning')
        return False

    def set_pose(self, pose: Any) -> None:
        """Set odometry to a pose, if this page may."""
        if self.refuses():
            self.forget_touch()
            return
        self._robot.set_pose(pose)

    def draw_touch(self, pose: Any, wheels: Any) -> None:
        """Draw a pose and wheel speeds in place of those of the robot."""
        self._map.run_method('touch', pose, wheels)

    def forget_touch(self) -> None:
        """Draw the robot as it is."""
        self._map.run_method('forget')

    def refuses(self) -> bool:
        """Return whether this page may change nothing now, and say so if that is so."""
        if not self._may_touch:
            ui.notify('This robot is a real one: the page shows it, until you choose '
                      '“Drive this real robot”.', type='warning')
            return True
        if self._robot.pilot.driver not in (None, self.identity):
            ui.notify('Another page drives: take the wheel first.', type='warning')
            return True
        return False

    def halt(self) -> None:
        """Stop the robot, whoever drives it, and have the node hold it."""
        self._robot.publish(self._robot.pilot.stop())
        ui.timer(0.0, lambda: self.attempt(self._robot.enable(False)), once=True)

    async def attempt(self, work: Awaitable[str]) -> bool:
        """Wait for a service; say what it answers, or that it does not."""
        try:
            ui.notify(await work, type='info')
        except NoAnswerError as error:
            ui.notify(str(error), type='negative')
            return False
        return True

    def _on_resume(self) -> Awaitable[bool] | None:
        if self.refuses():
            return None
        return self.attempt(self._robot.release(self._robot.pilot.stops))

    def _on_take(self) -> None:
        if self.may_drive:
            self._robot.publish(self._robot.pilot.take(self.identity))

    async def _ask_to_unlock(self) -> None:
        arrival = self._robot.arrivals
        with ui.dialog() as dialog, ui.card():
            ui.label('This moves a real robot').classes('text-lg font-bold')
            ui.label('Is nobody near it, and is somebody at its emergency stop? Your keys and the '
                     'joystick will then drive it.')
            with ui.row():
                self.do_now(
                    ui.button('Drive it').props('no-caps color=deep-orange-10'), 'click',
                    partial(dialog.submit, True))
                ui.button('Only look', on_click=dialog.close).props('no-caps flat')
        if await dialog is True:
            self._unlocked = arrival

    def _lock(self) -> None:
        self._unlocked = None
        self._look_at_the_lock()

    def _look_at_the_lock(self) -> None:
        if not self.may_drive and self._robot.pilot.driver == self.identity:
            self.close()

    def _turn_light(self) -> None:
        if self._dark.value is None:
            self._dark.value = True
        else:
            self._dark.value = not self._dark.value

    def _tell(self) -> None:
        """Say how things stand."""
        robot, pilot = self._robot, self._robot.pilot
        is_ours, is_held = pilot.driver == self.identity, pilot.is_stopped or robot.is_disabled
        self._resume.set_visibility(is_held)
        self._take.set_visibility(
            self.may_drive and pilot.driver is not None and not is_ours)
        self._unlock.set_visibility(
            robot.odom is not None and not (robot.is_simulated or self._is_unlocked))
        self._only_look.set_visibility(self._is_unlocked and not robot.is_simulated)
        others = robot.other_commanders
        self._status.set_text(self._state(is_ours, is_held) + (
            f' ({", ".join(others)} on cmd_vel too)' if others else ''))

    def _state(self, is_ours: bool, is_held: bool) -> str:
        robot, pilot = self._robot, self._robot.pilot
        if robot.odom is None:
            return 'Looking for the robot: nothing on odom yet'
        if is_held and not robot.is_disabled:
            return 'STOPPED here; the node has not said yet that it holds the wheels'
        if is_held:
            return 'STOPPED: the wheels are held until the stop is released'
        if robot.hold:
            return f'The node holds the wheels: {robot.hold}'
        if reason := robot.reason_not_to_drive:
            return f'The page only shows this robot: {reason}'
        if not self._may_touch:
            return 'A real robot: this page only shows it'
        if pilot.driver and not is_ours:
            return 'Another page drives'
        if complaint := pilot.complaint(self.identity):
            return f'Stopped: {complaint}. Let go, and press again'
        return 'You drive' if is_ours else 'Nobody drives: press a key or the joystick'


def _said(twist: Twist | None) -> str:
    return _numbers(twist, 'm/s ', 'rad/s')


def _numbers(pair: tuple[float, float] | None, first: str, second: str) -> str:
    if pair is None:
        return '   not told'
    one, other = (round(value, 2) + 0.0 for value in pair)  # no -0.00
    return f'{one:7.2f} {first}{other:6.2f} {second}'
