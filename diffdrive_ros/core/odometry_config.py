"""The configuration of odometry: one frozen object, from the parameters of the node."""
from collections.abc import Sequence
from dataclasses import dataclass
import math
import re
from typing import Any

from diffdrive_ros.core.axis_limits import AxisLimits
from diffdrive_ros.core.kinematics import DiffDrive
from diffdrive_ros.core.odometry import GeometryUncertainty, Odometry, WheelNoise
from diffdrive_ros.core.parameter_specs import ParameterError, Values
from diffdrive_ros.core.wheel_commander import WheelCommander
from diffdrive_ros.core.wheel_feedback import WheelFeedback


@dataclass(frozen=True)
class OdometryConfig:
    """The parameters of the node odometry, validated as a whole."""

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
    feedback_timeout: float
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
    wheel_command_type: str
    enable_stamped_cmd_vel: bool
    publish_limited_velocity: bool

    @classmethod
    def of(cls, values: Values, namespace: str = '/') -> 'OdometryConfig':
        """Return the config of a full set of values, in a namespace; raises ParameterError."""
        if values['base_frame_id'] == values['odom_frame_id']:
            raise ParameterError(
                'base_frame_id', repr(values['base_frame_id']), 'must differ from odom_frame_id')
        left_wheel_names, right_wheel_names = wheel_names(values)
        prefix = _prefix(values, namespace)
        optional: dict[str, Any] = {
            name: None if math.isnan(values[name]) else values[name] for name in (
                'encoder_wrap', 'max_plausible_wheel_speed', 'max_wheel_speed')}
        return cls(
            left_wheel_names=left_wheel_names,
            right_wheel_names=right_wheel_names,
            drive=diff_drive(values),
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
            linear_limits=_axis_limits(values, 'linear.x'),
            angular_limits=_axis_limits(values, 'angular.z'),
            **optional,
            **{name: values[name] for name in (
                'left_wheel_direction', 'right_wheel_direction', 'enable_odom_tf',
                'publish_rate', 'position_feedback', 'open_loop', 'feedback_timeout',
                'velocity_rolling_window_size', 'cmd_vel_timeout', 'command_rate',
                'wheel_command_type', 'enable_stamped_cmd_vel', 'publish_limited_velocity')})

    def wheel_feedback(self) -> WheelFeedback:
        """Return a new WheelFeedback; in open loop it integrates the commanded velocities."""
        return WheelFeedback(
            left_names=self.left_wheel_names, right_names=self.right_wheel_names,
            left_direction=self.left_wheel_direction, right_direction=self.right_wheel_direction,
            position_feedback=self.position_feedback and not self.open_loop,
            encoder_wrap=self.encoder_wrap, max_plausible_speed=self.max_plausible_wheel_speed)

    def odometry(self) -> Odometry:
        """Return a new Odometry at the origin."""
        return Odometry(
            self.drive, window=self.velocity_rolling_window_size, noise=self.noise,
            geometry_uncertainty=self.geometry_uncertainty)

    def wheel_commander(self) -> WheelCommander:
        """Return a new WheelCommander."""
        return WheelCommander(
            self.drive, timeout=self.cmd_vel_timeout, max_wheel_speed=self.max_wheel_speed,
            linear_limits=self.linear_limits, angular_limits=self.angular_limits,
            period=1.0 / self.command_rate, left_direction=self.left_wheel_direction,
            right_direction=self.right_wheel_direction)


def wheel_names(values: Values) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Return the left and right joints; raises ParameterError unless they are as many."""
    left, right = tuple(values['left_wheel_names']), tuple(values['right_wheel_names'])
    if len(left) != len(right):
        raise ParameterError(
            'right_wheel_names', list(right), f'must be as many as left_wheel_names, {len(left)}')
    if values.get('wheel_command_type') == 'per_wheel':
        for name in (*left, *right):
            if not re.fullmatch(r'[A-Za-z_][A-Za-z0-9_]*(/[A-Za-z_][A-Za-z0-9_]*)*', name):
                raise ParameterError(
                    'wheel_command_type', "'per_wheel'", f'must be another form, since {name} '
                    'cannot stand in the name of a topic')
    if both := sorted(set(left) & set(right)):
        raise ParameterError(
            'right_wheel_names', list(right), f'must not share {both[0]} with left_wheel_names')
    return left, right


def diff_drive(values: Values) -> DiffDrive:
    """Return the geometry with its multipliers applied; raises ValueError."""
    return DiffDrive(
        values['wheel_separation'] * values['wheel_separation_multiplier'],
        values['wheel_radius'] * values['left_wheel_radius_multiplier'],
        values['wheel_radius'] * values['right_wheel_radius_multiplier'])


def _axis_limits(values: Values, axis: str) -> AxisLimits:
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
    """Return the prefix of the frames with its slash, or an empty string."""
    prefix = values['tf_frame_prefix'] if values['tf_frame_prefix_enable'] else ''
    prefix = (namespace if prefix == '~' else prefix).strip('/')
    return f'{prefix}/' if prefix else ''
