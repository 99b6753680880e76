"""Results of a campaign: one file of lines, each on the disk before its result counts as finished.

A line is the result of a case, or the death of a worker at one; the last result of a case counts. A kill or a full disk
may tear the last line, whose case is then made again.
"""

from __future__ import annotations

import contextlib
import json
import os
from collections import Counter
from collections.abc import Iterable, Iterator
from dataclasses import asdict
from pathlib import Path
from typing import Any

from jointid.campaigns.cases import Outcome, Row, canonical
from jointid.common.errors import RecordError
from jointid.common.files import lock, open_file

RETRIED = (Outcome.REFUSED, Outcome.FAILED, Outcome.SET_ASIDE)
"""Outcomes that are tried again where that is asked for; an answer that is not reliable stays."""


class Store:
    """The results of a campaign; see `open_store`."""

    def __init__(self, path: Path, descriptor: int, *, again: bool = False) -> None:
        self._path, self._descriptor, self._retried = path, descriptor, set[str]()
        self._rows, self._deaths = dict[str, Row](), Counter[str]()
        whole = self._read()
        if again:
            self._retried = {row.content_hash for row in self._rows.values() if row.outcome in RETRIED}
            self._deaths.clear()
        with _explain(path):
            os.ftruncate(descriptor, whole)  # without the line that a kill has torn

    def has_result(self, content_hash: str) -> bool:
        """Test whether a case needs no work."""
        return content_hash in self._rows and content_hash not in self._retried

    def add(self, row: Row) -> None:
        """Keep a result; it is on the disk when this returns."""
        self._append({"row": asdict(row)})
        self._rows[row.content_hash] = row
        self._retried.discard(row.content_hash)

    def count_death(self, content_hash: str) -> int:
        """Count a death by a case running alone, and return the total."""
        self._append({"death": content_hash})
        self._deaths[content_hash] += 1
        return self._deaths[content_hash]

    def rows_of(self, hashes: Iterable[str]) -> tuple[Row, ...]:
        """Return the results of cases, in an order that depends on no engine."""
        found = [self._rows[one] for one in dict.fromkeys(hashes) if one in self._rows]
        return tuple(sorted(found, key=lambda row: row.place))

    def _append(self, line: dict[str, Any]) -> None:
        content = (canonical(line) + "\n").encode("utf-8", "surrogatepass")
        with _explain(self._path):
            while content:  # a disk that takes a part of it says why at the next attempt
                content = content[os.write(self._descriptor, content) :]
            os.fsync(self._descriptor)

    def _read(self) -> int:
        """Take in the lines, and return the size of those that are whole."""
        whole = 0
        with _explain(self._path), open_file(self._path) as file:
            for number, line in enumerate(file, 1):
                try:
                    said = json.loads(line)
                except (ValueError, RecursionError) as error:
                    if not line.endswith(b"\n") and line.startswith(b"{"):
                        break  # torn by a kill
                    raise self._foreign(number, error) from error
                try:
                    self._take(said)
                except ValueError as error:
                    raise self._foreign(number, error) from error
                whole += len(line)
                if not line.endswith(b"\n"):
                    whole += os.write(self._descriptor, b"\n")
                    break
        return whole

    def _foreign(self, number: int, error: Exception) -> RecordError:
        return RecordError(
            f"{self._path}, line {number} is no result of a campaign ({error}); name another file by --out."
        )

    def _take(self, said: Any) -> None:
        match said:
            case {"row": dict(row)}:
                made = Row.read(json.dumps(row))
                self._rows[made.content_hash] = made
            case {"death": str(content_hash)}:
                self._deaths[content_hash] += 1
            case _:
                raise ValueError("neither a row nor a death")


@contextlib.contextmanager
def open_store(path: Path, *, again: bool = False) -> Iterator[Store]:
    """Yield the results in a file, for one process at a time.

    Args:
        path: of the file; it is made if it is not there.
        again: whether what was refused, failed or set aside counts as not done.
    """
    with _explain(path):
        if path.exists():
            open_file(path).close()  # which refuses a pipe or a device
        flags = os.O_RDWR | os.O_CREAT | os.O_APPEND | getattr(os, "O_BINARY", 0)
        descriptor = os.open(path, flags, 0o666)
    try:
        if lock(descriptor) is False:
            raise RecordError(
                f"Another campaign is at work on {path}; wait for its end, or name another file by --out."
            )
        yield Store(path, descriptor, again=again)
    finally:
        os.close(descriptor)


@contextlib.contextmanager
def _explain(path: Path) -> Iterator[None]:
    try:
        yield
    except OSError as error:
        reason = (error.strerror or type(error).__name__).lower()
        raise RecordError(
            f"{path} cannot be used ({reason}); what is finished is kept: free space there, or mend its rights, and "
            "give the same command again."
        ) from error
