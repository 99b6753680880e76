"""A row: the reproducible result of a case."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from enum import StrEnum
from typing import Any, Self

from jointid.campaigns.cases import Case, sha256_of

LOGGED = "logged"
"""Kind of a run that was no simulation: it has a time."""


class Outcome(StrEnum):
    """How a case ended."""

    IDENTIFIED = "identified"
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
        seed: of a run that is simulated, resampled or has a random start; None for another one.
        outcome: how it ended; a refusal is the record's or the joint file's fault, a failure is one of jointid's.
        sentence: the answer in a line, or why there is none.
        found: parameters, and sums that are known where their parts are not, by name.
        trust: whether to rely on the answer, a code.
        converged: whether the search did; None where there was none.
        error_percent: norm of the torque error, filtered, over that of the torque.
        record_sha256: of the record's bytes; empty where they could not be read.
        joint_file_sha256: of the joint file's text.
        versions: of jointid, Python and the libraries that compute, by name.
        kind: of the run: logged, simulated, resampled, or a search that is started elsewhere.
        truth: of a simulated run what is true of each that is found, by name, in its unit.
    """

    content_hash: str
    joint: str
    record: str
    day: str
    changes: tuple[str, ...]
    seed: int | None
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
    kind: str = LOGGED
    truth: Mapping[str, float] = field(default_factory=dict)

    @classmethod
    def of(cls, case: Case, outcome: Outcome, sentence: str, **more: Any) -> Self:
        """Return the row of a case."""
        seed, kind = (None, LOGGED) if case.varied is None else (case.varied.seed, case.varied.kind)
        return cls(
            case.content_hash, case.joint, case.record, case.day, case.changes, seed, outcome, sentence,
            sha256_of(case.joint_file), settings=case.settings, kind=kind, **more,
        )  # fmt: skip

    def text(self) -> str:
        """Serialise the row as JSON on one line, in ASCII."""
        return json.dumps(asdict(self), sort_keys=True, separators=(",", ":"), allow_nan=False)

    @classmethod
    def read(cls, text: str) -> Self:
        """Parse a row from `text`."""
        try:
            raw = json.loads(text)
            found = {str(name): Found(_number(one["value"]), _number(one["std"]), str(one["unit"]))
                     for name, one in raw["found"].items()}  # fmt: skip
            raw |= {key: tuple(map(str, raw.get(key, ()))) for key in ("changes", "settings")}
            truth = {str(name): float(value) for name, value in raw.get("truth", {}).items()}
            raw |= {"found": found, "outcome": Outcome(raw["outcome"]), "truth": truth}
            row = cls(**raw)
        except (TypeError, KeyError, AttributeError, RecursionError) as error:
            raise ValueError(f"no row ({error})") from error
        texts = (row.content_hash, row.joint, row.record, row.day, row.sentence, row.trust, row.record_sha256, row.kind)
        if not all(isinstance(one, str) for one in texts):
            raise ValueError("no row (a text is none)")
        return row

    @property
    def place(self) -> tuple[str, str, str, int, tuple[str, ...], str]:
        """Sort key, independent of engine and order."""
        return (
            self.joint,
            self.day,
            self.record,
            -1 if self.seed is None else self.seed,
            self.changes,
            self.content_hash,
        )


def finite(value: float | None) -> float | None:
    """Return a finite number, else None, for JSON."""
    return None if value is None or not math.isfinite(value) else float(value)


def _number(value: object) -> float | None:
    if value is None or (isinstance(value, int | float) and not isinstance(value, bool)):
        return None if value is None else float(value)
    raise TypeError("a value is no number")
