"""The node odometry: cmd_vel to wheel commands, joint_states to odom."""
import sys
from typing import Any

from diffdrive_ros.core.odometry_config import OdometryConfig
from diffdrive_ros.core.parameter_specs import ODOMETRY, RETIRED, Values
from diffdrive_ros.node import parameters, runner
from diffdrive_ros.node.command_loop import CommandLoop
from diffdrive_ros.node.diagnostics import Diagnostics
from diffdrive_ros.node.odom_publisher import OdomPublisher
from diffdrive_ros.node.pose_conversion import read_pose
from diffdrive_ros.node.rclpy_internals import parameter_overrides
from geometry_msgs.msg import PoseWithCovarianceStamped
from rclpy.node import Node
from rclpy.qos import QoSProfile
from std_srvs.srv import Trigger


class OdometryNode(Node):
    """
    Wires parameters, odometry, commands and diagnostics.

    has_parameter_file is whether the process was given one, which must then have the geometry.
    Raises runner.StartError for parameters that are incomplete or wrong.
    """

    def __init__(self, *, has_parameter_file: bool = False, **kwargs: Any) -> None:
        super().__init__('odometry', **kwargs)
        try:
            overrides = parameter_overrides(self, 'odometry', **kwargs)
            values = parameters.declare(self, ODOMETRY, overrides)
            is_example = parameters.is_example_robot(self, overrides, has_parameter_file)
            config = self._config = self._config_of(values)
        except ValueError as error:
            raise runner.StartError(
                f'{self.get_fully_qualified_name()} cannot start: {error}') from None
        self._odom = OdomPublisher(self, config)
        self._commander = config.wheel_commander()
        self._diagnostics = Diagnostics(self, config, self._odom, self._commander, is_example)
        self._command_loop = CommandLoop(
            self, config, self._odom, self._commander, self._diagnostics.report_inhibits)
        parameters.follow_changes(self, ODOMETRY, self._config_of, self._apply)
        self.create_subscription(
            PoseWithCovarianceStamped, '~/set_pose', self._on_set_pose, QoSProfile(depth=10))
        self.create_service(Trigger, '~/reset_odometry', self._on_reset)
        self._limit_warnings: set[str] = set()
        parameters.log_unknown_names(self, overrides, ODOMETRY, RETIRED)
        self._log_start(config, is_example)

    def stop_wheels(self) -> None:
        """Send the last zero."""
        self._command_loop.stop()

    def tick_if_overdue(self) -> None:
        """Do an overdue timer's work; to be called between two callbacks."""
        self._command_loop.tick_if_overdue()

    def _log_start(self, config: OdometryConfig, is_example: bool) -> None:
        """Log geometry, topics as they are resolved, and what may not be meant."""
        drive, logger = config.drive, self.get_logger()
        robot = (f'wheel_separation {drive.wheel_separation:g} m, wheel radii '
                 f'{drive.left_wheel_radius:g} and {drive.right_wheel_radius:g} m')
        if is_example:
            logger.warning(
                f'no geometry is given: the example robot, {robot}; set wheel_separation and '
                'wheel_radius to those of your robot')
        else:
            logger.info(robot)
        source = ('commands as applied (open_loop)' if config.open_loop
                  else self._odom.joint_states_topic)
        logger.info(f'{self._odom.odom_topic}: {config.odom_frame} to {config.base_frame}, from '
                    f'{source}')
        kind = 'TwistStamped' if config.enable_stamped_cmd_vel else 'Twist'
        limit = ('no limit' if config.max_wheel_speed is None
                 else f'at most {config.max_wheel_speed:g} rad/s')
        logger.info(
            f'{", ".join(self._command_loop.topics) or "no wheel commands"}: '
            f'{", ".join(config.left_wheel_names)} | {", ".join(config.right_wheel_names)} by '
            f'{config.wheel_command_type}, {limit}, from {self.resolve_topic_name("cmd_vel")} '
            f'({kind}), timeout {config.cmd_vel_timeout:g} s')
        self._warn_of_no_timeout(config)
        self._warn_of_limits(config)

    def _warn_of_limits(self, config: OdometryConfig) -> None:
        """Warn of limits that may not be meant, unless it was done before."""
        before, self._limit_warnings = self._limit_warnings, set()
        for axis, limits in (
                ('linear.x', config.linear_limits), ('angular.z', config.angular_limits)):
            if limits.without_effect:
                self._limit_warnings.add(
                    f'{axis}: without effect, since their maximum is not set: '
                    f'{", ".join(limits.without_effect)}')
            if limits.max_acceleration == 0.0:
                self._limit_warnings.add(
                    f'{axis}.max_acceleration = 0.0: the robot never starts')
        for text in sorted(self._limit_warnings - before):
            self.get_logger().warning(text)

    def _warn_of_no_timeout(self, config: OdometryConfig) -> None:
        if not config.cmd_vel_timeout:
            self.get_logger().warning(
                'cmd_vel_timeout = 0.0: without further commands the wheels keep turning')

    def _config_of(self, values: Values) -> OdometryConfig:
        return OdometryConfig.of(values, self.get_namespace())

    def _apply(self, config: OdometryConfig) -> None:
        if config.cmd_vel_timeout != self._config.cmd_vel_timeout:
            self._warn_of_no_timeout(config)
        self._warn_of_limits(config)
        self._config = config
        self._odom.odometry.drive = config.drive
        self._command_loop.apply(config)

    def _on_set_pose(self, message: PoseWithCovarianceStamped) -> None:
        try:
            if message.header.frame_id != self._config.odom_frame:
                raise ValueError(
                    f'frame_id = {message.header.frame_id!r}: must be '
                    f'{self._config.odom_frame!r}')
            self._odom.odometry.reset(*read_pose(message))
        except ValueError as error:
            self.get_logger().warning(
                f'~/set_pose: rejected, {error}', throttle_duration_sec=1.0)
        else:
            x, y, theta = self._odom.odometry.pose
            self.get_logger().info(
                f'~/set_pose: {x:g} m, {y:g} m, {theta:g} rad', throttle_duration_sec=1.0)

    def _on_reset(self, request: Any, response: Any) -> Any:
        self._odom.odometry.reset()
        response.success, response.message = True, 'the pose is zero'
        return response


def main() -> None:
    """Run the node as a process."""
    sys.exit(runner.run(
        'odometry', __doc__,
        lambda: OdometryNode(has_parameter_file=runner.has_parameter_file()),
        stop=OdometryNode.stop_wheels, between_callbacks=OdometryNode.tick_if_overdue))


if __name__ == '__main__':
    main()
