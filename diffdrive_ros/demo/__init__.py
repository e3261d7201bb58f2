"""The demo: a simulated robot drives a path, and its odometry is checked."""
