"""The parameter file without ROS: read as the node reads it, by the node's rules."""
import math

from diffdrive_ros.core.parameter_specs import ODOMETRY
from diffdrive_ros.tools import parameter_file
from diffdrive_ros.tools.parameter_file import ParameterFileError, RobotParameters
import pytest

GOOD = """/**/odometry:
  ros__parameters:
    wheel_separation: 0.31
    wheel_radius: 0.05
"""


def read(folder, text):
    """Return the robot of a file with this text."""
    path = folder / 'robot.yaml'
    path.write_text(text)
    return parameter_file.read(path)


@pytest.mark.parametrize(('text', 'value'), [
    ('5e-6', 5e-6), ('5E-6', 5e-6), ('1e3', 1000.0), ('2.e-5', 2e-5), ('.5e-5', 5e-6),
    ('5.0e-06', 5e-6), ('1', 1), ('.5', 0.5),
])
def test_a_number_is_what_rcl_reads(tmp_path, text, value):
    robot = read(tmp_path, f'{GOOD}    turn_variance: {text}\n    cmd_vel_timeout: {text}\n')
    assert robot.config.noise.turn == value
    assert robot.values['cmd_vel_timeout'] == value


def test_what_is_written_is_what_was_read_to_the_last_digit(tmp_path):
    values = {
        'wheel_separation': 0.1 + 0.2, 'wheel_radius': 1.0 / 19.0, 'turn_variance': 1.0 / 3e7,
        'left_wheel_names': ["it's", 'b'], 'right_wheel_names': ['c', 'd'],
        'cmd_vel_timeout': 1e22, 'open_loop': False, 'odom_frame_id': '5e-6',
        'linear.x.max_velocity': math.inf}
    path = tmp_path / 'robot.yaml'
    parameter_file.write(path, values, {}, 'Written.')
    assert parameter_file.read(path).values == values


@pytest.mark.parametrize('text', [
    '', '/**/odometry', 'odometry:\n  ros__par', 'odometry: [1, 2]', '[1, 2]', '"unfinished',
    '/**/odometry:\n  ros__parameters:\n    wheel_radius', 'odometry:\n  ros__parameters: [1]',
    "/**/odometry:\n  ros__parameters:\n    left_wheel_names: ['left_whe", 'a: 2020-13-45',
    '\0',
])
def test_half_a_file_is_refused_in_one_line(tmp_path, text):
    with pytest.raises(ParameterFileError) as error:
        read(tmp_path, text)
    assert str(error.value).startswith(f'{tmp_path}/robot.yaml: ')
    assert '\n' not in str(error.value)


@pytest.mark.parametrize(('text', 'rule'), [
    ('left_wheel_direction: 7', 'left_wheel_direction = 7: must be 1 or -1'),
    ('left_wheel_direction: x', "left_wheel_direction = 'x': must be an integer"),
    ('left_wheel_direction: 1.0', 'left_wheel_direction = 1.0: must be an integer'),
    ('left_wheel_names: [right_wheel_joint]', 'must not share right_wheel_joint with left_wheel'),
    ('left_wheel_names: abc', "left_wheel_names = 'abc': must be a list"),
    ('left_wheel_names: []', 'left_wheel_names = []: must be a list of one or more'),
    ('left_wheel_names: null', 'left_wheel_names = null: must have a value'),
    ('left_wheel_names: [[a]]', 'left_wheel_names = [['),
    ('left_wheel_names: [a, b]', 'must be as many as left_wheel_names, 2'),
    ("position_feedback: 'false'", "position_feedback = 'false': must be a bool"),
    ('wheel_separation_multiplier: 50.0', 'wheel_separation_multiplier = 50.0: must be from 0.1'),
    ('wheel_seperation: 0.4', 'wheel_seperation = 0.4: is no parameter; is it wheel_separation?'),
    ('left_wheel_radius: 0.05', 'left_wheel_radius = 0.05: is no parameter; is it'),
    ('right_wheel_radius: 0.05', 'right_wheel_radius = 0.05: is no parameter; is it'),
    ('encoder_wrap: 0.0', 'encoder_wrap = 0.0: must be positive and finite, or .nan'),
    ('encoder_wrap: abc', "encoder_wrap = 'abc': must be a double"),
    ('turn_variance: -1.0', 'turn_variance = -1.0: must be finite and zero or more'),
    ('left_wheel_travel_variance: -1', 'left_wheel_travel_variance = -1.0: must be finite and'),
    ('wheel_separation_std: .nan', 'wheel_separation_std = nan: must be finite'),
    ('velocity_rolling_window_size: 5.5', 'velocity_rolling_window_size = 5.5: must be an int'),
    ('command_rate: null', 'command_rate = null: must have a value'),
])
def test_a_parameter_keeps_the_rule_of_the_node_and_the_line_names_it(tmp_path, text, rule):
    right = '    right_wheel_names: [right_wheel_joint]\n' if 'wheel_names' in text else ''
    with pytest.raises(ParameterFileError) as error:
        read(tmp_path, f'{GOOD}{right}    {text}\n')
    assert rule in str(error.value)


def test_a_key_that_is_not_the_nodes_is_named(tmp_path):
    with pytest.raises(ParameterFileError, match='no key that is the node /odometry, but /r1/odo'):
        read(tmp_path, GOOD.replace('/**/odometry', '/r1/odometry'))


def test_every_parameter_of_the_node_may_stand_in_the_file():
    RobotParameters.of(
        {spec.name: spec.default for spec in ODOMETRY} | {'use_sim_time': False, 'type': 'x'})


def test_a_parameter_of_the_node_that_odometry_does_not_need_keeps_its_rule_too(tmp_path):
    with pytest.raises(ParameterFileError, match=r'command_rate = 0\.5: must be from 1 to'):
        read(tmp_path, f'{GOOD}    command_rate: 0.5\n')
    with pytest.raises(ParameterFileError, match=r'linear\.x\.min_velocity = 1\.0: must be zero'):
        read(tmp_path, f'{GOOD}    linear: {{x: {{max_velocity: 1.0, min_velocity: 1.0}}}}\n')
