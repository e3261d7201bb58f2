"""The texts of the page: who may drive, and the numbers beside the map."""
from diffdrive_ros.dashboard.page_permission import PagePermission
from diffdrive_ros.dashboard.robot import DashboardRobot
from diffdrive_ros.dashboard.teleop import Twist


def status_text(robot: DashboardRobot, permission: PagePermission) -> str:
    """Return the status line of a page."""
    others = ', '.join(robot.other_commanders)
    return _state(robot, permission) + (f' ({others} on cmd_vel too)' if others else '')


def speeds_text(robot: DashboardRobot) -> str:
    """Return the wheel speeds, and the twists as commanded, applied and measured."""
    has_applied = robot.applied or robot.parameters.value('publish_limited_velocity')
    return '\n'.join((
        f'wheels    {_pair(robot.wheels, "", "rad/s")}',
        f'commanded {_twist(robot.commanded)}',
        f'applied   {_twist(robot.applied)}'
        + ('' if has_applied else '\n(publish_limited_velocity is false)'),
        f'measured  {_twist(robot.twist)}'))


def ellipse_text(robot: DashboardRobot) -> str:
    """Return the size of the covariance ellipse."""
    size = f': ±{robot.ellipse[0]:.3f} × {robot.ellipse[1]:.3f} m' if robot.ellipse else ''
    return f'● 95 % of the position{size}'


def _state(robot: DashboardRobot, permission: PagePermission) -> str:
    if robot.odom is None:
        return 'No robot yet: nothing received on odom'
    if robot.software_stop.is_confirmed:
        return 'STOPPED: the node inhibits the wheels until the stop is released'
    if robot.software_stop.is_active:
        return 'STOPPED here: the node has not confirmed it yet'
    if robot.inhibits:
        return f'The node inhibits the wheels: {robot.inhibits}'
    if reason := robot.reason_not_to_drive:
        return f'Display only: {reason}'
    if not permission.may_change:
        return 'Display only: a real robot'
    if robot.teleop.driver and not permission.is_driver:
        return 'Another page drives'
    if reason := robot.teleop.stop_reason(permission.page):
        return f'Stopped: {reason}. Release the controls, and press again'
    return 'You drive' if permission.is_driver else 'Nobody drives: press a key or the joystick'


def _twist(twist: Twist | None) -> str:
    return _pair(twist, 'm/s ', 'rad/s')


def _pair(pair: tuple[float, float] | None, first: str, second: str) -> str:
    if pair is None:
        return '   no data'
    one, other = (round(value, 2) + 0.0 for value in pair)  # no -0.00
    return f'{one:7.2f} {first}{other:6.2f} {second}'
