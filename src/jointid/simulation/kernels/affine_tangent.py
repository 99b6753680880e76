"""The derivatives of a joint's affine maps, and of a run that glides by them, compiled.

A column of derivatives moves by the map of its mode, and is pushed by what its parameter changes in that map.

All that the loop over the periods goes on from is one array, with rows of a constant length: only then the compiler
knows that nothing overlaps, and keeps to vector instructions.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from jointid.common.arrays import FloatArray
from jointid.common.compiled import compile_kernel, inline_kernel
from jointid.simulation.kernels.affine import INPUTS, MODES, Drive, drive_of, fill_rates, unit_move
from jointid.simulation.kernels.control import SmallLaw
from jointid.simulation.kernels.tables import LANES, IntArray

_STEP = 1e-30j  # its square is nothing beside any rate
WIDE = 4 * LANES  # derivatives of a state

# Rows of the scratch, LANES long: derivatives of motor position, motor velocity, load position and load velocity; what
# parameters change in the map of these; derivatives of two states of the law, and of the torque; then what parameters
# change in the law's output.
_S, _T, _Z, _D, _EXPLICIT, SCRATCH = (LANES * row for row in (0, 4, 8, 10, 11, 12))


@compile_kernel
def fill_tangent(
    p: Drive, masses: FloatArray, springs: FloatArray, mode: int, lengths: FloatArray, rates: FloatArray,
    bent: NDArray[Any], slopes: FloatArray, moves: FloatArray, moved: FloatArray,
) -> None:  # fmt: skip
    """Fill the maps of a mode, and their derivatives by a complex step.

    Columns are of parameters, by which masses and springs have derivatives, (LANES, masses or springs, numbers). Filled
    are `moves`, as by `kernels.affine.fill_mode`, and `moved`, (parts * MODES, INPUTS, 4, LANES); `bent` and `slopes`,
    (2, INPUTS), are scratch.
    """
    m1, m2 = mode // 3 - 1, mode % 3 - 1
    share1, share2 = abs(m1) / p.inertia1, abs(m2) / p.inertia2
    for c in range(LANES):
        change = drive_of(masses[c], springs[c])
        fill_rates(change, m1, m2, share1, share2, 0.0, slopes)
        for i in range(INPUTS):
            slope1 = slopes[0, i] - change.inertia1 * share1 * rates[mode, 0, i]
            slope2 = slopes[1, i] - change.inertia2 * share2 * rates[mode, 1, i]
            bent[0, i], bent[1, i] = rates[mode, 0, i] + _STEP * slope1, rates[mode, 1, i] + _STEP * slope2
        for part in range(lengths.size):
            for i in range(INPUTS):
                x, b = unit_move(bent, m1, m2, i, lengths[part]), part * MODES + mode
                for row in range(4):
                    moves[b, i, row], moved[b, i, row, c] = x[row].real, x[row].imag / _STEP.imag


@inline_kernel
def _read(s: FloatArray, dq: FloatArray, dv: FloatArray) -> None:
    """Read the derivatives of the state of one or two masses into the scratch."""
    two = dq.shape[0] > 1
    for c in range(LANES):
        s[_S + c], s[_S + LANES + c] = dq[0, c], dv[0, c]
        s[_S + 2 * LANES + c], s[_S + 3 * LANES + c] = dq[1, c] if two else dq[0, c], dv[1, c] if two else 0.0


@inline_kernel
def _write(s: FloatArray, dq: FloatArray, dv: FloatArray) -> None:
    """Write them back."""
    for i in range(dq.shape[0]):
        for c in range(LANES):
            dq[i, c], dv[i, c] = s[_S + 2 * i * LANES + c], s[_S + (2 * i + 1) * LANES + c]


@inline_kernel
def _push(s: FloatArray, moved: FloatArray, b: int, v1: float, stretch: float, v2: float, torque: float) -> None:
    """Write what the parameters change in the map of a part, for the motion there is."""
    m = np.uint64(b)  # Numba looks for negative indices among the signed
    for i in range(WIDE):
        change = (moved[m, 4 * WIDE + i] + moved[m, i] * v1) + moved[m, WIDE + i] * stretch
        s[_T + i] = (change + moved[m, 2 * WIDE + i] * v2) + moved[m, 3 * WIDE + i] * torque


@inline_kernel
def _step(s: FloatArray, m: FloatArray, moved: FloatArray, b: int, states: FloatArray, at: int, torque: float) -> None:
    """Move the derivatives over a part in which nothing happened."""
    _push(s, moved, b, states[at, 1], states[at, 2] - states[at, 0], states[at, 3], torque)
    p00, p01, p02, p03 = m[b, 0, 0], m[b, 0, 1], m[b, 0, 2], m[b, 0, 3]
    p10, p11, p12, p13 = m[b, 1, 0], m[b, 1, 1], m[b, 1, 2], m[b, 1, 3]
    p20, p21, p22, p23 = m[b, 2, 0], m[b, 2, 1], m[b, 2, 2], m[b, 2, 3]
    g0, g1, g2, g3 = m[b, 3, 0], m[b, 3, 1], m[b, 3, 2], m[b, 3, 3]
    for j in range(LANES):
        a0, a1, a2, a3 = s[_S + j], s[_S + LANES + j], s[_S + 2 * LANES + j], s[_S + 3 * LANES + j]
        a, d = a2 - a0, s[_D + j]
        s[_S + j] = ((((s[_T + j] + a0) + p00 * a1) + p20 * a3) + p10 * a) + g0 * d
        s[_S + LANES + j] = (((s[_T + LANES + j] + p01 * a1) + p21 * a3) + p11 * a) + g1 * d
        s[_S + 2 * LANES + j] = ((((s[_T + 2 * LANES + j] + a2) + p02 * a1) + p22 * a3) + p12 * a) + g2 * d
        s[_S + 3 * LANES + j] = (((s[_T + 3 * LANES + j] + p03 * a1) + p23 * a3) + p13 * a) + g3 * d


@inline_kernel
def cross_slopes(
    s: FloatArray, m: FloatArray, moved: FloatArray, b: int, states: FloatArray, at: int, torque: float,
    dtorque: FloatArray, dq: FloatArray, dv: FloatArray,
) -> None:  # fmt: skip
    """Move the derivatives over a part in which nothing happened, with those of the torque."""
    _read(s, dq, dv)
    for c in range(LANES):
        s[_D + c] = dtorque[c]
    _step(s, m, moved, b, states, at, torque)
    _write(s, dq, dv)


@inline_kernel
def glide_slopes(
    s: FloatArray, law: SmallLaw, m: FloatArray, moved: FloatArray, mode: int, k: int, end: int, lags: IntArray,
    before: float, states: FloatArray, modes: NDArray[np.int16], u: FloatArray, post: FloatArray, explicit: FloatArray,
    first: int, dq: FloatArray, dv: FloatArray, dz: FloatArray, du: FloatArray,
) -> int:  # fmt: skip
    """Do what `control_slopes` and `cross_slopes` do, at once, while the mode lasts and no limit cuts.

    Return the next period. Nearly all periods are of this kind. Every value is written once: a machine keeps it in
    vectors.
    """
    a00, a01, a10, a11, b0, b1, c0, c1, _, _, direct, limit = law
    p00, p01, p02, p03 = m[mode, 0, 0], m[mode, 0, 1], m[mode, 0, 2], m[mode, 0, 3]
    p10, p11, p12, p13 = m[mode, 1, 0], m[mode, 1, 1], m[mode, 1, 2], m[mode, 1, 3]
    p20, p21, p22, p23 = m[mode, 2, 0], m[mode, 2, 1], m[mode, 2, 2], m[mode, 2, 3]
    g0, g1, g2, g3 = m[mode, 3, 0], m[mode, 3, 1], m[mode, 3, 2], m[mode, 3, 3]
    parts, at_once, lasts = lags.size, lags.size == 1 and lags[0] == 0, True
    _read(s, dq, dv)
    for i in range(dz.shape[0]):
        for c in range(LANES):
            s[_Z + i * LANES + c] = dz[i, c]
    while k < end and abs(u[k]) < limit:
        for part in range(parts):
            lasts = lasts and modes[k * parts + part] == mode
        if not lasts:
            break
        at = np.uint64(k)  # Numba looks for negative indices among the signed
        for i in range(explicit.shape[2]):
            s[_EXPLICIT + first + i] = explicit[at, 0, i]
        if at_once:
            _push(s, moved, mode, states[at, 1], states[at, 2] - states[at, 0], states[at, 3], u[at] + post[at])
            for j in range(LANES):
                a0, a1, a2, a3 = s[_S + j], s[_S + LANES + j], s[_S + 2 * LANES + j], s[_S + 3 * LANES + j]
                z0, z1, a = s[_Z + j], s[_Z + LANES + j], a2 - a0
                d = (direct * a0 + s[_EXPLICIT + j]) + (c0 * z0 + c1 * z1)
                s[_S + j] = ((((s[_T + j] + a0) + p00 * a1) + p20 * a3) + p10 * a) + g0 * d
                s[_S + LANES + j] = (((s[_T + LANES + j] + p01 * a1) + p21 * a3) + p11 * a) + g1 * d
                s[_S + 2 * LANES + j] = ((((s[_T + 2 * LANES + j] + a2) + p02 * a1) + p22 * a3) + p12 * a) + g2 * d
                s[_S + 3 * LANES + j] = (((s[_T + 3 * LANES + j] + p03 * a1) + p23 * a3) + p13 * a) + g3 * d
                s[_Z + j] = b0 * a0 + (a00 * z0 + a01 * z1)
                s[_Z + LANES + j] = b1 * a0 + (a10 * z0 + a11 * z1)
                s[_D + j] = d
        for j in range(0 if at_once else LANES):
            a0, z0, z1 = s[_S + j], s[_Z + j], s[_Z + LANES + j]
            s[_D + j] = (direct * a0 + s[_EXPLICIT + j]) + (c0 * z0 + c1 * z1)
            s[_Z + j] = b0 * a0 + (a00 * z0 + a01 * z1)
            s[_Z + LANES + j] = b1 * a0 + (a10 * z0 + a11 * z1)
        for j in range(LANES):
            du[at, j] = s[_D + j]
        for part in range(0 if at_once else parts):
            source = k - lags[part]
            acts, torque = np.uint64(max(source, 0)), u[source] + post[source] if source >= 0 else before
            for j in range(LANES):
                s[_D + j] = du[acts, j]
            _step(s, m, moved, part * MODES + mode, states, k * parts + part, torque)
        k += 1
    _write(s, dq, dv)
    for i in range(dz.shape[0]):
        for c in range(LANES):
            dz[i, c] = s[_Z + i * LANES + c]
    return k
