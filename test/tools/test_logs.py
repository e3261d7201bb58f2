"""Logs are recognised by their paths."""
from diffdrive_ros.core.validation import UserError
from diffdrive_ros.core.wheel_feedback import WheelFeedback
from diffdrive_ros.tools import logs
import pytest


def test_path_that_is_no_log_is_rejected(tmp_path):
    with pytest.raises(UserError, match='no such file'):
        logs.read(tmp_path / 'nothing.mcap', WheelFeedback(left_names=['l'], right_names=['r']))
    (tmp_path / 'empty').mkdir()
    with pytest.raises(UserError, match=r'empty: is no rosbag2 folder: it has no metadata.yaml'):
        logs.read(tmp_path / 'empty', WheelFeedback(left_names=['l'], right_names=['r']))
    (tmp_path / 'notes.txt').write_text('')
    with pytest.raises(UserError, match='must be a rosbag2 folder'):
        logs.read(tmp_path / 'notes.txt', WheelFeedback(left_names=['l'], right_names=['r']))
