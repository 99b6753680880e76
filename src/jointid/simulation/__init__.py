"""Exact simulation of a joint in closed loop, drive-side and in open loop."""

from jointid.simulation import excitation

__all__ = ["excitation"]
