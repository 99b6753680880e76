"""Atomic writing of files and folders, and opening of files that may be anything.

Output is written beside its place and moved there when complete. A link is followed, permissions are kept, and a device
or pipe such as `/dev/stdout` is written directly. A killed program leaves a folder `.jointid-...` behind.
"""

from __future__ import annotations

import contextlib
import errno
import hashlib
import os
import secrets
import shutil
import stat
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import IO

from jointid.common.errors import RecordError

_FULL = (errno.ENOSPC, errno.EFBIG, getattr(errno, "EDQUOT", errno.ENOSPC))
_SYSTEM = ("/dev/", "/proc/")  # what is opened there may be a file, and is still no place to put another
_rooms: set[Path] = set()


@contextlib.contextmanager
def beside(path: str | os.PathLike[str]) -> Iterator[Path]:
    """Yield a temporary path; its content replaces `path` on success.

    Args:
        path: the place. A file that is there is replaced, a folder is not.

    Example:
        >>> import tempfile
        >>> from pathlib import Path
        >>> from jointid.common.files import beside
        >>> with tempfile.TemporaryDirectory() as folder:
        ...     place = Path(folder) / "answer.txt"
        ...     with beside(place) as fresh:
        ...         _ = fresh.write_text("42")
        ...         before = place.exists()
        ...     before, place.read_text()
        (False, '42')
    """
    path = Path(path)
    with explain(path):
        if _is_written_as_it_is(path):
            yield path
            return
        place = _place_of(path)
        with _room_in(place.parent) as room:
            fresh = room / place.name
            yield fresh
            if fresh.is_file():
                try:
                    with fresh.open("rb+") as file:
                        os.fsync(file.fileno())  # a full disk fails here
                except OSError as error:
                    if error.errno not in (errno.EINVAL, errno.ENOSYS, errno.ENOTSUP):  # no such order on some disks
                        raise
            with contextlib.suppress(FileNotFoundError):
                shutil.copymode(place, fresh)
            fresh.replace(place)


def require_room(path: str | os.PathLike[str]) -> None:
    """Refuse an output path that cannot be written, before long work.

    An existing folder is tested itself, otherwise the nearest one above. A pipe or a device is not tested.
    """
    path = Path(path)
    with explain(path):
        if not _is_written_as_it_is(path):
            place = _place_of(path)
            with _room_in(next(each for each in (place, *place.parents) if each.is_dir())) as room:
                (room / place.name).write_bytes(b"\n")


def write_whole(path: str | os.PathLike[str], content: str | bytes) -> None:
    """Write a file atomically, text as UTF-8."""
    with beside(path) as fresh:
        fresh.write_bytes(content.encode("utf-8", "backslashreplace") if isinstance(content, str) else content)


def write_folder(folder: str | os.PathLike[str], files: Mapping[str, bytes]) -> tuple[Path, ...]:
    """Write files by name into a folder, each atomically, and return their paths."""
    folder = Path(folder)
    with explain(folder):
        folder.mkdir(parents=True, exist_ok=True)
    for name, content in files.items():
        write_whole(folder / name, content)
    return tuple(folder / name for name in files)


def open_file(path: str | os.PathLike[str]) -> IO[bytes]:
    """Open a regular file for reading.

    Raises:
        OSError: it cannot be opened, or is a folder, a pipe or a device: these may never answer, or have no end.
    """
    flags = os.O_RDONLY | getattr(os, "O_NONBLOCK", 0) | getattr(os, "O_BINARY", 0)  # a pipe waits for its writer
    descriptor = os.open(path, flags)
    kind = os.fstat(descriptor).st_mode
    if stat.S_ISREG(kind):
        return os.fdopen(descriptor, "rb")
    os.close(descriptor)
    if stat.S_ISDIR(kind):
        raise IsADirectoryError(errno.EISDIR, os.strerror(errno.EISDIR), os.fspath(path))
    raise OSError(errno.EINVAL, "it is a pipe or a device, no file", os.fspath(path))


def files_of(record: Path) -> list[Path]:
    """Return the files of a record, which is a file or a folder, in order."""
    return sorted(each for each in record.rglob("*") if each.is_file()) if record.is_dir() else [record]


def digest(*records: Path) -> str:
    """Return the SHA-256 of the bytes of files, one after the other, of a folder over its files in order.

    Raises:
        RecordError: a file cannot be read.
    """
    made = hashlib.sha256()
    try:
        for each in (file for record in records for file in files_of(record)):
            with open_file(each) as file:
                while block := file.read(2**20):
                    made.update(block)
    except OSError as error:
        reason = (error.strerror or type(error).__name__).lower()
        raise RecordError(f"{error.filename} cannot be opened ({reason}); check the path.") from error
    return made.hexdigest()


def lock(descriptor: int) -> bool | None:
    """Lock an open file or folder; False if another process has it.

    None where the system has no locks, as Windows and some disks in a network.
    """
    try:
        import fcntl

        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except (BlockingIOError, PermissionError):
        return False
    except (ImportError, OSError):
        return None
    return True


def remove_rooms() -> None:
    """Remove temporary folders that an interrupt left, at the end of the program."""
    for room in tuple(_rooms):
        shutil.rmtree(room, ignore_errors=True)
    _rooms.clear()


def is_full(error: BaseException) -> bool:
    """Test whether an error or its cause is a full disk."""
    cause = error if isinstance(error, OSError) else error.__cause__
    return isinstance(cause, OSError) and cause.errno in _FULL


@contextlib.contextmanager
def explain(path: Path) -> Iterator[None]:
    """Convert an `OSError` of writing a file or a folder to a sentence."""
    try:
        yield
    except OSError as error:
        reason = (error.strerror or str(error) or type(error).__name__).lower()
        kept = ", and what was there is as it was" if path.exists() else ""
        raise RecordError(
            f"{path} cannot be written ({reason}){kept}; free space there, or choose another place."
        ) from error


def _is_written_as_it_is(path: Path) -> bool:
    """Test for a device, a pipe or a system path."""
    if os.path.abspath(path).startswith(_SYSTEM):  # noqa: PTH100 - resolve would follow /dev/stdout to a file
        return True
    try:
        kind = path.stat().st_mode
    except OSError:
        return False
    return not (stat.S_ISREG(kind) or stat.S_ISDIR(kind))


def _place_of(path: Path) -> Path:
    """Return the place of a file or folder that may be written."""
    place = Path(os.path.realpath(path))
    if place.exists() and not os.access(place, os.W_OK):
        raise PermissionError(errno.EACCES, os.strerror(errno.EACCES))
    return place


@contextlib.contextmanager
def _room_in(folder: Path) -> Iterator[Path]:
    """Yield a temporary folder on the same disk."""
    room = folder / f".jointid-{secrets.token_hex(8)}"
    _rooms.add(room)  # first: a signal may come before the next line
    try:
        room.mkdir(mode=0o700)
        yield room
    finally:
        shutil.rmtree(room, ignore_errors=True)
        _rooms.discard(room)
