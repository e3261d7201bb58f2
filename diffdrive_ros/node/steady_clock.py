"""The steady clock: it runs while the machine sleeps, and nobody can set it."""
import time


def steady_ns() -> int:
    """Return the time since boot [ns]."""
    return time.clock_gettime_ns(time.CLOCK_BOOTTIME)


def steady() -> float:
    """Return the time since boot [s]."""
    return time.clock_gettime(time.CLOCK_BOOTTIME)
