"""CSV logs are read to the last digit, or rejected with the line."""
import math

from diffdrive_ros.core.validation import UserError
from diffdrive_ros.core.wheel_feedback import WheelFeedback
from diffdrive_ros.tools import csv_logs, logs
import numpy as np
import pytest


def test_csv_has_wheels_and_reference_at_their_own_rates(tmp_path):
    path = tmp_path / 'drive.csv'
    path.write_text(
        'stamp,left,right,x,y,theta\n1700000000.123456789,0.0,0.5,,,\n'
        '1700000000.2,,,1.0,2.0,3.1\n1700000000.25,1.0,1.5,1.5,2.0,-3.1\n')
    log = logs.read(path, WheelFeedback(left_names=['l'], right_names=['r']))
    assert [sample.stamp_ns for sample in log.samples] == [
        1_700_000_000_123_456_789, 1_700_000_000_250_000_000]
    assert log.samples[1].right == 1.5
    assert log.reference.poses[:, 2] == pytest.approx([3.1, 2.0 * math.pi - 3.1])


def test_csv_may_have_a_byte_order_mark_and_blank_lines(tmp_path):
    path = tmp_path / 'drive.csv'
    path.write_bytes(b'\xef\xbb\xbfstamp,left,right\r\n0,0,0\r\n\r\n1,1,1\r\n  \r\n\r\n')
    assert len(logs.read(path, WheelFeedback(left_names=['l'], right_names=['r'])).samples) == 2


def test_csv_without_pose_columns_has_no_reference(tmp_path):
    path = tmp_path / 'drive.csv'
    path.write_text('stamp,left,right\n0,0,0\n0.5,1,1\n1,2,2\n')
    assert logs.read(path, WheelFeedback(left_names=['l'], right_names=['r'])).reference is None


@pytest.mark.parametrize(('content', 'rule'), [
    ('', 'the header is missing'),
    ('stamp,left\n', 'must be stamp,left,right or'),
    ('stamp,left,right\n0,0,0\n', '1 samples of all wheels, must be 2 or more'),
    ('stamp,left,right\n0,0,0\n1,nan,0\n', 'line 3: .*must be finite'),
    ('stamp,left,right\n0,0,0\n1,1\n', 'line 3: 2 columns, must be 3'),
    ('stamp,left,right,x,y,theta\n0,0,0,,,\n1,1,1,,,\n', 'the reference has 0 poses'),
    ('stamp,left,right\n0,0,0\n2,1,1\n1,2,2\n', 'line 4: stamp 1 is not later .*must increase'),
    ('stamp,left,right\n0,0,0\n1,1,1\n0,0,0\n1,1,1\n', 'line 4: stamp 0 is not later'),
    ('stamp,left,right\n0,0,0\n1e300,1,1\n', r'line 3: stamp 1e300: must be within 9e\+09 s'),
    ('stamp,left,right\n0,0,0\n-1e300,1,1\n', 'line 3: stamp -1e300: must be within'),
    ('stamp,left,right\n0,0,0\n1,1,1.2', 'the last line does not end: was it cut off?'),
    (f'stamp,left,right\n0,0,0\n{"7" * 5000},1,1\n', 'line 3: .*must be finite numbers'),
    (f'stamp,left,right\n0,0,0\n{"7" * 50},1,1\n', 'line 3: stamp 7{40}: must be within'),
    ('stamp,left,right\n0,0,0\n1,1e300,1\n', r'line 3: 1e300,1: must be within 1e\+09 rad'),
])
def test_damaged_csv_is_rejected_with_the_line(tmp_path, content, rule):
    path = tmp_path / 'drive.csv'
    path.write_text(content)
    with pytest.raises(UserError, match=rule):
        logs.read(path, WheelFeedback(left_names=['l'], right_names=['r']))


def test_written_csv_has_stamps_and_poses(tmp_path):
    poses = np.array([[0.0, 0.0, 0.0], [0.25, -1.0 / 3.0, 4.0]])
    csv_logs.write_csv(tmp_path / 'poses.csv', [10**18, 10**18 + 1], poses)
    assert (tmp_path / 'poses.csv').read_text() == (
        'stamp,x,y,theta\n1000000000.000000000,0,0,0\n'
        '1000000000.000000001,0.25,-0.333333333,4\n')


@pytest.mark.parametrize(('content', 'rule'), [
    ('direction,x,y\ncw,1,2\n', 'has no ccw: squares of both directions'),
    ('direction,x,y\nleft,1,2\n', 'line 2: direction = left: must be cw or ccw'),
    ('direction,x,y\ncw,1,nan\n', 'line 2: .*must be finite numbers'),
])
def test_damaged_end_errors_are_rejected(tmp_path, content, rule):
    path = tmp_path / 'ends.csv'
    path.write_text(content)
    with pytest.raises(UserError, match=rule):
        csv_logs.read_end_errors(path)
