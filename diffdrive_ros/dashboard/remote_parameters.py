"""The parameters of the observed node: read, set, and read again when they may have changed."""
from collections.abc import Callable
from dataclasses import dataclass
import math
from typing import Any

from diffdrive_ros.core.odometry_config import diff_drive, wheel_names
from diffdrive_ros.core.parameter_specs import checked_values, GEOMETRY
from diffdrive_ros.dashboard.dashboard_node import DashboardNode, ServiceError
from diffdrive_ros.node import clock
from rcl_interfaces.msg import ParameterType
from rcl_interfaces.srv import DescribeParameters, GetParameters, ListParameters, SetParameters
from rclpy.parameter import Parameter, parameter_value_to_python

# Every node has these, and none concerns the robot.
HIDDEN = ('use_sim_time', 'qos_overrides.', 'start_type_description')
MISMATCH_RETRY_S = 3.0  # until a node that is no odometry is read again


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


class RemoteParameters:
    """All parameters of the observed node, and the geometry that follows from them."""

    def __init__(self, node: DashboardNode) -> None:
        self._node = node
        self.all: list[RemoteParameter] = []
        self.drive = diff_drive(checked_values(GEOMETRY, {}))
        self.joints: tuple[tuple[str, ...], tuple[str, ...]] = ((), ())
        self.directions = (1.0, 1.0)
        self.is_known = False
        self.mismatch = ''
        """Why the node is no odometry, or ''."""
        self.invalidations = 0
        self._read_at = 0.0

    def value(self, name: str) -> Any:
        """Return the value of a parameter when it was read last, or None."""
        return next((each.value for each in self.all if each.name == name), None)

    @property
    def are_outdated(self) -> bool:
        """Return whether the parameters have to be read."""
        if self._read_at <= self._node.parameters_changed_at:
            return True
        if self.mismatch:
            return clock.steady() - self._read_at > MISMATCH_RETRY_S
        return not self.is_known

    def invalidate(self) -> None:
        """Have them read again: they may be those of another process."""
        self.is_known, self.mismatch = False, ''
        self.invalidations += 1

    async def read(self) -> None:
        """Read all parameters of the node, and derive its geometry; raises ServiceError."""
        read_at, invalidations, mismatch = clock.steady(), self.invalidations, ''
        try:
            received = await read_all(self._node)
            if self.invalidations == invalidations:
                self._update(received)
        except KeyError as error:
            mismatch = f'it has no parameter {error}'
        except (TypeError, ValueError) as error:
            mismatch = str(error)
        if self.invalidations != invalidations:
            return  # the response is that of an earlier process
        self.is_known, self._read_at = not mismatch, read_at
        self.mismatch = mismatch and (
            f'{self._node.observed} is another node than odometry: {mismatch}')
        if mismatch:
            raise ServiceError(self.mismatch)

    async def change(self, name: str, text: str) -> str:
        """Set a parameter to a text; return why it was refused, or ''; raises ServiceError."""
        kind = next(each.kind for each in self.all if each.name == name)
        try:
            value = parse(kind, text)
        except ValueError as error:
            reason = f'{name} = {text}: {error}'
        else:
            response = await self._node.call('set_parameters', SetParameters.Request(
                parameters=[Parameter(name, Parameter.Type(kind), value).to_parameter_msg()]))
            result = response.results[0]
            reason = '' if result.successful else result.reason or 'the node gives no reason'
        try:
            await self.read()
        except ServiceError:  # the parameter is set, and all are read before the robot is driven
            self.invalidate()
        return reason

    def _update(self, received: list[RemoteParameter]) -> None:
        self.all = received
        values = {each.name: each.value for each in received}
        for name in ('cmd_vel_timeout', 'publish_rate'):
            float(values[name])  # numbers, as reason_not_to_drive requires
        self.drive = diff_drive(values)
        self.joints = wheel_names(values)
        self.directions = (
            float(values['left_wheel_direction']), float(values['right_wheel_direction']))
        self._node.advertise_commands(bool(values['enable_stamped_cmd_vel']))


async def read_all(node: DashboardNode) -> list[RemoteParameter]:
    """Return all parameters of the observed node; raises ServiceError."""
    listed = await node.call('list_parameters', ListParameters.Request())
    names = sorted(name for name in listed.result.names if not name.startswith(HIDDEN))
    described = await node.call('describe_parameters', DescribeParameters.Request(names=names))
    got = await node.call('get_parameters', GetParameters.Request(names=names))
    return [
        RemoteParameter(
            entry.name, entry.type, parameter_value_to_python(value), entry.description,
            entry.additional_constraints or _range(entry), not entry.read_only)
        for entry, value in zip(described.descriptors, got.values, strict=True)]


def parse(kind: int, text: str) -> bool | int | float | str:
    """
    Return the value of a text, by a constant of ParameterType; raises ValueError with the rule.

    Not rclpy's get_parameter_value, which guesses the type from YAML: it makes an integer of 1, a
    boolean of yes and a string of 1e3.
    """
    text = text.strip()
    if kind == ParameterType.PARAMETER_BOOL:
        if text.lower() not in ('true', 'false'):
            raise ValueError('must be true or false')
        return text.lower() == 'true'
    if kind == ParameterType.PARAMETER_INTEGER:
        value = _number(int, text, 'an integer')
        if not -2**63 <= value < 2**63:
            raise ValueError('must fit into 64 bits')
        return value
    if kind == ParameterType.PARAMETER_DOUBLE:
        return _number(
            float, text.lower().replace('.nan', 'nan').replace('.inf', 'inf'), 'a number')
    if kind == ParameterType.PARAMETER_STRING:
        return text
    raise ValueError('lists cannot be set here')


def _number(kind: Callable[[str], Any], text: str, what: str) -> Any:
    try:
        return kind(text)
    except ValueError:
        raise ValueError(f'must be {what}') from None


def _range(descriptor: Any) -> str:
    for limits in (*descriptor.floating_point_range, *descriptor.integer_range):
        return f'must be from {limits.from_value} to {limits.to_value}'
    return ''
