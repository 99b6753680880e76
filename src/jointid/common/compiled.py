"""Numba decorators, their cache on disk, and what makes them compile faster."""

from __future__ import annotations

import contextlib
import hashlib
import os
from collections.abc import Callable
from functools import cache
from pathlib import Path
from types import SimpleNamespace
from typing import Any, TypeVar, cast

import numba
from numba import types
from numba.core.caching import FunctionCache, IndexDataCacheFile
from numba.core.codegen import JITCodeLibrary
from numba.core.compiler import Compiler
from numba.core.registry import cpu_target

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


@cache
def hash_kernels() -> str:
    """Hash the modules of kernels and of their named-tuple arguments, whose fields they read by position."""
    package, patterns = Path(__file__).parents[1], ("common/compiled.py", "simulation/kernels/*.py", "models/**/*.py")
    files = sorted(file for pattern in (*patterns, "records/signals/sections.py") for file in package.glob(pattern))
    return hashlib.sha256(b"".join(file.read_bytes() for file in files)).hexdigest()[:16]


def compile_kernel(function: F, **options: bool) -> F:
    """Compile with Numba: without the GIL, with fused multiply-add, cached if possible."""
    kernel: Any = _njit(function, **options)
    with contextlib.suppress(RuntimeError, OSError):  # there is no such folder, or there are no files of sources
        kernel._cache = KernelCache(function)
    return cast("F", kernel)


def inline_kernel(function: F) -> F:
    """Compile a function that is a part of its callers and allocates no array.

    Python cannot call it. Reference counts take half of a step's time, wrappers a fifth of the compile time, and
    machine code of its own a tenth.
    """
    without = {"no_cpython_wrapper": True, "no_cfunc_wrapper": True, "_nrt": False}
    return _njit(function, forceinline=True, pipeline_class=_PartCompiler, **without)


class _Part(JITCodeLibrary):
    """The code of a function that only its callers optimise and turn into machine code."""

    codegen = SimpleNamespace(set_env=lambda *_: None)  # Numba sets the environment of machine code, and there is none

    def _optimize_final_module(self) -> None:
        pass

    def _finalize_final_module(self) -> None:
        self._finalized = True


class _PartCompiler(Compiler):
    def compile_extra(self, func: Any) -> Any:
        self.state.library = _Part(self.state.targetctx.codegen(), func.__qualname__)
        return super().compile_extra(func)


_KERNELS = set[Any]()  # Numba's hook below serves all of a process, and leaves others' functions as they are


def _njit(function: F, **options: Any) -> F:
    make: Any = numba.njit  # its types know some of the options only
    kernel = make(nogil=True, fastmath={"contract"}, error_model="numpy", **options)(function)
    _KERNELS.add(kernel)
    return cast("F", kernel)


_PLAIN = {types.Array, types.Boolean, types.Complex, types.Float, types.Integer, types.IntegerLiteral, types.UniTuple}
_resolve = cpu_target.typing_context.resolve_function_type
_resolve_operator = cache(lambda function, args: _resolve(function, args, {}))


def _resolve_once(function: Any, args: tuple[Any, ...], kws: dict[str, Any]) -> Any:
    """Find the type of a call; of an operator on numbers and arrays once, which saves an eighth of the compile time."""
    if getattr(function, "dispatcher", None) in _KERNELS:  # else each constant argument has a kernel of its own
        return _resolve(function, tuple(map(types.unliteral, args)), kws)
    origin = getattr(getattr(function, "typing_key", None), "__module__", "")
    if origin == "_operator" and _PLAIN.issuperset(map(type, args)):
        return _resolve_operator(function, args)
    return _resolve(function, args, kws)


cpu_target.typing_context.resolve_function_type = _resolve_once


@inline_kernel
def assign(to: FloatArray, values: FloatArray) -> None:
    """Copy a vector; slice assignment takes a second longer to compile."""
    for i in range(values.size):
        to[i] = values[i]
