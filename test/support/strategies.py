"""Strategies of Hypothesis: geometries, poses and twists of plausible size, with edge cases."""
import math

from diffdrive_ros.core.kinematics import DiffDrive
from hypothesis import strategies as st

metres = st.floats(-10.0, 10.0)
half_turns = st.one_of(
    st.floats(-math.pi, math.pi, exclude_min=True),
    st.sampled_from([0.0, 1e-18, -1e-17, 1e-8, -1e-8, -math.pi / 2, math.pi]))
"""Angles within (-pi, pi]: the range of se2.log."""
many_turns = st.one_of(st.floats(-20.0, 20.0), half_turns)

points = st.tuples(metres, metres)
poses = st.tuples(metres, metres, many_turns)
twists = st.tuples(metres, metres, many_turns)

drives = st.builds(DiffDrive, st.floats(0.05, 2.0), st.floats(0.02, 0.5), st.floats(0.02, 0.5))
wheel_steps = st.lists(
    st.tuples(st.floats(-60.0, 60.0), st.floats(-60.0, 60.0)), min_size=1, max_size=20)
"""Increments of the left and the right wheel angle from sample to sample [rad]."""
