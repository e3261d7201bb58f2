"""The parameters of the observed node: read, set, and read again when they may have changed."""
from collections.abc import Callable, Mapping
from dataclasses import dataclass
import math
from typing import Any

from diffdrive_ros.core.odometry_config import diff_drive, wheel_names
from diffdrive_ros.core.parameter_specs import checked_values, GEOMETRY
from diffdrive_ros.dashboard.dashboard_node import DashboardNode, ServiceError
from diffdrive_ros.node import steady_clock
from rcl_interfaces.msg import ParameterDescriptor, ParameterType
from rcl_interfaces.srv import DescribeParameters, GetParameters, ListParameters, SetParameters
from rclpy.parameter import Parameter, parameter_value_to_python

# Every node has these, and none concerns the robot.
HIDDEN = ('use_sim_time', 'qos_overrides.', 'start_type_description')
MISMATCH_RETRY_S = 3.0  # until a node that is no odometry is read again

# Of a type that can be set: the value of a text, and the rule for the text.
PARSERS: Mapping[int, tuple[Callable[[str], Any], str]] = {
    ParameterType.PARAMETER_BOOL: (
        lambda text: {'true': True, 'false': False}[text.lower()], 'true or false'),
    ParameterType.PARAMETER_INTEGER: (int, 'an integer'),
    ParameterType.PARAMETER_DOUBLE: (
        lambda text: float(text.lower().replace('.nan', 'nan').replace('.inf', 'inf')),
        'a number'),
    ParameterType.PARAMETER_STRING: (str, 'a text')}


@dataclass(frozen=True)
class RemoteParameter:
    """One parameter as its node describes it."""

    descriptor: ParameterDescriptor
    value: Any

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
        self.all: Mapping[str, RemoteParameter] = {}
        """Those that were read last, by their names; replaced as a whole."""
        self.drive = diff_drive(checked_values(GEOMETRY, {}))
        self.joints: tuple[tuple[str, ...], tuple[str, ...]] = ((), ())
        self.is_known = False
        self.mismatch = ''
        """Why the node is no odometry, or ''."""
        self.invalidations = 0
        self._read_at = 0.0

    def value(self, name: str) -> Any:
        """Return the value of a parameter when it was read last, or None."""
        return self.all[name].value if name in self.all else None

    @property
    def are_outdated(self) -> bool:
        """Return whether the parameters have to be read."""
        if self._read_at <= self._node.parameters_changed_at:
            return True
        if self.mismatch:
            return steady_clock.steady() - self._read_at > MISMATCH_RETRY_S
        return not self.is_known

    def invalidate(self) -> None:
        """Have them read again: they may be those of another process."""
        self.is_known, self.mismatch = False, ''
        self.invalidations += 1

    async def read(self) -> None:
        """Read all parameters of the node, and derive its geometry; raises ServiceError."""
        read_at, invalidations = steady_clock.steady(), self.invalidations
        received = await read_all(self._node)
        if self.invalidations != invalidations:
            return  # the response is that of an earlier process
        self.is_known, self.mismatch, self._read_at = False, '', read_at
        try:
            self._update(received)
        except (KeyError, TypeError, ValueError) as error:
            cause = f'it has no parameter {error}' if isinstance(error, KeyError) else error
            self.mismatch = f'{self._node.observed} is another node than odometry: {cause}'
            raise ServiceError(self.mismatch) from None
        self.is_known = True

    async def change(self, name: str, text: str) -> str:
        """Set a parameter to a text; return why it was refused, or ''; raises ServiceError."""
        kind = self.all[name].descriptor.type
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

    def _update(self, received: Mapping[str, RemoteParameter]) -> None:
        self.all = received
        values = {name: each.value for name, each in received.items()}
        for name in (
                'cmd_vel_timeout', 'publish_rate', 'left_wheel_direction',
                'right_wheel_direction'):
            float(values[name])  # numbers, as the robot requires
        self.drive = diff_drive(values)
        self.joints = wheel_names(values)
        self._node.advertise_commands(bool(values['enable_stamped_cmd_vel']))


async def read_all(node: DashboardNode) -> Mapping[str, RemoteParameter]:
    """Return all parameters of the observed node, by their names; raises ServiceError."""
    listed = await node.call('list_parameters', ListParameters.Request())
    names = sorted(name for name in listed.result.names if not name.startswith(HIDDEN))
    described = await node.call('describe_parameters', DescribeParameters.Request(names=names))
    got = await node.call('get_parameters', GetParameters.Request(names=names))
    return {
        descriptor.name: RemoteParameter(descriptor, parameter_value_to_python(value))
        for descriptor, value in zip(described.descriptors, got.values, strict=True)}


def parse(kind: int, text: str) -> Any:
    """
    Return the value of a text, by a constant of ParameterType; raises ValueError with the rule.

    Not rclpy's get_parameter_value, which guesses the type from YAML: it makes an integer of 1, a
    boolean of yes and a string of 1e3.
    """
    if kind not in PARSERS:
        raise ValueError('lists cannot be set here')
    convert, rule = PARSERS[kind]
    try:
        value = convert(text.strip())
    except (KeyError, ValueError):
        raise ValueError(f'must be {rule}') from None
    if kind == ParameterType.PARAMETER_INTEGER and not -2**63 <= value < 2**63:
        raise ValueError('must fit into 64 bits')
    return value
