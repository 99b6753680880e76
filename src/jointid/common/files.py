"""Atomic writes, and opening of files that may be pipes or devices.

Output is written beside its place and moved there when complete. A link is followed, permissions are kept, and a device
or pipe such as `/dev/stdout` is written directly. A killed program leaves a file `.jointid-...` behind.
"""

from __future__ import annotations

import contextlib
import errno
import hashlib
import os
import secrets
import shutil
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import IO

from jointid.common.errors import RecordError

_SYSTEM = ("/dev/", "/proc/")  # files there cannot be replaced by moving another one


@contextlib.contextmanager
def beside(path: str | os.PathLike[str]) -> Iterator[Path]:
    """Yield a temporary path; its content replaces `path` on success.

    Args:
        path: destination. An existing file is replaced, an existing folder is not.
    """
    path = Path(path)
    with explain(path):
        if _is_device(path):
            yield path
            return
        place = _place_of(path)
        fresh = place.with_name(f".jointid-{secrets.token_hex(4)}-{place.name}")
        try:
            yield fresh
            with contextlib.suppress(FileNotFoundError):
                shutil.copymode(place, fresh)
            fresh.replace(place)
        finally:
            fresh.unlink(missing_ok=True)


def require_room(path: str | os.PathLike[str]) -> None:
    """Refuse an output path that cannot be written, before long work."""
    path = Path(path)
    with explain(path):
        if not _is_device(path):
            place = _place_of(path)
            fresh = next(each for each in (place, *place.parents) if each.is_dir()) / f".jointid-{secrets.token_hex(4)}"
            try:
                fresh.write_bytes(b"\n")  # a full disk refuses this, too
            finally:
                fresh.unlink(missing_ok=True)


def write_whole(path: str | os.PathLike[str], content: str | bytes) -> None:
    """Write a file atomically, text as UTF-8."""
    with beside(path) as fresh:
        fresh.write_bytes(content.encode("utf-8", "backslashreplace") if isinstance(content, str) else content)


def write_folder(folder: str | os.PathLike[str], files: Mapping[str, bytes]) -> tuple[Path, ...]:
    """Write files by name into a folder atomically; return their paths."""
    folder = Path(folder)
    with explain(folder):
        folder.mkdir(parents=True, exist_ok=True)
    for name, content in files.items():
        write_whole(folder / name, content)
    return tuple(folder / name for name in files)


def open_file(path: str | os.PathLike[str]) -> IO[bytes]:
    """Open a file for reading.

    Raises:
        OSError: it cannot be opened, or is a folder, pipe or device; reading these may never end.
    """
    path = Path(path)
    if _is_device(path):
        raise OSError(errno.EINVAL, "it is a pipe or a device, no file", str(path))
    return path.open("rb")


def files_of(record: Path) -> list[Path]:
    """Return the sorted files of a record, a file or folder."""
    return sorted(each for each in record.rglob("*") if each.is_file()) if record.is_dir() else [record]


def digest(*records: Path) -> str:
    """Return the SHA-256 of concatenated files; of a folder, its sorted files.

    Raises:
        RecordError: a file cannot be read.
    """
    made = hashlib.sha256()
    for each in (file for record in records for file in files_of(record)):
        with explain(each, "opened", "check the path"), open_file(each) as file:
            while block := file.read(2**20):
                made.update(block)
    return made.hexdigest()


def lock(descriptor: int) -> bool:
    """Lock an open file; False if another process holds the lock."""
    with contextlib.suppress(ImportError):
        import fcntl

        try:
            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError as error:
            return error.errno not in (errno.EAGAIN, errno.EACCES)
    return True


@contextlib.contextmanager
def explain(
    path: Path, done: str = "written", remedy: str = "free space there, or choose another place"
) -> Iterator[None]:
    """Convert an `OSError` to a `RecordError` with path and remedy."""
    try:
        yield
    except OSError as error:
        reason = (error.strerror or str(error) or type(error).__name__).lower()
        raise RecordError(f"{path} cannot be {done} ({reason}); {remedy}.") from error


def _is_device(path: Path) -> bool:
    """Test for a device, a pipe or a system path."""
    if os.path.abspath(path).startswith(_SYSTEM):  # noqa: PTH100 - resolve would follow /dev/stdout to a file
        return True
    return path.exists() and not (path.is_file() or path.is_dir())


def _place_of(path: Path) -> Path:
    """Resolve a path; refuse one without write permission."""
    place = Path(os.path.realpath(path))
    if place.exists() and not os.access(place, os.W_OK):
        raise PermissionError(errno.EACCES, os.strerror(errno.EACCES))
    return place
