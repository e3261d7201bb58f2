"""Reports of the tools: tables for people, dictionaries for json.dumps."""
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict
from typing import Any, TYPE_CHECKING

from diffdrive_ros.calibration.end_pose import EndPoseCalibration
from diffdrive_ros.calibration.model import Calibration, GEOMETRY_PARAMETERS
from diffdrive_ros.core.evaluation import Evaluation
from diffdrive_ros.core.kinematics import DiffDrive
from diffdrive_ros.core.replay import ReplayedOdometry
from diffdrive_ros.tools.parameter_file import RobotParameters
import numpy as np

if TYPE_CHECKING:  # replay does without scipy
    from diffdrive_ros.calibration.cross_validation import FinalErrors

# Headings of a reference that are noisier than this carry no information [rad].
UNUSABLE_HEADING_STD_RAD = 0.3

ALIGNMENT_LABELS = {'start': 'first pose', 'path': 'whole path', 'none': 'none'}


# Replay

def replay_table(columns: Mapping[str, Evaluation], alignment: str) -> str:
    """Return the figures as lines of text, one column per replay."""
    first, figures = next(iter(columns.values())), list(columns.values())
    rows = [
        ('alignment', [ALIGNMENT_LABELS[alignment]] * len(columns)),
        ('path length [m]', [f'{each.length:.3f}' for each in figures]),
        ('final position error [m]', [f'{each.final_position:.4f}' for each in figures]),
        ('final heading error [rad]', [f'{each.final_heading:.4f}' for each in figures]),
        ('ATE, rms position [m]', [f'{each.ate:.4f}' for each in figures]),
        ('heading error, rms [rad]', [f'{each.heading_rms:.4f}' for each in figures]),
        ('heading error, max [rad]', [f'{each.heading_worst:.4f}' for each in figures]),
    ]
    for index, part in enumerate(first.rpe):
        rows.append((
            f'RPE over {part.distance:g} m [m, rad]',
            [f'{each.rpe[index].position:.4f} {each.rpe[index].heading:.4f}'
             if index < len(each.rpe) else '-' for each in figures]))
    for name, key in (('NEES/3, final', 'nees_final'), ('NEES/3, mean', 'nees_mean')):
        if getattr(first, key) is not None:
            rows.append((name, [f'{getattr(each, key):.2f}' for each in figures]))
    lines = [f'{"":28}' + ''.join(f'{name:>16}' for name in columns)] if any(columns) else []
    lines += [f'{name:28}' + ''.join(f'{cell:>16}' for cell in cells) for name, cells in rows]
    return '\n'.join(lines)


def replay_json(
    log: str, replayed: ReplayedOdometry, columns: Mapping[str, Evaluation], alignment: str,
) -> dict[str, Any]:
    """Return the figures of each replay, by before and after, or figures if there is one."""
    return {
        'log': log, 'poses': len(replayed.stamps_ns),
        'seconds': float(replayed.stamps_ns[-1] - replayed.stamps_ns[0]) * 1e-9,
        'final_pose': replayed.poses[-1].tolist(), 'alignment': alignment if columns else None,
        **{name or 'figures': asdict(each) for name, each in columns.items()}}


# Calibration by runs

def calibration_summary(before: DiffDrive, found: Calibration) -> str:
    """Return the result of a calibration as lines of text."""
    from diffdrive_ros.calibration.covariance import MIN_VARIANCES

    def shown(value: float, floor: float) -> str:
        return f'{"< " if value < 1.01 * floor else ""}{value:.2g}'

    travel, turn = map(shown, (found.noise.left_travel, found.noise.turn), MIN_VARIANCES)
    spread = shown(  # its floor is relative
        1e3 * found.separation_spread,
        1e3 * found.drive.wheel_separation * MIN_VARIANCES[2]**0.5)
    position, heading, time, slow_position, slow_heading = (
        shown(1e3 * value, 1e3 * floor**0.5) for value, floor in zip(
            (found.position_std, found.heading_std, found.time_std, found.slow_position_std,
             found.slow_heading_std), MIN_VARIANCES[3:], strict=True))
    stds = found.geometry_std
    lines = [f'{"":24}{"before":>12}{"calibrated":>12}{"std":>12}']
    for index, name in enumerate(GEOMETRY_PARAMETERS):
        lines.append(
            f'{name + " [mm]":24}{1e3 * getattr(before, name):12.3f}'
            f'{1e3 * getattr(found.drive, name):12.3f}{or_unknown(1e3 * stds[index], ".3f"):>12}')
    lines += [f'unobservable: {name}; unchanged' for name in found.unobservable]
    if stds[0]:
        lines.append(
            'separation spread      '
            + (f'{spread} mm between runs' if found.separation_spread else 'unknown')
            + f'; wheel_separation_std {1e3 * found.uncertainty.wheel_separation:.2f} mm, for a '
            'new run')
    lines += [
        f'wheel noise            {travel} m^2/m of travel, '
        + (f'{turn} rad^2/rad of turn' if found.noise.turn else 'unknown for turns'),
        f'reference noise        {position} mm, {heading} mrad, {time} ms; over seconds '
        f'{slow_position} mm, {slow_heading} mrad',
        'reference offset       ' + ', '.join(
            f'{1e3 * value:.2f} ± {or_unknown(1e3 * std, ".2f")} {unit}'
            for value, std, unit in zip(
                found.marker, found.marker_std, ('mm', 'mm', 'mrad'), strict=True)),
        'options of replay      ' + ' '.join(replay_options(found.marker, found.reference_std)),
    ]
    if found.reference_std[1] > UNUSABLE_HEADING_STD_RAD:
        lines.append('reference headings do not fit: in degrees, or none?')
    lines += [f'outlier: {each.name}: {each.outlier}' for each in found.runs if each.outlier]
    return '\n'.join(lines)


def replay_options(offset: Iterable[float], reference_std: Iterable[float]) -> list[str]:
    """Return the options by which replay compares with a reference as calibrate does."""
    return ['--reference-offset', *(f'{each:.5f}' for each in offset),
            '--reference-std', *(f'{each:.5f}' for each in reference_std)]


def final_errors_table(errors: 'Sequence[FinalErrors]') -> str:
    """Return the final errors of each run as lines of text, and the medians without outliers."""
    def shown(value: float | None) -> str:
        return '-' if value is None else f'{value:.4f}'

    lines = [f'{"final error [m]":28}{"before":>10}{"calibrated":>12}{"cross-validated":>17}'
             f'{"--clock-offset [s]":>20}']
    for each in errors:
        lines.append(
            f'{each.name:28}{each.before:10.4f}{each.calibrated:12.4f}'
            f'{shown(each.cross_validated):>17}{shown(each.clock_offset):>20}')
    kept = [each for each in errors if not each.is_outlier]
    validated = [each.cross_validated for each in kept if each.cross_validated is not None]
    lines.append(
        f'{"median":28}{np.median([each.before for each in kept]):10.4f}'
        f'{np.median([each.calibrated for each in kept]):12.4f}'
        f'{shown(float(np.median(validated)) if validated else None):>17}')
    lines += [f'not cross-validated: {each.failure}' for each in errors if each.failure]
    return '\n'.join(lines)


def calibration_json(
    found: Calibration, errors: 'Sequence[FinalErrors]', after: RobotParameters,
) -> dict[str, Any]:
    """Return the result of a calibration, and the parameters that follow from it."""
    return {
        **{name: getattr(found.drive, name) for name in GEOMETRY_PARAMETERS},
        'covariance': found.covariance.tolist(),
        'wheel_separation_std': after.values['wheel_separation_std'],
        'separation_spread': found.separation_spread,
        'unobservable': list(found.unobservable),
        'left_wheel_travel_variance': found.noise.left_travel,
        'right_wheel_travel_variance': found.noise.right_travel,
        'turn_variance': after.values['turn_variance'],
        'reference': {
            'position_std': found.position_std, 'heading_std': found.heading_std,
            'time_std': found.time_std, 'slow_position_std': found.slow_position_std,
            'slow_heading_std': found.slow_heading_std,
            'reference_std': list(found.reference_std),
            'reference_offset': found.marker.tolist(),
            'reference_offset_std': found.marker_std.tolist()},
        'runs': [
            {'name': run.name, 'clock_offset': each.clock_offset, 'outlier': run.outlier,
             'final_error_before': each.before, 'final_error': each.calibrated,
             'final_error_cross_validated': each.cross_validated,
             'cross_validation_failure': each.failure}
            for run, each in zip(found.runs, errors, strict=True)],
    }


# Calibration by end poses

def end_pose_summary(found: EndPoseCalibration) -> str:
    """Return the result of a calibration by end poses as lines of text."""
    ratio_b, ratio_d = (or_unknown(std, '.5f') for std in found.ratio_std)
    lines = [f'E_b {found.separation_ratio:.5f} ± {ratio_b}, '
             f'E_d {found.diameter_ratio:.5f} ± {ratio_d}']
    for name, std in zip(GEOMETRY_PARAMETERS, 1e3 * found.geometry_std, strict=True):
        lines.append(
            f'{name:20} {1e3 * getattr(found.drive, name):9.3f} ± {or_unknown(std, ".3f")} mm')
    return '\n'.join(lines)


def or_unknown(std: float, form: str) -> str:
    """Return a standard deviation as text; 0 stands for an unknown one."""
    return format(std, form) if std else 'unknown'
