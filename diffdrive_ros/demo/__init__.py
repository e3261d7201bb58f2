"""A robot that drives a figure, and a verdict."""
