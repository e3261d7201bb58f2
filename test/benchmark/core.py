"""
Measure the time of parts of the core, alternately, or the memory of one; print it as JSON.

Arguments: SAMPLES REPEATS WORK... Times are medians of CPU time [ns a sample]. Without repeats,
the memory is the peak growth of this process beyond the wheel angles [bytes a sample].
"""
from collections.abc import Callable
import json
from pathlib import Path
import re
import statistics
import sys
import time

from diffdrive_ros.core.kinematics import DiffDrive
from diffdrive_ros.core.odometry import GeometryUncertainty, integrate, integrate_chunks, Odometry
import numpy as np

DRIVE = DiffDrive(0.16, 0.033, 0.033)
UNCERTAINTY = GeometryUncertainty(0.002, 0.0001, 0.0001)
CHUNK = 100_000


def wheels(samples: int) -> np.ndarray:
    """Return angles of the left and right wheel on curves, (2, N)."""
    angles = np.random.default_rng(1).normal(0.05, 0.02, (2, samples))
    return np.cumsum(angles, axis=1, out=angles)


def by_integrate(left: np.ndarray, right: np.ndarray) -> None:
    """Integrate in one call."""
    integrate(DRIVE, left, right)


def by_chunks(left: np.ndarray, right: np.ndarray) -> None:
    """Integrate chunk by chunk, and keep nothing."""
    cuts = range(0, left.size, CHUNK)
    for _ in integrate_chunks(
            DRIVE, ((left[cut:cut + CHUNK], right[cut:cut + CHUNK]) for cut in cuts)):
        pass


def by_numpy(left: np.ndarray, right: np.ndarray) -> None:
    """Compute the minimum of any vectorised integration."""
    np.sin(left)
    np.cos(left)
    np.cumsum(left)
    np.cumsum(left)
    np.cumsum(left)


def by_update(left: list[float], right: list[float]) -> None:
    """Update sample by sample, with the systematic part of the covariance."""
    update = Odometry(DRIVE, geometry_uncertainty=UNCERTAINTY).update
    for number, angles in enumerate(zip(left, right, strict=True)):
        update(*angles, number * 5_000_000)


def by_update_and_read_out(left: list[float], right: list[float]) -> None:
    """Update sample by sample, and read all values of a message."""
    odometry = Odometry(DRIVE, geometry_uncertainty=UNCERTAINTY)
    for number, angles in enumerate(zip(left, right, strict=True)):
        odometry.update(*angles, number * 5_000_000)
        odometry.estimate()


ONLINE: dict[str, Callable] = {'update': by_update, 'update and read-out': by_update_and_read_out}
WORK: dict[str, Callable] = {
    'numpy': by_numpy, 'integrate': by_integrate, 'integrate_chunks': by_chunks, **ONLINE}


def growth(work: Callable[[], None]) -> int:
    """Return the peak growth of this process by some work [bytes]."""
    Path('/proc/self/clear_refs').write_text('5')  # resets the peak to the present memory
    before = peak_memory()
    work()
    return peak_memory() - before


def peak_memory() -> int:
    """Return the peak resident memory [bytes]."""
    status = Path('/proc/self/status').read_text()
    return 1024 * int(re.search(r'VmHWM:\s+(\d+) kB', status)[1])


def main() -> None:
    """Measure."""
    samples, repeats, names = int(sys.argv[1]), int(sys.argv[2]), sys.argv[3:]
    arrays = tuple(wheels(samples))
    lists = [each.tolist() for each in arrays] if set(names) & set(ONLINE) else []
    angles = {name: lists if name in ONLINE else arrays for name in names}
    for name in names:  # imports and first allocations
        WORK[name](*(each[:1000] for each in angles[name]))
    if not repeats:
        print(growth(lambda: WORK[names[0]](*angles[names[0]])) / samples)
        return
    times = {name: [] for name in names}
    for _ in range(repeats):
        for name in names:
            start = time.thread_time()  # excludes other processes
            WORK[name](*angles[name])
            times[name].append(time.thread_time() - start)
    print(json.dumps({
        name: statistics.median(each) / samples * 1e9 for name, each in times.items()}))


if __name__ == '__main__':
    main()
