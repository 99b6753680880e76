"""The laws of friction, springs and forces of a position, compiled: of each its force and the partials of that.

A law is a row of numbers (`kernels`), in which its force is linear but for a winding length and a wave. The
simulation takes the forces, its derivatives the partials. What winds up over a displacement is a state w of its own, by
one of `models.friction.WINDS`. Its steps are exponential: exact where the rate is linear in w, as in the law of P. R.
Dahl (Solid friction damping of mechanical vibrations, AIAA Journal 14, 1976), and elsewhere of order 3.
"""

from __future__ import annotations

import math
from typing import Any

from numpy.typing import NDArray

from jointid.common.arrays import FloatArray
from jointid.common.compiled import assign, inline_kernel
from jointid.models.friction import LAW, WINDS
from jointid.simulation import kernels


@inline_kernel
def take_piece(springs: FloatArray, s: int, piece: int, spring: FloatArray) -> None:
    """Take the numbers of a spring in a piece of its deflection, negative of a negative one."""
    assign(spring[s], springs[s, abs(piece)])
    spring[s, kernels.HELD] *= -1.0 if piece < 0 else 1.0


def _either(number: int, law: Any, other: Any) -> Any:
    return inline_kernel(lambda row, i, *of: law(row, i, *of) if row[i, LAW].real == number else other(row, i, *of))


wind_up, *_more = map(inline_kernel, WINDS)
for _number, _law in enumerate(_more, 1):
    wind_up = _either(_number, _law, wind_up)


@inline_kernel
def wind(numbers: NDArray[Any], i: int, way: float, v: Any, h: float, w: Any) -> Any:
    """Advance what is wound up, w, by h seconds of a mean velocity v; numbers may be complex, but for h."""
    rate, by_state = wind_up(numbers, i, way, v, w)
    grows, end = h * by_state, w + h * rate
    if rate * by_state != 0.0 and grows.real < 1.0:  # the exponential of a complex step is its tangent
        if abs(grows.real) < 0.5:  # the series of (exp(x) - 1) / x, within 3e-11
            x, y = grows, grows * grows
            higher = (1 / 120 + x / 720) + y * ((1 / 5040 + x / 40320) + y * (1 / 362880 + x / 3628800))
            end = (w + h * rate * ((1.0 + x / 2) + y * (1 / 6 + x / 24))) + (h * rate * (y * y)) * higher
        else:
            more = math.expm1(grows.real)
            end = w + (rate / by_state) * (more + (1.0 + more) * (grows - grows.real))
    then, bent = wind_up(numbers, i, way, v, end)
    return end + h * (then - rate - by_state * (end - w)) / (3.0 - 0.75 * grows) if bent != by_state else end


@inline_kernel
def spring_torque(spring: FloatArray, s: int, e: float, de: float, w: float) -> float:
    """Return the torque of a spring at a deflection, its rate, and what is wound up."""
    held = (spring[s, kernels.STIFFNESS] + spring[s, kernels.CUBIC] * (e * e)) * e + (
        spring[s, kernels.HELD] + spring[s, kernels.SLIPS] * w
    )
    return float(held + spring[s, kernels.DAMPING] * de)  # the rate comes last, as it is known last


@inline_kernel
def spring_partials(spring: FloatArray, s: int, e: float, de: float, w: float, k: FloatArray, row: int) -> float:
    """Write the partials of a spring's torque by its numbers into a row of `k`; return that by the deflection."""
    k[row, kernels.STIFFNESS], k[row, kernels.DAMPING] = e, de
    k[row, kernels.CUBIC], k[row, kernels.SLIPS] = e * e * e, w
    return float(spring[s, kernels.STIFFNESS] + 3.0 * spring[s, kernels.CUBIC] * e * e)


@inline_kernel
def friction(mass: FloatArray, i: int, back: int, carried: float, time: float) -> tuple[float, float]:
    """Return the Coulomb force and the viscous coefficient of a mass that carries a torque; `back` is 1 backwards."""
    grip = mass[i, kernels.COULOMB + back] + mass[i, kernels.COULOMB_DRIFT] * time
    if mass[i, kernels.PER_TORQUE] != 0.0:  # a branch: what is carried is known last
        grip += mass[i, kernels.PER_TORQUE] * abs(carried)
    return grip, mass[i, kernels.VISCOUS + back] + mass[i, kernels.VISCOUS_DRIFT] * time


@inline_kernel
def friction_partials(
    mass: FloatArray, i: int, back: int, share: float, v: float, carried: float, time: float, k: FloatArray, row: int
) -> float:
    """Write the partials of friction's force on a mass by its numbers into a row of `k`; return that by the torque.

    The share of the Coulomb force that acts is 1 or -1, or what is wound up.
    """
    k[row, kernels.OFFSET], k[row, kernels.VISCOUS + back], k[row, kernels.VISCOUS_DRIFT] = -1.0, -v, -v * time
    k[row, kernels.COULOMB + back], k[row, kernels.COULOMB_DRIFT] = -share, -share * time
    k[row, kernels.PER_TORQUE] = -share * abs(carried)
    return float(-share * mass[i, kernels.PER_TORQUE] * math.copysign(1.0, carried))


@inline_kernel
def turn_place(places: FloatArray, j: int, q: float, turned: FloatArray) -> None:
    """Write the start of a step, and a position force's wave and slope there."""
    cos, sin = math.cos(places[j, kernels.WAVE] * q), math.sin(places[j, kernels.WAVE] * q)
    turned[j, 0], turned[j, 1] = q, places[j, kernels.COS] * cos + places[j, kernels.SIN] * sin
    turned[j, 2] = places[j, kernels.SIN] * cos - places[j, kernels.COS] * sin


@inline_kernel
def place_force(places: FloatArray, turned: FloatArray, j: int, q: float) -> float:
    """Return a force that follows a position, by series: a step turns by less than a radian."""
    x = places[j, kernels.WAVE] * (q - turned[j, 0])
    square = x * x
    cos = 1.0 + square * (-1 / 2 + square * (1 / 24 + square * (-1 / 720 + square * (1 / 40320))))
    sin = x * (1.0 + square * (-1 / 6 + square * (1 / 120 + square * (-1 / 5040 + square * (1 / 362880)))))
    return float(turned[j, 1] * cos + turned[j, 2] * sin + places[j, kernels.RATE] * q)


@inline_kernel
def place_partials(places: FloatArray, j: int, q: float, k: FloatArray, row: int) -> float:
    """Write the partials of the opposite of such a force by its numbers into a row of `k`; return that by the place."""
    wave = places[j, kernels.WAVE]
    cos, sin = math.cos(wave * q), math.sin(wave * q)
    k[row, kernels.COS], k[row, kernels.SIN], k[row, kernels.RATE] = -cos, -sin, -q
    return float(wave * (places[j, kernels.COS] * sin - places[j, kernels.SIN] * cos) - places[j, kernels.RATE])
