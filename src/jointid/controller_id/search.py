"""The search for the law's structure: from what explains most whatever the gains, in single changes, down a criterion.

The criterion is Schwarz's: the whitened cost, in units of what the best structure leaves, and what the structure
weighs, rows being the independent numbers that are heard. Ten less is as good as certain: exp(-5) to 1.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from typing import TypeVar

import numpy as np

from jointid.common.errors import MethodError
from jointid.common.progress import Progress, silent
from jointid.controller_id.fitting import Fitted, Task, fit
from jointid.controller_id.noise import Noise
from jointid.controller_id.regression import Explained, Regression, Standing, gains_of, regression
from jointid.controller_id.screening import Candidate, begin, candidates, survey, unheard
from jointid.controller_id.structure_moves import neighbours, simpler, without
from jointid.controller_id.structures import SIGNED, Structure, bounds, converted, starts

_Law = TypeVar("_Law", Explained, Fitted)

_STRETCH = 4000  # samples that a search looks at
_JUDGED = 20  # rivals that the whole record judges
MATERIAL = 1e-3  # of the torque's rms: a part that carries less is none
REMOVABLE = (
    "ki", "velocity_feedforward", "acceleration_feedforward", "viscous_feedforward", "coulomb_feedforward",
    "constant_feedforward", "reference_delay", "torque_filters.0.time_constant",
)  # fmt: skip
_EXPLAINS = 0.8  # of the cost without: a limit that leaves more was a torque that only lingered
_SIEVE = ((80, 3), (24, 6), (12, 6))  # laws of the survey that are fitted, each time under a better noise, and how well
_DAMPED = 1.01 * bounds("velocity_filter.damping", 1.0, 1)[0]  # what is below has run to the bound
_SCREENING = 2  # steps of Gauss and Newton after which a candidate is judged, and perhaps left
_PROMISING = 20  # candidates that are fitted to the end in a round


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
        rivals: others that came near, the likeliest first.
    """

    best: Fitted
    rivals: tuple[Rival, ...]


@dataclass(frozen=True, slots=True, eq=False)
class _Ground:
    """What a search fits to.

    Attributes:
        task: the record's stretch.
        regression: on it.
        limited: whether the limit acts in it.
    """

    task: Task
    regression: Regression
    limited: bool = False

    @property
    def limit(self) -> float:
        """The limit that the log shows, in controller units."""
        return (self.task.watched.plateau or math.inf) / self.task.gain

    def explained(self, structure: Structure, numbers: Mapping[str, float], standing: Standing) -> Explained | None:
        """Return what a structure explains; None where its filters or its delay cannot be."""
        try:
            return self.regression.explained(structure, numbers, standing, free=False)[0]
        except MethodError:
            return None

    def tried(self, structure: Structure, known: Mapping[str, float], standing: Standing) -> Explained | None:
        """Return the best of a structure's starts: from known numbers, else on a grid."""
        begun = starts(structure, known, self.task.watched.period)
        found = (self.explained(structure, numbers, standing) for numbers in begun)
        return min((one for one in found if one is not None), key=lambda one: one.cost, default=None)

    def known(self, one: Fitted, standing: Standing) -> Fitted | None:
        """Return a law fitted again from its own numbers."""
        tried = self.tried(replace(one.structure, limited=False), one.numbers, standing)
        return None if tried is None else self.refined(tried, standing)

    def refined(self, one: Explained, standing: Standing) -> Fitted | None:
        """Return a structure with the numbers of least cost; None where they make no law."""
        try:
            return self.fitted(self.regression.refined(one, standing, free=False), standing.noise)
        except MethodError:
            return None

    def fitted(self, one: Explained, noise: Noise) -> Fitted | None:
        """Return what was explained as a law, exactly where a limit acts; None where a number cannot be."""
        numbers = gains_of(one, self.task.gain)
        if _impossible(numbers):
            return None
        if not self.limited:
            return Fitted(one.structure, numbers, one.cost, noise)
        return fit(self.task, replace(one.structure, limited=True), numbers | {"limit": self.limit}, noise)

    def standing(self, best: Fitted) -> Standing:
        """Return what rivals of a law are judged under."""
        return Standing(best.noise, self.task.response(best.structure, best.numbers))


def search(task: Task, progress: Progress = silent) -> Found:
    """Return the structure of the least criterion, and its rivals: found on a stretch, and judged on the whole."""
    ground, likeliest, best = _begun(task.stretch(_STRETCH), _channel(task), progress)
    best, seen = _settled(ground.task, best), set[Structure]()
    while True:
        progress(f"{best.structure.words}: {len(best.structure.names)} numbers")
        seen.add(best.structure)
        best = ground.known(best, ground.standing(best)) or best
        rivals = _ranked(ground.task, best, _around(ground, best, neighbours(best.structure, _channel(task))))
        if not rivals or rivals[0].worse >= 0.0:
            others = _refitted(ground, likeliest, ground.standing(best))
            rivals = _ranked(ground.task, best, [*others, *(rival.fitted for rival in rivals)])
        if not rivals or rivals[0].worse >= 0.0:
            break
        better = _settled(ground.task, rivals[0].fitted)
        if better.structure in seen:  # its own noise speaks for either: the whole record decides
            break
        best = better
    progress(f"{best.structure.words}, and {len(rivals[:_JUDGED])} others on the whole record")
    whole = replace(ground, task=task, regression=replace(regression(task.watched), own=True))
    return _on_the_whole(whole, best, _distinct(rival.fitted for rival in rivals)[:_JUDGED])


def _begun(task: Task, channel: bool, progress: Progress) -> tuple[_Ground, list[Explained], Fitted]:
    """Return what a search is made on, the likeliest laws of a survey, and the best of them."""
    ground = _Ground(task, replace(regression(task.watched), own=True))
    standing, late = survey(ground.regression, progress)
    begun = candidates(ground.regression, standing, late, channel, progress)[: _SIEVE[0][0]]
    likeliest = [one for one in (ground.explained(one.structure, one.numbers, standing) for one in begun) if one]
    for keep, evaluations in _SIEVE:
        refined = (ground.regression.refined(one, standing, False, evaluations) for one in likeliest[:keep])
        trimmed = (_trimmed(ground, one, standing) for one in refined)
        rows = standing.noise.rows
        likeliest = _distinct(sorted(trimmed, key=lambda one: _weighed(one, rows)))
        standing = ground.regression.standing(likeliest[0])
    fitted = (ground.fitted(one, standing.noise) for one in likeliest)
    best = next((one for one in fitted if one is not None), None)
    if best is None:
        raise MethodError(
            "No law that is searched for gives this record's torque: all that come near have a negative gain, or "
            "a filter that is hardly damped. Check "
            "units, signs and sides of torque, reference and motor_position, or declare the law."
        )
    ground, best = _within(ground, best)
    return ground, likeliest, best


def _refitted(ground: _Ground, likeliest: Iterable[Explained], standing: Standing) -> list[Fitted]:
    """Return laws fitted again under another noise, each with the parts that pay."""
    fresh = (ground.explained(one.structure, one.numbers, standing) for one in likeliest)
    refined = (ground.refined(_trimmed(ground, one, standing), standing) for one in fresh if one is not None)
    return [one for one in refined if one is not None]


def _weighed(one: Candidate | Explained | Fitted, rows: float) -> float:
    """Return a structure's cost with what its parts weigh."""
    return one.cost + one.structure.weight(rows)


def _trimmed(ground: _Ground, one: Explained, standing: Standing) -> Explained:
    """Return a law without the parts that do not pay, and without numbers that cannot be."""
    rows = standing.noise.rows
    while True:
        known = gains_of(one, ground.task.gain)
        tried = (ground.tried(fewer, known, standing) for fewer in simpler(one.structure))
        best = min((fewer for fewer in tried if fewer), key=lambda fewer: _weighed(fewer, rows), default=None)
        if best is None or (_weighed(best, rows) > _weighed(one, rows) and not _impossible(known)):
            return one
        one = best


def _impossible(numbers: Mapping[str, float]) -> bool:
    """Return whether a gain is negative, or a filter's damping has run to where none is set."""
    undamped = any(name.endswith("damping") and value < _DAMPED for name, value in numbers.items())
    return undamped or any(value < 0 for name, value in numbers.items() if name not in SIGNED)


def _within(ground: _Ground, best: Fitted) -> tuple[_Ground, Fitted]:
    """Return a law with the limit that the log shows, where that explains more than without."""
    task = ground.task
    if task.watched.plateau is None:
        return ground, best
    plain = fit(task, best.structure, best.numbers, best.noise)
    numbers = best.numbers | {"limit": ground.limit}
    limited = fit(task, replace(best.structure, limited=True), numbers, best.noise)
    if limited is None or (plain is not None and limited.cost > _EXPLAINS * plain.cost):
        return ground, plain or best
    return replace(ground, limited=True), limited


def _on_the_whole(ground: _Ground, best: Fitted, others: list[Fitted]) -> Found:
    """Return what the whole record says of structures that a stretch of it left."""
    errors: dict[Structure, float] = {}
    decided = False
    # What an integral holds at the first sample is another number here, and no noise is known before it.
    best = ground.known(best, unheard(ground.regression)) or best
    while True:
        best = _settled(ground.task, best)
        errors[best.structure] = best.noise.torque
        standing = ground.standing(best)
        own = ground.known(best, standing) or best
        known = [ground.known(one, standing) for one in others]
        fewer = [ground.tried(one, own.numbers, standing) for one in simpler(replace(own.structure, limited=False))]
        known += [ground.refined(one, standing) for one in fewer if one is not None]
        rivals = _ranked(ground.task, own, _distinct([one for one in known if one is not None]))
        if not rivals or rivals[0].worse >= 0.0 or decided:
            break
        better = rivals[0].fitted
        if better.structure in errors:  # two noises speak each for another law: the torque's own error is the smaller
            if errors[better.structure] >= errors[best.structure]:
                break
            decided = True
        others, best = [best, *(rival.fitted for rival in rivals[1:])], better
    return Found(best, tuple(rival for rival in rivals if rival.fitted.structure != best.structure))


def _distinct(laws: Iterable[_Law]) -> list[_Law]:
    """Return the first of each structure."""
    first: dict[Structure, _Law] = {}
    for one in laws:
        first.setdefault(one.structure, one)
    return list(first.values())


def _settled(task: Task, best: Fitted) -> Fitted:
    """Return a structure fitted under its own noise."""
    for _ in range(2):
        noise = task.noise(best.structure, best.numbers)
        best = _pruned(task, fit(task, best.structure, best.numbers, noise) or best)
    return best


def _channel(task: Task) -> bool:
    return task.watched.record.reference_velocity is not None


def _around(ground: _Ground, best: Fitted, structures: Iterable[Structure]) -> list[Fitted]:
    """Return the most promising structures, fitted under one noise."""
    standing = ground.standing(best)
    own, rows, task = ground.regression, best.noise.rows, ground.task
    unlimited = (replace(s, limited=False) for s in structures)
    begun = (begin(own, one, starts(one, best.numbers, task.watched.period), standing) for one in unlimited)
    promising = sorted((one for one in begun if one is not None), key=lambda one: _weighed(one, rows))[:_PROMISING]
    explained = (ground.explained(one.structure, one.numbers, standing) for one in promising)
    fitted = (ground.refined(one, standing) for one in explained if one is not None)
    return [one for one in fitted if one is not None]


def _ranked(task: Task, best: Fitted, others: list[Fitted]) -> list[Rival]:
    """Return structures, the likeliest first.

    Of two that predict the same torque to within `MATERIAL`, by the same filters, the one with fewer numbers is the
    likelier, whatever the criterion says: what is there by the statistics, as the error of an encoder that depends on
    the direction is, need not be of the law.
    """
    own, rivals = criterion(best, best), []
    for one in others:
        worse, distance = criterion(one, best) - own, apart(task, one, best)
        more = one.structure.parts - best.structure.parts
        if distance < MATERIAL and more and _filters(one) == _filters(best):
            if more > 0:
                continue  # the same law with a part that does nothing
            worse = -max(abs(worse), 1.0)
        rivals.append(Rival(one, worse, distance))
    return sorted(rivals, key=lambda rival: rival.worse)


def _filters(one: Fitted) -> tuple[str, str]:
    return one.structure.velocity_filter, one.structure.torque_filter


def _pruned(task: Task, best: Fitted) -> Fitted:
    """Return a structure without the parts that carry next to nothing when the others may make up for them."""
    for name in best.structure.names:
        if name not in REMOVABLE or name not in best.structure.names:
            continue
        fewer = without(best.structure, name)
        fitted = fit(task, fewer, converted(fewer, best.numbers), best.noise, _SCREENING)
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
    return rows * one.cost / best.cost + one.structure.weight(rows)
