"""Exact simulation of a joint in closed loop and on the drive side."""

from jointid.simulation import excitation

__all__ = ["excitation"]
