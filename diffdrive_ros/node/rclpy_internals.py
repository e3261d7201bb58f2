"""
Every private part and undocumented behaviour of rclpy that this package uses, seen in rclpy 7.1.6.

Each has a fallback by the public API with the same results, for an rclpy without it; only a stop
under a message flood arrives later then. test_odometry_node.py runs with both.
"""
from collections.abc import Callable
import inspect
from typing import Any

from rclpy.context import Context
from rclpy.executors import Executor, SingleThreadedExecutor
from rclpy.node import Node
from rclpy.publisher import Publisher
from rclpy.service import Service
from rclpy.subscription import Subscription

MAX_REQUESTS = 10  # the queue depth of a service


def private(owner: Any, *path: str) -> Any:
    """Return the attribute at the end of a path, None in an rclpy without it."""
    for name in path:
        owner = getattr(owner, name, None)
    return owner


def make_executor(context: Context | None = None) -> Executor:
    """
    Return EventsExecutor where this rclpy has it, else SingleThreadedExecutor.

    It is experimental, and costs half of the CPU time.
    """
    try:
        from rclpy.experimental import EventsExecutor
    except ImportError:
        return SingleThreadedExecutor(context=context)
    return EventsExecutor(context=context)


def parameter_overrides(node: Node, name: str, **kwargs: Any) -> dict[str, Any]:
    """
    Return the values that files, command line and constructor gave to a node, by parameter name.

    name and kwargs are those that the node was made with. Without _parameter_overrides a second
    node, which declares them all, takes its place.
    """
    overrides = private(node, '_parameter_overrides')
    if overrides is None:
        twin = Node(name, **kwargs, start_parameter_services=False, enable_rosout=False,
                    automatically_declare_parameters_from_overrides=True)
        overrides = twin.get_parameters_by_prefix('')
        twin.destroy_node()
    return {name: parameter.value for name, parameter in overrides.items()}


def raw_publish(publisher: Publisher) -> Callable[[bytes], None]:
    """
    Return what Publisher.publish calls for bytes.

    It skips a type check and a lock against destruction, which one thread does not need. They
    cost 2 % of a message.
    """
    return private(publisher, 'handle', 'publish_raw') or publisher.publish


def take_message(subscription: Subscription) -> None:
    """Call the callback with a waiting message ahead of the executor's queue, if there is one."""
    take = private(subscription, 'handle', 'take_message')
    if take is None:
        return
    with subscription.handle:
        taken = take(subscription.msg_type, subscription.raw)
    if taken is not None:
        subscription.callback(*taken)


def take_requests(service: Service) -> None:
    """Answer waiting requests ahead of the executor's queue, MAX_REQUESTS at most."""
    take = private(service, 'handle', 'service_take_request')
    kind: Any = service.srv_type
    for _ in range(MAX_REQUESTS if take else 0):
        with service.handle:
            request, header = take(kind.Request)
        if header is None:
            return
        service.send_response(service.callback(request, kind.Response()), header)


def with_source_timestamp(callback: Callable[[Any, int], None]) -> Callable[..., None]:
    """
    Return a subscription callback that passes on the message and its source timestamp [ns].

    It is by the sender's clock, and 0 from a middleware without it.
    """
    def receive(*arguments: Any) -> None:
        # EventsExecutor of 7.1.6 passes one tuple, the other executors two arguments.
        message, info = arguments if len(arguments) == 2 else arguments[0]
        callback(message, info['source_timestamp'])

    # rclpy decides by the number of parameters whether a callback gets the info.
    receive.__signature__ = inspect.signature(  # type: ignore[attr-defined]
        lambda message, info: None)
    return receive
