"""
Drive a simulated robot over real ROS, and check its odometry by the true pose.

Starts simulator and odometry as processes, drives a path by cmd_vel, and compares odom with
ground_truth. Exits with 0 only if the path was driven and the odometry was right.
"""
import argparse
from collections.abc import Sequence
from contextlib import suppress
import importlib.util
import math
import os
from pathlib import Path
import shutil
import signal
import sys
import time
from typing import TYPE_CHECKING

from diffdrive_ros.core import se2
from diffdrive_ros.core.evaluation import distances_along
from diffdrive_ros.core.validation import Array
from diffdrive_ros.demo.driver_node import DriverNode
from diffdrive_ros.node.robot_processes import (
    RobotEndedError,
    RobotProcesses,
    running_robot,
    used_topics,
)
from diffdrive_ros.node.runner import STOP_SIGNALS
from diffdrive_ros.tools import plots
import numpy as np
import rclpy
from rclpy.executors import SingleThreadedExecutor
from rclpy.signals import SignalHandlerOptions

if TYPE_CHECKING:
    from rich.console import Console

# Legs of (linear [m/s], angular [rad/s], seconds).
PATHS: dict[str, tuple[tuple[float, float, float], ...]] = {
    'square': 4 * ((0.4, 0.0, 2.0), (0.0, 1.5, 0.5 * math.pi / 1.5)),
    'circle': ((0.4, 0.8, 2.0 * math.pi / 0.8),),
    'eight': ((0.4, 1.0, 2.0 * math.pi), (0.4, -1.0, 2.0 * math.pi)),
}

MAX_POSITION_ERROR_M = 0.15
MAX_HEADING_ERROR_RAD = 0.15
MAX_COURSE_ERROR_M = 0.5  # from the planned end to the true one

START_TIMEOUT_S = 20.0
TOPIC_TIMEOUT_S = 2.0
COMMAND_PERIOD_S = 0.05
SETTLING_S = 0.7  # until the wheels stop and the last messages arrive


class DemoError(Exception):
    """The path was not driven, or the odometry was wrong; the message has the reason."""


class DemoRun:
    """One run: driver, robot, and the console with its progress."""

    def __init__(self, driver: DriverNode, robot: RobotProcesses, console: 'Console') -> None:
        self._driver, self._robot, self._console = driver, robot, console
        self._executor = SingleThreadedExecutor()
        self._executor.add_node(driver)

    def wait_for_robot(self) -> None:
        """Return once the robot can be driven; raises DemoError on timeout."""
        deadline = time.monotonic() + START_TIMEOUT_S
        while not self._driver.is_ready():
            if time.monotonic() > deadline:
                raise DemoError(f'no robot and odometry within {START_TIMEOUT_S:g} s')
            self._robot.check()
            self._executor.spin_once(timeout_sec=0.1)

    def drive(self, path: str) -> None:
        """Drive the legs of a path and stop; raises DemoError when robot or odometry fail."""
        from rich.progress import BarColumn, Progress, TextColumn

        legs = PATHS[path]
        with Progress(
            TextColumn(path), BarColumn(bar_width=14), TextColumn('{task.percentage:3.0f} %'),
            TextColumn('{task.fields[state]}'), console=self._console,
        ) as progress:
            task = progress.add_task(path, total=sum(leg[2] for leg in legs), state='')
            start = end = time.monotonic()
            for linear, angular, seconds in legs:
                end += seconds
                while (left := end - time.monotonic()) > 0.0:
                    self._driver.command(linear, angular)
                    self._receive(min(COMMAND_PERIOD_S, left))
                    progress.update(
                        task, completed=time.monotonic() - start, state=self._state())
            self._driver.command(0.0, 0.0)
            self._receive(SETTLING_S)
            progress.update(task, state=self._state())

    def stay(self) -> None:
        """Keep robot and odometry running; returns when interrupted."""
        with suppress(KeyboardInterrupt):
            while True:
                self._receive(1.0)
                self._driver.clear()

    def _receive(self, seconds: float) -> None:
        deadline = time.monotonic() + seconds
        while (left := deadline - time.monotonic()) > 0.0:
            self._executor.spin_once(timeout_sec=left)
        self._robot.check()
        if topic := self._driver.silent_topic(TOPIC_TIMEOUT_S):
            raise DemoError(f'{topic}: no message for {TOPIC_TIMEOUT_S:g} s')

    def _state(self) -> str:
        x, y, theta = self._driver.pose
        left, right = self._driver.wheel_speeds
        return (f'x {x:5.2f} y {y:5.2f} m {math.degrees(theta):6.1f}°  '
                f'wheels {left:5.1f} {right:5.1f} rad/s')


def planned_end(path: str) -> Array:
    """Return the end pose of a path for an ideal robot, (3,)."""
    pose: Array = np.zeros(3)
    for linear, angular, seconds in PATHS[path]:
        pose = se2.compose(pose, se2.exp([linear * seconds, 0.0, angular * seconds]))
    return pose


def errors_of(path: str, odometry: Array, truth: Array) -> dict[str, tuple[float, float, str]]:
    """Return the errors of a run: value, bound and unit by name."""
    apart = np.hypot(*(odometry[:, :2] - truth[:, :2]).T)
    turned = np.abs(odometry[:, 2] - truth[:, 2])
    course = np.hypot(*(truth[-1, :2] - planned_end(path)[:2]))
    return {
        'position error at the end': (float(apart[-1]), MAX_POSITION_ERROR_M, 'm'),
        'position error at worst': (float(apart.max()), MAX_POSITION_ERROR_M, 'm'),
        'heading error at worst': (float(turned.max()), MAX_HEADING_ERROR_RAD, 'rad'),
        'true end from the planned one': (float(course), MAX_COURSE_ERROR_M, 'm'),
    }


def report(console: 'Console', driver: DriverNode, path: str, picture: Path) -> None:
    """Print the errors of a run and plot it; raises DemoError if one is out of bounds."""
    from rich.table import Table

    seconds, odometry, truth = driver.trajectories()
    figures = errors_of(path, odometry, truth)
    length = float(distances_along(truth)[-1])
    table = Table(title=f'{path}, {length:.2f} m driven')
    for heading in ('', 'measured', 'at most'):
        table.add_column(heading, justify='right' if heading else 'left')
    for name, (value, bound, unit) in figures.items():
        table.add_row(name, f'{value:.3f} {unit}', f'{bound:.3f} {unit}')
    console.print(table)
    plots.draw_trajectories(picture, f'Demo: {path}, {length:.2f} m', seconds, odometry, truth)
    console.print(f'Picture: {picture}', soft_wrap=True)
    for name, (value, bound, unit) in figures.items():
        if not value <= bound:
            raise DemoError(f'{name} = {value:.3f} {unit}: must be at most {bound} {unit}')


def commands_to_type() -> list[str]:
    """Return the commands that drive and show the running robot, with ros2 or without."""
    domain = f'ROS_DOMAIN_ID={os.environ.get("ROS_DOMAIN_ID", "0")}'
    local = f'ROS_AUTOMATIC_DISCOVERY_RANGE={os.environ["ROS_AUTOMATIC_DISCOVERY_RANGE"]}'
    if shutil.which('ros2'):
        return [f'  export {domain} {local}',
                '  ros2 run teleop_twist_keyboard teleop_twist_keyboard',
                '  ros2 topic echo /odom']
    dashboard = Path(sys.executable).with_name('dashboard')
    return [f'  {domain} {local} {dashboard}', '  # then open http://127.0.0.1:8080']


def run(path: str, picture: Path, keep_running: bool) -> None:
    """Start the robot, drive it, check its odometry; raises DemoError."""
    from rich.console import Console

    console = Console()
    # The demo commands wheels: it must not reach a real robot on the network.
    os.environ.setdefault('ROS_AUTOMATIC_DISCOVERY_RANGE', 'LOCALHOST')
    rclpy.init(args=[], signal_handler_options=SignalHandlerOptions.NO)
    driver = DriverNode()
    try:
        if topics := used_topics(driver):
            raise DemoError(
                f'{", ".join(topics)}: in use already; end that node, or set ROS_DOMAIN_ID to '
                'another domain')
        with running_robot() as robot:
            run = DemoRun(driver, robot, console)
            run.wait_for_robot()
            run.drive(path)
            report(console, driver, path, picture)
            console.print('PASSED')
            if keep_running:
                console.print('Simulator and odometry keep running until Ctrl-C. To drive the '
                              'robot, type in another terminal:')
                console.print(*commands_to_type(), sep='\n', soft_wrap=True)
                run.stay()
    finally:
        rclpy.try_shutdown()


def main(arguments: Sequence[str] | None = None) -> None:
    """Run the demo as a process."""
    parser = argparse.ArgumentParser(prog='demo', description=__doc__.split('\n\n')[0])
    parser.add_argument(
        '--path', choices=sorted(PATHS), default='square', help='default: square')
    parser.add_argument(
        '--output', type=Path, default=Path('demo.png'),
        help='picture of the trajectories, default: demo.png')
    parser.add_argument(
        '--keep-running', action='store_true', help='leave robot and odometry up afterwards')
    options = parser.parse_args(arguments)
    for extra in ('rich', 'matplotlib'):
        if importlib.util.find_spec(extra) is None:
            sys.exit(f'demo: {extra} is not installed: pip install {extra}, or apt install '
                     f'python3-{extra}')
    if not options.output.resolve().parent.is_dir():
        parser.error(f'--output {options.output}: its folder does not exist')
    for each in STOP_SIGNALS:
        signal.signal(each, signal.default_int_handler)
    try:
        run(options.path, options.output, options.keep_running)
    except (DemoError, RobotEndedError) as failure:
        sys.exit(f'demo: FAILED: {failure}')
    except KeyboardInterrupt:
        sys.exit('demo: interrupted')


if __name__ == '__main__':
    main()
