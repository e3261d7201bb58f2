"""When a message was sent, for callbacks that want to know."""
from collections.abc import Callable
import inspect
from typing import Any


def with_time_sent(callback: Callable[[Any, int], None]) -> Callable[..., None]:
    """
    Return a callback of a subscription that hands on a message and the time of its sending [ns].

    It is by the clock of the sender, and 0 with a middleware that does not tell.
    """
    def receive(*arguments: Any) -> None:
        # EventsExecutor of Jazzy gives both in one tuple, the other executors one by one.
        message, info = arguments if len(arguments) == 2 else arguments[0]
        callback(message, info['source_timestamp'])

    # By the number of its parameters rclpy sees what a callback wants.
    receive.__signature__ = inspect.signature(  # type: ignore[attr-defined]
        lambda message, info: None)
    return receive
