"""Tools for those who work on the package; nothing of them is installed."""
