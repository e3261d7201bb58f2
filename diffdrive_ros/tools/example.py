"""
An example of a calibration: a simulated robot whose wheels are not what its data sheet says.

It drives, a bag of each drive is recorded, calibrate finds the wheels by four of them, and replay
shows a fifth before and after. Each command is printed as one would type it.
"""
import argparse
from collections.abc import Callable, Sequence
import json
import math
from pathlib import Path
import shlex
import sys

from diffdrive_ros.core import se2
from diffdrive_ros.core.kinematics import DiffDrive
from diffdrive_ros.core.simulation import RobotModel, SimulatedRobot
from diffdrive_ros.tools import calibrate, logs, replay
import numpy as np

NOMINAL = DiffDrive(0.160, 0.033, 0.033)
TRUE = RobotModel(0.1634, 0.03285, 0.03322, travel_noise=0.001)
PARAMETERS = """# What the data sheet says.
/**/odometry:
  ros__parameters:
    left_wheel_names: [left_wheel_joint]
    right_wheel_names: [right_wheel_joint]
    wheel_separation: 0.160
    wheel_radius: 0.033
"""
RATE = 50.0  # [Hz] of the wheels
SEEN_EVERY = 2  # the capture is half as fast
CAPTURE = (0.001, 0.004)  # [m], [rad]
MARKER = (0.021, -0.008, 0.03)
START_NS = 1_795_000_000 * 10**9

# Legs of linear [m/s] and angular [rad/s] speed and seconds.
DRIVES = {
    'square_left': 4 * ((0.25, 0.0, 6.0), (0.0, 1.0, 0.5 * math.pi)),
    'square_right': 4 * ((0.25, 0.0, 6.0), (0.0, -1.0, 0.5 * math.pi)),
    'circle_left': ((0.25, 0.4, 30.0),),
    'eight': ((0.25, 0.6, 10.5), (0.25, -0.6, 10.5)),
    'unseen': ((0.25, 0.1, 10.0), (0.0, -1.0, 2.0), (0.25, -0.2, 15.0), (0.2, 0.5, 8.0)),
}


def record(path: Path, legs: Sequence[tuple[float, float, float]], seed: int) -> None:
    """Drive a robot and record what its wheels and the capture say, as an .mcap."""
    robot = SimulatedRobot(TRUE, seed=seed)
    random = np.random.default_rng(seed)
    with logs.DriveWriter(path, '/joint_states', '/mocap') as log:
        stamp_ns = START_NS + seed * 10**12
        for linear, angular, seconds in (*legs, (0.0, 0.0, 0.5)):
            robot.command(*NOMINAL.wheel_speeds(linear, angular))
            for count in range(round(seconds * RATE)):
                log.write_joints(
                    stamp_ns, ('left_wheel_joint', 'right_wheel_joint'), robot.encoders)
                if count % SEEN_EVERY == 0:
                    log.write_pose(stamp_ns, 'world', seen(robot, random))
                robot.advance(1.0 / RATE)
                stamp_ns += round(1e9 / RATE)


def seen(robot: SimulatedRobot, random: np.random.Generator) -> tuple[float, float, float]:
    """Return the pose of the marker as the capture has it, in a frame of its own."""
    pose = se2.compose([1.2, -0.7, 2.0], se2.compose(robot.pose, MARKER))
    x, y, theta = pose + random.normal(size=3) * [CAPTURE[0], CAPTURE[0], CAPTURE[1]]
    return float(x), float(y), float(theta)


def run(folder: Path) -> None:
    """Record the drives in a folder, calibrate by them and replay the one that was not seen."""
    folder.mkdir(exist_ok=True)
    (folder / 'nominal.yaml').write_text(PARAMETERS, encoding='utf-8')
    for seed, (name, legs) in enumerate(DRIVES.items()):
        record(folder / f'{name}.mcap', legs, seed)
    print(f'Recorded in {folder}: {", ".join(DRIVES)}. In truth, the separation is '
          f'{1e3 * TRUE.wheel_separation:g} mm, the radii are {1e3 * TRUE.left_wheel_radius:g} '
          f'(left) and {1e3 * TRUE.right_wheel_radius:g} mm (right).')
    *known, unseen = (str(folder / f'{name}.mcap') for name in DRIVES)
    common = ['--reference', 'mocap', '--force']
    _do('calibrate', calibrate.main, [
        *known, '--params', f'{folder}/nominal.yaml', *common, '--output', f'{folder}/robot.yaml',
        '--json', f'{folder}/found.json', '--plot', f'{folder}/calibration.png'])
    found = json.loads((folder / 'found.json').read_text(encoding='utf-8'))['reference']
    _do('replay', replay.main, [
        unseen, '--before', f'{folder}/nominal.yaml', '--params', f'{folder}/robot.yaml', *common,
        *calibrate.options_for_replay(found['marker'], found['reference_std']),
        '--plot', f'{folder}/replay.png'])
    print(f'Pictures: {folder}/calibration.png, {folder}/replay.png')


def _do(name: str, main: Callable[[Sequence[str]], None], arguments: list[str]) -> None:
    print(f'\n$ {shlex.join([name, *arguments])}', flush=True)
    main(arguments)


def main(arguments: Sequence[str] | None = None) -> None:
    """Run the example as a process."""
    parser = argparse.ArgumentParser(prog='example', description=__doc__.split('\n\n')[0])
    parser.add_argument(
        '--folder', type=Path, default=Path('example'), help='for what is made: %(default)s')
    options = parser.parse_args(arguments)
    try:
        run(options.folder)
    except (ValueError, OSError) as error:
        sys.exit(f'example: {error}')
    except KeyboardInterrupt:
        sys.exit('example: interrupted')


if __name__ == '__main__':
    main()
