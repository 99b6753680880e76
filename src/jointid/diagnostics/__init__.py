"""Diagnostics: validation, loop check, methods side by side, intervals, sensors and tests, changes."""
