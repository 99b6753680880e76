"""Numba decorators, and their cache on disk."""

from __future__ import annotations

import contextlib
import hashlib
import os
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any, TypeVar, cast

import numba
from numba import types
from numba.core.caching import FunctionCache, IndexDataCacheFile

from jointid.common.arrays import FloatArray

F = TypeVar("F", bound=Callable[..., object])


class KernelCache(FunctionCache):
    """Numba's disk cache of one kernel; a damaged or unwritable one is ignored.

    Numba's own stamp covers the kernel's file only, so file names contain a hash of all kernels instead. They also
    contain the process number: two processes that compile at once would otherwise overwrite each other's code.
    """

    def __init__(self, function: Any) -> None:
        super().__init__(function)
        self._cache_file = IndexDataCacheFile(self._cache_path, f"{self._impl.filename_base}.{hash_kernels()}", "")
        self._cache_file._data_name_pattern = self._cache_file._data_name_pattern[:-4] + f".{os.getpid()}.nbc"

    def load_overload(self, sig: Any, target_context: Any) -> Any:
        """Load a compiled kernel; None if it is missing or damaged."""
        try:
            return super().load_overload(sig, target_context)
        except Exception:  # a damaged pickle raises anything
            with contextlib.suppress(OSError):
                self.flush()
            return None

    def save_overload(self, sig: Any, data: Any) -> None:
        """Save a compiled kernel, if possible."""
        with contextlib.suppress(Exception):  # a full disk, or a type that is not kept
            super().save_overload(sig, data)


_SOURCES = (
    "common/compiled.py",
    "records/signals/sections.py",
    "simulation/kernels/*.py",
    "models/**/*.py",
)
"""The modules of kernels and of their named-tuple arguments, whose fields they read by position."""


@cache
def hash_kernels() -> str:
    """Hash the sources of all kernels."""
    package = Path(__file__).parents[1]
    files = sorted(file for pattern in _SOURCES for file in package.glob(pattern))
    return hashlib.sha256(b"".join(file.read_bytes() for file in files)).hexdigest()[:16]


def compile_kernel(function: F, **options: bool) -> F:
    """Compile with Numba: without the GIL, with fused multiply-add, cached if possible."""
    kernel: Any = _njit(function, **options)
    if kernel is not function:  # Numba may be configured not to compile
        with contextlib.suppress(RuntimeError, OSError):  # there is no such folder, or there are no files of sources
            kernel._cache = KernelCache(function)
    return cast("F", kernel)


def inline_kernel(function: F) -> F:
    """Compile a function that is inlined in its callers and allocates no array.

    Python cannot call it. Reference counts take half of a step's time, and wrappers a fifth of the compile time.
    """
    return _njit(function, forceinline=True, no_cpython_wrapper=True, no_cfunc_wrapper=True, _nrt=False)


def _njit(function: F, **options: bool) -> F:
    make: Any = numba.njit  # its types know some of the options only
    kernel = make(nogil=True, fastmath={"contract"}, error_model="numpy", **options)(function)
    if kernel is not function:  # Numba may be configured not to compile
        template = kernel.get_call_template
        unliteral: Any = types.unliteral

        def without_literals(args: tuple[Any, ...], kws: dict[str, Any]) -> Any:
            return template(tuple(map(unliteral, args)), kws)

        # Numba takes a constant argument for a type of its own, and compiles the function again for each.
        kernel.get_call_template = without_literals
    return cast("F", kernel)


@inline_kernel
def assign(to: FloatArray, values: FloatArray) -> None:
    """Copy a vector; slice assignment takes a second longer to compile."""
    for i in range(values.size):
        to[i] = values[i]
