"""Ranking of laws by Schwarz's criterion, and equivalence of laws.

The criterion is the whitened cost relative to the best structure, plus the penalty of the structure's parts, with one
row per informative frequency. A difference of ten means odds of exp(-5) to 1.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import TypeVar

import numpy as np

from jointid.controller_id.fitting import FittedLaw, Task
from jointid.controller_id.structures import NumberedStructure, Structure

_Law = TypeVar("_Law", bound=NumberedStructure)

ALIKE = 10.0  # of the criterion: a smaller difference does not distinguish two laws
MATERIAL = 1e-3  # of the torque's rms: a part that carries less is none


@dataclass(frozen=True, slots=True, eq=False)
class Rival:
    """A structure compared with the best.

    Attributes:
        worse: how much larger its criterion is.
        apart: by how much the torques differ that the two predict, in rms, as a share of the torque's rms.
    """

    fitted: FittedLaw
    worse: float
    apart: float


def score(one: NumberedStructure, rows: float) -> float:
    """Cost of a structure plus penalty."""
    return one.cost + one.structure.weight(rows)


def rank(task: Task, best: FittedLaw, others: list[FittedLaw]) -> list[Rival]:
    """Rank structures by likelihood.

    Of two with equal filters (free taps equal any difference) and torques equal within `MATERIAL`, the one with fewer
    numbers ranks first, since direction-dependent encoder errors can be significant.
    """
    own, rivals = criterion(best, best), []
    for one in others:
        worse, distance = criterion(one, best) - own, torque_difference(task, one, best)
        more = one.structure.parts - best.structure.parts
        first, second = one.structure, best.structure
        same_velocity = first.velocity_filter == second.velocity_filter or first.taps or second.taps
        if distance < MATERIAL and more and same_velocity and first.torque_filter == second.torque_filter:
            if more > 0:
                continue  # the same law with a part that does nothing
            worse = -max(abs(worse), 1.0)
        rivals.append(Rival(one, worse, distance))
    return sorted(rivals, key=lambda rival: rival.worse)


def much_simpler(best: FittedLaw, rivals: Iterable[Rival]) -> FittedLaw | None:
    """Simplest equivalent law with at most half the parts, if any.

    Hidden by quantisation, a filter's noise spectrum is inexact, which a complex law can fit.
    """
    alike = (one.fitted for one in rivals if one.worse < ALIKE)
    simple = (one for one in alike if 2 * one.structure.parts <= best.structure.parts)
    return min(simple, key=lambda one: one.structure.parts, default=None)


def drop_failures(laws: Iterable[_Law | None]) -> list[_Law]:
    """Keep the laws that could be fitted."""
    return [one for one in laws if one is not None]


def unique_structures(laws: Iterable[_Law], by: Callable[[_Law], float] = lambda _: 0.0) -> list[_Law]:
    """Best law of each structure by a key."""
    best: dict[Structure, _Law] = {}
    for one in laws:
        if one.structure not in best or by(one) < by(best[one.structure]):
            best[one.structure] = one
    return list(best.values())


def torque_difference(task: Task, one: FittedLaw, other: FittedLaw) -> float:
    """Rms difference of two laws' torques, relative to the torque's rms."""
    change = task.residual(one.structure, one.numbers) - task.residual(other.structure, other.numbers)
    return float(np.sqrt(np.mean(change**2) / np.mean(task.log.torque**2)))


def criterion(one: FittedLaw, best: FittedLaw) -> float:
    """Schwarz's criterion, with the best law's residual as unit."""
    rows = one.noise.rows
    return rows * one.cost / best.cost + one.structure.weight(rows)
