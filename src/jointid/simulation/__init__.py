"""Exact simulation: the compiled kernels, and what closes the loop around a joint."""
