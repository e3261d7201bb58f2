"""
One way to run a node as a process: its arguments, executor, signals and last words.

SIGINT, SIGTERM, SIGHUP and SIGQUIT end the node while its context is still valid, so that it can
say a last word (stop the wheels) and be sure that it was heard.
"""
from collections.abc import Callable, Sequence
import faulthandler
import os
import signal
import sys
import threading
from typing import TypeVar

from diffdrive_ros.node.nonblocking_output import patient_console
import rclpy
from rclpy.context import Context
from rclpy.exceptions import NameValidationException, ParameterException
from rclpy.executors import Executor, SingleThreadedExecutor
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions
from rclpy.utilities import remove_ros_args

EXECUTOR_VARIABLE = 'DIFFDRIVE_EXECUTOR'

STOP_SIGNALS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP, signal.SIGQUIT)

NodeT = TypeVar('NodeT', bound=Node)


class StartError(Exception):
    """A node cannot start, for a reason that is said in one line."""


# Besides, what rclpy raises for files, names and overrides that it cannot take.
START_ERRORS = (StartError, RuntimeError, ParameterException, NameValidationException)


def run(
    name: str, description: str, make_node: Callable[[], NodeT],
    last_words: Callable[[NodeT], None], arguments: Sequence[str] | None = None,
    keep_time: Callable[[NodeT], None] | None = None,
) -> int:
    """
    Run a node until a signal ends it; return the exit code of the process.

    last_words is called with the node before anything of it is destroyed, whatever ended it.
    keep_time is called with it between two callbacks: an executor that is flooded by messages or
    requests of any kind may keep its timers waiting for long.
    """
    arguments = sys.argv[1:] if arguments is None else arguments
    stop = _catch_signals()
    with patient_console() as console:
        try:
            refuse_other_arguments(name, description, arguments)
            rclpy.init(args=list(arguments), signal_handler_options=SignalHandlerOptions.NO)
            executor = make_executor()
            faulthandler.enable(console)  # a crash takes the thread with it that hands lines on
            node = make_node()
        except START_ERRORS as error:
            what = '' if isinstance(error, StartError) else (
                f'cannot start: {type(error).__name__}: ')
            print(f'{name}: {what}{" ".join(str(error).split())}', file=sys.stderr)
            rclpy.try_shutdown()
            return 1
        try:
            _spin(executor, node, last_words, keep_time, stop)
        finally:
            rclpy.try_shutdown()
    return 0


def refuse_other_arguments(name: str, description: str, arguments: Sequence[str]) -> None:
    """Exit with a line on standard error if there are arguments that ROS would pass over."""
    others = remove_ros_args([name, *arguments])[1:]
    if not others:
        return
    import argparse  # here, for most starts do without its memory

    parser = argparse.ArgumentParser(
        prog=name, description=description, allow_abbrev=False,
        epilog=f'ROS arguments come after --ros-args: {name} --ros-args --params-file robot.yaml')
    parser.parse_args(others)


def has_parameter_file(arguments: Sequence[str] | None = None) -> bool:
    """Return whether the arguments (default: those of the process) name a parameter file."""
    return '--params-file' in (sys.argv if arguments is None else arguments)


def make_executor(context: Context | None = None) -> Executor:
    """
    Return the executor that DIFFDRIVE_EXECUTOR names, else the cheapest that this rclpy has.

    Raises StartError for a name that is none, and for an executor that this rclpy does not have.
    """
    name = os.environ.get(EXECUTOR_VARIABLE, '')
    if name not in ('', 'events', 'single_threaded'):
        raise StartError(
            f'cannot start: {EXECUTOR_VARIABLE} = {name!r}: must be events or single_threaded')
    if name != 'single_threaded':
        try:
            from rclpy.experimental import EventsExecutor
        except ImportError:
            if name:
                raise StartError(
                    f'cannot start: {EXECUTOR_VARIABLE} = {name!r}: this rclpy has none'
                ) from None
        else:
            return EventsExecutor(context=context)
    return SingleThreadedExecutor(context=context)


def _spin(
    executor: Executor, node: NodeT, last_words: Callable[[NodeT], None],
    keep_time: Callable[[NodeT], None] | None, signals: int,
) -> None:
    executor.add_node(node)
    stop: list[bytes] = []  # cheaper to look at than an event

    def wait_for_a_signal() -> None:
        stop.append(os.read(signals, 1))
        executor.wake()

    threading.Thread(target=wait_for_a_signal, daemon=True).start()
    try:
        while not stop:
            # Not spin(): that of EventsExecutor hangs in rclpy before 7.1.8. Nor, though it is 5 %
            # cheaper, spin_until_future_complete(): after a flood, events whose messages are gone
            # keep it from coming back, and timers from their turn.
            executor.spin_once(0.5)
            if keep_time:
                keep_time(node)
    finally:
        last_words(node)
        executor.remove_node(node)
        node.destroy_node()


def _catch_signals() -> int:
    """
    Return a file descriptor that can be read as soon as one of the signals has come.

    A handler in Python runs only when the main thread is back from C++, which may be half a
    second later; the byte is written by the interpreter's own handler, at once.
    """
    reader, writer = os.pipe()
    os.set_blocking(writer, False)
    signal.set_wakeup_fd(writer, warn_on_full_buffer=False)
    for each in STOP_SIGNALS:
        if signal.getsignal(each) != signal.SIG_IGN or each != signal.SIGHUP:  # as nohup asks
            signal.signal(each, lambda number, frame: None)
    return reader
