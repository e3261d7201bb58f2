"""
The parameter file of the odometry node, read and written without ROS.

Names, types, rules and defaults are the node's, from the one table of parameters. Sections, their
wildcards and scalars are read as rcl_yaml_param_parser and rclpy read them.
"""
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
import math
from pathlib import Path
import re
from typing import Any, ClassVar

from diffdrive_ros.core.kinematics import DiffDrive
from diffdrive_ros.core.odometry_config import OdometryConfig
from diffdrive_ros.core.parameter_specs import (
    checked_values,
    missing_geometry,
    nearest_name,
    NOT_OURS,
    ODOMETRY,
    ParameterError,
    RETIRED,
)
from diffdrive_ros.core.validation import UserError

NODE_NAMES = ('odometry', 'diff_drive_controller')

# A name that is no parameter, and is as similar to one as this, is a mistake.
SIMILAR = 0.8

_TRUE = ('Y', 'y', 'yes', 'Yes', 'YES', 'true', 'True', 'TRUE', 'on', 'On', 'ON')
_FALSE = ('N', 'n', 'no', 'No', 'NO', 'false', 'False', 'FALSE', 'off', 'Off', 'OFF')


@dataclass(frozen=True)
class RobotParameters:
    """The parameters of a robot: as in a file, the configuration they make, the node's name."""

    values: Mapping[str, Any]
    config: OdometryConfig
    node: str

    @classmethod
    def of(cls, values: Mapping[str, Any], node: str = f'/{NODE_NAMES[0]}') -> 'RobotParameters':
        """Return the parameters of a robot whose geometry is given; raises ParameterError."""
        known = {spec.name for spec in ODOMETRY}
        for name, value in values.items():
            if value is None:
                raise ParameterError(name, 'null', 'must have a value')
            if name not in known and name not in RETIRED and not name.startswith(
                    NOT_OURS) and (near := nearest_name(name, known, SIMILAR)):
                raise ParameterError(name, repr(value), f'is no parameter; is it {near}?')
        if missing := missing_geometry(values):
            raise ParameterError(missing.name, '(not set)', missing.rule.text)
        config = OdometryConfig.of(
            checked_values(ODOMETRY, values), node.rpartition('/')[0] or '/')
        return cls(values, config, node)

    @property
    def nominal(self) -> DiffDrive:
        """Return the geometry without multipliers."""
        radius = self.values['wheel_radius']
        return DiffDrive(self.values['wheel_separation'], radius, radius)


def read(path: Path, node: str | None = None) -> RobotParameters:
    """
    Return the parameters of a node in a file; raises UserError.

    Without a node, the file has to have the section of one node of NODE_NAMES, or wildcards only.
    """
    import yaml

    class Loader(yaml.SafeLoader):  # type: ignore[misc]
        """Scalars as rcl reads them: PyYAML reads 5e-6 and nan as strings."""

        yaml_implicit_resolvers: ClassVar[dict[str, Any]] = {}

    Loader.add_constructor('tag:yaml.org,2002:str', lambda loader, scalar: (
        scalar.value if scalar.style else _scalar(scalar.value)))
    try:
        content = yaml.load(path.read_text(encoding='utf-8'), Loader)
        if not isinstance(content, Mapping):
            raise UserError('has no parameters: must be nodes with their ros__parameters')
        sections = list(_sections(content))
        name = _node([name for name, _ in sections], node)
        values: dict[str, Any] = {}
        for section, parameters in sections:  # the later one overrides, as in rclpy
            if _matches(section, name):
                values |= _flat(parameters)
        return RobotParameters.of(values, name)
    except (ValueError, TypeError, RecursionError, yaml.YAMLError) as error:
        raise UserError(f'{path}: {" ".join(str(error).split())}') from None


def _scalar(text: str) -> object:
    """Return the value of a plain scalar, by rcl's order: bool, integer, double, string."""
    if text in ('', '~', 'null'):
        return None
    if text in _TRUE or text in _FALSE:
        return text in _TRUE
    if re.fullmatch(r'[-+]?0[0-7]+', text):
        return int(text, 8)
    if re.fullmatch(r'[-+]?(0|[1-9][0-9]*|0[xX][0-9a-fA-F]+)', text):
        return int(text, 0)
    dotted = re.fullmatch(r'([-+]?)\.(inf|Inf|INF)|\.(nan|NaN|NAN)', text)
    try:
        return float(text.replace('.', '') if dotted else 'string' if '_' in text else text)
    except ValueError:
        return text


def _sections(content: Mapping[Any, Any], name: str = '') -> Iterator[tuple[str, Any]]:
    """Yield the full name of each node, wildcards included, and its parameters."""
    for key, value in content.items():
        if key == 'ros__parameters' and name and isinstance(value, Mapping):
            yield name, value
        elif key != 'ros__parameters' and isinstance(value, Mapping):
            yield from _sections(value, f'{name}/{str(key).strip("/")}')
        else:
            raise UserError(
                f'{name}/{key}: must be a node with ros__parameters of names and values: was the '
                'file cut off?')


def _matches(section: str, node: str) -> bool:
    """Return whether a section is the node's: /* is one part of a name, /** any number."""
    return re.fullmatch(section.replace('/*', r'(/\w+)'), node) is not None


def _node(sections: list[str], wanted: str | None) -> str:
    """Return the full name of the node whose parameters are wanted; raises UserError."""
    named = sorted({section for section in sections if '*' not in section})
    choices = [name for name in named if name.rpartition('/')[2] in NODE_NAMES]
    if wanted is not None:
        choices = ['/' + wanted.strip('/')]
    elif not choices:
        choices = [f'/{name}' for name in NODE_NAMES if any(
            _matches(section, f'/{name}') for section in sections)][:1]
    if len(choices) > 1:
        raise UserError(
            f'has the nodes {", ".join(choices)}: --node must name one of them')
    if not choices or not any(_matches(section, choices[0]) for section in sections):
        missing = choices[0] if choices else ' or '.join(f'/{name}' for name in NODE_NAMES)
        raise UserError(
            f'has no section of the node {missing}, but {", ".join(sections) or "none"}'
            + '; --node names another node' * (wanted is None))
    return choices[0]


def _flat(parameters: Mapping[str, Any], prefix: str = '') -> dict[str, Any]:
    """Return nested parameters by their full names, with dots."""
    flat: dict[str, Any] = {}
    for name, value in parameters.items():
        if isinstance(value, Mapping):
            flat |= _flat(value, f'{prefix}{name}.')
        else:
            flat[f'{prefix}{name}'] = value
    return flat


def write(
    path: Path, robot: RobotParameters, comments: Mapping[str, str], header: str,
) -> None:
    """Write the parameters of a robot for its node, each with its comment, after a header."""
    import yaml

    class Dumper(yaml.SafeDumper):  # type: ignore[misc]
        """Strings in quotes: rcl reads more of them as booleans than PyYAML does."""

    Dumper.add_representer(str, lambda dumper, text: dumper.represent_scalar(
        'tag:yaml.org,2002:str', text, style='"' if '\n' in text else "'"))
    lines = [f'# {line}'.rstrip() for line in header.splitlines()]
    lines += [f'/**/{robot.node.rpartition("/")[2]}:', '  ros__parameters:']
    for name, value in robot.values.items():
        comment = f'  # {comments[name]}' if name in comments else ''
        text, *_ = yaml.dump(
            value, Dumper=Dumper, default_flow_style=True, width=math.inf, allow_unicode=True,
        ).splitlines()
        lines.append(f'    {name}: {text}{comment}')
    path.write_text('\n'.join(lines) + '\n', encoding='utf-8')
