"""The two ways a function becomes a compiled kernel."""

from __future__ import annotations

from collections.abc import Callable
from typing import TypeVar, cast

import numba

F = TypeVar("F", bound=Callable[..., object])


def compiled(function: F) -> F:
    """Compile with Numba: cached on disk, GIL released, multiply-adds fused.

    Numba refuses to cache where neither the package nor the user's cache folder can be written (a read-only
    container, a service account without a home); the kernel then compiles in each process.
    """
    try:
        return _njit(function, cache=True)
    except RuntimeError:
        return _njit(function, cache=False)


def inlined(function: F) -> F:
    """Compile as part of every caller: Numba passes an array to a real call as seven values, and counts references."""
    return _njit(function, forceinline=True)


def _njit(function: F, *, cache: bool = False, forceinline: bool = False) -> F:
    make = numba.njit(cache=cache, forceinline=forceinline, nogil=True, fastmath={"contract"}, error_model="numpy")
    return cast("F", make(function))
