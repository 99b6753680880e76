"""Polynomials of the motion within a step, compiled: their values, and the first root, where something happens.

The first sign change is isolated by the signs of the coefficients in Bernstein's basis, then found by Newton.
"""

from __future__ import annotations

import math

import numpy as np

from jointid.common.arrays import FloatArray
from jointid.common.compiled import compile_kernel, inline_kernel

ORDER = 10  # of the polynomials
_DEPTH = 40  # of the halvings that isolate a root

# Rows of the scratch: five are the caller's own; the function whose root is sought, then the stack of halved intervals,
# each with its ends in two more columns.
SOUGHT, _STACK = 5, 6
_LOW, _HIGH = ORDER + 1, ORDER + 2
ROOM = (_STACK + _DEPTH, ORDER + 3)


def _bernstein_table() -> FloatArray:
    n = ORDER
    table = np.zeros((n + 1, n + 1))
    for i in range(n + 1):
        for j in range(i + 1):
            table[i, j] = math.comb(i, j) / math.comb(n, j)
    return table


_BERNSTEIN = _bernstein_table()


@inline_kernel
def value_at(c: FloatArray, row: int, t: float) -> float:
    """Return a polynomial's value: Estrin's scheme, whose chain is half as long as Horner's."""
    t2 = t * t
    t4 = t2 * t2
    low = (c[row, 0] + c[row, 1] * t) + (c[row, 2] + c[row, 3] * t) * t2
    middle = (c[row, 4] + c[row, 5] * t) + (c[row, 6] + c[row, 7] * t) * t2
    high = (c[row, 8] + c[row, 9] * t) + c[row, 10] * t2
    return float(low + (middle + high * t4) * t4)


@inline_kernel
def first_root(c: FloatArray) -> float:
    """Return the first root in (0, 1] of the polynomial in row SOUGHT; 2.0 if there is none.

    A start below zero is a root at 0. Newton, kept inside a shrinking bracket.
    """
    start, lowest, root = c[SOUGHT, 0], c[SOUGHT, 0], 2.0
    for i in range(1, ORDER + 1):
        lowest += min(c[SOUGHT, i], 0.0)
    if start < 0.0:
        root = 0.0
    elif lowest <= 0.0:
        low, high = _isolate(c)
        t = 0.5 * (low + high)
        for _ in range(100 if t <= 1.0 else 0):
            value, slope = c[SOUGHT, ORDER], 0.0
            for i in range(ORDER - 1, -1, -1):
                value, slope = c[SOUGHT, i] + t * value, value + t * slope
            low, high = (low, t) if value < 0.0 else (t, high)
            new = t - value / slope if slope != 0.0 else t + 1.0
            root = min(max(new, low), high)
            if abs(new - t) <= 1e-9 or high - low <= 1e-16:  # Newton squares the error: the next is under the rounding
                break
            t = new if low < new < high else 0.5 * (low + high)
    return root


@compile_kernel
def _isolate(c: FloatArray) -> tuple[float, float]:
    """Isolate the first sign change of the polynomial in row SOUGHT; 2.0 without one.

    The signs of its Bernstein coefficients bound the number of roots: none changes, no root; one change, one
    root. Otherwise the interval is halved, left half first.
    """
    n = ORDER
    top = _STACK
    c[top, _LOW], c[top, _HIGH] = 0.0, 1.0
    for i in range(n + 1):
        c[top, i] = 0.0
        for j in range(i + 1):
            c[top, i] += _BERNSTEIN[i, j] * c[SOUGHT, j]
    while top >= _STACK:
        changes = 0
        sign = 1.0
        for i in range(n + 1):
            if c[top, i] * sign < 0.0:
                changes += 1
                sign = -sign
        low, high = c[top, _LOW], c[top, _HIGH]
        if changes == 1:
            return low, high
        # Two roots within rounding: it touches zero and comes back.
        if changes == 0 or top == _STACK + _DEPTH - 1 or high - low < 1e-12:
            top -= 1
            continue
        middle = 0.5 * (low + high)
        for i in range(n + 1):  # de Casteljau: the left half goes above, the right half stays
            c[top + 1, i] = c[top, 0]
            for j in range(n - i):
                c[top, j] = 0.5 * (c[top, j] + c[top, j + 1])
        c[top, _LOW] = c[top + 1, _HIGH] = middle
        c[top + 1, _LOW] = low
        top += 1
    return 2.0, 2.0
