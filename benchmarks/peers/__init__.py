"""The peers, one file each; a peer that is not installed is a row that says so."""

from __future__ import annotations

from importlib import import_module

from benchmarks.peers.shape import Peer, Setting

_WHERE = {
    "jointid": "engine.Engine",
    "c": "c_stick.CStick",
    "mujoco": "mujoco_step.MujocoStep",
    "scipy": "scipy_ivp.SolveIvp",
}

PEERS = tuple(_WHERE)
"""Their keys, in the order of the table."""


def peer(key: str) -> type[Peer]:
    """Return a peer by its key; what it needs is imported when it is made."""
    module, name = _WHERE[key].split(".")
    return getattr(import_module(f"{__name__}.{module}"), name)  # type: ignore[no-any-return]


__all__ = ["PEERS", "Peer", "Setting", "peer"]
