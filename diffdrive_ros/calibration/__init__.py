"""Arrays in, geometry and its uncertainty out, with scipy."""
