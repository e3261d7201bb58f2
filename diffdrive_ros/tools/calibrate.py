"""
Calibrate a robot: its geometry with standard deviations, as parameters of the node.

With a reference (motion capture, a map) any runs will do. Without one, umbmark takes the end poses
of squares driven both ways, and line-and-turn a straight line and a turn on the spot.
"""
import argparse
from collections.abc import Sequence
import json
import os
from pathlib import Path
from typing import TypeAlias

from diffdrive_ros.calibration import node_parameters
from diffdrive_ros.calibration.end_pose import EndPoseCalibration, line_and_turn, umbmark
from diffdrive_ros.calibration.model import check_geometry, Run, Terms
from diffdrive_ros.core.kinematics import DiffDrive
from diffdrive_ros.core.validation import UserError
from diffdrive_ros.tools import csv_logs, logs, parameter_file, reports
from diffdrive_ros.tools.bags import Topics
from diffdrive_ros.tools.command_line import (
    add_log_options,
    add_node_option,
    add_output_options,
    check_outputs,
    number,
    run_tool,
    topics_of,
)
from diffdrive_ros.tools.parameter_file import RobotParameters
from diffdrive_ros.tools.pool import limit_threads, map_on_cores

Methods: TypeAlias = 'argparse._SubParsersAction[argparse.ArgumentParser]'

OFFSETS = ('clock-offset', 'reference-offset')

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


# The command line

def options_of(arguments: Sequence[str] | None) -> argparse.Namespace:
    """Return the options of the command line."""
    parser = argparse.ArgumentParser(prog='calibrate', description=__doc__.split('\n\n')[0])
    methods = parser.add_subparsers(title='methods', metavar='METHOD', required=True)
    for add in (_add_runs, _add_umbmark, _add_line_and_turn):
        add(methods)
    return parser.parse_args(arguments)


def _add_runs(methods: Methods) -> None:
    parser = _add_method(
        methods, 'runs', 'logs of runs with a reference', json='result, with its covariance',
        run=calibrate_runs)
    parser.add_argument(
        'logs', type=Path, nargs='+', metavar='LOG', help=f'each a {logs.HELP}')
    add_log_options(parser)
    group = parser.add_argument_group('fit')
    group.add_argument(
        '--without', choices=OFFSETS, action='append', default=[],
        help='do not estimate the offset of the clocks, or the pose of the marker on the robot')
    group.add_argument(
        '--no-validation', action='store_true', help='do not cross-validate over the runs')


def _add_umbmark(methods: Methods) -> None:
    parser = _add_method(
        methods, 'umbmark', 'end poses of squares driven both ways (UMBmark)',
        run=calibrate_end_poses, solve=solve_umbmark)
    parser.add_argument(
        'ends', type=Path, metavar='CSV', help='direction,x,y a row: cw or ccw, measured end '
        'position minus that of odometry [m]')
    parser.add_argument(
        '--side', type=number(0.01, 1e3), required=True, help='length of the sides [m]')


def _add_line_and_turn(methods: Methods) -> None:
    parser = _add_method(
        methods, 'line-and-turn', 'a straight line and a turn on the spot',
        run=calibrate_end_poses, solve=solve_line_and_turn, ends=None)
    for name, text in (
            ('left', 'angle of the left wheel over the line [rad]'),
            ('right', 'angle of the right wheel over the line [rad]'),
            ('distance', 'end of the line, ahead [m]'),
            ('sideways', 'end of the line, to the left [m]'),
            ('turn_left', 'angle of the left wheel over the turn [rad]'),
            ('turn_right', 'angle of the right wheel over the turn [rad]'),
            ('heading', 'of the robot over the turn, counter-clockwise, whole turns counted '
             '[rad]')):
        parser.add_argument(name, type=float, metavar=name.upper(), help=text)


def _add_method(
    methods: Methods, name: str, text: str, json: str | None = None, **defaults: object,
) -> argparse.ArgumentParser:
    """Add a subcommand with the options that all have: the nominal robot, and outputs."""
    parser = methods.add_parser(name, help=text, description=f'Calibrate by {text}.')
    parser.set_defaults(**defaults)
    group = parser.add_argument_group('nominal robot')
    one = group.add_mutually_exclusive_group(required=True)
    one.add_argument('--params-file', type=Path, metavar='FILE', help='parameter file of the node')
    one.add_argument(
        '--geometry', type=number(1e-3, 1e2), nargs=2, metavar=('SEPARATION', 'RADIUS'),
        help='wheel_separation and wheel_radius [m], in place of a file')
    add_node_option(group)
    add_output_options(parser, json).add_argument(
        '--output', type=Path, metavar='FILE', help='parameter file for the node')
    return parser


# The methods

def calibrate_runs(options: argparse.Namespace) -> None:
    """Calibrate by logs of runs; raises UserError."""
    check_outputs(
        {'--output': options.output, '--json': options.json, '--plot': options.plot},
        (*options.logs, options.params_file), options.overwrite)
    _check_distinct(options.logs)
    from diffdrive_ros.calibration import cross_validation
    from diffdrive_ros.calibration.fit import calibrate
    from rich.console import Console

    limit_threads()
    robot = _nominal_robot(options)
    runs = map_on_cores(
        'Reading', _read_run, [(path, robot, topics_of(options)) for path in options.logs])
    terms = Terms(
        clock_offset='clock-offset' not in options.without,
        marker='reference-offset' not in options.without)
    before = robot.config
    with Console(stderr=True).status('Fitting'):
        found = calibrate(runs, before.drive, terms)
    print(reports.calibration_summary(before.drive, found))
    folds = [None] * len(runs) if len(runs) < 3 or options.no_validation else map_on_cores(
        'Cross-validation', cross_validation.calibrate_without,
        [(index, runs, before.drive, terms, found) for index in range(len(runs))])
    errors = [
        cross_validation.final_errors(index, run, before, terms, found, fold)
        for index, (run, fold) in enumerate(zip(runs, folds, strict=True))]
    print(reports.final_errors_table(errors))
    after = _with(robot, node_parameters.from_runs(found, before, robot.nominal))
    if options.output:
        kept = sum(not run.outlier for run in found.runs)
        _write(options.output, after, f'Calibrated by {kept} of {len(runs)} runs.')
    if options.json:
        content = reports.calibration_json(found, errors, after)
        options.json.write_text(json.dumps(content, indent=2) + '\n', encoding='utf-8')
    if options.plot:
        from diffdrive_ros.tools import plots
        comparisons = [
            {name: cross_validation.compare_run(run, config, found, each.clock_offset)
             for name, config in (('before', before), ('after', after.config))}
            for run, each in zip(runs, errors, strict=True)]
        plots.draw_calibration(options.plot, comparisons, found, errors)


def _check_distinct(paths: Sequence[Path]) -> None:
    """Raise UserError if a log is given twice: it would count as two runs that agree."""
    places = [os.path.realpath(path) for path in paths]
    for path, place in zip(paths, places, strict=True):
        if places.count(place) > 1:
            raise UserError(f'{path}: given more than once')


def _read_run(path: Path, robot: RobotParameters, topics: Topics) -> Run:
    """Return a log as a run of the calibration; raises UserError."""
    log = logs.read(path, robot.config.wheel_feedback(), topics)
    if log.reference is None:
        raise UserError(f'{path}: has no reference; ' + (
            'a CSV has it in the columns x,y,theta' if path.suffix == '.csv'
            else '--reference-topic names its topic'))
    stamps, left, right = log.wheels()
    return Run(
        path.stem, (stamps - stamps[0]) * 1e-9, left, right,
        (log.reference.stamps_ns - stamps[0]) * 1e-9, log.reference.poses)


def solve_umbmark(options: argparse.Namespace, nominal: DiffDrive) -> EndPoseCalibration:
    """Return the geometry by the end poses of squares; raises ValueError."""
    ends = csv_logs.read_end_errors(options.ends)
    return umbmark(ends['cw'], ends['ccw'], options.side, nominal)


def solve_line_and_turn(options: argparse.Namespace, nominal: DiffDrive) -> EndPoseCalibration:
    """Return the geometry by a straight line and a turn on the spot; raises ValueError."""
    return line_and_turn(
        (options.left, options.right), options.distance, options.sideways,
        (options.turn_left, options.turn_right), options.heading, nominal)


def calibrate_end_poses(options: argparse.Namespace) -> None:
    """Calibrate by end poses, as options.solve does; raises UserError."""
    check_outputs(
        {'--output': options.output}, (options.ends, options.params_file), options.overwrite)
    robot = _nominal_robot(options)
    try:
        found: EndPoseCalibration = options.solve(options, robot.config.drive)
    except ValueError as error:  # of a geometry that is none, too
        raise UserError(str(error)) from None
    check_geometry(
        found.drive, robot.config.drive, 'are angles in degrees, lengths in mm, signs reversed, '
        'or is the nominal geometry far off?')
    print(reports.end_pose_summary(found))
    if options.output:
        parameters = node_parameters.from_end_poses(found, robot.nominal)
        _write(options.output, _with(robot, parameters), 'Calibrated by end poses.')


def _with(robot: RobotParameters, parameters: dict[str, float]) -> RobotParameters:
    """Return a robot with calibrated parameters."""
    return RobotParameters.of(dict(robot.values) | parameters, robot.node)


def _nominal_robot(options: argparse.Namespace) -> RobotParameters:
    """Return the robot before the calibration; raises UserError."""
    if options.params_file:
        return parameter_file.read(options.params_file, options.node)
    separation, radius = options.geometry
    return RobotParameters.of({
        'left_wheel_names': ['left_wheel_joint'], 'right_wheel_names': ['right_wheel_joint'],
        'wheel_separation': separation, 'wheel_radius': radius})


def _write(path: Path, robot: RobotParameters, header: str) -> None:
    """Write the parameter file, with the command that starts the node with it."""
    name = robot.node.rpartition('/')[2]
    rename = f'-r __node:={name} ' * (name != parameter_file.NODE_NAMES[0])
    parameter_file.write(path, robot, COMMENTS, (
        f'{header} Start the node with it:\n'
        f'  ros2 run diffdrive_ros odometry --ros-args {rename}--params-file {path.name}'))


def main(arguments: Sequence[str] | None = None) -> None:
    """Calibrate as a process."""
    options = options_of(arguments)
    run_tool('calibrate', lambda: options.run(options))


if __name__ == '__main__':
    main()
