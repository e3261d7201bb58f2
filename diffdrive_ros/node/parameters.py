"""
Declare parameters with their descriptions, validate them, and apply live changes.

Every rule is checked on the whole set, at start and before any change at run time. A request of
set_parameters_atomically is accepted as a whole or not at all.
"""
from collections.abc import Callable, Mapping, Sequence
from types import MappingProxyType
from typing import Any, TypeVar

from diffdrive_ros.core.parameter_specs import (
    checked_values,
    GEOMETRY,
    missing_geometry,
    nearest_name,
    NOT_OURS,
    ParameterError,
    ParameterSpec,
    Values,
)
from rcl_interfaces.msg import ParameterDescriptor, SetParametersResult
from rclpy.node import Node
from rclpy.parameter import Parameter


def declare(node: Node, specs: Sequence[ParameterSpec], overrides: Values) -> Values:
    """Declare the parameters on a node; return their values. Raises ParameterError."""
    for name, value in overrides.items():
        if name.startswith('qos_overrides.') and name.endswith('.depth') and not (
                isinstance(value, int) and value >= 1):
            raise ParameterError(name, value, 'must be an integer of 1 or more')
    values = checked_values(specs, overrides)
    for spec in specs:
        unit = f'[{spec.unit}] ' if spec.unit else ''
        node.declare_parameter(
            spec.name, values[spec.name], ParameterDescriptor(
                description=unit + spec.description, additional_constraints=spec.rule.text,
                read_only=not spec.live), ignore_override=True)
    return values


def log_unknown_names(
    node: Node, overrides: Values, specs: Sequence[ParameterSpec],
    retired: Mapping[str, str] = MappingProxyType({}),
) -> None:
    """
    Log the overrides that are no parameters of a node.

    retired has the names of former parameters and what replaces each.
    """
    known = [spec.name for spec in specs]
    known += [f'qos_overrides.{name}' for name in node.get_parameters_by_prefix('qos_overrides')]
    for name in sorted(overrides):
        if name in retired:
            node.get_logger().info(f'{name}: not used any more, {retired[name]}')
        elif name not in known and not name.startswith(NOT_OURS):
            node.get_logger().warning(
                f'{name}: no parameter of this node, not used; the nearest is '
                f'{nearest_name(name, known)}')


def is_example_robot(node: Node, overrides: Values, has_parameter_file: bool) -> bool:
    """
    Return whether no geometry is given, so that the node runs the example robot.

    Raises ParameterError for a part of the geometry, and for a parameter file without any: most
    often its key is not the node's name.
    """
    geometry = {spec.name for spec in GEOMETRY}
    given = sorted(overrides.keys() & geometry)
    if not given and not has_parameter_file:
        return True
    missing = missing_geometry(overrides)
    if missing:
        name = node.get_fully_qualified_name()
        why = (f'{", ".join(given)} came without it' if given else 'the parameter file gives '
               f'{name} no geometry: its key must be {name} or /**/{node.get_name()}')
        if similar := nearest_name(missing.name, overrides.keys() - geometry, 0.6):
            why += f'; {similar} is no parameter of this node'
        raise ParameterError(missing.name, '(not set)', f'{missing.rule.text}; {why}')
    return False


ConfigT = TypeVar('ConfigT')


def follow_changes(
    node: Node, specs: Sequence[ParameterSpec], config_of: Callable[[Values], ConfigT],
    apply: Callable[[ConfigT], None],
) -> None:
    """Validate changes of the live parameters before, and apply them after."""
    by_name = {spec.name: spec for spec in specs}

    def values(changes: Sequence[Parameter]) -> Values:
        now: dict[str, Any] = {name: node.get_parameter(name).value for name in by_name}
        return now | {change.name: change.value for change in changes}

    def converted(changes: list[Parameter]) -> list[Parameter]:
        return [
            change if change.name not in by_name or (
                value := by_name[change.name].converted(change.value)) is change.value
            else Parameter(change.name, value=value) for change in changes]

    def validate(changes: list[Parameter]) -> SetParametersResult:
        try:
            for change in changes:
                if change.name in by_name:
                    by_name[change.name].check(change.value)
            config_of(values(changes))
        except ValueError as error:
            return SetParametersResult(successful=False, reason=str(error))
        return SetParametersResult(successful=True)

    node.add_pre_set_parameters_callback(converted)
    node.add_on_set_parameters_callback(validate)
    node.add_post_set_parameters_callback(lambda changes: apply(config_of(values([]))))
