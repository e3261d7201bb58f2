"""
Run an example of a calibration: a simulated robot whose wheels differ from its data sheet.

Five runs are recorded as bags, calibrate estimates the geometry from four of them, and replay
compares the fifth before and after. Each command is printed as a user would type it.
"""
import argparse
from collections.abc import Callable, Sequence
import json
import math
from pathlib import Path
import shlex

from diffdrive_ros.core import se2
from diffdrive_ros.core.kinematics import DiffDrive
from diffdrive_ros.core.simulation import RobotModel, SimulatedRobot
from diffdrive_ros.tools import calibrate, replay
from diffdrive_ros.tools.bags import create_bag, JOINT_STATE, POSE_STAMPED
from diffdrive_ros.tools.command_line import run_tool
from diffdrive_ros.tools.reports import replay_options
import numpy as np

NOMINAL = DiffDrive(0.160, 0.033, 0.033)
TRUE = RobotModel(0.1634, 0.03285, 0.03322, travel_noise=0.001)
PARAMETERS = """# From the data sheet.
/**/odometry:
  ros__parameters:
    left_wheel_names: [left_wheel_joint]
    right_wheel_names: [right_wheel_joint]
    wheel_separation: 0.160
    wheel_radius: 0.033
"""
RATE = 50.0  # [Hz] of the wheels
CAPTURE_EVERY = 2  # samples of the wheels
CAPTURE_STD = (0.001, 0.004)  # [m], [rad]
MARKER = (0.021, -0.008, 0.03)
FRAME = (1.2, -0.7, 2.0)  # the odometry's, as the capture has it
START_NS = 1_795_000_000 * 10**9

# Legs of linear [m/s] and angular [rad/s] speed and seconds.
RUNS = {
    'square_left': 4 * ((0.25, 0.0, 6.0), (0.0, 1.0, 0.5 * math.pi)),
    'square_right': 4 * ((0.25, 0.0, 6.0), (0.0, -1.0, 0.5 * math.pi)),
    'circle_left': ((0.25, 0.4, 30.0),),
    'eight': ((0.25, 0.6, 10.5), (0.25, -0.6, 10.5)),
    'validation': ((0.25, 0.1, 10.0), (0.0, -1.0, 2.0), (0.25, -0.2, 15.0), (0.2, 0.5, 8.0)),
}


def record(path: Path, legs: Sequence[tuple[float, float, float]], seed: int) -> None:
    """Drive a robot; record its joint states and the motion capture as an .mcap."""
    robot = SimulatedRobot(TRUE, seed=seed)
    random = np.random.default_rng(seed)
    with create_bag(path, {'/joint_states': JOINT_STATE, '/mocap': POSE_STAMPED}) as bag:
        stamp_ns = START_NS + seed * 10**12
        for linear, angular, seconds in (*legs, (0.0, 0.0, 0.5)):
            robot.command(*NOMINAL.wheel_speeds(linear, angular))
            for count in range(round(seconds * RATE)):
                bag.write_joints(
                    '/joint_states', stamp_ns, ('left_wheel_joint', 'right_wheel_joint'),
                    robot.encoders)
                if count % CAPTURE_EVERY == 0:
                    marker = se2.compose(FRAME, se2.compose(robot.pose, MARKER))
                    noise = random.normal(size=3) * [CAPTURE_STD[0], *CAPTURE_STD]
                    bag.write_pose('/mocap', stamp_ns, 'world', marker + noise)
                robot.advance(1.0 / RATE)
                stamp_ns += round(1e9 / RATE)


def run(folder: Path) -> None:
    """Record the runs in a folder, calibrate from four of them and replay the fifth."""
    folder.mkdir(exist_ok=True)
    (folder / 'nominal.yaml').write_text(PARAMETERS, encoding='utf-8')
    for seed, (name, legs) in enumerate(RUNS.items()):
        record(folder / f'{name}.mcap', legs, seed)
    print(f'Recorded in {folder}: {", ".join(RUNS)}. True geometry: separation '
          f'{1e3 * TRUE.wheel_separation:g} mm, radii {1e3 * TRUE.left_wheel_radius:g} (left) and '
          f'{1e3 * TRUE.right_wheel_radius:g} mm (right).')
    *calibrating, validating = (str(folder / f'{name}.mcap') for name in RUNS)
    common = ['--reference-topic', 'mocap', '--overwrite']
    _call('calibrate', calibrate.main, [
        'runs', *calibrating, '--params-file', f'{folder}/nominal.yaml', *common, '--output',
        f'{folder}/robot.yaml', '--json', f'{folder}/calibration.json', '--plot',
        f'{folder}/calibration.png'])
    content = json.loads((folder / 'calibration.json').read_text(encoding='utf-8'))
    reference = content['reference']
    _call('replay', replay.main, [
        validating, '--baseline-params', f'{folder}/nominal.yaml', '--params-file',
        f'{folder}/robot.yaml', *common,
        *replay_options(reference['reference_offset'], reference['reference_std']),
        '--plot', f'{folder}/replay.png'])
    print(f'Plots: {folder}/calibration.png, {folder}/replay.png')


def _call(name: str, main: Callable[[Sequence[str]], None], arguments: list[str]) -> None:
    print(f'\n$ {shlex.join([name, *arguments])}', flush=True)
    main(arguments)


def main(arguments: Sequence[str] | None = None) -> None:
    """Run the example as a process."""
    parser = argparse.ArgumentParser(prog='example', description=__doc__.split('\n\n')[0])
    parser.add_argument(
        '--folder', type=Path, default=Path('example'), help='of all files: %(default)s')
    options = parser.parse_args(arguments)
    run_tool('example', lambda: run(options.folder))


if __name__ == '__main__':
    main()
