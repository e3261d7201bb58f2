"""The pool returns results in the order of the tasks, and ends on Ctrl-C."""
import os
import signal
import subprocess
import sys
import time

from diffdrive_ros.core.validation import UserError
from diffdrive_ros.tools.pool import map_on_cores
import pytest


def wait_for(seconds):
    """Take some time, or fail below zero; for a process of its own."""
    if seconds < -1.0:
        raise ZeroDivisionError('a bug')
    if seconds < 0.0:
        raise UserError('must not be negative')
    time.sleep(seconds)
    return seconds


def test_results_are_in_the_order_of_tasks():
    assert map_on_cores('Waiting', wait_for, [(0.2,), (0.1,), (0.0,)]) == [0.2, 0.1, 0.0]


def test_user_error_in_a_worker_is_raised():
    with pytest.raises(UserError, match='must not be negative'):
        map_on_cores('Waiting', wait_for, [(0.2,), (-1.0,), (0.0,)])


def test_no_tasks_have_no_results():
    assert map_on_cores('Waiting', wait_for, []) == []


def test_bug_in_a_worker_is_raised():
    with pytest.raises(ZeroDivisionError, match='a bug'):
        map_on_cores('Waiting', wait_for, [(0.0,), (-2.0,)])


INTERRUPTED = """
from diffdrive_ros.tools.command_line import run_tool
from diffdrive_ros.tools.pool import map_on_cores
from test_pool import wait_for
print('begun', flush=True)
run_tool('waiting', lambda: map_on_cores('Waiting', wait_for, [(1.0,)] * 100))
"""


def test_ctrl_c_ends_the_pool_in_one_line():
    with subprocess.Popen(
            [sys.executable, '-c', INTERRUPTED], stdout=subprocess.PIPE, text=True,
            stderr=subprocess.PIPE, start_new_session=True,
            env=os.environ | {'PYTHONPATH': os.pathsep.join(sys.path)}) as process:
        assert process.stdout.readline() == 'begun\n'
        time.sleep(1.0)
        process.send_signal(signal.SIGINT)
        _, errors = process.communicate(timeout=20)
    assert process.returncode == 1
    assert errors == 'waiting: interrupted\n'
