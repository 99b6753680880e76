"""Results of a campaign: one file of lines, each on the disk before its result counts as finished.

A line is the result of a case; the last one of a case counts. A kill or a full disk may tear the last line, whose case
is then made again.
"""

from __future__ import annotations

import contextlib
import json
import os
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import asdict, dataclass, field
from enum import StrEnum
from pathlib import Path
from typing import Any, Self

from jointid import __version__
from jointid.campaigns.campaign import Case, canonical
from jointid.common.errors import RecordError
from jointid.common.files import explain, lock, open_file
from jointid.estimation.result.fields import read

_BEGIN = b'{"changes":'  # of each line, whose keys are in order


class Outcome(StrEnum):
    """How a case ended."""

    IDENTIFIED = "identified"
    DOUBTFUL = "not reliable"
    REFUSED = "refused"
    FAILED = "failed"
    SET_ASIDE = "set aside"


RETRIED = (Outcome.REFUSED, Outcome.FAILED, Outcome.SET_ASIDE)
"""Outcomes that are tried again where that is asked for; an answer that is not reliable stays."""


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
        error_percent: norm of the torque error, filtered, over that of the torque.
        record_sha256: of the record's bytes; empty where they could not be read.
        program: the version of jointid that identified it.
    """

    content_hash: str
    joint: str
    record: str
    day: str
    changes: tuple[str, ...]
    outcome: Outcome
    sentence: str
    found: Mapping[str, Found] = field(default_factory=dict)
    trust: str = ""
    error_percent: float | None = None
    record_sha256: str = ""
    settings: tuple[str, ...] = ()
    program: str = __version__

    @classmethod
    def of(cls, case: Case, outcome: Outcome, sentence: str, **more: Any) -> Self:
        """Return the row of a case."""
        about = (case.content_hash, case.joint, case.record, case.day, case.changes)
        return cls(*about, outcome, sentence, settings=case.settings, **more)

    @property
    def place(self) -> tuple[str, str, str, tuple[str, ...], str]:
        """Sort key, independent of engine and order."""
        return (self.joint, self.day, self.record, self.changes, self.content_hash)


class Store:
    """The results of a campaign; see `open_store`."""

    def __init__(self, path: Path, descriptor: int, *, again: bool = False) -> None:
        self._path, self._descriptor = path, descriptor
        self._rows = dict[str, Row]()
        whole = self._read()
        self._retried = {row.content_hash for row in self._rows.values() if again and row.outcome in RETRIED}
        with explain(path):
            os.ftruncate(descriptor, whole)  # without the line that a kill has torn

    def has_result(self, content_hash: str) -> bool:
        """Test whether a case needs no work."""
        return content_hash in self._rows and content_hash not in self._retried

    def add(self, row: Row) -> None:
        """Keep a result; it is on the disk when this returns."""
        content = (canonical(asdict(row)) + "\n").encode("utf-8", "surrogatepass")
        with explain(self._path):
            while content:  # a disk that takes a part of it says why at the next attempt
                content = content[os.write(self._descriptor, content) :]
            os.fsync(self._descriptor)
        self._rows[row.content_hash] = row
        self._retried.discard(row.content_hash)

    def rows_of(self, hashes: Iterable[str]) -> tuple[Row, ...]:
        """Return the results of cases, in an order that depends on no engine."""
        found = [self._rows[one] for one in dict.fromkeys(hashes) if one in self._rows]
        return tuple(sorted(found, key=lambda row: row.place))

    def _read(self) -> int:
        """Take in the lines, and return the size of those that are whole."""
        whole = 0
        with explain(self._path), open_file(self._path) as file:
            for number, line in enumerate(file, 1):
                if not line.endswith(b"\n") and (line.startswith(_BEGIN) or _BEGIN.startswith(line)):
                    break  # torn by a kill
                try:
                    row = read(Row, json.loads(line))
                except (ValueError, TypeError, OverflowError, RecursionError) as error:
                    raise RecordError(
                        f"{self._path}, line {number} is no result of a campaign ({error}); name another file by --out."
                    ) from error
                self._rows[row.content_hash] = row
                whole += len(line)
        return whole


@contextlib.contextmanager
def open_store(path: Path, *, again: bool = False) -> Iterator[Store]:
    """Yield the results in a file, for one process at a time.

    Args:
        path: of the file; it is made if it is not there.
        again: whether what was refused, failed or set aside counts as not done.
    """
    with explain(path):
        if path.exists():
            open_file(path).close()  # which refuses a pipe or a device
        flags = os.O_RDWR | os.O_CREAT | os.O_APPEND | getattr(os, "O_BINARY", 0)
        descriptor = os.open(path, flags, 0o666)
    try:
        if not lock(descriptor):
            raise RecordError(
                f"Another campaign is at work on {path}; wait for its end, or name another file by --out."
            )
        yield Store(path, descriptor, again=again)
    finally:
        os.close(descriptor)
