"""Faults of joint messages: the angles stay those of the drive without faults."""
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
# Further than any wheel turns in ten periods, and well below the range of the encoder.
jumps = st.floats(12.0, 0.45 * WRAP).flatmap(lambda size: st.sampled_from([size, -size]))


class DamagedDrive(RuleBasedStateMachine):
    """A drive of two wheels, the right one counting backward, through a sequence of faults."""

    @initialize(start=st.tuples(st.floats(0.0, WRAP), st.floats(0.0, WRAP)))
    def begin(self, start: tuple[float, float]) -> None:
        """Start with encoders at any value: the first sample is the baseline."""
        self.feedback = WheelFeedback(
            left_names=['left'], right_names=['right'], right_direction=-1, encoder_wrap=WRAP,
            max_plausible_speed=FASTEST)
        self.now = 1_700_000_000 * SECOND
        self.counter = list(start)  # of the encoders, before the wraparound
        self.turned = [0.0, 0.0]  # expected wheel angles of the last sample
        self.step = [0.0, 0.0]  # expected step of the next sample
        self.last = self.now
        first = self.send()
        self.first = first.left, first.right

    def move(self, step: tuple[float, float]) -> None:
        """Turn the wheels, and let a period pass."""
        self.now += DT
        for side, direction in ((0, 1), (1, -1)):
            self.counter[side] += direction * step[side]
            self.step[side] += step[side]

    def lose(self, jump: tuple[float, float]) -> None:
        """Let the encoders jump: the step until now is lost."""
        self.counter = [angle + by for angle, by in zip(self.counter, jump, strict=True)]
        self.step = [0.0, 0.0]

    def send(self, spoil: dict[int, float] | None = None, stamp: int | None = None,
             names: list[str] = NAMES) -> object:
        """Send the encoder positions, or other values for some sides."""
        values = [math.fmod(math.fmod(angle, WRAP) + WRAP, WRAP) for angle in self.counter]
        for side, value in (spoil or {}).items():
            values[side] = value
        by_name = dict(zip(NAMES, values, strict=True))
        return self.feedback.update(
            tuple(names), [by_name.get(name, 7.0) for name in names], [],
            self.now if stamp is None else stamp)

    def check(self, sample: object, time_reset: int | None = None) -> None:
        """Check the angles against the drive without faults, and the stamp."""
        assert sample is not None
        self.turned = [angle + by for angle, by in zip(self.turned, self.step, strict=True)]
        self.step = [0.0, 0.0]
        self.last = self.now
        assert (sample.stamp_ns, sample.time_reset_ns) == (self.now, time_reset)
        assert sample.left - self.first[0] == pytest.approx(self.turned[0], abs=1e-9)
        assert sample.right - self.first[1] == pytest.approx(self.turned[1], abs=1e-9)

    @rule(step=steps)
    def valid_sample(self, step: tuple[float, float]) -> None:
        """Include wraparounds in both directions."""
        self.move(step)
        self.check(self.send())

    @precondition(lambda self: self.now - self.last < 6 * DT)
    @rule(step=steps, side=sides, value=st.sampled_from([math.nan, math.inf, -math.inf, 1e300]))
    def not_finite_value(self, step: tuple[float, float], side: int, value: float) -> None:
        """Drop the message; the next one contains the motion."""
        self.move(step)
        assert self.send({side: value}) is None

    @rule(step=steps, after=steps, side=sides, jump=jumps)
    def glitch(self, step: tuple[float, float], after: tuple[float, float], side: int,
               jump: float) -> None:
        """Send one implausible position: no motion is lost."""
        self.move(step)
        assert self.send({side: self.counter[side] + jump}) is None
        assert 'max_plausible_wheel_speed' in self.feedback.warning
        self.move(after)
        self.check(self.send())

    @rule(step=steps, after=steps, jump=st.tuples(jumps, jumps))
    def encoder_reset(self, step: tuple[float, float], after: tuple[float, float],
                      jump: tuple[float, float]) -> None:
        """Lose only the step of the reset: the new values stay."""
        self.move(step)
        self.lose(jump)
        assert self.send() is None
        self.move(after)
        self.check(self.send())

    @rule(age=st.integers(0, SECOND - 1), spoiled=st.floats(-9.0, 9.0))
    def out_of_order_stamp(self, age: int, spoiled: float) -> None:
        """Drop duplicates and out-of-order messages."""
        assert self.send({0: spoiled}, stamp=self.last - age) is None

    @rule(step=steps, age=st.integers(2 * SECOND, 10**12), spoiled=st.floats(-9.0, 9.0))
    def late_message(self, step: tuple[float, float], age: int, spoiled: float) -> None:
        """Drop a single late message: it is no time reset."""
        assert self.send({0: spoiled}, stamp=self.last - age) is None
        self.move(step)
        self.check(self.send())

    @rule(back=st.integers(2 * SECOND, 10**12), after=steps, jump=st.tuples(jumps, jumps))
    def time_reset(self, back: int, after: tuple[float, float],
                   jump: tuple[float, float]) -> None:
        """Loop a bag, or restart a simulation; the encoders jump too."""
        self.now -= back
        self.lose(jump)
        assert self.send() is None
        time_reset = self.now
        self.move(after)
        self.check(self.send(), time_reset)

    @rule(step=steps, first=sides)
    def separate_messages(self, step: tuple[float, float], first: int) -> None:
        """Send one message a wheel: the second completes the sample."""
        self.move(step)
        assert self.send(names=[NAMES[first]], stamp=self.now - 1) is None
        assert self.feedback.missing_wheels == [NAMES[1 - first]]
        self.check(self.send(names=['arm', NAMES[1 - first]]))

    @rule(step=steps)
    def messages_without_wheels(self, step: tuple[float, float]) -> None:
        """Ignore messages of other joints and empty messages."""
        assert self.send(names=['arm', 'hand']) is None
        assert self.send(names=[]) is None

    @rule(step=steps, seconds=st.integers(1, 100))
    def gap(self, step: tuple[float, float], seconds: int) -> None:
        """Leave a gap: the next sample contains its motion."""
        self.now += seconds * SECOND
        self.move(step)
        self.check(self.send())


TestDamagedDrive = DamagedDrive.TestCase
TestDamagedDrive.settings = settings(
    max_examples=2000, stateful_step_count=12, deadline=None, derandomize=True)


def test_events_are_counted_by_name() -> None:
    """The names are keys of /diagnostics."""
    feedback = WheelFeedback(
        left_names=['l'], right_names=['r'], encoder_wrap=10.0, max_plausible_speed=50.0)

    def send(stamp_ms: int, left: float, right: float) -> None:
        feedback.update(['l', 'r'], [left, right], [], stamp_ms * 1_000_000)

    send(1000, 9.9, 0.0)
    send(1020, 0.1, 0.0)  # a wraparound
    send(1020, 0.2, 0.0)  # out of order
    send(1040, 4.0, 0.0)  # a glitch of the left wheel
    send(1060, 0.2, 0.0)
    send(1080, math.nan, 0.0)
    send(1100, 3.5, 0.0)  # a reset of the left wheel
    send(1120, 3.6, 0.0)
    feedback.update(['arm'], [1.0], [], 1_130_000_000)
    feedback.update(['l', 'r'], [1.0], [], 1_140_000_000)
    assert feedback.counts == {
        'wraparounds': 1, 'out_of_order': 1, 'glitches': 1, 'not_finite': 1, 'encoder_resets': 1,
        'without_wheels': 1, 'missing_values': 1}
    assert feedback.samples == 4


def test_velocity_gap_above_a_second_is_not_integrated() -> None:
    """The motion in a longer gap is unknown."""
    feedback = WheelFeedback(left_names=['l'], right_names=['r'], position_feedback=False)
    feedback.update(['l', 'r'], [], [3.0, 4.0], 0)
    after = feedback.update(['l', 'r'], [], [3.0, 4.0], 1_000_000_001)
    assert (after.left, after.right) == (0.0, 0.0)
    after = feedback.update(['l', 'r'], [], [3.0, 4.0], 1_500_000_001)
    assert (after.left, after.right) == (1.5, 2.0)


def test_implausible_velocities_are_dropped() -> None:
    """max_plausible_wheel_speed is a limit of velocities too."""
    feedback = WheelFeedback(
        left_names=['l'], right_names=['r'], position_feedback=False, max_plausible_speed=20.0)
    feedback.update(['l', 'r'], [], [3.0, 4.0], 0)
    assert feedback.update(['l', 'r'], [], [3.0, -20.1], 100_000_000) is None
    after = feedback.update(['l', 'r'], [], [3.0, 4.0], 200_000_000)
    assert (after.left, after.right) == pytest.approx((0.6, 0.8))
