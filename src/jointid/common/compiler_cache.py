"""Disk cache of compiled kernels: Numba's own, in files that are named by a hash of the kernel's sources.

Numba's own stamp covers the kernel's file only. An unreadable entry is compiled again; a folder that cannot be written
causes a warning.
"""

from __future__ import annotations

import contextlib
import hashlib
import re
import sys
import warnings
from functools import cache
from pathlib import Path
from typing import Any

from numba.core.caching import FunctionCache, IndexDataCacheFile


class CacheWarning(UserWarning):
    """The compiler cache is unusable, so kernels are compiled again."""


class KernelCache(FunctionCache):
    """The cache of one kernel."""

    def __init__(self, function: Any) -> None:
        super().__init__(function)
        # Numba's names have the line of the function: that moves with every edit above it.
        before, after = re.split(r"-\d+(?=\.py\d)", self._impl.filename_base)
        self._every = f"{before}.*{after}.*"
        self._cache_file = IndexDataCacheFile(
            self._cache_path, f"{before}.{hash_sources(function.__module__)}{after}", ""
        )

    def holds_any(self) -> bool:
        """Test whether the cache holds the kernel of the present sources."""
        return Path(self._cache_file._index_path).exists()

    def load_overload(self, sig: Any, target_context: Any) -> Any:
        """Load a compiled kernel; None if it is missing or damaged."""
        try:
            return super().load_overload(sig, target_context)
        except PermissionError:  # it cannot be written either, which is said then
            return None
        except Exception:  # a damaged pickle raises anything
            warn(
                f"The compiler's cache in {self.cache_path} is damaged, and what is needed of it is compiled again; if "
                "this is said again, delete that folder."
            )
            with contextlib.suppress(OSError):
                self.flush()
            return None

    def save_overload(self, sig: Any, data: Any) -> None:
        """Save a compiled kernel, if possible, and remove those of former sources."""
        try:
            if not self.holds_any():
                for former in Path(self.cache_path).glob(self._every):
                    former.unlink(missing_ok=True)
            super().save_overload(sig, data)
        except Exception as error:
            reason = str(getattr(error, "strerror", None) or type(error).__name__).lower()
            warn(
                f"The compiler's cache in {self.cache_path} cannot be written ({reason}), so that every start compiles "
                "again; free space there, delete that folder, or name another by NUMBA_CACHE_DIR."
            )


@cache
def hash_sources(module: str) -> str:
    """Hash the source of a module of kernels and of those of its package that it imports from.

    Of other modules compiled code takes named tuples alone, whose fields it reads by position.
    """
    imports = re.compile(rf"^from ({module.partition('.')[0]}[\w.]*) import", re.MULTILINE)
    waiting, found = [module], dict[str, str]()
    while waiting:
        if (name := waiting.pop()) not in found:
            text = Path(str(sys.modules[name].__file__)).read_text(encoding="utf-8")
            if "_kernel" in text:
                found[name] = text
                waiting += imports.findall(text)
            else:
                values = vars(sys.modules[name]).items()
                found[name] = str({key: value._fields for key, value in values if hasattr(value, "_fields")})
    return hashlib.sha256(str(sorted(found.items())).encode()).hexdigest()[:16]


@cache  # said once
def warn(said: str) -> None:
    """Warn that the cache is of no use."""
    warnings.warn(said, CacheWarning, stacklevel=3)
