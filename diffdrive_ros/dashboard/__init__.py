"""The page to see and drive a robot with, in NiceGUI."""
