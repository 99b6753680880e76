"""Bounds of what the page accepts, and of the processes that read and identify."""

from __future__ import annotations

from dataclasses import dataclass

LOOPBACK = ("127.0.0.1", "localhost", "::1")
"""Addresses that only this machine reaches."""


@dataclass(frozen=True, slots=True)
class Limits:
    """Bounds of one page.

    Attributes:
        upload: bytes of a record.
        joint_file: bytes of a joint file.
        memory: bytes of address space of each process that reads or identifies, where the system bounds it (not
            Windows, not macOS); what the compiled simulation reserves is in it.
        seconds: after which an identification is stopped.
        reading: seconds after which the reading of a record is stopped.
    """

    upload: int = 256 * 2**20
    joint_file: int = 256 * 2**10
    memory: int = 4 * 2**30
    seconds: float = 3600.0
    reading: float = 300.0


def format_size(size: float) -> str:
    """Return a size in bytes as a sentence says it."""
    return f"{size / 2**20:.0f} MB" if size >= 2**20 else f"{size / 2**10:.0f} kB"
