"""The clock by which the dashboard tells how old things are."""
import time


def now() -> float:
    """Return the time since the machine was started [s]; it goes on while the machine sleeps."""
    return time.clock_gettime(time.CLOCK_BOOTTIME)
