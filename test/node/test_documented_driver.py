"""The driver of doc/driver.md, as it stands there, against the node over DDS."""
from collections.abc import Callable, Iterator
from pathlib import Path
import re
import signal
import subprocess
import sys

from nav_msgs.msg import Odometry
import numpy as np
import pytest
from sensor_msgs.msg import JointState
from support.station import Process, Station, twist, wait_until

PAGE = Path(__file__).resolve().parents[2] / 'doc' / 'driver.md'
WATCHDOG = 0.25  # [s], of the page


@pytest.fixture
def driver(tmp_path: Path, domain: int) -> Iterator[subprocess.Popen]:
    """Run the driver of the page as a process."""
    blocks = re.findall(r'^```python\n(.*?)^```', PAGE.read_text(), re.DOTALL | re.MULTILINE)
    assert len(blocks) == 1
    script = tmp_path / 'driver.py'
    script.write_text(blocks[0])
    process = subprocess.Popen(
        [sys.executable, script], stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True)
    yield process
    process.kill()
    process.communicate()


def test_documented_driver_drives_and_its_watchdog_stops_it(
        driver: subprocess.Popen, station: Station, start: Callable[..., Process]) -> None:
    """Forward and left as the page has it, then the stop after kill -9, then Ctrl-C."""
    poses = station.subscribe(Odometry, 'odom')
    joints = station.subscribe(JointState, 'joint_states')
    odometry = start('odometry_node', wheel_separation=0.160, wheel_radius=0.033)
    wait_until(lambda: poses)
    commands = iter(lambda: twist(0.1, 0.5), None)
    station.publish_until(
        lambda: abs(poses[-1][1].twist.twist.linear.x - 0.1) < 0.01
        and abs(poses[-1][1].twist.twist.angular.z - 0.5) < 0.05, 'cmd_vel', commands)
    assert poses[-1][1].pose.pose.position.x > 0.0
    left, right = angles(joints[-1][1])
    assert 0.0 < left < right

    odometry.signal(signal.SIGKILL)
    assert odometry.wait() == -signal.SIGKILL
    killed = len(joints)
    wait_until(lambda: len(joints) > killed + 3
               and (angles(joints[-1][1]) == angles(joints[-4][1])).all())
    moved = [heard_at for (heard_at, message), (_, before) in zip(
        joints[killed:], joints[killed - 1:], strict=False)
        if (angles(message) != angles(before)).any()]
    # Two periods of the timer and a busy machine may come on top.
    assert not moved or moved[-1] - joints[killed - 1][0] < WATCHDOG + 1.0

    driver.send_signal(signal.SIGINT)
    output = driver.communicate(timeout=10.0)[0]
    assert driver.returncode == 0, output
    assert 'Traceback' not in output


def angles(message: JointState) -> np.ndarray:
    """Return the angles of the left and the right wheel [rad]."""
    assert message.name == ['left_wheel_joint', 'right_wheel_joint']
    return np.array(message.position)
