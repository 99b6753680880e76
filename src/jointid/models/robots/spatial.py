"""Vectors of three numbers in rows of arrays, compiled into what uses them."""

from __future__ import annotations

from typing import TypeAlias

from jointid.common.arrays import FloatArray
from jointid.common.compiled import inline_kernel

Vector: TypeAlias = tuple[float, float, float]
ZERO: Vector = (0.0, 0.0, 0.0)


@inline_kernel
def get(values: FloatArray, i: int, j: int) -> Vector:
    """Return three numbers of a row."""
    return values[i, j], values[i, j + 1], values[i, j + 2]


@inline_kernel
def put(values: FloatArray, i: int, j: int, a: Vector) -> None:
    """Write three numbers into a row."""
    values[i, j], values[i, j + 1], values[i, j + 2] = a


@inline_kernel
def add(a: Vector, b: Vector) -> Vector:
    """Return the sum."""
    return a[0] + b[0], a[1] + b[1], a[2] + b[2]


@inline_kernel
def times(factor: float, a: Vector) -> Vector:
    """Return a multiple."""
    return factor * a[0], factor * a[1], factor * a[2]


@inline_kernel
def dot(a: Vector, b: Vector) -> float:
    """Return the inner product."""
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


@inline_kernel
def cross(a: Vector, b: Vector) -> Vector:
    """Return the vector product."""
    return a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]


@inline_kernel
def rotated(x: Vector, y: Vector, z: Vector, a: Vector) -> Vector:
    """Return a vector by the matrix of these rows."""
    return dot(x, a), dot(y, a), dot(z, a)


@inline_kernel
def inertia_times(body: FloatArray, i: int, j: int, a: Vector) -> Vector:
    """Return the inertia ``xx, xy, xz, yy, yz, zz`` in a row, from column j on, times a vector."""
    xx, xy, xz, yy, yz, zz = body[i, j], body[i, j + 1], body[i, j + 2], body[i, j + 3], body[i, j + 4], body[i, j + 5]
    return xx * a[0] + xy * a[1] + xz * a[2], xy * a[0] + yy * a[1] + yz * a[2], xz * a[0] + yz * a[1] + zz * a[2]
