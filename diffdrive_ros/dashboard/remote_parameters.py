"""The live parameters of another node: what they are, what they may be, and to set them."""
from collections.abc import Awaitable, Callable, Sequence
from dataclasses import dataclass
import math
from typing import Any

from rcl_interfaces.msg import Parameter, ParameterType, ParameterValue
from rcl_interfaces.srv import DescribeParameters, GetParameters, ListParameters, SetParameters

Ask = Callable[[str, Any], Awaitable[Any]]
"""Calls a service of the node by its short name."""

# Of every node, and none of what makes this robot.
NOT_SHOWN = ('use_sim_time', 'qos_overrides.', 'start_type_description')

FIELDS = {
    ParameterType.PARAMETER_BOOL: 'bool_value', ParameterType.PARAMETER_INTEGER: 'integer_value',
    ParameterType.PARAMETER_DOUBLE: 'double_value',
    ParameterType.PARAMETER_STRING: 'string_value',
    ParameterType.PARAMETER_STRING_ARRAY: 'string_array_value',
    ParameterType.PARAMETER_DOUBLE_ARRAY: 'double_array_value'}


@dataclass(frozen=True)
class RemoteParameter:
    """One parameter as its node describes it."""

    name: str
    kind: int
    value: Any
    description: str
    rule: str
    is_live: bool

    @property
    def text(self) -> str:
        """Return the value as a person writes it."""
        if isinstance(self.value, float):
            return '.nan' if math.isnan(self.value) else repr(self.value)
        return str(self.value)


async def read_all(ask: Ask) -> list[RemoteParameter]:
    """Return all parameters of the node."""
    listed = await ask('list_parameters', ListParameters.Request())
    names = sorted(name for name in listed.result.names if not name.startswith(NOT_SHOWN))
    described = await ask('describe_parameters', DescribeParameters.Request(names=names))
    got = await ask('get_parameters', GetParameters.Request(names=names))
    return [
        RemoteParameter(
            entry.name, entry.type, value_of(value), entry.description,
            entry.additional_constraints or _range(entry), not entry.read_only)
        for entry, value in zip(described.descriptors, got.values, strict=True)]


async def write(ask: Ask, name: str, kind: int, text: str) -> str:
    """Set a parameter to what a person wrote; return why not, or nothing when it is set."""
    try:
        value = parse(kind, text)
    except ValueError as error:
        return f'{name} = {text}: {error}'
    answer = await ask('set_parameters', SetParameters.Request(
        parameters=[Parameter(name=name, value=value)]))
    result = answer.results[0]
    return '' if result.successful else result.reason or 'the node refuses, without a reason'


def parse(kind: int, text: str) -> Any:
    """Return a text as a value of a type; raises ValueError saying what it must be."""
    text = text.strip()
    if kind == ParameterType.PARAMETER_BOOL:
        if text.lower() not in ('true', 'false'):
            raise ValueError('must be true or false')
        return ParameterValue(type=kind, bool_value=text.lower() == 'true')
    if kind == ParameterType.PARAMETER_INTEGER:
        value = _number(int, text, 'an integer')
        if not -2**63 <= value < 2**63:
            raise ValueError('must fit into 64 bits')
        return ParameterValue(type=kind, integer_value=value)
    if kind == ParameterType.PARAMETER_DOUBLE:
        plain = text.lower().replace('.nan', 'nan').replace('.inf', 'inf')
        return ParameterValue(type=kind, double_value=_number(float, plain, 'a number'))
    if kind == ParameterType.PARAMETER_STRING:
        return ParameterValue(type=kind, string_value=text)
    raise ValueError('lists cannot be set here')


def value_of(value: Any) -> Any:
    """Return what is in a ParameterValue."""
    content = getattr(value, FIELDS[value.type]) if value.type in FIELDS else None
    return list(content) if isinstance(content, Sequence) and not isinstance(
        content, str) else content


def _number(kind: Callable[[str], Any], text: str, what: str) -> Any:
    try:
        return kind(text)
    except ValueError:
        raise ValueError(f'must be {what}') from None


def _range(descriptor: Any) -> str:
    for limits in (*descriptor.floating_point_range, *descriptor.integer_range):
        return f'must be from {limits.from_value} to {limits.to_value}'
    return ''
