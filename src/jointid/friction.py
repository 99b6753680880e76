"""Friction laws of a motor or a load: `ji.RigidJoint("revolute", ji.friction.StribeckFriction())`."""

from jointid.models.friction import (
    AsymmetricFriction,
    AsymmetricLoadDependentFriction,
    AsymmetricStribeckFriction,
    DriftingFriction,
    LoadDependentFriction,
    PreslidingFriction,
    StribeckFriction,
    SymmetricFriction,
    WoundLoadDependentFriction,
)

__all__ = [
    "AsymmetricFriction", "AsymmetricLoadDependentFriction", "AsymmetricStribeckFriction", "DriftingFriction",
    "LoadDependentFriction", "PreslidingFriction", "StribeckFriction", "SymmetricFriction",
    "WoundLoadDependentFriction",
]  # fmt: skip
