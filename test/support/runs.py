"""Recorded runs of a simulated robot, and the tools run as processes on them."""
import subprocess
import sys

from diffdrive_ros.core.kinematics import DiffDrive
from diffdrive_ros.core.odometry import WheelNoise

TRUTH = DiffDrive(0.3021, 0.0497, 0.0504)
NOISE = WheelNoise(2e-6, 2e-6, 2e-5)
OFFSET = (0.02, 0.01, 0.05)
NOMINAL = """/**:
  ros__parameters:
    left_wheel_names: [left_wheel_joint]
    right_wheel_names: [right_wheel_joint]
    wheel_separation: 0.30
    wheel_radius: 0.05
    cmd_vel_timeout: 0.7
    linear:
      x:
        max_velocity: 0.8
"""


def tool(module, *arguments, **kwargs):
    """Run a tool to its end; return the process with its output."""
    return subprocess.run(
        [sys.executable, '-m', f'diffdrive_ros.tools.{module}', *map(str, arguments)], text=True,
        capture_output=True, timeout=120, check=False, **kwargs)


def rejection(module, *arguments):
    """Return the one line of a tool that ends with exit code 1."""
    done = tool(module, *arguments)
    assert done.returncode == 1, done.stderr
    lines = done.stderr.strip().splitlines()
    assert len(lines) == 1, done.stderr
    assert lines[0].startswith(f'{module}: ')
    return lines[0]


def write_csv(path, run):
    """Write a simulated run as a CSV, the reference between the wheels' rows."""
    rows = [(stamp + 100.0, f'{left:.9f},{right:.9f},,,') for stamp, left, right in zip(
        run.seconds, run.left, run.right, strict=True)]
    rows += [(stamp + 100.0, ',,' + ','.join(f'{value:.9f}' for value in pose))
             for stamp, pose in zip(run.reference_seconds, run.reference, strict=True)]
    path.write_text('stamp,left,right,x,y,theta\n' + ''.join(
        f'{stamp:.9f},{rest}\n' for stamp, rest in sorted(rows)))
    return path
