"""Disk cache of compiled kernels that tolerates damage.

A kernel's stamp covers its code, the functions it calls and the constants it reads; Numba's own stamp covers its file
only. A checksum protects the machine code. An unreadable entry is compiled again; a folder that cannot be written
causes a warning.
"""

from __future__ import annotations

import hashlib
import pickle
import re
import sys
import warnings
from collections.abc import Mapping
from functools import cache
from types import CodeType, FunctionType
from typing import Any

import numpy as np
from numba.core.caching import FunctionCache, IndexDataCacheFile
from numba.core.serialize import dumps

_DIGEST = hashlib.sha256().digest_size


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

    def holds_any(self) -> bool:
        """Test whether the cache holds the kernel with its present stamp."""
        return bool(self._try(self._cache_file._load_index))

    def load_overload(self, sig: Any, target_context: Any) -> Any:
        """Load a compiled kernel; None if it is missing or damaged."""
        return self._try(super().load_overload, sig, target_context)

    def _try(self, load: Any, *arguments: Any) -> Any:
        """Load a kernel; return None for a damaged cache, which is emptied."""
        if self._cache_file._source_stamp is None:  # not before all that it calls is defined
            self._cache_file._source_stamp = _stamp(self._function, self._options)
        try:
            return load(*arguments)
        except PermissionError:  # it cannot be written either, which is said then
            return None
        except (AttributeError, ModuleNotFoundError):  # of a type of an earlier version
            pass
        except Exception:  # a damaged pickle raises anything
            warn(
                f"The compiler's cache in {self.cache_path} is damaged, and what is needed of it is compiled again; if "
                "this is said again, delete that folder."
            )
        try:
            self.flush()
        except OSError as error:
            self._warn_of_place(error)
        return None

    def save_overload(self, sig: Any, data: Any) -> None:
        """Save a compiled kernel, if possible."""
        try:
            super().save_overload(sig, data)
        except Exception as error:
            self._warn_of_place(error)

    def _warn_of_place(self, error: Exception) -> None:
        reason = str(getattr(error, "strerror", None) or type(error).__name__).lower()
        warn(
            f"The compiler's cache in {self.cache_path} cannot be written ({reason}), so that every start compiles "
            "again; free space there, delete that folder, or name another by NUMBA_CACHE_DIR."
        )


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
    """The files of one kernel, with checksums.

    Numba writes the index before the data. If writing the data fails, the stamp in the former data tells them apart.
    """

    def _load_data(self, name: str) -> Any:
        kept = super()._load_data(name)
        digest, content, stamp = kept[:_DIGEST], kept[_DIGEST:], str(self._source_stamp).encode()
        if hashlib.sha256(content).digest() != digest:
            raise ValueError("the checksum does not fit")
        if not content.startswith(stamp):
            return None
        return pickle.loads(content[len(stamp) :])  # noqa: S301 - the user's own folder, as compiled modules are

    def _save_data(self, name: str, data: Any) -> None:
        content = str(self._source_stamp).encode() + dumps(data)
        super()._save_data(name, hashlib.sha256(content).digest() + content)


@cache  # said once
def warn(said: str) -> None:
    """Warn that the cache is of no use."""
    warnings.warn(said, CacheWarning, stacklevel=3)
