"""
Serve a page that shows a robot, drives it and sets its parameters.

It serves this machine alone; with --host also others, which need the token in the address that is
printed. With --simulate, it starts simulator and odometry too.
"""
import argparse
from collections.abc import Sequence
from contextlib import nullcontext
import os
import signal
import socket
import sys

from diffdrive_ros.node.robot_processes import RobotEndedError, running_robot, used_topics
from diffdrive_ros.node.runner import START_ERRORS, StartError, STOP_SIGNALS
import rclpy
from rclpy.signals import SignalHandlerOptions
from rclpy.utilities import remove_ros_args


def main(arguments: Sequence[str] | None = None) -> None:
    """Run the dashboard as a process."""
    arguments = list(sys.argv[1:] if arguments is None else arguments)
    parser = argparse.ArgumentParser(
        prog='dashboard', description=(__doc__ or '').split('\n\n')[0], allow_abbrev=False,
        epilog='ROS arguments come after --ros-args')
    parser.add_argument(
        '--host', default='127.0.0.1', help='address to listen on; any other than 127.0.0.1 lets '
        'other machines connect, with the token that is printed')
    parser.add_argument('--port', type=int, default=8080, help='default: 8080')
    parser.add_argument(
        '--odometry', default='odometry',
        help='name of the observed node, in the namespace of the dashboard; default: odometry')
    parser.add_argument(
        '--simulate', action='store_true', help='start simulator and odometry too')
    options = parser.parse_args(remove_ros_args(['dashboard', *arguments])[1:])
    try:
        import nicegui  # noqa: F401, so that its absence is one line
    except ImportError:
        sys.exit('dashboard: nicegui is not installed: pip install nicegui')
    catch_signals()
    try:
        run(options, arguments)
    except (StartError, RobotEndedError) as error:
        sys.exit(f'dashboard: {error}')
    except START_ERRORS as error:
        sys.exit(f'dashboard: cannot start: {" ".join(str(error).split())}')
    except KeyboardInterrupt:
        sys.exit(0)


def catch_signals() -> None:
    """Have every stop signal end the dashboard through the signal handler of the server."""
    for each in STOP_SIGNALS:
        if each in (signal.SIGINT, signal.SIGTERM):
            signal.signal(each, signal.default_int_handler)
        elif signal.getsignal(each) != signal.SIG_IGN:  # by nohup
            signal.signal(each, lambda *_: signal.raise_signal(signal.SIGTERM))


def run(options: argparse.Namespace, arguments: Sequence[str]) -> None:
    """Serve the page until a signal comes; raises StartError."""
    from diffdrive_ros.dashboard.dashboard_node import DashboardNode
    from diffdrive_ros.dashboard.server import serve

    check_address(options.host, options.port)
    if options.simulate:
        # The simulated robot gets commands, which must not reach a robot on the network.
        os.environ.setdefault('ROS_AUTOMATIC_DISCOVERY_RANGE', 'LOCALHOST')
    rclpy.init(args=list(arguments), signal_handler_options=SignalHandlerOptions.NO)
    try:
        node = DashboardNode(options.odometry)
        check_namespace(node.observed, node.get_namespace())
        if options.simulate and (topics := used_topics(node)):
            raise StartError(
                f'topics in use: {", ".join(topics)}; end those nodes, or set ROS_DOMAIN_ID to '
                'another domain')
        started = running_robot('publish_limited_velocity:=true') if options.simulate else (
            nullcontext())
        with started as robot:
            serve(node, options.host, options.port, robot)
    finally:
        rclpy.try_shutdown()


def check_namespace(observed: str, namespace: str) -> None:
    """Raise StartError if the observed node is in another namespace than this cmd_vel."""
    home = observed.rpartition('/')[0] or '/'
    if home != namespace:
        raise StartError(
            f'{observed} is not in the namespace {namespace}, where the dashboard publishes '
            f'cmd_vel; use --odometry {observed.rpartition("/")[2]} --ros-args -r __ns:={home}')


def check_address(host: str, port: int) -> None:
    """Raise StartError if the address cannot be bound."""
    try:
        family = socket.getaddrinfo(host, port, type=socket.SOCK_STREAM)[0][0]
        socket.create_server((host, port), family=family).close()
    except (OSError, OverflowError) as error:
        raise StartError(
            f'cannot serve at {host} port {port}: {error}; see --host and --port') from None


if __name__ == '__main__':
    main()
