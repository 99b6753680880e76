"""Equations of motion of a tree of links, and their derivatives.

All is seen from the base: with twists and wrenches about its origin the bodies behind a joint are a sum. Of link i, S
is the twist of its joint, V its velocity and A its acceleration (less gravity), I the inertia and f the force of all
bodies that it carries::

    M_ij = S_i' I_i S_j            tau_i = S_i' f_i            for each j that carries i, and i itself

    d tau_i / d q_j = 2 S_i' B_i P_j + S_i' I_i R_j
    d tau_j / d q_i = S_j' (2 B_i P_i + I_i R_i + S_i x* f_i)
    d tau_i / d v_j = 2 S_i' (B_i S_j + I_i P_j)
    d tau_j / d v_i = 2 S_j' (B_i S_i + I_i P_i)

with ``P_j = V x S_j`` and ``R_j = A x S_j + V x P_j`` of what carries joint j [S. Singh, R. P. Russell and P. M.
Wensing: Efficient analytical derivatives of rigid-body dynamics using spatial vector algebra, IEEE Robotics and
Automation Letters 7, 2022]. Of a body with angular velocity w, velocity u of the point at the base's origin, momentum
p,
first moment h and second moments E about that origin, ``B (x, y) = (W x, x x p)`` with ``W x = -w x (E x) + (h'u) x -
u (h'x)``: nine numbers and three, which add up along the chain as inertias do.

The arguments are those of `dynamics`, but positions are those of the shafts that the motors turn: of the joints where
no motors are coupled, and else ``C q`` (`robot.Robot.coupling`), of which `Tree.joints` is the inverse; `room` is
scratch, (n, ROOM).
"""

from __future__ import annotations

from functools import partial

from jointid.common.arrays import FloatArray
from jointid.common.compiled import assign, compile_kernel, inline_kernel
from jointid.models.robots.dynamics import (
    ACCELERATION,
    FREE,
    JOINT,
    MOTION,
    ORIGIN,
    TURNING,
    VELOCITY,
    ZERO,
    Vector,
    add,
    cross,
    dot,
    get,
    inertia_times,
    move_link,
    put,
    rotate,
    times,
)
from jointid.models.robots.robot import Tree

ROOM = FREE + 38
"""Numbers of scratch for each link."""

# Columns of the scratch behind those of the motion: inertia of the link; that of what is carried, and its force; W and
# momentum, of which B is made.
_OWN, _MASS, _FORCE, _W, _MOMENTUM = (FREE + column for column in (0, 10, 20, 26, 35))


@inline_kernel
def to_shafts(joints: FloatArray, rows: FloatArray, room: FloatArray) -> None:
    """Convert rows of joint torques, or their derivatives, to shafts, in place."""
    for i in range(rows.shape[0] if joints.shape[0] > 0 else 0):
        for j in range(joints.shape[0]):
            room[j, _FORCE] = 0.0
            for k in range(joints.shape[0]):
                room[j, _FORCE] += rows[i, k] * joints[k, j]
        for j in range(joints.shape[0]):
            rows[i, j] = room[j, _FORCE]


@inline_kernel
def _body(inertials: FloatArray, i: int, room: FloatArray) -> None:
    """Write the inertia of a link about the base's origin."""
    x, y, z, p = get(room, i, 0), get(room, i, 3), get(room, i, 6), get(room, i, ORIGIN)
    m = inertials[i, 0]
    h = rotate(x, y, z, get(inertials, i, 1))
    of_x, of_y = inertia_times(inertials, i, 4, x), inertia_times(inertials, i, 4, y)
    of_z = inertia_times(inertials, i, 4, z)
    reach = 2.0 * dot(p, h) + m * dot(p, p)
    room[i, _OWN] = m
    put(room, i, _OWN + 1, add(h, times(m, p)))
    room[i, _OWN + 4] = dot(x, of_x) + reach - 2.0 * p[0] * h[0] - m * p[0] * p[0]
    room[i, _OWN + 5] = dot(x, of_y) - p[0] * h[1] - h[0] * p[1] - m * p[0] * p[1]
    room[i, _OWN + 6] = dot(x, of_z) - p[0] * h[2] - h[0] * p[2] - m * p[0] * p[2]
    room[i, _OWN + 7] = dot(y, of_y) + reach - 2.0 * p[1] * h[1] - m * p[1] * p[1]
    room[i, _OWN + 8] = dot(y, of_z) - p[1] * h[2] - h[1] * p[2] - m * p[1] * p[2]
    room[i, _OWN + 9] = dot(z, of_z) + reach - 2.0 * p[2] * h[2] - m * p[2] * p[2]
    assign(room[i, _MASS:_FORCE], room[i, _OWN:_MASS])


@inline_kernel
def _times_inertia(room: FloatArray, i: int, column: int, a: Vector, b: Vector) -> tuple[Vector, Vector]:
    """Moment and force of an inertia for a twist."""
    h, m = get(room, i, column + 1), room[i, column]
    return add(inertia_times(room, i, column + 4, a), cross(h, b)), add(times(m, b), cross(a, h))


@inline_kernel
def _move(
    tree: Tree, inertials: FloatArray, i: int, q: FloatArray, v: FloatArray, a: FloatArray, room: FloatArray,
    placed: bool,
) -> None:  # fmt: skip
    """Write a link's motion into the scratch, from the shafts', with the force for it."""
    motion = (q[i], v[i], a[i])
    if tree.joints.shape[0] > 0:
        motion = ZERO
        for j in range(q.size):
            motion = add(motion, times(tree.joints[i, j], (q[j], v[j], a[j])))
    put(room, i, MOTION, motion)
    move_link(tree, i, room, placed)
    if not placed:
        _body(inertials, i, room)
    w, u = get(room, i, VELOCITY), get(room, i, VELOCITY + 3)
    moment, force = _times_inertia(room, i, _OWN, get(room, i, ACCELERATION), get(room, i, ACCELERATION + 3))
    N, p = _times_inertia(room, i, _OWN, w, u)
    put(room, i, _FORCE, add(moment, add(cross(w, N), cross(u, p))))
    put(room, i, _FORCE + 3, add(force, cross(w, p)))


@inline_kernel
def _accumulate(room: FloatArray, i: int, parent: int, first: int, last: int) -> None:
    """Add columns of a link to those of its parent."""
    for column in range(first, last):
        room[parent, column] += room[i, column]


@partial(compile_kernel, _nrt=False)
def equations_of_motion(
    tree: Tree, inertials: FloatArray, q: FloatArray, v: FloatArray, a: FloatArray, room: FloatArray,
    M: FloatArray, torque: FloatArray, placed: bool,
) -> None:  # fmt: skip
    """Fill the mass matrix, (n, n), and the torques of a motion, (n,); these alone if `room` has the positions."""
    parents, joints, n = tree.parents, tree.joints, tree.parents.size
    for i in range(n):
        _move(tree, inertials, i, q, v, a, room, placed)
        for j in range(0 if placed else n):
            M[i, j] = 0.0
    for i in range(n - 1, -1, -1):
        s, t = get(room, i, JOINT), get(room, i, JOINT + 3)
        torque[i] = dot(s, get(room, i, _FORCE)) + dot(t, get(room, i, _FORCE + 3))
        j = -1
        if not placed:
            j, (moment, force) = i, _times_inertia(room, i, _MASS, s, t)
        while j >= 0:
            M[i, j] = M[j, i] = dot(moment, get(room, j, JOINT)) + dot(force, get(room, j, JOINT + 3))
            j = parents[j]
        if parents[i] >= 0:
            _accumulate(room, i, parents[i], _FORCE if placed else _MASS, _W)
    to_shafts(joints, torque.reshape((1, n)), room)
    if not placed:
        to_shafts(joints, M, room)
        to_shafts(joints, M.T, room)


@inline_kernel
def _own_slopes(room: FloatArray, i: int) -> None:
    """Write W and the momentum of a link, the parts of B."""
    w, u, h = get(room, i, VELOCITY), get(room, i, VELOCITY + 3), get(room, i, _OWN + 1)
    (xx, xy, xz), (yy, yz, zz) = get(room, i, _OWN + 4), get(room, i, _OWN + 7)
    half, along = 0.5 * (xx + yy + zz), dot(h, u)
    # Columns of -w x E, with E = half the trace of the inertia less the inertia.
    first, second = cross((half - xx, -xy, -xz), w), cross((-xy, half - yy, -yz), w)
    third = cross((-xz, -yz, half - zz), w)
    put(room, i, _W, (first[0] + along - u[0] * h[0], second[0] - u[0] * h[1], third[0] - u[0] * h[2]))
    put(room, i, _W + 3, (first[1] - u[1] * h[0], second[1] + along - u[1] * h[1], third[1] - u[1] * h[2]))
    put(room, i, _W + 6, (first[2] - u[2] * h[0], second[2] - u[2] * h[1], third[2] + along - u[2] * h[2]))
    put(room, i, _MOMENTUM, _times_inertia(room, i, _OWN, w, u)[1])


@inline_kernel
def _changing(room: FloatArray, i: int, parent: int, gravity: FloatArray) -> tuple[Vector, Vector]:
    """R of a joint: second change of its twist with its carrier."""
    w, u, dw, du = ZERO, ZERO, ZERO, (-gravity[0], -gravity[1], -gravity[2])
    if parent >= 0:
        w, u = get(room, parent, VELOCITY), get(room, parent, VELOCITY + 3)
        dw, du = get(room, parent, ACCELERATION), get(room, parent, ACCELERATION + 3)
    s, t = get(room, i, JOINT), get(room, i, JOINT + 3)
    P, Q = get(room, i, TURNING), get(room, i, TURNING + 3)
    return add(cross(dw, s), cross(w, P)), add(add(cross(dw, t), cross(du, s)), add(cross(w, Q), cross(u, P)))


@partial(compile_kernel, _nrt=False)
def linearised_equations(
    tree: Tree, inertials: FloatArray, q: FloatArray, v: FloatArray, a: FloatArray, room: FloatArray,
    M: FloatArray, by_place: FloatArray, by_speed: FloatArray,
) -> None:  # fmt: skip
    """Fill mass matrix and torque derivatives by position and velocity, (n, n)."""
    parents, joints, n = tree.parents, tree.joints, tree.parents.size
    for i in range(n):
        _move(tree, inertials, i, q, v, a, room, False)
        _own_slopes(room, i)
        for j in range(n):
            M[i, j] = by_place[i, j] = by_speed[i, j] = 0.0
    for i in range(n - 1, -1, -1):
        s, t = get(room, i, JOINT), get(room, i, JOINT + 3)
        g, h = _times_inertia(room, i, _MASS, s, t)  # I S
        x, y, z = get(room, i, _W), get(room, i, _W + 3), get(room, i, _W + 6)
        p = get(room, i, _MOMENTUM)
        # B' S and B S
        c = add(add(times(s[0], x), add(times(s[1], y), times(s[2], z))), cross(p, t))
        d, e = rotate(x, y, z, s), cross(s, p)
        # 2 B P + I R + S x* f, and B S + I P
        turning, sliding = get(room, i, TURNING), get(room, i, TURNING + 3)
        spinning, swaying = _changing(room, i, parents[i], tree.gravity)
        pulled, pushed = _times_inertia(room, i, _MASS, spinning, swaying)
        moment, force = get(room, i, _FORCE), get(room, i, _FORCE + 3)
        pulled = add(add(pulled, times(2.0, rotate(x, y, z, turning))), add(cross(s, moment), cross(t, force)))
        pushed = add(add(pushed, times(2.0, cross(turning, p))), cross(s, force))
        turned, slid = _times_inertia(room, i, _MASS, turning, sliding)
        d, e = add(d, turned), add(e, slid)
        j = i
        while j >= 0:
            a_j, b_j = get(room, j, JOINT), get(room, j, JOINT + 3)
            P, Q = get(room, j, TURNING), get(room, j, TURNING + 3)
            spinning, swaying = _changing(room, j, parents[j], tree.gravity)
            M[i, j] = M[j, i] = dot(g, a_j) + dot(h, b_j)
            by_place[j, i] = dot(pulled, a_j) + dot(pushed, b_j)
            by_place[i, j] = 2.0 * dot(c, P) + dot(g, spinning) + dot(h, swaying)
            by_speed[j, i] = 2.0 * (dot(d, a_j) + dot(e, b_j))
            by_speed[i, j] = 2.0 * (dot(c, a_j) + dot(g, P) + dot(h, Q))
            j = parents[j]
        if parents[i] >= 0:
            _accumulate(room, i, parents[i], _MASS, ROOM)
    for matrix in (M, by_place, by_speed):
        to_shafts(joints, matrix, room)
        to_shafts(joints, matrix.T, room)
