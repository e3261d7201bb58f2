"""
The node's parameter file, read and written where there is no ROS.

Of the parameters, those that odometry depends on are taken; the node validates all of them when it
starts. Names, rules and defaults are those of parameters.py and config.py.
"""
from collections.abc import Mapping
from dataclasses import dataclass
import fnmatch
import math
from pathlib import Path
from typing import Any

from diffdrive_ros.arguments import positive
from diffdrive_ros.feedback import WheelFeedback
from diffdrive_ros.kinematics import DiffDrive
from diffdrive_ros.odometry import GeometryUncertainty, Odometry, WheelNoise

KEY = '/**/odometry'


class ParameterFileError(ValueError):
    """A parameter file cannot be used, for a reason that is said in one line."""


@dataclass(frozen=True)
class Robot:
    """What odometry is told of a robot; values are the parameters as they stand in the file."""

    values: Mapping[str, Any]
    nominal: DiffDrive
    drive: DiffDrive
    noise: WheelNoise
    uncertainty: GeometryUncertainty
    left_names: tuple[str, ...]
    right_names: tuple[str, ...]

    @classmethod
    def of(cls, values: Mapping[str, Any]) -> 'Robot':
        """Return the robot of a node's parameters; raises ValueError."""
        for name in ('wheel_separation', 'wheel_radius'):
            if name not in values:
                raise ParameterFileError(f'{name} = (not set): must be positive and finite')
        separation = positive('wheel_separation', values['wheel_separation'])
        radius = positive('wheel_radius', values['wheel_radius'])
        factors = [
            positive(name, values.get(name, 1.0)) for name in (
                'wheel_separation_multiplier', 'left_wheel_radius_multiplier',
                'right_wheel_radius_multiplier')]
        drive = DiffDrive(
            separation * factors[0], radius * factors[1], radius * factors[2])
        default = WheelNoise()
        names = [
            tuple(values.get(f'{side}_wheel_names', [f'{side}_wheel_joint']))
            for side in ('left', 'right')]
        return cls(
            values=values, nominal=DiffDrive(separation, radius, radius), drive=drive,
            noise=WheelNoise(
                values.get('left_wheel_travel_variance', default.left_travel),
                values.get('right_wheel_travel_variance', default.right_travel),
                values.get('turn_variance', default.turn)),
            uncertainty=GeometryUncertainty(*(
                values.get(f'{name}_std', 0.0) for name in (
                    'wheel_separation', 'left_wheel_radius', 'right_wheel_radius'))),
            left_names=names[0], right_names=names[1])

    def feedback(self) -> WheelFeedback:
        """Return the way in of the wheels, with the node's rules."""
        values = self.values
        return WheelFeedback(
            self.left_names, self.right_names, values.get('position_feedback', True),
            values.get('left_wheel_direction', 1), values.get('right_wheel_direction', 1),
            _set(values.get('encoder_wrap')), _set(values.get('max_plausible_wheel_speed')))

    def odometry(self) -> Odometry:
        """Return the odometry as the node has it."""
        return Odometry(
            self.drive, window=self.values.get('velocity_rolling_window_size', 10),
            noise=self.noise, geometry_uncertainty=self.uncertainty)


def read(path: Path) -> Robot:
    """Return the robot of a file, of the keys that are the node's; raises ParameterFileError."""
    try:
        import yaml
    except ImportError:
        raise ParameterFileError(
            f'{path}: yaml is needed to read it: pip install pyyaml') from None
    try:
        content = yaml.safe_load(path.read_text(encoding='utf-8'))
    except (OSError, UnicodeDecodeError, yaml.YAMLError) as error:
        raise ParameterFileError(f'{path}: {" ".join(str(error).split())}') from None
    values: dict[str, Any] = {}
    for key, node in (content if isinstance(content, dict) else {}).items():
        # rcl's wildcards: * is one part of a name, ** any number of them.
        if fnmatch.fnmatchcase('/odometry', f'/{str(key).strip("/")}'.replace('/**', '*')):
            values |= _flat((node or {}).get('ros__parameters') or {})
    try:
        return Robot.of(values)
    except (ValueError, TypeError) as error:
        raise ParameterFileError(f'{path}: {error}') from None


def _flat(parameters: Mapping[str, Any], prefix: str = '') -> dict[str, Any]:
    """Return nested parameters by their full names, with dots."""
    flat: dict[str, Any] = {}
    for name, value in parameters.items():
        if isinstance(value, Mapping):
            flat |= _flat(value, f'{prefix}{name}.')
        else:
            flat[f'{prefix}{name}'] = value
    return flat


def write(path: Path, values: Mapping[str, Any], comments: Mapping[str, str], head: str) -> None:
    """Write parameters for the node, each with its comment; head is what the file says first."""
    lines = [f'# {line}'.rstrip() for line in head.splitlines()]
    lines += [f'{KEY}:', '  ros__parameters:']
    for name, value in values.items():
        comment = f'  # {comments[name]}' if name in comments else ''
        lines.append(f'    {name}: {_text(value)}{comment}')
    path.write_text('\n'.join(lines) + '\n', encoding='utf-8')


def _text(value: object) -> str:
    """Return a value such that YAML reads it back with its type: a double keeps its point."""
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, float):
        if not math.isfinite(value):
            return '.nan' if math.isnan(value) else '.inf' if value > 0.0 else '-.inf'
        text = f'{value:.9g}'
        mantissa, mark, exponent = text.partition('e')
        return f'{mantissa if "." in mantissa else mantissa + ".0"}{mark}{exponent}'
    if isinstance(value, (list, tuple)):
        return f'[{", ".join(map(_text, value))}]'
    if isinstance(value, str):
        return "'" + value.replace("'", "''") + "'"
    return str(value)


def _set(value: float | None) -> float | None:
    return None if value is None or math.isnan(value) else value
