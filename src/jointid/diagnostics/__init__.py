"""Diagnostics: validation, loop check, comparison of methods, intervals, sensors, changes."""
