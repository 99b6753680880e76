"""Columns of a robot's inverse dynamics, and its base parameters.

Of the ten inertial parameters of each link and its rotor's inertia many act on the torques only in sums. These sums,
the base parameters, are found from the columns in random motions: a column that is a sum of others before it adds its
parameter to theirs [Gautier 1991; Khalil and Dombre 2002, ch. 9.4]. Columns are divided by their lengths first, so
that the threshold for 0 depends neither on units nor on the size of a robot.

Parameters are named alike by every method. A number of a motor or a spring is named by its joint and what it is,
"elbow.viscous". A base parameter is named by the symbol of its first inertial parameter, "Izz1". The sum of a rotor and
its link about an axis that is none of the link's frame is "elbow.inertia".
"""

from __future__ import annotations

import numpy as np

from jointid.common.arrays import FloatArray, column_norms
from jointid.common.text import number
from jointid.models.robots.inertial import SYMBOLS
from jointid.models.robots.robot import Robot

_ZERO = 1e-8  # of a column: what is left of one that is a sum of others
INERTIAL_ORDER = (4, 5, 6, 8, 9, 7, 1, 2, 3, 0)
"""Inertial parameters of a link, those first that are kept: m, mz and Iyy are passed on to its parent."""

_SYMBOLS = {
    "inertia": "ZZ",
    "rotor_inertia": "Ia",
    "viscous": "Fv",
    "coulomb": "Fc",
    "stribeck_force": "FS",
    "friction_per_torque": "mu",
    "offset": "offset",
    "stiffness": "K",
    "damping": "D",
    "link_viscous": "FvL",
    "link_coulomb": "FcL",
    "link_stribeck_force": "FSL",
}
_WAYS = {"": "", "_forwards": "+", "_backwards": "-"}


def symbol_of(quantity: str, joint: int) -> str:
    """Symbol of a joint's number, as "Fc2", "Fv2+"; else its name."""
    word = quantity.removesuffix("_forwards").removesuffix("_backwards")
    return f"{_SYMBOLS.get(word, word)}{joint + 1}{_WAYS[quantity[len(word) :]]}"


def name_of(quantity: str, joint: str) -> str:
    """Name of a number of a joint, as "elbow.viscous"."""
    return f"{joint}.{quantity}"


def inverse_columns(robot: Robot, q: FloatArray, v: FloatArray, a: FloatArray) -> FloatArray:
    """Motor torque columns, (samples, n, 11 n): inertials by link, then rotors.

    Args:
        robot: its tree, gravity and coupling are read.
        q: (samples, n) positions of the joints, rad or m.
        v: (samples, n) their velocities.
        a: (samples, n) their accelerations.
    """
    from jointid.models.robots.dynamics import regressor_of

    links = regressor_of(robot.tree, *(np.ascontiguousarray(one) for one in (q, v, a)))
    coupling = robot.coupling
    rotors = (a @ coupling.T)[:, :, np.newaxis] * np.eye(len(robot))
    return np.concatenate([np.linalg.inv(coupling).T @ links, rotors], axis=2)


def standard_symbols(robot: Robot) -> tuple[str, ...]:
    """Symbols of the standard parameters, (11 n,), with joints counted from 1."""
    numbers = range(len(robot))
    links = (f"{symbol}{k + 1}" for k in numbers for symbol in SYMBOLS)
    return (*links, *(symbol_of("rotor_inertia", k) for k in numbers))


def name_sum(robot: Robot, weights: FloatArray, kept: int) -> tuple[str, str, int]:
    """Name and symbol of a sum, and the first standard parameter.

    A rotor that is part of a sum gives it no name.

    Args:
        robot: whose joints it names.
        weights: (11 n,) of the sum.
        kept: the standard parameter that stands for the sum.
    """
    n = len(robot)
    if kept >= 10 * n:
        joint = robot.joints[kept - 10 * n].name
        link = 10 * (kept - 10 * n) + np.array(INERTIAL_ORDER)
        own = link[np.abs(weights[link] - 1.0) < _ZERO]
        if not own.size:
            quantity = "rotor_inertia" if np.count_nonzero(weights) == 1 else "inertia"
            return name_of(quantity, joint), symbol_of(quantity, kept - 10 * n), kept
        kept = int(own[0])
    symbol = f"{SYMBOLS[kept % 10]}{kept // 10 + 1}"
    return symbol, symbol, kept


def group_columns(columns: FloatArray) -> tuple[list[int], FloatArray]:
    """Linearly independent columns, and sums, (kept, columns): ``columns = kept @ sums``.

    Args:
        columns: (rows, columns); a column of zeros is in no sum.
    """
    scales = column_norms(columns)
    unit, basis, kept = columns / scales, np.zeros((len(columns), 0)), list[int]()
    for i, column in enumerate(unit.T):
        left = column - basis @ (basis.T @ column)
        left -= basis @ (basis.T @ left)  # once more, for rounding
        size = float(np.linalg.norm(left))
        if size > _ZERO:
            basis = np.column_stack([basis, left / size])
            kept.append(i)
    # Scaled alike on both sides, so that what is rounding of a weight shows.
    sums = np.linalg.lstsq(unit[:, kept], unit, rcond=None)[0]
    sums[np.abs(sums) < _ZERO] = 0.0
    sums[:, kept] = np.eye(len(kept))
    return kept, sums * scales / scales[kept][:, np.newaxis]


def formula_of(weights: FloatArray, first: int, symbols: tuple[str, ...]) -> str:
    """Sum as text, beginning with its symbol: "Izz1 + m2 * 0.09".

    Args:
        weights: (symbols,) of the sum.
        first: place of the symbol that names it.
        symbols: of all parameters.
    """
    terms = [symbols[first]]
    for i in np.flatnonzero(weights):
        if i != first:
            factor = float(f"{abs(weights[i]):.9g}")  # rounding would decide on the last of four digits
            times = "" if abs(factor - 1.0) < _ZERO else f" * {number(factor, 4)}"
            terms.append(f"{'-' if weights[i] < 0 else '+'} {symbols[i]}{times}")
    return " ".join(terms)
