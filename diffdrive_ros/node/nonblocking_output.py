"""Log output that never blocks a node, on a console that is stopped (Ctrl-S) or a full pipe."""
from collections.abc import Iterator
from contextlib import contextmanager
import os
import threading

FLUSH_S = 0.5  # that the last lines may take


@contextmanager
def nonblocking_output() -> Iterator[int]:
    """
    Pass the log through a thread, which blocks in place of the caller.

    Lines beyond the capacity of a pipe are lost. Yields a file descriptor of the console itself,
    without blocking, for the trace of a crash.
    """
    ours = 1 if os.environ.get('RCUTILS_LOGGING_USE_STDOUT') == '1' else 2
    console = os.dup(ours)
    if os.isatty(console):
        os.environ.setdefault('RCUTILS_COLORIZED_OUTPUT', '1')
    reader, writer = os.pipe()
    os.set_blocking(writer, False)
    os.dup2(writer, ours)
    os.close(writer)
    thread = threading.Thread(target=_forward, args=(reader, console), daemon=True)
    thread.start()
    try:
        yield _nonblocking(console)
    finally:
        os.dup2(console, ours)  # closes the last writer, so that the thread ends
        thread.join(FLUSH_S)


def _nonblocking(console: int) -> int:
    """Return a file descriptor of the console that does not block, where that is possible."""
    try:
        return os.open(
            f'/proc/self/fd/{console}', os.O_WRONLY | os.O_NONBLOCK | os.O_APPEND | os.O_CLOEXEC)
    except OSError:  # a socket
        return console


def _forward(reader: int, console: int) -> None:
    while lines := os.read(reader, 65536):
        try:
            while lines:
                lines = lines[os.write(console, lines):]
        except OSError:  # the terminal is gone
            continue
