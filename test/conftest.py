"""Give each test its own ROS domain, without traffic beyond this machine."""
from collections.abc import Callable, Iterator
from contextlib import contextmanager
import fcntl
from importlib.util import find_spec
import itertools
import os
from pathlib import Path
import signal
import tempfile

from diffdrive_ros.node.odometry_node import OdometryNode
from hypothesis import settings
import pytest
from rclpy.parameter import Parameter
from support.station import GEOMETRY, Process, Station

settings.register_profile('suite', deadline=None, derandomize=True)
settings.load_profile('suite')

# Read when a context is made: for the tests and for the processes that they start.
os.environ['ROS_AUTOMATIC_DISCOVERY_RANGE'] = 'LOCALHOST'
os.environ['ROS_PYTHON_CHECK_FIELDS'] = '1'  # a field of a wrong type raises

# Child processes inherit an ignored SIGHUP, as of nohup, and nodes keep it ignored.
signal.signal(signal.SIGHUP, signal.SIG_DFL)

# Domains without ephemeral ports of Linux; each worker begins with another one.
WORKERS = int(os.environ.get('PYTEST_XDIST_WORKER_COUNT', '1'))
WORKER = int(os.environ.get('PYTEST_XDIST_WORKER', 'gw0').removeprefix('gw'))
_domains = itertools.cycle(range(1 + WORKER, 102, WORKERS))
for _ in range(os.getppid() % 101):
    next(_domains)


# No distribution has rosbags: without it, the tests that need it are not collected.
collect_ignore = [] if find_spec('rosbags') or os.environ.get('CI') else [
    f'tools/test_{name}.py' for name in (
        'bags', 'calibrate', 'pool', 'replay_like_node', 'replay_tool')]


@contextmanager
def own_domain() -> Iterator[int]:
    """Reserve a ROS domain that no other test on this machine uses."""
    for number in _domains:
        with Path(tempfile.gettempdir(), f'diffdrive_ros-domain-{number}.lock').open('w') as lock:
            try:
                fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except BlockingIOError:
                continue
            with pytest.MonkeyPatch.context() as patch:
                patch.setenv('ROS_DOMAIN_ID', str(number))
                yield number
            return


@pytest.fixture
def domain() -> Iterator[int]:
    """Return a ROS domain for one test; processes started by it are in it too."""
    with own_domain() as number:
        yield number


@pytest.fixture(scope='module')
def domain_of_module() -> Iterator[int]:
    """Return a ROS domain for tests of a module that share a process."""
    with own_domain() as number:
        yield number


@pytest.fixture
def station(domain: int) -> Iterator[Station]:
    """Return an operator station in the domain of the test."""
    station = Station(domain)
    yield station
    station.close()


@pytest.fixture
def start(domain: int) -> Iterator[Callable[..., Process]]:
    """Return a function that starts a node as a process, ended with the test."""
    processes: list[Process] = []

    def start_process(module: str, *arguments: str, **parameters: object) -> Process:
        processes.append(Process(module, *arguments, **parameters))
        return processes[-1]

    yield start_process
    for process in processes:
        process.close()


@pytest.fixture
def make(station: Station) -> Callable[..., OdometryNode]:
    """Return a function that runs odometry here, on the test's robot; a__b is parameter a.b."""
    def make_node(namespace: str = '', **parameters: object) -> OdometryNode:
        overrides = [Parameter(name.replace('__', '.'), value=value) for name, value in (
            GEOMETRY | parameters).items()]
        return station.add(OdometryNode(
            context=station.context, namespace=namespace, parameter_overrides=overrides))
    return make_node


@pytest.fixture
def logged(capfd: pytest.CaptureFixture) -> Callable[[], str]:
    """
    Return a function that returns the log until now.

    It reads the file itself: readouterr loses concurrent writes of another thread.
    """
    return Path('/proc/self/fd/2').read_text
