"""Differential-drive kinematics, odometry and command node for ROS 2."""
