"""Shards: parts of a campaign without a client, each with its own result file.

The case's hash modulo the number of shards selects the shard. Lines are appended at once; a torn last line of a killed
shard is repeated.
"""

from __future__ import annotations

import contextlib
import json
import os
import re
import time
from collections.abc import Collection, Iterable, Iterator, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

from jointid.campaigns.cases import Row, canonical, read_time
from jointid.campaigns.store import DATABASE, SHARD_FILES
from jointid.common.errors import MethodError, RecordError
from jointid.common.files import lock, open_file

_NAME = "shard-{}-of-{}.jsonl"


@dataclass(frozen=True, slots=True)
class Shard:
    """One of several parts of a campaign.

    Attributes:
        number: of it, from 1.

    Example:
        >>> from jointid.campaigns.shards import Shard
        >>> shard = Shard.of("2/4")
        >>> shard.has("00" * 32), shard.has("00" * 31 + "01")
        (False, True)
    """

    number: int
    count: int

    @classmethod
    def of(cls, text: str) -> Shard:
        """Parse a shard such as 2/4."""
        said = re.fullmatch(r"(\d{1,6})/(\d{1,6})", text)
        if said is None or not 1 <= int(said[1]) <= int(said[2]):
            raise MethodError(f'--shard is "{text}"; expected its number and how many there are, as 1/4 to 4/4.')
        return cls(int(said[1]), int(said[2]))

    def has(self, content_hash: str) -> bool:
        """Test whether a case belongs to this shard."""
        return int(content_hash, 16) % self.count == self.number - 1

    def path(self, folder: Path) -> Path:
        """Return the path of its file."""
        return folder / _NAME.format(self.number, self.count)


@dataclass(slots=True)
class _Contents:
    """Lines of a shard's file: campaign, cases, results with time, and deaths."""

    name: str = ""
    cases: dict[str, None] = field(default_factory=dict)
    rows: dict[str, tuple[float, Row]] = field(default_factory=dict)
    deaths: dict[str, int] = field(default_factory=dict)

    def take(self, said: Any) -> None:
        """Take a line in."""
        match said:
            case {"row": dict(row), "stored": float(stored)}:
                made = Row.read(json.dumps(row))
                self.rows.setdefault(made.content_hash, (read_time(stored), made))
            case {"cases": list(cases), "name": str(name)}:
                self.name, self.cases = name, dict.fromkeys(map(str, cases))
            case {"more": list(more), "fewer": list(fewer), "name": str(name)}:
                gone = set(map(str, fewer))
                kept = (one for one in self.cases if one not in gone)
                self.name, self.cases = name, dict.fromkeys([*kept, *map(str, more)])
            case {"death": str(content_hash)}:
                self.deaths[content_hash] = self.deaths.get(content_hash, 0) + 1
            case _:
                raise ValueError("no line of a shard")


class ShardFile:
    """Results of a shard, an append-only file; see `open_shard`."""

    def __init__(self, path: Path, descriptor: int, contents: _Contents, elsewhere: Collection[str] = ()) -> None:
        self._path, self._descriptor, self._contents = path, descriptor, contents
        self._finished = {*contents.rows, *elsewhere}

    def list_cases(self, name: str, hashes: Iterable[str]) -> int:
        """Store the changes of the campaign's cases; see `store.Results`."""
        cases, before = dict.fromkeys(hashes), self._contents.cases
        more, fewer = list(cases.keys() - before.keys()), list(before.keys() - cases.keys())
        if more or fewer or name != self._contents.name:
            changed: dict[str, Any] = {"more": sorted(more), "fewer": sorted(fewer)}
            self._append({"name": name, **(changed if len(more) + len(fewer) < len(cases) else {"cases": [*cases]})})
            self._contents.name, self._contents.cases = name, cases
        return len(cases)

    def has_result(self, content_hash: str) -> bool:
        """Test whether a case has a result."""
        return content_hash in self._finished

    def add(self, rows: Sequence[Row]) -> None:
        """Keep results; they are on the disk when this returns."""
        for row in rows:
            if row.content_hash not in self._finished:
                self._append({"row": asdict(row), "stored": time.time()})
                self._finished.add(row.content_hash)

    def count_death(self, content_hash: str) -> int:
        """Count a death by a case; see `store.Results`."""
        self._append({"death": content_hash})
        self._contents.deaths[content_hash] = self._contents.deaths.get(content_hash, 0) + 1
        return self._contents.deaths[content_hash]

    def _append(self, line: dict[str, Any]) -> None:
        content = (canonical(line) + "\n").encode("utf-8", "surrogatepass")
        with _explain(self._path):
            while content:  # a disk that takes a part of it says why at the next attempt
                content = content[os.write(self._descriptor, content) :]
            os.fsync(self._descriptor)


@contextlib.contextmanager
def open_shard(folder: Path, shard: Shard) -> Iterator[ShardFile]:
    """Yield the file of a shard, in an existing, possibly remote folder."""
    path = shard.path(folder)
    if (folder / DATABASE).exists():
        raise RecordError(f"{folder} has the results of campaign run; name another folder by --out, or go on with run.")
    with _explain(path):
        if path.exists():
            open_file(path).close()
        descriptor = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_APPEND | getattr(os, "O_BINARY", 0), 0o666)
    try:
        with _explain(path):
            if lock(descriptor) is False:
                raise RecordError(f"Another process is at work on {path}; wait for its end.")
            contents, ends = _read(path)
            if not ends:
                os.write(descriptor, b"\n")  # of a torn line, which is made again
            finished = {one for other in folder.glob(SHARD_FILES) if other != path for one in _read(other)[0].rows}
        yield ShardFile(path, descriptor, contents, finished)
    finally:
        os.close(descriptor)


def has_shards(folder: Path) -> bool:
    """Test whether a folder has shard files."""
    return any(folder.glob(SHARD_FILES))


def read_shards(folder: Path) -> tuple[str, int, list[tuple[float, Row]]]:
    """Merge the files of all shards by hash, as `store.read_database`.

    The campaign's cases are those of the latest listing.
    """
    name, cases, rows = "", dict[str, None](), dict[str, tuple[float, Row]]()
    for path in sorted(folder.glob(SHARD_FILES), key=lambda one: one.stat().st_mtime_ns):
        with _explain(path):
            contents, _ = _read(path)
        if contents.cases:
            name, cases = contents.name, contents.cases
        for content_hash, found in contents.rows.items():
            rows.setdefault(content_hash, found)
    return name, len(cases), [rows[one] for one in cases if one in rows]


def _read(path: Path) -> tuple[_Contents, bool]:
    """Contents of a shard's file, and whether it ends with a whole line."""
    contents, line = _Contents(), b"\n"
    with open_file(path) as file:
        for number, line in enumerate(file, 1):
            try:
                said = json.loads(line)
            except (ValueError, RecursionError):  # torn by a kill: its case is made again
                continue
            try:
                contents.take(said)
            except ValueError as error:
                raise RecordError(
                    f"{path}, line {number} is {error}; delete that line: jointid campaign work makes its case again."
                ) from error
    return contents, line.endswith(b"\n")


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
