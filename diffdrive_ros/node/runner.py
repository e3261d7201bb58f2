"""
Run a node as a process: arguments, executor, signals and the stop at its end.

SIGINT, SIGTERM, SIGHUP and SIGQUIT end the node while its context is still valid, so that it can
stop the wheels and wait for the acknowledgement.
"""
from collections.abc import Callable, Sequence
import faulthandler
import os
import signal
import sys
import threading
from typing import TypeVar

from diffdrive_ros.node.nonblocking_output import nonblocking_output
from diffdrive_ros.node.rclpy_internals import make_executor
import rclpy
from rclpy.exceptions import NameValidationException, ParameterException
from rclpy.executors import Executor
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions
from rclpy.utilities import remove_ros_args

STOP_SIGNALS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP, signal.SIGQUIT)

NodeT = TypeVar('NodeT', bound=Node)


class StartError(Exception):
    """A node cannot start; the message has the reason in one line."""


# The others are what rclpy raises for files, names and overrides that it rejects.
START_ERRORS = (StartError, RuntimeError, ParameterException, NameValidationException)


def run(
    name: str, description: str, make_node: Callable[[], NodeT],
    stop: Callable[[NodeT], None] = lambda node: None,
    between_callbacks: Callable[[NodeT], None] = lambda node: None,
) -> int:
    """
    Run a node until a signal ends it; return the exit code of the process.

    stop is called with the node before anything of it is destroyed, whatever ended it.
    between_callbacks is called with it after each callback: a flood of messages or requests may
    delay the timers of the executor for long.
    """
    arguments = sys.argv[1:]
    signals = _catch_signals()
    with nonblocking_output() as console:
        try:
            refuse_other_arguments(name, description, arguments)
            rclpy.init(args=list(arguments), signal_handler_options=SignalHandlerOptions.NO)
            executor = make_executor()
            faulthandler.enable(console)  # a crash ends the thread that forwards lines
            node = make_node()
        except START_ERRORS as error:
            what = '' if isinstance(error, StartError) else (
                f'cannot start: {type(error).__name__}: ')
            print(f'{name}: {what}{" ".join(str(error).split())}', file=sys.stderr)
            rclpy.try_shutdown()
            return 1
        try:
            _spin(executor, node, stop, between_callbacks, signals)
        finally:
            rclpy.try_shutdown()
    return 0


def refuse_other_arguments(name: str, description: str, arguments: Sequence[str]) -> None:
    """Exit with a line on standard error if there are arguments that ROS would ignore."""
    others = remove_ros_args([name, *arguments])[1:]
    if not others:
        return
    import argparse  # here, since most starts do not need its memory

    parser = argparse.ArgumentParser(
        prog=name, description=description, allow_abbrev=False,
        epilog=f'ROS arguments come after --ros-args: {name} --ros-args --params-file robot.yaml')
    parser.parse_args(others)


def has_parameter_file(arguments: Sequence[str] | None = None) -> bool:
    """Return whether the arguments (default: those of the process) name a parameter file."""
    return '--params-file' in (sys.argv if arguments is None else arguments)


def _spin(
    executor: Executor, node: NodeT, stop: Callable[[NodeT], None],
    between_callbacks: Callable[[NodeT], None], signals: int,
) -> None:
    executor.add_node(node)
    received: list[bytes] = []  # cheaper to check than an event

    def wait_for_a_signal() -> None:
        received.append(os.read(signals, 1))
        executor.wake()

    threading.Thread(target=wait_for_a_signal, daemon=True).start()
    try:
        while not received:
            # Not spin(): that of EventsExecutor hangs in rclpy before 7.1.8. Nor, though it is 5 %
            # cheaper, spin_until_future_complete(): after a flood it does not return while it
            # works off events whose messages are gone, and timers wait.
            executor.spin_once(0.5)
            between_callbacks(node)
    finally:
        stop(node)
        executor.remove_node(node)
        node.destroy_node()


def _catch_signals() -> int:
    """
    Return a file descriptor that is readable once one of the signals was received.

    A handler in Python runs only when the main thread returns from C++, up to half a second later.
    The interpreter's own handler writes the byte at once.
    """
    reader, writer = os.pipe()
    os.set_blocking(writer, False)
    signal.set_wakeup_fd(writer, warn_on_full_buffer=False)
    for each in STOP_SIGNALS:
        if signal.getsignal(each) != signal.SIG_IGN or each != signal.SIGHUP:  # as nohup asks
            signal.signal(each, lambda number, frame: None)
    return reader
