"""The one way a function becomes a compiled kernel."""

from __future__ import annotations

from collections.abc import Callable
from typing import TypeVar

import numba

F = TypeVar("F", bound=Callable[..., object])


def inlined(function: F) -> F:
    """Compile as part of its caller: Numba passes an array to a real call as seven values and counts references."""
    return numba.njit(forceinline=True, nogil=True, fastmath={"contract"}, error_model="numpy")(function)


def compiled(function: F) -> F:
    """Compile with Numba: cached on disk, GIL released, multiply-adds fused.

    Numba refuses to cache where neither the package nor the user's cache folder can be written (a read-only
    container, a service account without a home); the kernel then compiles in each process.
    """
    options = {"nogil": True, "fastmath": {"contract"}, "error_model": "numpy"}
    try:
        return numba.njit(cache=True, **options)(function)  # type: ignore[no-any-return]
    except RuntimeError:
        return numba.njit(**options)(function)  # type: ignore[no-any-return]
