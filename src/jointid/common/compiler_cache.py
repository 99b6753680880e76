"""Disk cache of compiled kernels that tolerates damage and concurrency.

A kernel's stamp covers its code, the functions it calls and the constants it reads; Numba's own stamp covers its file
only. One process compiles a kernel while others wait. A checksum protects the machine code. An unreadable entry is
compiled again; a folder that cannot be written causes a warning.
"""

from __future__ import annotations

import hashlib
import os
import pickle
import re
import sys
import time
import warnings
from collections.abc import Mapping
from functools import cache
from pathlib import Path
from types import CodeType, FunctionType
from typing import Any

import numpy as np
from numba.core.caching import FunctionCache, IndexDataCacheFile
from numba.core.serialize import dumps

_DIGEST = hashlib.sha256().digest_size
_PATIENCE, _PAUSE = 120.0, 0.05  # seconds to wait for another process, and between two looks


class CacheWarning(UserWarning):
    """The compiler cache is unusable, so kernels are compiled again."""


class KernelCache(FunctionCache):
    """The cache of one kernel."""

    def __init__(self, function: Any, options: dict[str, Any]) -> None:
        super().__init__(function)
        self._function, self._options = function, options
        # Numba's names have the line of the function: that moves with every edit above it.
        base = re.sub(r"-\d+(?=\.py\d)", "", self._impl.filename_base)
        self._cache_file = _CheckedFile(self._cache_path, base, None)
        self.lock = _CompileLock(Path(self._cache_path) / f"{base}.lock")

    def holds_any(self) -> bool:
        """Test whether the cache holds the kernel with its present stamp."""
        self._require_stamp()
        try:
            return bool(self._cache_file._load_index())
        except PermissionError:
            return False

    def load_overload(self, sig: Any, target_context: Any) -> Any:
        """Load a compiled kernel; None if it is missing or damaged."""
        self._require_stamp()
        found = self._load(sig, target_context)
        if found is None:
            self.lock.acquire()
            found = self._load(sig, target_context)  # another process may have compiled it meanwhile
        return found

    def _require_stamp(self) -> None:
        if self._cache_file._source_stamp is None:  # not before all that it calls is defined
            self._cache_file._source_stamp = _stamp(self._function, self._options)

    def _load(self, sig: Any, target_context: Any) -> Any:
        try:
            return super().load_overload(sig, target_context)
        except PermissionError:  # it cannot be written either, which is said then
            return None
        except Exception:  # a damaged pickle raises anything
            _warn_of_damage(self.cache_path)
            return None

    def save_overload(self, sig: Any, data: Any) -> None:
        """Save a compiled kernel, if possible."""
        try:
            super().save_overload(sig, data)
        except Exception as error:
            _warn_of_place(self.cache_path, getattr(error, "strerror", None) or type(error).__name__)


class _CompileLock:
    """A file lock on the compilation of one kernel, where file locks exist."""

    def __init__(self, path: Path) -> None:
        self._path, self._file = path, -1

    def acquire(self) -> None:
        """Take the lock; give up after two minutes or without file locks."""
        try:
            import fcntl

            if self._file < 0:
                self._path.parent.mkdir(parents=True, exist_ok=True)
                self._file = os.open(self._path, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o666)
        except (ImportError, OSError):  # Windows, or a folder that cannot be written
            return
        began = time.monotonic()
        while time.monotonic() - began < _PATIENCE:
            try:
                fcntl.flock(self._file, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except BlockingIOError:
                time.sleep(_PAUSE)
            except OSError:  # a file system without locks
                return
            else:
                return

    def release(self) -> None:
        """Release the lock, if it is held."""
        if self._file >= 0:
            import fcntl

            fcntl.flock(self._file, fcntl.LOCK_UN)  # a process that was forked meanwhile has the file open, too
            os.close(self._file)
            self._file = -1


def _stamp(function: FunctionType, options: dict[str, Any]) -> str:
    """Hash a function's code, its callees and the constants it reads."""
    seen: set[int] = set()
    parts: list[str] = [repr(sorted(options.items()))]

    def describe(value: Any) -> None:
        if hasattr(value, "py_func"):  # a kernel
            parts.append(repr(sorted(value.targetoptions.items())))
        value = getattr(value, "py_func", getattr(value, "_defn", value))  # of a kernel, of an intrinsic of Numba's
        if isinstance(value, FunctionType):
            if id(value) not in seen:
                seen.add(id(value))
                parts.append(repr(value.__defaults__))
                describe_fields(value.__annotations__, value.__globals__)
                describe_code(value.__code__, value.__globals__, value.__doc__)
        elif isinstance(value, np.ndarray):
            parts.append(f"{value.dtype}{value.shape}{value.tobytes()!r}")
        elif isinstance(value, type):
            parts.append(f"{value.__qualname__}{getattr(value, '_fields', ())}")
            if hasattr(value, "_fields"):
                describe_fields(value.__annotations__, vars(sys.modules[value.__module__]))
        elif isinstance(value, (bool, int, float, str, tuple, np.generic)):
            parts.append(repr(value))

    def describe_fields(annotations: Mapping[str, Any], names: Mapping[str, Any]) -> None:
        """Describe named tuples among annotations: compiled code reads their fields by position."""
        for annotation in annotations.values():
            for word in re.findall(r"\w+", str(getattr(annotation, "__forward_arg__", annotation))):
                if hasattr(names.get(word), "_fields"):
                    describe(names[word])

    def describe_code(code: CodeType, names: dict[str, Any], documentation: str | None = None) -> None:
        parts.append(f"{code.co_name}{code.co_code!r}{code.co_names}{code.co_varnames}")
        for constant in code.co_consts:
            if isinstance(constant, CodeType):
                describe_code(constant, names)
            elif constant != documentation:
                parts.append(repr(constant))
        for name in code.co_names:
            describe(names.get(name))

    describe(function)
    return hashlib.sha256("\n".join(parts).encode()).hexdigest()


class _CheckedFile(IndexDataCacheFile):
    """The files of one kernel, with checksums; a damaged index counts as empty.

    Numba writes the index before the data. If writing the data fails, the stamp in the former data tells them apart.
    """

    def _load_index(self) -> dict[Any, str]:
        try:
            found: dict[Any, str] = super()._load_index()
        except PermissionError:
            raise
        except (AttributeError, ModuleNotFoundError):  # it names a type of an earlier version
            return {}
        except Exception:
            _warn_of_damage(self._cache_path)
            return {}
        return found

    def _load_data(self, name: str) -> Any:
        kept = super()._load_data(name)
        if not isinstance(kept, bytes):  # of an earlier version, without a checksum
            return None
        digest, content = kept[:_DIGEST], kept[_DIGEST:]
        if hashlib.sha256(content).digest() != digest:
            raise ValueError("the checksum does not fit")
        stamp = str(self._source_stamp).encode()
        if not content.startswith(stamp):
            return None
        try:
            return pickle.loads(content[len(stamp) :])  # noqa: S301 - the user's own folder, as compiled modules are
        except (AttributeError, ModuleNotFoundError):  # the same code stood in another module
            return None

    def _save_data(self, name: str, data: Any) -> None:
        content = str(self._source_stamp).encode() + dumps(data)
        super()._save_data(name, hashlib.sha256(content).digest() + content)


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
    """Warn that no cache folder is writable."""
    warnings.warn(
        "There is no folder that the compiler's cache can be written to, so that every start compiles again; name one "
        "by NUMBA_CACHE_DIR.",
        CacheWarning,
        stacklevel=2,
    )
