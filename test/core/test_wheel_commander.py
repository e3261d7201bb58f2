"""Test the commander: timeout, inhibits, saturation and limits of the wheel commands."""
from functools import partial
import math

from diffdrive_ros.core.axis_limits import AxisLimits
from diffdrive_ros.core.kinematics import DiffDrive
from diffdrive_ros.core.wheel_commander import Inhibit, STOP, WheelCommand, WheelCommander
from hypothesis import assume, example, given, strategies as st
import numpy as np
import pytest
from support.strategies import drives

# No two of these numbers, nor their halves, doubles or inverses, can stand for each other.
ROBOT = DiffDrive(wheel_separation=0.317, left_wheel_radius=0.0471, right_wheel_radius=0.0533)
SECOND = 10**9
BOOT_NS = 12_345 * SECOND

same = partial(np.testing.assert_allclose, rtol=1e-12, atol=1e-12)

any_floats = st.floats()  # nan and infinities included
times = st.integers(0, 10 * SECOND)


def commander_with(linear, angular, **settings):
    """Return a commander that has just accepted a command."""
    commander = WheelCommander(ROBOT, **{'timeout': 0.5, **settings})
    commander.accept(linear, angular, BOOT_NS)
    return commander


def test_wheels_stand_still_before_the_first_command():
    commander = WheelCommander(ROBOT, timeout=0.5)
    assert not commander.started
    assert commander.step(BOOT_NS) == STOP == WheelCommand(0.0, 0.0, 0.0, 0.0)
    assert commander.stop_reason == ''
    assert not commander.started


@given(drives, st.floats(-3.0, 3.0), st.floats(-6.0, 6.0))
def test_wheel_speeds_are_those_of_the_jacobian(drive, linear, angular):
    commander = WheelCommander(drive, timeout=0.5)
    commander.accept(linear, angular, BOOT_NS)
    sent = commander.step(BOOT_NS)
    same([sent.left, sent.right], drive.wheel_jacobian @ [linear, 0.0, angular], atol=1e-10)
    same([sent.linear, sent.angular], [linear, angular])
    assert commander.started
    assert commander.stop_reason == ''


def test_command_of_a_left_turn_slows_the_left_wheel():
    straight = commander_with(0.5, 0.0).step(BOOT_NS)
    turning = commander_with(0.5, 0.5).step(BOOT_NS)
    assert turning.left < straight.left
    assert turning.right > straight.right


def test_newest_command_is_applied():
    commander = commander_with(0.5, 0.8)
    commander.accept(-0.2, 0.1, BOOT_NS)
    assert commander.step(BOOT_NS) == commander_with(-0.2, 0.1).step(BOOT_NS)


def test_numbers_out_are_plain_floats():
    sent = commander_with(1, 2, max_wheel_speed=3).step(BOOT_NS)
    for value in sent.left, sent.right, sent.linear, sent.angular:
        assert type(value) is float


# Timeout

def test_command_times_out_exactly():
    commander = commander_with(0.5, 0.8)
    moving = commander.step(BOOT_NS)
    assert commander.step(BOOT_NS + SECOND // 2) == moving
    assert commander.stop_reason == ''
    assert commander.step(BOOT_NS + SECOND // 2 + 1) == STOP
    assert commander.stop_reason == 'no command for 0.5 s'
    assert commander.started


def test_timed_out_command_stays_at_zero():
    commander = commander_with(0.5, 0.8)
    commander.step(BOOT_NS + SECOND)
    assert commander.step(BOOT_NS) == STOP


def test_each_command_restarts_the_timeout():
    commander = commander_with(0.5, 0.8)
    moving = commander.step(BOOT_NS)
    for tenths in range(4, 40, 4):
        commander.accept(0.5, 0.8, BOOT_NS + tenths * SECOND // 10)
        assert commander.step(BOOT_NS + (tenths + 4) * SECOND // 10) == moving


def test_timeout_of_zero_is_no_timeout():
    commander = commander_with(0.5, 0.8, timeout=0.0)
    assert commander.step(BOOT_NS + 10**6 * SECOND) == commander_with(0.5, 0.8).step(BOOT_NS)
    assert commander.stop_reason == ''


def test_timeout_change_takes_effect_while_driving():
    commander = commander_with(0.5, 0.8, timeout=0.0)
    commander.timeout = 2.0
    assert commander.step(BOOT_NS + 2 * SECOND).linear > 0.0
    assert commander.step(BOOT_NS + 2 * SECOND + 1) == STOP


@pytest.mark.parametrize('zero', [0.0, -0.0])
def test_timeout_of_a_zero_command_has_no_warning(zero):
    commander = commander_with(zero, zero)
    assert commander.step(BOOT_NS + 60 * SECOND) == STOP
    assert commander.stop_reason == ''


@pytest.mark.parametrize(('linear', 'angular'), [(0.5, 0.0), (0.0, 0.8), (-0.5, 0.0)])
def test_every_nonzero_command_times_out(linear, angular):
    commander = commander_with(linear, angular)
    assert commander.step(BOOT_NS + SECOND) == STOP
    assert commander.stop_reason == 'no command for 0.5 s'


def test_next_command_after_a_timeout_is_applied():
    commander = commander_with(0.5, 0.8)
    commander.step(BOOT_NS + SECOND)
    commander.accept(0.5, 0.8, BOOT_NS + 2 * SECOND)
    assert commander.step(BOOT_NS + 2 * SECOND) == commander_with(0.5, 0.8).step(BOOT_NS)
    assert commander.stop_reason == ''


# Commands that are not finite

NOT_FINITE = [
    (math.nan, 0.0), (0.0, math.nan), (math.inf, 0.0), (0.3, -math.inf), (math.nan, math.inf),
    # Finite, but the wheel speeds overflow.
    (1.7e308, 0.0), (-1.7e308, 0.0), (1e308, 1.7e308), (0.0, 1.7e308),
]


@pytest.mark.parametrize(('linear', 'angular'), NOT_FINITE)
@pytest.mark.parametrize('limit', [None, 20.0])
@pytest.mark.filterwarnings('error')
def test_not_finite_command_stops_the_wheels_with_a_warning(linear, angular, limit):
    commander = commander_with(0.5, 0.8, max_wheel_speed=limit)
    commander.step(BOOT_NS)
    commander.accept(linear, angular, BOOT_NS + 1)
    assert commander.step(BOOT_NS + 1) == STOP
    assert commander.stop_reason == f'command ({linear} m/s, {angular} rad/s): must be finite'
    assert commander.step(BOOT_NS + SECOND) == STOP
    assert 'must be finite' in commander.stop_reason


@pytest.mark.parametrize(('linear', 'angular'), NOT_FINITE)
def test_next_finite_command_is_applied(linear, angular):
    commander = commander_with(linear, angular)
    commander.step(BOOT_NS)
    commander.accept(0.5, 0.8, BOOT_NS)
    assert commander.step(BOOT_NS) == commander_with(0.5, 0.8).step(BOOT_NS)
    assert commander.stop_reason == ''


def test_not_finite_first_command_is_a_stop():
    commander = commander_with(math.nan, 0.0)
    assert commander.started
    assert commander.step(BOOT_NS) == STOP


# Saturation

@given(st.floats(-3.0, 3.0), st.floats(-6.0, 6.0), st.floats(0.1, 100.0))
def test_saturation_keeps_curvature_and_reports_the_twist(linear, angular, limit):
    sent = commander_with(linear, angular, max_wheel_speed=limit).step(BOOT_NS)
    assert max(abs(sent.left), abs(sent.right)) <= limit
    same(sent.linear * angular, sent.angular * linear)
    assert sent.linear * linear >= -1e-12
    assert sent.angular * angular >= -1e-12
    same([sent.linear, sent.angular], ROBOT.body_twist(sent.left, sent.right))


def test_speeds_below_saturation_are_unchanged():
    free = commander_with(0.5, 0.8).step(BOOT_NS)
    limited = commander_with(0.5, 0.8, max_wheel_speed=free.right / 2.0).step(BOOT_NS)
    same([limited.left, limited.right], [free.left / 2.0, free.right / 2.0])
    same([limited.linear, limited.angular], [0.25, 0.4])
    assert commander_with(0.5, 0.8, max_wheel_speed=free.right).step(BOOT_NS) == free


def test_limit_change_takes_effect_while_driving():
    commander = commander_with(0.5, 0.8)
    commander.max_wheel_speed = 1.0
    assert commander.step(BOOT_NS).right == 1.0


@given(st.lists(st.tuples(any_floats, any_floats, times), max_size=8), times, st.floats(1e-3, 1e3))
@example([(1.7e308, 0.0, 0)], 0, 20.0)
@example([(1e300, -1e300, 0)], 0, 20.0)
def test_wheel_speeds_are_finite_and_within_the_limit(commands, last_ns, limit):
    commander = WheelCommander(ROBOT, timeout=0.5, max_wheel_speed=limit)
    for linear, angular, now_ns in commands:
        commander.accept(linear, angular, now_ns)
        sent = commander.step(now_ns + last_ns)
        assert abs(sent.left) <= limit
        assert abs(sent.right) <= limit
        assert math.isfinite(sent.linear)
        assert math.isfinite(sent.angular)


@given(drives, any_floats, any_floats)
@example(ROBOT, 1e308, 1e308)
@example(DiffDrive(1.0, 2.0, 2.0), 1.2e308, 0.0)
def test_wheel_speeds_without_a_limit_are_finite(drive, linear, angular):
    commander = WheelCommander(drive, timeout=0.5)
    commander.accept(linear, angular, BOOT_NS)
    sent = commander.step(BOOT_NS)
    assert all(map(math.isfinite, (sent.left, sent.right, sent.linear, sent.angular)))


@given(late_ns=st.integers(0, 10**10), timeout=st.floats(0.05, 3.0))
def test_latency_of_a_command_shortens_its_timeout(late_ns: int, timeout: float) -> None:
    """The timeout starts when a command is sent, not when it is received."""
    commander = WheelCommander(ROBOT, timeout=timeout)
    commander.accept(0.2, 0.1, BOOT_NS, late_ns)
    assume(abs(late_ns - timeout * 1e9) > 2)
    if late_ns > timeout * 1e9:
        assert commander.step(BOOT_NS) == STOP
        assert commander.counts['late'] == 1
        assert 's late' in commander.stop_reason
        return
    assert commander.step(BOOT_NS).linear == pytest.approx(0.2)
    end = BOOT_NS + round(timeout * 1e9) - late_ns
    assert commander.step(end - 2).linear == pytest.approx(0.2)
    assert commander.step(end + 2) == STOP


def test_late_command_may_stop_but_not_drive() -> None:
    """A stop of any age is accepted; another command is dropped, and the last one stays."""
    commander = WheelCommander(ROBOT, timeout=0.5)
    commander.accept(0.2, 0.1, BOOT_NS)
    commander.accept(-0.9, 0.0, BOOT_NS + 1, late_ns=10**9)
    assert commander.step(BOOT_NS + 2).linear == pytest.approx(0.2)
    assert commander.stop_reason == ''
    commander.accept(0.0, 0.0, BOOT_NS + 3, late_ns=10**9)
    assert commander.step(BOOT_NS + 4) == STOP


def test_late_command_without_a_timeout_is_applied() -> None:
    """A timeout of zero keeps the last command, whatever its latency."""
    commander = WheelCommander(ROBOT, timeout=0.0)
    commander.accept(0.2, 0.1, BOOT_NS, late_ns=10**12)
    assert commander.step(BOOT_NS).linear == pytest.approx(0.2)


@given(st.lists(st.integers(1, 5), min_size=30, max_size=30))
def test_limits_are_per_second_despite_missed_steps(gaps: list[int]) -> None:
    """A machine too busy for the rate stops the robot as soon as any other."""
    commander = WheelCommander(ROBOT, timeout=0.5, linear_limits=AxisLimits(
        max_velocity=2.0, max_acceleration=1.0, max_deceleration=-1.0), period=0.02)
    now = BOOT_NS
    for _ in range(150):
        now += 20_000_000
        commander.accept(2.0, 0.0, now)
        fastest = commander.step(now)
    assert fastest.linear == pytest.approx(2.0)
    commander.accept(0.0, 0.0, now)
    start = now
    for gap in gaps:
        now += gap * 20_000_000
        sent = commander.step(now)
        assert sent.linear == pytest.approx(max(0.0, 2.0 - (now - start) * 1e-9), abs=1e-9)


@given(st.floats(0.05, 50.0), st.booleans())
def test_pause_of_the_process_counts_as_deceleration_time(pause: float, is_new: bool) -> None:
    """The wheels continue at the speed that the limits give after the pause."""
    commander = WheelCommander(ROBOT, timeout=0.5, linear_limits=AxisLimits(
        max_velocity=2.0, max_acceleration=4.0, max_deceleration=-0.4), period=0.02)
    now = BOOT_NS
    for _ in range(100):
        now += 20_000_000
        commander.accept(1.0, 0.0, now)
        commander.step(now)
    now += round(pause * 1e9)
    if is_new:
        commander.accept(1.0, 0.0, now)
    left = commander.step(now).linear
    slow = max(pause - 0.5, 0.0)  # the command is valid for half a second
    if is_new:
        assert left == pytest.approx(min(1.0, max(0.0, 1.0 - 0.4 * slow) + 0.4))
    elif pause > 0.5 + 1e-6:
        assert left == pytest.approx(max(0.0, 1.0 - 0.4 * (slow + min(0.1, pause))))
    else:
        assert left == 1.0


@given(st.sampled_from([1.0, 5.0, 6.0, 10.0, 25.0]))
def test_fast_or_coarse_clock_still_reaches_the_speed(pace: float) -> None:
    """A step longer than five periods is no pause while commands are valid."""
    commander = WheelCommander(
        ROBOT, timeout=0.5, linear_limits=AxisLimits(max_acceleration=1.0), period=0.02)
    for k in range(200):
        now = BOOT_NS + round(k * pace * 20_000_000)
        commander.accept(1.0, 0.0, now)
        sent = commander.step(now)
    assert sent.linear == pytest.approx(1.0)


def test_clock_change_stops_by_the_deceleration_limit() -> None:
    """The time between two clocks is unknown."""
    commander = WheelCommander(
        ROBOT, timeout=0.0, linear_limits=AxisLimits(max_acceleration=2.0), period=0.02)
    for k in range(100):
        commander.accept(1.0, 0.0, BOOT_NS + k * 20_000_000)
        commander.step(BOOT_NS + k * 20_000_000)
    commander.reset_clock()
    speeds = [commander.step(7 + k * 20_000_000).linear for k in range(30)]
    assert speeds == pytest.approx([max(0.0, 0.96 - 0.04 * k) for k in range(30)], abs=1e-9)
    assert commander.stop_reason == 'the clock was changed'


@given(st.lists(st.integers(0, 25), min_size=1, max_size=80))
def test_step_jitter_does_not_exceed_the_acceleration_limit(millis: list[int]) -> None:
    """The same with a simulated clock that is coarser than the period of the commands."""
    commander = WheelCommander(ROBOT, timeout=0.0, linear_limits=AxisLimits(
        max_velocity=5.0, max_acceleration=1.5), period=0.02)
    commander.accept(5.0, 0.0, BOOT_NS)
    commander.step(BOOT_NS)
    now = BOOT_NS
    for each in millis:
        now += each * 1_000_000
        assert commander.step(now).linear <= 1.5 * (0.02 + (now - BOOT_NS) * 1e-9) + 1e-6


def test_inhibit_stops_the_wheels_despite_a_clock_stall() -> None:
    """A /clock that stands still stops the wheels, by the deceleration limit."""
    commander = WheelCommander(ROBOT, timeout=0.5, linear_limits=AxisLimits(
        max_velocity=2.0, max_acceleration=5.0, max_deceleration=-2.0), period=0.02)
    for k in range(50):
        commander.accept(1.0, 0.0, BOOT_NS + k * 20_000_000)
        commander.step(BOOT_NS + k * 20_000_000)
    commander.inhibit(Inhibit.CLOCK_STALL, True)
    speeds = [commander.step(BOOT_NS + 49 * 20_000_000).linear for _ in range(30)]
    assert speeds[:3] == pytest.approx([0.96, 0.92, 0.88])
    assert speeds[-1] == 0.0


@given(st.lists(st.integers(2, 120), min_size=1, max_size=60))
def test_jerk_is_limited_for_any_period(millis: list[int]) -> None:
    """The acceleration changes by no more than the jerk times the time."""
    commander = WheelCommander(ROBOT, timeout=0.0, linear_limits=AxisLimits(
        max_velocity=1000.0, max_jerk=20.0), period=0.025)
    now, before, acceleration = BOOT_NS, commander.step(BOOT_NS).linear, 0.0
    commander.accept(900.0, 0.0, now)
    for each in millis:
        now += each * 1_000_000
        speed, seconds = commander.step(now).linear, each * 1e-3
        assert (speed - before) / seconds <= acceleration + 20.0 * seconds + 1e-6
        before, acceleration = speed, (speed - before) / seconds


def test_short_inhibit_discards_the_command() -> None:
    """Also if the inhibit ends before the next step."""
    commander = commander_with(0.5, 0.8)
    commander.step(BOOT_NS)
    commander.inhibit(Inhibit.DISABLED, True)
    commander.inhibit(Inhibit.DISABLED, False)
    assert commander.step(BOOT_NS + 1) == STOP
