"""The data of a calibration: runs are checked, the uncertainty covers other motions."""
from dataclasses import replace

from checks.calibration_consistency import NOMINAL
from diffdrive_ros.calibration.fit import calibrate
from diffdrive_ros.core.validation import UserError
import numpy as np
import pytest
from support.calibration_runs import noisy_runs, straight_run


def test_uncertainty_includes_the_least_separation_spread():
    found = calibrate(noisy_runs(), NOMINAL)
    uncertainty = found.uncertainty
    assert uncertainty.wheel_separation == pytest.approx(
        np.hypot(found.geometry_std[0], 0.003 * found.drive.wheel_separation))
    assert [uncertainty.left_wheel_radius, uncertainty.right_wheel_radius] == pytest.approx(
        found.geometry_std[1:])
    lines = calibrate([straight_run(seed=seed) for seed in range(3)], NOMINAL)
    assert lines.uncertainty.wheel_separation == lines.separation_spread == 0.0


@pytest.mark.parametrize(('change', 'rule'), [
    ({'reference_seconds': np.arange(401) * 0.05 + 1e9}, 'does not overlap'),
    ({'seconds': -np.arange(401.0)}, 'timestamps of the wheels: must increase'),
    ({'left': np.zeros(401), 'right': np.zeros(401)}, 'the wheels do not turn'),
    ({'reference_seconds': np.zeros(1), 'reference': np.zeros((1, 3))}, 'must be 2 or more'),
])
def test_run_without_information_is_rejected(change, rule):
    with pytest.raises(UserError, match=rule) as error:
        replace(straight_run('run 7'), **change)
    assert str(error.value).startswith('run 7: ')
    assert '\n' not in str(error.value)
