"""The columns of a robot's inverse dynamics, and the base parameters: what its motion can tell of them at all.

Of the ten inertial parameters of each link and its rotor's inertia many act on the torques only in sums. These sums,
the base parameters, are found from the columns in random motions: a column that is a sum of others before it adds its
parameter to theirs [Gautier 1991; Khalil and Dombre 2002, ch. 9.4]. Columns are divided by their lengths first, so
that neither units nor the size of a robot decide what is 0.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from jointid.common.arrays import FloatArray, column_norms
from jointid.common.text import number
from jointid.models.robots.friction_terms import Friction, FrictionTerm, friction_values, offset_indices
from jointid.models.robots.inertial import SYMBOLS, UNITS
from jointid.models.robots.names import inertial_symbol, name_of, symbol_of
from jointid.models.robots.robot import Robot

_POSES = 60  # random ones, times the joints in rows
_ZERO = 1e-8  # of a column: what is left of one that is a sum of others
_NOTHING = 1e-11  # of the largest column in its unit: the rounding of one that is 0
INERTIAL_ORDER = (4, 5, 6, 8, 9, 7, 1, 2, 3, 0)
"""Inertial parameters of a link, those first that are kept: m, mz and Iyy are passed on to its parent."""


def inverse_columns(robot: Robot, q: FloatArray, v: FloatArray, a: FloatArray) -> FloatArray:
    """Return the columns of the motors' torques, (samples, n, 11 n): the inertials link by link, then the rotors.

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
    """Return the symbols of the standard parameters, (11 n,), with the joints' numbers from 1."""
    numbers = range(len(robot))
    links = (inertial_symbol(symbol, k) for k in numbers for symbol in SYMBOLS)
    return (*links, *(symbol_of("rotor_inertia", k) for k in numbers))


def standard_values(robot: Robot) -> FloatArray:
    """Return the standard parameters of a robot, (11 n,)."""
    return np.concatenate([robot.inertials.ravel(), robot.of_joints("rotor_inertia")])


@dataclass(frozen=True, slots=True, eq=False)
class BaseParameters:
    """The base parameters of a robot: sums of its standard parameters.

    Attributes:
        names: (base,) of the sums: the symbol of an inertial parameter, or "elbow.rotor_inertia" of a rotor alone.
        symbols: (base,) of the parameter that names each sum.
        formulas: (base,) the sums, as text. offset_formulas: (n,) likewise of the offsets of the motors' friction.
        units: (base,).
        chosen: (base,) which standard parameters come first; their columns are those of the base parameters.
        grouping: (base, 11 n) takes the standard parameters to the base parameters.
        offsets: (n, 11 n) takes them to what they add to the motors' offsets.
    """

    names: tuple[str, ...]
    symbols: tuple[str, ...]
    formulas: tuple[str, ...]
    offset_formulas: tuple[str, ...]
    units: tuple[str, ...]
    chosen: NDArray[np.intp]
    grouping: FloatArray
    offsets: FloatArray

    def __len__(self) -> int:
        return len(self.symbols)

    def of(self, robot: Robot) -> FloatArray:
        """Return the base parameters, (base,), of a robot of this tree."""
        return np.asarray(self.grouping @ standard_values(robot))

    def with_friction(self, robot: Robot) -> FloatArray:
        """Return the base parameters of a robot of this tree, then the numbers of the motors' friction.

        See `friction_terms.friction_terms`; of the links' side there are none.
        """
        friction = friction_values(robot)
        friction[offset_indices(robot)] += self.offsets @ standard_values(robot)
        return np.concatenate([self.of(robot), friction])


def base_parameters(robot: Robot) -> BaseParameters:
    """Return the base parameters of links and rotors; only tree, gravity and coupling are read."""
    n = len(robot)
    random = np.random.default_rng(0)
    q, v, a = random.uniform(-np.pi, np.pi, (_POSES, n)), *random.normal(0.0, 3.0, (2, _POSES, n))
    columns = inverse_columns(robot, q, v, a).reshape(_POSES * n, -1)
    norms = np.linalg.norm(columns, axis=0)
    dimensions = np.array([*n * ([0] + 3 * [1] + 6 * [2]), *n * [3]])  # columns of one number are in one unit
    largest = np.array([norms[dimensions == kind].max() for kind in range(4)])
    columns[:, norms <= _NOTHING * largest[dimensions]] = 0.0
    # Rotors first, as in a simulation: what a slide lifts is then its mass, and the rotor no part of other sums.
    order = np.array([*range(10 * n, 11 * n), *(10 * k + i for k in range(n) for i in INERTIAL_ORDER)])
    kept, sums = group_columns(np.column_stack([np.tile(np.eye(n), (_POSES, 1)), columns[:, order]]))
    first = order[np.array(kept[n:]) - n]
    grouping, offsets = np.zeros((first.size, 11 * n)), np.zeros((n, 11 * n))
    grouping[:, order], offsets[:, order] = sums[n:, n:], sums[:n, n:]
    rotors = tuple("kg" if link.kind == "prismatic" else "kg m2" for link in robot.links)
    symbols, units = standard_symbols(robot), (*n * UNITS, *rotors)
    of_offsets = tuple(FrictionTerm(k, Friction.OFFSET).symbol for k in range(n))
    names, own, begins = zip(
        *(name_sum(robot, row, int(i)) for row, i in zip(grouping, first, strict=True)), strict=True
    )
    return BaseParameters(
        names,
        own,
        tuple(formula_of(row, i, symbols) for row, i in zip(grouping, begins, strict=True)),
        tuple(formula_of(row, k, (*of_offsets, *symbols)) for k, row in enumerate(np.hstack([np.eye(n), offsets]))),
        tuple(units[i] for i in first),
        first,
        grouping,
        offsets,
    )


def name_sum(robot: Robot, weights: FloatArray, kept: int) -> tuple[str, str, int]:
    """Return name and symbol of a sum, and the standard parameter that its formula begins with.

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
    symbol = inertial_symbol(SYMBOLS[kept % 10], kept // 10)
    return symbol, symbol, kept


def group_columns(columns: FloatArray) -> tuple[list[int], FloatArray]:
    """Return which columns are no sum of those before them, and the sums, (kept, columns): columns = kept @ sums.

    Args:
        columns: (rows, columns); of one that is 0 there is nothing in any sum.
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
    """Return a sum as text, which begins with its first symbol: "Izz1 + m2 * 0.09 + Ia1".

    Args:
        weights: (symbols,) of the sum.
        first: place of the symbol that names it.
        symbols: all there are.
    """
    terms = [symbols[first]]
    for i in np.flatnonzero(weights):
        if i != first:
            factor = float(f"{abs(weights[i]):.9g}")  # rounding would decide on the last of four digits
            times = "" if abs(factor - 1.0) < _ZERO else f" * {number(factor, 4)}"
            terms.append(f"{'-' if weights[i] < 0 else '+'} {symbols[i]}{times}")
    return " ".join(terms)
