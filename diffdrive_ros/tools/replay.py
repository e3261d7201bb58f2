"""
Replay a log: odometry as the node publishes it, and its error against a reference.

The poses are written as TUM text, CSV or .mcap; the figures as a table and as JSON.
"""
import argparse
from collections.abc import Sequence
import json
from pathlib import Path

from diffdrive_ros.core.evaluation import ALIGNMENTS
from diffdrive_ros.core.odometry_config import OdometryConfig
from diffdrive_ros.core.replay import (
    compare,
    Comparison,
    comparison_start_ns,
    MAX_COMPARED,
    replay,
    ReplayedOdometry,
)
from diffdrive_ros.core.validation import UserError
from diffdrive_ros.tools import bags, csv_logs, logs, parameter_file, reports
from diffdrive_ros.tools.command_line import (
    add_log_options,
    add_node_option,
    add_output_options,
    check_outputs,
    number,
    path_ending,
    run_tool,
    topics_of,
)
from diffdrive_ros.tools.logs import Log
from diffdrive_ros.tools.parameter_file import RobotParameters

OUTPUTS = ('.tum', '.txt', '.csv', '.mcap')


def options_of(arguments: Sequence[str] | None) -> argparse.Namespace:
    """Return the options of the command line."""
    parser = argparse.ArgumentParser(prog='replay', description=__doc__.split('\n\n')[0])
    parser.add_argument('log', type=Path, help=logs.HELP)
    group = parser.add_argument_group('robot')
    group.add_argument(
        '--params-file', type=Path, required=True, metavar='FILE',
        help='parameter file of the node')
    group.add_argument(
        '--baseline-params', type=Path, metavar='FILE',
        help='parameter file to compare with, such as the one before a calibration')
    add_node_option(group)
    add_log_options(parser)
    group = parser.add_argument_group('comparison with the reference')
    group.add_argument(
        '--alignment', choices=ALIGNMENTS,
        help='of the frames: by the first pose (start, the default), by the whole path, or none')
    group.add_argument(
        '--reference-offset', type=number(-1e3, 1e3), nargs=3, metavar=('X', 'Y', 'THETA'),
        help='pose of the marker in the body frame [m, m, rad]')
    group.add_argument(
        '--clock-offset', type=number(-1e6, 1e6), metavar='SECONDS',
        help='added to the stamps of the reference [s], default: 0')
    group.add_argument(
        '--reference-std', type=number(0.0, 1e3), nargs=2, metavar=('POSITION', 'HEADING'),
        help='standard deviations of the reference, for the NEES [m, rad]')
    add_output_options(parser, json='figures').add_argument(
        '--output', type=path_ending(OUTPUTS), metavar='FILE',
        help='poses as .tum (or .txt) or .csv, or /odom of the node as .mcap')
    return parser.parse_args(arguments)


def run(options: argparse.Namespace) -> None:
    """Replay one log; raises UserError."""
    check_outputs(
        {'--output': options.output, '--json': options.json, '--plot': options.plot},
        (options.log, options.params_file, options.baseline_params), options.overwrite)
    robots = {'': parameter_file.read(options.params_file, options.node)}
    if options.baseline_params:
        baseline = parameter_file.read(options.baseline_params, options.node)
        robots = {'before': baseline, 'after': robots['']}
    replayed, comparisons = {}, {}
    for name, robot in robots.items():
        # Each file decodes the log by its own joints, directions and wraps.
        log = logs.read(options.log, robot.config.wheel_feedback(), topics_of(options))
        replayed[name], comparison = replay_log(log, robot.config, options)
        if comparison:
            comparisons[name] = comparison
    figures = {name: each.figures for name, each in comparisons.items()}
    last = replayed[name]
    content = reports.replay_json(
        str(options.log), last, figures, options.alignment or 'start')
    print(f'{options.log}: {content["poses"]} poses in {content["seconds"]:.1f} s')
    if figures:
        print(reports.replay_table(figures, options.alignment or 'start'))
    if options.output:
        write_poses(options.output, log, last, robot)
    if options.json:
        options.json.write_text(json.dumps(content, indent=2) + '\n', encoding='utf-8')
    if options.plot:
        from diffdrive_ros.tools import plots
        plots.draw_replay(options.plot, options.log.stem, log.samples, replayed, comparisons)


def replay_log(
    log: Log, config: OdometryConfig, options: argparse.Namespace,
) -> tuple[ReplayedOdometry, Comparison | None]:
    """Return odometry of a log, and its comparison if it has a reference; raises UserError."""
    interval = max(1, len(log.samples) // MAX_COMPARED)
    if log.reference is None:
        for option in ('alignment', 'reference_offset', 'clock_offset', 'reference_std'):
            if getattr(options, option) is not None:
                raise UserError(
                    f'--{option.replace("_", "-")}: does nothing without a reference')
        return replay(config, log.samples, interval), None
    alignment, clock_offset = options.alignment or 'start', options.clock_offset or 0.0
    reset_ns = comparison_start_ns(
        log.samples, log.reference, clock_offset) if alignment == 'start' else None
    replayed = replay(config, log.samples, interval, reset_ns)
    return replayed, compare(
        replayed, log.reference, alignment=alignment, clock_offset=clock_offset,
        marker=options.reference_offset, reference_std=tuple(options.reference_std or (0.0, 0.0)))


def write_poses(path: Path, log: Log, replayed: ReplayedOdometry, robot: RobotParameters) -> None:
    """Write the poses in the format of the suffix."""
    if path.suffix == '.mcap':
        bags.write_odometry(path, robot.config, log.samples)
    else:
        write = csv_logs.write_csv if path.suffix == '.csv' else csv_logs.write_tum
        write(path, replayed.stamps_ns.tolist(), replayed.poses)


def main(arguments: Sequence[str] | None = None) -> None:
    """Replay a log as a process."""
    options = options_of(arguments)
    run_tool('replay', lambda: run(options))


if __name__ == '__main__':
    main()
