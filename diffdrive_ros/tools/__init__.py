"""The executables for logs, without ROS."""
