"""The motors' equations of a robot at a known motion: how each depends on every number, as columns."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from jointid.common.arrays import FloatArray
from jointid.common.parallel import threads
from jointid.models.robots.dynamics import IntArray
from jointid.models.robots.inertial import SYMBOLS
from jointid.models.robots.robot import Tree
from jointid.simulation.closed_loop import in_threads
from jointid.simulation.robot_numbers import NumberOf, NumberPlace, RobotNumbers, stribeck_share
from jointid.simulation.robots import MassMotion


def columns_of(
    tree: Tree, numbers: RobotNumbers, places: tuple[NumberPlace, ...], motion: MassMotion, rows: IntArray
) -> list[tuple[IntArray, FloatArray]]:
    """Return, for each of some masses, the derivatives of its equation by the parameters that act in it.

    At a known motion, so these are the regressor's columns; their product with the parameters is the motor's torque,
    and 0 for the link of a flexible joint. Each is the places of the parameters, (own,), and their columns,
    (samples, own), which stand one after the other.

    Args:
        tree: of `RobotInput`.
        numbers: of which only the rotors are read, and the speeds below which friction rises.
        places: of the parameters.
        motion: of all masses.
        rows: of the masses.
    """
    from jointid.models.robots.equations import regressor_columns

    samples, n = len(motion.position), numbers.rotors.size
    carried = _carried(tree.parents) if tree.joints.size == 0 else np.ones((n, n), dtype=np.bool_)
    felt = [np.array([c for c, p in enumerate(places) if _acts(p, int(row), numbers, carried)], int) for row in rows]
    ends = np.cumsum([own.size for own in felt])
    lines, of_links = np.empty((int(ends[-1]), samples)), []
    position, velocity, acceleration = motion.position, motion.velocity, motion.acceleration
    for row, own, end in zip(rows, felt, ends, strict=True):
        for line, place in zip(range(int(end) - own.size, int(end)), (places[c] for c in own), strict=True):
            if place.of is NumberOf.LINK:
                of_links.append((row, len(SYMBOLS) * place.row + place.column, line))
            elif place.of is NumberOf.MASS:
                lines[line] = _of_mass(motion, int(row), place.column, numbers)
            else:
                moved, motor = (velocity if place.column else position), numbers.rotors[place.row]
                stretch = moved[:, motor] - moved[:, place.row]
                lines[line] = stretch if row == motor else -stretch
    if of_links:
        q, v, a = (np.ascontiguousarray(values[:, :n]) for values in (position, velocity, acceleration))
        whose, which, where = np.array(of_links, dtype=np.int64).T.copy()
        spans = np.array_split(np.arange(samples), threads())

        def fill(span: NDArray[np.intp]) -> None:
            inside = slice(span[0], span[-1] + 1)
            regressor_columns(tree, q[inside], v[inside], a[inside], whose, which, where, span[0], lines)

        in_threads(fill, [span for span in spans if span.size])
    return [(own, lines[end - own.size : end].T) for own, end in zip(felt, ends, strict=True)]


def _carried(parents: IntArray) -> NDArray[np.bool_]:
    """Return which link carries which, itself included, (n, n)."""
    found = np.eye(parents.size, dtype=np.bool_)
    for i, parent in enumerate(parents):
        if parent >= 0:
            found[:, i] |= found[:, parent]
    return found


def _acts(place: NumberPlace, row: int, numbers: RobotNumbers, carried: NDArray[np.bool_]) -> bool:
    """True of a parameter that is in the equation of a mass."""
    if place.of is NumberOf.LINK:
        return row < len(carried) and bool(carried[row, place.row])
    return row == place.row or (place.of is NumberOf.SPRING and row == numbers.rotors[place.row])


def _of_mass(motion: MassMotion, row: int, column: int, numbers: RobotNumbers) -> FloatArray | float:
    """Return what a number of a mass is multiplied with in its equation, (samples,)."""
    velocity = motion.velocity[:, row]
    if column in (0, 2):
        return motion.acceleration[:, row] if column == 0 else motion.direction[:, row]
    if column == 3:
        return 1.0
    if column == 6:
        return motion.direction[:, row] * stribeck_share(numbers.masses[row], velocity)
    if column == 1:
        return velocity
    if column not in (4, 5):
        raise NotImplementedError(f"the equations are not linear in number {column} of a mass")
    return np.asarray(np.maximum(velocity, 0.0) if column == 4 else np.minimum(velocity, 0.0))
