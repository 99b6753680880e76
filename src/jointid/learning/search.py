"""The search for the law's structure: from one that may hold too much, in single changes, down its criterion.

The criterion is Schwarz's: the whitened cost, in units of what the best structure leaves, and log(samples) for each
number. Of two structures, ten less is as good as certain: exp(-5) to 1.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass, replace

import numpy as np

from jointid.common.progress import Progress, silent
from jointid.learning.changes import combinations, neighbours, without
from jointid.learning.fitting import Fitted, Task, fit
from jointid.learning.noise import Noise, everything
from jointid.learning.regression import cascade_start
from jointid.learning.structures import (
    ACCELERATION,
    CONSTANT,
    COULOMB,
    INTEGRAL,
    LATE,
    VELOCITY,
    Structure,
    starts,
)

_SEEDS = 4  # structures that a search may begin at
_STRETCH = 4000  # samples that a search looks at
_JUDGED = 10  # rivals that the whole record judges
MATERIAL = 1e-3  # of the torque's rms: a part that carries less is none
REMOVABLE = (
    "ki", "velocity_feedforward", "acceleration_feedforward", "viscous_feedforward", "coulomb_feedforward",
    "constant_feedforward", "reference_delay", "torque_filters.0.time_constant",
)  # fmt: skip
_RICH = frozenset({VELOCITY, ACCELERATION, COULOMB, CONSTANT})
_EXPLAINS = 0.8  # of the cost without: a limit that leaves more was a torque that only lingered
_SEEDING = 5  # steps of Gauss and Newton of what a search may begin at
_SCREENING = 2  # steps of Gauss and Newton after which a candidate is judged, and perhaps left
_PROMISING = 12  # candidates that are fitted to the end in a round


@dataclass(frozen=True, slots=True, eq=False)
class Rival:
    """A structure beside the best.

    Attributes:
        fitted: with its numbers.
        worse: how much larger its criterion is.
        apart: by how much the torques differ that the two predict, in rms, as a share of the torque's rms.
    """

    fitted: Fitted
    worse: float
    apart: float


@dataclass(frozen=True, slots=True, eq=False)
class Found:
    """What a search ended with.

    Attributes:
        best: the structure of the least criterion.
        rivals: its neighbours, the likeliest first.
    """

    best: Fitted
    rivals: tuple[Rival, ...]


def search(task: Task, progress: Progress = silent) -> Found:
    """Return the structure of the least criterion, and its rivals: found on a stretch, and judged on the whole."""
    stretch = task.stretch(_STRETCH)
    best, seen = _settled(stretch, _seed(stretch)), set[Structure]()
    while True:
        progress(f"{best.structure.words}: {len(best.structure.names)} numbers")
        seen.add(best.structure)
        rivals = _ranked(stretch, best, _around(stretch, best, neighbours(best.structure, _channel(task))))
        if not rivals or rivals[0].worse >= 0.0:
            as_plain = (s for s in combinations(best.structure) if s.parts <= best.structure.parts)
            others = _around(stretch, best, as_plain)
            rivals = _ranked(stretch, best, [*others, *(rival.fitted for rival in rivals)])
        if not rivals or rivals[0].worse >= 0.0:
            break
        better = _settled(stretch, rivals[0].fitted)
        if better.structure in seen:  # its own noise speaks for either: the whole record decides
            break
        best = better
    return _on_the_whole(task, best, [rival.fitted for rival in rivals[:_JUDGED]])


def _on_the_whole(task: Task, best: Fitted, others: list[Fitted]) -> Found:
    """Return what the whole record says of structures that a stretch of it left."""
    seen = set[Structure]()
    while True:
        best = _settled(task, best)
        seen.add(best.structure)
        fitted = [fit(task, one.structure, one.numbers | _content(one, best), best.noise, 4) for one in others]
        rivals = _ranked(task, best, [one for one in fitted if one is not None])
        if not rivals or rivals[0].worse >= 0.0 or rivals[0].fitted.structure in seen:
            return Found(best, tuple(rivals))
        others = [best, *(rival.fitted for rival in rivals[1:])]
        best = rivals[0].fitted


def _content(one: Fitted, best: Fitted) -> dict[str, float]:
    """Return the integral's content at the record's first sample, where a structure has one and it is known."""
    return {INTEGRAL: best.numbers.get(INTEGRAL, 0.0)} if one.structure.integrates else {}


def _settled(task: Task, best: Fitted) -> Fitted:
    """Return a structure fitted under its own noise."""
    for _ in range(2):
        noise = task.noise(best.structure, best.numbers)
        best = _pruned(task, fit(task, best.structure, best.numbers, noise) or best)
    return best


def _channel(task: Task) -> bool:
    return task.watched.record.reference_velocity is not None


def _around(task: Task, best: Fitted, structures: Iterable[Structure]) -> list[Fitted]:
    """Return the most promising structures, fitted under one noise."""
    others = (s for s in structures if s != best.structure)
    screened = [_tried(task, s, best, best.noise, _SCREENING) for s in others]
    promising = sorted((one for one in screened if one is not None), key=lambda one: criterion(one, best))
    return [fit(task, one.structure, one.numbers, best.noise) or one for one in promising[:_PROMISING]]


def _ranked(task: Task, best: Fitted, others: list[Fitted]) -> list[Rival]:
    """Return structures, the likeliest first.

    Of two that predict the same torque to within `MATERIAL` the one with fewer numbers is the likelier, whatever the
    criterion says: what is there by the statistics, as the error of an encoder that depends on the direction is, need
    not be of the law.
    """
    own, rivals = criterion(best, best), []
    for one in others:
        worse, distance = criterion(one, best) - own, apart(task, one, best)
        more = one.structure.parts - best.structure.parts
        if distance < MATERIAL and more > 0 and one.structure.velocity_filter == best.structure.velocity_filter:
            continue  # the same law with a part that does nothing
        if distance < MATERIAL and more:
            worse = math.copysign(max(abs(worse), 1.0), more)
        rivals.append(Rival(one, worse, distance))
    return sorted(rivals, key=lambda rival: rival.worse)


def _pruned(task: Task, best: Fitted) -> Fitted:
    """Return a structure without the parts that carry next to nothing when the others may make up for them."""
    for name in best.structure.names:
        if name not in REMOVABLE or name not in best.structure.names:
            continue
        fewer = without(best.structure, name)
        start = starts(fewer, best.numbers, task.watched.period, 0.0)[0]
        fitted = fit(task, fewer, start, best.noise, _SCREENING)
        if fitted is not None and apart(task, fitted, best) < MATERIAL:
            best = fitted
    return best


def apart(task: Task, one: Fitted, other: Fitted) -> float:
    """Return by how much two laws differ in the torque they predict, in rms, as a share of the torque's rms."""
    change = task.residual(one.structure, one.numbers) - task.residual(other.structure, other.numbers)
    return float(np.sqrt(np.mean(change**2) / np.mean(task.watched.torque**2)))


def criterion(one: Fitted, best: Fitted) -> float:
    """Return Schwarz's criterion of a structure, its cost in units of what the best one leaves."""
    rows = one.noise.rows
    return rows * one.cost / best.cost + len(one.structure.names) * math.log(rows)


def _tried(task: Task, structure: Structure, near: Fitted, noise: Noise, steps: int) -> Fitted | None:
    """Return a structure fitted from the numbers of a similar one, and from a regression where it is another law."""
    watched, period = task.watched, task.watched.period / structure.rate
    tried = []
    for start in starts(structure, near.numbers, period, (watched.plateau or math.inf) / task.gain):
        tried.append(fit(task, structure, start, noise, steps))
        if structure.law == "P-PI" and near.structure.law != "P-PI":
            made = task.controller(structure, start | {"kp": 1.0, "kv": 1.0})
            filtered = getattr(made, "velocity_filter", (1.0,))
            gains = cascade_start(watched, filtered, structure.late, task.gain)
            begun = start | {name: value for name, value in gains.items() if name in structure.names}
            tried.append(fit(task, structure, begun, noise, steps))
    return min((one for one in tried if one is not None), key=lambda one: one.cost, default=None)


def _seed(task: Task) -> Fitted:
    """Return the best of some structures that hold all that is linear in its numbers."""
    best = _first(task)
    limited = best.structure.limited
    # How late the log is comes first: filters and delays of other kinds would be bent to make up for it.
    noise = task.noise(best.structure, best.numbers)
    like = replace(best.structure, law="PID", velocity_filter="first order", feedforward=_RICH - {CONSTANT})
    tried = _all_tried(task, [replace(like, late=n) for n in (0, *LATE)], best, noise)
    best, chosen = tried[0], [s for one in tried[:2] for s in _rich(limited, one.structure.late)]
    for keep in (_SEEDS, 1):
        noise = task.noise(best.structure, best.numbers)
        tried = _all_tried(task, chosen, best, noise)
        best, chosen = tried[0], [one.structure for one in tried[:keep]]
    return best


def _all_tried(task: Task, structures: Iterable[Structure], near: Fitted, noise: Noise) -> list[Fitted]:
    """Return structures fitted under one noise, that of the least cost first."""
    tried = (_tried(task, structure, near, noise, _SEEDING) for structure in structures)
    return sorted((one for one in tried if one is not None), key=lambda one: one.cost)


def _first(task: Task) -> Fitted:
    """Return a law that is linear in its numbers, within the log's plateau where that explains more than without."""
    torque, plateau = task.watched.torque, task.watched.plateau
    noise = everything(float(np.var(torque)), torque.size)
    structure = Structure("PD", "none", "mean 2", _RICH)
    best = fit(task, structure, dict.fromkeys(structure.names, 0.0), noise)
    assert best is not None  # nothing of it depends on the record but the columns of a linear regression
    if plateau is None:
        return best
    limited = fit(task, replace(structure, limited=True), best.numbers | {"limit": plateau / task.gain}, noise)
    return limited if limited is not None and limited.cost < _EXPLAINS * best.cost else best


def _rich(limited: bool, late: int) -> Iterable[Structure]:
    parts = frozenset({ACCELERATION, COULOMB})
    for filtered in ("none", "mean 2", "first order", "second order"):
        like = Structure(velocity_filter=filtered, limited=limited, late=late)
        yield replace(like, law="P-P", reference_velocity="share", feedforward=parts | {CONSTANT})
        yield replace(like, law="P-PI", reference_velocity="share", feedforward=parts)
        yield replace(like, law="PID", reference_velocity="none", feedforward=parts | {VELOCITY})
        if filtered != "none":
            yield replace(like, law="PD", reference_velocity="difference", feedforward=parts | {CONSTANT})
            yield replace(like, law="PID", reference_velocity="difference", feedforward=parts)
