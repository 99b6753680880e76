"""Structure search by single changes from the screened laws, by Schwarz's criterion."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from functools import partial

from jointid.common.errors import MethodError
from jointid.common.messages import Detail, Progress, follow, ignore_progress
from jointid.controller_id.fitting import FittedLaw, Task, fit
from jointid.controller_id.noise import Noise
from jointid.controller_id.ranking import (
    MATERIAL,
    Rival,
    drop_failures,
    much_simpler,
    rank,
    rank_candidates,
    score,
    screen_frames,
    start_law,
    torque_difference,
    unique_structures,
)
from jointid.controller_id.regression import (
    Regression,
    RegressionFit,
    Weighting,
    initial_weighting,
    law_numbers,
    regression,
)
from jointid.controller_id.structure_moves import list_neighbours, list_simpler, remove_part
from jointid.controller_id.structures import (
    Structure,
    bounds,
    convert_numbers,
    may_be_negative,
    starts,
)

_NEARBY, _JUDGING = "trying what is near the best", "judging on the whole record"

_SEGMENT = 4000  # samples that a search looks at
_JUDGED = 20  # rivals that the whole record judges
_REMOVABLE = (
    "integral_gain", "velocity_feedforward", "acceleration_feedforward", "viscous_feedforward", "coulomb_feedforward",
    "constant_feedforward", "reference_delay", "torque_filters.0.time_constant",
)  # fmt: skip
_EXPLAINS = 0.8  # of the cost without: a limit that leaves more was a torque that only lingered
_SIEVE = ((80, 3), (24, 6), (12, 6))  # laws of the survey that are fitted, each time under a better noise, and how well
_DAMPED = 1.01 * bounds("velocity_filter.damping", 1.0, 1)[0]  # what is below has run to the bound
_SCREENING = 2  # steps of Gauss and Newton after which a candidate is judged, and perhaps left
_PROMISING = 20  # candidates that are fitted to the end in a round


@dataclass(frozen=True, slots=True, eq=False)
class _SearchData:
    """Data of a structure search.

    Attributes:
        task: the record's stretch.
        limited: whether the limit acts in it.
    """

    task: Task
    regression: Regression
    limited: bool = False

    @property
    def limit(self) -> float:
        """Observed limit in controller units."""
        return (self.task.log.plateau or math.inf) / self.task.gain

    def fit_gains(
        self, structure: Structure, numbers: Mapping[str, float], weighting: Weighting
    ) -> RegressionFit | None:
        """Regress a structure; None if filters or delay are impossible."""
        try:
            return self.regression.fit_gains(structure, numbers, weighting, free=False)[0]
        except MethodError:
            return None

    def best_start(
        self, structure: Structure, known: Mapping[str, float], weighting: Weighting
    ) -> RegressionFit | None:
        """Best start of a structure: from known numbers, else on a grid."""
        candidates = starts(structure, known, self.task.log.period)
        found = drop_failures(self.fit_gains(structure, numbers, weighting) for numbers in candidates)
        return min(found, key=lambda one: one.cost, default=None)

    def refit(self, one: FittedLaw, weighting: Weighting) -> FittedLaw | None:
        """Return a law fitted again from its own numbers."""
        tried = self.best_start(replace(one.structure, limited=False), one.numbers, weighting)
        return None if tried is None else self.refine(tried, weighting)

    def refine(self, one: RegressionFit, weighting: Weighting) -> FittedLaw | None:
        """Optimise a structure's numbers; None if they make no law."""
        try:
            return self.to_law(self.regression.refine(one, weighting, free=False), weighting.noise)
        except MethodError:
            return None

    def to_law(self, one: RegressionFit, noise: Noise) -> FittedLaw | None:
        """Convert a regression to a law, refitted if a limit acts; None if impossible."""
        numbers = law_numbers(one, self.task.gain)
        if _is_invalid(numbers):
            return None
        if not self.limited:
            return FittedLaw(one.structure, numbers, one.cost, noise)
        return fit(self.task, replace(one.structure, limited=True), numbers | {"limit": self.limit}, noise)

    def weighting(self, best: FittedLaw) -> Weighting:
        """Weighting for the rivals of a law."""
        return Weighting(best.noise, self.task.response(best.structure, best.numbers))


def search(task: Task, progress: Progress = ignore_progress) -> tuple[FittedLaw, tuple[Rival, ...], bool]:
    """Return the best structure, its close rivals and True.

    Candidates come from a segment and are judged on the whole record. An interrupt returns the best law so far, no
    rivals, and False; before the first law is fitted there is none.
    """
    channel = task.log.record.reference_velocity is not None
    stretch = task.select_strongest(_SEGMENT)
    progress(f"learning the controller from {task.log.samples} samples; an interrupt keeps the best law so far")
    whole = replace(regression(task.log), own=True)
    path: list[FittedLaw] = []
    try:
        data, likeliest = _start_search(stretch, channel, path, progress)
        others = _search_nearby(data, likeliest, path, channel, progress)
        data = replace(data, task=task, regression=whole)
        return *_judge_on_whole_record(data, path[-1], others, progress), True
    except KeyboardInterrupt:
        if not path:
            raise
    best = path[-1]
    progress(f"interrupted; fitting the best law so far to the whole record: {best.structure}")
    best = _SearchData(task, whole, best.structure.limited).refit(best, initial_weighting(whole)) or best
    return _refit_under_own_noise(task, best), (), False


def _search_nearby(
    data: _SearchData, likeliest: list[RegressionFit], path: list[FittedLaw], channel: bool, progress: Progress
) -> list[FittedLaw]:
    """Improve the last law of a path by single changes; return close laws."""
    best, seen = _refit_under_own_noise(data.task, path[-1]), set[Structure]()
    while True:
        path.append(best)
        progress(Detail(f"{best.structure}: {len(best.structure.names)} numbers"))
        seen.add(best.structure)
        best = data.refit(best, data.weighting(best)) or best
        near = list(list_neighbours(best.structure, channel))
        rivals = rank(data.task, best, _fit_nearby(data, best, follow(near, progress, _NEARBY, len(near), "laws")))
        if not rivals or rivals[0].worse >= 0.0:
            weighting = data.weighting(best)
            fresh = drop_failures(data.fit_gains(one.structure, one.numbers, weighting) for one in likeliest)
            others = drop_failures(data.refine(_trim(data, one, weighting), weighting) for one in fresh)
            rivals = rank(data.task, best, [*others, *(rival.fitted for rival in rivals)])
        if not rivals or rivals[0].worse >= 0.0:
            break
        better = _refit_under_own_noise(data.task, rivals[0].fitted)
        if better.structure in seen:  # its own noise speaks for either: the whole record decides
            break
        best = better
    path.append(best)
    progress(Detail(f"{best.structure}, and {len(rivals[:_JUDGED])} others on the whole record"))
    return unique_structures(rival.fitted for rival in rivals)[:_JUDGED]


def _start_search(
    task: Task, channel: bool, path: list[FittedLaw], progress: Progress
) -> tuple[_SearchData, list[RegressionFit]]:
    """Return search data and likely laws; the best of them begins the path."""
    data = _SearchData(task, replace(regression(task.log), own=True))
    weighting, late = screen_frames(data.regression, progress)
    candidates = rank_candidates(data.regression, weighting, late, channel, progress)[: _SIEVE[0][0]]
    likeliest = drop_failures(data.fit_gains(one.structure, one.numbers, weighting) for one in candidates)
    for keep, evaluations in _SIEVE:
        kept = follow(likeliest[:keep], progress, "fitting the likeliest laws", keep, "laws")
        refined = (data.regression.refine(one, weighting, False, evaluations) for one in kept)
        trimmed = [_trim(data, one, weighting) for one in refined]
        likeliest = unique_structures(sorted(trimmed, key=partial(score, rows=weighting.noise.rows)))
        weighting = data.regression.weighting(likeliest[0])
    fitted = (data.to_law(one, weighting.noise) for one in likeliest)
    best = next((one for one in fitted if one is not None), None)
    if best is None:
        raise MethodError(
            "No law that is searched for gives this record's torque: all that come near have a negative gain, or a "
            "filter that is hardly damped. Check units, signs and sides of torque, reference and motor_position, or "
            "declare the law."
        )
    data, best = _add_limit(data, best)
    path.append(best)
    return data, likeliest


def _trim(data: _SearchData, one: RegressionFit, weighting: Weighting) -> RegressionFit:
    """Remove parts that do not pay and invalid numbers."""
    rows = weighting.noise.rows
    while True:
        known = law_numbers(one, data.task.gain)
        tried = (data.best_start(fewer, known, weighting) for fewer in list_simpler(one.structure))
        best = min(drop_failures(tried), key=lambda fewer: score(fewer, rows), default=None)
        if best is None or (score(best, rows) > score(one, rows) and not _is_invalid(known)):
            return one
        one = best


def _is_invalid(numbers: Mapping[str, float]) -> bool:
    """Test for negative gains, or damping at its bound."""
    undamped = any(name.endswith("damping") and value < _DAMPED for name, value in numbers.items())
    return undamped or any(value < 0 for name, value in numbers.items() if not may_be_negative(name))


def _add_limit(data: _SearchData, best: FittedLaw) -> tuple[_SearchData, FittedLaw]:
    """Add the observed limit if it improves the fit."""
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
    data: _SearchData, best: FittedLaw, others: list[FittedLaw], progress: Progress
) -> tuple[FittedLaw, tuple[Rival, ...]]:
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
        fewer = drop_failures(data.best_start(one, own.numbers, weighting) for one in simpler)
        refitted = [
            *(partial(data.refit, one, weighting) for one in others),
            *(partial(data.refine, one, weighting) for one in fewer),
        ]
        known = drop_failures(fit_again() for fit_again in follow(refitted, progress, _JUDGING, len(refitted), "laws"))
        rivals = rank(data.task, own, unique_structures(known))
        if not rivals or decided:
            break
        better = rivals[0].fitted
        if rivals[0].worse >= 0.0:
            simple = much_simpler(own, rivals)
            if simple is None:
                break
            better, decided = simple, True
        elif better.structure in errors:  # two noises speak each for another law: the torque's own error is the smaller
            if errors[better.structure] >= errors[best.structure]:
                break
            decided = True
        others = [best, *(rival.fitted for rival in rivals if rival.fitted is not better)]
        best = better
    return best, tuple(rival for rival in rivals if rival.fitted.structure != best.structure)


def _refit_under_own_noise(task: Task, best: FittedLaw) -> FittedLaw:
    for _ in range(2):
        noise = task.noise(best.structure, best.numbers)
        best = _prune(task, fit(task, best.structure, best.numbers, noise) or best)
    return best


def _fit_nearby(data: _SearchData, best: FittedLaw, structures: Iterable[Structure]) -> list[FittedLaw]:
    """Return the most promising structures, fitted under one noise."""
    weighting = data.weighting(best)
    own, rows, task = data.regression, best.noise.rows, data.task
    unlimited = (replace(s, limited=False) for s in structures)
    candidates = drop_failures(
        start_law(own, one, starts(one, best.numbers, task.log.period), weighting) for one in unlimited
    )
    promising = sorted(candidates, key=lambda one: score(one, rows))[:_PROMISING]
    explained = drop_failures(data.fit_gains(one.structure, one.numbers, weighting) for one in promising)
    return drop_failures(data.refine(one, weighting) for one in explained)


def _prune(task: Task, best: FittedLaw) -> FittedLaw:
    """Remove parts with negligible effect after refitting."""

    def unless_other_torque(structure: Structure) -> FittedLaw:
        fitted = fit(task, structure, convert_numbers(structure, best.numbers), best.noise, _SCREENING)
        return best if fitted is None or torque_difference(task, fitted, best) >= MATERIAL else fitted

    for name in best.structure.names:
        if name in _REMOVABLE and name in best.structure.names:
            best = unless_other_torque(remove_part(best.structure, name))
    return best
