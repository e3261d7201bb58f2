"""
The parameter file of the node odometry, read and written where there is no ROS.

Names, types, rules and defaults are those of the node, by the one table of parameters.
"""
from collections.abc import Mapping
from dataclasses import dataclass
import fnmatch
import math
from pathlib import Path
import re
from typing import Any

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

KEY = '/**/odometry'

# A name that is no parameter, and as similar to one as this, is a mistake.
SIMILAR = 0.8


class ParameterFileError(ValueError):
    """A parameter file cannot be used, for a reason that is said in one line."""


@dataclass(frozen=True)
class RobotParameters:
    """The parameters of a robot: as they stand in a file, and the configuration they make."""

    values: Mapping[str, Any]
    config: OdometryConfig

    @classmethod
    def of(cls, values: Mapping[str, Any]) -> 'RobotParameters':
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
        return cls(values, OdometryConfig.of(checked_values(ODOMETRY, values)))

    @property
    def nominal(self) -> DiffDrive:
        """Return the geometry without multipliers."""
        radius = self.values['wheel_radius']
        return DiffDrive(self.values['wheel_separation'], radius, radius)


def read(path: Path) -> RobotParameters:
    """Return the parameters of the node in a file; raises ParameterFileError."""
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
        return RobotParameters.of(_values(content))
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
