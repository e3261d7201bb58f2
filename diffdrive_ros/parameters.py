"""
Parameters: declared with their descriptions, validated one by one, and followed when they change.

Every rule is checked on the whole set, at start and before any change at run time. What is set in
one request of set_parameters_atomically is taken as a whole or not at all.
"""
from array import array
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
import math
import re
from types import MappingProxyType
from typing import Any, TypeVar

from diffdrive_ros.kinematics import DiffDrive
from rcl_interfaces.msg import ParameterDescriptor, SetParametersResult
from rclpy.node import Node
from rclpy.parameter import Parameter

Values = Mapping[str, Any]


class ParameterError(ValueError):
    """A parameter breaks its rule; the message names it, its value and the rule."""

    def __init__(self, name: str, value: object, rule: str) -> None:
        super().__init__(f'{name} = {value}: {rule}')


@dataclass(frozen=True)
class Rule:
    """What a value has to be, in words and as a test."""

    text: str
    holds: Callable[[Any], bool]


ANYTHING = Rule('', lambda value: True)
POSITIVE = Rule('must be positive and finite', lambda value: 0.0 < value < math.inf)
NOT_NEGATIVE = Rule('must be finite and zero or more', lambda value: 0.0 <= value < math.inf)
POSITIVE_OR_NAN = Rule(
    'must be positive and finite, or .nan for none',
    lambda value: 0.0 < value < math.inf or math.isnan(value))
RATE_OR_NONE = Rule(
    'must be zero, or from 0.001 to 1000 Hz', lambda value: not value or 0.001 <= value <= 1000.0)
RATE = Rule('must be from 1 to 1000 Hz', lambda value: 1.0 <= value <= 1000.0)
WINDOW = Rule('must be from 1 to 10000', lambda value: 1 <= value <= 10000)
FACTOR = Rule('must be from 0.1 to 10', lambda value: 0.1 <= value <= 10.0)
NOT_EMPTY = Rule('must not be empty', lambda value: value != '')
JOINT_NAMES = Rule(
    'must be a list of one or more different joint names',
    lambda value: 0 < len(value) == len(set(value)) and '' not in value)


def one_of(*choices: str) -> Rule:
    """Return the rule that a value is among the choices."""
    return Rule(f'must be one of {", ".join(choices)}', lambda value: value in choices)


@dataclass(frozen=True)
class Spec:
    """One parameter; its type is that of its default. live: may be set at run time."""

    name: str
    default: bool | int | float | str | list[str] | list[float]
    description: str
    rule: Rule = ANYTHING
    live: bool = False

    def check(self, value: object) -> None:
        """Raise ParameterError unless the value is of the type and keeps the rule."""
        if not self._is_of_type(value):
            raise ParameterError(self.name, repr(value), f'must be {self._type_name}')
        if not self.rule.holds(value):
            raise ParameterError(self.name, repr(value), self.rule.text)

    def with_point(self, value: object) -> object:
        """Return an integer given for a double as a double: 1 means 1.0."""
        if type(value) is int and type(self.default) is float:
            return float(value)
        if isinstance(self.default, list) and isinstance(value, (list, tuple, array)):
            is_float = isinstance(self.default[0], float)
            return [float(item) if is_float and type(item) is int else item for item in value]
        return value

    @property
    def _type_name(self) -> str:
        if isinstance(self.default, list):
            return f'a list of {_TYPES[type(self.default[0])].split()[1]}s'
        return _TYPES[type(self.default)]

    def _is_of_type(self, value: object) -> bool:
        if isinstance(self.default, list):
            return isinstance(value, list) and all(
                type(item) is type(self.default[0]) for item in value)
        return type(value) is type(self.default)

    @property
    def descriptor(self) -> ParameterDescriptor:
        """Return what `ros2 param describe` shows."""
        return ParameterDescriptor(
            description=self.description, additional_constraints=self.rule.text,
            read_only=not self.live)


_TYPES = {bool: 'a bool', int: 'an integer', float: 'a double', str: 'a string'}

GEOMETRY = (
    Spec('left_wheel_names', ['left_wheel_joint'],
         'Joints of the left wheels. A name that the driver does not use: no odometry at all.',
         JOINT_NAMES),
    Spec('right_wheel_names', ['right_wheel_joint'],
         'Joints of the right wheels, as many as left ones. Swapped with the left ones, every '
         'turn goes the wrong way.', JOINT_NAMES),
    Spec('wheel_separation', 0.160,
         'FULL distance between the left and right contact points [m]. Too large: the robot '
         'turns further than commanded, and odometry reports too little.', POSITIVE),
    Spec('wheel_radius', 0.033,
         'Radius of the wheels [m]. Too large: the robot drives slower and less far than '
         'odometry says.', POSITIVE),
    Spec('wheel_separation_multiplier', 1.0,
         'Correction factor of wheel_separation, from calibration.', FACTOR, live=True),
    Spec('left_wheel_radius_multiplier', 1.0,
         'Correction factor of the left radius. Too large: straight drives bend to the left.',
         FACTOR, live=True),
    Spec('right_wheel_radius_multiplier', 1.0,
         'Correction factor of the right radius. Too large: straight drives bend to the right.',
         FACTOR, live=True),
)

COMMAND_INTERFACE = Spec(
    'command_interface', 'joint_state',
    'Form of the wheel commands: joint_state (JointState), multi_array (Float64MultiArray, left '
    'wheels then right), per_wheel (Float64 on <joint>/command) or none.',
    one_of('joint_state', 'multi_array', 'per_wheel', 'none'))


def wheel_names(values: Values) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Return the left and right joints; raises ParameterError unless they pair up."""
    left, right = tuple(values['left_wheel_names']), tuple(values['right_wheel_names'])
    if len(left) != len(right):
        raise ParameterError(
            'right_wheel_names', list(right), f'must be as many as left_wheel_names, {len(left)}')
    if values.get('command_interface') == 'per_wheel':
        for name in (*left, *right):
            if not re.fullmatch(r'[A-Za-z_][A-Za-z0-9_]*(/[A-Za-z_][A-Za-z0-9_]*)*', name):
                raise ParameterError(
                    'command_interface', "'per_wheel'", f'must be another form, since {name} '
                    'cannot stand in the name of a topic')
    if both := sorted(set(left) & set(right)):
        raise ParameterError(
            'right_wheel_names', list(right), f'must not share {both[0]} with left_wheel_names')
    return left, right


def drive(values: Values) -> DiffDrive:
    """Return the geometry with its multipliers applied; raises ValueError."""
    return DiffDrive(
        values['wheel_separation'] * values['wheel_separation_multiplier'],
        values['wheel_radius'] * values['left_wheel_radius_multiplier'],
        values['wheel_radius'] * values['right_wheel_radius_multiplier'])


def given(node: Node) -> Values:
    """Return what a parameter file and the command line set for a node, by name."""
    # rclpy has no public way to tell a value that was given from a default.
    return {name: parameter.value for name, parameter in node._parameter_overrides.items()}


def declare(node: Node, specs: Sequence[Spec]) -> Values:
    """Declare the parameters on a node; return their values. Raises ParameterError."""
    values: dict[str, Any] = {}
    overrides = given(node)
    for name, value in overrides.items():
        if name.startswith('qos_overrides.') and name.endswith('.depth') and not (
                isinstance(value, int) and value >= 1):
            raise ParameterError(name, value, 'must be an integer of 1 or more')
    for spec in specs:
        values[spec.name] = spec.with_point(overrides.get(spec.name, spec.default))
        spec.check(values[spec.name])
        node.declare_parameter(
            spec.name, values[spec.name], spec.descriptor, ignore_override=True)
    return values


def say_unknown_names(
    node: Node, specs: Sequence[Spec], retired: Mapping[str, str] = MappingProxyType({}),
    not_for_us: tuple[str, ...] = ('use_sim_time',),
) -> None:
    """
    Log the names that were given to a node and are none of its parameters.

    retired are such that once were, and why not any more; what begins like one of not_for_us is
    meant for somebody else.
    """
    known = [spec.name for spec in specs]
    known += [f'qos_overrides.{name}' for name in node.get_parameters_by_prefix('qos_overrides')]
    for name in sorted(given(node)):
        if name in retired:
            node.get_logger().info(f'{name} is not used any more: {retired[name]}')
        elif name not in known and not name.startswith(not_for_us):
            import difflib  # here, for most starts do without its memory

            nearest = difflib.get_close_matches(name, known, n=1, cutoff=0.0)
            node.get_logger().warning(
                f'{name} is no parameter of this node and is not used; the nearest is '
                f'{nearest[0]}')


def is_example_robot(node: Node, parameter_file: bool) -> bool:
    """
    Return True if nothing was said of the robot, so that the example stands in for it.

    Raises ParameterError if the geometry was given by half, or a parameter file was and brought
    none of it: most often a key in the file that is not the node's name.
    """
    geometry = {spec.name: spec for spec in GEOMETRY}
    said = sorted(given(node).keys() & geometry)
    if not said and not parameter_file:
        return True
    needed = ['wheel_separation', 'wheel_radius']
    if {'left_wheel_names', 'right_wheel_names'} & set(said):
        needed += ['left_wheel_names', 'right_wheel_names']
    for name in needed:
        if name not in said:
            import difflib  # here, for most starts do without its memory

            why = (f'{", ".join(said)} came without it' if said else 'the parameter file has '
                   f'nothing of it under a key that is {node.get_fully_qualified_name()}')
            for similar in difflib.get_close_matches(name, given(node).keys() - geometry, n=1):
                why += f'; {similar} is no parameter of this node'
            raise ParameterError(name, '(not set)', f'{geometry[name].rule.text}; {why}')
    return False


ConfigT = TypeVar('ConfigT')


def follow_changes(
    node: Node, specs: Sequence[Spec], config_of: Callable[[Values], ConfigT],
    apply: Callable[[ConfigT], None],
) -> None:
    """Let the live parameters be set at run time: validated before, applied after."""
    by_name = {spec.name: spec for spec in specs}

    def values(changes: Sequence[Parameter]) -> Values:
        now: dict[str, Any] = {name: node.get_parameter(name).value for name in by_name}
        return now | {change.name: change.value for change in changes}

    def with_points(changes: list[Parameter]) -> list[Parameter]:
        return [
            change if change.name not in by_name or (
                point := by_name[change.name].with_point(change.value)) is change.value
            else Parameter(change.name, value=point) for change in changes]

    def validate(changes: list[Parameter]) -> SetParametersResult:
        try:
            for change in changes:
                if change.name in by_name:
                    by_name[change.name].check(change.value)
            config_of(values(changes))
        except ValueError as error:
            return SetParametersResult(successful=False, reason=str(error))
        return SetParametersResult(successful=True)

    node.add_pre_set_parameters_callback(with_points)
    node.add_on_set_parameters_callback(validate)
    node.add_post_set_parameters_callback(lambda changes: apply(config_of(values([]))))
