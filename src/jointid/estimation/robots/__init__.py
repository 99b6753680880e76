"""Identification of a robot: all joints at once, by its whole dynamics."""
