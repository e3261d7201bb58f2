"""The clock by which commands age, and its stall."""
import time

from diffdrive_ros.node.steady_clock import steady_ns
from rclpy.node import Node

CLOCK_STALL_S = 1.0


class CommandClock:
    """The time by which commands age: simulation time with use_sim_time, else the steady clock."""

    def __init__(self, node: Node) -> None:
        self._node = node
        self._was_simulated = self.is_simulated
        self._last_ns, self._moved_at = -1, time.monotonic()

    @property
    def is_simulated(self) -> bool:
        """Return the parameter use_sim_time."""
        return bool(self._node.get_parameter('use_sim_time').value)

    def now_ns(self) -> int:
        """Return the time [ns]."""
        if self.is_simulated:
            return int(self._node.get_clock().now().nanoseconds)
        return steady_ns()

    def has_changed(self) -> bool:
        """Return whether use_sim_time has changed since the last call."""
        before, self._was_simulated = self._was_simulated, self.is_simulated
        return before != self._was_simulated

    def is_stalled(self, now_ns: int) -> bool:
        """Return whether simulation time has not moved for CLOCK_STALL_S of the steady clock."""
        if not self.is_simulated:
            return False
        if now_ns != self._last_ns:
            self._last_ns, self._moved_at = now_ns, time.monotonic()
        return not now_ns or time.monotonic() - self._moved_at > CLOCK_STALL_S
