"""The shell that all tools share: groups of options, checks of paths, errors in one line."""
import argparse
from collections.abc import Callable, Mapping, Sequence
import importlib
import os
from pathlib import Path
import sys

from diffdrive_ros.core.validation import UserError
from diffdrive_ros.tools.bags import Topics

PICTURES = ('.png', '.pdf', '.svg')

# Packages that the tools need and the node does not, as pip names them.
EXTRAS = {'matplotlib': 'matplotlib', 'rich': 'rich', 'rosbags': 'rosbags', 'scipy': 'scipy',
          'yaml': 'pyyaml'}


def run_tool(name: str, tool: Callable[[], None]) -> None:
    """Run a tool as a process: an error of its input is one line and exit code 1."""
    try:
        tool()
    except (UserError, OSError) as error:
        sys.exit(f'{name}: {error}')
    except ModuleNotFoundError as error:
        if error.name not in EXTRAS:
            raise
        sys.exit(f'{name}: {error.name} is needed: pip install {EXTRAS[error.name]}')
    except KeyboardInterrupt:
        sys.exit(f'{name}: interrupted')


def number(least: float, most: float) -> Callable[[str], float]:
    """Return the type of an option that is a number within bounds."""
    def converted(text: str) -> float:
        try:
            value = float(text)
        except ValueError:
            value = float('nan')
        if not least <= value <= most:
            raise argparse.ArgumentTypeError(
                f'{text}: must be a number from {least:g} to {most:g}')
        return value

    return converted


def path_ending(suffixes: Sequence[str]) -> Callable[[str], Path]:
    """Return the type of an option that is a path with one of the suffixes."""
    def converted(text: str) -> Path:
        path = Path(text)
        if path.suffix not in suffixes:
            raise argparse.ArgumentTypeError(f'{text}: must end with {", ".join(suffixes)}')
        return path

    return converted


def add_node_option(group: argparse._ArgumentGroup) -> None:
    """Add the option that selects the node in a parameter file."""
    group.add_argument(
        '--node', help='full name of the node in the parameter file, such as /robot1/odometry, '
        'where the file has several')


def add_log_options(parser: argparse.ArgumentParser) -> None:
    """Add the options that select what is read of a bag."""
    group = parser.add_argument_group('topics of a bag')
    group.add_argument(
        '--joint-states-topic', metavar='TOPIC', default='joint_states',
        help='JointState: %(default)s')
    group.add_argument(
        '--reference-topic', metavar='TOPIC',
        help='Odometry, PoseStamped, PoseWithCovarianceStamped or TF')
    group.add_argument(
        '--reference-frame', metavar='FRAME',
        help='child frame of the reference, where its topic has several')


def add_output_options(
    parser: argparse.ArgumentParser, json: str | None = None,
) -> argparse._ArgumentGroup:
    """Add the options of what is written: with json, its content, also a page of plots."""
    group = parser.add_argument_group('outputs')
    if json is not None:
        group.add_argument('--json', type=Path, metavar='FILE', help=json)
        group.add_argument(
            '--plot', type=path_ending(PICTURES), metavar='FILE',
            help=f'page of plots, {", ".join(PICTURES)}')
    group.add_argument('--overwrite', action='store_true', help='replace files that exist')
    return group


def topics_of(options: argparse.Namespace) -> Topics:
    """Return what to read of a bag."""
    return Topics(
        options.joint_states_topic, options.reference_topic, options.reference_frame)


def check_outputs(
    outputs: Mapping[str, Path | None], inputs: Sequence[Path | None], overwrite: bool,
) -> None:
    """Raise UserError if an output, by its option, cannot be written or must not be."""
    sources = [Path(os.path.realpath(path)) for path in inputs if path is not None]
    options: dict[Path, str] = {}
    for option, path in outputs.items():
        if path is None:
            continue
        target = Path(os.path.realpath(path))
        if target.is_dir():
            raise UserError(f'{option} {path}: is a folder, must be a file')
        if not target.parent.is_dir():
            raise UserError(f'{option} {path}: its folder does not exist')
        if any(source in (target, *target.parents) for source in sources):
            raise UserError(f'{option} {path}: is an input or inside one, must be another file')
        if target in options:
            raise UserError(f'{option} {path}: must differ from {options[target]}')
        options[target] = option
        if target.exists() and not overwrite:
            raise UserError(f'{option} {path}: exists; --overwrite replaces it')
        if option == '--plot':
            importlib.import_module('matplotlib')  # fail before the work, not after it
