"""Structure search: from the best regression with free gains, by single changes, minimising Schwarz's criterion.

Clocks and filters are screened before a law is chosen, each by its regression with free gains.

The criterion is the whitened cost, relative to that of the best structure, plus the weight of the structure's parts,
with as many rows as there are informative frequencies. A difference of ten is as good as certain: exp(-5) to 1.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TypeVar

import numpy as np

from jointid.common.errors import MethodError
from jointid.common.progress import Progress, silent
from jointid.controller_id.fitting import FittedLaw, Task, fit
from jointid.controller_id.noise import Noise
from jointid.controller_id.regression import (
    CompressedFrame,
    Regression,
    RegressionFit,
    Weighting,
    initial_weighting,
    law_numbers,
    regression,
)
from jointid.controller_id.structure_moves import list_laws, list_neighbours, list_simpler, remove_part
from jointid.controller_id.structures import (
    COMMON,
    INTEGRAL_GAINS,
    LATE,
    RATES,
    SIGNED,
    SLOWER,
    TORQUE_FILTERS,
    VELOCITY_FILTERS,
    NumberedStructure,
    Structure,
    bounds,
    convert_numbers,
    starts,
)

_Law = TypeVar("_Law", bound=NumberedStructure)

_SEGMENT = 4000  # samples that a search looks at
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
_FINEST = 8  # frames whose filters' numbers are searched for
_DELAYS = 2  # of the log's, with which laws are tried


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


@dataclass(frozen=True, slots=True, eq=False)
class _SearchData:
    """The data that a structure search fits to.

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
        return (self.task.log.plateau or math.inf) / self.task.gain

    def fit_gains(
        self, structure: Structure, numbers: Mapping[str, float], weighting: Weighting
    ) -> RegressionFit | None:
        """Return the regression of a structure on the torque; None if its filters or its delay are impossible."""
        try:
            return self.regression.fit_gains(structure, numbers, weighting, free=False)[0]
        except MethodError:
            return None

    def best_start(
        self, structure: Structure, known: Mapping[str, float], weighting: Weighting
    ) -> RegressionFit | None:
        """Return the best of a structure's starts: from known numbers, else on a grid."""
        begun = starts(structure, known, self.task.log.period)
        found = _found(self.fit_gains(structure, numbers, weighting) for numbers in begun)
        return min(found, key=lambda one: one.cost, default=None)

    def refit(self, one: FittedLaw, weighting: Weighting) -> FittedLaw | None:
        """Return a law fitted again from its own numbers."""
        tried = self.best_start(replace(one.structure, limited=False), one.numbers, weighting)
        return None if tried is None else self.refine(tried, weighting)

    def refine(self, one: RegressionFit, weighting: Weighting) -> FittedLaw | None:
        """Return a structure with the numbers of least cost; None where they make no law."""
        try:
            return self.to_law(self.regression.refine(one, weighting, free=False), weighting.noise)
        except MethodError:
            return None

    def to_law(self, one: RegressionFit, noise: Noise) -> FittedLaw | None:
        """Return a regression as a law, fitted exactly where a limit acts; None if a number is impossible."""
        numbers = law_numbers(one, self.task.gain)
        if _is_invalid(numbers):
            return None
        if not self.limited:
            return FittedLaw(one.structure, numbers, one.cost, noise)
        return fit(self.task, replace(one.structure, limited=True), numbers | {"limit": self.limit}, noise)

    def weighting(self, best: FittedLaw) -> Weighting:
        """Return the weighting under which rivals of a law are compared."""
        return Weighting(best.noise, self.task.response(best.structure, best.numbers))


def search(task: Task, progress: Progress = silent) -> tuple[FittedLaw, tuple[Rival, ...]]:
    """Return the structure of the least criterion, and the rivals that came near, the likeliest first.

    They are found on a stretch, and judged on the whole record.
    """
    channel = task.log.record.reference_velocity is not None
    data, likeliest, best = _start_search(task.segment(_SEGMENT), channel, progress)
    best, seen = _refit_under_own_noise(data.task, best), set[Structure]()
    while True:
        progress(f"{best.structure}: {len(best.structure.names)} numbers")
        seen.add(best.structure)
        best = data.refit(best, data.weighting(best)) or best
        rivals = _rank(data.task, best, _fit_nearby(data, best, list_neighbours(best.structure, channel)))
        if not rivals or rivals[0].worse >= 0.0:
            others = _refit(data, likeliest, data.weighting(best))
            rivals = _rank(data.task, best, [*others, *(rival.fitted for rival in rivals)])
        if not rivals or rivals[0].worse >= 0.0:
            break
        better = _refit_under_own_noise(data.task, rivals[0].fitted)
        if better.structure in seen:  # its own noise speaks for either: the whole record decides
            break
        best = better
    progress(f"{best.structure}, and {len(rivals[:_JUDGED])} others on the whole record")
    whole = replace(data, task=task, regression=replace(regression(task.log), own=True))
    return _judge_on_whole_record(whole, best, _unique_structures(rival.fitted for rival in rivals)[:_JUDGED])


def _start_search(task: Task, channel: bool, progress: Progress) -> tuple[_SearchData, list[RegressionFit], FittedLaw]:
    """Return the data of a search, the likeliest laws of the screening, and the best of them."""
    data = _SearchData(task, replace(regression(task.log), own=True))
    weighting, late = screen_frames(data.regression, progress)
    begun = rank_candidates(data.regression, weighting, late, channel, progress)[: _SIEVE[0][0]]
    likeliest = _found(data.fit_gains(one.structure, one.numbers, weighting) for one in begun)
    for keep, evaluations in _SIEVE:
        refined = (data.regression.refine(one, weighting, False, evaluations) for one in likeliest[:keep])
        trimmed = (_trim(data, one, weighting) for one in refined)
        rows = weighting.noise.rows
        likeliest = _unique_structures(sorted(trimmed, key=lambda one: _score(one, rows)))
        weighting = data.regression.weighting(likeliest[0])
    fitted = (data.to_law(one, weighting.noise) for one in likeliest)
    best = next((one for one in fitted if one is not None), None)
    if best is None:
        raise MethodError(
            "No law that is searched for gives this record's torque: all that come near have a negative gain, or "
            "a filter that is hardly damped. Check "
            "units, signs and sides of torque, reference and motor_position, or declare the law."
        )
    data, best = _add_limit(data, best)
    return data, likeliest, best


def _refit(data: _SearchData, likeliest: Iterable[RegressionFit], weighting: Weighting) -> list[FittedLaw]:
    """Return laws fitted again under another noise, each with the parts that pay."""
    fresh = _found(data.fit_gains(one.structure, one.numbers, weighting) for one in likeliest)
    return _found(data.refine(_trim(data, one, weighting), weighting) for one in fresh)


def _score(one: NumberedStructure, rows: float) -> float:
    """Return a structure's cost with what its parts weigh."""
    return one.cost + one.structure.weight(rows)


def _trim(data: _SearchData, one: RegressionFit, weighting: Weighting) -> RegressionFit:
    """Return a law without the parts that do not pay, and without numbers that cannot be."""
    rows = weighting.noise.rows
    while True:
        known = law_numbers(one, data.task.gain)
        tried = (data.best_start(fewer, known, weighting) for fewer in list_simpler(one.structure))
        best = min(_found(tried), key=lambda fewer: _score(fewer, rows), default=None)
        if best is None or (_score(best, rows) > _score(one, rows) and not _is_invalid(known)):
            return one
        one = best


def _is_invalid(numbers: Mapping[str, float]) -> bool:
    """True if a gain is negative, or a filter's damping is at its lower bound."""
    undamped = any(name.endswith("damping") and value < _DAMPED for name, value in numbers.items())
    return undamped or any(value < 0 for name, value in numbers.items() if name not in SIGNED)


def _add_limit(data: _SearchData, best: FittedLaw) -> tuple[_SearchData, FittedLaw]:
    """Return a law with the limit that the log shows, where that explains more than without."""
    task = data.task
    if task.log.plateau is None:
        return data, best
    plain = fit(task, best.structure, best.numbers, best.noise)
    numbers = best.numbers | {"limit": data.limit}
    limited = fit(task, replace(best.structure, limited=True), numbers, best.noise)
    if limited is None or (plain is not None and limited.cost > _EXPLAINS * plain.cost):
        return data, plain or best
    return replace(data, limited=True), limited


def _judge_on_whole_record(
    data: _SearchData, best: FittedLaw, others: list[FittedLaw]
) -> tuple[FittedLaw, tuple[Rival, ...]]:
    """Rank, on the whole record, the structures that the search on a segment has left."""
    errors: dict[Structure, float] = {}
    decided = False
    # What an integral holds at the first sample is another number here, and no noise is known before it.
    best = data.refit(best, initial_weighting(data.regression)) or best
    while True:
        best = _refit_under_own_noise(data.task, best)
        errors[best.structure] = best.noise.torque
        weighting = data.weighting(best)
        own = data.refit(best, weighting) or best
        simpler = list_simpler(replace(own.structure, limited=False))
        fewer = _found(data.best_start(one, own.numbers, weighting) for one in simpler)
        known = _found(
            [*(data.refit(one, weighting) for one in others), *(data.refine(one, weighting) for one in fewer)]
        )
        rivals = _rank(data.task, own, _unique_structures(known))
        if not rivals or rivals[0].worse >= 0.0 or decided:
            break
        better = rivals[0].fitted
        if better.structure in errors:  # two noises speak each for another law: the torque's own error is the smaller
            if errors[better.structure] >= errors[best.structure]:
                break
            decided = True
        others, best = [best, *(rival.fitted for rival in rivals[1:])], better
    return best, tuple(rival for rival in rivals if rival.fitted.structure != best.structure)


def _found(laws: Iterable[_Law | None]) -> list[_Law]:
    """Return those that are possible."""
    return [one for one in laws if one is not None]


def _unique_structures(laws: Iterable[_Law]) -> list[_Law]:
    """Return the first of each structure."""
    first: dict[Structure, _Law] = {}
    for one in laws:
        first.setdefault(one.structure, one)
    return list(first.values())


def _refit_under_own_noise(task: Task, best: FittedLaw) -> FittedLaw:
    """Return a structure fitted under its own noise."""
    for _ in range(2):
        noise = task.noise(best.structure, best.numbers)
        best = _prune(task, fit(task, best.structure, best.numbers, noise) or best)
    return best


def _fit_nearby(data: _SearchData, best: FittedLaw, structures: Iterable[Structure]) -> list[FittedLaw]:
    """Return the most promising structures, fitted under one noise."""
    weighting = data.weighting(best)
    own, rows, task = data.regression, best.noise.rows, data.task
    unlimited = (replace(s, limited=False) for s in structures)
    begun = _found(start_law(own, one, starts(one, best.numbers, task.log.period), weighting) for one in unlimited)
    promising = sorted(begun, key=lambda one: _score(one, rows))[:_PROMISING]
    explained = _found(data.fit_gains(one.structure, one.numbers, weighting) for one in promising)
    return _found(data.refine(one, weighting) for one in explained)


def _rank(task: Task, best: FittedLaw, others: list[FittedLaw]) -> list[Rival]:
    """Return structures, the likeliest first.

    Of two that predict the same torque to within `MATERIAL`, by the same filters, the one with fewer numbers is the
    likelier, whatever the criterion says: what is there by the statistics, as the error of an encoder that depends on
    the direction is, need not be of the law.
    """
    own, rivals = criterion(best, best), []
    for one in others:
        worse, distance = criterion(one, best) - own, torque_difference(task, one, best)
        more = one.structure.parts - best.structure.parts
        if distance < MATERIAL and more and one.structure.filters == best.structure.filters:
            if more > 0:
                continue  # the same law with a part that does nothing
            worse = -max(abs(worse), 1.0)
        rivals.append(Rival(one, worse, distance))
    return sorted(rivals, key=lambda rival: rival.worse)


def _prune(task: Task, best: FittedLaw) -> FittedLaw:
    """Return a structure without the parts that carry next to nothing when the others may make up for them."""
    for name in best.structure.names:
        if name not in REMOVABLE or name not in best.structure.names:
            continue
        fewer = remove_part(best.structure, name)
        fitted = fit(task, fewer, convert_numbers(fewer, best.numbers), best.noise, _SCREENING)
        if fitted is not None and torque_difference(task, fitted, best) < MATERIAL:
            best = fitted
    return best


def torque_difference(task: Task, one: FittedLaw, other: FittedLaw) -> float:
    """Return the rms difference of two laws' predicted torques, as a share of the torque's rms."""
    change = task.residual(one.structure, one.numbers) - task.residual(other.structure, other.numbers)
    return float(np.sqrt(np.mean(change**2) / np.mean(task.log.torque**2)))


def criterion(one: FittedLaw, best: FittedLaw) -> float:
    """Return Schwarz's criterion of a structure, its cost in units of what the best one leaves."""
    rows = one.noise.rows
    return rows * one.cost / best.cost + one.structure.weight(rows)


def screen_frames(regression: Regression, progress: Progress = silent) -> tuple[Weighting, list[int]]:
    """Return the weighting under which laws are compared, and the log's likeliest delays.

    What is quiet beside the noise shows only once something explains the rest: the noise is that of the frame that
    explains most whatever the gains, and all are judged again under it. At first by one spectrum, as the law's own
    would reward a far-off law for reacting to the position; at last by each its own, as one for all would reward a
    filter that keeps the noise away.
    """
    weighting = initial_weighting(regression)
    progress("screening clocks and filters, with free gains")
    best = sorted(_best_of_each(_fit_all_frames(regression, weighting)), key=lambda one: one.cost)[:_FINEST]
    for own in (False, False, True):
        weighting = regression.weighting(best[0])
        finer = replace(regression, own=own)
        best = sorted((finer.refine(one, weighting) for one in best), key=lambda one: one.cost)
    late = list(dict.fromkeys(one.structure.late for one in best))
    return regression.weighting(best[0]), late[:_DELAYS]


def rank_candidates(
    regression: Regression, weighting: Weighting, late: Sequence[int], channel: bool, progress: Progress = silent
) -> list[NumberedStructure]:
    """Return all laws in all frames, each where it begins best, the likeliest first."""
    progress("screening all laws with all clocks and filters")
    rows = weighting.noise.rows
    begun = _begin_all_laws(regression, weighting, late, channel)
    return sorted(_best_of_each(begun), key=lambda one: _score(one, rows))


def _begin_all_laws(
    regression: Regression, weighting: Weighting, late: Sequence[int], channel: bool
) -> Iterator[NumberedStructure]:
    period = regression.log.period
    for frame in _frames(Structure()):
        plain = frame.rate == frame.every == 1
        for delayed in (False, True) if plain and frame.torque_filter == "none" else (False,):
            laws = [law for law in list_laws(frame, channel) if law.reference_delay == delayed]
            for numbers in starts(replace(frame, reference_delay=delayed), {}, period):
                try:
                    compressed = regression.compress(frame, numbers, weighting, late if plain else [0])
                except MethodError:  # a filter that cannot be at this rate
                    continue
                for law in laws:
                    yield from _start_laws(compressed, law, period)


def start_law(
    regression: Regression, law: Structure, begun: Iterable[Mapping[str, float]], weighting: Weighting
) -> NumberedStructure | None:
    """Return the best starting point of a law, of some numbers; None if it is impossible."""
    found = []
    for numbers in begun:
        ki = numbers.get("ki") if law.cascade else None
        others = {name: value for name, value in numbers.items() if name != "ki"}
        try:
            compressed = regression.compress(law, others, weighting, [law.late])
        except MethodError:  # a filter or a delay that cannot be
            continue
        found.append(NumberedStructure(law, dict(numbers), float(compressed.costs(law, ki)[0])))
    return min(found, key=lambda one: one.cost, default=None)


def _start_laws(compressed: CompressedFrame, law: Structure, period: float) -> Iterator[NumberedStructure]:
    gains = INTEGRAL_GAINS if law.cascade and law.integrates else (None,)
    for share in gains:
        ki = None if share is None else share / period
        numbers = compressed.numbers if ki is None else compressed.numbers | {"ki": ki}
        for late, cost in zip(compressed.late, compressed.costs(law, ki), strict=True):
            yield NumberedStructure(replace(law, late=late), numbers, float(cost))


def _fit_all_frames(regression: Regression, weighting: Weighting) -> Iterator[RegressionFit]:
    for frame in _frames(Structure()):
        late = (0, *LATE) if frame.rate == frame.every == 1 else (0,)
        for numbers in starts(frame, {}, regression.log.period):
            try:
                yield from regression.fit_gains(frame, numbers, weighting, late)
            except MethodError:  # a filter that cannot be at this rate
                continue


def _frames(plain: Structure) -> Iterator[Structure]:
    """Yield clocks with the common filters, and the log's own clock with all pairs of filters."""
    for filtered in VELOCITY_FILTERS:
        like = replace(plain, velocity_filter=filtered)
        yield like
        if filtered in COMMON:
            yield from (replace(like, torque_filter=one) for one in TORQUE_FILTERS[1:])
            yield from (replace(like, rate=n, curved=curved) for n in RATES for curved in (False, True))
            yield from (replace(like, every=n, offset=k) for n in SLOWER for k in range(n))


def _best_of_each(laws: Iterable[_Law]) -> Iterable[_Law]:
    """Return the one of least cost of each structure."""
    best: dict[Structure, _Law] = {}
    for one in laws:
        if one.structure not in best or one.cost < best[one.structure].cost:
            best[one.structure] = one
    return best.values()
