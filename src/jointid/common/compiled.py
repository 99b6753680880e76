"""The two ways a function becomes a compiled kernel, and what it may ask of the machine."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, TypeVar, cast

import numba
from numba import types
from numba.extending import intrinsic

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


def _widened(_: Any) -> tuple[Any, Any]:
    def lower(context: Any, builder: Any, *_: Any) -> Any:
        # A set whose own `add` knows the attributes without a value only, so it is told of this one as any set is.
        set.add(builder.function.attributes, '"prefer-vector-width"="512"')
        return context.get_dummy_value()

    return types.void(), lower


def _nothing() -> None: ...


wide_vectors = (
    _nothing
    if numba.config.DISABLE_JIT  # type: ignore[attr-defined]
    else cast("Callable[[], None]", intrinsic(_widened))
)
"""Let the function that calls this use all of the machine's vectors, as those it inlines must ask, too.

Of vectors of 512 bits LLVM takes halves, since a program that seldom needs them would lose by them (a machine may slow
down for the first). A loop that is made of nothing else gains by them.
"""


def _njit(function: F, *, cache: bool = False, forceinline: bool = False) -> F:
    make = numba.njit(cache=cache, forceinline=forceinline, nogil=True, fastmath={"contract"}, error_model="numpy")
    return cast("F", make(function))
