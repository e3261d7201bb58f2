"""When a message was sent, for callbacks that want to know, with any executor of rclpy."""
from collections.abc import Callable
import inspect
from typing import Any


def with_sent_ns(callback: Callable[[Any, int], None]) -> Callable[..., None]:
    """Return a callback of a subscription that hands on the message and when it was sent [ns]."""
    def receive(*arguments: Any) -> None:
        # EventsExecutor of Jazzy gives both in one tuple, the other executors one by one.
        message, info = arguments if len(arguments) == 2 else arguments[0]
        callback(message, info['source_timestamp'])

    # By the number of its parameters rclpy sees what a callback wants.
    receive.__signature__ = inspect.signature(  # type: ignore[attr-defined]
        lambda message, info: None)
    return receive
