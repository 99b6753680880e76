"""Write a file or a folder beside its place, and put it there when it is whole: until then what was there stays.

The disk may be full, the program may be ended at any moment, and nobody finds half a result. A link is followed: what
it leads to is replaced, and the link stays. A file keeps who may read it. Another name of the same file (a hard link)
keeps what was there. A device or a pipe, as `/dev/stdout`, is written as it is. A program that is killed with no time
to tidy up leaves a folder `.jointid-...` behind, which can be deleted.
"""

from __future__ import annotations

import contextlib
import errno
import os
import secrets
import shutil
import stat
from collections.abc import Iterator, Mapping
from pathlib import Path

from jointid.common.errors import RecordError

_FULL = (errno.ENOSPC, errno.EFBIG, getattr(errno, "EDQUOT", errno.ENOSPC))
_NO_STORING = (errno.EINVAL, errno.ENOSYS, getattr(errno, "ENOTSUP", errno.EINVAL))
_SYSTEM = ("/dev/", "/proc/")  # what is opened there may be a file, and is still no place to put another
_rooms: set[Path] = set()


@contextlib.contextmanager
def beside(path: str | os.PathLike[str]) -> Iterator[Path]:
    """Yield where to write a file, or a folder, of the same name; what is there in the end is put in its place.

    Args:
        path: the place. A file that is there is replaced, a folder is not.

    Raises:
        RecordError: it cannot be written; the sentence says why, and what was there is as it was.

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
    with _explain(path):
        if _is_written_as_it_is(path):
            yield path
            return
        place = Path(os.path.realpath(path))
        if place.exists() and not os.access(place, os.W_OK):
            raise PermissionError(errno.EACCES, os.strerror(errno.EACCES))
        with _room_in(place.parent) as room:
            yield room / place.name
            _settle(room / place.name, place)


def require_room(path: str | os.PathLike[str]) -> None:
    """Refuse a place that takes no byte now, before long work is done for it; nothing is left there.

    A folder that is there takes it in itself, what is not there beside its place, in the nearest folder above. A pipe
    is not tried: who reads it would take that for the end.

    Raises:
        RecordError: see `beside`.
    """
    path = Path(path)
    with _explain(path):
        if not _is_written_as_it_is(path):
            place = Path(os.path.realpath(path))
            with _room_in(next(each for each in (place, *place.parents) if each.is_dir())) as room:
                (room / place.name).write_bytes(b"\n")
        elif path.is_char_device():
            device = os.open(path, os.O_WRONLY)
            try:
                os.write(device, b"")  # a full one refuses even that
            finally:
                os.close(device)


def write_whole(path: str | os.PathLike[str], content: str | bytes) -> None:
    """Write a file, a text in UTF-8 as it stands.

    Raises:
        RecordError: see `beside`.
    """
    data = content.encode("utf-8", "backslashreplace") if isinstance(content, str) else content
    with beside(path) as fresh:
        fresh.write_bytes(data)


def write_folder(folder: str | os.PathLike[str], files: Mapping[str, bytes]) -> tuple[Path, ...]:
    """Write files by their names into a folder, and return their paths.

    A folder that is not there appears with all of them in it. In one that is there, none is replaced until all are
    written.

    Raises:
        RecordError: see `beside`.
    """
    folder = Path(folder)
    with _explain(folder):
        place = Path(os.path.realpath(folder))
        is_new = not place.exists()
        if is_new:
            place.parent.mkdir(parents=True, exist_ok=True)
        with _room_in(place.parent if is_new else place) as room:
            fresh = room / place.name
            fresh.mkdir()
            for name, content in files.items():
                (fresh / name).write_bytes(content)
                _store(fresh / name)
            if is_new:
                fresh.rename(place)
            else:
                for name in files:
                    _settle(fresh / name, Path(os.path.realpath(place / name)))
    return tuple(folder / name for name in files)


def remove_rooms() -> None:
    """Remove what a signal left behind that came while a folder was being made or removed.

    For the end of a program, when no signal is answered any more.
    """
    for room in _rooms:
        shutil.rmtree(room, ignore_errors=True)
    _rooms.clear()


def is_full(error: BaseException) -> bool:
    """Return whether an error, or the one it came of, is a disk that is full."""
    cause = error if isinstance(error, OSError) else error.__cause__
    return isinstance(cause, OSError) and cause.errno in _FULL


@contextlib.contextmanager
def _explain(path: Path) -> Iterator[None]:
    """Say in a sentence why something cannot be written."""
    try:
        yield
    except OSError as error:
        reason = (error.strerror or str(error) or type(error).__name__).lower()
        kept = ", and what was there is as it was" if path.exists() else ""
        remedy = (
            "free space there, or choose another place" if error.errno in (None, *_FULL) else "choose another place"
        )
        raise RecordError(f"{path} cannot be written ({reason}){kept}; {remedy}.") from error


def _is_written_as_it_is(path: Path) -> bool:
    """Return True for what is there and is neither a file nor a folder, or belongs to the system."""
    if os.path.abspath(path).startswith(_SYSTEM):  # noqa: PTH100 - resolve would follow /dev/stdout to a file
        return True
    try:
        kind = path.stat().st_mode
    except OSError:
        return False
    return not (stat.S_ISREG(kind) or stat.S_ISDIR(kind))


@contextlib.contextmanager
def _room_in(folder: Path) -> Iterator[Path]:
    """Yield an empty folder on the same disk, which is removed with what is left in it."""
    room = folder / f".jointid-{secrets.token_hex(8)}"
    _rooms.add(room)  # first: a signal may come before the next line
    try:
        room.mkdir(mode=0o700)
        yield room
    finally:
        shutil.rmtree(room, ignore_errors=True)
        _rooms.discard(room)


def _settle(fresh: Path, place: Path) -> None:
    """Put what is whole in its place, with the rights of a file that was there."""
    if fresh.is_dir():
        fresh.rename(place)
        return
    _store(fresh)
    with contextlib.suppress(FileNotFoundError):
        before = place.stat()
        fresh.chmod(stat.S_IMODE(before.st_mode))
        if hasattr(os, "chown") and (before.st_uid, before.st_gid) != (fresh.stat().st_uid, fresh.stat().st_gid):
            with contextlib.suppress(OSError):  # only root can give a file away
                os.chown(fresh, before.st_uid, before.st_gid)
    fresh.replace(place)


def _store(fresh: Path) -> None:
    """Have the disk hold a file before it takes another's place: one that is full may say so only now."""
    with fresh.open("rb+") as file:
        try:
            os.fsync(file.fileno())
        except OSError as error:  # some disks in a network know no such order
            if error.errno not in _NO_STORING:
                raise
