"""The parameter file without ROS: read as rclpy reads it, by the rules of the node."""
from array import array
import itertools
import math

from diffdrive_ros.core.parameter_specs import ODOMETRY
from diffdrive_ros.core.validation import UserError
from diffdrive_ros.tools import parameter_file
from diffdrive_ros.tools.parameter_file import RobotParameters
import pytest
from rclpy.context import Context
from rclpy.node import Node

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
def test_number_is_read_as_by_rcl(tmp_path, text, value):
    robot = read(tmp_path, f'{GOOD}    turn_variance: {text}\n    cmd_vel_timeout: {text}\n')
    assert robot.config.noise.turn == value
    assert robot.values['cmd_vel_timeout'] == value


def test_written_values_are_read_back_to_the_last_digit(tmp_path):
    values = {
        'wheel_separation': 0.1 + 0.2, 'wheel_radius': 1.0 / 19.0, 'turn_variance': 1.0 / 3e7,
        'left_wheel_names': ["it's", 'b'], 'right_wheel_names': ['c', 'd'],
        'cmd_vel_timeout': 1e22, 'open_loop': False, 'odom_frame_id': '5e-6',
        'linear.x.max_velocity': math.inf, 'robot_description': '<a>\n  <b/>\n</a>\n',
        'max_wheel_speed': math.nan}
    path = tmp_path / 'robot.yaml'
    parameter_file.write(path, RobotParameters.of(values), {}, 'Written.')
    read = parameter_file.read(path).values
    assert math.isnan(read.pop('max_wheel_speed'))
    assert math.isnan(values.pop('max_wheel_speed'))
    assert read == values


@pytest.mark.parametrize('text', [
    '', '/**/odometry', 'odometry:\n  ros__par', 'odometry: [1, 2]', '[1, 2]', '"unfinished',
    '/**/odometry:\n  ros__parameters:\n    wheel_radius', 'odometry:\n  ros__parameters: [1]',
    "/**/odometry:\n  ros__parameters:\n    left_wheel_names: ['left_whe", 'a: 2020-13-45',
    '\0',
])
def test_truncated_file_is_rejected_in_one_line(tmp_path, text):
    with pytest.raises(UserError) as error:
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
def test_parameter_that_breaks_its_rule_is_named(tmp_path, text, rule):
    right = '    right_wheel_names: [right_wheel_joint]\n' if 'wheel_names' in text else ''
    with pytest.raises(UserError) as error:
        read(tmp_path, f'{GOOD}{right}    {text}\n')
    assert rule in str(error.value)


ROBOTS = GOOD.replace('/**/odometry', 'robot1/odometry') + """
robot2:
  odometry:
    ros__parameters:
      wheel_separation: 0.32
      wheel_radius: 0.05
      tf_frame_prefix: '~'
"""


@pytest.mark.parametrize(('section', 'node'), [
    ('/**/odometry', '/odometry'), ('/**', '/odometry'), ('/*', '/odometry'),
    ('odometry', '/odometry'), ('/robot1/odometry', '/robot1/odometry'),
    ('diff_drive_controller', '/diff_drive_controller'),
    ('/**/diff_drive_controller', '/diff_drive_controller'),
])
def test_only_section_is_that_of_the_node(tmp_path, section, node):
    robot = read(tmp_path, GOOD.replace('/**/odometry', section))
    assert robot.node == node
    assert robot.config.drive.wheel_separation == 0.31


def test_node_is_selected_by_its_full_name(tmp_path):
    path = tmp_path / 'robot.yaml'
    path.write_text(ROBOTS)
    robot = parameter_file.read(path, 'robot2/odometry')
    assert robot.config.drive.wheel_separation == 0.32
    assert robot.config.odom_frame == 'robot2/odom'
    assert parameter_file.read(path, '/robot1/odometry').config.drive.wheel_separation == 0.31


@pytest.mark.parametrize(('text', 'node', 'rule'), [
    (ROBOTS, None, 'has the nodes /robot1/odometry, /robot2/odometry: --node must name one'),
    (ROBOTS, '/odometry', 'has no section of the node /odometry, but /robot1/odometry, /robot2'),
    (GOOD.replace('/**/odometry', '/r1/odom'), None,
     'no section of the node /odometry or /diff_drive_controller, but /r1/odom; --node names'),
    (GOOD.replace('/**/odometry', '/*/odometry'), None, 'but /\\*/odometry; --node names'),
])
def test_ambiguous_or_missing_node_is_rejected(tmp_path, text, node, rule):
    path = tmp_path / 'robot.yaml'
    path.write_text(text)
    with pytest.raises(UserError, match=rule):
        parameter_file.read(path, node)


@pytest.mark.parametrize('text', [
    '5e-6', '1', '.5', '1.', '+3', '010', '089', '0x1F', '1_000', '1:30', '2020-01-02', 'nan',
    '.nan', 'NaN', '-.inf', 'inf', '-Infinity', 'y', 'Off', 'yes', '"5"', "'nan'", 'left',
    '[1.0, nan]', '[1, 2]', '[a, b]'])
def test_values_are_those_of_rclpy(tmp_path, text):
    values = read(tmp_path, f'{GOOD}    other: {text}\n').values
    assert repr(values) == repr(values_of_rclpy(tmp_path / 'robot.yaml', '/odometry'))


@pytest.mark.parametrize('node', ['/odometry', '/robot1/odometry', '/a/b/odometry'])
@pytest.mark.parametrize('names', list(itertools.permutations(
    ['/**', 'odometry', '/robot1/odometry', '/*/odometry', '/**/odometry'], 2)))
def test_sections_are_merged_as_in_rclpy(tmp_path, node, names):
    path = tmp_path / 'robot.yaml'
    path.write_text(GOOD.replace('/**/odometry', '/**/*') + ''.join(
        f'{name}:\n  ros__parameters:\n    command_rate: {number}.0\n    last: {name}\n'
        for number, name in enumerate(names, 1)))
    values = parameter_file.read(path, node).values
    assert values == values_of_rclpy(path, node)


def values_of_rclpy(path, name):
    """Return the parameters that a node of rclpy gets from a file."""
    namespace, _, base = name.rpartition('/')
    context = Context()
    context.init(args=['--ros-args', '--params-file', str(path)])
    try:
        node = Node(base, namespace=namespace, context=context, start_parameter_services=False,
                    enable_rosout=False)
        values = {name: parameter.value for name, parameter in node._parameter_overrides.items()}
        node.destroy_node()
    finally:
        context.try_shutdown()
    return {name: list(value) if isinstance(value, array) else value
            for name, value in values.items()}


def test_file_may_have_every_parameter_of_the_node():
    RobotParameters.of(
        {spec.name: spec.default for spec in ODOMETRY} | {'use_sim_time': False, 'type': 'x'})


def test_parameter_of_commands_is_checked_too(tmp_path):
    with pytest.raises(UserError, match=r'command_rate = 0\.5: must be from 1 to'):
        read(tmp_path, f'{GOOD}    command_rate: 0.5\n')
    with pytest.raises(UserError, match=r'linear\.x\.min_velocity = 1\.0: must be zero'):
        read(tmp_path, f'{GOOD}    linear: {{x: {{max_velocity: 1.0, min_velocity: 1.0}}}}\n')
