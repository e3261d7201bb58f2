"""What inhibits the wheels of the observed node, and the software stop that does."""
import math
from typing import Any

from diffdrive_ros.core.wheel_commander import Inhibit, REASONS
from diffdrive_ros.dashboard.dashboard_node import DashboardNode
from diffdrive_ros.dashboard.teleop import Teleop
from diffdrive_ros.node import steady_clock
from std_srvs.srv import SetBool

DIAGNOSTICS_TIMEOUT_S = 3.0  # of a status that comes once a second


class CommandsStatus:
    """The status `commands` of the observed node: what inhibits its wheels."""

    def __init__(self, node: DashboardNode) -> None:
        self._node = node
        self.arrivals = 0
        """How many processes of the node were discovered: each may be another robot."""
        self._valid_from = 0.0
        self._inhibited_count: str | None = None

    @property
    def is_current(self) -> bool:
        """Return whether the newest status describes the node as it is."""
        received_at, _ = self._node.diagnostics.get(
            self._node.commands_status, (-math.inf, None))
        return (received_at >= self._valid_from
                and steady_clock.steady() - received_at <= DIAGNOSTICS_TIMEOUT_S)

    @property
    def inhibits(self) -> list[str]:
        """Return what inhibits the wheels, as the key `inhibits` lists it."""
        if not self.is_current:
            return []
        return inhibits_of(self._node.diagnostics[self._node.commands_status][1])

    def restart(self) -> None:
        """Expect the statuses of another process of the node."""
        self.arrivals += 1
        self.discard_before(steady_clock.steady())

    def discard_before(self, moment: float) -> None:
        """Ignore the statuses received before a moment: they describe an earlier state."""
        self._valid_from = max(self._valid_from, moment)

    def new_inhibits(self) -> str:
        """Return what inhibits the wheels, or did so since the last call, for a person to read."""
        reasons = describe(self.inhibits)
        for status in self._node.take_command_statuses():  # each, however short its inhibit was
            count = value_of(status, 'inhibited', '0')
            if self._inhibited_count not in (None, count):
                reasons = reasons or 'the node ignored a command'
            self._inhibited_count = count
            reasons = reasons or describe(inhibits_of(status))
        return reasons


class SoftwareStop:
    """Keeps the observed node disabled while STOP is pressed, also one that is started later."""

    def __init__(self, node: DashboardNode, teleop: Teleop, commands: CommandsStatus) -> None:
        self._node, self._teleop, self._commands = node, teleop, commands
        self._pending_calls = 0
        self._disabled_arrival = 0

    @property
    def is_active(self) -> bool:
        """Return whether STOP is pressed, or the node disabled."""
        return self._teleop.is_stopped or self.is_confirmed

    @property
    def is_confirmed(self) -> bool:
        """Return whether the node reports that it is disabled."""
        return Inhibit.DISABLED in self._commands.inhibits

    async def enable(self, is_enabled: bool) -> str:
        """Enable or disable the node; return its message; raises ServiceError."""
        called_at, arrival = steady_clock.steady(), self._commands.arrivals
        self._pending_calls += 1
        try:
            response = await self._node.call('enable', SetBool.Request(data=is_enabled))
        finally:
            self._pending_calls -= 1
        self._commands.discard_before(called_at)
        self._disabled_arrival = 0 if is_enabled else arrival
        return str(response.message)

    async def maintain(self) -> None:
        """Disable a node that was started after STOP was pressed; raises ServiceError."""
        if not self._teleop.is_stopped or self._pending_calls:
            return
        if self._commands.arrivals != self._disabled_arrival or (
                self._commands.is_current and not self.is_confirmed):
            await self.enable(False)

    async def release(self, stop_count: int) -> str:
        """Enable the node and the pages, unless STOP is pressed once more; raises ServiceError."""
        if self._teleop.stop_count == stop_count:
            message = await self.enable(True)
            if self._teleop.stop_count == stop_count:
                self._teleop.resume()
                return message
        return await self.enable(False)


def value_of(status: Any, key: str, default: str = '') -> str:
    """Return the value of a key of a diagnostic status."""
    return next((each.value for each in status.values if each.key == key), default)


def inhibits_of(status: Any) -> list[str]:
    """Return what inhibits the wheels, according to a status `commands`."""
    return [word for word in value_of(status, 'inhibits').split(',') if word]


def describe(inhibits: list[str]) -> str:
    """Return what inhibits the wheels for a person to read."""
    texts = {inhibit.value: text for inhibit, text in REASONS.items()}
    return ', '.join(texts.get(word, word) for word in inhibits)
