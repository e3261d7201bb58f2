"""When a message was sent, and which it was, for callbacks that want to know."""
from collections.abc import Callable
import inspect
from typing import Any


def with_sending(callback: Callable[[Any, int, int | None], None]) -> Callable[..., None]:
    """
    Return a callback of a subscription that hands on message, time [ns] and number of its sending.

    Each sender counts its own messages; the number is None with a middleware that does not tell.
    """
    def receive(*arguments: Any) -> None:
        # EventsExecutor of Jazzy gives both in one tuple, the other executors one by one.
        message, info = arguments if len(arguments) == 2 else arguments[0]
        callback(message, info['source_timestamp'], info['publication_sequence_number'])

    # By the number of its parameters rclpy sees what a callback wants.
    receive.__signature__ = inspect.signature(  # type: ignore[attr-defined]
        lambda message, info: None)
    return receive
