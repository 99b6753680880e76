"""Friction laws of a motor or a load: `ji.RigidJoint("revolute", ji.friction.StribeckFriction())`."""

from jointid.models.friction import (
    AsymmetricFriction,
    AsymmetricStribeckFriction,
    DriftingFriction,
    LoadDependentFriction,
    PreslidingFriction,
    StribeckFriction,
    SymmetricFriction,
    WoundLoadDependentFriction,
)

__all__ = [
    "AsymmetricFriction", "AsymmetricStribeckFriction", "DriftingFriction", "LoadDependentFriction",
    "PreslidingFriction", "StribeckFriction", "SymmetricFriction", "WoundLoadDependentFriction",
]  # fmt: skip
