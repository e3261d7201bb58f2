"""Calibration finds the geometry that simulated drives were driven with, and knows how well."""
from dataclasses import replace

from checks.calibration_consistency import NOISE, NOMINAL, SHAPES, simulated_run, z_scores
from diffdrive_ros.calibration.fit import calibrate, estimate_clock_offset
from diffdrive_ros.calibration.model import Run, Terms
from diffdrive_ros.core import se2
from diffdrive_ros.core.kinematics import DiffDrive
from diffdrive_ros.core.odometry import integrate, WheelNoise
from diffdrive_ros.core.validation import UserError
import numpy as np
import pytest

TRUTH = DiffDrive(0.3021, 0.0497, 0.0504)
MARKER = np.array([0.031, -0.012, 1.4])
STILL = WheelNoise(0.0, 0.0, 0.0)


def geometry_of(drive):
    """Return the measures of a geometry, (3,)."""
    return np.array([drive.wheel_separation, drive.left_wheel_radius, drive.right_wheel_radius])


def exact_drive(name, marker=MARKER, seed=5):
    """Return a drive without any noise but for what cutting the truth finer brings."""
    random = np.random.default_rng(seed)
    return simulated_run(name, TRUTH, STILL, marker, random, 0.0, 0.0)


def noisy_drives(seed=3, names=('square', 'circle back', 'eight', 'there and back')):
    """Return drives with the noise of the wheels and of the capture."""
    random = np.random.default_rng(seed)
    return [simulated_run(name, TRUTH, NOISE, MARKER, random) for name in names]


def test_without_noise_geometry_and_marker_are_found_to_a_hundredth_of_a_percent():
    found = calibrate([exact_drive(name) for name in ('square', 'eight', 'circle back')], NOMINAL)
    assert geometry_of(found.drive) == pytest.approx(geometry_of(TRUTH), rel=1e-4)
    assert found.marker == pytest.approx(MARKER, abs=1e-4)
    assert found.unobservable == ()


def test_with_noise_the_errors_are_as_large_as_the_deviations_say():
    found = calibrate(noisy_drives(names=tuple(SHAPES)), NOMINAL)
    errors = geometry_of(found.drive) - geometry_of(TRUTH)
    assert (np.abs(errors) < 3.0 * found.geometry_std).all()
    assert (found.geometry_std < [1e-3, 2e-4, 2e-4]).all()
    assert found.noise.left_travel == pytest.approx(NOISE.left_travel, rel=0.5)
    assert found.position_std == pytest.approx(1e-3, rel=0.3)
    assert found.heading_std == pytest.approx(4e-3, rel=0.3)


def test_the_clock_of_the_reference_may_be_off():
    # On a circle, driven at one speed, an offset of the clock is but another start.
    first = noisy_drives(names=('square', 'eight', 'there and back'))
    later = [
        replace(drive, reference_seconds=drive.reference_seconds + 0.1) for drive in first]
    before, after = calibrate(first, NOMINAL), calibrate(later, NOMINAL)
    for old, new in zip(before.runs, after.runs, strict=True):
        assert new.clock_offset - old.clock_offset == pytest.approx(-0.1, abs=5e-3)
    assert geometry_of(after.drive) == pytest.approx(geometry_of(before.drive), rel=1e-3)


def test_the_frame_of_the_reference_does_not_matter():
    moved = [
        replace(drive, reference=se2.compose([-7.0, 3.0, 2.5], drive.reference))
        for drive in noisy_drives()]
    first, second = (calibrate(drives, NOMINAL) for drives in (noisy_drives(), moved))
    assert geometry_of(second.drive) == pytest.approx(geometry_of(first.drive), rel=1e-5)


def test_gaps_and_wrapped_headings_of_the_reference_do_not_matter():
    drives = noisy_drives()
    gappy = []
    for drive in drives:
        keep = np.ones(len(drive.reference), bool)
        keep[40:80] = keep[150:160] = False
        reference = drive.reference[keep]
        reference[:, 2] = se2.wrap_angle(reference[:, 2])
        gappy.append(replace(
            drive, reference=reference, reference_seconds=drive.reference_seconds[keep]))
    whole, found = calibrate(drives, NOMINAL), calibrate(gappy, NOMINAL)
    differences = geometry_of(found.drive) - geometry_of(whole.drive)
    assert (np.abs(differences) < 2.0 * whole.geometry_std).all()


def test_glitches_of_the_capture_do_not_count():
    drives = noisy_drives()
    for drive in drives:
        drive.reference[::17] += [0.5, -0.3, 0.4]
    found = calibrate(drives, NOMINAL)
    errors = geometry_of(found.drive) - geometry_of(TRUTH)
    assert (np.abs(errors) < 4.0 * found.geometry_std).all()


def straight(name='straight', drive=TRUTH, seed=1):
    """Return a drive along a straight line, with noise."""
    random = np.random.default_rng(seed)
    angles = np.linspace(0.0, 100.0, 401)
    left, right = angles / drive.left_wheel_radius * 0.05, angles / drive.right_wheel_radius * 0.05
    poses = integrate(drive, left, right, [1.0, 2.0, 0.5])
    noisy = poses + random.normal(size=poses.shape) * [1e-3, 1e-3, 4e-3]
    seconds = 0.05 * np.arange(401)
    return Run(name, seconds, left, right, seconds, noisy)


def test_a_straight_line_gives_the_radii_and_says_that_it_cannot_give_the_separation():
    found = calibrate([straight(seed=seed) for seed in range(3)], NOMINAL)
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


def test_turns_on_the_spot_give_the_separation_and_say_that_they_cannot_give_the_radii():
    random = np.random.default_rng(2)
    angles = np.linspace(0.0, 40.0, 401)
    seconds = 0.05 * np.arange(401)
    drives = []
    for sign in (1.0, -1.0):
        left, right = -sign * angles, sign * angles * 0.0497 / 0.0504
        poses = integrate(TRUTH, left, right)
        noisy = poses + random.normal(size=poses.shape) * [1e-3, 1e-3, 4e-3]
        drives.append(Run('spin', seconds, left, right, seconds, noisy))
    found = calibrate(drives, replace(TRUTH, wheel_separation=0.29), Terms(marker=False))
    assert 'radii' in found.unobservable[0]
    assert found.drive.wheel_separation == pytest.approx(TRUTH.wheel_separation, rel=2e-3)


def test_turns_on_the_spot_with_an_unknown_marker_tell_one_ratio_and_no_radius():
    angles = np.linspace(0.0, 40.0, 401)
    seconds, random = 0.05 * np.arange(401), np.random.default_rng(2)
    drives = []
    for sign in (1.0, -1.0):
        poses = integrate(TRUTH, -sign * angles, sign * angles)
        noisy = poses + random.normal(size=poses.shape) * [1e-3, 1e-3, 4e-3]
        drives.append(Run('spin', seconds, -sign * angles, sign * angles, seconds, noisy))
    found = calibrate(drives, NOMINAL)
    assert found.unobservable[0].startswith('the wheel radii: ')
    assert geometry_of(found.drive)[1:] == pytest.approx([0.05, 0.05])
    assert found.geometry_std[1:].tolist() == [0.0, 0.0]
    ratio = 2.0 * TRUTH.wheel_separation / (TRUTH.left_wheel_radius + TRUTH.right_wheel_radius)
    assert found.drive.wheel_separation == pytest.approx(0.05 * ratio, rel=2e-3)


def test_a_perfectly_straight_line_keeps_the_nominal_separation_and_says_so():
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
    (lambda drive: replace(drive, left=drive.right, right=drive.left), 'mm: must be 0.5 to 2'),
    (lambda drive: replace(drive, left=-drive.left), 'mm: must be 0.5 to 2'),
    (lambda drive: replace(drive, left=0.0 * drive.left), 'mm: must be 0.5 to 2'),
    (lambda drive: replace(drive, reference_seconds=drive.reference_seconds + 1.0),
     'clock_offset = '),
    (lambda drive: replace(drive, reference=0.0 * drive.reference), 'mm: must be 0.5 to 2'),
])
def test_what_cannot_be_the_robot_that_was_driven_is_refused_with_the_usual_causes(damage, rule):
    drives = [damage(drive) for drive in noisy_drives(names=('square', 'eight', 'square back'))]
    with pytest.raises(UserError, match=rule) as error:
        calibrate(drives, NOMINAL)
    assert 'are the sides swapped' in str(error.value)
    assert 'must be ' in str(error.value)
    assert '\n' not in str(error.value)


def test_a_separation_that_differs_from_drive_to_drive_widens_its_own_error_bar_only():
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


def test_a_drive_to_come_may_be_of_a_kind_that_these_were_not():
    found = calibrate(noisy_drives(), NOMINAL)
    unsure = found.uncertainty
    assert unsure.wheel_separation == pytest.approx(
        np.hypot(found.geometry_std[0], 0.003 * found.drive.wheel_separation))
    assert [unsure.left_wheel_radius, unsure.right_wheel_radius] == pytest.approx(
        found.geometry_std[1:])
    known_by_hand = calibrate([straight(seed=seed) for seed in range(3)], NOMINAL)
    assert known_by_hand.uncertainty.wheel_separation == known_by_hand.separation_spread == 0.0


def test_what_the_capture_is_off_by_for_seconds_is_not_taken_for_noise_of_the_wheels():
    drives, random = noisy_drives(names=tuple(SHAPES)), np.random.default_rng(8)
    for drive in drives:
        steps = np.diff(drive.reference_seconds, prepend=-np.inf)
        kept = np.exp(-steps / 2.0)
        off = np.zeros(3)
        for k, share in enumerate(kept):
            fresh = random.normal(size=3) * [4e-3, 4e-3, 8e-3]
            off = share * off + np.sqrt(1.0 - share**2) * fresh
            drive.reference[k] += off
    found = calibrate(drives, NOMINAL, keep_all=True)
    assert found.slow_position_std == pytest.approx(4e-3, rel=0.4)
    assert found.slow_heading_std == pytest.approx(8e-3, rel=0.4)
    assert found.reference_std == pytest.approx((np.hypot(1e-3, 4e-3), np.hypot(4e-3, 8e-3)), 0.3)
    assert found.noise.left_travel == pytest.approx(NOISE.left_travel, rel=1.0)
    errors = geometry_of(found.drive) - geometry_of(TRUTH)
    assert (np.abs(errors) < 3.0 * found.geometry_std).all()


def test_a_drive_that_slipped_is_named_and_left_out():
    drives = noisy_drives()
    slipped = drives[2]
    half = len(slipped.reference) // 2
    turned = se2.compose(slipped.reference[half], se2.compose(
        [0.05, 0.02, 0.4], se2.between(slipped.reference[half], slipped.reference[half:])))
    slipped.reference[half:] = turned
    found = calibrate(drives, NOMINAL)
    assert [drive.name for drive in found.runs if drive.outlier] == [slipped.name]
    errors = geometry_of(found.drive) - geometry_of(TRUTH)
    assert (np.abs(errors) < 3.5 * found.geometry_std).all()


@pytest.mark.parametrize('seed', [11, 12])
def test_drives_that_nothing_is_wrong_with_are_all_kept(seed):
    """Of circles, too, which at one speed tell neither the clock nor three of six measures."""
    found = calibrate(noisy_drives(seed, tuple(SHAPES)), NOMINAL)
    assert [drive.outlier for drive in found.runs] == [''] * len(SHAPES)


def test_the_only_drive_that_turns_is_not_left_out_for_telling_what_the_others_do_not():
    lines = [straight(f'line {seed}', seed=seed) for seed in range(4)]
    found = calibrate([*lines, *noisy_drives(names=('square',))], NOMINAL)
    assert [drive.outlier for drive in found.runs] == [''] * 5
    assert found.unobservable == ()
    errors = geometry_of(found.drive) - geometry_of(TRUTH)
    assert (np.abs(errors) < 3.5 * found.geometry_std).all()


@pytest.mark.parametrize('seed', [21, 22])
def test_a_drive_with_another_separation_is_named_and_does_not_hide_itself(seed):
    """By widening the spread from drive to drive that it is judged by."""
    random, names = np.random.default_rng(seed), ('square', 'square back', 'eight',
                                                  'there and back')
    wrong = replace(TRUTH, wheel_separation=1.06 * TRUTH.wheel_separation)
    found = calibrate([
        simulated_run(name, wrong if name == 'eight' else TRUTH, NOISE, MARKER, random)
        for name in names], NOMINAL)
    assert [drive.name for drive in found.runs if drive.outlier] == ['eight']
    assert abs(found.drive.wheel_separation - TRUTH.wheel_separation) < 3.0 * found.geometry_std[0]


def test_a_drive_of_another_kind_may_have_a_separation_that_is_a_little_different():
    """Which drives of one kind alone do not show."""
    random, quiet = np.random.default_rng(1), WheelNoise(5e-7, 5e-7, 5e-6)
    squares = replace(TRUTH, wheel_separation=0.99 * TRUTH.wheel_separation)
    found = calibrate([
        simulated_run(name, TRUTH if name == 'eight' else squares, quiet, MARKER, random)
        for name in (*2 * ('square', 'square back'), 'eight')], NOMINAL)
    assert [drive.outlier for drive in found.runs] == [''] * 5
    assert found.uncertainty.wheel_separation > 0.003 * TRUTH.wheel_separation


def test_a_nominal_geometry_that_is_far_off_spoils_neither_drives_nor_fit():
    drives = noisy_drives(14, ('square', 'square back', 'circle', 'eight'))
    found = calibrate(drives, DiffDrive(0.2554, 0.0405, 0.0479))
    assert [drive.outlier for drive in found.runs] == [''] * 4
    errors = geometry_of(found.drive) - geometry_of(TRUTH)
    assert (np.abs(errors) < 3.5 * found.geometry_std).all()


def test_the_offset_of_a_clock_that_a_drive_does_not_tell_is_none():
    drives = noisy_drives()
    found = calibrate(drives, NOMINAL)
    for index, drive in enumerate(drives):
        assert estimate_clock_offset(drive, found) == pytest.approx(
            found.runs[index].clock_offset, abs=0.02)
    first = drives[0].reference[:1]
    frozen = replace(drives[0], reference=np.repeat(first, len(drives[0].reference), axis=0))
    with pytest.raises(UserError, match='does not determine its clock offset'):
        estimate_clock_offset(frozen, found)


def test_a_drive_with_a_clock_of_another_day_is_named_and_does_not_spoil_the_others():
    drives = noisy_drives()
    drives[0] = replace(drives[0], reference_seconds=drives[0].reference_seconds + 3.0)
    found = calibrate(drives, NOMINAL)
    (left_out,) = [drive for drive in found.runs if drive.outlier]
    assert left_out.name == drives[0].name
    assert 'must be' in left_out.outlier
    errors = geometry_of(found.drive) - geometry_of(TRUTH)
    assert (np.abs(errors) < 3.5 * found.geometry_std).all()


def test_one_drive_cannot_tell_by_how_much_the_separation_differs():
    found = calibrate(noisy_drives(names=('eight',)), NOMINAL)
    assert found.separation_spread == 0.0
    assert found.uncertainty.wheel_separation >= 0.003 * found.drive.wheel_separation


@pytest.mark.parametrize(('change', 'rule'), [
    ({'reference_seconds': np.arange(401) * 0.05 + 1e9}, 'does not overlap'),
    ({'seconds': -np.arange(401.0)}, 'timestamps of the wheels: must increase'),
    ({'left': np.zeros(401), 'right': np.zeros(401)}, 'the wheels do not turn'),
    ({'reference_seconds': np.zeros(1), 'reference': np.zeros((1, 3))}, 'must be 2 or more'),
])
def test_a_log_that_tells_nothing_is_refused_in_one_line(change, rule):
    with pytest.raises(UserError, match=rule) as error:
        replace(straight('run 7'), **change)
    assert str(error.value).startswith('run 7: ')
    assert '\n' not in str(error.value)


def test_no_drive_and_a_standing_robot_are_refused():
    with pytest.raises(UserError, match='no runs'):
        calibrate([], NOMINAL)
    short = straight()
    tiny = replace(short, left=short.left * 1e-6, right=short.right * 1e-6)
    with pytest.raises(UserError, match='too short'):
        calibrate([tiny], NOMINAL)


@pytest.mark.parametrize('seed', [210, 288])
def test_a_circle_that_tells_no_clock_does_not_keep_the_fit_from_coming_to_rest(seed):
    """With an offset of the clock the robot may have started further on, or further back."""
    assert np.abs(z_scores(seed)).max() < 3.0
