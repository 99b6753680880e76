"""Which of two laws is the likelier: Schwarz's criterion, and what is the same law with a part that does nothing.

The criterion is the whitened cost, relative to that of the best structure, plus the weight of the structure's parts,
with as many rows as there are informative frequencies. A difference of ten is as good as certain: exp(-5) to 1.
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
    """A structure beside the best.

    Attributes:
        fitted: with its numbers.
        worse: how much larger its criterion is.
        apart: by how much the torques differ that the two predict, in rms, as a share of the torque's rms.
    """

    fitted: FittedLaw
    worse: float
    apart: float


def score(one: NumberedStructure, rows: float) -> float:
    """Return a structure's cost with what its parts weigh."""
    return one.cost + one.structure.weight(rows)


def rank(task: Task, best: FittedLaw, others: list[FittedLaw]) -> list[Rival]:
    """Return structures, the likeliest first.

    Of two that predict the same torque to within `MATERIAL`, by the same filters, the one with fewer numbers is the
    likelier, whatever the criterion says: what is there by the statistics, as the error of an encoder that depends on
    the direction is, need not be of the law.
    """
    own, rivals = criterion(best, best), []
    for one in others:
        worse, distance = criterion(one, best) - own, torque_difference(task, one, best)
        more = one.structure.parts - best.structure.parts
        if distance < MATERIAL and more and _has_same_filters(one.structure, best.structure):
            if more > 0:
                continue  # the same law with a part that does nothing
            worse = -max(abs(worse), 1.0)
        rivals.append(Rival(one, worse, distance))
    return sorted(rivals, key=lambda rival: rival.worse)


def _has_same_filters(one: Structure, other: Structure) -> bool:
    """Return True if two structures have filters of the same kind; free taps are of every kind of difference."""
    differences = one.taps or other.taps
    return one.filters == other.filters or bool(differences and one.torque_filter == other.torque_filter)


def much_simpler(best: FittedLaw, rivals: Iterable[Rival]) -> FittedLaw | None:
    """Return the simplest law alike that has at most half the parts, None if there is none.

    Where an encoder's steps hide a filter, what is heard of them is not quite of the noise's spectrum: of hundreds of
    laws one with many parts explains a little of that, too.
    """
    alike = (one.fitted for one in rivals if one.worse < ALIKE)
    simple = (one for one in alike if 2 * one.structure.parts <= best.structure.parts)
    return min(simple, key=lambda one: one.structure.parts, default=None)


def drop_none(laws: Iterable[_Law | None]) -> list[_Law]:
    """Return the laws that could be fitted."""
    return [one for one in laws if one is not None]


def unique_structures(laws: Iterable[_Law], by: Callable[[_Law], float] = lambda _: 0.0) -> list[_Law]:
    """Return the best of each structure by something, the first of those that are as good."""
    best: dict[Structure, _Law] = {}
    for one in laws:
        if one.structure not in best or by(one) < by(best[one.structure]):
            best[one.structure] = one
    return list(best.values())


def torque_difference(task: Task, one: FittedLaw, other: FittedLaw) -> float:
    """Return the rms difference of two laws' predicted torques, as a share of the torque's rms."""
    change = task.residual(one.structure, one.numbers) - task.residual(other.structure, other.numbers)
    return float(np.sqrt(np.mean(change**2) / np.mean(task.log.torque**2)))


def criterion(one: FittedLaw, best: FittedLaw) -> float:
    """Return Schwarz's criterion of a structure, its cost in units of what the best one leaves."""
    rows = one.noise.rows
    return rows * one.cost / best.cost + one.structure.weight(rows)
