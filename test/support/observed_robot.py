"""What pages do with the robot that the dashboard observes."""
import asyncio

from diffdrive_ros.dashboard.robot import DashboardRobot
from diffdrive_ros.dashboard.teleop import Heartbeat, STOP
from diffdrive_ros.node import steady_clock

FORWARD = (0.3, 0.0)


def read_parameters(robot: DashboardRobot) -> None:
    """Have the parameters of the robot read."""
    asyncio.run(robot.parameters.read())


def drive(robot: DashboardRobot) -> None:
    """Have a page drive."""
    for number, command in enumerate((STOP, FORWARD)):
        now = steady_clock.steady()
        robot.publish(robot.teleop.accept('a', Heartbeat(number, now, command), now))
    assert robot.teleop.is_moving
