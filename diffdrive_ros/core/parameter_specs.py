"""
Parameters of the nodes: name, type, default, unit, rule, and whether each is live.

The nodes declare them, the tools validate parameter files by them, and the documents list them.
Names and meanings are those of diff_drive_controller, releases 4 to 6, where it has the parameter.
A double that is not set is .nan, as there.
"""
from array import array
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
import math
from typing import Any

from diffdrive_ros.core.odometry import UNKNOWN_VARIANCE, WheelNoise

Values = Mapping[str, Any]


class ParameterError(ValueError):
    """A parameter breaks its rule; the message names it, its value and the rule."""

    def __init__(self, name: str, value: object, rule: str) -> None:
        super().__init__(f'{name} = {value}: {rule}')


@dataclass(frozen=True)
class Rule:
    """The condition of a valid value, as text and as a predicate."""

    text: str
    is_met: Callable[[Any], bool]


@dataclass(frozen=True)
class ParameterSpec:
    """
    One parameter; its type is that of its default.

    unit is '' if it has none. A live parameter may be set at run time.
    """

    name: str
    default: bool | int | float | str | list[str] | list[float]
    unit: str
    description: str
    rule: Rule = Rule('', lambda value: True)
    live: bool = False

    def check(self, value: object) -> None:
        """Raise ParameterError unless the value has the type and meets the rule."""
        if not self._is_of_type(value):
            raise ParameterError(self.name, repr(value), f'must be {self.type_name}')
        if not self.rule.is_met(value):
            raise ParameterError(self.name, repr(value), self.rule.text)

    def converted(self, value: object) -> object:
        """Return an integer given for a double as a double: 1 means 1.0."""
        if type(value) is int and type(self.default) is float:
            return float(value)
        if isinstance(self.default, list) and isinstance(value, (list, tuple, array)):
            is_float = isinstance(self.default[0], float)
            return [float(item) if is_float and type(item) is int else item for item in value]
        return value

    @property
    def type_name(self) -> str:
        """Return the type with its article."""
        if isinstance(self.default, list):
            return f'a list of {_TYPES[type(self.default[0])].split()[1]}s'
        return _TYPES[type(self.default)]

    def _is_of_type(self, value: object) -> bool:
        if isinstance(self.default, list):
            return isinstance(value, list) and all(
                type(item) is type(self.default[0]) for item in value)
        return type(value) is type(self.default)


_TYPES = {bool: 'a bool', int: 'an integer', float: 'a double', str: 'a string'}


def checked_values(specs: Sequence[ParameterSpec], given: Values) -> dict[str, Any]:
    """Return the value of each parameter, given or default; raises ParameterError."""
    values = {}
    for spec in specs:
        values[spec.name] = spec.converted(given.get(spec.name, spec.default))
        spec.check(values[spec.name])
    return values


def missing_geometry(given: Values) -> ParameterSpec | None:
    """Return the first missing parameter of an incomplete geometry, or None."""
    needed = ['wheel_separation', 'wheel_radius']
    if given.keys() & {'left_wheel_names', 'right_wheel_names'}:
        needed += ['left_wheel_names', 'right_wheel_names']
    missing = next((name for name in needed if name not in given), None)
    return next((spec for spec in GEOMETRY if spec.name == missing), None)


def nearest_name(name: str, known: Iterable[str], cutoff: float = 0.0) -> str:
    """Return the known name most similar to a name, '' if none reaches the cutoff."""
    import difflib  # here, to save its memory in most starts of a node

    return next(iter(difflib.get_close_matches(name, known, n=1, cutoff=cutoff)), '')


def _one_of(*choices: str) -> Rule:
    return Rule(f'must be one of {", ".join(choices)}', lambda value: value in choices)


_POSITIVE = Rule('must be positive and finite', lambda value: 0.0 < value < math.inf)
_NOT_NEGATIVE = Rule('must be finite and zero or more', lambda value: 0.0 <= value < math.inf)
_POSITIVE_OR_NAN = Rule(
    'must be positive and finite, or .nan for none',
    lambda value: 0.0 < value < math.inf or math.isnan(value))
_RATE_OR_NONE = Rule(
    'must be zero, or from 0.001 to 1000 Hz', lambda value: not value or 0.001 <= value <= 1000.0)
_RATE = Rule('must be from 1 to 1000 Hz', lambda value: 1.0 <= value <= 1000.0)
_WINDOW = Rule('must be from 1 to 10000', lambda value: 1 <= value <= 10000)
_FACTOR = Rule('must be from 0.1 to 10', lambda value: 0.1 <= value <= 10.0)
_SHARE = Rule('must be zero or more and below 1', lambda value: 0.0 <= value < 1.0)
_DIRECTION = Rule('must be 1 or -1', lambda value: value in (1, -1))
_NOT_EMPTY = Rule('must not be empty', lambda value: value != '')
_JOINT_NAMES = Rule(
    'must be a list of one or more different joint names',
    lambda value: 0 < len(value) == len(set(value)) and '' not in value)
_DIAGONAL = Rule(
    'must be 6 variances, each zero or more and at most 1e6',
    lambda value: len(value) == 6 and all(
        0.0 <= variance <= UNKNOWN_VARIANCE for variance in value))

GEOMETRY = (
    ParameterSpec(
        'left_wheel_names', ['left_wheel_joint'], '',
        'Joints of the left wheels. A name that the driver does not use: no odometry.',
        _JOINT_NAMES),
    ParameterSpec(
        'right_wheel_names', ['right_wheel_joint'], '',
        'Joints of the right wheels, as many as left ones. Swapped with the left ones: every turn '
        'has the wrong direction.', _JOINT_NAMES),
    ParameterSpec(
        'wheel_separation', 0.160, 'm',
        'FULL distance between the left and right contact points. Too large: the robot turns '
        'further than commanded, and odometry reports too little.', _POSITIVE),
    ParameterSpec(
        'wheel_radius', 0.033, 'm',
        'Radius of the wheels. Too large: the robot drives slower and less far than odometry '
        'reports.', _POSITIVE),
    ParameterSpec(
        'wheel_separation_multiplier', 1.0, '',
        'Correction factor of wheel_separation, from calibration.', _FACTOR, live=True),
    ParameterSpec(
        'left_wheel_radius_multiplier', 1.0, '',
        'Correction factor of the left radius. Too large: straight drives bend to the left.',
        _FACTOR, live=True),
    ParameterSpec(
        'right_wheel_radius_multiplier', 1.0, '',
        'Correction factor of the right radius. Too large: straight drives bend to the right.',
        _FACTOR, live=True),
)

_WHEEL_COMMAND_TYPE = ParameterSpec(
    'wheel_command_type', 'joint_state', '',
    'Form of the wheel commands: joint_state (JointState), multi_array (Float64MultiArray, left '
    'wheels then right), per_wheel (Float64 on <joint>/command) or none.',
    _one_of('joint_state', 'multi_array', 'per_wheel', 'none'))

_NOISE = WheelNoise()  # of a small indoor robot


def _limits(axis: str, unit: str) -> tuple[ParameterSpec, ...]:
    """Return the limits of an axis; AxisLimits validates their signs."""
    limits = {
        'max_velocity': (f'{unit}/s', 'Maximum speed forward or counter-clockwise.'),
        'min_velocity': (f'{unit}/s', 'Maximum speed backward or clockwise, negative.'),
        'max_acceleration': (f'{unit}/s^2', 'Maximum acceleration forward.'),
        'max_deceleration': (
            f'{unit}/s^2', 'Maximum deceleration forward, negative. Too small: long stops.'),
        'max_acceleration_reverse': (f'{unit}/s^2', 'Maximum acceleration backward, negative.'),
        'max_deceleration_reverse': (f'{unit}/s^2', 'Maximum deceleration backward.'),
        'max_jerk': (f'{unit}/s^3', 'Maximum change of acceleration. Never delays a stop.'),
        'min_jerk': (f'{unit}/s^3', 'Minimum change of acceleration, negative.'),
    }
    return (
        *(ParameterSpec(f'{axis}.{name}', math.nan, unit, text, live=True)
          for name, (unit, text) in limits.items()),
        *(ParameterSpec(f'{axis}.has_{family}_limits', True, '',
                        f'false: the {family} limits are off.', live=True)
          for family in ('velocity', 'acceleration', 'jerk')))


ODOMETRY = (
    *GEOMETRY,
    ParameterSpec(
        'left_wheel_direction', 1, '',
        '-1: the left joints turn backward when the robot drives forward.', _DIRECTION),
    ParameterSpec(
        'right_wheel_direction', 1, '',
        '-1: the right joints turn backward when the robot drives forward.', _DIRECTION),
    ParameterSpec(
        'odom_frame_id', 'odom', '', 'Frame of the pose in odom.', _NOT_EMPTY),
    ParameterSpec(
        'base_frame_id', 'base_link', '', 'Frame between the wheels, x forward.', _NOT_EMPTY),
    ParameterSpec(
        'tf_frame_prefix', '', '',
        'Prefix of both frames, separated by a slash; ~ is the namespace of the node.'),
    ParameterSpec('tf_frame_prefix_enable', True, '', 'false: tf_frame_prefix has no effect.'),
    ParameterSpec(
        'enable_odom_tf', True, '',
        'Publish the transform from odom to base on /tf. Set to false if a filter publishes it: '
        'with two publishers the robot jumps.'),
    ParameterSpec(
        'publish_rate', 0.0, 'Hz',
        'Maximum rate of odom and its transform, by stamp; 0: one for each joint_states.',
        _RATE_OR_NONE),
    ParameterSpec(
        'position_feedback', True, '',
        'Use the positions of joint_states; false: integrate their velocities.'),
    ParameterSpec(
        'open_loop', False, '',
        'Integrate the applied commands, for a robot without encoders; joint_states is ignored.'),
    ParameterSpec(
        'encoder_wrap', math.nan, 'rad',
        'Range of an encoder that wraps around, such as 2 pi. .nan: no wraparound.',
        _POSITIVE_OR_NAN),
    ParameterSpec(
        'max_plausible_wheel_speed', math.nan, 'rad/s',
        'Speed above which a step is a glitch or an encoder reset; the next sample decides. Too '
        'small: no odometry at high speed. .nan: every step is accepted.', _POSITIVE_OR_NAN),
    ParameterSpec(
        'feedback_timeout', 0.0, 's',
        'Time without joint_states after which the wheels are stopped; 0: never.',
        _NOT_NEGATIVE, live=True),
    ParameterSpec(
        'velocity_rolling_window_size', 10, '',
        'Number of samples in the mean twist. Too many: the twist lags; too few: encoder ticks '
        'are visible.', _WINDOW),
    ParameterSpec(
        'left_wheel_travel_variance', _NOISE.left_travel, 'm^2/m',
        "Variance of the left wheel's travel over the floor per metre driven. Too small: filters "
        'trust odometry despite slip.', _NOT_NEGATIVE),
    ParameterSpec(
        'right_wheel_travel_variance', _NOISE.right_travel, 'm^2/m',
        "Variance of the right wheel's travel over the floor per metre driven.", _NOT_NEGATIVE),
    ParameterSpec(
        'turn_variance', _NOISE.turn, 'rad^2/rad',
        'Variance of the heading per radian turned, from tyre scrub.', _NOT_NEGATIVE),
    *(ParameterSpec(
        f'{name}_std', 0.0, 'm',
        f'Standard deviation of {name}, such as {example} if it was measured by hand; 0: exact.',
        _NOT_NEGATIVE)
      for name, example in (('wheel_separation', '0.002'), ('left_wheel_radius', '0.0001'),
                            ('right_wheel_radius', '0.0001'))),
    ParameterSpec(
        'pose_covariance_diagonal', [0.0] * 6, 'm^2, rad^2',
        'Variances of x, y, z, roll, pitch, yaw that replace the propagated covariance; all zero: '
        'not set.', _DIAGONAL),
    ParameterSpec(
        'twist_covariance_diagonal', [0.0] * 6, 'm^2/s^2, rad^2/s^2',
        'Variances that replace the covariance of the twist; all zero: not set.', _DIAGONAL),
    ParameterSpec(
        'cmd_vel_timeout', 0.5, 's',
        'Time without a command after which the wheels are stopped; 0: never.',
        _NOT_NEGATIVE, live=True),
    ParameterSpec('command_rate', 50.0, 'Hz', 'Rate of wheel commands.', _RATE),
    ParameterSpec(
        'max_wheel_speed', math.nan, 'rad/s',
        'Maximum speed of a wheel; a faster command is scaled, so that the curvature stays. Too '
        'large, or .nan (no limit): a saturated wheel changes the curvature.',
        _POSITIVE_OR_NAN, live=True),
    *_limits('linear.x', 'm'),
    *_limits('angular.z', 'rad'),
    _WHEEL_COMMAND_TYPE,
    ParameterSpec(
        'enable_stamped_cmd_vel', False, '',
        'Receive commands as TwistStamped; false: Twist. The other type is not received.'),
    ParameterSpec(
        'publish_limited_velocity', False, '', 'Publish the applied twist on ~/cmd_vel_out.'),
)

SIMULATOR = (
    *GEOMETRY,
    ParameterSpec('publish_rate', 50.0, 'Hz', 'Rate of joint_states and ground_truth.', _RATE),
    ParameterSpec(
        'motor_time_constant', 0.05, 's',
        'Time to 63 % of a change of wheel speed.', _NOT_NEGATIVE),
    ParameterSpec(
        'ticks_per_revolution', 4096, '', 'Encoder ticks per turn of the wheel; 0: infinite.',
        _NOT_NEGATIVE),
    ParameterSpec(
        'slip', 0.0, '', 'Fraction of their travel that both wheels lose on the floor.', _SHARE),
    ParameterSpec(
        'travel_noise', 0.0, 'm/sqrt(m)',
        "Standard deviation of a wheel's travel over the floor after one metre.", _NOT_NEGATIVE),
    ParameterSpec(
        'seed', 0, '', 'Seed of the noise; the same seed gives the same noise.', _NOT_NEGATIVE),
    ParameterSpec(
        'command_timeout', 0.5, 's',
        'Time without a wheel command after which the motors stop.', _POSITIVE),
    ParameterSpec(
        'swap_wheels', False, '',
        'Swap left and right, motors and encoders, as a wiring error does.',
        live=True),
    ParameterSpec('odom_frame_id', 'odom', '', 'Frame of the true pose.', _NOT_EMPTY),
    ParameterSpec('base_frame_id', 'base_link', '', 'Frame between the wheels.', _NOT_EMPTY),
    _WHEEL_COMMAND_TYPE,
)

# Former names of diff_drive_controller, and their replacements here.
RETIRED = {
    'use_stamped_vel': 'commands are Twist; enable_stamped_cmd_vel is for TwistStamped',
    'wheels_per_side': 'the lists of wheel names give the number of wheels',
    'allow_multiple_cmd_vel_publishers': 'the newest command is applied, whatever its publisher',
    'linear.x.min_acceleration': 'without effect, as there; set linear.x.max_deceleration',
    'angular.z.min_acceleration': 'without effect, as there; set angular.z.max_deceleration',
}

# Keys of such a file for its controller manager, and of every node.
NOT_OURS = ('type', 'update_rate', 'use_sim_time', 'start_type_description')
