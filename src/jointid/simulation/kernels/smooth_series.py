"""The Taylor series of a drive's motion under smooth laws, compiled: what its simulation and its derivatives share.

A cubic or hysteretic spring, friction that winds up over a displacement, that grows with the torque through the spring
or changes with time, a force that follows the position: none has an affine map (`kernels.drive`). But between two
events each obeys a differential equation whose right-hand side is made of sums and products, so the coefficients of
the motion's Taylor series follow one from another (R. E. Moore, Interval Analysis, 1966; A. Griewank and A. Walther,
Evaluating Derivatives, 2nd ed. 2008, chapter 13).

What winds up over a displacement is a share w of a limit and a state of its own, by the law of P. R. Dahl (Solid
friction damping of mechanical vibrations, AIAA Journal 14, 1976), with the velocity v, its direction d and the length
s over which it winds up::

    w' = (v - d v w) / s

A force that follows the position has the cosine and the sine of its phase, which are each other's derivatives.

State ``y`` = position and velocity of the motor, of the load, and of the part of an elastic load that swings, which
follows the load with a spring and a damper of its own, without friction; then the shares that are wound up of the
friction of motor and load and of the spring's limit.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from jointid.common.arrays import FloatArray
from jointid.common.compiled import inline_kernel
from jointid.models.smooth import SmoothLaws
from jointid.simulation.kernels.drive import Drive

TERMS = 8  # the order of the series
STATES = 9
MOTOR, LOAD, SWINGING = 1, 3, 5  # velocities
WOUND1, WOUND2, WOUND = 6, 7, 8
# Rows of the series beside the states: square and cube of the deflection, the spring's torque, what pushes motor and
# load but their friction, and by how much their Coulomb friction is larger than its coefficient.
SQUARE, CUBE, TORQUE, PUSH1, PUSH2, MORE1, MORE2 = 9, 10, 11, 12, 13, 14, 15
ROWS = 16
INVERSE = np.array([0.0, *(1.0 / k for k in range(1, TERMS + 2))])


class Modes(NamedTuple):
    """Directions of motor, load, the spring's rate and its torque (0: at rest)."""

    motor: int
    load: int
    rate: int
    torque: int


class Known(NamedTuple):
    """Known zeros of the guards at a step's start: motor, load, spring rate, spring torque.

    How many leading coefficients of a velocity are 0 by construction, or the direction of the edge of its cone where a
    mass is at rest (`kernels.drive`); 1 where rate or torque have just gone through 0.
    """

    motor: int
    load: int
    rate: int
    torque: int


@inline_kernel
def _product(c: FloatArray, one: int, other: int, k: int) -> float:
    """Return the coefficient of order k of the product of two series."""
    total = 0.0
    for i in range(k + 1):
        total += c[one, i] * c[other, k - i]
    return total


@inline_kernel
def _square(c: FloatArray, k: int) -> float:
    """Return the coefficient of order k of the deflection's square."""
    total = 0.0
    for i in range(k + 1):
        total += (c[2, i] - c[0, i]) * (c[2, k - i] - c[0, k - i])
    return total


@inline_kernel
def _cube(c: FloatArray, k: int) -> float:
    """Return the coefficient of order k of the deflection's cube, from that of its square."""
    total = 0.0
    for i in range(k + 1):
        total += (c[2, i] - c[0, i]) * c[SQUARE, k - i]
    return total


@inline_kernel
def _winding(c: FloatArray, velocity: int, wound: int, direction: int, k: int) -> float:
    """Return the coefficient of order k of how fast what is wound up changes, times its length."""
    return float(c[velocity, k] - direction * _product(c, velocity, wound, k))


@inline_kernel
def _held_back(c: FloatArray, places: FloatArray, turns: FloatArray, side: int, k: int, h: float) -> float:
    """Return the coefficient of the force on a side that follows its position, and go on with its phases."""
    force = 0.0
    for j in range(places.shape[0]):
        if places[j, 4] == side:
            force += places[j, 0] * turns[j, 0, k] + places[j, 1] * turns[j, 1, k] + places[j, 2] * c[2 * side, k]
            if places[j, 3] != 0.0:
                cos, sin = 0.0, 0.0
                for i in range(k + 1):
                    cos -= c[2 * side + 1, i] * turns[j, 1, k - i]
                    sin += c[2 * side + 1, i] * turns[j, 0, k - i]
                rate = places[j, 3] * h * INVERSE[k + 1]
                turns[j, 0, k + 1], turns[j, 1, k + 1] = rate * cos, rate * sin
    return force


@inline_kernel
def fill_series(
    p: Drive, b: SmoothLaws, places: FloatArray, m: Modes, known: Known, y: FloatArray, time: float, torque: float,
    h: float, c: FloatArray, turns: FloatArray,
) -> None:  # fmt: skip
    """Write the Taylor series of the motion over a step of `h` into `c`, time counted in steps.

    A mass that has just come loose has, exactly, no velocity and no acceleration: rounding must not give it one, or
    the sign of the motion that follows would be noise.
    """
    for i in range(STATES):
        c[i, 0] = y[i]
    for j in range(places.shape[0]):
        phase = places[j, 3] * y[2 if places[j, 4] == 1.0 else 0]
        turns[j, 0, 0], turns[j, 1, 0] = math.cos(phase), math.sin(phase)
    viscous1 = (p.viscous1 if m.motor > 0 else p.viscous1_back) + b.motor.viscous_drift * time
    viscous2 = (p.viscous2 if m.load > 0 else p.viscous2_back) + b.load.viscous_drift * time
    coulomb1 = p.coulomb1 if m.motor > 0 else p.coulomb1_back
    coulomb2 = p.coulomb2 if m.load > 0 else p.coulomb2_back
    faster1, faster2, lossy = b.motor.viscous_drift * h, b.load.viscous_drift * h, b.load.per_torque * m.torque
    mobility1, mobility2 = h / p.inertia1, h / ((1.0 - b.spring.swing_share) * p.inertia2)
    swings = h / (b.spring.swing_share * p.inertia2) if b.spring.swing_share > 0.0 else 0.0
    before1, before2 = 0.0, 0.0  # coefficients of the velocities of one order less
    for k in range(TERMS + 1):
        v1, v2 = c[1, k], c[3, k]
        spring = p.stiffness * (c[2, k] - c[0, k]) + p.damping * (v2 - v1)
        if b.spring.cubic != 0.0:
            c[SQUARE, k] = _square(c, k)
            c[CUBE, k] = _cube(c, k)
            spring += b.spring.cubic * c[CUBE, k]
        if b.spring.slider > 0.0:
            spring += b.spring.slips * c[WOUND, k]
        pull = 0.0
        if b.spring.swing_share > 0.0:
            pull = b.spring.swing_stiffness * (c[4, k] - c[2, k]) + b.spring.swing_damping * (c[5, k] - v2)
        push1, push2, more1, more2, bound1, bound2 = spring, pull - spring, 0.0, lossy * spring, 0.0, 0.0
        if places.shape[0] > 0:
            push1 -= _held_back(c, places, turns, 0, k, h)
            push2 -= _held_back(c, places, turns, 1, k, h)
        if k == 0:
            push1 += torque - p.offset1
            push2 -= p.offset2
            more1 += b.motor.coulomb_drift * time
            more2 += b.load.coulomb_drift * time
            bound1, bound2 = coulomb1, coulomb2
        elif k == 1:
            more1 += b.motor.coulomb_drift * h
            more2 += b.load.coulomb_drift * h
        c[TORQUE, k], c[PUSH1, k], c[PUSH2, k], c[MORE1, k], c[MORE2, k] = spring, push1, push2, more1, more2
        if k == TERMS:
            break
        inverse = INVERSE[k + 1]
        c[0, k + 1], c[2, k + 1] = h * v1 * inverse, h * v2 * inverse
        if m.motor != 0:
            held = m.motor * (bound1 + more1)
            if b.motor.presliding > 0.0:
                held = coulomb1 * c[WOUND1, k] + _product(c, MORE1, WOUND1, k)
                c[WOUND1, k + 1] = h * inverse / b.motor.presliding * _winding(c, MOTOR, WOUND1, m.motor, k)
            drag = viscous1 * v1 + faster1 * before1 + held
            c[1, k + 1] = 0.0 if k == 0 and known.motor == 2 else mobility1 * inverse * (push1 - drag)
        else:
            c[1, k + 1], c[WOUND1, k + 1] = 0.0, 0.0
        if m.load != 0:
            held = m.load * (bound2 + more2)
            if b.load.presliding > 0.0:
                held = coulomb2 * c[WOUND2, k] + _product(c, MORE2, WOUND2, k)
                c[WOUND2, k + 1] = h * inverse / b.load.presliding * _winding(c, LOAD, WOUND2, m.load, k)
            drag = viscous2 * v2 + faster2 * before2 + held
            c[3, k + 1] = 0.0 if k == 0 and known.load == 2 else mobility2 * inverse * (push2 - drag)
        else:
            c[3, k + 1], c[WOUND2, k + 1] = 0.0, 0.0
        if b.spring.swing_share > 0.0:
            c[4, k + 1], c[5, k + 1] = h * c[5, k] * inverse, -swings * inverse * pull
        if b.spring.slider > 0.0:
            rate = 0.0
            for i in range(k + 1):
                rate += (c[3, i] - c[1, i]) * c[WOUND, k - i]
            c[WOUND, k + 1] = h * inverse * b.spring.slider / b.spring.slips * (v2 - v1 - m.rate * rate)
        before1, before2 = v1, v2
