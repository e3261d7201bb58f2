"""Teleoperation: heartbeats, dead-man switch, stop; keys and joystick to twists."""
import math

from diffdrive_ros.dashboard.teleop import (
    Heartbeat,
    HEARTBEAT_TIMEOUT_S,
    MAX_LATENCY_S,
    saturate,
    STOP,
    Teleop,
    twist_of_joystick,
    twist_of_keys,
)
from hypothesis import given, strategies as st
import pytest

FORWARD = (0.3, 0.0)
LIMITS = (0.37, 1.9)
UNIT = st.floats(-1.0, 1.0)


class Pages:
    """Pages that send heartbeats, at a time that only the tests advance."""

    def __init__(self) -> None:
        self.teleop, self.now, self._number = Teleop(), 100.0, 0

    def heartbeat(
            self, page, twist, *, latency=0.0, number=None, is_interrupted=False, may_drive=True):
        """Send a heartbeat of a page whose newest frame was sent latency [s] ago."""
        self._number += 1
        return self.teleop.accept(page, Heartbeat(
            self._number if number is None else number, self.now - latency, twist, is_interrupted,
            may_drive), self.now)

    def drive(self, page='a'):
        """Press a control of a page that was at rest."""
        self.heartbeat(page, STOP)
        assert self.heartbeat(page, FORWARD) == FORWARD


@pytest.fixture
def pages() -> Pages:
    """Return pages of which none drives."""
    return Pages()


def test_first_page_that_asks_for_motion_gets_control(pages):
    pages.drive('a')
    pages.heartbeat('b', STOP)
    assert pages.heartbeat('b', FORWARD) is None
    assert pages.teleop.driver == 'a'


def test_controls_that_were_never_at_rest_do_not_drive(pages):
    assert pages.heartbeat('a', FORWARD) is None
    assert pages.teleop.driver is None


def test_released_controls_publish_one_stop(pages):
    pages.drive()
    assert pages.heartbeat('a', STOP) == STOP
    assert pages.heartbeat('a', STOP) is None


def test_heartbeat_timeout_publishes_one_stop_and_disarms(pages):
    pages.drive()
    pages.now += HEARTBEAT_TIMEOUT_S + 0.001
    assert pages.teleop.check_timeout(pages.now) == STOP
    assert pages.teleop.check_timeout(pages.now) is None
    assert pages.heartbeat('a', FORWARD) is None
    assert pages.teleop.stop_reason('a')
    pages.drive()
    assert not pages.teleop.stop_reason('a')


def test_heartbeats_within_the_timeout_keep_driving(pages):
    pages.drive()
    for _ in range(100):
        pages.now += 0.9 * HEARTBEAT_TIMEOUT_S
        assert pages.teleop.check_timeout(pages.now) is None
        assert pages.heartbeat('a', FORWARD) == FORWARD


def test_command_above_the_max_latency_stops(pages):
    pages.drive()
    assert pages.heartbeat('a', FORWARD, latency=MAX_LATENCY_S + 0.001) == STOP
    assert pages.heartbeat('a', FORWARD) is None


@pytest.mark.parametrize('latency', [float('nan'), float('inf'), -float('inf'), -1.0])
def test_impossible_frame_time_stops(pages, latency):
    pages.drive()
    assert pages.heartbeat('a', FORWARD, latency=latency) == STOP


def test_stop_counts_whatever_its_latency(pages):
    pages.drive()
    assert pages.heartbeat('a', STOP, latency=10.0) == STOP


def test_duplicate_and_out_of_order_heartbeats_are_dropped(pages):
    pages.heartbeat('a', STOP, number=1)
    assert pages.heartbeat('a', FORWARD, number=5) == FORWARD
    assert pages.heartbeat('a', STOP, number=6) == STOP
    assert pages.heartbeat('a', FORWARD, number=5) is None
    assert pages.heartbeat('a', FORWARD, number=6) is None


@pytest.mark.parametrize('twist', [(float('nan'), 0.0), (0.0, float('inf'))])
def test_command_that_is_not_finite_stops(pages, twist):
    pages.drive()
    assert pages.heartbeat('a', twist) == STOP
    assert pages.heartbeat('a', FORWARD) is None


def test_taking_control_stops_and_disarms(pages):
    pages.drive('a')
    pages.heartbeat('b', STOP)
    assert pages.teleop.take_control('b') == STOP
    assert pages.heartbeat('b', FORWARD) is None
    assert pages.heartbeat('a', FORWARD) is None
    pages.drive('b')


def test_stop_of_another_page_does_not_stop_the_driver(pages):
    pages.drive('a')
    assert pages.heartbeat('b', STOP) is None
    assert pages.heartbeat('b', (float('nan'), 0.0)) is None
    assert pages.teleop.is_moving


def test_leaving_page_stops_and_gives_up_control(pages):
    pages.drive('a')
    assert pages.teleop.leave('b') is None
    assert pages.teleop.leave('a') == STOP
    pages.drive('b')


def test_page_that_left_has_to_come_to_rest(pages):
    pages.drive('a')
    pages.teleop.leave('a')
    assert pages.heartbeat('a', FORWARD) is None


def test_stop_lasts_until_it_is_released(pages):
    pages.drive('a')
    assert pages.teleop.stop() == STOP
    pages.heartbeat('a', STOP)
    assert pages.heartbeat('a', FORWARD) is None
    pages.teleop.resume()
    pages.heartbeat('a', STOP)
    assert pages.heartbeat('a', FORWARD) == FORWARD


def test_key_held_through_a_stop_does_not_drive_after_it(pages):
    pages.drive('a')
    pages.teleop.stop()
    pages.teleop.resume()
    assert pages.heartbeat('a', FORWARD) is None


def assert_needs_release(pages, page, end):
    """Hold a key beyond the end of what prevents driving; assert that it drives after a rest."""
    assert pages.heartbeat(page, FORWARD) is None
    end()
    assert pages.heartbeat(page, FORWARD) is None
    assert pages.teleop.stop_reason(page)
    pages.drive(page)
    assert not pages.teleop.stop_reason(page)


def test_key_held_while_another_drives_needs_a_release(pages):
    pages.drive('a')
    pages.heartbeat('b', STOP)
    assert_needs_release(pages, 'b', lambda: pages.teleop.leave('a'))


def test_key_held_since_control_was_taken_needs_a_release(pages):
    pages.drive('a')
    pages.teleop.take_control('b')
    assert_needs_release(pages, 'a', lambda: pages.teleop.leave('b'))


def test_key_pressed_during_a_stop_needs_a_release(pages):
    pages.drive('a')
    pages.teleop.stop()
    pages.heartbeat('a', STOP)
    assert_needs_release(pages, 'a', pages.teleop.resume)


def test_invalid_heartbeat_stops_and_disarms(pages):
    pages.drive('a')
    assert pages.teleop.reject('a') == STOP
    assert pages.heartbeat('a', FORWARD) is None
    assert pages.teleop.reject('b') is None
    pages.drive('a')


def test_page_without_permission_is_stopped_and_disarmed(pages):
    pages.drive('a')
    assert pages.heartbeat('a', FORWARD, may_drive=False) == STOP
    assert pages.heartbeat('a', FORWARD) is None
    pages.drive('a')


def test_page_without_permission_does_not_get_control(pages):
    pages.heartbeat('a', STOP, may_drive=False)
    assert pages.heartbeat('a', FORWARD, may_drive=False) is None
    assert pages.teleop.driver is None
    pages.drive('a')


def test_disarm_publishes_one_stop_and_disarms_every_page(pages):
    pages.drive('a')
    pages.heartbeat('b', STOP)
    assert pages.teleop.disarm('odom is silent') == STOP
    assert pages.teleop.disarm('odom is silent') is None
    assert pages.teleop.stop_reason('a') == 'odom is silent'
    assert pages.heartbeat('a', FORWARD) is None
    pages.teleop.leave('a')
    assert pages.heartbeat('b', FORWARD) is None
    pages.drive('b')


@pytest.mark.parametrize(('latency', 'stop_count', 'expected'), [
    (0.0, 1, True), (MAX_LATENCY_S - 0.001, 1, True), (MAX_LATENCY_S + 0.001, 1, False),
    (-1.0, 1, False), (float('nan'), 1, False), (0.0, 0, False)])
def test_click_counts_if_its_page_showed_the_present_state(
        pages, latency, stop_count, expected):
    pages.teleop.stop()
    assert pages.teleop.is_current(
        pages.now - latency, stop_count, pages.now) is expected


EVENTS = st.lists(st.tuples(
    st.sampled_from([
        'drive', 'drive', 'drive', 'rest', 'take_control', 'leave', 'stop', 'resume', 'disarm']),
    st.sampled_from('abc'), st.floats(0.0, 0.5), st.floats(0.0, 0.6)), max_size=60)


@given(EVENTS)
def test_robot_moves_only_by_current_heartbeats_of_its_driver(events):
    """And stops within the heartbeat timeout."""
    pages = Pages()
    is_moving, driven_at = False, 0.0
    for kind, page, pause, latency in events:
        pages.now += pause
        twists = [pages.teleop.check_timeout(pages.now)]
        if kind in ('drive', 'rest'):
            command = FORWARD if kind == 'drive' else STOP
            twists.append(pages.heartbeat(page, command, latency=latency))
        else:
            act = getattr(pages.teleop, kind)
            twists.append(act(page) if kind in ('take_control', 'leave', 'disarm') else act())
        for twist in twists:
            if twist == FORWARD:
                assert (kind, pages.teleop.driver) == ('drive', page)
                assert latency <= MAX_LATENCY_S
                assert not pages.teleop.is_stopped
                is_moving, driven_at = True, pages.now
            elif twist == STOP:
                is_moving = False
        assert is_moving == pages.teleop.is_moving
        assert not is_moving or pages.now - driven_at <= HEARTBEAT_TIMEOUT_S


def test_page_above_the_max_latency_gets_a_reason(pages):
    pages.heartbeat('a', STOP)
    assert pages.heartbeat('a', FORWARD, latency=2.0 * MAX_LATENCY_S) is None
    assert pages.teleop.stop_reason('a')
    assert not pages.teleop.stop_reason('b')


def test_interrupted_page_gets_a_reason_until_it_drives(pages):
    pages.drive('a')
    assert pages.heartbeat('a', STOP, is_interrupted=True) == STOP
    pages.heartbeat('a', STOP)
    assert pages.teleop.stop_reason('a')
    pages.drive('a')
    assert not pages.teleop.stop_reason('a')


def test_rest_above_the_max_latency_arms() -> None:
    """After a slow moment nobody has to press twice; motion still needs a current frame."""
    teleop = Teleop()
    teleop.accept('page', Heartbeat(1, 0.0, (0.0, 0.0)), 100.0)
    assert teleop.accept('page', Heartbeat(2, 0.0, (0.3, 0.0)), 100.1) is None
    teleop.accept('page', Heartbeat(3, 0.0, (0.0, 0.0)), 100.2)
    assert teleop.accept('page', Heartbeat(4, 100.3, (0.3, 0.0)), 100.3) == (0.3, 0.0)


def test_keys_command_their_directions():
    assert twist_of_keys({'forward'}, LIMITS) == (0.37, 0.0)
    assert twist_of_keys({'backward'}, LIMITS) == (-0.37, 0.0)
    assert twist_of_keys({'left'}, LIMITS) == (0.0, 1.9)
    assert twist_of_keys({'forward', 'right'}, LIMITS) == (0.37, -1.9)


def test_opposite_keys_cancel_and_unknown_keys_are_ignored():
    assert twist_of_keys({'forward', 'backward', 'left', 'right', 'fly'}, LIMITS) == (0.0, 0.0)


def test_deflected_joystick_commands_the_limits():
    assert twist_of_joystick((0.0, 1.0), LIMITS) == pytest.approx((0.37, 0.0))
    assert twist_of_joystick((-1.0, 0.0), LIMITS) == pytest.approx((0.0, 1.9))
    assert twist_of_joystick((0.0, -1.0), LIMITS) == pytest.approx((-0.37, 0.0))


def test_joystick_in_its_dead_zone_stops():
    assert twist_of_joystick((0.07, -0.07), LIMITS) == (0.0, 0.0)


@given(UNIT, UNIT)
def test_joystick_never_exceeds_the_limits(right, forward):
    linear, angular = twist_of_joystick((right, forward), LIMITS)
    assert math.hypot(linear / LIMITS[0], angular / LIMITS[1]) <= 1.0 + 1e-9


@given(st.floats(0.0, 2.0 * math.pi), UNIT, UNIT)
def test_larger_deflection_is_never_slower(angle, a, b):
    near, far = sorted((abs(a), abs(b)))
    slow, fast = (
        math.hypot(*twist_of_joystick(
            (deflection * math.cos(angle), deflection * math.sin(angle)), (1.0, 1.0)))
        for deflection in (near, far))
    assert slow <= fast + 1e-9


@pytest.mark.parametrize('position', [(math.nan, 0.0), (0.0, math.inf), (1.0,), ('x', 0.0)])
def test_invalid_joystick_position_is_rejected(position):
    with pytest.raises(ValueError):  # noqa: PT011, whichever of them
        twist_of_joystick(position, LIMITS)


@given(st.floats(-50.0, 50.0), st.floats(-50.0, 50.0))
def test_saturated_twist_keeps_its_curvature(linear, angular):
    slow = saturate((linear, angular), LIMITS)
    assert abs(slow[0]) <= LIMITS[0] * (1 + 1e-9)
    assert abs(slow[1]) <= LIMITS[1] * (1 + 1e-9)
    assert slow[0] * angular == pytest.approx(slow[1] * linear, abs=1e-9)
