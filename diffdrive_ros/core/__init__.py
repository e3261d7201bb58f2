"""What stands on numpy and the standard library alone."""
