"""What is taken out of its turn, where more comes than can be answered."""
from contextlib import nullcontext

from diffdrive_ros.node.rclpy_internals import MAX_REQUESTS, take_requests
from std_srvs.srv import SetBool


class EndlessHandle(nullcontext):
    """A service's handle in which a request always waits."""

    def __init__(self) -> None:
        super().__init__()
        self.taken = 0

    def service_take_request(self, kind: type) -> tuple[object, object]:
        """Return the next one."""
        self.taken += 1
        return kind(data=True), self.taken


class Service:
    """As much of a service as is used."""

    srv_type = SetBool

    def __init__(self) -> None:
        self.handle = EndlessHandle()
        self.answered: list[object] = []

    def callback(self, request: SetBool.Request, response: SetBool.Response) -> object:
        """Answer."""
        response.success = request.data
        return response

    def send_response(self, response: SetBool.Response, header: object) -> None:
        """Keep whom an answer was for."""
        assert response.success
        self.answered.append(header)


def test_take_requests_answers_a_limited_number() -> None:
    """They are answered in their order, in several calls."""
    service = Service()
    take_requests(service)
    assert service.answered == list(range(1, MAX_REQUESTS + 1))
    take_requests(service)
    assert len(service.answered) == 2 * MAX_REQUESTS
