"""
Replay a log: odometry as the node would have published it, and how far it is from a reference.

The poses go to a TUM text, a CSV or an .mcap; the figures to a table, and as JSON to a file.
"""
import argparse
from collections.abc import Mapping, Sequence
import importlib.util
import json
import os
from pathlib import Path
import sys

from diffdrive_ros.core import evaluation
from diffdrive_ros.core.evaluation import Evaluation
from diffdrive_ros.core.replay import (
    compare,
    comparison_start_ns,
    MAX_COMPARED,
    replay,
    ReplayedOdometry,
)
from diffdrive_ros.tools import logs, parameter_file
from diffdrive_ros.tools.logs import Wanted
from diffdrive_ros.tools.parameter_file import RobotParameters
import numpy as np

LOG_HELP = (
    'rosbag2 folder, .mcap, .db3, or .csv with the header stamp,left,right[,x,y,theta]: stamps '
    '[s] that grow, wheel angles [rad] that are continuous and forward-positive (directions and '
    'wraps of the parameters are for bags), pose of the reference [m, m, rad]')
FORMATS = ('.tum', '.txt', '.csv', '.mcap')


class OptionError(ValueError):
    """An option cannot be what it is; the message says why in one line."""


# The shell

def options_of(arguments: Sequence[str] | None) -> argparse.Namespace:
    """Return the command line."""
    parser = argparse.ArgumentParser(prog='replay', description=__doc__.split('\n\n')[0])
    parser.add_argument('log', type=Path, help=LOG_HELP)
    parser.add_argument(
        '--params', type=Path, required=True, help="the node's parameter file")
    parser.add_argument(
        '--before', type=Path, help='parameters to compare with, such as those not calibrated')
    add_log_options(parser)
    parser.add_argument(
        '--align', choices=evaluation.ALIGNMENTS,
        help='frames are brought together by the first pose (the default), the whole path, or '
        'not at all')
    parser.add_argument(
        '--marker', type=float, nargs=3, metavar=('X', 'Y', 'THETA'),
        help='pose of the reference in the body frame [m, m, rad]')
    parser.add_argument(
        '--time-offset', type=float,
        help="added to the reference's stamps [s], default: 0")
    parser.add_argument(
        '--reference-std', type=float, nargs=2,
        metavar=('POSITION', 'HEADING'),
        help='deviations of the reference itself, for the NEES [m, rad]')
    parser.add_argument(
        '--output', type=Path, help='poses as .tum (or .txt), .csv or .mcap')
    parser.add_argument('--json', type=Path, help='the figures')
    parser.add_argument('--plot', type=Path, help='a page of pictures, .png, .pdf or .svg')
    parser.add_argument('--force', action='store_true', help='write over files that are there')
    return parser.parse_args(arguments)


def add_log_options(parser: argparse.ArgumentParser) -> None:
    """Add the options that say what to read of a log."""
    parser.add_argument(
        '--wheels', default='joint_states', help='topic of the JointStates: %(default)s')
    parser.add_argument('--reference', help='topic of the reference: Odometry, poses or TF')
    parser.add_argument(
        '--reference-child', help='child frame of the reference, where its topic has several')


PICTURES = ('.png', '.pdf', '.svg')


def check_outputs(
    outputs: Mapping[str, Path | None], inputs: Sequence[Path | None], force: bool,
) -> None:
    """Raise OptionError if an output, by its option, cannot be written or must not be."""
    places = {os.path.realpath(path): path for path in inputs if path is not None}
    bags = {place: path for place, path in places.items() if os.path.isdir(place)}
    taken = {place: f'{path} is an input' for place, path in places.items()}
    for option, path in outputs.items():
        if path is None:
            continue
        if option == '--plot':
            if path.suffix not in PICTURES:
                raise OptionError(f'--plot {path}: must end with {", ".join(PICTURES)}')
            if importlib.util.find_spec('matplotlib') is None:
                raise OptionError('matplotlib is needed: pip install matplotlib')
        if path.is_dir():
            raise OptionError(f'{option} {path}: is a folder, must be a file')
        place = os.path.realpath(path)
        if os.path.islink(place):
            raise OptionError(f'{option} {path}: is a loop of links')
        if not os.path.isdir(os.path.dirname(place)):
            raise OptionError(f'{option} {path}: its folder does not exist')
        for bag, name in bags.items():  # its recording would be written over
            if Path(place).is_relative_to(bag):
                raise OptionError(f'{option} {path}: is in {name}, an input, must be elsewhere')
        if place in taken:
            raise OptionError(f'{option} {path}: {taken[place]}, must be another file')
        taken[place] = f'{path} is what {option} writes'
        if path.exists() and not force:
            raise OptionError(f'{path} exists: --force writes over it')


def refuse_twice(logs: Sequence[Path]) -> None:
    """Raise OptionError if a log is given twice: it would count as two drives that agree."""
    seen: set[str] = set()
    for path in logs:
        place = os.path.realpath(path)
        if place in seen:
            raise OptionError(f'{path}: is given twice')
        seen.add(place)


def refuse_idle(options: argparse.Namespace, names: Sequence[str], why: str) -> None:
    """Raise OptionError if one of the options was given though it would do nothing."""
    for name in names:
        value = getattr(options, name.strip('-').replace('-', '_'))
        if not (value is None or value is False or value == []):
            raise OptionError(f'{name}: does nothing {why}')


def _check_numbers(options: argparse.Namespace) -> None:
    for name, values, most in (
            ('--marker', options.marker or (), 1e3),
            ('--time-offset', [options.time_offset or 0.0], 1e6)):
        for value in values:
            if not abs(value) <= most:
                raise OptionError(f'{name} {value}: must be within {most:g}')
    for value in options.reference_std or ():
        if not 0.0 <= value <= 1e3:
            raise OptionError(f'--reference-std {value}: must be from 0 to 1000')


def run(options: argparse.Namespace) -> None:
    """Replay one log; raises ValueError for what cannot be done."""
    check_outputs(
        {'--output': options.output, '--json': options.json, '--plot': options.plot},
        (options.log, options.params, options.before), options.force)
    if options.output and options.output.suffix not in FORMATS:
        raise OptionError(f'--output {options.output}: must end with {", ".join(FORMATS)}')
    _check_numbers(options)
    robot = parameter_file.read(options.params)
    wanted = Wanted(options.wheels, options.reference, options.reference_child)
    log = logs.read(options.log, robot.config.wheel_feedback(), wanted)
    if log.reference is None:
        refuse_idle(
            options, ('--marker', '--time-offset', '--align', '--reference-std'),
            'without a reference')
    is_full = options.output is not None and options.output.suffix == '.mcap'
    every = 1 if is_full else max(1, len(log.samples) // MAX_COMPARED)
    robots = {'': robot}
    if options.before:
        robots = {'before': parameter_file.read(options.before), 'after': robot}
    how, time_offset = options.align or 'start', options.time_offset or 0.0
    known_ns = None
    if log.reference is not None and how == 'start':
        known_ns = comparison_start_ns(log.samples, log.reference, time_offset)
    # What is written has the covariances that the node would publish.
    results = {name: replay(each.config, log.samples, every, None if is_full else known_ns)
               for name, each in robots.items()}
    replayed = list(results.values())[-1]
    duration = float(replayed.stamps_ns[-1] - replayed.stamps_ns[0]) * 1e-9
    comparisons = {}
    if log.reference is not None:
        judged = results if not is_full else {
            name: replay(each.config, log.samples, every, known_ns)
            for name, each in robots.items()}
        comparisons = {
            name: compare(
                each, log.reference, alignment=how, clock_offset=time_offset,
                marker=None if options.marker is None else np.array(options.marker),
                reference_std=tuple(options.reference_std or (0.0, 0.0)))
            for name, each in judged.items()}
    print(f'{options.log}: {len(replayed.stamps_ns)} poses in {duration:.1f} s')
    if comparisons:
        print(table_of({name: each.figures for name, each in comparisons.items()}, how))
    if options.output:
        write_poses(options.output, replayed, robot)
    if options.json:
        content: dict[str, object] = {
            'log': str(options.log), 'poses': len(replayed.stamps_ns), 'seconds': duration,
            'final_pose': replayed.poses[-1].tolist(),
            'align': how if comparisons else None}
        for name, each in comparisons.items():
            content[name or 'figures'] = each.figures.as_json()
        options.json.write_text(json.dumps(content, indent=2) + '\n', encoding='utf-8')
    if options.plot:
        from diffdrive_ros.tools import plots
        plots.draw_replay(options.plot, log, results, comparisons)


ALIGNED = {
    'start': 'by the first pose', 'path': 'by the whole path', 'none': 'not at all'}


def table_of(columns: dict[str, Evaluation], how: str) -> str:
    """Return the figures as lines of text, one column a replay; how: the frames are aligned."""
    first = next(iter(columns.values()))
    rows = [
        ('frames brought together', [ALIGNED[how]] + [''] * (len(columns) - 1)),
        ('length of the way [m]', [f'{each.length:.3f}' for each in columns.values()]),
        ('final position error [m]', [f'{each.final_position:.4f}' for each in columns.values()]),
        ('final heading error [rad]', [f'{each.final_heading:.4f}' for each in columns.values()]),
        ('ATE, rms position [m]', [f'{each.ate:.4f}' for each in columns.values()]),
        ('heading error, rms [rad]', [f'{each.heading_rms:.4f}' for each in columns.values()]),
        ('heading error, worst [rad]', [f'{each.heading_worst:.4f}' for each in columns.values()]),
    ]
    for index, part in enumerate(first.rpe):
        rows.append((
            f'RPE over {part.distance:g} m [m, rad]',
            [f'{each.rpe[index].position:.4f} {each.rpe[index].heading:.4f}'
             if index < len(each.rpe) else '-' for each in columns.values()]))
    for name, key in (('NEES/3, final', 'nees_final'), ('NEES/3, mean', 'nees_mean')):
        if getattr(first, key) is not None:
            rows.append((name, [f'{getattr(each, key):.2f}' for each in columns.values()]))
    lines = [f'{"":28}' + ''.join(f'{name:>16}' for name in columns)] if any(columns) else []
    lines += [f'{name:28}' + ''.join(f'{cell:>16}' for cell in cells) for name, cells in rows]
    return '\n'.join(line.rstrip() for line in lines)


def write_poses(path: Path, replayed: ReplayedOdometry, robot: RobotParameters) -> None:
    """Write the poses in the format that the file's ending says."""
    stamps = replayed.stamps_ns.tolist()
    if path.suffix == '.csv':
        logs.write_csv(path, dict(zip(('x', 'y', 'theta'), replayed.poses.T, strict=True)), stamps)
    elif path.suffix == '.mcap':
        logs.write_odometry(
            path, stamps, replayed.poses, replayed.twists, replayed.pose_covariances,
            replayed.twist_covariances, robot.values.get('odom_frame_id', 'odom'),
            robot.values.get('base_frame_id', 'base_link'))
    else:
        logs.write_tum(path, stamps, replayed.poses)


def main(arguments: Sequence[str] | None = None) -> None:
    """Replay a log as a process."""
    options = options_of(arguments)
    try:
        run(options)
    except (ValueError, OSError) as error:
        sys.exit(f'replay: {error}')
    except KeyboardInterrupt:
        sys.exit('replay: interrupted')


if __name__ == '__main__':
    main()
