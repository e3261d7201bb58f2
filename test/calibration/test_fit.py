"""The calibration recovers the true geometry of simulated runs, within its error bars."""
from dataclasses import replace

from checks.calibration_consistency import NOISE, NOMINAL, SHAPES, simulated_run, z_scores
from diffdrive_ros.calibration.fit import calibrate, estimate_clock_offset
from diffdrive_ros.calibration.model import Run, Terms
from diffdrive_ros.core import se2
from diffdrive_ros.core.kinematics import DiffDrive
from diffdrive_ros.core.odometry import integrate
from diffdrive_ros.core.validation import UserError
import numpy as np
import pytest
from support.calibration_runs import (
    geometry_of,
    MARKER,
    noiseless_run,
    noisy_runs,
    straight_run,
    TRUTH,
)


def test_calibrate_noiseless_runs_recovers_geometry_and_marker():
    found = calibrate(
        [noiseless_run(name) for name in ('square', 'eight', 'circle back')], NOMINAL)
    assert geometry_of(found.drive) == pytest.approx(geometry_of(TRUTH), rel=1e-4)
    assert found.marker == pytest.approx(MARKER, abs=1e-4)
    assert found.unobservable == ()


def test_calibrate_errors_with_noise_agree_with_their_std():
    found = calibrate(noisy_runs(names=tuple(SHAPES)), NOMINAL)
    errors = geometry_of(found.drive) - geometry_of(TRUTH)
    assert (np.abs(errors) < 3.0 * found.geometry_std).all()
    assert (found.geometry_std < [1e-3, 2e-4, 2e-4]).all()
    assert found.noise.left_travel == pytest.approx(NOISE.left_travel, rel=0.5)
    assert found.position_std == pytest.approx(1e-3, rel=0.3)
    assert found.heading_std == pytest.approx(4e-3, rel=0.3)


def test_calibrate_estimates_the_clock_offset_of_each_run():
    # On a circle at one speed, a clock offset is equivalent to another start.
    first = noisy_runs(names=('square', 'eight', 'there and back'))
    later = [
        replace(run, reference_seconds=run.reference_seconds + 0.1) for run in first]
    before, after = calibrate(first, NOMINAL), calibrate(later, NOMINAL)
    for old, new in zip(before.runs, after.runs, strict=True):
        assert new.clock_offset - old.clock_offset == pytest.approx(-0.1, abs=5e-3)
    assert geometry_of(after.drive) == pytest.approx(geometry_of(before.drive), rel=1e-3)


def test_calibrate_is_invariant_to_the_reference_frame():
    moved = [
        replace(run, reference=se2.compose([-7.0, 3.0, 2.5], run.reference))
        for run in noisy_runs()]
    first, second = (calibrate(runs, NOMINAL) for runs in (noisy_runs(), moved))
    assert geometry_of(second.drive) == pytest.approx(geometry_of(first.drive), rel=1e-5)


def test_calibrate_accepts_gaps_and_wrapped_headings():
    runs = noisy_runs()
    gappy = []
    for run in runs:
        keep = np.ones(len(run.reference), bool)
        keep[40:80] = keep[150:160] = False
        reference = run.reference[keep]
        reference[:, 2] = se2.wrap_angle(reference[:, 2])
        gappy.append(replace(
            run, reference=reference, reference_seconds=run.reference_seconds[keep]))
    whole, found = calibrate(runs, NOMINAL), calibrate(gappy, NOMINAL)
    differences = geometry_of(found.drive) - geometry_of(whole.drive)
    assert (np.abs(differences) < 2.0 * whole.geometry_std).all()


def test_calibrate_is_robust_to_glitches_of_the_reference():
    runs = noisy_runs()
    for run in runs:
        run.reference[::17] += [0.5, -0.3, 0.4]
    found = calibrate(runs, NOMINAL)
    errors = geometry_of(found.drive) - geometry_of(TRUTH)
    assert (np.abs(errors) < 4.0 * found.geometry_std).all()


def test_calibrate_noisy_lines_report_separation_unobservable():
    found = calibrate([straight_run(seed=seed) for seed in range(3)], NOMINAL)
    assert found.unobservable == (
        'wheel_separation, the noise of turns and the position of the marker: the runs turn too '
        'little',)
    assert found.noise.turn == 0.0
    assert found.marker[:2] == pytest.approx([0.0, 0.0], abs=1e-6)
    assert found.drive.wheel_separation == NOMINAL.wheel_separation
    assert found.geometry_std[0] == 0.0
    radii = geometry_of(found.drive)[1:]
    assert radii == pytest.approx(geometry_of(TRUTH)[1:], rel=2e-3)
    assert radii[1] / radii[0] == pytest.approx(0.0504 / 0.0497, rel=1e-3)


def test_calibrate_turns_on_the_spot_report_radii_unobservable():
    random = np.random.default_rng(2)
    angles = np.linspace(0.0, 40.0, 401)
    seconds = 0.05 * np.arange(401)
    runs = []
    for sign in (1.0, -1.0):
        left, right = -sign * angles, sign * angles * 0.0497 / 0.0504
        poses = integrate(TRUTH, left, right)
        noisy = poses + random.normal(size=poses.shape) * [1e-3, 1e-3, 4e-3]
        runs.append(Run('spin', seconds, left, right, seconds, noisy))
    found = calibrate(runs, replace(TRUTH, wheel_separation=0.29), Terms(marker=False))
    assert 'radii' in found.unobservable[0]
    assert found.drive.wheel_separation == pytest.approx(TRUTH.wheel_separation, rel=2e-3)


def test_calibrate_turns_with_unknown_marker_give_one_ratio():
    angles = np.linspace(0.0, 40.0, 401)
    seconds, random = 0.05 * np.arange(401), np.random.default_rng(2)
    runs = []
    for sign in (1.0, -1.0):
        poses = integrate(TRUTH, -sign * angles, sign * angles)
        noisy = poses + random.normal(size=poses.shape) * [1e-3, 1e-3, 4e-3]
        runs.append(Run('spin', seconds, -sign * angles, sign * angles, seconds, noisy))
    found = calibrate(runs, NOMINAL)
    assert found.unobservable[0].startswith('the wheel radii: ')
    assert geometry_of(found.drive)[1:] == pytest.approx([0.05, 0.05])
    assert found.geometry_std[1:].tolist() == [0.0, 0.0]
    ratio = 2.0 * TRUTH.wheel_separation / (TRUTH.left_wheel_radius + TRUTH.right_wheel_radius)
    assert found.drive.wheel_separation == pytest.approx(0.05 * ratio, rel=2e-3)


def test_calibrate_exact_line_keeps_the_nominal_separation():
    angles, seconds = np.linspace(0.0, 100.0, 401), 0.05 * np.arange(401)
    level = DiffDrive(0.30, 0.0501, 0.0501)
    random = np.random.default_rng(1)
    poses = integrate(level, angles, angles)
    noisy = poses + random.normal(size=poses.shape) * [1e-3, 1e-3, 4e-3]
    found = calibrate([Run('line', seconds, angles, angles, seconds, noisy)], NOMINAL)
    assert found.unobservable == (
        'wheel_separation, the noise of turns and the position of the marker: the runs turn too '
        'little',)
    assert found.noise.turn == 0.0
    assert found.marker[:2] == pytest.approx([0.0, 0.0], abs=1e-6)
    assert found.drive.wheel_separation == NOMINAL.wheel_separation
    assert geometry_of(found.drive)[1:] == pytest.approx([0.0501, 0.0501], rel=2e-3)


@pytest.mark.parametrize(('damage', 'rule'), [
    (lambda run: replace(run, left=run.right, right=run.left), 'mm: must be 0.5 to 2'),
    (lambda run: replace(run, left=-run.left), 'mm: must be 0.5 to 2'),
    (lambda run: replace(run, left=0.0 * run.left), 'mm: must be 0.5 to 2'),
    (lambda run: replace(run, reference_seconds=run.reference_seconds + 1.0),
     'clock_offset = '),
    (lambda run: replace(run, reference=0.0 * run.reference), 'mm: must be 0.5 to 2'),
])
def test_calibrate_implausible_result_is_rejected_with_causes(damage, rule):
    runs = [damage(run) for run in noisy_runs(names=('square', 'eight', 'square back'))]
    with pytest.raises(UserError, match=rule) as error:
        calibrate(runs, NOMINAL)
    assert 'are the sides swapped' in str(error.value)
    assert 'must be ' in str(error.value)
    assert '\n' not in str(error.value)


def test_separation_spread_widens_the_std_of_separation_only():
    random = np.random.default_rng(4)
    separations = TRUTH.wheel_separation * (1.0 + 0.011 * np.array([-1, 1, -1, 1, 1, -1]))
    found, plain = (
        calibrate([
            simulated_run(name, replace(TRUTH, wheel_separation=each), NOISE, MARKER, random)
            for name, each in zip(SHAPES, choice, strict=True)], NOMINAL, keep_all=True)
        for choice in (separations, np.full(6, TRUTH.wheel_separation)))
    assert found.separation_spread == pytest.approx(separations.std(), rel=0.4)
    assert plain.separation_spread < 0.1 * separations.std()
    assert found.geometry_std[0] == pytest.approx(found.separation_spread / 6**0.5, rel=0.3)
    assert abs(found.drive.wheel_separation - TRUTH.wheel_separation) < 3.0 * found.geometry_std[0]
    assert found.geometry_std[1:] == pytest.approx(plain.geometry_std[1:], rel=0.5)


def test_slow_reference_noise_is_separated_from_wheel_noise():
    runs, random = noisy_runs(names=tuple(SHAPES)), np.random.default_rng(8)
    for run in runs:
        steps = np.diff(run.reference_seconds, prepend=-np.inf)
        kept = np.exp(-steps / 2.0)
        off = np.zeros(3)
        for k, share in enumerate(kept):
            fresh = random.normal(size=3) * [4e-3, 4e-3, 8e-3]
            off = share * off + np.sqrt(1.0 - share**2) * fresh
            run.reference[k] += off
    found = calibrate(runs, NOMINAL, keep_all=True)
    assert found.slow_position_std == pytest.approx(4e-3, rel=0.4)
    assert found.slow_heading_std == pytest.approx(8e-3, rel=0.4)
    assert found.reference_std == pytest.approx((np.hypot(1e-3, 4e-3), np.hypot(4e-3, 8e-3)), 0.3)
    assert found.noise.left_travel == pytest.approx(NOISE.left_travel, rel=1.0)
    errors = geometry_of(found.drive) - geometry_of(TRUTH)
    assert (np.abs(errors) < 3.0 * found.geometry_std).all()


def test_calibrate_from_a_distant_nominal_geometry_converges():
    runs = noisy_runs(14, ('square', 'square back', 'circle', 'eight'))
    found = calibrate(runs, DiffDrive(0.2554, 0.0405, 0.0479))
    assert [run.outlier for run in found.runs] == [''] * 4
    errors = geometry_of(found.drive) - geometry_of(TRUTH)
    assert (np.abs(errors) < 3.5 * found.geometry_std).all()


def test_clock_offset_that_is_not_determined_is_rejected():
    runs = noisy_runs()
    found = calibrate(runs, NOMINAL)
    for index, run in enumerate(runs):
        assert estimate_clock_offset(run, found) == pytest.approx(
            found.runs[index].clock_offset, abs=0.02)
    first = runs[0].reference[:1]
    still = replace(runs[0], reference=np.repeat(first, len(runs[0].reference), axis=0))
    with pytest.raises(UserError, match='does not determine its clock offset'):
        estimate_clock_offset(still, found)


def test_calibrate_single_run_has_no_separation_spread():
    found = calibrate(noisy_runs(names=('eight',)), NOMINAL)
    assert found.separation_spread == 0.0
    assert found.uncertainty.wheel_separation >= 0.003 * found.drive.wheel_separation


def test_calibrate_rejects_no_runs_and_a_standing_robot():
    with pytest.raises(UserError, match='no runs'):
        calibrate([], NOMINAL)
    short = straight_run()
    tiny = replace(short, left=short.left * 1e-6, right=short.right * 1e-6)
    with pytest.raises(UserError, match='too short'):
        calibrate([tiny], NOMINAL)


@pytest.mark.parametrize('seed', [210, 288])
def test_calibrate_with_an_undetermined_clock_converges(seed):
    """On a circle, a clock offset is equivalent to another start."""
    assert np.abs(z_scores(seed)).max() < 3.0
