"""
Two hosts on one machine, for tests: network namespaces with an emulated link.

Each host is connected by veth to a third namespace. A process there forwards the frames between
them with loss and latency, because not every kernel has netem of tc. It creates all three
namespaces. It deletes them and ends their processes at the end of its standard input: at any end
of the test.
"""
from collections import defaultdict, deque
from collections.abc import Iterator
from contextlib import contextmanager, suppress
import ctypes
from functools import partial
import os
from pathlib import Path
import random
import selectors
import shutil
import signal
import socket
import subprocess
import sys
import tempfile
import threading
import time

from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import Twist
from nav_msgs.msg import Odometry
import rclpy
from rclpy.qos import QoSProfile
from rclpy.serialization import deserialize_message
from sensor_msgs.msg import JointState

ADDRESSES = {'robot': '10.77.0.1', 'station': '10.77.0.2'}

KINDS = {
    'cmd_vel': Twist, 'diagnostics': DiagnosticArray, 'ground_truth': Odometry,
    'joint_states': JointState, 'odom': Odometry, 'wheel_commands': JointState}

CLONE_NEWNET = 0x40000000  # <linux/sched.h>, here and below where Python has no name for it
SOL_PACKET, PACKET_VNET_HDR, PACKET_OUTGOING, ETH_P_ALL = 263, 15, 4, 3
SO_RCVBUFFORCE = 33


class HostsError(Exception):
    """The hosts cannot be created on this machine; the message has the reason."""


class Hosts:
    """
    The hosts robot and station, until closed.

    Raises HostsError if they cannot be created.
    """

    def __init__(self) -> None:
        self._link = subprocess.Popen(
            [sys.executable, __file__, 'emulate_link', str(os.getpid())], stdin=subprocess.PIPE,
            stdout=subprocess.PIPE, text=True, start_new_session=True)  # not ended by Ctrl-C
        answer = self._link.stdout.readline().strip()
        if not answer.startswith('/'):
            self.close()
            raise HostsError(answer or 'it ended')
        self._memory = answer
        self._programs = []

    def close(self) -> None:
        """End all processes on the hosts, and delete the hosts."""
        self._link.communicate(timeout=10.0)

    def set_impairment(self, *, loss: float = 0.0, delay: float = 0.0) -> float:
        """Drop a share of the frames, and delay the others [s]; return the time of the change."""
        return self._order(f'{loss} {delay}')

    def set_up(self, *, is_up: bool) -> float:
        """Set the interfaces of both hosts up or down; return the time of the change."""
        return self._order('up' if is_up else 'down')

    def start(self, host: str, *arguments: str, **environment: str) -> 'Program':
        """Run Python on a host, in ROS's default domain and discovery range."""
        # Each host has a /dev/shm of its own: Fast DDS goes through it where it can.
        return Program([
            'ip', 'netns', 'exec', name_of(host, os.getpid()), 'sh', '-c',
            'mount --bind "$0" /dev/shm && exec "$@"', f'{self._memory}/{host}',
            sys.executable, *arguments],
            {**os.environ, 'ROS_DOMAIN_ID': '0', 'ROS_AUTOMATIC_DISCOVERY_RANGE': 'SUBNET',
             **environment})

    def record(self, host: str, *topics: str, **environment: str) -> 'Program':
        """Start a recorder of topics on a host; that of the station publishes commands as well."""
        return self.start(host, __file__, 'record', host, *topics, **environment)

    def _order(self, line: str) -> float:
        print(line, file=self._link.stdin, flush=True)
        return float(self._link.stdout.readline())


class Program:
    """A process on a host: its output, and the received messages of a recorder."""

    def __init__(self, command: list[str], environment: dict[str, str]) -> None:
        self.lines: list[str] = []
        self.received: dict[str, list] = defaultdict(list)
        """By topic, (time of receipt, message)."""
        self._process = subprocess.Popen(
            command, env=environment, text=True, stdin=subprocess.PIPE, stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT)
        threading.Thread(target=self._read, daemon=True).start()

    def send(self, line: str) -> None:
        """Write a line to its standard input."""
        print(line, file=self._process.stdin, flush=True)

    def _read(self) -> None:
        for line in self._process.stdout:
            if line.startswith('received '):
                _, topic, at, data = line.split()
                message = deserialize_message(bytes.fromhex(data), KINDS[topic])
                self.received[topic].append((float(at), message))
            else:
                self.lines.append(line.rstrip())


def name_of(host: str, owner: int) -> str:
    """Return the name of the namespace of a host."""
    return f'diffdrive-{owner}-{host}'


def emulate_link(owner: int) -> None:
    """Create the hosts and emulate the link, controlled by the lines of standard input."""
    signal.signal(signal.SIGTERM, lambda number, frame: sys.exit())
    memory = Path(tempfile.mkdtemp(prefix='hosts-', dir='/dev/shm'))
    try:
        ends = _make(owner, memory)
        print(memory, flush=True)
        _forward(owner, ends)
    except (OSError, HostsError) as error:
        print(' '.join(str(error).split()), flush=True)
    finally:
        for host in (*ADDRESSES, 'link'):
            with suppress(HostsError):
                for each in _ip('netns', 'pids', name_of(host, owner)).split():
                    os.kill(int(each), signal.SIGKILL)
                _ip('netns', 'del', name_of(host, owner))
        shutil.rmtree(memory)


def _make(owner: int, memory: Path) -> list[socket.socket]:
    """Return the two ends of the link."""
    link = name_of('link', owner)
    _ip('netns', 'add', link)
    for host, address in ADDRESSES.items():
        name = name_of(host, owner)
        (memory / host).mkdir()
        _ip('netns', 'add', name)
        _ip('-n', name, 'link', 'add', 'eth0', 'type', 'veth', 'peer', host, 'netns', link)
        _ip('-n', name, 'address', 'add', f'{address}/24', 'dev', 'eth0')
        _ip('-n', name, 'link', 'set', 'lo', 'up')
        _ip('-n', name, 'link', 'set', 'eth0', 'up')
        _ip('-n', link, 'link', 'set', host, 'up')
        _run('ip', 'netns', 'exec', name, 'mount', '--bind', str(memory / host), '/dev/shm')
    with _inside(link):
        return [_end(host) for host in ADDRESSES]


def _end(host: str) -> socket.socket:
    end = socket.socket(socket.AF_PACKET, socket.SOCK_RAW, socket.htons(ETH_P_ALL))
    # Keep the offload headers of the sender, such as checksums left to the hardware.
    end.setsockopt(SOL_PACKET, PACKET_VNET_HDR, 1)
    # Room for frames while a busy machine delays this process.
    end.setsockopt(socket.SOL_SOCKET, SO_RCVBUFFORCE, 1 << 24)
    end.bind((host, 0))
    return end


def _forward(owner: int, ends: list[socket.socket]) -> None:
    chance, loss, delay = random.Random(1), 0.0, 0.0
    in_flight: deque[tuple[float, socket.socket, bytes]] = deque()
    ready = selectors.DefaultSelector()
    ready.register(0, selectors.EVENT_READ)
    for end, other in (ends, ends[::-1]):
        ready.register(end, selectors.EVENT_READ, other)
    while True:
        wait = max(0.0, in_flight[0][0] - time.monotonic()) if in_flight else None
        for key, _ in ready.select(wait):
            if key.fd == 0:
                line = sys.stdin.readline().split()
                if not line:
                    return
                if line in (['up'], ['down']):
                    for host in ADDRESSES:
                        _ip('-n', name_of('link', owner), 'link', 'set', host, *line)
                else:
                    loss, delay = map(float, line)
                print(time.monotonic(), flush=True)
                continue
            with suppress(OSError):  # the interface is down
                frame, address = key.fileobj.recvfrom(1 << 17)
                if address[2] != PACKET_OUTGOING and chance.random() >= loss:
                    in_flight.append((time.monotonic() + delay, key.data, frame))
        while in_flight and in_flight[0][0] <= time.monotonic():
            _, end, frame = in_flight.popleft()
            with suppress(OSError):
                end.send(frame)


@contextmanager
def _inside(namespace: str) -> Iterator[None]:
    """Enter a network namespace; sockets stay in the namespace of their creation."""
    libc = ctypes.CDLL(None, use_errno=True)
    with open('/proc/self/ns/net') as home, open(f'/run/netns/{namespace}') as away:
        for each in (away, home):
            if libc.setns(each.fileno(), CLONE_NEWNET):
                raise OSError(ctypes.get_errno(), f'setns {each.name}')
            if each is away:
                yield


def _ip(*arguments: str) -> str:
    return _run('ip', *arguments)


def _run(*command: str) -> str:
    try:
        done = subprocess.run(command, capture_output=True, text=True, check=True)
    except FileNotFoundError:
        raise HostsError(f'{command[0]} is not installed') from None
    except subprocess.CalledProcessError as error:
        raise HostsError(f'{" ".join(command)}: {error.stderr}') from None
    return done.stdout


def record(name: str, *topics: str) -> None:
    """Print the received messages; publish the commands of standard input at 20 Hz."""
    rclpy.init()
    node = rclpy.create_node(f'{name}_recorder')
    for topic in topics:
        node.create_subscription(
            KINDS[topic], topic, partial(_write, topic), QoSProfile(depth=1000), raw=True)
    command = []
    if name == 'station':
        publisher = node.create_publisher(Twist, 'cmd_vel', QoSProfile(depth=10))
        node.create_timer(0.05, lambda: [publisher.publish(twist) for twist in command])

    def read_commands() -> None:
        for line in sys.stdin:
            twist = Twist()
            if line.strip():
                twist.linear.x, twist.angular.z = map(float, line.split())
            command[:] = [twist] if line.strip() else []

    threading.Thread(target=read_commands, daemon=True).start()
    with suppress(KeyboardInterrupt):
        rclpy.spin(node)


def _write(topic: str, data: bytes) -> None:
    print('received', topic, time.monotonic(), data.hex(), flush=True)


if __name__ == '__main__':
    if sys.argv[1] == 'emulate_link':
        emulate_link(int(sys.argv[2]))
    else:
        record(*sys.argv[2:])
