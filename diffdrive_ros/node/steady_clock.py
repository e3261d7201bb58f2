"""The steady clock: it runs in suspend, and cannot be set."""
import time


def steady_ns() -> int:
    """Return the time since boot [ns]."""
    return time.clock_gettime_ns(time.CLOCK_BOOTTIME)


def steady() -> float:
    """Return the time since boot [s]."""
    return time.clock_gettime(time.CLOCK_BOOTTIME)
