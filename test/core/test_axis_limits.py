"""Test the limits of an axis: velocity, acceleration, jerk, stops and reversals."""
from dataclasses import fields, FrozenInstanceError, replace
import math
import re
import sys

from diffdrive_ros.core.axis_limits import AxisLimits
from hypothesis import example, given, strategies as st
import pytest

NAN, INF = math.nan, math.inf
NAMES = [field.name for field in fields(AxisLimits)]
NOT_POSITIVE = ['min_velocity', 'max_deceleration', 'max_acceleration_reverse', 'min_jerk']
NOT_NEGATIVE = [name for name in NAMES if name not in NOT_POSITIVE]
ACCELERATIONS = NAMES[2:6]

# Of diff_drive_controller's test_speed_limiter, and of control_toolbox's tests of RateLimiter.
FOUR_RATES = {
    'max_acceleration': 2.0, 'max_deceleration': -4.0,
    'max_acceleration_reverse': -8.0, 'max_deceleration_reverse': 10.0}
TOOLBOX_RATES = {
    'max_acceleration': 1.0, 'max_deceleration': -5.0,
    'max_acceleration_reverse': -0.5, 'max_deceleration_reverse': 10.0}
TOOLBOX_JERKS = {'max_jerk': 5.0, 'min_jerk': -0.5}
TOOLBOX_VELOCITIES = {'max_velocity': 1.0, 'min_velocity': -0.5}


def limit(name, size):
    """Return a strategy of one limit: with its sign, or not set, or zero, or infinite."""
    sign = -1.0 if name in NOT_POSITIVE else 1.0
    return st.one_of(st.just(NAN), st.just(0.0), st.floats(0.0, size), st.just(INF)).map(
        lambda value: sign * value)


no_jerk_limits = st.builds(AxisLimits, *(
    limit(name, 2.0 if name.endswith('velocity') else 5.0) for name in NAMES[:6]))
any_limits = st.builds(
    replace, no_jerk_limits, max_jerk=limit('max_jerk', 50.0), min_jerk=limit('min_jerk', 50.0))
speeds = st.one_of(st.floats(-3.0, 3.0), st.floats(-0.1, 0.1), st.sampled_from([0.0, -0.0, 1.0]))
periods = st.one_of(st.floats(1e-3, 1.0), st.sampled_from([0.01, 0.02, 0.5]))
finite = st.floats(allow_nan=False, allow_infinity=False)


def drive(limits, targets, dt, last=0.0, before_last=None):
    """Return the applied speeds for a sequence of targets, one a period."""
    applied = [last if before_last is None else before_last, last]
    for target in targets:
        applied.append(limits.step(target, applied[-1], applied[-2], dt))
    return applied[2:]


def velocities(limits):
    """Return the lowest and the highest velocity that limits allow."""
    if math.isnan(limits.max_velocity):
        return -INF, INF
    low = limits.min_velocity
    return -limits.max_velocity if math.isnan(low) else low, limits.max_velocity


def mirrored(limits):
    """Return the limits of the same axis with its positive direction reversed."""
    partner = {
        'max_velocity': 'min_velocity', 'max_acceleration': 'max_acceleration_reverse',
        'max_deceleration': 'max_deceleration_reverse', 'max_jerk': 'min_jerk'}
    partner |= {there: here for here, there in partner.items()}
    return AxisLimits(**{name: -getattr(limits, partner[name]) for name in NAMES})


# Values by hand

@pytest.mark.parametrize(('last', 'target', 'dt', 'expected'), [
    (0.0, 1.0, 0.125, [0.25, 0.5, 0.75, 1.0, 1.0]),
    (1.0, 0.0, 0.0625, [0.75, 0.5, 0.25, 0.0, 0.0]),
    (1.0, 0.375, 0.0625, [0.75, 0.5, 0.375, 0.375]),
    (0.0, -1.0, 0.03125, [-0.25, -0.5, -0.75, -1.0, -1.0]),
    (-1.0, 0.0, 0.03125, [-0.6875, -0.375, -0.0625, 0.0, 0.0]),
    (-1.0, -0.5, 0.03125, [-0.6875, -0.5, -0.5]),
])
def test_each_direction_has_its_own_rates(last, target, dt, expected):
    assert drive(AxisLimits(**FOUR_RATES), [target] * len(expected), dt, last) == expected


@pytest.mark.parametrize(('settings', 'target', 'last', 'expected'), [
    (TOOLBOX_RATES, 10.0, 5.0, 5.5),
    (TOOLBOX_RATES, -10.0, 5.0, 2.5),
    (TOOLBOX_RATES, 10.0, -5.0, 0.0),
    (TOOLBOX_RATES, -10.0, -5.0, -5.25),
    (TOOLBOX_RATES, 10.0, 0.0, 0.5),
    (TOOLBOX_RATES, -10.0, 0.0, -0.25),
    (TOOLBOX_JERKS, 10.0, 0.0, 1.25),
    (TOOLBOX_JERKS, -10.0, 0.0, -0.125),
    (TOOLBOX_VELOCITIES, 10.0, 0.0, 1.0),
    (TOOLBOX_VELOCITIES, -10.0, 0.0, -0.5),
    (TOOLBOX_RATES | TOOLBOX_VELOCITIES, 10.0, 0.75, 1.0),
    (TOOLBOX_RATES | TOOLBOX_VELOCITIES, -10.0, -0.375, -0.5),
    (TOOLBOX_RATES | TOOLBOX_JERKS | TOOLBOX_VELOCITIES, 10.0, 0.0, 0.5),
    (TOOLBOX_RATES | TOOLBOX_JERKS | TOOLBOX_VELOCITIES, -10.0, 0.0, -0.125),
    ({}, 10.0, 0.0, 10.0),
    ({}, -10.0, 3.0, -10.0),
])
def test_speeds_after_half_a_second_are_control_toolboxs(settings, target, last, expected):
    assert AxisLimits(**settings).step(target, last, last, 0.5) == expected


def test_reversal_decelerates_then_accelerates_by_the_other_rate():
    # 4 m/s^2 stop 0.25 m/s in 62.5 ms; the other 62.5 ms are for 8 m/s^2.
    limits = AxisLimits(**FOUR_RATES)
    assert limits.step(-2.0, 0.25, 0.25, 0.125) == -0.5
    # 10 m/s^2 stop 0.625 m/s in 62.5 ms; 2 m/s^2 then.
    assert limits.step(2.0, -0.625, -0.625, 0.125) == 0.125
    assert drive(limits, [-0.75] * 4, 0.125, 1.0) == [0.5, 0.0, -0.75, -0.75]


def test_direction_with_acceleration_zero_is_not_entered():
    limits = AxisLimits(max_acceleration=2.0, max_acceleration_reverse=0.0, max_deceleration=-4.0)
    assert drive(limits, [-1.0] * 3, 0.125, 0.75) == [0.25, 0.0, 0.0]


def test_constant_jerk_gives_speed_quadratic_in_time():
    limits = AxisLimits(max_jerk=0.5, min_jerk=-1.0)
    triangular = [0.0, 1.0, 3.0, 6.0, 10.0, 15.0, 21.0]  # of jerk dt^2 = 1/8
    assert drive(limits, [9.0] * 6, 0.5) == [number / 8.0 for number in triangular[1:]]
    assert drive(limits, [-9.0] * 6, 0.5) == [-number / 4.0 for number in triangular[1:]]
    assert drive(limits, [2.0] * 7, 0.5)[-2:] == [2.0, 2.0]  # and not beyond
    slower = drive(limits, [3.0] * 6, 0.5, 9.0)
    assert slower == [9.0 - number / 4.0 for number in triangular[1:6]] + [3.75]


def test_jerk_limits_do_not_delay_the_end_of_acceleration():
    limits = AxisLimits(max_jerk=0.5)
    assert limits.step(1.1, 1.0, 0.5, 0.5) == 1.1
    assert limits.step(0.9, 1.0, 1.5, 0.5) == 0.9


def test_jerk_limits_preserve_momentum_after_a_new_target():
    # The deceleration is 0.5 a period at the new target, and may change by 1/8.
    limits = AxisLimits(max_jerk=0.5)
    assert drive(limits, [3.0] * 5, 0.5, 2.0, 2.5) == [1.625, 1.375, 1.25, 1.25, 1.375]


def test_momentum_does_not_accelerate_to_a_slower_target():
    # The acceleration is 0.5 a period at the new target.
    limits = AxisLimits(max_jerk=0.5)
    assert drive(limits, [0.25] * 4, 0.5, 1.0, 0.5) == [1.0, 0.875, 0.625, 0.25]
    assert drive(limits, [1e-9] * 4, 0.5, -1.0, -0.5) == [-1.0, -0.875, -0.625, -0.25]


def test_momentum_does_not_carry_past_zero():
    limits = AxisLimits(max_jerk=0.5)
    assert drive(limits, [2.0] * 3, 0.5, 0.25, 1.0) == [0.0, 0.0, 0.125]
    assert drive(limits, [-2.0] * 3, 0.5, -0.25, -1.0) == [0.0, 0.0, -0.125]
    assert limits.step(2.0, 0.0, 1.0, 0.5) == 0.0


# Limits not set

@pytest.mark.parametrize(('settings', 'same_as'), [
    ({'max_velocity': 1.5}, {'min_velocity': -1.5}),
    ({'max_jerk': 1.5}, {'min_jerk': -1.5}),
    ({'max_acceleration': 2.0}, {
        'max_acceleration_reverse': -2.0, 'max_deceleration': -2.0,
        'max_deceleration_reverse': 2.0}),
    ({'max_acceleration': 2.0, 'max_acceleration_reverse': -3.0}, {
        'max_deceleration': -3.0, 'max_deceleration_reverse': 2.0}),
    ({'max_acceleration': 2.0, 'max_deceleration': -4.0}, {
        'max_acceleration_reverse': -2.0, 'max_deceleration_reverse': 2.0}),
    ({'max_acceleration': 2.0, 'max_deceleration_reverse': 4.0}, {
        'max_acceleration_reverse': -2.0, 'max_deceleration': -2.0}),
])
@given(speeds, speeds, speeds, periods)
def test_unset_limit_has_the_value_of_its_counterpart(
        settings, same_as, target, last, before_last, dt):
    partly, fully = AxisLimits(**settings), AxisLimits(**settings, **same_as)
    assert partly.step(target, last, before_last, dt) == fully.step(target, last, before_last, dt)


def test_unset_deceleration_is_the_opposite_acceleration():
    limits = AxisLimits(max_acceleration=2.0, max_acceleration_reverse=-8.0)
    assert limits.step(0.0, 3.0, 3.0, 0.125) == 2.0
    assert limits.step(0.0, -3.0, -3.0, 0.125) == -2.75


@pytest.mark.parametrize(('maximum', 'others'), [
    ('max_velocity', ['min_velocity']),
    ('max_acceleration', ACCELERATIONS[1:]),
    ('max_jerk', ['min_jerk']),
])
@given(any_limits, speeds, speeds, speeds, periods)
def test_family_without_maximum_is_off_and_reported(
        maximum, others, limits, target, last, before_last, dt):
    settings = {name: getattr(limits, name) for name in NAMES} | {maximum: NAN}
    off = AxisLimits(**settings)
    bare = AxisLimits(**settings | dict.fromkeys(others, NAN))
    assert off.step(target, last, before_last, dt) == bare.step(target, last, before_last, dt)
    reported = [name for name in others if not math.isnan(settings[name])]
    assert [name for name in off.without_effect if name in others] == reported
    assert not set(bare.without_effect) & set(others)


def test_limits_without_effect_have_the_order_of_parameters():
    assert AxisLimits().without_effect == ()
    minima = AxisLimits(
        min_jerk=0.0, max_deceleration=-4.0, max_acceleration_reverse=-8.0,
        max_deceleration_reverse=10.0, min_velocity=-INF)
    assert minima.without_effect == (
        'min_velocity', 'max_deceleration', 'max_acceleration_reverse',
        'max_deceleration_reverse', 'min_jerk')
    assert AxisLimits(**FOUR_RATES, **TOOLBOX_JERKS, **TOOLBOX_VELOCITIES).without_effect == ()


@pytest.mark.parametrize('limits', [
    AxisLimits(), AxisLimits(**{name: -INF if name in NOT_POSITIVE else INF for name in NAMES})])
@given(finite, finite, finite, st.floats(1e-300, 1e300))
def test_target_is_applied_without_finite_limits(
        limits, target, last, before_last, dt):
    assert limits.step(target, last, before_last, dt) == target


@pytest.mark.parametrize('name', ['max_velocity', 'max_acceleration', 'max_jerk'])
def test_limit_of_zero_is_a_limit(name):
    limits = AxisLimits(**{name: 0.0})
    assert drive(limits, [1.0, 1.0, -1.0, -1.0], 0.5) == [0.0] * 4


def test_deceleration_of_zero_keeps_the_speed_except_at_a_stop():
    limits = AxisLimits(max_acceleration=2.0, max_deceleration=-0.0, max_deceleration_reverse=0.0)
    assert drive(limits, [0.5, -1.0, 0.0], 0.125, 1.0) == [1.0, 1.0, 0.0]
    assert drive(limits, [-0.5, 1.0, 0.0], 0.125, -1.0) == [-1.0, -1.0, 0.0]
    assert drive(limits, [-1.0, -1.0], 0.125) == [-0.25, -0.5]  # acceleration is unchanged
    assert AxisLimits(max_acceleration=0.0).step(0.0, 1.0, 1.0, 0.02) == 0.0


# Stops

def test_stop_ignores_jerk_limits():
    limits = AxisLimits(**FOUR_RATES, max_jerk=0.01)
    assert drive(limits, [0.0] * 4, 0.0625, 0.75, 0.5) == [0.5, 0.25, 0.0, 0.0]
    assert drive(limits, [-0.0] * 4, 0.03125, -0.75, 0.5) == [-0.4375, -0.125, 0.0, 0.0]
    assert AxisLimits(max_jerk=0.01).step(0.0, 1.0, 0.5, 0.02) == 0.0


def test_target_clipped_to_zero_is_a_stop():
    limits = AxisLimits(max_velocity=1.0, min_velocity=0.0, max_acceleration=2.0, max_jerk=0.01)
    assert drive(limits, [-1.0] * 4, 0.125, 0.625, 0.375) == [0.375, 0.125, 0.0, 0.0]


@given(any_limits, finite, finite, st.floats(1e-6, 1e6))
@example(AxisLimits(max_jerk=0.5), 0.25, 1.0, 0.5)
@example(AxisLimits(max_jerk=0.5), 0.0, 1.0, 0.5)
@example(AxisLimits(max_velocity=1.0, max_acceleration=0.0), 2.0, 2.0, 0.02)
def test_stop_approaches_zero_monotonically(limits, last, before_last, dt):
    for now in drive(limits, [0.0] * 10, dt, last, before_last):
        assert abs(now) <= abs(last)
        assert now == 0.0 or (now > 0.0) == (last > 0.0)
        last = now


@given(any_limits, speeds, speeds, periods)
def test_stop_lasts_no_longer_than_its_deceleration(limits, last, before_last, dt):
    if math.isnan(limits.max_acceleration):
        rate = INF
    elif last < 0.0:
        rate = limits.max_deceleration_reverse
        rate = limits.max_acceleration if math.isnan(rate) else rate
    else:
        rates = limits.max_deceleration, limits.max_acceleration_reverse, -limits.max_acceleration
        rate = -next(value for value in rates if not math.isnan(value))
    now = limits.step(0.0, last, before_last, dt)
    expected = max(abs(last) - (rate or INF) * dt, 0.0)
    assert now == pytest.approx(math.copysign(expected, last), rel=1e-12, abs=1e-12)
    assert (now == 0.0) == (expected == 0.0)


# Limits lowered while the robot drives

@pytest.mark.parametrize('target', [1.0, 5.0, INF])
def test_speed_beyond_lowered_limits_decelerates_by_the_limit(target):
    target = min(target, sys.float_info.max)
    limits = AxisLimits(
        **FOUR_RATES, max_velocity=1.0, min_velocity=-0.5, max_jerk=0.01)
    assert drive(limits, [target] * 5, 0.125, 2.25, 2.0) == [1.75, 1.25, 1.0, 1.0, 1.0]
    assert drive(limits, [-target] * 4, 0.0625, -1.5, -1.0) == [-0.875, -0.5, -0.5, -0.5]


@pytest.mark.parametrize('settings', [{}, {'max_acceleration': 2.0, 'max_deceleration': 0.0}])
def test_speed_beyond_limits_without_deceleration_is_clipped(settings):
    limits = AxisLimits(**settings, max_velocity=1.0)
    assert drive(limits, [5.0, 5.0, 0.0], 0.125, 2.0) == [1.0, 1.0, 0.0]


@given(any_limits, speeds, speeds, speeds, periods)
def test_speed_beyond_velocity_limits_only_approaches_them(
        limits, target, last, before_last, dt):
    low, high = velocities(limits)
    for now in drive(limits, [target] * 10, dt, last, before_last):
        assert min(last, low) <= now <= max(last, high)
        if last > high:
            assert now <= last
        if last < low:
            assert now >= last
        last = now


# Laws

@given(any_limits, finite, finite, finite, st.floats(allow_nan=False, allow_infinity=False))
@example(AxisLimits(max_jerk=1.0), 1.0, 1e308, -1e308, 0.02)
@example(AxisLimits(max_jerk=1.0), 1.0, 1.7e308, 1e308, 0.02)
@example(AxisLimits(max_jerk=1.0, min_jerk=-INF), 1.0, 1e308, -1e308, 0.02)
@example(AxisLimits(max_jerk=0.0), 1.0, 0.0, 0.0, 1e200)
@example(AxisLimits(max_jerk=INF), 1e308, -1e308, 1e308, 5e-324)
@example(AxisLimits(max_acceleration=INF, max_deceleration=-1.0), -1.0, 0.1, 0.1, 0.1)
@example(AxisLimits(NAN, NAN, 1.0, -5.7, -INF), -1.0, 0.399, 0.399, 0.07)
@example(AxisLimits(max_velocity=INF, max_jerk=1.0), 1.0, 1.7e308, 1e308, 0.02)
def test_step_of_finite_numbers_is_finite(limits, target, last, before_last, dt):
    assert math.isfinite(limits.step(target, last, before_last, dt))


@given(any_limits, speeds, speeds, speeds, periods)
def test_speed_within_velocity_limits_stays_within(limits, target, last, before_last, dt):
    low, high = velocities(limits)
    last = min(max(last, low), high)
    for now in drive(limits, [target] * 10, dt, last, before_last):
        assert low <= now <= high


@given(any_limits, speeds, speeds, speeds, periods)
def test_target_is_never_overshot(limits, target, last, before_last, dt):
    low, high = velocities(limits)
    now = limits.step(target, last, before_last, dt)
    target = min(max(target, low), high)
    if last <= target:
        assert now <= target
    if last >= target:
        assert now >= target


@given(no_jerk_limits, speeds, speeds, speeds, periods)
def test_speed_without_jerk_limits_is_between_last_and_target(
        limits, target, last, before_last, dt):
    low, high = velocities(limits)
    now = limits.step(target, last, before_last, dt)
    assert now == limits.step(target, last, last, dt)
    target = min(max(target, low), high)
    assert min(last, target) <= now <= max(last, target)


@given(any_limits, speeds, speeds, speeds, periods)
def test_direction_is_that_of_last_speed_or_target(
        limits, target, last, before_last, dt):
    now = limits.step(target, last, before_last, dt)
    if target >= 0.0 and last >= 0.0:
        assert now >= 0.0
    if target <= 0.0 and last <= 0.0:
        assert now <= 0.0


@given(
    st.lists(st.floats(0.01, 50.0), min_size=4, max_size=4), speeds, speeds, speeds, periods,
    st.sampled_from([NAN, 0.0, 0.5, 20.0]))
def test_speed_is_not_reached_faster_than_by_the_rates(
        rates, target, last, before_last, dt, max_jerk):
    faster, slower, faster_reverse, slower_reverse = rates
    limits = AxisLimits(
        max_acceleration=faster, max_deceleration=-slower,
        max_acceleration_reverse=-faster_reverse, max_deceleration_reverse=slower_reverse,
        max_jerk=max_jerk)
    now = limits.step(target, last, before_last, dt)
    forward = max(now, 0.0) - max(last, 0.0)
    reverse = max(-now, 0.0) - max(-last, 0.0)
    time = max(forward / faster, -forward / slower)
    time += max(reverse / faster_reverse, -reverse / slower_reverse)
    assert time <= dt * (1.0 + 1e-9) + 1e-13


@given(
    st.lists(st.floats(0.5, 10.0), min_size=4, max_size=4),
    st.one_of(st.just(NAN), st.floats(2.0, 50.0)), st.one_of(st.just(NAN), st.floats(0.5, 2.0)),
    speeds, speeds, st.floats(0.02, 0.1))
def test_target_within_velocity_limits_is_reached_and_kept(
        rates, max_jerk, max_velocity, target, last, dt):
    limits = AxisLimits(
        max_velocity, NAN, rates[0], -rates[1], -rates[2], rates[3], max_jerk, NAN)
    # 6 m/s at 0.5 m/s^2, and three times as long to build up 0.5 m/s^2 or more at 2 m/s^3.
    applied = drive(limits, [target] * math.ceil(25.0 / dt), dt, last)
    low, high = velocities(limits)
    assert applied[-2:] == [min(max(target, low), high)] * 2


@given(any_limits, speeds, speeds, speeds, periods)
def test_mirrored_limits_give_mirrored_speeds(limits, target, last, before_last, dt):
    if any(math.isnan(getattr(limits, name)) for name in NAMES):
        return  # a limit not set has the value of the forward direction
    there = mirrored(limits).step(-target, -last, -before_last, dt)
    assert there == -limits.step(target, last, before_last, dt)


@given(any_limits, speeds, speeds, speeds, periods)
def test_speed_of_zero_has_no_sign(limits, target, last, before_last, dt):
    now = limits.step(target, last, before_last, dt)
    assert now != 0.0 or math.copysign(1.0, now) == 1.0


# Equality with diff_drive_controller

def control_toolbox_step(limits, target, last, before_last, dt):
    """Return the speed of control_toolbox's RateLimiter, by a separate implementation."""
    def middle(low, value, high):
        return sorted([low, value, high])[1]

    def value_of(*names):
        return next(v for v in (getattr(limits, name) for name in names) if not math.isnan(v))

    now = target
    if not math.isnan(limits.max_jerk):
        low = -limits.max_jerk if math.isnan(limits.min_jerk) else limits.min_jerk
        change = (now - last) - (last - before_last)
        if change * (now - last) > 0.0:
            now = 2.0 * last - before_last + middle(low * dt**2, change, limits.max_jerk * dt**2)
    if not math.isnan(limits.max_acceleration):
        back = limits.max_acceleration_reverse
        back = -limits.max_acceleration if math.isnan(back) else back
        low, high = back, limits.max_acceleration
        if last > 0.0 and not math.isnan(limits.max_deceleration):
            low = limits.max_deceleration
        if last < 0.0:
            high = value_of('max_deceleration_reverse', 'max_acceleration')
        now = last + middle(low * dt, now - last, high * dt)
    low, high = velocities(limits)
    return middle(low, now, high)


def equals_control_toolbox(limits, target, last, before_last, dt):
    expected = control_toolbox_step(limits, target, last, before_last, dt)
    now = limits.step(target, last, before_last, dt)
    return now == pytest.approx(expected, rel=1e-9, abs=1e-9)


@given(any_limits, speeds, speeds, speeds, periods)
def test_speeds_are_diff_drive_controllers_without_reversal(
        limits, target, last, before_last, dt):
    low, high = velocities(limits)
    last, before_last = min(max(last, low), high), min(max(before_last, low), high)
    expected = control_toolbox_step(limits, target, last, before_last, dt)
    clipped = min(max(target, low), high)
    if not clipped or abs(expected) > max(abs(last), abs(clipped)):
        return  # a stop, or RateLimiter accelerates towards a lower target
    if last * expected >= 0.0 and target * expected >= 0.0:
        assert equals_control_toolbox(limits, target, last, before_last, dt)


@given(any_limits, speeds, speeds, speeds, periods)
def test_speeds_are_diff_drive_controllers_with_one_rate(
        limits, target, last, before_last, dt):
    rate = limits.max_acceleration
    limits = AxisLimits(limits.max_velocity, limits.min_velocity, rate)
    low, high = velocities(limits)
    last = min(max(last, low), high)
    if rate or min(max(target, low), high):  # except a stop without a deceleration
        assert equals_control_toolbox(limits, target, last, before_last, dt)


# Time and arguments

@pytest.mark.parametrize('dt', [0.0, -0.0, -0.02, -1e300])
@given(any_limits, speeds, speeds, speeds)
def test_speed_stays_with_a_period_of_zero(dt, limits, target, last, before_last):
    assert limits.step(target, last, before_last, dt) == last


def test_long_period_overshoots_neither_target_nor_limits():
    limits = AxisLimits(**FOUR_RATES, **TOOLBOX_JERKS, **TOOLBOX_VELOCITIES)
    assert [limits.step(target, 0.25, 0.125, 1e300) for target in (9.0, 0.75, 0.0, -9.0)] == [
        1.0, 0.75, 0.0, -0.5]
    assert AxisLimits(max_jerk=0.0).step(1.0, 0.0, 0.0, 1e200) == 0.0


@pytest.mark.parametrize('value', [NAN, INF, -INF, None, '1', 10**400])
@pytest.mark.parametrize('index', range(4))
def test_not_finite_arguments_are_rejected_by_name(index, value):
    arguments = [1.0, 0.5, 0.25, 0.02]
    arguments[index] = value
    name = ['target', 'last', 'before_last', 'dt'][index]
    with pytest.raises(ValueError, match=rf'^{name} = .*: must be finite$'):
        AxisLimits().step(*arguments)


@pytest.mark.parametrize('name', NAMES)
@pytest.mark.parametrize('size', [5e-324, 0.5, 1e308, INF])
def test_limit_of_the_wrong_sign_is_rejected_by_name(name, size):
    sign, side = (1.0, 'less') if name in NOT_POSITIVE else (-1.0, 'more')
    message = f'{name} = {sign * size}: must be zero or {side}, or nan (not set)'
    with pytest.raises(ValueError, match=f'^{re.escape(message)}$'):
        AxisLimits(**{name: sign * size})
    assert getattr(AxisLimits(**{name: -sign * size}), name) == -sign * size
    for zero in 0.0, -0.0, 0:
        assert getattr(AxisLimits(**{name: zero}), name) == 0.0


@pytest.mark.parametrize('value', [None, '1', [1.0], 1j, 10**400])
def test_limit_that_is_no_number_is_rejected(value):
    with pytest.raises(ValueError, match=r'^max_jerk = .*: must be zero or more, or nan'):
        AxisLimits(max_jerk=value)


def test_limits_are_immutable():
    with pytest.raises(FrozenInstanceError):
        AxisLimits().max_jerk = 1.0


def test_numbers_out_are_plain_floats():
    limits = AxisLimits(max_velocity=2, max_acceleration=1)
    assert type(limits.max_velocity) is float
    for now in limits.step(3, 1, 1, 1), limits.step(0, 1, 1, 1), limits.step(0, 1, 1, 0):
        assert type(now) is float
