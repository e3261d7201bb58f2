"""The robot moves only while the page that drives says so, freshly."""
from diffdrive_ros.dashboard.teleop import Beat, LONGEST_SILENCE, OLDEST_SIGHT, Pilot, STOP
from hypothesis import given, strategies as st
import pytest

AHEAD = (0.3, 0.0)


class Hands:
    """Pages at a pilot, at a time that stands still unless a test moves it."""

    def __init__(self) -> None:
        self.pilot, self.now, self._number = Pilot(), 100.0, 0

    def beat(self, page, twist, *, seen=0.0, number=None, lost=False,
             may_drive=True):
        """Send a beat of a page whose picture is seen seconds old."""
        self._number += 1
        return self.pilot.beat(page, Beat(
            self._number if number is None else number, self.now - seen, twist, lost, may_drive),
            self.now)

    def drive(self, page='a'):
        """Let a page drive that was at rest before."""
        self.beat(page, STOP)
        assert self.beat(page, AHEAD) == AHEAD


@pytest.fixture
def hands() -> Hands:
    """Return a pilot with nobody at it."""
    return Hands()


def test_a_free_wheel_goes_to_the_first_that_asks_for_motion(hands):
    hands.drive('a')
    hands.beat('b', STOP)
    assert hands.beat('b', AHEAD) is None
    assert hands.pilot.driver == 'a'


def test_controls_that_were_never_at_rest_do_not_drive(hands):
    assert hands.beat('a', AHEAD) is None
    assert hands.pilot.driver is None


def test_release_stops_once_and_then_leaves_the_topic_to_others(hands):
    hands.drive()
    assert hands.beat('a', STOP) == STOP
    assert hands.beat('a', STOP) is None


def test_silence_stops_once_and_motion_needs_a_new_touch(hands):
    hands.drive()
    hands.now += LONGEST_SILENCE + 0.001
    assert hands.pilot.watch(hands.now) == STOP
    assert hands.pilot.watch(hands.now) is None
    assert hands.beat('a', AHEAD) is None
    assert hands.pilot.complaint('a')
    hands.drive()
    assert not hands.pilot.complaint('a')


def test_beats_that_come_keep_the_robot_in_motion(hands):
    hands.drive()
    for _ in range(100):
        hands.now += 0.9 * LONGEST_SILENCE
        assert hands.pilot.watch(hands.now) is None
        assert hands.beat('a', AHEAD) == AHEAD


def test_a_command_that_waited_on_its_way_stops_the_robot(hands):
    hands.drive()
    assert hands.beat('a', AHEAD, seen=OLDEST_SIGHT + 0.001) == STOP
    assert hands.beat('a', AHEAD) is None


@pytest.mark.parametrize('seen', [float('nan'), float('inf'), -float('inf'), -1.0])
def test_a_picture_that_cannot_have_been_seen_drives_nothing(hands, seen):
    hands.drive()
    assert hands.beat('a', AHEAD, seen=seen) == STOP


def test_a_late_wish_to_stop_stops(hands):
    hands.drive()
    assert hands.beat('a', STOP, seen=10.0) == STOP


def test_a_beat_that_was_overtaken_or_comes_twice_is_not_driven(hands):
    hands.beat('a', STOP, number=1)
    assert hands.beat('a', AHEAD, number=5) == AHEAD
    assert hands.beat('a', STOP, number=6) == STOP
    assert hands.beat('a', AHEAD, number=5) is None
    assert hands.beat('a', AHEAD, number=6) is None


@pytest.mark.parametrize('twist', [(float('nan'), 0.0), (0.0, float('inf'))])
def test_what_is_not_finite_stops(hands, twist):
    hands.drive()
    assert hands.beat('a', twist) == STOP
    assert hands.beat('a', AHEAD) is None


def test_taking_the_wheel_stops_the_robot_and_needs_a_new_touch(hands):
    hands.drive('a')
    hands.beat('b', STOP)
    assert hands.pilot.take('b') == STOP
    assert hands.beat('b', AHEAD) is None
    assert hands.beat('a', AHEAD) is None
    hands.drive('b')


def test_the_rest_of_one_who_watches_does_not_stop_the_one_who_drives(hands):
    hands.drive('a')
    assert hands.beat('b', STOP) is None
    assert hands.beat('b', (float('nan'), 0.0)) is None
    assert hands.pilot.is_moving


def test_leaving_stops_and_frees_the_wheel(hands):
    hands.drive('a')
    assert hands.pilot.leave('b') is None
    assert hands.pilot.leave('a') == STOP
    hands.drive('b')


def test_a_page_that_left_has_to_be_at_rest_again(hands):
    hands.drive('a')
    hands.pilot.leave('a')
    assert hands.beat('a', AHEAD) is None


def test_a_stop_holds_everybody_until_it_is_released(hands):
    hands.drive('a')
    assert hands.pilot.stop() == STOP
    hands.beat('a', STOP)
    assert hands.beat('a', AHEAD) is None
    hands.pilot.resume()
    hands.beat('a', STOP)
    assert hands.beat('a', AHEAD) == AHEAD


def test_keys_held_through_a_stop_do_not_drive_when_it_is_released(hands):
    hands.drive('a')
    hands.pilot.stop()
    hands.pilot.resume()
    assert hands.beat('a', AHEAD) is None


def hold_until(hands, page, is_over):
    """Hold a key that is not driven until that would be possible; assert that it needs a rest."""
    assert hands.beat(page, AHEAD) is None
    is_over()
    assert hands.beat(page, AHEAD) is None
    assert hands.pilot.complaint(page)
    hands.drive(page)
    assert not hands.pilot.complaint(page)


def test_a_key_held_by_one_who_watches_does_not_drive_when_the_driver_leaves(hands):
    hands.drive('a')
    hands.beat('b', STOP)
    hold_until(hands, 'b', lambda: hands.pilot.leave('a'))


def test_a_key_held_by_who_drove_before_does_not_drive_when_the_taker_leaves(hands):
    hands.drive('a')
    hands.pilot.take('b')
    hold_until(hands, 'a', lambda: hands.pilot.leave('b'))


def test_a_key_pressed_during_a_stop_does_not_drive_when_it_is_released(hands):
    hands.drive('a')
    hands.pilot.stop()
    hands.beat('a', STOP)
    hold_until(hands, 'a', hands.pilot.resume)


def test_a_beat_that_cannot_be_understood_stops_and_those_after_a_rest_are_driven(hands):
    hands.drive('a')
    assert hands.pilot.distrust('a') == STOP
    assert hands.beat('a', AHEAD) is None
    assert hands.pilot.distrust('b') is None
    hands.drive('a')


def test_a_page_that_may_not_drive_is_stopped_and_has_to_come_to_rest_when_it_may(hands):
    hands.drive('a')
    assert hands.beat('a', AHEAD, may_drive=False) == STOP
    assert hands.beat('a', AHEAD) is None
    hands.drive('a')


def test_who_may_not_drive_gets_no_wheel_but_may_come_to_rest(hands):
    hands.beat('a', STOP, may_drive=False)
    assert hands.beat('a', AHEAD, may_drive=False) is None
    assert hands.pilot.driver is None
    hands.drive('a')


def test_a_robot_that_may_not_be_driven_stops_once_and_everybody_has_to_come_to_rest(hands):
    hands.drive('a')
    hands.beat('b', STOP)
    assert hands.pilot.disarm('odom is silent') == STOP
    assert hands.pilot.disarm('odom is silent') is None
    assert hands.pilot.complaint('a') == 'odom is silent'
    assert hands.beat('a', AHEAD) is None
    hands.pilot.leave('a')
    assert hands.beat('b', AHEAD) is None
    hands.drive('b')


@pytest.mark.parametrize(('seen', 'stops', 'is_so'), [
    (0.0, 1, True), (OLDEST_SIGHT - 0.001, 1, True), (OLDEST_SIGHT + 0.001, 1, False),
    (-1.0, 1, False), (float('nan'), 1, False), (0.0, 0, False)])
def test_a_click_counts_if_its_page_showed_how_things_stand(hands, seen, stops, is_so):
    hands.pilot.stop()
    assert hands.pilot.sees(hands.now - seen, stops, hands.now) is is_so


EVENTS = st.lists(st.tuples(
    st.sampled_from([
        'beat', 'beat', 'beat', 'rest', 'take', 'leave', 'stop', 'resume', 'disarm']),
    st.sampled_from('abc'), st.floats(0.0, 0.5), st.floats(0.0, 0.6)), max_size=60)


@given(EVENTS)
def test_whatever_happens_a_moving_robot_was_asked_to_by_its_driver_just_now(events):
    """Motion follows from a fresh beat of the driver alone, and ends within the silence."""
    hands = Hands()
    moving, beat_at = False, 0.0
    for kind, page, pause, seen in events:
        hands.now += pause
        said = [hands.pilot.watch(hands.now)]
        if kind in ('beat', 'rest'):
            said.append(hands.beat(page, AHEAD if kind == 'beat' else STOP, seen=seen))
        else:
            act = getattr(hands.pilot, kind)
            said.append(act(page) if kind in ('take', 'leave', 'disarm') else act())
        for twist in said:
            if twist == AHEAD:
                assert (kind, hands.pilot.driver) == ('beat', page)
                assert seen <= OLDEST_SIGHT
                assert not hands.pilot.is_stopped
                moving, beat_at = True, hands.now
            elif twist == STOP:
                moving = False
        assert moving == hands.pilot.is_moving
        assert not moving or hands.now - beat_at <= LONGEST_SILENCE


def test_who_was_too_slow_to_get_the_wheel_is_told_so(hands):
    hands.beat('a', STOP)
    assert hands.beat('a', AHEAD, seen=2.0 * OLDEST_SIGHT) is None
    assert hands.pilot.complaint('a')
    assert not hands.pilot.complaint('b')


def test_who_lost_hold_of_the_controls_is_told_so_until_they_are_touched_again(hands):
    hands.drive('a')
    assert hands.beat('a', STOP, lost=True) == STOP
    hands.beat('a', STOP)
    assert hands.pilot.complaint('a')
    hands.drive('a')
    assert not hands.pilot.complaint('a')


def test_a_rest_counts_however_old_the_picture_was() -> None:
    """After a slow moment nobody has to press twice; motion still needs a picture of now."""
    pilot = Pilot()
    pilot.beat('page', Beat(1, 0.0, (0.0, 0.0)), 100.0)
    assert pilot.beat('page', Beat(2, 0.0, (0.3, 0.0)), 100.1) is None
    pilot.beat('page', Beat(3, 0.0, (0.0, 0.0)), 100.2)
    assert pilot.beat('page', Beat(4, 100.3, (0.3, 0.0)), 100.3) == (0.3, 0.0)
