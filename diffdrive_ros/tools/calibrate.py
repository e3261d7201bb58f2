"""
Calibrate a robot by logs of its drives: its geometry with error bars, as the node's parameters.

With a reference (motion capture, a map) any drives will do. Without one, umbmark takes the end
poses of squares driven both ways, and line-and-turn a straight line and turns on the spot.
"""
import argparse
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
import importlib.util
import json
import os
from pathlib import Path
import signal
import sys
import threading
from typing import TYPE_CHECKING, TypeVar

from diffdrive_ros.calibration import node_parameters
from diffdrive_ros.calibration.end_pose import line_and_turn, umbmark
from diffdrive_ros.calibration.model import check_geometry, GEOMETRY_PARAMETERS
from diffdrive_ros.core.validation import Array, UserError
from diffdrive_ros.tools import logs, parameter_file
from diffdrive_ros.tools.logs import Log, Wanted
from diffdrive_ros.tools.parameter_file import RobotParameters
from diffdrive_ros.tools.replay import (
    add_log_options,
    check_outputs,
    LOG_HELP,
    OptionError,
    refuse_idle,
    refuse_twice,
)
import numpy as np

if TYPE_CHECKING:
    from diffdrive_ros.calibration.cross_validation import FinalErrors
    from diffdrive_ros.calibration.model import Calibration, Run

OutT = TypeVar('OutT')

# A reference whose headings are noisier than this tells by its positions only [rad].
HEADLESS = 0.3


# On all cores

def on_all_cores(
    what: str, function: Callable[..., OutT], tasks: Sequence[tuple[object, ...]],
) -> Iterator[tuple[int, OutT | ValueError]]:
    """
    Yield the index of each task and what the function returned, or the ValueError it raised.

    They come as they are done. On Ctrl-C the rest is not begun, and nothing more comes.
    """
    from rich.console import Console
    from rich.progress import Progress

    workers = max(1, min(len(tasks), os.cpu_count() or 1))
    pool = ProcessPoolExecutor(workers, initializer=_begin_worker)
    pending: dict[Future[OutT], int] = {
        pool.submit(function, *task): index for index, task in enumerate(tasks)}
    # A flag and no exception: that could come while the caller keeps what is done.
    stop = threading.Event()
    before = signal.signal(signal.SIGINT, lambda number, frame: stop.set())
    console = Console(stderr=True)
    with Progress(
            console=console, transient=True, disable=not console.is_terminal) as progress:
        bar = progress.add_task(what, total=len(tasks))
        try:
            while pending and not stop.is_set():
                for future in wait(pending, 0.1, FIRST_COMPLETED).done:
                    index = pending.pop(future)
                    try:
                        result: OutT | ValueError = future.result()
                    except ValueError as error:
                        result = error
                    progress.advance(bar)
                    yield index, result
        finally:
            pool.shutdown(wait=True, cancel_futures=True)
            signal.signal(signal.SIGINT, before)
    if pending:
        print(f'{what}: interrupted, {len(pending)} not done', file=sys.stderr)


def _begin_worker() -> None:
    """Leave Ctrl-C to the parent, and the other cores to the other workers."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    _keep_to_one_core()


def _keep_to_one_core() -> None:
    """Let linear algebra do without threads: of matrices as small as these, they wait."""
    try:
        from threadpoolctl import threadpool_limits
    except ImportError:  # no distribution of ROS has it; it takes several times as long
        return
    threadpool_limits(1)


def read_log(path: Path, robot: RobotParameters, wanted: Wanted) -> Log:
    """Return a log with its reference; raises LogError."""
    log = logs.read(path, robot.config.wheel_feedback(), wanted)
    if log.reference is None:
        raise logs.LogError(f'{path}: has no reference; ' + (
            'a CSV has it in the columns x,y,theta' if path.suffix == '.csv'
            else '--reference names its topic'))
    stamps, _, _ = log.wheels()
    seen = log.reference.stamps_ns
    if seen[-1] < stamps[0] or seen[0] > stamps[-1]:
        raise logs.LogError(
            f'{path}: the reference, from {seen[0] * 1e-9:.3f} to {seen[-1] * 1e-9:.3f} s, does '
            f'not overlap the wheels, from {stamps[0] * 1e-9:.3f} to {stamps[-1] * 1e-9:.3f} s')
    return log


def run_of(log: Log) -> 'Run':
    """Return a log as the calibration takes it; raises ValueError."""
    from diffdrive_ros.calibration.model import Run

    stamps, left, right = log.wheels()
    assert log.reference is not None
    return Run(
        log.name, (stamps - stamps[0]) * 1e-9, left, right,
        (log.reference.stamps_ns - stamps[0]) * 1e-9, log.reference.poses)


COMMENTS = {
    'wheel_separation': '[m] nominal, FULL distance between the contact points',
    'wheel_radius': '[m] nominal',
    'left_wheel_travel_variance': '[m^2/m]',
    'right_wheel_travel_variance': '[m^2/m]',
    'turn_variance': '[rad^2/rad]',
    'wheel_separation_std': '[m]',
    'left_wheel_radius_std': '[m]',
    'right_wheel_radius_std': '[m]',
}


def summary_of(robot: RobotParameters, found: 'Calibration') -> str:
    """Return what was found as lines of text."""
    from diffdrive_ros.calibration.covariance import MIN_VARIANCES

    def shown(value: float, floor: float) -> str:
        return f'{"< " if value < 1.01 * floor else ""}{value:.2g}'

    travel, turn = map(shown, (found.noise.left_travel, found.noise.turn), MIN_VARIANCES)
    spread = shown(  # its floor is relative
        1e3 * found.separation_spread, 1e3 * found.drive.wheel_separation * MIN_VARIANCES[2]**0.5)
    position, heading, time, slow_position, slow_heading = (
        shown(1e3 * value, 1e3 * floor**0.5) for value, floor in zip(
            (found.position_std, found.heading_std, found.time_std, found.slow_position_std,
             found.slow_heading_std), MIN_VARIANCES[3:], strict=True))
    before, drive, deviations = robot.config.drive, found.drive, found.geometry_std
    lines = [f'{"":24}{"before":>12}{"calibrated":>12}{"deviation":>12}']
    for index, name in enumerate(GEOMETRY_PARAMETERS):
        deviation = _or_not_known(1e3 * deviations[index], '.3f')
        lines.append(
            f'{name + " [mm]":24}{1e3 * getattr(before, name):12.3f}'
            f'{1e3 * getattr(drive, name):12.3f}{deviation:>12}')
    lines += [f'not observed: {what}; as before' for what in found.unobservable]
    if deviations[0]:
        lines.append(
            'spread of separation   '
            + (f'{spread} mm from drive to drive' if found.separation_spread else 'not known')
            + f'; wheel_separation_std {1e3 * found.uncertainty.wheel_separation:.2f} mm, for '
            'drives to come')
    lines += [
        f'noise of the wheels    {travel} m^2/m of their travel, '
        + (f'{turn} rad^2/rad of the turn' if found.noise.turn else 'of the turn not known'),
        f'noise of the reference {position} mm, {heading} mrad, {time} ms; for seconds '
        f'{slow_position} mm, {slow_heading} mrad',
        'marker on the robot    ' + ', '.join(
            f'{1e3 * value:.2f} ± {_or_not_known(1e3 * deviation, ".2f")} {unit}'
            for value, deviation, unit in zip(
                found.marker, found.marker_std, ('mm', 'mm', 'mrad'), strict=True)),
        'for replay             ' + ' '.join(
            options_for_replay(found.marker, found.reference_std)),
    ]
    if found.reference_std[1] > HEADLESS:
        lines.append('the headings of the reference do not fit: in degrees, or none?')
    for each in found.runs:
        if each.outlier:
            lines.append(f'left out: {each.name}: {each.outlier}')
    return '\n'.join(lines)


def options_for_replay(marker: Iterable[float], reference_std: Iterable[float]) -> list[str]:
    """Return the options by which replay compares with a reference as calibrate did."""
    return ['--marker', *(f'{each:.5f}' for each in marker),
            '--reference-std', *(f'{each:.5f}' for each in reference_std)]


def judged_table(judged: 'Sequence[FinalErrors]') -> str:
    """Return the final errors of each drive as lines of text, and the medians of those kept."""
    lines = [f'{"final error [m]":28}{"before":>10}{"calibrated":>12}{"unseen":>10}'
             f'{"--time-offset [s]":>19}']
    for each in judged:
        unseen = '-' if each.cross_validated is None else f'{each.cross_validated:.4f}'
        offset = '-' if each.clock_offset is None else f'{each.clock_offset:.4f}'
        lines.append(
            f'{each.name:28}{each.before:10.4f}{each.calibrated:12.4f}{unseen:>10}{offset:>19}')
    kept = [each for each in judged if not each.is_outlier]
    unseen_errors = [each.cross_validated for each in kept if each.cross_validated is not None]
    lines.append(
        f'{"median":28}{np.median([each.before for each in kept]):10.4f}'
        f'{np.median([each.calibrated for each in kept]):12.4f}'
        + (f'{np.median(unseen_errors):10.4f}' if unseen_errors else f'{"-":>10}'))
    lines += [f'not cross-validated: {each.failure}' for each in judged if each.failure]
    return '\n'.join(lines)


# The shell

def options_of(arguments: Sequence[str] | None) -> argparse.Namespace:
    """Return the command line."""
    parser = argparse.ArgumentParser(prog='calibrate', description=__doc__.split('\n\n')[0])
    parser.add_argument('logs', type=Path, nargs='*', help=f'each a {LOG_HELP}')
    parser.add_argument(
        '--params', type=Path, help="the node's parameter file, with the nominal geometry")
    parser.add_argument(
        '--separation', type=float, help='nominal wheel_separation [m], without --params')
    parser.add_argument('--radius', type=float, help='nominal wheel_radius [m], likewise')
    add_log_options(parser)
    parser.add_argument(
        '--umbmark', type=Path, metavar='CSV', help='in place of logs: the ends of squares, '
        'direction,x,y a row (cw or ccw; where the robot is minus where odometry is [m])')
    parser.add_argument('--side', type=float, help='of the squares [m]')
    parser.add_argument(
        '--line-and-turn', type=float, nargs=7, metavar=(
            'LEFT', 'RIGHT', 'DISTANCE', 'SIDEWAYS', 'TURN_LEFT', 'TURN_RIGHT', 'TURNED'),
        help='in place of logs: wheel angles [rad] and end [m] of a straight line, wheel angles '
        'and heading [rad] of a turn on the spot')
    parser.add_argument(
        '--without', choices=('time-offset', 'marker'), action='append', default=[],
        help='do not estimate the offset of the clocks, or the place of the marker')
    parser.add_argument(
        '--no-validation', action='store_true', help='do not cross-validate over the drives')
    parser.add_argument('--output', type=Path, help='parameter file for the node')
    parser.add_argument('--json', type=Path, help='what was found, with its covariance')
    parser.add_argument('--plot', type=Path, help='a page of pictures, .png, .pdf or .svg')
    parser.add_argument('--force', action='store_true', help='write over files that are there')
    return parser.parse_args(arguments)


def robot_of(options: argparse.Namespace) -> RobotParameters:
    """Return the nominal robot; raises ValueError."""
    if options.params:
        if options.separation is not None or options.radius is not None:
            raise OptionError('--params has the geometry: no --separation and --radius')
        return parameter_file.read(options.params)
    if options.separation is None or options.radius is None:
        raise OptionError('what is the robot nominally? --params, or --separation and --radius')
    for name in ('separation', 'radius'):
        if not 1e-3 <= getattr(options, name) <= 1e2:
            raise OptionError(
                f'--{name} = {getattr(options, name)}: must be from 0.001 to 100 m')
    return RobotParameters.of({
        'left_wheel_names': ['left_wheel_joint'], 'right_wheel_names': ['right_wheel_joint'],
        'wheel_separation': options.separation, 'wheel_radius': options.radius})


def run(options: argparse.Namespace) -> None:
    """Calibrate by logs; raises ValueError for what cannot be done."""
    check_outputs(
        {'--output': options.output, '--json': options.json, '--plot': options.plot},
        (*options.logs, options.params, options.umbmark), options.force)
    if options.umbmark or options.line_and_turn:
        run_by_ends(options)
        return
    if not options.logs:
        raise OptionError('no logs; or --umbmark, or --line-and-turn')
    refuse_idle(options, ('--side',), 'without --umbmark')
    refuse_twice(options.logs)
    for extra in ('rich', 'scipy'):
        if importlib.util.find_spec(extra) is None:
            raise OptionError(f'{extra} is needed: pip install {extra}')
    from diffdrive_ros.calibration.cross_validation import (
        calibrate_without,
        compare_run,
        final_errors,
    )
    from diffdrive_ros.calibration.fit import calibrate
    from diffdrive_ros.calibration.model import Terms
    from rich.console import Console

    _keep_to_one_core()
    robot = robot_of(options)
    wanted = Wanted(options.wheels, options.reference, options.reference_child)
    read: dict[int, Log] = {}
    tasks = [(path, robot, wanted) for path in options.logs]
    for index, result in on_all_cores('Reading', read_log, tasks):
        if isinstance(result, ValueError):
            raise result
        read[index] = result
    if len(read) < len(tasks):
        raise KeyboardInterrupt
    kept = [read[index] for index in sorted(read)]
    runs = [run_of(log) for log in kept]
    terms = Terms(
        clock_offset='time-offset' not in options.without, marker='marker' not in options.without)
    with Console(stderr=True).status('Fitting'):
        found = calibrate(runs, robot.config.drive, terms)
    print(summary_of(robot, found))
    cross_validated: dict[int, Calibration | UserError] = {}
    if len(runs) > 2 and not options.no_validation:
        folds = [(index, runs, robot.config.drive, terms, found) for index in range(len(runs))]
        for index, fold in on_all_cores('Cross-validation', calibrate_without, folds):
            if isinstance(fold, ValueError) and not isinstance(fold, UserError):
                raise fold
            cross_validated[index] = fold
    judged = [
        final_errors(index, run, robot.config, terms, found, cross_validated.get(index))
        for index, run in enumerate(runs)]
    print(judged_table(judged))
    values = dict(robot.values) | node_parameters.from_runs(found, robot.config, robot.nominal)
    after = RobotParameters.of(values)
    if options.output:
        head = (
            f'Calibrated by {sum(not each.outlier for each in found.runs)} of {len(kept)} '
            'drives. Start the node with it:\n'
            '  ros2 run diffdrive_ros odometry --ros-args --params-file ' + options.output.name)
        parameter_file.write(options.output, values, COMMENTS, head)
    if options.json:
        options.json.write_text(
            json.dumps(as_json(found, judged, values), indent=2) + '\n', encoding='utf-8')
    if options.plot:
        from diffdrive_ros.tools import plots
        comparisons = [
            {'before': compare_run(run, robot.config, found, each.clock_offset),
             'after': compare_run(run, after.config, found, each.clock_offset)}
            for run, each in zip(runs, judged, strict=True)]
        plots.draw_calibration(options.plot, comparisons, found, judged)


def run_by_ends(options: argparse.Namespace) -> None:
    """Calibrate by where the robot ended up; raises ValueError for what cannot be done."""
    robot = robot_of(options)
    if options.logs or (options.umbmark and options.line_and_turn):
        raise OptionError('logs, --umbmark and --line-and-turn: must be one of the three')
    refuse_idle(
        options, ('--json', '--plot', '--reference', '--reference-child', '--without',
                  '--no-validation', *(('--side',) if options.line_and_turn else ())),
        'without logs')
    if options.umbmark:
        if options.side is None:
            raise OptionError('--side: the side of the squares is needed [m]')
        if not 0.01 <= options.side <= 1e3:
            raise OptionError(f'--side = {options.side}: must be from 0.01 to 1000 m')
        ends = logs.read_ends(options.umbmark)
        found = umbmark(ends['cw'], ends['ccw'], options.side, robot.config.drive)
    else:
        left, right, distance, sideways, turn_left, turn_right, turned = options.line_and_turn
        found = line_and_turn(
            (left, right), distance, sideways, (turn_left, turn_right), turned, robot.config.drive)
    check_geometry(
        found.drive, robot.config.drive, 'are angles in degrees, lengths in mm, signs turned '
        'round, or is the nominal geometry far off?')
    print(f'E_b {found.separation_ratio:.5f} ± {_or_not_known(found.ratio_std[0], ".5f")}, '
          f'E_d {found.diameter_ratio:.5f} ± {_or_not_known(found.ratio_std[1], ".5f")}')
    for name, deviation in zip(GEOMETRY_PARAMETERS, found.geometry_std.tolist(), strict=True):
        print(f'{name:20} {1e3 * getattr(found.drive, name):9.3f} ± '
              f'{_or_not_known(1e3 * deviation, ".3f")} mm')
    if options.output:
        values = dict(robot.values) | node_parameters.from_end_poses(found, robot.nominal)
        RobotParameters.of(values)
        parameter_file.write(options.output, values, COMMENTS, 'Calibrated by end poses.')


def _or_not_known(deviation: float, form: str) -> str:
    return format(deviation, form) if deviation else 'not known'


def as_json(
    found: 'Calibration', judged: 'Sequence[FinalErrors]', values: Mapping[str, object],
) -> dict[str, object]:
    """Return what was found, and what the parameters make of it, for json.dumps."""
    def listed(array: Array) -> object:
        return array.tolist()

    return {
        'wheel_separation': found.drive.wheel_separation,
        'left_wheel_radius': found.drive.left_wheel_radius,
        'right_wheel_radius': found.drive.right_wheel_radius,
        'covariance': listed(found.covariance),
        'wheel_separation_std': values['wheel_separation_std'],
        'separation_spread': found.separation_spread,
        'unobservable': list(found.unobservable),
        'left_wheel_travel_variance': found.noise.left_travel,
        'right_wheel_travel_variance': found.noise.right_travel,
        'turn_variance': values['turn_variance'],
        'reference': {
            'position_std': found.position_std, 'heading_std': found.heading_std,
            'time_std': found.time_std, 'slow_position_std': found.slow_position_std,
            'slow_heading_std': found.slow_heading_std,
            'reference_std': list(found.reference_std), 'marker': listed(found.marker),
            'marker_std': listed(found.marker_std)},
        'drives': [
            {'name': each.name, 'time_offset': errors.clock_offset, 'left_out': each.outlier,
             'final_error_before': errors.before, 'final_error': errors.calibrated,
             'final_error_unseen': errors.cross_validated}
            for each, errors in zip(found.runs, judged, strict=True)],
    }


def main(arguments: Sequence[str] | None = None) -> None:
    """Calibrate as a process."""
    options = options_of(arguments)
    try:
        run(options)
    except (ValueError, OSError) as error:
        sys.exit(f'calibrate: {error}')
    except KeyboardInterrupt:
        sys.exit('calibrate: interrupted')


if __name__ == '__main__':
    main()
