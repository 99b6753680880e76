"""The programs: the command line and the page in the browser."""

WHOLE = "no file is left half written."
INTERRUPTED = f"Interrupted; {WHOLE}"
SIGNALLED = 128
"""Added to a signal's number it is the exit code of a program that the signal ended."""
