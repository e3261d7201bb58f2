"""Whatever happens to the messages of a drive, the angles are those of the undamaged one."""
import math

from diffdrive_ros.core.wheel_feedback import WheelFeedback
from hypothesis import settings, strategies as st
from hypothesis.stateful import initialize, precondition, rule, RuleBasedStateMachine
import pytest

NAMES = ['left', 'right']
WRAP = 53.7  # [rad] range of the counters
FASTEST = 31.0  # [rad/s]
DT = 20_000_000  # [ns]
SECOND = 1_000_000_000

steps = st.tuples(*[st.floats(-0.5 * FASTEST * DT * 1e-9, 0.5 * FASTEST * DT * 1e-9)] * 2)
sides = st.sampled_from([0, 1])
# Further than any wheel turns in ten periods, and not nearly a whole range of the counter.
jumps = st.floats(12.0, 0.45 * WRAP).flatmap(lambda size: st.sampled_from([size, -size]))


class DamagedDrive(RuleBasedStateMachine):
    """Two wheels on a drive, the right of which counts backward, through fault after fault."""

    @initialize(start=st.tuples(st.floats(0.0, WRAP), st.floats(0.0, WRAP)))
    def begin(self, start: tuple[float, float]) -> None:
        """Start with encoders that say anything: the first sample is the baseline."""
        self.feedback = WheelFeedback(
            left_names=['left'], right_names=['right'], right_direction=-1, encoder_wrap=WRAP,
            max_plausible_speed=FASTEST)
        self.now = 1_700_000_000 * SECOND
        self.counter = list(start)  # of the encoders, before it wraps
        self.turned = [0.0, 0.0]  # what the samples should have told
        self.unheard = [0.0, 0.0]  # what the next sample should add to it
        self.last = self.now
        first = self.send()
        self.first = first.left, first.right

    def move(self, step: tuple[float, float]) -> None:
        """Turn the wheels, and let a period pass."""
        self.now += DT
        for side, direction in ((0, 1), (1, -1)):
            self.counter[side] += direction * step[side]
            self.unheard[side] += step[side]

    def lose(self, jump: tuple[float, float]) -> None:
        """Let the counters jump: what was not heard until now never will be."""
        self.counter = [angle + by for angle, by in zip(self.counter, jump, strict=True)]
        self.unheard = [0.0, 0.0]

    def send(self, spoil: dict[int, float] | None = None, stamp: int | None = None,
             names: list[str] = NAMES) -> object:
        """Send what the encoders say, or something else for some sides."""
        values = [math.fmod(math.fmod(angle, WRAP) + WRAP, WRAP) for angle in self.counter]
        for side, value in (spoil or {}).items():
            values[side] = value
        by_name = dict(zip(NAMES, values, strict=True))
        return self.feedback.update(
            tuple(names), [by_name.get(name, 7.0) for name in names], [],
            self.now if stamp is None else stamp)

    def check(self, sample: object, restarted: int | None = None) -> None:
        """Check that the angles are those of the undamaged drive, and the stamp the message's."""
        assert sample is not None
        self.turned = [angle + by for angle, by in zip(self.turned, self.unheard, strict=True)]
        self.unheard = [0.0, 0.0]
        self.last = self.now
        assert (sample.stamp_ns, sample.restarted_ns) == (self.now, restarted)
        assert sample.left - self.first[0] == pytest.approx(self.turned[0], abs=1e-9)
        assert sample.right - self.first[1] == pytest.approx(self.turned[1], abs=1e-9)

    @rule(step=steps)
    def an_ordinary_sample(self, step: tuple[float, float]) -> None:
        """With wraps of the counters in both directions in between."""
        self.move(step)
        self.check(self.send())

    @precondition(lambda self: self.now - self.last < 6 * DT)
    @rule(step=steps, side=sides, value=st.sampled_from([math.nan, math.inf, -math.inf, 1e300]))
    def a_value_that_is_none(self, step: tuple[float, float], side: int, value: float) -> None:
        """Not taken; the next carries the motion."""
        self.move(step)
        assert self.send({side: value}) is None

    @rule(step=steps, after=steps, side=sides, jump=jumps)
    def a_glitch(self, step: tuple[float, float], after: tuple[float, float], side: int,
                 jump: float) -> None:
        """Comes alone: nothing is lost."""
        self.move(step)
        assert self.send({side: self.counter[side] + jump}) is None
        assert 'max_plausible_wheel_speed' in self.feedback.complaint
        self.move(after)
        self.check(self.send())

    @rule(step=steps, after=steps, jump=st.tuples(jumps, jumps))
    def a_reset_of_the_counters(self, step: tuple[float, float], after: tuple[float, float],
                                jump: tuple[float, float]) -> None:
        """Stays: what was not heard until then is lost, and nothing else."""
        self.move(step)
        self.lose(jump)
        assert self.send() is None
        self.move(after)
        self.check(self.send())

    @rule(age=st.integers(0, SECOND - 1), spoiled=st.floats(-9.0, 9.0))
    def a_stamp_that_is_not_newer(self, age: int, spoiled: float) -> None:
        """Duplicates and messages out of order are passed over."""
        assert self.send({0: spoiled}, stamp=self.last - age) is None

    @rule(step=steps, age=st.integers(2 * SECOND, 10**12), spoiled=st.floats(-9.0, 9.0))
    def a_straggler(self, step: tuple[float, float], age: int, spoiled: float) -> None:
        """One message from long ago is no restart of time."""
        assert self.send({0: spoiled}, stamp=self.last - age) is None
        self.move(step)
        self.check(self.send())

    @rule(back=st.integers(2 * SECOND, 10**12), after=steps, jump=st.tuples(jumps, jumps))
    def time_starts_again(self, back: int, after: tuple[float, float],
                          jump: tuple[float, float]) -> None:
        """Go on in a bag that loops, or a simulation that is reset, encoders and all."""
        self.now -= back
        self.lose(jump)
        assert self.send() is None
        restarted = self.now
        self.move(after)
        self.check(self.send(), restarted)

    @rule(step=steps, first=sides)
    def the_wheels_come_apart(self, step: tuple[float, float], first: int) -> None:
        """One message a wheel: the sample is complete with the second."""
        self.move(step)
        assert self.send(names=[NAMES[first]], stamp=self.now - 1) is None
        assert self.feedback.waits_for == [NAMES[1 - first]]
        self.check(self.send(names=['arm', NAMES[1 - first]]))

    @rule(step=steps)
    def other_joints_come_between(self, step: tuple[float, float]) -> None:
        """Send what has to be passed over, empty messages too."""
        assert self.send(names=['arm', 'hand']) is None
        assert self.send(names=[]) is None

    @rule(step=steps, seconds=st.integers(1, 100))
    def the_driver_pauses(self, step: tuple[float, float], seconds: int) -> None:
        """Until the next sample, which carries the motion."""
        self.now += seconds * SECOND
        self.move(step)
        self.check(self.send())


TestDamagedDrive = DamagedDrive.TestCase
TestDamagedDrive.settings = settings(
    max_examples=2000, stateful_step_count=12, deadline=None, derandomize=True)


def test_what_happened_is_counted() -> None:
    """By the words in which diagnostics say it."""
    feedback = WheelFeedback(
        left_names=['l'], right_names=['r'], encoder_wrap=10.0, max_plausible_speed=50.0)

    def say(stamp_ms: int, left: float, right: float) -> None:
        feedback.update(['l', 'r'], [left, right], [], stamp_ms * 1_000_000)

    say(1000, 9.9, 0.0)
    say(1020, 0.1, 0.0)  # a wrap
    say(1020, 0.2, 0.0)  # not newer
    say(1040, 4.0, 0.0)  # a glitch of the left wheel
    say(1060, 0.2, 0.0)
    say(1080, math.nan, 0.0)
    say(1100, 3.5, 0.0)  # a reset of the left wheel
    say(1120, 3.6, 0.0)
    feedback.update(['arm'], [1.0], [], 1_130_000_000)
    feedback.update(['l', 'r'], [1.0], [], 1_140_000_000)
    assert feedback.counts == {
        'wraps': 1, 'not newer': 1, 'glitches': 1, 'not finite': 1, 'counter resets': 1,
        'without our wheels': 1, 'without a value': 1}
    assert feedback.samples == 4


def test_a_velocity_says_nothing_about_a_long_silence() -> None:
    """A driver that paused for longer than a second left the wheels' motion unknown."""
    feedback = WheelFeedback(left_names=['l'], right_names=['r'], position_feedback=False)
    feedback.update(['l', 'r'], [], [3.0, 4.0], 0)
    after = feedback.update(['l', 'r'], [], [3.0, 4.0], 1_000_000_001)
    assert (after.left, after.right) == (0.0, 0.0)
    after = feedback.update(['l', 'r'], [], [3.0, 4.0], 1_500_000_001)
    assert (after.left, after.right) == (1.5, 2.0)


def test_a_velocity_that_no_wheel_reaches_is_dropped() -> None:
    """max_plausible_wheel_speed holds for velocities too."""
    feedback = WheelFeedback(
        left_names=['l'], right_names=['r'], position_feedback=False, max_plausible_speed=20.0)
    feedback.update(['l', 'r'], [], [3.0, 4.0], 0)
    assert feedback.update(['l', 'r'], [], [3.0, -20.1], 100_000_000) is None
    after = feedback.update(['l', 'r'], [], [3.0, 4.0], 200_000_000)
    assert (after.left, after.right) == pytest.approx((0.6, 0.8))
