"""Estimation: problems, methods, the estimate and the verb `identify`."""
