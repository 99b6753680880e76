"""The rigid dynamics of a tree of links: torques, mass matrix, and the regressor of the inertial parameters.

::

    tau = M(q) a + c(q, v) + g(q) = Y(q, v, a) p

Link i has its frame on its joint. At q = 0 that frame stands in the parent's at `origins[i]`, turned by `rotations[i]`
(link to parent); a revolute joint turns the link about `axes[i]`, a prismatic one slides it along. Inertial parameters
``m, mx, my, mz, Ixx, Ixy, Ixz, Iyy, Iyz, Izz`` are about the origin of the link's frame, so the dynamics are linear in
them [Khalil and Dombre 2002, ch. 9]. What a rotor adds behind its gear, and friction, is not in here.

The torque is the recursion of Newton and Euler [Luh, Walker and Paul 1980], the mass matrix that of composite rigid
bodies [Walker and Orin 1982; Featherstone 2008, ch. 6]. The regressor carries the axis of every joint out to the links
that it moves, one twist for each pair, rather than ten wrenches of each link back to the base [Atkeson, An and
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
from jointid.models.robots.spatial import Vector, add, cross, dot, get, inertia_times, put, times

IntArray: TypeAlias = NDArray[np.int64]

REVOLUTE, PRISMATIC = 0, 1
PARAMETERS = 10
"""Inertial parameters of a link."""


@inline_kernel
def _to_parent(place: FloatArray, i: int, a: Vector) -> Vector:
    return dot(get(place, i, 0), a), dot(get(place, i, 3), a), dot(get(place, i, 6), a)


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
def inverse_dynamics(
    tree: Tree,
    inertials: FloatArray,
    q: FloatArray,
    v: FloatArray,
    a: FloatArray,
    torque: FloatArray,
) -> None:
    """Fill `torque`, (n,), with what the joints exert for the accelerations `a` at positions `q` and velocities `v`.

    Args:
        tree: of the links.
        inertials: (n, 10) see the module.
        q: (n,) rad or m.
        v: (n,) rad/s or m/s.
        a: (n,) rad/s2 or m/s2.
        torque: (n,) N m or N, out.
    """
    n, parents, kinds, axes = q.size, tree.parents, tree.kinds, tree.axes
    place, motion, wrench = np.empty((n, 12)), np.empty((n, 9)), np.empty((n, 6))
    _place(tree, q, place)
    _move(tree, place, v, a, motion)
    for i in range(n):
        w, dw, rising = get(motion, i, 0), get(motion, i, 3), get(motion, i, 6)
        h = get(inertials, i, 1)
        swing = add(cross(dw, h), cross(w, cross(w, h)))
        put(wrench, i, 0, add(times(inertials[i, 0], rising), swing))
        turn = add(inertia_times(inertials, i, 4, dw), cross(w, inertia_times(inertials, i, 4, w)))
        put(wrench, i, 3, add(turn, cross(h, rising)))
    for i in range(n - 1, -1, -1):
        force, moment = get(wrench, i, 0), get(wrench, i, 3)
        torque[i] = dot(get(axes, i, 0), moment if kinds[i] == REVOLUTE else force)
        parent = parents[i]
        if parent >= 0:
            force = _to_parent(place, i, force)
            moment = add(_to_parent(place, i, moment), cross(get(place, i, 9), force))
            put(wrench, parent, 0, add(get(wrench, parent, 0), force))
            put(wrench, parent, 3, add(get(wrench, parent, 3), moment))


@compile_kernel
def regressor(
    tree: Tree,
    q: FloatArray,
    v: FloatArray,
    a: FloatArray,
    out: FloatArray,
) -> None:
    """Fill `out`, (n, 10 n), with the regressor: times the inertials, link by link, it is the torque.

    The arguments are those of `inverse_dynamics`.
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


@inline_kernel
def _carry(place: FloatArray, i: int, parent: int, body: FloatArray) -> None:
    """Add a link's inertials to its parent's, seen from the parent's frame."""
    m, r = body[i, 0], get(place, i, 9)
    h = _to_parent(place, i, get(body, i, 1))
    body[parent, 0] += m
    put(body, parent, 1, add(get(body, parent, 1), add(h, times(m, r))))
    x, y, z = get(place, i, 0), get(place, i, 3), get(place, i, 6)
    of_x, of_y, of_z = inertia_times(body, i, 4, x), inertia_times(body, i, 4, y), inertia_times(body, i, 4, z)
    reach = 2.0 * dot(r, h) + m * dot(r, r)
    body[parent, 4] += dot(x, of_x) + reach - 2.0 * r[0] * h[0] - m * r[0] * r[0]
    body[parent, 5] += dot(x, of_y) - r[0] * h[1] - h[0] * r[1] - m * r[0] * r[1]
    body[parent, 6] += dot(x, of_z) - r[0] * h[2] - h[0] * r[2] - m * r[0] * r[2]
    body[parent, 7] += dot(y, of_y) + reach - 2.0 * r[1] * h[1] - m * r[1] * r[1]
    body[parent, 8] += dot(y, of_z) - r[1] * h[2] - h[1] * r[2] - m * r[1] * r[2]
    body[parent, 9] += dot(z, of_z) + reach - 2.0 * r[2] * h[2] - m * r[2] * r[2]


@compile_kernel
def mass_matrix(
    tree: Tree,
    inertials: FloatArray,
    q: FloatArray,
    out: FloatArray,
) -> None:
    """Fill `out`, (n, n), with the mass matrix of the links, symmetric.

    The arguments are those of `inverse_dynamics`.
    """
    n, parents, kinds, axes = q.size, tree.parents, tree.kinds, tree.axes
    place, body = np.empty((n, 12)), inertials.copy()
    _place(tree, q, place)
    out[:] = 0.0
    for i in range(n - 1, -1, -1):
        axis, h = get(axes, i, 0), get(body, i, 1)
        if kinds[i] == REVOLUTE:
            force, moment = cross(axis, h), inertia_times(body, i, 4, axis)
            out[i, i] = dot(axis, moment)
        else:
            force, moment = times(body[i, 0], axis), cross(h, axis)
            out[i, i] = dot(axis, force)
        j = i
        while parents[j] >= 0:
            force = _to_parent(place, j, force)
            moment = add(_to_parent(place, j, moment), cross(get(place, j, 9), force))
            j = parents[j]
            out[i, j] = out[j, i] = dot(get(axes, j, 0), moment if kinds[j] == REVOLUTE else force)
        if parents[i] >= 0:
            _carry(place, i, parents[i], body)


@compile_kernel
def inverse_dynamics_of(
    tree: Tree,
    inertials: FloatArray,
    q: FloatArray,
    v: FloatArray,
    a: FloatArray,
) -> FloatArray:
    """Return the torques of a motion, (samples, n); positions, velocities and accelerations are (samples, n)."""
    torque = np.empty(q.shape)
    for t in range(q.shape[0]):
        inverse_dynamics(tree, inertials, q[t], v[t], a[t], torque[t])
    return torque


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
