"""Recorded runs that the tests of the tools share."""
from dataclasses import replace

from checks.calibration_consistency import simulated_run
from diffdrive_ros.core.odometry import WheelNoise
import numpy as np
import pytest
from support.runs import NOISE, NOMINAL, OFFSET, tool, TRUTH, write_csv


@pytest.fixture(scope='module')
def runs(tmp_path_factory):
    """Return a folder with the logs of four runs, and with nominal.yaml."""
    folder = tmp_path_factory.mktemp('runs')
    random = np.random.default_rng(11)
    for name in ('square', 'circle back', 'eight', 'there and back'):
        run = simulated_run(name, TRUTH, NOISE, np.array(OFFSET), random)
        write_csv(folder / f'{name.replace(" ", "_")}.csv', run)
    (folder / 'nominal.yaml').write_text(NOMINAL)
    return folder


@pytest.fixture(scope='module')
def calibrated(runs):
    """Return the folder after a calibration by three runs."""
    done = tool(
        'calibrate', 'runs', runs / 'square.csv', runs / 'circle_back.csv', runs / 'eight.csv',
        '--params-file', runs / 'nominal.yaml', '--output', runs / 'robot.yaml', '--json',
        runs / 'found.json', '--plot', runs / 'page.png')
    assert done.returncode == 0, done.stderr
    assert 'wheel_separation [mm]' in done.stdout
    return runs


@pytest.fixture(scope='module')
def late_clocks(tmp_path_factory):
    """Return logs that end at full speed, the reference's clock 0.3 s late, and their folder."""
    folder, random = tmp_path_factory.mktemp('late'), np.random.default_rng(12)
    for name in ('square', 'eight', 'there and back'):
        run = simulated_run(
            name, TRUTH, WheelNoise(1e-8, 1e-8, 1e-7), np.array(OFFSET), random, 1e-3, 1e-3)
        late = replace(run, reference_seconds=run.reference_seconds + 0.3)
        write_csv(folder / f'{name.replace(" ", "_")}.csv', late)
    (folder / 'nominal.yaml').write_text(NOMINAL)
    return folder
