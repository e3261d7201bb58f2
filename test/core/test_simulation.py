"""Test the simulated robot against physics by hand."""
from dataclasses import replace
import math
import re

from diffdrive_ros.core.simulation import RobotModel, SimulatedRobot
from hypothesis import given, strategies as st
import numpy as np
import pytest

IDEAL = RobotModel(0.317, 0.0471, 0.0533, motor_time_constant=0.0, ticks_per_revolution=0)


def test_equal_rim_speeds_drive_straight() -> None:
    """The wheel with the smaller radius turns faster."""
    robot = SimulatedRobot(IDEAL)
    robot.command(0.5 / 0.0471, 0.5 / 0.0533)
    robot.advance(3.0)
    np.testing.assert_allclose(robot.pose, [1.5, 0.0, 0.0], atol=1e-12)


def test_standing_left_wheel_is_the_centre_of_the_circle() -> None:
    """Half a turn about it ends one separation to the left."""
    robot = SimulatedRobot(IDEAL)
    right = math.pi * 0.317 / 0.0533
    robot.command(0.0, right / 2.0)
    robot.advance(2.0)
    np.testing.assert_allclose(robot.pose, [0.0, 0.317, math.pi], atol=1e-6)


@given(left=st.floats(-20.0, 20.0), right=st.floats(-20.0, 20.0))
def test_constant_command_drives_a_circle(left: float, right: float) -> None:
    """The distance from the centre of curvature is constant."""
    robot = SimulatedRobot(IDEAL)
    robot.command(left, right)
    robot.advance(0.7)
    rims = left * 0.0471, right * 0.0533
    turn = (rims[1] - rims[0]) / 0.317 * 0.7
    assert robot.pose[2] == pytest.approx(turn, abs=1e-9)
    if abs(turn) > 1e-3:
        radius = 0.5 * sum(rims) * 0.7 / turn
        assert math.hypot(robot.pose[0], robot.pose[1] - radius) == pytest.approx(
            abs(radius), rel=1e-5)


def test_wheel_reaches_63_percent_after_its_time_constant() -> None:
    """In the end its angle lags the ideal one by the time constant."""
    robot = SimulatedRobot(replace(IDEAL, motor_time_constant=0.13))
    robot.command(7.0, -3.0)
    robot.advance(0.13)
    np.testing.assert_allclose(robot.speeds, (1.0 - math.exp(-1.0)) * np.array([7.0, -3.0]))
    robot.advance(10.0)
    np.testing.assert_allclose(robot.encoders, [7.0 * 10.0, -3.0 * 10.0], atol=1e-9)


@given(cuts=st.lists(st.floats(0.001, 0.5), min_size=1, max_size=5))
def test_motion_is_independent_of_time_steps(cuts: list[float]) -> None:
    """The same time in one step or in several gives the same motion."""
    model = replace(IDEAL, motor_time_constant=0.07)
    whole, pieces = SimulatedRobot(model), SimulatedRobot(model)
    for robot in (whole, pieces):
        robot.command(9.0, 4.0, lasts=0.9)
    whole.advance(sum(cuts))
    for cut in cuts:
        pieces.advance(cut)
    np.testing.assert_allclose(pieces.encoders, whole.encoders, atol=1e-9)
    np.testing.assert_allclose(pieces.pose, whole.pose, atol=1e-5)


def test_command_without_renewal_times_out() -> None:
    """The watchdog of the motors stops the wheels."""
    robot = SimulatedRobot(IDEAL)
    robot.command(5.0, 6.0, lasts=0.4)
    robot.advance(2.0)
    np.testing.assert_allclose(robot.encoders, [2.0, 2.4], atol=1e-12)
    np.testing.assert_array_equal(robot.speeds, [0.0, 0.0])


def test_encoders_report_whole_ticks() -> None:
    """The resolution is a revolution divided by the ticks."""
    robot = SimulatedRobot(replace(IDEAL, ticks_per_revolution=360))
    robot.command(1.0, -1.0)
    robot.advance(0.5)
    ticks = np.degrees(robot.encoders)
    np.testing.assert_allclose(ticks, [28.0, -29.0], atol=1e-9)


def test_slip_shortens_the_path_but_not_encoder_angles() -> None:
    """The encoders measure the rotation of the wheels, not the slip."""
    robot = SimulatedRobot(replace(IDEAL, slip=0.1))
    robot.command(0.5 / 0.0471, 0.5 / 0.0533)
    robot.advance(2.0)
    np.testing.assert_allclose(robot.pose, [0.9, 0.0, 0.0], atol=1e-12)
    np.testing.assert_allclose(robot.encoders, [1.0 / 0.0471, 1.0 / 0.0533])
    np.testing.assert_allclose(robot.twist, [0.45, 0.0, 0.0], atol=1e-12)


def test_travel_noise_has_its_variance_per_metre() -> None:
    """For any step; the heading has the variance of both wheels over the separation squared."""
    for step in (1e-3, 2e-2):
        robot = SimulatedRobot(
            replace(IDEAL, travel_noise=0.003), seed=7, runs=20_000, step=step)
        robot.command(0.5 / 0.0471, 0.5 / 0.0533)
        robot.advance(0.4)
        travelled = 0.2
        assert np.var(robot.pose[2]) == pytest.approx(
            2.0 * 0.003**2 * travelled / 0.317**2, rel=0.05)
        assert np.var(robot.pose[0]) == pytest.approx(0.003**2 * travelled / 2.0, rel=0.05)


def test_noise_is_determined_by_the_seed() -> None:
    """A failed test can be repeated."""
    model = replace(IDEAL, travel_noise=0.01)
    poses = []
    for seed in (3, 3, 4):
        robot = SimulatedRobot(model, seed=seed)
        robot.command(3.0, 5.0)
        robot.advance(1.0)
        poses.append(robot.pose)
    np.testing.assert_array_equal(poses[0], poses[1])
    assert (poses[0] != poses[2]).any()


@pytest.mark.parametrize(('name', 'value', 'rule'), [
    ('wheel_separation', 0.0, 'must be positive and finite'),
    ('left_wheel_radius', math.nan, 'must be positive and finite'),
    ('right_wheel_radius', -1.0, 'must be positive and finite'),
    ('motor_time_constant', -0.1, 'must be finite and zero or more'),
    ('ticks_per_revolution', -1, 'must be finite and zero or more'),
    ('slip', 1.0, 'must be below 1'),
    ('travel_noise', math.inf, 'must be finite and zero or more'),
])
def test_invalid_model_is_rejected(name: str, value: float, rule: str) -> None:
    """The error has the name, the value and the rule."""
    with pytest.raises(ValueError, match=re.escape(f'{name} = {value}: {rule}')):
        replace(IDEAL, **{name: value})


def test_not_finite_motor_command_is_rejected() -> None:
    """It has no effect, and the state stays finite."""
    robot = SimulatedRobot(IDEAL)
    robot.command(1.0, 2.0)
    with pytest.raises(ValueError, match='right = nan: must be finite'):
        robot.command(5.0, math.nan)
    with pytest.raises(ValueError, match=r'seconds = -1\.0: must be finite and zero or more'):
        robot.advance(-1.0)
    robot.advance(1.0)
    np.testing.assert_allclose(robot.encoders, [1.0, 2.0])
