"""The identification methods, one file each, and the regressions they share."""
