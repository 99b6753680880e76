"""A case: a self-contained description of one identification.

The SHA-256 of the description identifies it. A changed record, joint file or version of jointid makes another case.
"""

from __future__ import annotations

import hashlib
import json
from dataclasses import asdict, dataclass
from typing import ClassVar

from jointid import __version__


@dataclass(frozen=True, slots=True)
class Simulated:
    """A simulated run in place of a logged one; the record gives the motion.

    Attributes:
        values: every parameter of the joint by name, in SI units.
        noise_force: standard deviation of a white force on the motor, inside the loop, N or N m.
        noise_log: standard deviation of white noise on the logged torque, N or N m.
    """

    kind: ClassVar[str] = "simulated"
    values: tuple[tuple[str, float], ...]
    noise_force: float = 0.0
    noise_log: float = 0.0
    seed: int = 0


@dataclass(frozen=True, slots=True)
class Redrawn:
    """A record with its residual resampled in blocks of time."""

    kind: ClassVar[str] = "resampled"
    seed: int


@dataclass(frozen=True, slots=True)
class Started:
    """A random start of the search.

    Attributes:
        starts: by parameter, in SI units.
    """

    kind: ClassVar[str] = "started"
    starts: tuple[tuple[str, float], ...]
    seed: int


@dataclass(frozen=True, slots=True)
class Case:
    """One identification of a campaign.

    Attributes:
        joint: the name by which a report calls it.
        joint_file: the text of the joint file.
        record: address of the record, a path or a URL.
        stamp: by which a record that was replaced is known: its size and the time of its change, or its ETag.
        day: on which it was logged, as 2026-11-23; empty where that does not matter.
        changes: keys of the joint file that are changed, each as ``method.frequency=30``.
        varied: the simulated run, the resampled error or the start that is this case's own; None for a logged record.
        program: the version of jointid that described it.
        settings: keys of the joint file that are set for this joint alone, as ``transmission.ratio=100``, by key.

    Example:
        >>> from jointid.campaigns.cases import Case
        >>> case = Case("axis 1", "[joint]", "axis-1.csv", "1200 1763884800000")
        >>> case.content_hash == Case("axis 1", "[joint]", "axis-1.csv", "1200 1763884800001").content_hash
        False
    """

    joint: str
    joint_file: str
    record: str
    stamp: str
    day: str = ""
    changes: tuple[str, ...] = ()
    varied: Simulated | Redrawn | Started | None = None
    program: str = __version__
    settings: tuple[str, ...] = ()

    @property
    def content_hash(self) -> str:
        """SHA-256 of the description, as 64 hexadecimal digits."""
        return sha256_of(canonical(asdict(self)))


def canonical(value: object) -> str:
    """Serialise a value as canonical JSON on one line."""
    return json.dumps(value, sort_keys=True, separators=(",", ":"), ensure_ascii=False, allow_nan=False)


def sha256_of(text: str) -> str:
    """Return the SHA-256 of a text as 64 hexadecimal digits."""
    return hashlib.sha256(text.encode("utf-8", "surrogatepass")).hexdigest()
