"""Numba decorators, and compiled kernels that are not part of a simulation."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, TypeAlias, TypeVar, cast

import numba
import numpy as np
from numba import types
from numba.extending import intrinsic
from numpy.typing import NDArray

from jointid.common.arrays import FloatArray
from jointid.common.compiler_cache import KernelCache, warn

F = TypeVar("F", bound=Callable[..., object])
MODES = 4
"""Of the filter that is compiled: it has the order 8."""

Four: TypeAlias = tuple[float, float, float, float]

_NOTHING = 1e-200  # what falls below it is 0: near the smallest numbers many machines are a hundred times slower
_BLOCK = 16  # kept samples between two checks for one


def compile_kernel(function: F) -> F:
    """Compile with Numba: cached on disk, without the GIL, with fused multiply-add.

    Without a writable cache folder, each process compiles the kernel.
    """
    kernel: Any = _njit(function)
    if kernel is not function:  # Numba may be configured not to compile
        try:
            kernel._cache = KernelCache(function)
        except (RuntimeError, OSError):  # there is no such folder, or there are no files of sources
            warn("The compiler's cache has no folder, so that every start compiles again; name one by NUMBA_CACHE_DIR.")
    return cast("F", kernel)


def has_cache(kernel: object) -> bool:
    """Test whether a kernel is cached, or has no cache."""
    held = getattr(kernel, "_cache", None)
    return not isinstance(held, KernelCache) or held.holds_any()


def inline_kernel(function: F) -> F:
    """Compile as part of every caller; Python cannot call the function.

    A real call passes an array as seven values and counts references; Python wrappers take a fifth of the compile time.
    """
    return _njit(function, forceinline=True, no_cpython_wrapper=True, no_cfunc_wrapper=True)


def _prefer_wide_vectors(_: Any) -> tuple[Any, Any]:
    def lower(context: Any, builder: Any, *_: Any) -> Any:
        # A set whose own `add` knows the attributes without a value only, so call that of any set.
        set.add(builder.function.attributes, '"prefer-vector-width"="512"')
        return context.get_dummy_value()

    return types.void(), lower


_intrinsic: Any = intrinsic  # its types know no function without arguments
wide_vectors: Callable[[], None] = (
    (lambda: None) if numba.config.DISABLE_JIT else _intrinsic(_prefer_wide_vectors)  # type: ignore[attr-defined]
)
"""Let the function that calls this use all of the machine's vectors, as those it inlines must ask, too.

Of vectors of 512 bits LLVM takes halves, since a program that seldom needs them would lose by them (a machine may slow
down for the first). A loop that is made of nothing else gains by them.
"""


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


@inline_kernel
def _four(values: FloatArray) -> Four:
    return values[0], values[1], values[2], values[3]


@compile_kernel
def carry(powers: FloatArray, said: FloatArray, step: int) -> None:
    """Propagate the modes of a filter from each kept sample to the next.

    Args:
        powers: (2, MODES) real and imaginary part of each mode's factor between two kept samples.
        said: (columns, kept, 2 MODES) initial modes, then the contribution of each interval, real parts first; replaced
            by the modes at each kept sample.
        step: 1 forwards, -1 backwards.
    """
    wide_vectors()
    (a0, a1, a2, a3), (b0, b1, b2, b3) = _four(powers[0]), _four(powers[1])
    count = said.shape[1]
    for k in range(1, count):
        at = np.uint64(k if step > 0 else count - 1 - k)
        last = np.uint64(k - 1 if step > 0 else count - k)
        if k % _BLOCK == 0:  # what is left of a signal that ended long ago
            for j in range(said.shape[0]):
                for i in range(2 * MODES):
                    said[j, last, i] = said[j, last, i] if abs(said[j, last, i]) > _NOTHING else 0.0
        for j in range(said.shape[0]):
            r0, r1, r2, r3 = said[j, last, 0], said[j, last, 1], said[j, last, 2], said[j, last, 3]
            i0, i1, i2, i3 = said[j, last, 4], said[j, last, 5], said[j, last, 6], said[j, last, 7]
            s0, t0 = said[j, at, 0] + (a0 * r0 - b0 * i0), said[j, at, 4] + (b0 * r0 + a0 * i0)
            s1, t1 = said[j, at, 1] + (a1 * r1 - b1 * i1), said[j, at, 5] + (b1 * r1 + a1 * i1)
            s2, t2 = said[j, at, 2] + (a2 * r2 - b2 * i2), said[j, at, 6] + (b2 * r2 + a2 * i2)
            s3, t3 = said[j, at, 3] + (a3 * r3 - b3 * i3), said[j, at, 7] + (b3 * r3 + a3 * i3)
            said[j, at, 0], said[j, at, 1], said[j, at, 2], said[j, at, 3] = s0, s1, s2, s3
            said[j, at, 4], said[j, at, 5], said[j, at, 6], said[j, at, 7] = t0, t1, t2, t3


@compile_kernel
def respond(
    starts: NDArray[np.int64],
    sources: NDArray[np.int64],
    weights: FloatArray,
    limits: FloatArray,
    gates: NDArray[np.int64],
    free: bool,
    z: FloatArray,
    inputs: FloatArray,
    excess: FloatArray,
    raw: FloatArray,
) -> None:
    """Compute `raw`, and `excess` unless given, period by period; `z` becomes the final state.

    Args:
        starts: (phases, rows + 1) first weight of each row; the rows are the elements, then the states.
        sources: (weights,) index of a weight's signal: states, then inputs, then excesses.
        weights: (weights,) nonzero weights.
        limits: (elements,) which elements are limits.
        gates: (elements,) index of the limit that a gate watches, negative for a limit.
        free: whether limits and gates act and `excess` is computed.
        z: (states,).
        inputs: (periods, inputs).
        excess: (periods, elements) in, or out.
        raw: (periods, elements) out.
    """
    periods, width = inputs.shape
    phases, rows = starts.shape[0], starts.shape[1] - 1
    order, elements = z.size, limits.size
    now = np.zeros(order + width + elements)
    assign(now[:order], z)
    new = np.zeros(order)
    for k in range(periods):
        phase = k % phases
        assign(now[order : order + width], inputs[k])
        for row in range(rows):
            total = 0.0
            for at in range(starts[phase, row], starts[phase, row + 1]):
                total += weights[at] * now[sources[at]]
            if row >= elements:
                new[row - elements] = total
                continue
            raw[k, row] = total
            if free:
                cut = 0.0
                if gates[row] >= 0:
                    if total * excess[k, gates[row]] < 0.0:
                        cut = -total
                elif abs(total) > limits[row]:
                    cut = np.copysign(limits[row], total) - total
                excess[k, row] = cut
            now[order + width + row] = excess[k, row]
        assign(now[:order], new)
    assign(z, now[:order])
