"""The cache of compiled kernels on disk: one that is damaged, empty or cannot be written never ends a command.

A kernel is compiled anew where a file of its folder has changed, as Numba itself looks at that of the kernel alone.

What Numba reads back is machine code, and it looks at nothing before it runs it. Here it is kept behind its checksum.
What does not fit, or cannot be read, is compiled again; what cannot be written is compiled in every process. Either way
a warning names the folder.
"""

from __future__ import annotations

import hashlib
import pickle
import warnings
from functools import cache
from pathlib import Path
from typing import Any

from numba.core.caching import FunctionCache, IndexDataCacheFile
from numba.core.serialize import dumps

_DIGEST = hashlib.sha256().digest_size


class CacheWarning(UserWarning):
    """The compiler's cache cannot be used; the work is done without it, and takes longer."""


class KernelCache(FunctionCache):
    """The cache of one kernel."""

    def __init__(self, function: Any) -> None:
        super().__init__(function)
        kept = self._cache_file
        stamp = kept._source_stamp, *_stamps_beside(function.__code__.co_filename)
        self._cache_file = _CheckedFile(kept._cache_path, self._impl.filename_base, stamp)

    def load_overload(self, sig: Any, target_context: Any) -> Any:
        """Return a compiled kernel, None where there is none that can be trusted."""
        try:
            return super().load_overload(sig, target_context)
        except PermissionError:  # it cannot be written either, which is said then
            return None
        except Exception:  # a damaged pickle raises anything
            _warn_of_damage(self.cache_path)
            return None

    def save_overload(self, sig: Any, data: Any) -> None:
        """Keep a compiled kernel, where it can be kept."""
        try:
            super().save_overload(sig, data)
        except Exception as error:
            _warn_of_place(self.cache_path, getattr(error, "strerror", None) or type(error).__name__)


def _stamps_beside(source: str) -> list[tuple[str, int, int]]:
    """Return name, time and size of the files in a kernel's folder: it may have compiled in what one of them says."""
    try:
        found = [(file.name, file.stat()) for file in sorted(Path(source).parent.glob("*.py"))]
    except OSError:  # such as in an archive
        return []
    return [(name, about.st_mtime_ns, about.st_size) for name, about in found]


class _CheckedFile(IndexDataCacheFile):
    """The files of one kernel: what is compiled stands behind its checksum, and a damaged index is an empty one."""

    def _load_index(self) -> dict[Any, str]:
        try:
            found: dict[Any, str] = super()._load_index()
        except PermissionError:
            raise
        except Exception:
            _warn_of_damage(self._cache_path)
            return {}
        return found

    def _load_data(self, name: str) -> Any:
        kept = super()._load_data(name)
        if not isinstance(kept, bytes):  # of an earlier version, without a checksum
            return None
        if hashlib.sha256(kept[_DIGEST:]).digest() != kept[:_DIGEST]:
            raise ValueError("the checksum does not fit")
        return pickle.loads(kept[_DIGEST:])  # noqa: S301 - the user's own folder, as Python's compiled modules are

    def _save_data(self, name: str, data: Any) -> None:
        made = dumps(data)
        super()._save_data(name, hashlib.sha256(made).digest() + made)


@cache  # said once
def _warn_of_damage(folder: str) -> None:
    warnings.warn(
        f"The compiler's cache in {folder} is damaged, and what is needed of it is compiled again; if this is said "
        "again, delete that folder.",
        CacheWarning,
        stacklevel=2,
    )


@cache
def _warn_of_place(folder: str, reason: str) -> None:
    warnings.warn(
        f"The compiler's cache in {folder} cannot be written ({reason.lower()}), so that every start compiles again; "
        "free space there, delete that folder, or name another by NUMBA_CACHE_DIR.",
        CacheWarning,
        stacklevel=2,
    )


@cache
def warn_of_no_place() -> None:
    """Say that neither the package's folder nor the user's can be written."""
    warnings.warn(
        "There is no folder that the compiler's cache can be written to, so that every start compiles again; name one "
        "by NUMBA_CACHE_DIR.",
        CacheWarning,
        stacklevel=2,
    )
