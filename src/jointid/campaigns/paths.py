"""Paths of records: listed by a pattern, known by size and time, and digested."""

from __future__ import annotations

import contextlib
import hashlib
import os
import posixpath
import re
from pathlib import Path

from jointid.common.errors import RecordError
from jointid.common.files import open_file

_BLOCK = 2**20


def list_records(pattern: str, folder: Path) -> dict[str, str]:
    """List paths that match a pattern with * and ?, with stamps."""
    root = Path(pattern).anchor
    below = os.path.relpath(pattern, root) if root else pattern
    below = re.sub(r"\*+", "*", posixpath.normpath(below)).replace("[", "[[]")  # * is all that patterns have
    paths = sorted(os.path.normpath(path) for path in (Path(root) if root else folder).glob(below))
    stamps = dict.fromkeys(paths, "")
    for path in paths:
        with contextlib.suppress(RecordError):  # which its case reports
            stamps[path] = stamp_of(Path(path))
    return stamps


def stamp_of(path: Path) -> str:
    """Identify a version of a record by size and change time [ms], of a bag over all files."""
    try:
        about = [each.stat() for each in _files(path)]
    except OSError as error:
        raise _unreadable(path, error) from error
    return f"{sum(one.st_size for one in about)} {max((one.st_mtime_ns for one in about), default=0) // 10**6}"


def digest(path: Path) -> str:
    """SHA-256 of a record's bytes, of a bag over its files in order."""
    made = hashlib.sha256()
    try:
        for each in _files(path):
            with open_file(each) as file:
                while block := file.read(_BLOCK):
                    made.update(block)
    except OSError as error:
        raise _unreadable(path, error) from error
    return made.hexdigest()


def _files(path: Path) -> list[Path]:
    return sorted(path.iterdir()) if path.is_dir() else [path]


def _unreadable(path: Path, error: OSError) -> RecordError:
    reason = (error.strerror or type(error).__name__).lower()
    return RecordError(f"{path} cannot be opened ({reason}); check the path.")
