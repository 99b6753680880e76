"""Exact simulation: the compiled kernels, and what closes the loop around a joint."""

from jointid.simulation import excitation

__all__ = ["excitation"]
