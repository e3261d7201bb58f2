"""
An odometry node as in most Python packages, for comparison.

It has the default executor, a new message for each answer, covariances set as lists, the midpoint
rule, and no check of missing wheels.
"""
from contextlib import suppress
from math import cos, sin

from nav_msgs.msg import Odometry
import rclpy
from rclpy.executors import ExternalShutdownException
from rclpy.node import Node
from sensor_msgs.msg import JointState

WHEEL_RADIUS, WHEEL_SEPARATION = 0.033, 0.16


class TypicalOdometry(Node):
    """Joint states in, odometry out."""

    def __init__(self) -> None:
        super().__init__('typical_odometry')
        self.last = None
        self.x = self.y = self.theta = 0.0
        self.publisher = self.create_publisher(Odometry, 'odom', 1000)
        self.subscription = self.create_subscription(
            JointState, 'joint_states', self.on_joint_states, 1000)

    def on_joint_states(self, joints: JointState) -> None:
        """Integrate one sample, and publish."""
        time = joints.header.stamp.sec + 1e-9 * joints.header.stamp.nanosec
        left = joints.position[joints.name.index('left_wheel_joint')]
        right = joints.position[joints.name.index('right_wheel_joint')]
        last_time, last_left, last_right = self.last or (time - 1.0, left, right)
        self.last = time, left, right
        left_travel = WHEEL_RADIUS * (left - last_left)
        right_travel = WHEEL_RADIUS * (right - last_right)
        distance = (left_travel + right_travel) / 2.0
        turn = (right_travel - left_travel) / WHEEL_SEPARATION
        self.x += distance * cos(self.theta + turn / 2.0)
        self.y += distance * sin(self.theta + turn / 2.0)
        self.theta += turn

        odometry = Odometry()
        odometry.header.stamp = joints.header.stamp
        odometry.header.frame_id = 'odom'
        odometry.child_frame_id = 'base_link'
        odometry.pose.pose.position.x = self.x
        odometry.pose.pose.position.y = self.y
        odometry.pose.pose.orientation.z = sin(self.theta / 2.0)
        odometry.pose.pose.orientation.w = cos(self.theta / 2.0)
        odometry.twist.twist.linear.x = distance / (time - last_time)
        odometry.twist.twist.angular.z = turn / (time - last_time)
        variances = [0.0] * 36
        variances[0] = variances[7] = variances[35] = 0.01
        odometry.pose.covariance = variances
        odometry.twist.covariance = variances
        self.publisher.publish(odometry)


def main() -> None:
    """Spin until a signal."""
    rclpy.init()
    with suppress(KeyboardInterrupt, ExternalShutdownException):
        rclpy.spin(TypicalOdometry())


if __name__ == '__main__':
    main()
