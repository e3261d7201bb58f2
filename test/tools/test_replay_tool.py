"""Replay, on real files: poses, figures and plots, and the input that it rejects."""
import json
from pathlib import Path
import re
import sys

from diffdrive_ros.core.kinematics import DiffDrive
from diffdrive_ros.core.odometry import Odometry
from diffdrive_ros.tools import replay
import numpy as np
import pytest
from rosbags.rosbag2 import Reader
from support import bags
from support.runs import NOMINAL, tool

ANY = ['square.csv', '--params-file', 'nominal.yaml']


def test_unseen_run_has_a_smaller_error_once_calibrated(calibrated):
    done = tool(
        'replay', calibrated / 'there_and_back.csv', '--params-file', calibrated / 'robot.yaml',
        '--baseline-params', calibrated / 'nominal.yaml', '--json', calibrated / 'after.json',
        '--plot', calibrated / 'replay.png', '--alignment', 'path')
    assert done.returncode == 0, done.stderr
    figures = json.loads((calibrated / 'after.json').read_text())
    assert figures['after']['ate'] < 0.3 * figures['before']['ate']
    assert figures['alignment'] == 'path'
    for picture in ('page.png', 'replay.png'):
        assert (calibrated / picture).read_bytes().startswith(b'\x89PNG')


def test_alignment_is_in_the_table_and_path_has_no_nees(runs, capsys):
    arguments = [str(runs / 'square.csv'), '--params-file', str(runs / 'nominal.yaml')]
    replay.main(arguments)
    printed = capsys.readouterr().out
    assert re.search(r'alignment +first pose', printed)
    assert 'NEES' in printed
    replay.main([*arguments, '--alignment', 'path'])
    printed = capsys.readouterr().out
    assert re.search(r'alignment +whole path', printed)
    assert 'NEES' not in printed


def messages_of(path):
    """Return the messages of an .mcap."""
    with Reader(path) as reader:
        return [bags.STORE.deserialize_cdr(data, connection.msgtype)
                for connection, _, data in reader.messages()]


def test_output_is_odometry_of_the_usable_messages(tmp_path):
    random = np.random.default_rng(4)
    angles = np.cumsum(random.uniform(-0.1, 0.3, size=(40, 2)), axis=0)
    names = ['right_wheel_joint', 'left_wheel_joint']
    stamps = [bags.START_NS + index * 20_000_000 for index in range(40)]
    messages = [('/joint_states', stamp, bags.joints(stamp, names, [right, left]))
                for stamp, (left, right) in zip(stamps, angles.tolist(), strict=True)]
    messages.insert(7, ('/joint_states', stamps[6], bags.joints(stamps[3], names, [9.0, 9.0])))
    messages.insert(9, ('/joint_states', stamps[8], bags.joints(stamps[8], names, [np.nan, 1.0])))
    folder = bags.write(tmp_path / 'run', 'mcap', messages)
    (tmp_path / 'robot.yaml').write_text(NOMINAL)
    done = tool('replay', folder, '--params-file', tmp_path / 'robot.yaml', '--output',
                tmp_path / 'out.mcap')
    assert done.returncode == 0, done.stderr
    odometry = Odometry(DiffDrive(0.30, 0.05, 0.05))
    written = messages_of(tmp_path / 'out.mcap')
    assert len(written) == 40
    for message, stamp, (left, right) in zip(written, stamps, angles.tolist(), strict=True):
        odometry.update(left, right, stamp)
        assert message.header.stamp.sec * 10**9 + message.header.stamp.nanosec == stamp
        assert message.pose.pose.position.x == pytest.approx(odometry.pose[0], abs=1e-12)
        assert message.pose.covariance[35] == pytest.approx(odometry.pose_covariance[2, 2])
        assert message.twist.twist.linear.x == pytest.approx(odometry.twist[0])
    done = tool('replay', folder, '--params-file', tmp_path / 'robot.yaml', '--output',
                tmp_path / 'out.tum')
    last = (tmp_path / 'out.tum').read_text().splitlines()[-1].split()
    assert float(last[1]) == pytest.approx(odometry.pose[0], abs=1e-8)
    assert last[0] == '1700000000.903456789'


def test_baseline_decodes_the_log_by_its_own_file(tmp_path, monkeypatch):
    """The joints of one file are reversed and wrap, those of the other are other joints."""
    monkeypatch.chdir(tmp_path)
    messages = []
    for index in range(50):
        stamp, angle = bags.START_NS + index * 20_000_000, 0.2 * index
        messages.append(('/joint_states', stamp, bags.joints(
            stamp, ['left_wheel_joint', 'right_wheel_joint', 'l', 'r'],
            [angle, angle, -angle % 6.0, -angle % 6.0])))
        messages.append(('/mocap', stamp, bags.reference(
            'geometry_msgs/msg/PoseStamped', stamp, (0.05 * angle, 0.0, 0.0))))
    bags.write(tmp_path / 'run', 'mcap', messages)
    Path('robot.yaml').write_text(NOMINAL)
    Path('raw.yaml').write_text(
        NOMINAL.replace('left_wheel_joint', 'l').replace('right_wheel_joint', 'r')
        + '    encoder_wrap: 6.0\n    left_wheel_direction: -1\n    right_wheel_direction: -1\n')
    replay.main(['run', '--params-file', 'robot.yaml', '--baseline-params', 'raw.yaml',
                 '--reference-topic', 'mocap', '--json', 'figures.json'])
    figures = json.loads(Path('figures.json').read_text())
    for name in ('before', 'after'):
        assert figures[name]['length'] == pytest.approx(0.05 * 0.2 * 49)
        assert figures[name]['ate'] == pytest.approx(0.0, abs=1e-9)


@pytest.mark.parametrize(('arguments', 'rule'), [
    (['square.csv', '--params-file', 'nothing.yaml'], 'No such file .*nothing.yaml'),
    (['square.csv', '--params-file', 'other.yaml'],
     'other.yaml: has no section of the node /odometry or .*, but /other_node'),
    (['square.csv', '--params-file', 'two.yaml'],
     'two.yaml: has the nodes /a/odometry, /b/odometry: --node must name one of them'),
    ([*ANY, '--output', 'there.csv'], '--output there.csv: exists; --overwrite replaces it'),
    (['late.csv', *ANY[1:]], 'does not overlap'),
    ([*ANY, '--output', 'a.csv', '--json', './a.csv'], '--json a.csv: must differ from --output'),
    ([*ANY, '--output', 'square.csv', '--overwrite'], '--output square.csv: is an input'),
    ([*ANY, '--json', 'nominal.yaml', '--overwrite'], '--json nominal.yaml: is an input'),
    ([*ANY, '--json', '.', '--overwrite'], 'is a folder, must be a file'),
    ([*ANY, '--json', 'no/a.json'], '--json no/a.json: its folder does not exist'),
    (['bag', *ANY[1:], '--output', 'bag/bag_0.mcap', '--overwrite'], 'is an input or inside one'),
    (['bare.csv', *ANY[1:], '--clock-offset', '0'], '--clock-offset: does nothing without a ref'),
    (['bare.csv', *ANY[1:], '--alignment', 'start'], '--alignment: does nothing without a ref'),
    (['nan.csv', *ANY[1:]], 'nan.csv, line 3: .*: must be finite numbers'),
    (['bare.csv', '--params-file', 'large.yaml'], 'wheels at 1.000 s: .*for a finite covariance'),
])
def test_unusable_input_is_rejected_in_one_line(runs, monkeypatch, capsys, arguments, rule):
    monkeypatch.chdir(runs)
    Path('other.yaml').write_text(NOMINAL.replace('/**:', '/other_node:'))
    Path('two.yaml').write_text(''.join(NOMINAL.replace('/**:', f'/{name}/odometry:')
                                        for name in 'ab'))
    Path('large.yaml').write_text(NOMINAL + '    turn_variance: 1.0e308\n'
                                  '    left_wheel_travel_variance: 1.0e308\n')
    Path('there.csv').write_text('mine')
    Path('bag').mkdir(exist_ok=True)
    Path('bare.csv').write_text('stamp,left,right\n0,0,0\n1,100,1\n2,200,2\n')
    Path('nan.csv').write_text('stamp,left,right\n0,0,0\n1,nan,1\n')
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
    ([*ANY, '--output', 'new.doc'], 'new.doc: must end with .tum, .txt, .csv, .mcap'),
    ([*ANY, '--plot', 'a.jpg'], '--plot: a.jpg: must end with .png, .pdf'),
    ([*ANY, '--clock-offset', '1e300'], r'--clock-offset: 1e\+?300: must be a number from'),
    ([*ANY, '--clock-offset', 'nan'], '--clock-offset: nan: must be a number from'),
    ([*ANY, '--reference-offset', '0', 'inf', '0'], '--reference-offset: inf: must be a number'),
    ([*ANY, '--reference-std', '0.1', '-0.1'], '--reference-std: -0.1: must be a number from 0'),
    ([*ANY, '--reference-std', '0.1', 'x'], '--reference-std: x: must be a number from 0 to 1000'),
    (['square.csv'], 'arguments are required: --params-file'),
])
def test_wrong_options_are_rejected_with_the_usage(capsys, arguments, rule):
    with pytest.raises(SystemExit, match='2'):
        replay.main(arguments)
    assert re.search(rule, capsys.readouterr().err)


def test_missing_matplotlib_is_named_before_the_work(runs, monkeypatch, capsys):
    monkeypatch.chdir(runs)
    monkeypatch.setitem(sys.modules, 'matplotlib', None)
    with pytest.raises(SystemExit, match='matplotlib is needed: pip install matplotlib'):
        replay.main([*ANY, '--plot', 'new.png'])
    assert capsys.readouterr().out == ''
