"""
The settings of the node odometry: its parameters, and the one frozen Config that they make.

The names, and where they have one the meaning, are diff_drive_controller's, of its releases 4 to
6. A double that is not set is .nan, as there.
"""
from collections.abc import Sequence
from dataclasses import dataclass
import math
from typing import Any

from diffdrive_ros import parameters
from diffdrive_ros.kinematics import DiffDrive
from diffdrive_ros.limits import AxisLimits
from diffdrive_ros.odometry import GeometryUncertainty, WheelNoise
from diffdrive_ros.parameters import ParameterError, Rule, Spec, Values

NOISE = WheelNoise()  # of a small indoor robot

DIRECTION = Rule('must be 1 or -1', lambda value: value in (1, -1))
DIAGONAL = Rule(
    'must be 6 variances, each zero or more and at most 1e6',
    lambda value: len(value) == 6 and all(0.0 <= variance <= 1e6 for variance in value))


def _limits(axis: str, unit: str) -> tuple[Spec, ...]:
    """Return the limits of an axis; what signs they have is AxisLimits' rule."""
    words = {
        'max_velocity': f'Fastest forward or counter-clockwise [{unit}/s].',
        'min_velocity': f'Fastest backward or clockwise, negative [{unit}/s].',
        'max_acceleration': f'Speeding up forward [{unit}/s^2].',
        'max_deceleration':
            f'Slowing down from forward, negative [{unit}/s^2]. Too small: stops take long.',
        'max_acceleration_reverse': f'Speeding up backward, negative [{unit}/s^2].',
        'max_deceleration_reverse': f'Slowing down from backward [{unit}/s^2].',
        'max_jerk': f'Change of acceleration [{unit}/s^3]. Never delays a stop.',
        'min_jerk': f'The same downward, negative [{unit}/s^3].',
    }
    flags = {
        'has_velocity_limits': 'velocity', 'has_acceleration_limits': 'acceleration',
        'has_jerk_limits': 'jerk'}
    return (
        *(Spec(f'{axis}.{name}', math.nan, text, live=True) for name, text in words.items()),
        *(Spec(f'{axis}.{name}', True, f'false: the {family} limits are off.', live=True)
          for name, family in flags.items()))


SPECS = (
    *parameters.GEOMETRY,
    Spec('left_wheel_direction', 1,
         '-1: the left joints turn backward when the robot drives forward.', DIRECTION),
    Spec('right_wheel_direction', 1,
         '-1: the right joints turn backward when the robot drives forward.', DIRECTION),
    Spec('odom_frame_id', 'odom', 'Frame in which odometry gives the pose.',
         parameters.NOT_EMPTY),
    Spec('base_frame_id', 'base_link', 'Frame between the wheels, x forward.',
         parameters.NOT_EMPTY),
    Spec('tf_frame_prefix', '',
         'Put before both frames, with a slash; ~ is the namespace of the node.'),
    Spec('tf_frame_prefix_enable', True, 'false: tf_frame_prefix is not used.'),
    Spec('enable_odom_tf', True,
         'Publish the transform from odom to base on /tf. Turn it off where a filter publishes '
         'it: two sources make the robot jump.'),
    Spec('publish_rate', 0.0,
         'Rate to which odom and its transform are thinned out, by stamp [Hz]; 0: one for each '
         'joint_states.', parameters.RATE_OR_NONE),
    Spec('position_feedback', True,
         'Use the positions of joint_states; false: integrate their velocities.'),
    Spec('open_loop', False,
         'Integrate the commands as applied, for a robot without encoders; joint_states is '
         'not used.'),
    Spec('encoder_wrap', math.nan,
         'Range after which the position of a joint starts anew, such as 2 pi [rad]. .nan: it '
         'never does.', parameters.POSITIVE_OR_NAN),
    Spec('max_plausible_wheel_speed', math.nan,
         'A wheel that seems to turn faster is held back until its next sample: a glitch, or a '
         'counter that was reset [rad/s]. .nan: everything is believed.',
         parameters.POSITIVE_OR_NAN),
    Spec('stop_on_feedback_loss', 0.0,
         'The wheels are stopped when joint_states fall silent for this long [s]; 0: they are '
         'not.', parameters.NOT_NEGATIVE, live=True),
    Spec('velocity_rolling_window_size', 10,
         'Samples over which the twist is measured. Too many: it lags; too few: it shows the '
         'steps of the encoders.', parameters.WINDOW),
    Spec('left_wheel_travel_variance', NOISE.left_travel,
         "Variance of the left wheel's travel over the floor per metre driven [m^2/m]. Too "
         'small: filters trust odometry that has slipped away.', parameters.NOT_NEGATIVE),
    Spec('right_wheel_travel_variance', NOISE.right_travel,
         "Variance of the right wheel's travel over the floor per metre driven [m^2/m].",
         parameters.NOT_NEGATIVE),
    Spec('turn_variance', NOISE.turn,
         'Variance of the heading per radian turned, from wheels that scrub [rad^2/rad].',
         parameters.NOT_NEGATIVE),
    *(Spec(f'{name}_std', 0.0,
           f'How well {name} is known: its standard deviation [m], such as {example} if it was '
           'measured by hand; 0: exactly.', parameters.NOT_NEGATIVE)
      for name, example in (('wheel_separation', '0.002'), ('left_wheel_radius', '0.0001'),
                            ('right_wheel_radius', '0.0001'))),
    Spec('pose_covariance_diagonal', [0.0] * 6,
         'Variances of x, y, z [m^2], roll, pitch, yaw [rad^2] in place of the propagated '
         'covariance; all zero: not set.', DIAGONAL),
    Spec('twist_covariance_diagonal', [0.0] * 6,
         'The same of the twist [m^2/s^2, rad^2/s^2]; all zero: not set.', DIAGONAL),
    Spec('cmd_vel_timeout', 0.5,
         'The wheels are stopped when no command has come for this long [s]; 0 never stops '
         'them.', parameters.NOT_NEGATIVE, live=True),
    Spec('command_rate', 50.0, 'Rate at which wheel commands go out [Hz].', parameters.RATE),
    Spec('max_wheel_speed', math.nan,
         'Fastest that a wheel can turn [rad/s]; a faster command is slowed down as a whole, '
         'so that the curve stays. .nan: no limit, and a wheel that cannot follow bends it.',
         parameters.POSITIVE_OR_NAN, live=True),
    *_limits('linear.x', 'm'),
    *_limits('angular.z', 'rad'),
    parameters.COMMAND_INTERFACE,
    Spec('enable_stamped_cmd_vel', False,
         'Commands come as TwistStamped; false: as Twist. The other type is not heard.'),
    Spec('publish_limited_velocity', False, 'Publish the twist as applied on ~/cmd_vel_out.'),
)

# Names that diff_drive_controller once had, and what stands for them here.
RETIRED = {
    'use_stamped_vel': 'commands are Twist; enable_stamped_cmd_vel is for TwistStamped',
    'wheels_per_side': 'the lists of wheel names say how many wheels there are',
    'allow_multiple_cmd_vel_publishers': 'the newest command counts, whoever sent it',
    'linear.x.min_acceleration': 'without effect, as there; set linear.x.max_deceleration',
    'angular.z.min_acceleration': 'without effect, as there; set angular.z.max_deceleration',
}

# Keys of such a file that are for its controller manager, and those of every node.
NOT_FOR_US = ('type', 'update_rate', 'use_sim_time', 'start_type_description')


@dataclass(frozen=True)
class Config:
    """The settings of the node odometry, validated as a whole."""

    left_wheel_names: tuple[str, ...]
    right_wheel_names: tuple[str, ...]
    drive: DiffDrive
    left_wheel_direction: int
    right_wheel_direction: int
    odom_frame: str
    base_frame: str
    enable_odom_tf: bool
    publish_rate: float
    position_feedback: bool
    open_loop: bool
    encoder_wrap: float | None
    max_plausible_wheel_speed: float | None
    stop_on_feedback_loss: float
    velocity_rolling_window_size: int
    noise: WheelNoise
    geometry_uncertainty: GeometryUncertainty
    pose_variances: tuple[float, ...] | None
    twist_variances: tuple[float, ...] | None
    cmd_vel_timeout: float
    command_rate: float
    max_wheel_speed: float | None
    linear_limits: AxisLimits
    angular_limits: AxisLimits
    command_interface: str
    enable_stamped_cmd_vel: bool
    publish_limited_velocity: bool

    @classmethod
    def of(cls, values: Values, namespace: str = '/') -> 'Config':
        """Return the Config of a full set of values, for a namespace; raises ParameterError."""
        if values['base_frame_id'] == values['odom_frame_id']:
            raise ParameterError(
                'base_frame_id', repr(values['base_frame_id']), 'must differ from odom_frame_id')
        left_wheel_names, right_wheel_names = parameters.wheel_names(values)
        prefix = _prefix(values, namespace)
        optional: dict[str, Any] = {
            name: None if math.isnan(values[name]) else values[name] for name in (
                'encoder_wrap', 'max_plausible_wheel_speed', 'max_wheel_speed')}
        return cls(
            left_wheel_names=left_wheel_names,
            right_wheel_names=right_wheel_names,
            drive=parameters.drive(values),
            odom_frame=prefix + values['odom_frame_id'].lstrip('/'),
            base_frame=prefix + values['base_frame_id'].lstrip('/'),
            noise=WheelNoise(
                values['left_wheel_travel_variance'], values['right_wheel_travel_variance'],
                values['turn_variance']),
            geometry_uncertainty=GeometryUncertainty(
                values['wheel_separation_std'], values['left_wheel_radius_std'],
                values['right_wheel_radius_std']),
            pose_variances=_diagonal(values['pose_covariance_diagonal']),
            twist_variances=_diagonal(values['twist_covariance_diagonal']),
            linear_limits=axis_limits(values, 'linear.x'),
            angular_limits=axis_limits(values, 'angular.z'),
            **optional,
            **{name: values[name] for name in (
                'left_wheel_direction', 'right_wheel_direction', 'enable_odom_tf',
                'publish_rate', 'position_feedback', 'open_loop', 'stop_on_feedback_loss',
                'velocity_rolling_window_size', 'cmd_vel_timeout', 'command_rate',
                'command_interface', 'enable_stamped_cmd_vel', 'publish_limited_velocity')})


def axis_limits(values: Values, axis: str) -> AxisLimits:
    """Return the limits of an axis, linear.x or angular.z; raises ParameterError."""
    limits = {
        name: values[f'{axis}.{name}'] for name in (
            'max_velocity', 'min_velocity', 'max_acceleration', 'max_deceleration',
            'max_acceleration_reverse', 'max_deceleration_reverse', 'max_jerk', 'min_jerk')}
    for family in ('velocity', 'acceleration', 'jerk'):
        if not values[f'{axis}.has_{family}_limits']:
            limits |= {name: math.nan for name in limits if family[:5] in name
                       or (family == 'acceleration' and 'deceleration' in name)}
    try:
        return AxisLimits(**limits)
    except ValueError as error:
        name, rest = str(error).split(' = ', 1)
        value, rule = rest.split(': ', 1)
        raise ParameterError(f'{axis}.{name}', value, rule) from None


def _diagonal(variances: Sequence[float]) -> tuple[float, ...] | None:
    return tuple(variances) if any(variances) else None


def _prefix(values: Values, namespace: str) -> str:
    """Return what stands before the frames, with its slash, or nothing."""
    prefix = values['tf_frame_prefix'] if values['tf_frame_prefix_enable'] else ''
    prefix = (namespace if prefix == '~' else prefix).strip('/')
    return f'{prefix}/' if prefix else ''
