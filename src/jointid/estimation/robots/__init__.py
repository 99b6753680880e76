"""Identification of a robot: all joints at once, by the inverse dynamics of the whole."""
