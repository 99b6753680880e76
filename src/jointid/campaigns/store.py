"""Result database of the client, on its local disk.

Each result is committed before it counts as finished, so that a kill or a full disk loses none. Write-ahead logging
allows concurrent readers, but needs shared memory, which network disks lack.
"""

from __future__ import annotations

import contextlib
import sqlite3
import sys
import time
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path
from typing import Protocol

from jointid.campaigns.cases import Outcome, Row, read_time
from jointid.common.errors import RecordError
from jointid.common.text import short

DATABASE = "campaign.sqlite"
SHARD_FILES = "shard-*-of-*.jsonl"
"""Names of the results of shards, which stand in another folder than a database."""
_LOCK = "campaign.lock"
_FORMAT = 1
_LONGEST = 2**24  # bytes of a result
_PATIENCE = 60.0  # s that a reader may hold the database
_NETWORK = (
    "nfs", "cifs", "smb", "lustre", "gpfs", "beegfs", "9p", "ceph", "glusterfs", "afs", "ncpfs", "ocfs2", "gfs2",
    "pvfs2", "orangefs", "panfs", "wekafs", "davfs", "fuse.sshfs", "fuse.s3fs", "fuse.gcsfuse", "fuse.rclone",
    "fuse.ceph", "fuse.glusterfs", "fuse.juicefs", "fuse.blobfuse", "fuse.beegfs", "fuse.mount-s3",
)  # fmt: skip
_TABLES = (
    "CREATE TABLE listed (hash TEXT PRIMARY KEY) WITHOUT ROWID",
    "CREATE TABLE results (hash TEXT PRIMARY KEY, stored REAL NOT NULL, row TEXT NOT NULL)",
    "CREATE TABLE deaths (hash TEXT PRIMARY KEY, count INTEGER NOT NULL) WITHOUT ROWID",
    "CREATE TABLE about (key TEXT PRIMARY KEY, value TEXT NOT NULL) WITHOUT ROWID",
)


class Results(Protocol):
    """Storage of a campaign's results: a database or a shard's file."""

    def list_cases(self, name: str, hashes: Iterable[str]) -> int:
        """Store the campaign's cases, and return their number; rows of others are hidden."""

    def has_result(self, content_hash: str) -> bool:
        """Test whether a case has a result."""

    def add(self, rows: Sequence[Row]) -> None:
        """Store results atomically; existing ones stay."""

    def count_death(self, content_hash: str) -> int:
        """Count a death by a case running alone, and return the total."""


class Database:
    """Results of a campaign in a client's folder; see `open_database`."""

    def __init__(self, path: Path, connection: sqlite3.Connection) -> None:
        self._path, self._connection = path, connection

    def list_cases(self, name: str, hashes: Iterable[str]) -> int:
        """See `Results`."""
        with _explain(self._path), self._connection as transaction:
            transaction.execute("DELETE FROM listed")
            transaction.executemany("INSERT OR IGNORE INTO listed VALUES (?)", ((one,) for one in hashes))
            about = {"name": name, "format": str(_FORMAT)}
            transaction.executemany("INSERT OR REPLACE INTO about VALUES (?, ?)", about.items())
            return int(transaction.execute("SELECT count(*) FROM listed").fetchone()[0])

    def has_result(self, content_hash: str) -> bool:
        """See `Results`."""
        with _explain(self._path):
            found = self._connection.execute("SELECT 1 FROM results WHERE hash = ?", (content_hash,))
            return found.fetchone() is not None

    def add(self, rows: Sequence[Row]) -> None:
        """Store results in one transaction, durable on return."""
        with _explain(self._path), self._connection as transaction:
            transaction.executemany(
                "INSERT OR IGNORE INTO results VALUES (?, ?, ?)",
                [(row.content_hash, time.time(), row.text()) for row in rows],
            )

    def count_death(self, content_hash: str) -> int:
        """See `Results`."""
        with _explain(self._path), self._connection as transaction:
            transaction.execute(
                "INSERT INTO deaths VALUES (?, 1) ON CONFLICT (hash) DO UPDATE SET count = count + 1", (content_hash,)
            )
            return int(transaction.execute("SELECT count FROM deaths WHERE hash = ?", (content_hash,)).fetchone()[0])

    def forget_failures(self) -> int:
        """Delete failed results, to be retried; return their number."""
        with _explain(self._path), self._connection as transaction:
            transaction.execute("DELETE FROM deaths")
            done = str(Outcome.IDENTIFIED)
            return transaction.execute(
                "DELETE FROM results WHERE json_extract(row, '$.outcome') <> ?", (done,)
            ).rowcount


@contextlib.contextmanager
def open_database(folder: Path) -> Iterator[Database]:
    """Yield the database of an existing folder for its single writer."""
    require_local_disk(folder)
    if any(folder.glob(SHARD_FILES)):
        raise RecordError(f"{folder} has the results of shards; name another folder by --out, or go on with work.")
    path = folder / DATABASE
    with (
        _explain(path),
        contextlib.closing(_lock(folder)),
        contextlib.closing(sqlite3.connect(path, timeout=_PATIENCE)) as connection,
    ):
        connection.execute("PRAGMA journal_mode=WAL")
        connection.execute("PRAGMA synchronous=FULL")  # a result outlives a power cut, too
        there = _require_own_tables(path, connection)
        connection.executescript(";".join(table for table in _TABLES if table not in there))
        found = dict(connection.execute("SELECT key, value FROM about").fetchall()).get("format", str(_FORMAT))
        if found != str(_FORMAT):
            raise RecordError(
                f"{path} is of format {found}, and this jointid knows {_FORMAT}; use the one that wrote it."
            )
        yield Database(path, connection)


def _lock(folder: Path) -> sqlite3.Connection:
    """Lock a folder for one client; the system releases it."""
    connection = sqlite3.connect(folder / _LOCK, timeout=0.0, isolation_level=None)
    try:
        connection.execute("BEGIN EXCLUSIVE")
    except sqlite3.OperationalError as error:
        connection.close()
        if "locked" not in str(error):
            raise
        raise RecordError(
            f"Another campaign is at work in {folder}; wait for its end, or name another folder by --out."
        ) from error
    return connection


def read_database(folder: Path) -> tuple[str, int, list[tuple[float, Row]]]:
    """Campaign name, number of cases, and results with storage time."""
    path = folder / DATABASE
    with _explain(path), contextlib.closing(sqlite3.connect(path, timeout=_PATIENCE)) as connection:
        if not _require_own_tables(path, connection):
            return "", 0, []  # it has only just started
        about = dict(connection.execute("SELECT key, value FROM about").fetchall())
        (total,) = connection.execute("SELECT count(*) FROM listed").fetchone()
        found = connection.execute("SELECT hash, stored, row FROM results JOIN listed USING (hash)")
        try:
            rows = [(read_time(stored), Row.read(text, named)) for named, stored, text in found]
        except ValueError as error:
            raise RecordError(f"{path} holds what is no result ({error}); name another folder.") from error
        return str(about.get("name", "")), int(total), rows


def _require_own_tables(path: Path, connection: sqlite3.Connection) -> set[str]:
    """Return the tables that are there; refuse any other content, such as a view or a trigger, which computes."""
    connection.setlimit(sqlite3.SQLITE_LIMIT_LENGTH, _LONGEST)
    there = {sql for (sql,) in connection.execute("SELECT sql FROM sqlite_master WHERE sql IS NOT NULL")}
    if foreign := there.difference(_TABLES):
        raise RecordError(
            f"{path} holds {short(min(foreign))}, which no campaign has; name the folder of a campaign by --out."
        )
    return there


@contextlib.contextmanager
def _explain(path: Path) -> Iterator[None]:
    """Say in a sentence why a database cannot be used."""
    try:
        yield
    except sqlite3.OperationalError as error:
        raise RecordError(
            f"{path} cannot be used ({error}); what is finished is kept: free space there, or mend its rights, and "
            "give the same command again."
        ) from error
    except sqlite3.DatabaseError as error:
        raise RecordError(f"{path} is no database of a campaign ({error}); name another folder by --out.") from error


def require_local_disk(folder: Path, mounts: str | None = None) -> None:
    """Refuse a folder on a network disk, which could corrupt the database.

    Args:
        folder: that is there.
        mounts: text of /proc/self/mountinfo; that of this machine when None, where the system has one.

    Example:
        >>> from pathlib import Path
        >>> from jointid.campaigns.store import require_local_disk
        >>> require_local_disk(Path("/data/a"), "36 35 98:0 / /data rw - nfs4 server:/data rw")
        Traceback (most recent call last):
        ...
        jointid.common.errors.RecordError: /data/a is on a disk in a network (nfs4), ...
    """
    place = str(folder.resolve())
    kind = "a share of Windows" if place.startswith("\\\\") else _file_system(place, mounts)
    if kind is not None and (kind.startswith(_NETWORK) or kind == "a share of Windows"):
        raise RecordError(
            f"{folder} is on a disk in a network ({kind}), where the results' database could be spoiled; name a folder "
            "on a local disk by --out, or let shards write there: jointid campaign work --shard 1/4."
        )


def _file_system(place: str, mounts: str | None) -> str | None:
    """File system type of a path; None if unknown."""
    if mounts is None:
        if sys.platform != "linux":
            return None
        try:
            mounts = Path("/proc/self/mountinfo").read_text(encoding="utf-8", errors="surrogateescape")
        except OSError:
            return None
    found = ("", "")
    for line in mounts.splitlines():
        before, _, after = line.partition(" - ")
        if len(before.split()) < 5 or not after.split():
            continue
        point = before.split()[4].replace("\\040", " ")  # of two mounted on one point the later one is seen
        if (place == point or place.startswith(point.rstrip("/") + "/")) and len(point) >= len(found[0]):
            found = point, after.split()[0]
    return found[1] or None
