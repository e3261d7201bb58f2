"""What runs on the robot, with rclpy."""
