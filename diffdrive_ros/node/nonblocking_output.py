"""A console that nobody reads (Ctrl-S, a pipe that is full) must not stop a node that logs."""
from collections.abc import Iterator
from contextlib import contextmanager
import os
import threading

LONGEST_REST = 0.5  # [s] that the last lines may take


@contextmanager
def patient_console() -> Iterator[int]:
    """
    Let what ROS logs go through a thread, which waits for the console instead of the caller.

    What is too much for it meanwhile is lost. Gives the file descriptor of the console itself, for
    what cannot wait for a thread, nor for a reader.
    """
    ours = 1 if os.environ.get('RCUTILS_LOGGING_USE_STDOUT') == '1' else 2
    console = os.dup(ours)
    if os.isatty(console):
        os.environ.setdefault('RCUTILS_COLORIZED_OUTPUT', '1')
    reader, writer = os.pipe()
    os.set_blocking(writer, False)
    os.dup2(writer, ours)
    os.close(writer)
    thread = threading.Thread(target=_hand_on, args=(reader, console), daemon=True)
    thread.start()
    try:
        yield _impatient(console)
    finally:
        os.dup2(console, ours)  # which ends the thread, for it was the last to write
        thread.join(LONGEST_REST)


def _impatient(console: int) -> int:
    """Return a file descriptor of the console on which nothing waits, if there can be one."""
    try:
        return os.open(
            f'/proc/self/fd/{console}', os.O_WRONLY | os.O_NONBLOCK | os.O_APPEND | os.O_CLOEXEC)
    except OSError:  # a socket
        return console


def _hand_on(reader: int, console: int) -> None:
    while lines := os.read(reader, 65536):
        try:
            while lines:
                lines = lines[os.write(console, lines):]
        except OSError:  # the terminal is gone
            continue
