"""Final errors of the runs, by a calibration and, as for a future run, by one without the run."""
from collections.abc import Sequence
from dataclasses import dataclass, replace

from diffdrive_ros.calibration.fit import calibrate, estimate_clock_offset
from diffdrive_ros.calibration.model import Calibration, Run, Terms
from diffdrive_ros.core.kinematics import DiffDrive
from diffdrive_ros.core.odometry_config import OdometryConfig
from diffdrive_ros.core.replay import compare, Comparison, comparison_start_ns, replay
from diffdrive_ros.core.validation import UserError

# Covariances of a replay, evenly over the run.
DETAILS = 500


@dataclass(frozen=True)
class FinalErrors:
    """Final position errors of a run [m]: before, calibrated, calibrated by all other runs."""

    name: str
    clock_offset: float | None
    """
    Offset of the wheels' clock from the reference's [s], as RunReport.clock_offset.

    None if an outlier does not determine it; its errors are without an offset then.
    """
    before: float
    calibrated: float
    cross_validated: float | None
    """None if there is no calibration without the run, or no clock offset by it."""
    is_outlier: bool
    failure: str = ''
    """Why there is no calibration without the run, where it failed."""


def calibrate_without(
    index: int, runs: Sequence[Run], nominal: DiffDrive, terms: Terms, calibration: Calibration,
) -> Calibration | str:
    """
    Return the calibration by all runs but the one with this index, and but the outliers.

    Of an outlier this is the given one. If there is none, return the name of the run and why.
    """
    if calibration.runs[index].outlier:
        return calibration
    others = [
        run for other, run in enumerate(runs)
        if other != index and not calibration.runs[other].outlier]
    try:
        return calibrate(others, nominal, terms, keep_all=True)
    except UserError as error:
        return f'{runs[index].name}: no calibration without this run: {error}'


def compare_run(
    run: Run, config: OdometryConfig, calibration: Calibration, clock_offset: float | None,
) -> Comparison:
    """Return the odometry of a run beside its reference, from the first pose on."""
    samples, reference, offset = run.samples(), run.trajectory(), clock_offset or 0.0
    replayed = replay(
        config, samples, max(1, len(samples) // DETAILS),
        comparison_start_ns(samples, reference, offset))
    return compare(
        replayed, reference, marker=calibration.marker, clock_offset=offset,
        reference_std=calibration.reference_std)


def final_errors(
    index: int, run: Run, config: OdometryConfig, terms: Terms, calibration: Calibration,
    fold: Calibration | str | None,
) -> FinalErrors:
    """
    Return the final errors of the run with this index, as the calibration counts them.

    config has the geometry before the calibration; fold is of calibrate_without.
    """
    def clock_offset(by: Calibration) -> float | None:
        try:
            return estimate_clock_offset(run, by) if terms.clock_offset else 0.0
        except UserError:
            return None

    def final_error(drive: DiffDrive, by: Calibration, offset: float | None) -> float:
        return compare_run(run, replace(config, drive=drive), by, offset).figures.final_position

    report = calibration.runs[index]
    own = clock_offset(calibration) if report.outlier else report.clock_offset
    cross_validated = None
    if isinstance(fold, Calibration) and (offset := clock_offset(fold)) is not None:
        cross_validated = final_error(fold.drive, fold, offset)
    return FinalErrors(
        run.name, own, final_error(config.drive, calibration, own),
        final_error(calibration.drive, calibration, own),
        cross_validated, bool(report.outlier), fold if isinstance(fold, str) else '')
