"""What the page accepts and keeps: everything that comes from a browser has a bound."""

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
        kept: bytes of one visitor's folder, beyond which no further record is taken, and nothing identified.
        everything: bytes of all visitors' folders together, beyond which nothing further is taken.
        visitors: whose folders are kept at a time.
        runs: identifications that are kept for a visitor.
        at_once: identifications that run at a time; the others wait.
        read_at_once: records that are read at a time; the others wait.
        waiting: identifications that may wait, and records to be read.
        waiting_each: identifications of one visitor that may wait or run.
        memory: bytes of address space of each process that reads or identifies, where the system bounds it (not
            Windows, not macOS); what the compiled simulation reserves is in it.
        seconds: after which an identification is stopped.
        reading: seconds after which the reading of a record is stopped.
        days: after which the folder of a visitor who did not come back is removed.
    """

    upload: int = 256 * 2**20
    joint_file: int = 256 * 2**10
    kept: int = 2 * 2**30
    everything: int = 20 * 2**30
    visitors: int = 100
    runs: int = 20
    at_once: int = 1
    read_at_once: int = 2
    waiting: int = 20
    waiting_each: int = 5
    memory: int = 4 * 2**30
    seconds: float = 3600.0
    reading: float = 300.0
    days: float = 7.0


def megabytes(size: float) -> str:
    """Return a size in bytes as a sentence says it."""
    return f"{size / 2**20:.0f} MB" if size >= 2**20 else f"{size / 2**10:.0f} kB"
