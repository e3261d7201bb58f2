"""A pool of processes with a progress bar."""
from collections.abc import Callable, Sequence
from concurrent.futures import ProcessPoolExecutor
import os
import signal
from typing import TypeVar

OutT = TypeVar('OutT')


def map_on_cores(
    label: str, function: Callable[..., OutT], tasks: Sequence[tuple[object, ...]],
) -> list[OutT]:
    """
    Return what the function returns for each task.

    An exception is raised here, Ctrl-C too: what has not begun is cancelled then.
    """
    from rich.console import Console
    from rich.progress import track

    console = Console(stderr=True)
    workers = max(1, min(len(tasks), os.cpu_count() or 1))
    with ProcessPoolExecutor(workers, initializer=_begin_worker) as pool:
        try:
            return list(track(
                pool.map(function, *zip(*tasks, strict=True)), label, len(tasks),
                console=console, transient=True, disable=not console.is_terminal))
        except BaseException:
            pool.shutdown(cancel_futures=True)
            raise


def _begin_worker() -> None:
    """Leave Ctrl-C to the parent, and the other cores to the other workers."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    limit_threads()


def limit_threads() -> None:
    """Run linear algebra in one thread: matrices as small as these gain nothing from more."""
    try:
        from threadpoolctl import threadpool_limits
    except ImportError:  # no distribution of ROS has it; it takes several times as long
        return
    threadpool_limits(1)
