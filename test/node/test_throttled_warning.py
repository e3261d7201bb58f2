"""A complaint is said when it changes, not too often, and the last one always."""
from diffdrive_ros.node import throttled_warning
from diffdrive_ros.node.throttled_warning import ThrottledWarning
import pytest


@pytest.fixture
def clock(monkeypatch):
    """Return a list with the time that the module sees."""
    now = [100.0]
    monkeypatch.setattr(throttled_warning.time, 'monotonic', lambda: now[0])
    return now


@pytest.fixture
def said():
    """Return what was said."""
    return []


@pytest.fixture
def update(clock, said):
    """Return what looks at a complaint."""
    return ThrottledWarning(said.append, 'joint_states: {}').update


def test_a_complaint_that_stays_is_said_once(update, said, clock):
    for _ in range(5):
        update('{no} wheels')
        clock[0] += 0.7
    assert said == ['joint_states: {no} wheels']


def test_nothing_is_said_of_a_complaint_that_is_over_and_it_is_said_again_when_it_returns(
        update, said, clock):
    update('a')
    update('')
    clock[0] += 1.1
    update('a')
    assert said == ['joint_states: a'] * 2


def test_complaints_that_take_turns_are_said_once_a_second_and_the_last_of_them_in_the_end(
        update, said, clock):
    for number in range(100):
        update(f'number {number}')
        clock[0] += 0.01
    assert said == ['joint_states: number 0']
    clock[0] += 0.1
    update('number 99')
    assert said == ['joint_states: number 0', 'joint_states: number 99']
