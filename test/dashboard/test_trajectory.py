"""A track stays bounded, and stays the track."""
from itertools import pairwise
import math

from diffdrive_ros.dashboard.ellipse import INSIDE_95, of_covariance
from diffdrive_ros.dashboard.trajectory import Track
from hypothesis import given, strategies as st
import numpy as np
import pytest


def test_an_hour_at_20_frames_a_second_stays_bounded_and_near_every_place():
    track = Track(most=2000)
    path = [(3.0 * math.sin(0.05 * t), 2.0 * math.sin(0.031 * t))
            for t in np.arange(0.0, 3600.0, 0.05)]
    most = 0
    for place in path:
        track.add(*place)
        most = max(most, len(track.points))
    assert most <= 2001
    assert track.spacing < 1.5
    kept = np.array([point[:2] for point in track.points])
    for place in path[::997]:
        assert np.min(np.hypot(*(kept - place).T)) < 2.0 * track.spacing


def test_an_hour_of_small_circles_still_shows_one():
    track = Track(most=2000)
    for turn in np.arange(0.0, 3600.0, 0.05):
        track.add(0.3 * math.cos(turn), 0.3 * math.sin(turn))
    for angle in np.linspace(-math.pi, math.pi, 100):
        place = 0.3 * math.cos(angle), 0.3 * math.sin(angle)
        assert min(math.dist(place, point[:2]) for point in track.points) < 0.02
    newest = track.points[-900:]
    assert max(math.dist(a[:2], b[:2]) for a, b in pairwise(newest)) < 0.03


def test_a_robot_that_stands_adds_nothing():
    track = Track()
    for _ in range(1000):
        track.add(1.0, 2.0)
    assert track.points == [(1.0, 2.0, True)]


def test_points_only_grow_while_the_version_stays():
    track, seen = Track(most=100), []
    version = track.version
    for step in range(1000):
        track.add(0.02 * step, 0.0)
        if track.version == version:
            assert track.points[:len(seen)] == seen
        version, seen = track.version, list(track.points)


def test_a_jump_starts_a_new_line():
    track = Track()
    for place in ((0.0, 0.0), (0.1, 0.0), (5.0, 5.0), (5.1, 5.0)):
        track.add(*place)
    assert [point[2] for point in track.points] == [True, False, True, False]


@given(st.lists(st.tuples(st.floats(-1e3, 1e3), st.floats(-1e3, 1e3)), max_size=300))
def test_nothing_but_jumps_stays_bounded_too(places):
    track = Track(most=20)
    for place in places:
        track.add(*place)
    assert len(track.points) <= 21


def test_what_is_not_finite_is_passed_over():
    track = Track()
    track.add(math.nan, 0.0)
    track.add(0.0, math.inf)
    assert track.points == []


def test_a_track_that_was_cleared_starts_a_new_line():
    track = Track()
    track.add(0.0, 0.0)
    track.add(0.1, 0.0)
    track.clear()
    track.add(0.1, 0.0)
    assert track.points == [(0.1, 0.0, True)]


@given(st.floats(0.01, 3.0), st.floats(0.01, 1.0), st.floats(-1.5, 1.5))
def test_an_ellipse_is_that_of_the_covariance(long, share, angle):
    short = 0.9 * share * long
    turn = np.array([[math.cos(angle), -math.sin(angle)], [math.sin(angle), math.cos(angle)]])
    got = of_covariance(turn @ np.diag([long**2, short**2]) @ turn.T)
    assert got[:2] == pytest.approx((INSIDE_95 * long, INSIDE_95 * short))
    assert math.sin(got[2] - angle) == pytest.approx(0.0, abs=1e-6)


def test_what_is_no_covariance_has_no_ellipse():
    assert of_covariance([[math.nan, 0.0], [0.0, 1.0]]) is None
    assert of_covariance([[math.inf, 0.0], [0.0, 1.0]]) is None
    assert of_covariance([[-1.0, 0.0], [0.0, 1.0]]) is None
    assert of_covariance([[1.0, 2.0], [2.0, 1.0]]) is None
