"""Recurrences, compiled: what a sampled law answers to given inputs, and a filter of many columns both ways."""

from __future__ import annotations

from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from jointid.common.compiled import compiled, inlined
from jointid.data.record import FloatArray

Four: TypeAlias = tuple[float, float, float, float]


SECTIONS = 4
"""Of the filter that is compiled: it has the order 8."""

_LANES = 16  # columns that are filtered at a time
_LINE = 8  # numbers of a cache line


@inlined
def _aligned(size: int) -> FloatArray:
    """Return so many zeros that begin with a line of the cache; here again, as the compiler's cache sees one file."""
    room = np.zeros(size + _LINE)
    first = (-(room.ctypes.data // 8)) % _LINE
    return room[first : first + size]


@inlined
def _through(q: FloatArray, b0: Four, b1: Four, b2: Four, a1: Four, a2: Four) -> None:
    """Move all columns of a sample, in the first row of `q`, through the sections, whose states are the other rows.

    One loop whose every value is written once, as the compiler then keeps to vectors.
    """
    for j in range(_LANES):
        x0 = q[j]
        x1 = b0[0] * x0 + q[_LANES + j]
        x2 = b0[1] * x1 + q[3 * _LANES + j]
        x3 = b0[2] * x2 + q[5 * _LANES + j]
        x4 = b0[3] * x3 + q[7 * _LANES + j]
        q[_LANES + j] = (q[2 * _LANES + j] + b1[0] * x0) - a1[0] * x1
        q[2 * _LANES + j] = b2[0] * x0 - a2[0] * x1
        q[3 * _LANES + j] = (q[4 * _LANES + j] + b1[1] * x1) - a1[1] * x2
        q[4 * _LANES + j] = b2[1] * x1 - a2[1] * x2
        q[5 * _LANES + j] = (q[6 * _LANES + j] + b1[2] * x2) - a1[2] * x3
        q[6 * _LANES + j] = b2[2] * x2 - a2[2] * x3
        q[7 * _LANES + j] = (q[8 * _LANES + j] + b1[3] * x3) - a1[3] * x4
        q[8 * _LANES + j] = b2[3] * x3 - a2[3] * x4
        q[j] = x4


@inlined
def _one_way(
    q: FloatArray, line: FloatArray, begin: int, step: int, settled: FloatArray, coefficients: tuple[Four, ...]
) -> None:
    """Filter all samples in place, from `begin` on by steps of 1 or -1, as if the first had been so for ever."""
    b0, b1, b2, a1, a2 = coefficients
    for s in range(2 * SECTIONS):
        for j in range(_LANES):
            q[(1 + s) * _LANES + j] = settled[s] * line[begin * _LANES + j]
    for k in range(line.size // _LANES):
        at = np.uint64((begin + step * k) * _LANES)
        for j in range(_LANES):
            q[j] = line[at + np.uint64(j)]
        _through(q, b0, b1, b2, a1, a2)
        for j in range(_LANES):
            line[at + np.uint64(j)] = q[j]


@compiled
def both_ways(
    sections: FloatArray, settled: FloatArray, values: FloatArray, padding: int, first: int, out: FloatArray, keep: int
) -> None:
    """Filter columns forwards and backwards and keep some of the samples, as `scipy.signal.sosfiltfilt` does.

    Args:
        sections: (SECTIONS, 6) of second order.
        settled: (2 * SECTIONS,) their states at a constant 1.
        values: (samples, columns).
        padding: samples by which the ends are reflected about their ends.
        first: sample that is kept first.
        out: (kept, columns) is filled.
        keep: one sample in so many.
    """
    n, columns = values.shape
    b0 = (sections[0, 0], sections[1, 0], sections[2, 0], sections[3, 0])
    b1 = (sections[0, 1], sections[1, 1], sections[2, 1], sections[3, 1])
    b2 = (sections[0, 2], sections[1, 2], sections[2, 2], sections[3, 2])
    a1 = (sections[0, 4], sections[1, 4], sections[2, 4], sections[3, 4])
    a2 = (sections[0, 5], sections[1, 5], sections[2, 5], sections[3, 5])
    coefficients = (b0, b1, b2, a1, a2)
    line, q = _aligned((n + 2 * padding) * _LANES), _aligned((1 + 2 * SECTIONS) * _LANES)
    for begin in range(0, columns, _LANES):
        width = min(_LANES, columns - begin)
        for k in range(n):
            for j in range(width):
                line[(padding + k) * _LANES + j] = values[k, begin + j]
        for k in range(padding):
            for j in range(width):
                at, last = begin + j, n + padding + k
                line[k * _LANES + j] = 2.0 * values[0, at] - values[padding - k, at]
                line[last * _LANES + j] = 2.0 * values[n - 1, at] - values[n - 2 - k, at]
        _one_way(q, line, 0, 1, settled, coefficients)
        _one_way(q, line, n + 2 * padding - 1, -1, settled, coefficients)
        for i in range(out.shape[0]):
            for j in range(width):
                out[i, begin + j] = line[(padding + first + i * keep) * _LANES + j]


@compiled
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
    """Fill `raw`, and `excess` unless it is given, period by period; `z` is overwritten by the last states.

    Args:
        starts: (phases, rows + 1) where each row of a phase begins among the weights; the rows are those of the
            elements, then those of the states.
        sources: (weights,) what a weight is of: the states, then the inputs, then the excesses.
        weights: (weights,) those that are not 0: a long delay is many states with one weight each.
        limits: (elements,) of the elements that are limits.
        gates: (elements,) the place of the limit a gate watches, negative for a limit.
        free: whether limits and gates act, so that the excess is found; else it is read.
        z: (states,).
        inputs: (periods, inputs).
        excess: (periods, elements) in, or out.
        raw: (periods, elements) out.
    """
    periods, width = inputs.shape
    phases, rows = starts.shape[0], starts.shape[1] - 1
    order, elements = z.size, limits.size
    now = np.zeros(order + width + elements)
    now[:order] = z
    new = np.zeros(order)
    for k in range(periods):
        phase = k % phases
        now[order : order + width] = inputs[k]
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
        now[:order] = new
    z[:] = now[:order]
