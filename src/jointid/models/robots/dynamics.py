"""Motion of a tree of links, and regressor of its inertial parameters.

::

    tau = M(q) a + c(q, v) + g(q) = Y(q, v, a) p

Link i has its frame on its joint. At q = 0 that frame stands in the parent's at `origins[i]`, turned by `rotations[i]`
(link to parent); a revolute joint turns the link about `axes[i]`, a prismatic one slides it along. Inertial parameters
``m, mx, my, mz, Ixx, Ixy, Ixz, Iyy, Iyz, Izz`` are about the origin of the link's frame, so the dynamics are linear in
them [Khalil and Dombre 2002, ch. 9]. Rotors behind gears, and friction, are not included.

All motion is seen from the base, as in `equations`, which has the mass matrix and the torque in one pass. The regressor
takes the axis of every joint to the links that it moves, one twist for each pair, rather than ten wrenches of each link
back to the base [Atkeson, An and Hollerbach 1986 for the linear form].

All arrays are contiguous, of float64 and int64; nothing is checked here (`robot.Robot` does).
"""

from __future__ import annotations

import math
from functools import partial
from typing import TypeAlias

import numpy as np

from jointid.common.arrays import FloatArray
from jointid.common.compiled import compile_kernel, inline_kernel
from jointid.models.robots.robot import Tree

Vector: TypeAlias = tuple[float, float, float]
ZERO: Vector = (0.0, 0.0, 0.0)

REVOLUTE = 0
PARAMETERS = 10
"""Inertial parameters of a link."""
# Columns of the scratch: rotation, row by row, and origin; twists of the joint, of velocity and of acceleration,
# how the joint's turns, and its position, velocity and acceleration. What follows is free for `equations`.
ORIGIN, JOINT, VELOCITY, ACCELERATION, TURNING, MOTION, FREE = 9, 12, 18, 24, 30, 36, 39


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
    """Inertia ``xx, xy, xz, yy, yz, zz``, from column j, times vector."""
    xx, xy, xz, yy, yz, zz = body[i, j], body[i, j + 1], body[i, j + 2], body[i, j + 3], body[i, j + 4], body[i, j + 5]
    return xx * a[0] + xy * a[1] + xz * a[2], xy * a[0] + yy * a[1] + yz * a[2], xz * a[0] + yz * a[1] + zz * a[2]


@inline_kernel
def _place(tree: Tree, i: int, room: FloatArray) -> None:
    """Write the frame of a link and the twist of its joint."""
    parent, turned, q, cosine, sine = tree.parents[i], tree.rotations, room[i, MOTION], 1.0, 0.0
    x, y, z, p = (1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0), ZERO
    if parent >= 0:
        x, y, z = get(room, parent, 0), get(room, parent, 3), get(room, parent, 6)
        p = get(room, parent, ORIGIN)
    p = add(p, rotate(x, y, z, get(tree.origins, i, 0)))
    if tree.kinds[i] == REVOLUTE:
        cosine, sine = math.cos(q), math.sin(q)
    first = add(get(turned, i, 0), add(times(cosine, get(turned, i, 9)), times(sine, get(turned, i, 18))))
    second = add(get(turned, i, 3), add(times(cosine, get(turned, i, 12)), times(sine, get(turned, i, 21))))
    third = add(get(turned, i, 6), add(times(cosine, get(turned, i, 15)), times(sine, get(turned, i, 24))))
    x = dot(x, first), dot(x, second), dot(x, third)
    y = dot(y, first), dot(y, second), dot(y, third)
    z = dot(z, first), dot(z, second), dot(z, third)
    s = rotate(x, y, z, get(tree.axes, i, 0))
    if tree.kinds[i] == REVOLUTE:
        put(room, i, JOINT, s)
        put(room, i, JOINT + 3, cross(p, s))
    else:
        p = add(p, times(q, s))
        put(room, i, JOINT, ZERO)
        put(room, i, JOINT + 3, s)
    put(room, i, 0, x)
    put(room, i, 3, y)
    put(room, i, 6, z)
    put(room, i, ORIGIN, p)


@inline_kernel
def move_link(tree: Tree, i: int, room: FloatArray, placed: bool) -> None:
    """Write frame, unless it is there, joint twist, velocity and acceleration in the base's frame from MOTION."""
    if not placed:
        _place(tree, i, room)
    parent, v, a = tree.parents[i], room[i, MOTION + 1], room[i, MOTION + 2]
    turns, slides = get(room, i, JOINT), get(room, i, JOINT + 3)
    w, u, dw, du = ZERO, ZERO, ZERO, (-tree.gravity[0], -tree.gravity[1], -tree.gravity[2])
    if parent >= 0:
        w, u = get(room, parent, VELOCITY), get(room, parent, VELOCITY + 3)
        dw, du = get(room, parent, ACCELERATION), get(room, parent, ACCELERATION + 3)
    turning, sliding = cross(w, turns), add(cross(w, slides), cross(u, turns))
    put(room, i, TURNING, turning)
    put(room, i, TURNING + 3, sliding)
    put(room, i, VELOCITY, add(w, times(v, turns)))
    put(room, i, VELOCITY + 3, add(u, times(v, slides)))
    put(room, i, ACCELERATION, add(dw, add(times(v, turning), times(a, turns))))
    put(room, i, ACCELERATION + 3, add(du, add(times(v, sliding), times(a, slides))))


@inline_kernel
def _to_link(room: FloatArray, i: int, a: Vector) -> Vector:
    """Return a vector of the base in the frame of a link."""
    x, y, z = get(room, i, 0), get(room, i, 3), get(room, i, 6)
    return add(times(a[0], x), add(times(a[1], y), times(a[2], z)))


@partial(compile_kernel, _nrt=False)
def regressor(tree: Tree, room: FloatArray, out: FloatArray) -> None:
    """Fill `out`, (n, 10 n), with the regressor of joint torques.

    Args:
        tree: of the links.
        room: written by `move_link`.
        out: N m or N per unit of each parameter.
    """
    for i in range(out.shape[0]):
        for column in range(out.shape[1]):
            out[i, column] = 0.0
    for link in range(out.shape[0]):
        p, spun, turned = get(room, link, ORIGIN), get(room, link, VELOCITY), get(room, link, ACCELERATION)
        speed = add(get(room, link, VELOCITY + 3), cross(spun, p))
        lifted = add(get(room, link, ACCELERATION + 3), add(cross(turned, p), cross(spun, speed)))
        w, dw, rising = _to_link(room, link, spun), _to_link(room, link, turned), _to_link(room, link, lifted)
        at, i = PARAMETERS * link, link
        while i >= 0:  # a joint that carries the link: about it the link turns, and its origin slides
            axis = get(room, i, JOINT)
            turn, slide = _to_link(room, link, axis), _to_link(room, link, add(get(room, i, JOINT + 3), cross(axis, p)))
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
            i = tree.parents[i]


@compile_kernel
def regressor_of(tree: Tree, q: FloatArray, v: FloatArray, a: FloatArray) -> FloatArray:
    """Regressor of a motion, (samples, n, 10 n), from (samples, n) each."""
    samples, n = q.shape
    out, room = np.empty((samples, n, PARAMETERS * n)), np.empty((n, FREE))
    for t in range(samples):
        for i in range(n):
            put(room, i, MOTION, (q[t, i], v[t, i], a[t, i]))
            move_link(tree, i, room, False)
        regressor(tree, room, out[t])
    return out
