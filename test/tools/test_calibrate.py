"""Calibrate, on real files: the parameters that it writes, and the input that it rejects."""
import json
from pathlib import Path
import re
import subprocess
import sys

from diffdrive_ros.calibration.end_pose import square_angles
from diffdrive_ros.core.kinematics import DiffDrive
from diffdrive_ros.core.odometry import integrate
from diffdrive_ros.core.odometry_config import OdometryConfig
from diffdrive_ros.core.parameter_specs import ODOMETRY
from diffdrive_ros.tools import calibrate, parameter_file
import numpy as np
import pytest
from support.runs import NOMINAL, rejection, tool, TRUTH
import yaml

SQUARE = ['runs', 'square.csv', '--params-file', 'nominal.yaml']


def test_calibrated_parameter_file_is_one_of_the_node(calibrated):
    content = yaml.safe_load((calibrated / 'robot.yaml').read_text())
    values = parameter_file._flat(content['/**/odometry']['ros__parameters'])
    defaults = {spec.name: spec.default for spec in ODOMETRY}
    for spec in ODOMETRY:
        if spec.name in values:
            spec.check(values[spec.name])
    assert values.keys() <= defaults.keys()
    config = OdometryConfig.of(defaults | values)
    found = json.loads((calibrated / 'found.json').read_text())
    for name in ('wheel_separation', 'left_wheel_radius', 'right_wheel_radius'):
        assert getattr(config.drive, name) == pytest.approx(found[name])
        assert getattr(config.drive, name) == pytest.approx(getattr(TRUTH, name), rel=5e-3)
    assert config.geometry_uncertainty.wheel_separation > 0.0
    # The other parameters of the file are kept.
    assert (values['cmd_vel_timeout'], values['linear.x.max_velocity']) == (0.7, 0.8)


@pytest.mark.parametrize(('node', 'section', 'options'), [
    ('/robot1/odometry', '/**/odometry', ''),
    ('/diff_drive_controller', '/**/diff_drive_controller', '-r __node:=diff_drive_controller '),
])
def test_parameter_file_is_for_the_same_node(tmp_path, monkeypatch, node, section, options):
    monkeypatch.chdir(tmp_path)
    Path('robot.yaml').write_text(NOMINAL.replace('/**', node))
    calibrate.main(['line-and-turn', '100', '100', '5', '0.1', '-150', '150', '50',
                    '--params-file', 'robot.yaml', '--output', 'new.yaml'])
    text = Path('new.yaml').read_text()
    assert list(yaml.safe_load(text)) == [section]
    assert f'--ros-args {options}--params-file new.yaml' in text
    assert parameter_file.read(Path('new.yaml')).values['cmd_vel_timeout'] == 0.7


def test_clock_offset_is_estimated_and_used(late_clocks):
    done = tool('calibrate', 'runs', *sorted(late_clocks.glob('*.csv')), '--params-file',
                late_clocks / 'nominal.yaml', '--json', late_clocks / 'found.json')
    assert done.returncode == 0, done.stderr
    for run in json.loads((late_clocks / 'found.json').read_text())['runs']:
        # 0.3 s late at 0.4 m/s would be 0.12 m.
        assert run['final_error'] < 0.05
        assert run['final_error_cross_validated'] < 0.05
        assert run['clock_offset'] == pytest.approx(-0.3, abs=0.07)
        assert f'{run["clock_offset"]:.4f}' in done.stdout


def test_noise_at_its_lower_bound_is_reported_as_less(late_clocks):
    done = tool('calibrate', 'runs', late_clocks / 'eight.csv', '--params-file',
                late_clocks / 'nominal.yaml')
    assert re.search(r'wheel noise +< 2.5e-08 m.2/m .*, < 2.5e-07 rad', done.stdout)


@pytest.mark.parametrize(('arguments', 'rule'), [
    (['runs', 'bare.csv', '--params-file', 'nominal.yaml'],
     'bare.csv: has no reference; a CSV has it in the columns x,y,theta'),
    (['runs', 'late.csv', '--params-file', 'nominal.yaml'],
     'late: the reference, from 850.000 to 851.000 s, does not overlap'),
    ([*SQUARE, '--output', 'other.yaml'], 'exists; --overwrite'),
    ([*SQUARE, '--output', 'nominal.yaml', '--overwrite'], 'nominal.yaml: is an input'),
    (['runs', './square.csv', *SQUARE[1:]], 'square.csv: given more than once'),
    ([*SQUARE, '--node', 'r/x', '--params-file', 'other.yaml'],
     'other.yaml: has no section of the node /r/x, but /odometry'),
    (['umbmark', 'square.csv', '--side', '4', *SQUARE[2:]],
     'square.csv: the header is stamp,left,right,x,y,theta, must be direction,x,y'),
    (['umbmark', 'nothing.csv', '--side', '4', *SQUARE[2:]], 'No such file'),
])
def test_unusable_input_is_rejected_in_one_line(runs, monkeypatch, arguments, rule):
    monkeypatch.chdir(runs)
    Path('other.yaml').write_text(NOMINAL.replace('/**', 'odometry'))
    Path('bare.csv').write_text('stamp,left,right\n0,0,0\n1,1,1\n2,2,2\n')
    Path('late.csv').write_text(
        'stamp,left,right,x,y,theta\n50,0,0,,,\n51,1,1,,,\n900,,,0,0,0\n901,,,1,0,0\n')
    assert rule in rejection('calibrate', *arguments)
    assert Path('nominal.yaml').read_text() == NOMINAL


@pytest.mark.parametrize(('arguments', 'rule'), [
    ([], 'the following arguments are required: METHOD'),
    (['runs', '--params-file', 'nominal.yaml'], 'arguments are required: LOG'),
    (['runs', 'square.csv'], 'one of the arguments --params-file --geometry is required'),
    ([*SQUARE, '--geometry', '0.3', '0.05'], 'not allowed with argument --params-file'),
    ([*SQUARE, '--side', '4'], 'unrecognized arguments: --side 4'),
    ([*SQUARE, '--output', 'a.yaml', '--plot', 'a'], '--plot: a: must end with .png'),
    (['runs', 'square.csv', '--geometry', '1e300', '1'], '1e300: must be a number from 0.001 to'),
    (['umbmark', 'ends.csv', '--side', '4', *SQUARE[2:], '--json', 'a'], 'unrecognized arguments'),
    (['umbmark', 'ends.csv', '--side', '1e300', *SQUARE[2:]], 'must be a number from 0.01 to'),
    (['umbmark', 'ends.csv', *SQUARE[2:]], 'arguments are required: --side'),
    (['line-and-turn', '1', '1', '1', '0', '1', '1', 'x', *SQUARE[2:]], "'x'"),
])
def test_wrong_options_are_rejected_with_the_usage(capsys, arguments, rule):
    with pytest.raises(SystemExit, match='2'):
        calibrate.main(arguments)
    assert rule in capsys.readouterr().err


def test_missing_scipy_is_named(runs):
    code = (f'import sys; sys.modules["scipy"] = None; from diffdrive_ros.tools import calibrate; '
            f'calibrate.main({SQUARE})')
    done = subprocess.run(
        [sys.executable, '-c', code], cwd=runs, text=True, capture_output=True, timeout=60,
        check=False)
    assert (done.returncode, done.stderr) == (
        1, 'calibrate: scipy is needed: pip install scipy\n')


def test_ctrl_c_while_logs_are_read_writes_nothing(runs, monkeypatch, tmp_path):
    def interrupted(label, function, tasks):
        raise KeyboardInterrupt

    monkeypatch.setattr(calibrate, 'map_on_cores', interrupted)
    with pytest.raises(SystemExit, match='calibrate: interrupted'):
        calibrate.main([
            'runs', str(runs / 'square.csv'), str(runs / 'eight.csv'), '--params-file',
            str(runs / 'nominal.yaml'), '--output', str(tmp_path / 'robot.yaml')])
    assert not (tmp_path / 'robot.yaml').exists()


# By end poses

def test_umbmark_calibrates_by_end_poses(tmp_path):
    (tmp_path / 'ends.csv').write_text(
        'direction,x,y\ncw,-0.10,0.02\ncw,-0.12,0.03\nccw,-0.05,0.01\nccw,-0.07,-0.01\n')
    done = tool('calibrate', 'umbmark', tmp_path / 'ends.csv', '--side', 4, '--geometry', 0.34,
                0.05, '--output', tmp_path / 'robot.yaml')
    assert done.returncode == 0, done.stderr
    assert 'E_b 1.0' in done.stdout
    assert parameter_file.read(tmp_path / 'robot.yaml').config.drive.wheel_separation > 0.34


def write_ends(path, truth, before):
    """Write the end errors of squares, as a robot with odometry of one geometry drives them."""
    random, rows = np.random.default_rng(6), ['direction,x,y']
    for way, sign in (('cw', -1.0), ('ccw', 1.0)):
        angles = square_angles(before, 4.0, sign)
        error = (integrate(truth, *angles)[-1] - integrate(before, *angles)[-1])[:2]
        rows += [f'{way},{x:.6f},{y:.6f}'
                 for x, y in error + 0.002 * random.normal(size=(5, 2))]
    path.write_text('\n'.join(rows) + '\n')


def test_second_umbmark_continues_from_the_first(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    Path('0.yaml').write_text(NOMINAL)
    truth = DiffDrive(0.3051, 0.0496, 0.0504)
    for number in range(2):
        write_ends(
            Path('ends.csv'), truth, parameter_file.read(Path(f'{number}.yaml')).config.drive)
        calibrate.main([
            'umbmark', 'ends.csv', '--side', '4', '--params-file', f'{number}.yaml', '--output',
            f'{number + 1}.yaml'])
        found = parameter_file.read(Path(f'{number + 1}.yaml')).config.drive
        assert found.wheel_separation == pytest.approx(truth.wheel_separation, rel=2e-3)
        assert found.right_wheel_radius == pytest.approx(truth.right_wheel_radius, rel=1e-3)
    # Squares do not determine the mean radius, whatever the ratio.
    printed = capsys.readouterr().out
    assert re.search(r'left_wheel_radius .* unknown mm', printed)
    assert not re.search(r'wheel_separation .* unknown mm', printed)


def test_line_and_turn_has_no_std_and_rejects_implausible(capsys):
    line = ['line-and-turn', '100', '99', '3.3', '0.1', '-150', '150', '60', '--geometry']
    calibrate.main([*line, '0.16', '0.033'])
    assert capsys.readouterr().out.count('unknown') == 5
    with pytest.raises(
            SystemExit, match=r'wheel_separation = .* must be 0.5 to 2 times .* in degrees'):
        calibrate.main([*line, '1.6', '0.033'])
    line[1:3] = ['0', '0']
    with pytest.raises(SystemExit, match='line, turn: must determine the geometry'):
        calibrate.main([*line, '0.16', '0.033'])
