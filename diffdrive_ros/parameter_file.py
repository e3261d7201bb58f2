"""
The node's parameter file, read and written where there is no ROS.

Of the parameters, those that odometry depends on are taken, by the node's rules; the node
validates all of them when it starts. Names, rules and defaults are those of parameters.py and
config.py, which need ROS; test_parameter_file.py holds the two against each other.
"""
from collections.abc import Callable, Mapping
from dataclasses import dataclass
import difflib
import fnmatch
import math
from pathlib import Path
import re
from typing import Any

from diffdrive_ros.feedback import WheelFeedback
from diffdrive_ros.kinematics import DiffDrive
from diffdrive_ros.odometry import GeometryUncertainty, Odometry, WheelNoise

KEY = '/**/odometry'


class ParameterFileError(ValueError):
    """A parameter file cannot be used, for a reason that is said in one line."""


@dataclass(frozen=True)
class Rule:
    """What a parameter has to be: its type as the node takes it, and what else holds of it."""

    kind: type
    text: str
    holds: Callable[[Any], bool] = lambda value: True

    def check(self, name: str, value: object) -> None:
        """Raise ParameterFileError unless the value keeps the rule."""
        # As in the node, 1 may stand for 1.0, but 1.0 not for 1 and true not for 1.
        kinds = (int, float) if self.kind is float else (self.kind,)
        if type(value) not in kinds or not self.holds(value):
            raise ParameterFileError(f'{name} = {value!r}: {self.text}')


_NAMES = Rule(
    list, 'must be a list of one or more different joint names',
    lambda value: all(isinstance(name, str) and name for name in value)
    and 0 < len(value) == len(set(value)))
_POSITIVE = Rule(float, 'must be positive and finite', lambda value: 0.0 < value < math.inf)
_POSITIVE_OR_NAN = Rule(
    float, 'must be positive and finite, or .nan for none',
    lambda value: 0.0 < value < math.inf or math.isnan(value))
_NOT_NEGATIVE = Rule(
    float, 'must be finite and zero or more', lambda value: 0.0 <= value < math.inf)
_FACTOR = Rule(float, 'must be from 0.1 to 10', lambda value: 0.1 <= value <= 10.0)
_DIRECTION = Rule(int, 'must be 1 or -1', lambda value: value in (1, -1))
_FRAME = Rule(str, 'must be a text that is not empty', bool)

RULES = {
    'left_wheel_names': _NAMES,
    'right_wheel_names': _NAMES,
    'wheel_separation': _POSITIVE,
    'wheel_radius': _POSITIVE,
    'wheel_separation_multiplier': _FACTOR,
    'left_wheel_radius_multiplier': _FACTOR,
    'right_wheel_radius_multiplier': _FACTOR,
    'left_wheel_direction': _DIRECTION,
    'right_wheel_direction': _DIRECTION,
    'position_feedback': Rule(bool, 'must be true or false'),
    'encoder_wrap': _POSITIVE_OR_NAN,
    'max_plausible_wheel_speed': _POSITIVE_OR_NAN,
    'velocity_rolling_window_size': Rule(
        int, 'must be an integer from 1 to 10000', lambda value: 1 <= value <= 10000),
    'left_wheel_travel_variance': _NOT_NEGATIVE,
    'right_wheel_travel_variance': _NOT_NEGATIVE,
    'turn_variance': _NOT_NEGATIVE,
    'wheel_separation_std': _NOT_NEGATIVE,
    'left_wheel_radius_std': _NOT_NEGATIVE,
    'right_wheel_radius_std': _NOT_NEGATIVE,
    'odom_frame_id': _FRAME,
    'base_frame_id': _FRAME,
}


def check(values: Mapping[str, Any]) -> None:
    """Raise ParameterFileError unless parameters keep the rules, each by itself and together."""
    for name, value in values.items():
        if name in RULES:
            RULES[name].check(name, value)
        elif value is None:
            raise ParameterFileError(f'{name} = null: must have a value')
        elif near := difflib.get_close_matches(name, RULES, n=1, cutoff=0.9):
            raise ParameterFileError(f'{name} = {value!r}: is no parameter; is it {near[0]}?')
    for name in ('wheel_separation', 'wheel_radius'):
        if name not in values:
            raise ParameterFileError(f'{name} = (not set): {RULES[name].text}')
    left, right = (
        values.get(f'{side}_wheel_names', [f'{side}_wheel_joint']) for side in ('left', 'right'))
    if len(left) != len(right):
        raise ParameterFileError(
            f'right_wheel_names = {right}: must be as many as left_wheel_names, {len(left)}')
    if both := sorted(set(left) & set(right)):
        raise ParameterFileError(
            f'right_wheel_names = {right}: must not share {both[0]} with left_wheel_names')


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
        check(values)
        separation, radius = float(values['wheel_separation']), float(values['wheel_radius'])
        factors = [
            values.get(name, 1.0) for name in (
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

    class Loader(yaml.SafeLoader):  # type: ignore[misc]
        """Numbers as rcl reads them: PyYAML takes 5e-6 for a text."""

    Loader.add_implicit_resolver(
        'tag:yaml.org,2002:float',
        re.compile(r'[-+]?(\.[0-9]+|[0-9]+(\.[0-9]*)?)[eE][-+]?[0-9]+$'), list('-+.0123456789'))
    try:
        content = yaml.load(path.read_text(encoding='utf-8'), Loader)
        return Robot.of(_values(content))
    except ParameterFileError as error:
        raise ParameterFileError(f'{path}: {error}') from None
    except (OSError, ValueError, TypeError, RecursionError, yaml.YAMLError) as error:
        raise ParameterFileError(f'{path}: {" ".join(str(error).split())}') from None


def _values(content: object) -> dict[str, Any]:
    """Return the node's parameters of a file by their full names."""
    if not isinstance(content, Mapping):
        raise ParameterFileError('has no parameters: must be nodes with their ros__parameters')
    values: dict[str, Any] = {}
    # rcl's wildcards: * is one part of a name, ** any number of them.
    nodes = [node for key, node in content.items() if fnmatch.fnmatchcase(
        '/odometry', f'/{str(key).strip("/")}'.replace('/**', '*'))]
    if not nodes:
        raise ParameterFileError(
            f'has no key that is the node /odometry, but {", ".join(map(str, content)) or "none"}')
    for node in nodes:
        parameters = node.get('ros__parameters') if isinstance(node, Mapping) else None
        if not isinstance(parameters, Mapping):
            raise ParameterFileError(
                'the node has no ros__parameters with names and values: was it cut off?')
        values |= _flat(parameters)
    return values


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
        mantissa, mark, exponent = repr(value).partition('e')
        return f'{mantissa if "." in mantissa else mantissa + ".0"}{mark}{exponent}'
    if isinstance(value, (list, tuple)):
        return f'[{", ".join(map(_text, value))}]'
    if isinstance(value, str):
        return "'" + value.replace("'", "''") + "'"
    return str(value)


def _set(value: float | None) -> float | None:
    return None if value is None or math.isnan(value) else value
