"""A case, the description of one identification, and its row, the reproducible result.

The SHA-256 of the description identifies it. A changed record, joint file or version of jointid makes another case.
"""

from __future__ import annotations

import hashlib
import json
import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from enum import StrEnum
from typing import Any, Self

from jointid import __version__


@dataclass(frozen=True, slots=True)
class Case:
    """One identification of a campaign.

    Attributes:
        joint: the name by which a report calls it.
        joint_file: the text of the joint file.
        record: path of the record.
        stamp: by which a record that was replaced is known: its size and the time of its change.
        day: on which it was logged, as 2026-11-23; empty where that does not matter.
        changes: keys of the joint file that are changed, each as ``method.frequency=30``.
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


class Outcome(StrEnum):
    """How a case ended."""

    IDENTIFIED = "identified"
    DOUBTFUL = "not reliable"
    REFUSED = "refused"
    FAILED = "failed"
    SET_ASIDE = "set aside"


@dataclass(frozen=True, slots=True)
class Found:
    """An identified parameter or combination.

    Attributes:
        value: in SI units; None where it is refused.
        std: its standard deviation; None where it was kept fixed.
    """

    value: float | None
    std: float | None
    unit: str


@dataclass(frozen=True, slots=True)
class Row:
    """The result of a case.

    Attributes:
        outcome: how it ended; a refusal is the record's or the joint file's fault, a failure is one of jointid's. A
            search without an end, value or fit is not reliable.
        sentence: the answer in a line, or why there is none.
        found: parameters, and sums that are known where their parts are not, by name.
        trust: whether to rely on the answer, a code.
        converged: whether the search did; None where there was none.
        error_percent: norm of the torque error, filtered, over that of the torque.
        record_sha256: of the record's bytes; empty where they could not be read.
        joint_file_sha256: of the joint file's text.
        versions: of jointid, Python and the libraries that compute, by name.
    """

    content_hash: str
    joint: str
    record: str
    day: str
    changes: tuple[str, ...]
    outcome: Outcome
    sentence: str
    joint_file_sha256: str
    found: Mapping[str, Found] = field(default_factory=dict)
    trust: str = ""
    converged: bool | None = None
    error_percent: float | None = None
    simulations: int | None = None
    record_sha256: str = ""
    versions: Mapping[str, str] = field(default_factory=dict)
    settings: tuple[str, ...] = ()

    @classmethod
    def of(cls, case: Case, outcome: Outcome, sentence: str, **more: Any) -> Self:
        """Return the row of a case."""
        return cls(
            case.content_hash, case.joint, case.record, case.day, case.changes, outcome, sentence,
            sha256_of(case.joint_file), settings=case.settings, **more,
        )  # fmt: skip

    def text(self) -> str:
        """Serialise the row as JSON on one line, in ASCII."""
        return json.dumps(asdict(self), sort_keys=True, separators=(",", ":"), allow_nan=False)

    @classmethod
    def read(cls, text: str) -> Self:
        """Parse a row.

        Raises:
            ValueError: it is none.
        """
        try:
            raw = json.loads(text)
            found = {str(name): Found(_number(one["value"]), _number(one["std"]), str(one["unit"]))
                     for name, one in raw["found"].items()}  # fmt: skip
            raw |= {key: tuple(map(str, raw.get(key, ()))) for key in ("changes", "settings")}
            raw |= {"found": found, "outcome": Outcome(raw["outcome"])}
            row = cls(**raw)
            _number(row.error_percent)
            named = (row.joint_file_sha256, *row.versions, *row.versions.values())
        except (TypeError, KeyError, AttributeError, RecursionError, OverflowError) as error:
            raise ValueError(f"no row ({error})") from error
        texts = (row.content_hash, row.joint, row.record, row.day, row.sentence, row.trust, row.record_sha256)
        if not all(isinstance(one, str) for one in (*texts, *named)):
            raise ValueError("no row (a text is none)")
        if not (row.simulations is None or type(row.simulations) is int):
            raise ValueError("no row (a count is none)")
        if not isinstance(row.converged, bool | None):
            raise ValueError("no row (whether it converged is neither true nor false)")
        return row

    @property
    def place(self) -> tuple[str, str, str, tuple[str, ...], str]:
        """Sort key, independent of engine and order."""
        return (self.joint, self.day, self.record, self.changes, self.content_hash)


def finite(value: float | None) -> float | None:
    """Return a finite number, else None, for JSON."""
    return None if value is None or not math.isfinite(value) else float(value)


def _number(value: object) -> float | None:
    if value is None:
        return None
    if isinstance(value, int | float) and not isinstance(value, bool) and math.isfinite(value):
        return float(value)
    raise TypeError("a value is no number")
