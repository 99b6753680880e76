"""Results that are kept: a database of the client's, in a folder on its local disk.

Every result is on the disk before it counts as finished, one transaction each, so that a client that is killed, and a
disk that is full, lose none. Its log beside the file (WAL) lets others read while the campaign runs; that needs memory
that processes share, which no disk in a network has.
"""

from __future__ import annotations

import contextlib
import sqlite3
import sys
import time
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path
from typing import Protocol

from jointid.campaigns.rows import Outcome, Row
from jointid.common.errors import RecordError

DATABASE = "campaign.sqlite"
SHARD_FILES = "shard-*-of-*.jsonl"
"""Names of the results of shards, which stand in another folder than a database."""
_LOCK = "campaign.lock"
_FORMAT = 1
_PATIENCE = 60.0  # s that a reader may hold the database
_NETWORK = (
    "nfs", "cifs", "smb", "lustre", "gpfs", "beegfs", "9p", "ceph", "glusterfs", "afs", "ncpfs", "ocfs2", "gfs2",
    "pvfs2", "orangefs", "panfs", "wekafs", "davfs", "fuse.sshfs", "fuse.s3fs", "fuse.gcsfuse", "fuse.rclone",
    "fuse.ceph", "fuse.glusterfs", "fuse.juicefs", "fuse.blobfuse", "fuse.beegfs", "fuse.mount-s3",
)  # fmt: skip
_TABLES = """
CREATE TABLE IF NOT EXISTS listed (hash TEXT PRIMARY KEY) WITHOUT ROWID;
CREATE TABLE IF NOT EXISTS results (hash TEXT PRIMARY KEY, stored REAL NOT NULL, row TEXT NOT NULL);
CREATE TABLE IF NOT EXISTS deaths (hash TEXT PRIMARY KEY, count INTEGER NOT NULL) WITHOUT ROWID;
CREATE TABLE IF NOT EXISTS about (key TEXT PRIMARY KEY, value TEXT NOT NULL) WITHOUT ROWID;
"""


class Results(Protocol):
    """Where a campaign keeps its results: a database, or the file of a shard."""

    def list_cases(self, name: str, hashes: Iterable[str]) -> int:
        """Keep which cases the campaign has now, and return how many; rows of others are kept, and not shown."""

    def is_finished(self, content_hash: str) -> bool:
        """Return whether the result of a case is there."""

    def add(self, rows: Sequence[Row]) -> None:
        """Keep results, all of them or none; of a case that has one already, the first stays."""

    def count_death(self, content_hash: str) -> int:
        """Count a worker that died of a case while it had nothing else to do, and return how many have by now."""


class Database:
    """The results of a campaign in a folder of the client; see `open_database`."""

    def __init__(self, path: Path, connection: sqlite3.Connection) -> None:
        self._path, self._connection = path, connection

    def list_cases(self, name: str, hashes: Iterable[str]) -> int:
        """Keep which cases the campaign has now; see `Results`."""
        with _explain(self._path), self._connection as transaction:
            transaction.execute("DELETE FROM listed")
            transaction.executemany("INSERT OR IGNORE INTO listed VALUES (?)", ((one,) for one in hashes))
            about = {"name": name, "format": str(_FORMAT)}
            transaction.executemany("INSERT OR REPLACE INTO about VALUES (?, ?)", about.items())
            return int(transaction.execute("SELECT count(*) FROM listed").fetchone()[0])

    def is_finished(self, content_hash: str) -> bool:
        """Return whether the result of a case is there."""
        with _explain(self._path):
            found = self._connection.execute("SELECT 1 FROM results WHERE hash = ?", (content_hash,))
            return found.fetchone() is not None

    def add(self, rows: Sequence[Row]) -> None:
        """Keep results in one transaction; they are on the disk when this returns."""
        with _explain(self._path), self._connection as transaction:
            transaction.executemany(
                "INSERT OR IGNORE INTO results VALUES (?, ?, ?)",
                [(row.content_hash, time.time(), row.text()) for row in rows],
            )

    def count_death(self, content_hash: str) -> int:
        """Count a worker that died of a case; see `Results`."""
        with _explain(self._path), self._connection as transaction:
            transaction.execute(
                "INSERT INTO deaths VALUES (?, 1) ON CONFLICT (hash) DO UPDATE SET count = count + 1", (content_hash,)
            )
            return int(transaction.execute("SELECT count FROM deaths WHERE hash = ?", (content_hash,)).fetchone()[0])

    def forget_unidentified(self) -> int:
        """Forget the results that are no identification, whose cases are then tried again; return how many."""
        with _explain(self._path), self._connection as transaction:
            transaction.execute("DELETE FROM deaths")
            done = str(Outcome.IDENTIFIED)
            return transaction.execute(
                "DELETE FROM results WHERE json_extract(row, '$.outcome') <> ?", (done,)
            ).rowcount


@contextlib.contextmanager
def open_database(folder: Path) -> Iterator[Database]:
    """Yield the database in a folder that is there, for the one client that may write it."""
    require_local_disk(folder)
    if any(folder.glob(SHARD_FILES)):
        raise RecordError(f"{folder} has the results of shards; name another folder by --out, or go on with work.")
    path = folder / DATABASE
    with _explain(path), contextlib.closing(_lock(folder)), contextlib.closing(_connect(path)) as connection:
        connection.executescript(_TABLES)
        found = dict(connection.execute("SELECT key, value FROM about").fetchall()).get("format", str(_FORMAT))
        if found != str(_FORMAT):
            raise RecordError(
                f"{path} is of format {found}, and this jointid knows {_FORMAT}; use the one that wrote it."
            )
        yield Database(path, connection)


def _connect(path: Path) -> sqlite3.Connection:
    connection = sqlite3.connect(path, timeout=_PATIENCE)
    connection.execute("PRAGMA journal_mode=WAL")
    connection.execute("PRAGMA synchronous=FULL")  # a result outlives a power cut, too
    return connection


def _lock(folder: Path) -> sqlite3.Connection:
    """Return what holds a folder for one client; the system lets go of it however that ends."""
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
    """Return the name of a campaign, how many cases it has, and the results of these with when each was stored."""
    path = folder / DATABASE
    with _explain(path), contextlib.closing(sqlite3.connect(path, timeout=_PATIENCE)) as connection:
        if not connection.execute("SELECT 1 FROM sqlite_master WHERE name = 'listed'").fetchone():
            return "", 0, []  # it was only just begun
        about = dict(connection.execute("SELECT key, value FROM about").fetchall())
        (total,) = connection.execute("SELECT count(*) FROM listed").fetchone()
        found = connection.execute("SELECT stored, row FROM results JOIN listed USING (hash)")
        try:
            return about.get("name", ""), int(total), [(float(stored), Row.read(text)) for stored, text in found]
        except ValueError as error:
            raise RecordError(f"{path} holds what is no result ({error}); name another folder.") from error


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
    """Refuse a folder on a disk in a network, where the database could be spoiled.

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
    """Return the type of the file system that holds a path, None where the system does not say."""
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
