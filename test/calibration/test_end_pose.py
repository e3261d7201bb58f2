"""UMBmark, and a straight line with a turn, recover the true geometry."""
import math

from diffdrive_ros.calibration.end_pose import line_and_turn, square_angles, umbmark
from diffdrive_ros.core.kinematics import DiffDrive
from diffdrive_ros.core.odometry import integrate
import numpy as np
import pytest

NOMINAL = DiffDrive(0.340, 0.0507, 0.0507)
SIDE = 4.0


def robot(e_b, e_d, mean=0.0507):
    """Return a robot with these ratios; the mean radius is the nominal one."""
    left = 2.0 * mean / (1.0 + e_d)
    return DiffDrive(0.340 * e_b, left, 2.0 * mean - left)


def end_errors(truth, sign, count=1, noise=0.0, seed=1):
    """Return the true end positions of squares minus those of the nominal geometry, (count, 2)."""
    random = np.random.default_rng(seed)
    angles = square_angles(NOMINAL, SIDE, sign)
    error = (integrate(truth, *angles)[-1] - integrate(NOMINAL, *angles)[-1])[:2]
    return error + noise * random.normal(size=(count, 2))


@pytest.mark.parametrize('e_b', [0.98, 0.995, 1.0, 1.007, 1.03])
@pytest.mark.parametrize('e_d', [0.99, 0.997, 1.0, 1.002, 1.01])
def test_umbmark_recovers_both_ratios_to_one_percent(e_b, e_d):
    truth = robot(e_b, e_d)
    found = umbmark(end_errors(truth, -1.0), end_errors(truth, 1.0), SIDE, NOMINAL)
    assert found.separation_ratio - 1.0 == pytest.approx(e_b - 1.0, rel=0.01, abs=1e-9)
    assert found.diameter_ratio - 1.0 == pytest.approx(e_d - 1.0, rel=0.01, abs=1e-9)
    assert found.drive.left_wheel_radius + found.drive.right_wheel_radius == pytest.approx(
        2.0 * 0.0507)


# Borenstein and Feng's first order: a turn of 90 degrees is alpha too short, a leg bends left by
# beta. The four legs then end ahead of the start by -2 L alpha -/+ 2 L beta.
@pytest.mark.parametrize(('e_b', 'e_d', 'clockwise', 'counter_clockwise'), [
    (0.995, 1.0, 1, 1),
    (1.005, 1.0, -1, -1),
    (1.0, 1.0005, -1, 1),
    (1.0, 0.9995, 1, -1),
])
def test_umbmark_has_the_signs_of_both_errors(e_b, e_d, clockwise, counter_clockwise):
    truth = robot(e_b, e_d)
    ends = [end_errors(truth, sign)[0] for sign in (-1.0, 1.0)]
    assert [np.sign(end[0]) for end in ends] == [clockwise, counter_clockwise]
    alpha, beta = 0.5 * math.pi * (e_b - 1.0), SIDE * (e_d - 1.0) / 0.340
    assert ends[0][0] == pytest.approx(-2.0 * SIDE * (alpha + beta), rel=0.1)
    assert ends[1][0] == pytest.approx(-2.0 * SIDE * (alpha - beta), rel=0.1)
    found = umbmark([ends[0]], [ends[1]], SIDE, NOMINAL)
    assert np.sign(round(found.separation_ratio - 1.0, 9)) == np.sign(e_b - 1.0)
    assert np.sign(round(found.diameter_ratio - 1.0, 9)) == np.sign(e_d - 1.0)


def test_umbmark_z_scores_with_noise_are_standard_normal():
    truth, scores = robot(1.012, 1.004), []
    for seed in range(200):
        found = umbmark(
            end_errors(truth, -1.0, 8, 0.02, seed), end_errors(truth, 1.0, 8, 0.02, seed + 1000),
            SIDE, NOMINAL)
        scores.append([
            (found.separation_ratio - 1.012) / found.ratio_std[0],
            (found.diameter_ratio - 1.004) / found.ratio_std[1]])
    # Student's t of 7 and more degrees of freedom.
    assert np.std(scores, axis=0) == pytest.approx([1.1, 1.1], abs=0.2)
    assert np.abs(np.mean(scores, axis=0)).max() < 0.25


@pytest.mark.parametrize('counts', [(1, 1), (1, 5), (5, 1)])
def test_umbmark_single_square_has_unknown_std(counts):
    truth = robot(1.012, 1.004)
    found = umbmark(*(
        end_errors(truth, sign, count, 0.02)
        for sign, count in zip((-1.0, 1.0), counts, strict=True)), SIDE, NOMINAL)
    assert found.ratio_std == (0.0, 0.0)
    assert not found.covariance.any()


@pytest.mark.parametrize(('clockwise', 'side', 'rule'), [
    ([[0.1, 0.1]], 0.0, 'side = 0.0: must be positive'),
    ([[0.1, math.nan]], 4.0, 'must be finite'),
    ([0.1, 0.1], 4.0, r'clockwise has shape \(2,\)'),
    ([[50.0, 70.0]], 4.0, 'must be those of a square'),
])
def test_umbmark_rejects_end_positions_of_no_square(clockwise, side, rule):
    with pytest.raises(ValueError, match=rule):
        umbmark(clockwise, [[0.1, 0.1]], side, NOMINAL)


@pytest.mark.parametrize('turns', [1.0, -3.25])
def test_line_and_turn_gives_all_three_parameters(turns):
    truth = DiffDrive(0.3333, 0.0497, 0.0511)
    line = [100.0, 99.0]
    end = integrate(truth, [0.0, line[0]], [0.0, line[1]])[-1]
    speeds = [float(speed) for speed in truth.wheel_speeds(0.0, 2.0 * math.pi * turns)]
    found = line_and_turn(
        line, end[0], end[1], speeds, 2.0 * math.pi * turns, NOMINAL, (0.005, 0.01, 0.02))
    assert found.drive.wheel_separation == pytest.approx(truth.wheel_separation)
    assert found.drive.left_wheel_radius == pytest.approx(truth.left_wheel_radius)
    assert found.drive.right_wheel_radius == pytest.approx(truth.right_wheel_radius)
    assert (np.diag(found.covariance) > 0.0).all()
