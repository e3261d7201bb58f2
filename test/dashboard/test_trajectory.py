"""A drawn trajectory stays bounded, and close to every position."""
from itertools import pairwise
import math

from diffdrive_ros.dashboard.trajectory import DrawnTrajectory
from hypothesis import given, strategies as st
import numpy as np


def test_hour_at_20_hz_stays_bounded_and_near_every_position():
    trajectory = DrawnTrajectory(max_points=2000)
    path = [(3.0 * math.sin(0.05 * t), 2.0 * math.sin(0.031 * t))
            for t in np.arange(0.0, 3600.0, 0.05)]
    most = 0
    for position in path:
        trajectory.add(*position)
        most = max(most, len(trajectory.points))
    assert most <= 2001
    assert trajectory.spacing < 1.5
    kept = np.array([point[:2] for point in trajectory.points])
    for position in path[::997]:
        assert np.min(np.hypot(*(kept - position).T)) < 2.0 * trajectory.spacing


def test_hour_of_small_circles_still_shows_one():
    trajectory = DrawnTrajectory(max_points=2000)
    for turn in np.arange(0.0, 3600.0, 0.05):
        trajectory.add(0.3 * math.cos(turn), 0.3 * math.sin(turn))
    for angle in np.linspace(-math.pi, math.pi, 100):
        position = 0.3 * math.cos(angle), 0.3 * math.sin(angle)
        assert min(math.dist(position, point[:2]) for point in trajectory.points) < 0.02
    newest = trajectory.points[-900:]
    assert max(math.dist(a[:2], b[:2]) for a, b in pairwise(newest)) < 0.03


def test_robot_at_rest_adds_no_points():
    trajectory = DrawnTrajectory()
    for _ in range(1000):
        trajectory.add(1.0, 2.0)
    assert trajectory.points == [(1.0, 2.0, True)]


def test_points_are_only_added_while_the_version_stays():
    trajectory, seen = DrawnTrajectory(max_points=100), []
    version = trajectory.version
    for step in range(1000):
        trajectory.add(0.02 * step, 0.0)
        if trajectory.version == version:
            assert trajectory.points[:len(seen)] == seen
        version, seen = trajectory.version, list(trajectory.points)


def test_jump_starts_a_new_line():
    trajectory = DrawnTrajectory()
    for position in ((0.0, 0.0), (0.1, 0.0), (5.0, 5.0), (5.1, 5.0)):
        trajectory.add(*position)
    assert [point[2] for point in trajectory.points] == [True, False, True, False]


@given(st.lists(st.tuples(st.floats(-1e3, 1e3), st.floats(-1e3, 1e3)), max_size=300))
def test_nothing_but_jumps_stays_bounded(positions):
    trajectory = DrawnTrajectory(max_points=20)
    for position in positions:
        trajectory.add(*position)
    assert len(trajectory.points) <= 21


def test_positions_that_are_not_finite_are_ignored():
    trajectory = DrawnTrajectory()
    trajectory.add(math.nan, 0.0)
    trajectory.add(0.0, math.inf)
    assert trajectory.points == []


def test_cleared_trajectory_starts_a_new_line():
    trajectory = DrawnTrajectory()
    trajectory.add(0.0, 0.0)
    trajectory.add(0.1, 0.0)
    trajectory.clear()
    trajectory.add(0.1, 0.0)
    assert trajectory.points == [(0.1, 0.0, True)]
