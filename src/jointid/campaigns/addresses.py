"""Record addresses: local or shared paths, and URLs opened by fsspec."""

from __future__ import annotations

import contextlib
import hashlib
import os
import posixpath
import re
import shutil
import time
from collections.abc import Iterator, Mapping
from pathlib import Path, PurePosixPath
from tempfile import TemporaryDirectory, gettempdir
from typing import Any
from urllib.parse import urlsplit

from jointid.common.errors import ExtraError, RecordError, extra
from jointid.common.files import lock, open_file
from jointid.common.messages import either

_REMOTE = ("s3", "s3a", "gs", "gcs", "az", "abfs", "adl", "http", "https", "sftp", "smb", "hdfs", "webhdfs", "file")
_CHANGED = ("ETag", "etag", "LastModified", "Last-Modified", "updated", "mtime")  # what an object store says of it
_BLOCK = 2**20
_PREFIX, _YOUNG = "jointid-record-", 60.0  # of a temporary folder; s from its making until it is locked


def is_remote(address: str) -> bool:
    """Test for a URL."""
    return "://" in address


def check_scheme(address: str) -> None:
    """Refuse URL schemes that are not plain file storage, since some execute templates."""
    kind = address.partition("://")[0]
    if is_remote(address) and kind not in _REMOTE:
        raise RecordError(f"{address} begins with {kind}://; expected a path, or one of {either(_REMOTE)}: correct it.")


@contextlib.contextmanager
def fetch(address: str) -> Iterator[Path]:
    """Yield the local path of a record; a remote one is downloaded temporarily."""
    if not is_remote(address):
        yield Path(address)
        return
    check_scheme(address)
    fsspec = extra("fsspec", "remote", "A record behind a URL")
    with _temporary_folder() as folder:
        # In an object store # and ? are letters of a name.
        whole = urlsplit(address).path if address.startswith("http") else address
        path = folder / PurePosixPath(whole).name
        try:
            with fsspec.open(address, "rb") as source, path.open("wb") as target:
                shutil.copyfileobj(source, target, _BLOCK)
        except Exception as error:  # of any of a dozen libraries
            raise _refusal(address, error) from error
        yield path


@contextlib.contextmanager
def _temporary_folder() -> Iterator[Path]:
    """Yield a locked temporary folder, and remove those of programs that were killed."""
    for left in Path(gettempdir()).glob(f"{_PREFIX}*"):
        with contextlib.suppress(OSError):
            if time.time() - left.stat().st_mtime > _YOUNG:
                with _locked(left) as is_mine:
                    if is_mine:
                        shutil.rmtree(left)
    with TemporaryDirectory(prefix=_PREFIX) as made, contextlib.ExitStack() as stack:
        with contextlib.suppress(OSError):  # Windows opens no folder
            stack.enter_context(_locked(Path(made)))
        yield Path(made)


@contextlib.contextmanager
def _locked(folder: Path) -> Iterator[bool]:
    """Hold a folder locked, and yield whether it is."""
    held = os.open(folder, os.O_RDONLY | getattr(os, "O_DIRECTORY", 0))
    try:
        yield lock(held) is True
    finally:
        os.close(held)


def list_addresses(pattern: str, folder: Path) -> dict[str, str]:
    """List addresses that match a pattern with * and ?, with stamps."""
    if not is_remote(pattern):
        root = Path(pattern).anchor
        below = os.path.relpath(pattern, root) if root else pattern
        below = re.sub(r"\*+", "*", posixpath.normpath(below)).replace("[", "[[]")  # * is all that patterns have
        paths = sorted(os.path.normpath(path) for path in (Path(root) if root else folder).glob(below))
        stamps = dict.fromkeys(paths, "")
        for path in paths:
            with contextlib.suppress(RecordError):  # which its case reports
                stamps[path] = stamp_of(Path(path))
        return stamps
    check_scheme(pattern)
    fsspec = extra("fsspec", "remote", "A record behind a URL")
    try:
        system, place = fsspec.core.url_to_fs(pattern)
        there: Mapping[str, Any] = system.glob(place, detail=True)
        files = {name: about for name, about in sorted(there.items()) if about.get("type") == "file"}
        stamps = {}
        for name, listed in files.items():
            about = system.info(name) if listed.get("size") is None else listed  # a page lists names alone
            changed = next((about[key] for key in _CHANGED if key in about), "")
            stamps[system.unstrip_protocol(name)] = f"{about.get('size')} {changed}"
        return stamps
    except Exception as error:
        raise _refusal(pattern, error) from error


def stamp_of(path: Path) -> str:
    """Identify a version of a record by size and change time [ms], of a bag over all files."""
    try:
        files = sorted(path.iterdir()) if path.is_dir() else [path]
        about = [each.stat() for each in files]
    except OSError as error:
        raise RecordError(f"{path} cannot be opened ({_reason(error)}); check the path.") from error
    return f"{sum(one.st_size for one in about)} {max((one.st_mtime_ns for one in about), default=0) // 10**6}"


def digest(path: Path) -> str:
    """SHA-256 of a record's bytes, of a bag over its files in order."""
    made = hashlib.sha256()
    try:
        for each in sorted(path.iterdir()) if path.is_dir() else [path]:
            with open_file(each) as file:
                while block := file.read(_BLOCK):
                    made.update(block)
    except OSError as error:
        raise RecordError(f"{path} cannot be opened ({_reason(error)}); check the path.") from error
    return made.hexdigest()


def _reason(error: OSError) -> str:
    return (error.strerror or type(error).__name__).lower()


def _refusal(address: str, error: Exception) -> RecordError:
    if isinstance(error, ExtraError | RecordError):
        return RecordError(str(error))
    reason = os.linesep.join(str(error).splitlines()[:1]) or "no reason given"
    if isinstance(error, ImportError):
        return RecordError(f"{address} needs a package more than the extra remote has ({reason}); install that, too.")
    return RecordError(f"{address} cannot be fetched ({type(error).__name__}: {reason}); check address and rights.")
