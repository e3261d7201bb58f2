"""
What must not wait for its turn: commands and requests that stop the robot.

EventsExecutor works off what has come in the order in which it came. Where more comes than can be
worked off, that order is one of seconds, and longer with each second.
"""
from typing import Any

from rclpy.service import Service
from rclpy.subscription import Subscription

MOST_REQUESTS = 10  # as many as a service keeps


def take_message(subscription: Subscription) -> None:
    """Give a callback that wants the time of sending the message that waits, if there is one."""
    with subscription.handle:
        taken = subscription.handle.take_message(subscription.msg_type, subscription.raw)
    if taken is not None:
        subscription.callback(*taken)


def take_requests(service: Service) -> None:
    """Answer the requests that wait, if there are any; what comes faster waits for its turn."""
    kind: Any = service.srv_type
    for _ in range(MOST_REQUESTS):
        with service.handle:
            request, header = service.handle.service_take_request(kind.Request)
        if header is None:
            return
        service.send_response(service.callback(request, kind.Response()), header)
