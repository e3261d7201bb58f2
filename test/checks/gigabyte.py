"""
Measure speed and memory of replay on a large bag; exit with 1 below the limits.

Writes a bag of a gigabyte, wheels and reference at 200 Hz among images, and replays it.
"""
import argparse
from pathlib import Path
import resource
import subprocess
import sys
import tempfile
import time

import numpy as np
from support import bags

RATE = 200
MIN_MESSAGES_PER_S = 20_000  # of the wheels
MIN_TIMES_REAL_TIME = 50
MAX_MEGABYTES = 500


def messages(seconds: float, size: int):
    """Yield joint states and a reference, and images of a total size [bytes]."""
    count = int(seconds * RATE)
    images = max(1, size // 1_000_000)
    every = max(1, count // images)
    image = bags.TYPES['sensor_msgs/msg/Image']
    pixels = np.random.default_rng(1).integers(0, 256, 1_000_000, np.uint8)
    names = ['left_wheel_joint', 'right_wheel_joint']
    for index in range(count):
        stamp = bags.START_NS + index * 10**9 // RATE
        yield '/joint_states', stamp, bags.joints(stamp, names, [0.02 * index, 0.021 * index])
        yield '/odom', stamp, bags.reference(
            'nav_msgs/msg/Odometry', stamp, (0.001 * index, 0.0, 0.0))
        if index % every == 0:
            yield '/camera', stamp, image(
                bags.header(stamp), 1000, 1000, 'mono8', 0, 1000, pixels)


def main() -> int:
    """Print the figures; return 0 within the limits."""
    parser = argparse.ArgumentParser(description=__doc__.split('\n\n')[0])
    parser.add_argument('--gigabytes', type=float, default=1.0)
    parser.add_argument('--seconds', type=float, default=500.0, help='duration of the bag')
    parser.add_argument('--storage', choices=bags.PLUGINS, default='mcap')
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        bag = bags.write(
            Path(folder) / 'bag', options.storage,
            messages(options.seconds, int(options.gigabytes * 1e9)))
        size = bags.file_of(bag).stat().st_size
        params = Path(folder) / 'robot.yaml'
        params.write_text(
            '/**:\n  ros__parameters:\n    wheel_separation: 0.3\n    wheel_radius: 0.05\n')
        start = time.monotonic()
        subprocess.run(
            [sys.executable, '-m', 'diffdrive_ros.tools.replay', bag, '--params-file', params,
             '--reference-topic', 'odom', '--output', Path(folder) / 'out.tum'], check=True)
        took = time.monotonic() - start
    usage = resource.getrusage(resource.RUSAGE_CHILDREN)
    rate = options.seconds * RATE / took
    megabytes = usage.ru_maxrss / 1024
    used = usage.ru_utime + usage.ru_stime
    times = options.seconds / took
    print(f'{size / 1e9:.2f} GB of {options.seconds:g} s in {took:.2f} s ({used:.2f} s of one '
          f'core): {rate:.0f} wheel messages a second, {times:.0f} times real time, '
          f'{megabytes:.0f} MB')
    good = (rate >= MIN_MESSAGES_PER_S and times > MIN_TIMES_REAL_TIME
            and megabytes < MAX_MEGABYTES)
    return 0 if good else 1


if __name__ == '__main__':
    sys.exit(main())
