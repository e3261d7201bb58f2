"""A clock that goes on while the machine sleeps, and that nobody sets."""
import time


def steady_ns() -> int:
    """Return the time since the machine was started [ns]."""
    return time.clock_gettime_ns(time.CLOCK_BOOTTIME)


def steady() -> float:
    """Return the same [s]."""
    return time.clock_gettime(time.CLOCK_BOOTTIME)
