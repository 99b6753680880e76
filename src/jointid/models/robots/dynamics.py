"""Regressor of the inertial parameters of a tree of links, and the vectors that the equations are written in.

::

    tau = M(q) a + c(q, v) + g(q) = Y(q, v, a) p

Link i has its frame on its joint. At q = 0 that frame stands in the parent's at `origins[i]`, turned by `rotations[i]`
(link to parent); a revolute joint turns the link about `axes[i]`, a prismatic one slides it along. Inertial parameters
``m, mx, my, mz, Ixx, Ixy, Ixz, Iyy, Iyz, Izz`` are about the origin of the link's frame, so the dynamics are linear in
them [Khalil and Dombre 2002, ch. 9]. What a rotor adds behind its gear, and friction, is not in here.

`equations` has the mass matrix and the torque in one pass. The regressor carries the axis of every joint out to the
links that it moves, one twist for each pair, rather than ten wrenches of each link back to the base [Atkeson, An and
Hollerbach 1986 for the linear form].

All arrays are contiguous, of float64 and int64; nothing is checked here (`robot.Robot` does).
"""

from __future__ import annotations

import math
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from jointid.common.arrays import FloatArray
from jointid.common.compiled import compile_kernel, inline_kernel
from jointid.models.robots.robot import Tree

Vector: TypeAlias = tuple[float, float, float]
ZERO: Vector = (0.0, 0.0, 0.0)
IntArray: TypeAlias = NDArray[np.int64]

REVOLUTE, PRISMATIC = 0, 1
PARAMETERS = 10
"""Inertial parameters of a link."""


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
def rotate(x: Vector, y: Vector, z: Vector, a: Vector) -> Vector:
    """Return a vector by the matrix of these rows."""
    return dot(x, a), dot(y, a), dot(z, a)


@inline_kernel
def inertia_times(body: FloatArray, i: int, j: int, a: Vector) -> Vector:
    """Return the inertia ``xx, xy, xz, yy, yz, zz`` in a row, from column j on, times a vector."""
    xx, xy, xz, yy, yz, zz = body[i, j], body[i, j + 1], body[i, j + 2], body[i, j + 3], body[i, j + 4], body[i, j + 5]
    return xx * a[0] + xy * a[1] + xz * a[2], xy * a[0] + yy * a[1] + yz * a[2], xz * a[0] + yz * a[1] + zz * a[2]


@inline_kernel
def _to_link(place: FloatArray, i: int, a: Vector) -> Vector:
    x, y, z = get(place, i, 0), get(place, i, 3), get(place, i, 6)
    return (
        x[0] * a[0] + y[0] * a[1] + z[0] * a[2],
        x[1] * a[0] + y[1] * a[1] + z[1] * a[2],
        x[2] * a[0] + y[2] * a[1] + z[2] * a[2],
    )


@inline_kernel
def _place(tree: Tree, q: FloatArray, place: FloatArray) -> None:
    """Fill `place`, (n, 12): each link's rotation to its parent, row by row, and its origin there."""
    kinds, axes, rotations, origins = tree.kinds, tree.axes, tree.rotations, tree.origins
    for i in range(q.size):
        x, y, z = get(axes, i, 0)
        for row in range(3):
            a, b, c = rotations[i, row, 0], rotations[i, row, 1], rotations[i, row, 2]
            along = a * x + b * y + c * z
            if kinds[i] == REVOLUTE:
                cosine, sine = math.cos(q[i]), math.sin(q[i])
                rest = (1.0 - cosine) * along
                put(
                    place,
                    i,
                    3 * row,
                    (
                        cosine * a + sine * (b * z - c * y) + rest * x,
                        cosine * b + sine * (c * x - a * z) + rest * y,
                        cosine * c + sine * (a * y - b * x) + rest * z,
                    ),
                )
                place[i, 9 + row] = origins[i, row]
            else:
                put(place, i, 3 * row, (a, b, c))
                place[i, 9 + row] = origins[i, row] + q[i] * along


@inline_kernel
def _move(tree: Tree, place: FloatArray, v: FloatArray, a: FloatArray, motion: FloatArray) -> None:
    """Fill `motion`, (n, 9): angular velocity, its derivative, and acceleration less gravity, in each link's frame."""
    parents, kinds, axes, gravity = tree.parents, tree.kinds, tree.axes, tree.gravity
    for i in range(v.size):
        parent = parents[i]
        turning, changing = (0.0, 0.0, 0.0), (0.0, 0.0, 0.0)
        rising = (-gravity[0], -gravity[1], -gravity[2])
        if parent >= 0:
            turning, changing, rising = get(motion, parent, 0), get(motion, parent, 3), get(motion, parent, 6)
        r, axis = get(place, i, 9), get(axes, i, 0)
        rising = add(rising, add(cross(changing, r), cross(turning, cross(turning, r))))
        turning, changing, rising = (
            _to_link(place, i, turning),
            _to_link(place, i, changing),
            _to_link(place, i, rising),
        )
        across, along = times(v[i], cross(turning, axis)), times(a[i], axis)
        if kinds[i] == REVOLUTE:
            changing = add(changing, add(across, along))
            turning = add(turning, times(v[i], axis))
        else:
            rising = add(rising, add(times(2.0, across), along))
        put(motion, i, 0, turning)
        put(motion, i, 3, changing)
        put(motion, i, 6, rising)


@compile_kernel
def regressor(
    tree: Tree,
    q: FloatArray,
    v: FloatArray,
    a: FloatArray,
    out: FloatArray,
) -> None:
    """Fill `out`, (n, 10 n), with the regressor: times the inertials, link by link, it is the torque.

    Args:
        tree: of the links.
        q: (n,) rad or m.
        v: (n,) rad/s or m/s.
        a: (n,) rad/s2 or m/s2.
        out: (n, 10 n) N m or N per unit of each parameter.
    """
    n, parents, kinds, axes = q.size, tree.parents, tree.kinds, tree.axes
    place, motion, twist = np.empty((n, 12)), np.empty((n, 9)), np.empty((n, 6))
    _place(tree, q, place)
    _move(tree, place, v, a, motion)
    moves = np.empty(n, np.bool_)
    out[:] = 0.0
    for i in range(n):  # the joint whose axis is carried outwards: about it a link turns, and its origin slides
        moves[:] = False
        for j in range(i, n):
            parent = parents[j]
            if j == i:
                axis = get(axes, i, 0)
                turn, slide = (axis, (0.0, 0.0, 0.0)) if kinds[i] == REVOLUTE else ((0.0, 0.0, 0.0), axis)
            elif parent >= 0 and moves[parent]:
                turn, slide = get(twist, parent, 0), get(twist, parent, 3)
                slide = _to_link(place, j, add(slide, cross(turn, get(place, j, 9))))
                turn = _to_link(place, j, turn)
            else:
                continue
            moves[j] = True
            put(twist, j, 0, turn)
            put(twist, j, 3, slide)
            w, dw, rising = get(motion, j, 0), get(motion, j, 3), get(motion, j, 6)
            at = PARAMETERS * j
            out[i, at] = dot(slide, rising)
            first = add(cross(slide, dw), cross(rising, turn))
            first = add(first, add(times(dot(slide, w), w), times(-dot(w, w), slide)))
            put(out, i, at + 1, first)
            u = cross(turn, w)  # u I w is the part of w x I w along the axis
            out[i, at + 4] = turn[0] * dw[0] + u[0] * w[0]
            out[i, at + 5] = turn[0] * dw[1] + turn[1] * dw[0] + u[0] * w[1] + u[1] * w[0]
            out[i, at + 6] = turn[0] * dw[2] + turn[2] * dw[0] + u[0] * w[2] + u[2] * w[0]
            out[i, at + 7] = turn[1] * dw[1] + u[1] * w[1]
            out[i, at + 8] = turn[1] * dw[2] + turn[2] * dw[1] + u[1] * w[2] + u[2] * w[1]
            out[i, at + 9] = turn[2] * dw[2] + u[2] * w[2]


@compile_kernel
def regressor_of(
    tree: Tree,
    q: FloatArray,
    v: FloatArray,
    a: FloatArray,
) -> FloatArray:
    """Return the regressor of a motion, (samples, n, 10 n); its arguments are (samples, n)."""
    samples, n = q.shape
    out = np.empty((samples, n, PARAMETERS * n))
    for t in range(samples):
        regressor(tree, q[t], v[t], a[t], out[t])
    return out


def inverse_dynamics(tree: Tree, inertials: FloatArray, q: FloatArray, v: FloatArray, a: FloatArray) -> FloatArray:
    """Return the torques of a motion, (samples, n); `inertials` (n, 10), the motion (samples, n) each."""
    return regressor_of(tree, q, v, a) @ inertials.ravel()
