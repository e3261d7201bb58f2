"""A changing warning is logged on change, not too often, and its last text always."""
from diffdrive_ros.node import throttled_warning
from diffdrive_ros.node.throttled_warning import ThrottledWarning
import pytest


@pytest.fixture
def clock(monkeypatch):
    """Return a list with the time of the module."""
    now = [100.0]
    monkeypatch.setattr(throttled_warning.time, 'monotonic', lambda: now[0])
    return now


@pytest.fixture
def logged():
    """Return what was logged."""
    return []


@pytest.fixture
def update(clock, logged):
    """Return what updates a warning."""
    return ThrottledWarning(logged.append, 'joint_states: {}').update


def test_unchanged_warning_is_logged_once(update, logged, clock):
    for _ in range(5):
        update('{no} wheels')
        clock[0] += 0.7
    assert logged == ['joint_states: {no} wheels']


def test_warning_is_logged_again_after_its_cause_was_gone(
        update, logged, clock):
    update('a')
    update('')
    clock[0] += 1.1
    update('a')
    assert logged == ['joint_states: a'] * 2


def test_changing_warning_is_logged_each_second_and_at_last(
        update, logged, clock):
    for number in range(100):
        update(f'number {number}')
        clock[0] += 0.01
    assert logged == ['joint_states: number 0']
    clock[0] += 0.1
    update('number 99')
    assert logged == ['joint_states: number 0', 'joint_states: number 99']
