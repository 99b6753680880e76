"""Friction laws of a motor or a load: `ji.RigidJoint("revolute", ji.friction.Friction("stribeck"))`."""

from jointid.models.friction import Friction

__all__ = ["Friction"]
