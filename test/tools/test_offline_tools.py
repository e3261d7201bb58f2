"""The tools for logs, as processes on real files."""
from dataclasses import replace
import importlib.util
import json
import os
from pathlib import Path
import re
import signal
import subprocess
import sys
import time

from checks.calibration_consistency import simulated_run
from diffdrive_ros.calibration import fit, node_parameters
from diffdrive_ros.calibration.cross_validation import FinalErrors
from diffdrive_ros.calibration.end_pose import square_angles
from diffdrive_ros.calibration.model import Run
from diffdrive_ros.core.kinematics import DiffDrive
from diffdrive_ros.core.odometry import integrate, Odometry, WheelNoise
from diffdrive_ros.core.odometry_config import OdometryConfig
from diffdrive_ros.core.parameter_specs import ODOMETRY
from diffdrive_ros.tools import calibrate, example, logs, parameter_file, replay
from diffdrive_ros.tools.parameter_file import RobotParameters
import numpy as np
import pytest
from rosbags.rosbag2 import Reader
from support import bags
import yaml

TRUTH = DiffDrive(0.3021, 0.0497, 0.0504)
NOISE = WheelNoise(2e-6, 2e-6, 2e-5)
NOMINAL = """/**:
  ros__parameters:
    left_wheel_names: [left_wheel_joint]
    right_wheel_names: [right_wheel_joint]
    wheel_separation: 0.30
    wheel_radius: 0.05
    cmd_vel_timeout: 0.7
    linear:
      x:
        max_velocity: 0.8
"""


def tool(module, *arguments, **kwargs):
    """Run a tool to its end; return the process with what it said."""
    return subprocess.run(
        [sys.executable, '-m', f'diffdrive_ros.tools.{module}', *map(str, arguments)], text=True,
        capture_output=True, timeout=120, check=False, **kwargs)


def refused(module, *arguments):
    """Return the one line with which a tool refuses, with exit code 1."""
    done = tool(module, *arguments)
    assert done.returncode == 1, done.stderr
    lines = done.stderr.strip().splitlines()
    assert len(lines) == 1, done.stderr
    assert lines[0].startswith(f'{module}: ')
    return lines[0]


def write_csv(path, drive):
    """Write a simulated drive as a CSV, the reference between the wheels' rows."""
    rows = [(stamp + 100.0, f'{left:.9f},{right:.9f},,,') for stamp, left, right in zip(
        drive.seconds, drive.left, drive.right, strict=True)]
    rows += [(stamp + 100.0, ',,' + ','.join(f'{value:.9f}' for value in pose))
             for stamp, pose in zip(drive.reference_seconds, drive.reference, strict=True)]
    path.write_text('stamp,left,right,x,y,theta\n' + ''.join(
        f'{stamp:.9f},{rest}\n' for stamp, rest in sorted(rows)))
    return path


@pytest.fixture(scope='module')
def place(tmp_path_factory):
    """Return a folder with the logs of four drives, and with nominal.yaml."""
    folder = tmp_path_factory.mktemp('drives')
    random = np.random.default_rng(11)
    for name in ('square', 'circle back', 'eight', 'there and back'):
        drive = simulated_run(name, TRUTH, NOISE, np.array([0.02, 0.01, 0.05]), random)
        write_csv(folder / f'{name.replace(" ", "_")}.csv', drive)
    (folder / 'nominal.yaml').write_text(NOMINAL)
    return folder


@pytest.fixture(scope='module')
def calibrated(place):
    """Return the place after a calibration by three drives."""
    done = tool(
        'calibrate', place / 'square.csv', place / 'circle_back.csv', place / 'eight.csv',
        '--params', place / 'nominal.yaml', '--output', place / 'robot.yaml', '--json',
        place / 'found.json', '--plot', place / 'page.png')
    assert done.returncode == 0, done.stderr
    assert 'wheel_separation [mm]' in done.stdout
    return place


def test_the_parameter_file_of_a_calibration_is_one_that_the_node_takes(calibrated):
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
    # What the file said besides is still there.
    assert (values['cmd_vel_timeout'], values['linear.x.max_velocity']) == (0.7, 0.8)


@pytest.fixture(scope='module')
def late_clocks(tmp_path_factory):
    """Return logs that end at full speed, the reference's clock 0.3 s late, and their folder."""
    folder, random = tmp_path_factory.mktemp('late'), np.random.default_rng(12)
    for name in ('square', 'eight', 'there and back'):
        drive = simulated_run(
            name, TRUTH, WheelNoise(1e-8, 1e-8, 1e-7), np.array([0.02, 0.01, 0.05]), random, 1e-3,
            1e-3)
        late = replace(drive, reference_seconds=drive.reference_seconds + 0.3)
        write_csv(folder / f'{name.replace(" ", "_")}.csv', late)
    (folder / 'nominal.yaml').write_text(NOMINAL)
    return folder


def test_final_errors_are_taken_with_the_offset_of_the_clocks_that_was_found(late_clocks):
    done = tool('calibrate', *sorted(late_clocks.glob('*.csv')), '--params',
                late_clocks / 'nominal.yaml', '--json', late_clocks / 'found.json')
    assert done.returncode == 0, done.stderr
    for drive in json.loads((late_clocks / 'found.json').read_text())['drives']:
        # 0.3 s late at 0.4 m/s would be 0.12 m.
        assert drive['final_error'] < 0.05
        assert drive['final_error_unseen'] < 0.05
        assert drive['time_offset'] == pytest.approx(-0.3, abs=0.07)
        assert f'{drive["time_offset"]:.4f}' in done.stdout


def test_what_the_drives_do_not_tell_stays_as_the_file_has_it():
    robot = RobotParameters.of({
        'wheel_separation': 0.30, 'wheel_radius': 0.05, 'wheel_separation_multiplier': 1.01,
        'left_wheel_radius_multiplier': 0.994, 'right_wheel_radius_multiplier': 1.008,
        'wheel_separation_std': 0.0007})
    random = np.random.default_rng(3)
    angles, seconds = np.linspace(0.0, 100.0, 401), 0.05 * np.arange(401)
    left, right = angles * 1.008, angles * 0.994
    noisy = integrate(robot.config.drive, left, right) + 1e-3 * random.normal(size=(401, 3))
    found = fit.calibrate(
        [Run('line', seconds, left, right, seconds, noisy)], robot.config.drive)
    assert found.unobservable
    values = dict(robot.values) | node_parameters.from_runs(found, robot.config, robot.nominal)
    after = RobotParameters.of(values)
    assert after.config.drive.wheel_separation == pytest.approx(0.303)
    assert after.config.geometry_uncertainty.wheel_separation == 0.0007
    judged = [FinalErrors('line', None, 0.0, 0.0, None, is_outlier=False)]
    assert calibrate.as_json(found, judged, values)['wheel_separation_std'] == 0.0007


def test_noise_that_is_too_little_to_be_seen_is_printed_as_less_than_the_least(late_clocks):
    done = tool('calibrate', late_clocks / 'eight.csv', '--params', late_clocks / 'nominal.yaml')
    assert re.search(r'noise of the wheels +< 2.5e-08 m.2/m .*, < 2.5e-07 rad', done.stdout)


def test_headings_that_are_none_are_said_to_be_none(place):
    """In degrees, beside a drive that is right, they pass for noise."""
    rows = (place / 'square.csv').read_text().splitlines()
    for number, row in enumerate(rows[1:], 1):
        *others, theta = row.split(',')
        rows[number] = ','.join([*others, theta and f'{np.degrees(float(theta)):.9f}'])
    (place / 'degrees.csv').write_text('\n'.join(rows) + '\n')
    robot = parameter_file.read(place / 'nominal.yaml')
    drives = [calibrate.run_of(calibrate.read_log(
        place / name, robot, logs.Wanted('joint_states'))) for name in (
            'degrees.csv', 'eight.csv', 'circle_back.csv')]
    said = [calibrate.summary_of(robot, fit.calibrate(kept, robot.config.drive))
            for kept in (drives, drives[1:])]
    assert ['in degrees, or none?' in each for each in said] == [True, False]


def test_medians_are_of_the_drives_that_were_kept():
    judged = [FinalErrors(f'run{number}', 0.02, error, error, error, is_outlier=False)
              for number, error in enumerate([1.0, 2.0, 3.0])]
    judged.append(FinalErrors('run3', None, 9.0, 9.0, None, is_outlier=True))
    *_, left_out, medians = calibrate.judged_table(judged).splitlines()
    assert left_out.split() == ['run3', '9.0000', '9.0000', '-', '-']
    assert medians.split() == ['median', '2.0000', '2.0000', '2.0000']


def test_a_drive_not_seen_ends_nearer_with_the_calibration(calibrated):
    done = tool(
        'replay', calibrated / 'there_and_back.csv', '--params', calibrated / 'robot.yaml',
        '--before', calibrated / 'nominal.yaml', '--json', calibrated / 'after.json', '--plot',
        calibrated / 'replay.png', '--align', 'path')
    assert done.returncode == 0, done.stderr
    figures = json.loads((calibrated / 'after.json').read_text())
    assert figures['after']['ate'] < 0.3 * figures['before']['ate']
    for picture in ('page.png', 'replay.png'):
        assert (calibrated / picture).read_bytes().startswith(b'\x89PNG')


def test_frames_that_are_fitted_have_no_nees_and_the_table_says_how_they_were(place, capsys):
    replay.main([str(place / 'square.csv'), '--params', str(place / 'nominal.yaml')])
    said = capsys.readouterr().out
    assert re.search(r'frames brought together +by the first pose', said)
    assert 'NEES' in said
    replay.main([str(place / 'square.csv'), '--params', str(place / 'nominal.yaml'), '--align',
                 'path'])
    said = capsys.readouterr().out
    assert re.search(r'frames brought together +by the whole path', said)
    assert 'NEES' not in said


def test_ctrl_c_in_the_example_is_one_line(monkeypatch, tmp_path):
    def interrupted(folder):
        raise KeyboardInterrupt

    monkeypatch.setattr(example, 'run', interrupted)
    with pytest.raises(SystemExit, match='example: interrupted'):
        example.main(['--folder', str(tmp_path)])


def test_a_replay_is_what_odometry_says_of_the_same_messages(tmp_path):
    random = np.random.default_rng(4)
    angles = np.cumsum(random.uniform(-0.1, 0.3, size=(40, 2)), axis=0)
    names = ['right_wheel_joint', 'left_wheel_joint']
    stamps = [bags.START_NS + index * 20_000_000 for index in range(40)]
    messages = [('/joint_states', stamp, bags.joints(stamp, names, [right, left]))
                for stamp, (left, right) in zip(stamps, angles.tolist(), strict=True)]
    messages.insert(7, ('/joint_states', stamps[6], bags.joints(stamps[3], names, [9.0, 9.0])))
    messages.insert(9, ('/joint_states', stamps[8], bags.joints(stamps[8], names, [np.nan, 1.0])))
    folder = bags.write(tmp_path / 'drive', 'mcap', messages)
    (tmp_path / 'robot.yaml').write_text(NOMINAL)
    done = tool('replay', folder, '--params', tmp_path / 'robot.yaml', '--output',
                tmp_path / 'out.mcap')
    assert done.returncode == 0, done.stderr
    odometry = Odometry(DiffDrive(0.30, 0.05, 0.05))
    with Reader(tmp_path / 'out.mcap') as reader:
        written = [bags.STORE.deserialize_cdr(data, connection.msgtype)
                   for connection, _, data in reader.messages()]
    assert len(written) == 40
    for message, stamp, (left, right) in zip(written, stamps, angles.tolist(), strict=True):
        odometry.update(left, right, stamp)
        assert message.header.stamp.sec * 10**9 + message.header.stamp.nanosec == stamp
        assert message.pose.pose.position.x == pytest.approx(odometry.pose[0], abs=1e-12)
        assert message.pose.covariance[35] == pytest.approx(odometry.pose_covariance[2, 2])
        assert message.twist.twist.linear.x == pytest.approx(odometry.twist[0])
    done = tool('replay', folder, '--params', tmp_path / 'robot.yaml', '--output',
                tmp_path / 'out.tum')
    last = (tmp_path / 'out.tum').read_text().splitlines()[-1].split()
    assert float(last[1]) == pytest.approx(odometry.pose[0], abs=1e-8)
    assert last[0] == '1700000000.903456789'


ANY = ['square.csv', '--params', 'nominal.yaml']


@pytest.mark.parametrize(('arguments', 'rule'), [
    (['square.csv', '--params', 'nothing.yaml'], 'nothing.yaml: .*No such file'),
    (['square.csv', '--params', 'other.yaml'], 'no key that is the node /odometry, but /other_'),
    (['square.csv', '--params', 'nominal.yaml', '--output', 'new.doc'], 'new.doc: must end with'),
    (['square.csv', '--params', 'nominal.yaml', '--output', 'there.csv'], 'exists: --force'),
    (['late.csv', '--params', 'nominal.yaml'], 'does not overlap'),
    ([*ANY, '--output', 'a.csv', '--plot', 'a.jpg'], '--plot a.jpg: must end with .png, .pdf'),
    ([*ANY, '--output', 'a.csv', '--json', './a.csv'], 'a.csv is what --output writes, must be'),
    ([*ANY, '--output', 'square.csv', '--force'], '--output square.csv: square.csv is an input'),
    ([*ANY, '--json', 'nominal.yaml', '--force'], '--json nominal.yaml: nominal.yaml is an input'),
    ([*ANY, '--json', '.', '--force'], 'is a folder, must be a file'),
    ([*ANY, '--json', 'no/a.json'], '--json no/a.json: its folder does not exist'),
    ([*ANY, '--json', 'loop', '--force'], '--json loop: is a loop of links'),
    (['bag', *ANY[1:], '--output', 'bag/bag_0.mcap', '--force'], 'is in bag, an input, must be'),
    ([*ANY, '--time-offset', '1e300'], r'--time-offset 1e\+300: must be within 1e\+06'),
    ([*ANY, '--time-offset', 'nan'], '--time-offset nan: must be within'),
    ([*ANY, '--marker', '0', 'inf', '0'], '--marker inf: must be within'),
    ([*ANY, '--reference-std', '0.1', '-0.1'], '--reference-std -0.1: must be from 0'),
    (['bare.csv', *ANY[1:], '--time-offset', '0'], '--time-offset: does nothing without a ref'),
    (['bare.csv', *ANY[1:], '--align', 'start'], '--align: does nothing without a reference'),
])
def test_replay_refuses_in_one_line(place, monkeypatch, capsys, arguments, rule):
    monkeypatch.chdir(place)
    Path('other.yaml').write_text(NOMINAL.replace('/**:', '/other_node:'))
    Path('there.csv').write_text('mine')
    Path('loop').unlink(missing_ok=True)
    Path('loop').symlink_to('loop')
    Path('bag').mkdir(exist_ok=True)
    Path('bare.csv').write_text('stamp,left,right\n0,0,0\n1,1,1\n2,2,2\n')
    Path('late.csv').write_text(
        'stamp,left,right,x,y,theta\n0,0,0,,,\n1,1,1,,,\n900,,,0,0,0\n901,,,1,0,0\n')
    with pytest.raises(SystemExit, match=rule) as ended:
        replay.main(arguments)
    assert '\n' not in ended.value.code
    assert ended.value.code.startswith('replay: ')
    assert capsys.readouterr().out == ''
    assert not Path('a.csv').exists()
    assert Path('there.csv').read_text() == 'mine'


@pytest.mark.parametrize(('arguments', 'rule'), [
    ([], 'no logs; or --umbmark'),
    (['square.csv'], 'what is the robot nominally'),
    (['bare.csv', '--params', 'nominal.yaml'],
     'bare.csv: has no reference; a CSV has it in the columns x,y,theta'),
    (['late.csv', '--params', 'nominal.yaml'], 'from 900.000 to 901.000 s, does not overlap'),
    (['square.csv', '--params', 'nominal.yaml', '--output', 'other.yaml'], 'exists: --force'),
    ([*ANY, '--output', 'nominal.yaml', '--force'], 'nominal.yaml is an input, must be another'),
    ([*ANY, '--output', 'a.yaml', '--plot', 'a'], '--plot a: must end with .png'),
    (['./square.csv', *ANY], 'square.csv: is given twice'),
    ([*ANY, '--side', '4'], '--side: does nothing without --umbmark'),
    (['--umbmark', 'ends.csv', '--side', '4', *ANY[1:], '--json', 'a.json'], '--json: does noth'),
    (['--umbmark', 'ends.csv', '--side', '1e300', *ANY[1:]], '--side = 1e+300: must be from 0.01'),
    (['--umbmark', 'ends.csv', '--side', '4', *ANY[1:], '--plot', 'a.png'], '--plot: does noth'),
])
def test_calibrate_refuses_in_one_line(place, monkeypatch, arguments, rule):
    monkeypatch.chdir(place)
    Path('other.yaml').write_text(NOMINAL)
    Path('bare.csv').write_text('stamp,left,right\n0,0,0\n1,1,1\n2,2,2\n')
    Path('late.csv').write_text(
        'stamp,left,right,x,y,theta\n50,0,0,,,\n51,1,1,,,\n900,,,0,0,0\n901,,,1,0,0\n')
    assert rule in refused('calibrate', *arguments)
    assert Path('nominal.yaml').read_text() == NOMINAL


@pytest.mark.parametrize('module', [calibrate, replay])
def test_a_picture_without_matplotlib_is_refused_before_any_work(place, monkeypatch, module):
    monkeypatch.chdir(place)
    find = importlib.util.find_spec
    monkeypatch.setattr(
        importlib.util, 'find_spec', lambda name: None if name == 'matplotlib' else find(name))
    with pytest.raises(SystemExit, match='matplotlib is needed: pip install matplotlib'):
        module.main([*ANY, '--plot', 'new.png'])


def test_squares_and_a_ruler_will_do(tmp_path):
    (tmp_path / 'ends.csv').write_text(
        'direction,x,y\ncw,-0.10,0.02\ncw,-0.12,0.03\nccw,-0.05,0.01\nccw,-0.07,-0.01\n')
    done = tool('calibrate', '--umbmark', tmp_path / 'ends.csv', '--side', 4, '--separation', 0.34,
                '--radius', 0.05, '--output', tmp_path / 'robot.yaml')
    assert done.returncode == 0, done.stderr
    assert 'E_b 1.0' in done.stdout
    assert parameter_file.read(tmp_path / 'robot.yaml').config.drive.wheel_separation > 0.34


def ends_of(path, truth, before):
    """Write the ends of squares, as a robot with odometry of one geometry drives them."""
    random, rows = np.random.default_rng(6), ['direction,x,y']
    for way, sign in (('cw', -1.0), ('ccw', 1.0)):
        angles = square_angles(before, 4.0, sign)
        error = (integrate(truth, *angles)[-1] - integrate(before, *angles)[-1])[:2]
        rows += [f'{way},{x:.6f},{y:.6f}'
                 for x, y in error + 0.002 * random.normal(size=(5, 2))]
    path.write_text('\n'.join(rows) + '\n')


def test_a_second_pass_of_squares_goes_on_from_the_first(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    Path('0.yaml').write_text(NOMINAL)
    truth = DiffDrive(0.3051, 0.0496, 0.0504)
    for number in range(2):
        ends_of(Path('ends.csv'), truth, parameter_file.read(Path(f'{number}.yaml')).config.drive)
        calibrate.main([
            '--umbmark', 'ends.csv', '--side', '4', '--params', f'{number}.yaml', '--output',
            f'{number + 1}.yaml'])
        found = parameter_file.read(Path(f'{number + 1}.yaml')).config.drive
        assert found.wheel_separation == pytest.approx(truth.wheel_separation, rel=2e-3)
        assert found.right_wheel_radius == pytest.approx(truth.right_wheel_radius, rel=1e-3)
    # Squares do not tell how large the wheels are, whatever their ratio.
    said = capsys.readouterr().out
    assert re.search(r'left_wheel_radius .* not known mm', said)
    assert not re.search(r'wheel_separation .* not known mm', said)


def test_a_line_and_a_turn_have_no_error_bars_and_give_no_giant(capsys):
    line = ['--line-and-turn', '100', '99', '3.3', '0.1', '-150', '150', '60', '--radius', '0.033']
    calibrate.main([*line, '--separation', '0.16'])
    assert capsys.readouterr().out.count('not known') == 5
    with pytest.raises(
            SystemExit, match=r'wheel_separation = .* must be 0.5 to 2 times .* in degrees'):
        calibrate.main([*line, '--separation', '1.6'])
    with pytest.raises(SystemExit, match=r'--separation = 1e\+300: must be from 0.001 to 100 m'):
        calibrate.main([*line, '--separation', '1e300'])


def test_ctrl_c_while_logs_are_read_ends_with_1_and_writes_nothing(place, monkeypatch, tmp_path):
    def cut_short(what, function, tasks):
        yield 0, function(*tasks[0])

    monkeypatch.setattr(calibrate, 'on_all_cores', cut_short)
    with pytest.raises(SystemExit, match='calibrate: interrupted'):
        calibrate.main([
            str(place / 'square.csv'), str(place / 'eight.csv'), '--params',
            str(place / 'nominal.yaml'), '--output', str(tmp_path / 'robot.yaml')])
    assert not (tmp_path / 'robot.yaml').exists()


def test_ctrl_c_keeps_what_is_done(place):
    with subprocess.Popen(
            [sys.executable, '-c', INTERRUPTED], stdout=subprocess.PIPE, text=True,
            stderr=subprocess.PIPE, start_new_session=True,
            env=os.environ | {'PYTHONPATH': os.pathsep.join(sys.path)}) as process:
        assert process.stdout.readline() == 'done 0\n'
        process.send_signal(signal.SIGINT)
        said, errors = process.communicate(timeout=60)
    assert process.returncode == 0, errors
    assert said.splitlines()[-1] == 'kept 1'
    assert 'interrupted, 1 not done' in errors


def wait_for(seconds):
    """Take so long; for a process of its own."""
    time.sleep(seconds)
    return seconds


INTERRUPTED = """
from diffdrive_ros.tools.calibrate import on_all_cores
from test_offline_tools import wait_for
kept = []
for index, result in on_all_cores('Waiting', wait_for, [(0.0,), (5.0,)]):
    kept.append(result)
    print('done', index, flush=True)
print('kept', len(kept), flush=True)
"""
