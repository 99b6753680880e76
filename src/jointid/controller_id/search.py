"""Structure search by single changes from the screened laws, by Schwarz's criterion."""

from __future__ import annotations

import math
import timeit
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from jointid.common.errors import MethodError
from jointid.common.messages import Detail, Progress, Work, describe_time, follow, ignore_progress
from jointid.controller_id.fitting import FittedLaw, Task, fit
from jointid.controller_id.noise import Noise
from jointid.controller_id.ranking import (
    FRAMES,
    LAWS,
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
    LONGEST,
    NumberedStructure,
    Structure,
    bounds,
    convert_numbers,
    is_tap,
    known_taps,
    list_known_taps,
    may_be_negative,
    starts,
)

_FITTING, _NEARBY, _JUDGING = (
    "fitting the likeliest laws",
    "trying what is near the best",
    "judging on the whole record",
)

_PROBED = 4  # periods per sample of the regression that the time of a search is expected from
_REGRESSIONS = {FRAMES: 500.0, LAWS: 800.0, _FITTING: 3000.0, _NEARBY: 300.0, _JUDGING: 150.0}
"""Regressions like it that each stage takes as long as, measured on records of 1000 to 60,000 samples."""
_SMALL = 60000.0  # and those of few rows, by which laws are screened
_NOT_YET = 99.0  # % at most, before the end

_SEGMENT = 4000  # samples that a search looks at
_JUDGED = 20  # rivals that the whole record judges
_REMOVABLE = (
    "integral_gain", "velocity_feedforward", "acceleration_feedforward", "viscous_feedforward", "coulomb_feedforward",
    "constant_feedforward", "reference_delay", "torque_filters.0.time_constant",
)  # fmt: skip
_EXPLAINS = 0.8  # of the cost without: a limit that leaves more was a torque that only lingered
_SIEVE = ((80, 3), (24, 6), (12, 6))  # laws of the survey that are fitted, each time under a better noise, and how well
_DAMPED = 1.01 * bounds("velocity_filter.damping", 1.0, 1)[0]  # what is below has run to the bound
_CANCELLING = 3.0  # sum of the sizes of free taps, whose sum is 1
_SCREENING = 2  # steps of Gauss and Newton after which a candidate is judged, and perhaps left
_PROMISING = 20  # candidates that are fitted to the end in a round


class _Course:
    """Progress of a search in % of the expected time, from progress of its stages."""

    def __init__(self, progress: Progress, seconds: Mapping[str, float]) -> None:
        self._progress, self._seconds, self._reached = progress, seconds, 0.0
        self._work = Work(progress, "learning the controller", 100.0, "%")

    def __call__(self, message: str) -> None:
        """Pass a sentence on."""
        self._progress(message)

    def draw(self, what: str, done: float, total: float, unit: str) -> None:
        """Update a stage's progress; of a repeated one, the increment."""
        del unit
        stages = list(self._seconds)
        before = sum(self._seconds[one] for one in stages[: stages.index(what)])
        reached = (before + self._seconds[what] * done / (total or 1.0)) / sum(self._seconds.values())
        if reached > self._reached:
            self._reached = reached
            self._work.reach(min(100.0 * reached, _NOT_YET))

    def end(self) -> None:
        """Report completion."""
        self._work.reach(100.0)


def _expect_seconds(task: Task, stretch: Task) -> dict[str, float]:
    """Predict the time of each stage from a few timed regressions."""
    own = replace(regression(stretch.log), own=True)
    weighting, frame, longer = initial_weighting(own), Structure(rate=_PROBED), task.log.samples / stretch.log.samples
    compressed = own.compress(frame, {}, weighting, [0])
    each = _time_work(partial(own.fit_gains, frame, {}, weighting))
    seconds = {stage: many * each for stage, many in _REGRESSIONS.items()}
    of_few_rows = _time_work(partial(compressed.costs, frame, None))
    return seconds | {LAWS: seconds[LAWS] + _SMALL * of_few_rows, _JUDGING: longer * seconds[_JUDGING]}


def _time_work(work: Callable[[], object]) -> float:
    """Median time of a few runs, s."""
    return float(np.median(timeit.repeat(work, number=1, repeat=7)))


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

    Candidates come from a segment and are judged on the whole record. An interrupt after the first fit returns the best
    so far, no rivals, and False.
    """
    channel = task.log.record.reference_velocity is not None
    stretch = task.select_strongest(_SEGMENT)
    seconds = _expect_seconds(task, stretch)
    progress(
        f"learning the controller from {task.log.samples} samples; this takes some "
        f"{describe_time(sum(seconds.values()))}, and an interrupt keeps the best law so far"
    )
    course = _Course(progress, seconds)
    data, likeliest, best, ended = _start_search(stretch, channel, course)
    whole = replace(data, task=task, regression=replace(regression(task.log), own=True))
    path = [best]
    try:
        if ended:
            others = _search_nearby(data, likeliest, path, channel, course)
            return *_judge_on_whole_record(whole, path[-1], others, course), True
    except KeyboardInterrupt:
        pass
    finally:
        course.end()
    best = path[-1]
    progress(f"interrupted; fitting the best law so far to the whole record: {best.structure}")
    best = whole.refit(best, initial_weighting(whole.regression)) or best
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
    task: Task, channel: bool, progress: Progress
) -> tuple[_SearchData, list[RegressionFit], FittedLaw, bool]:
    """Return search data, likely laws, the best of them and True; False if interrupted."""
    data = _SearchData(task, replace(regression(task.log), own=True))
    try:
        weighting, late = screen_frames(data.regression, progress)
        candidates = _shorten_taps(
            data, rank_candidates(data.regression, weighting, late, channel, progress), weighting
        )
        candidates = candidates[: _SIEVE[0][0]]
        likeliest = drop_failures(data.fit_gains(one.structure, one.numbers, weighting) for one in candidates)
    except KeyboardInterrupt:
        progress("interrupted before any law was fitted: there is none to keep yet")
        raise
    work, ended = Work(progress, _FITTING, sum(keep for keep, _ in _SIEVE), "laws"), True
    try:
        for keep, evaluations in _SIEVE:
            refined = (
                data.regression.refine(one, weighting, False, evaluations) for one in work.along(likeliest[:keep])
            )
            trimmed = [_trim(data, one, weighting) for one in refined]
            likeliest = unique_structures(sorted(trimmed, key=partial(score, rows=weighting.noise.rows)))
            weighting = data.regression.weighting(likeliest[0])
    except KeyboardInterrupt:
        ended = False
    fitted = (data.to_law(one, weighting.noise) for one in likeliest)
    best = next((one for one in fitted if one is not None), None)
    if best is None:
        raise MethodError(
            "No law that is searched for gives this record's torque: all that come near have a negative gain, or a "
            "filter that is hardly damped. Check units, signs and sides of torque, reference and motor_position, or "
            "declare the law."
        )
    work.reach(work.total)
    data, best = _add_limit(data, best)
    return data, likeliest, best, ended


def _shorten_taps(
    data: _SearchData, candidates: list[NumberedStructure], weighting: Weighting
) -> list[NumberedStructure]:
    """Reduce free taps to the needed number, or to a named difference.

    All laws begin with the maximal number, since removing single taps would take long. A named difference has no free
    numbers, so that laws are ranked again.
    """
    # What a regression does not find, as a delay, is rough where it begins.
    best = min((one for one in candidates if one.structure.taps), key=lambda one: len(one.numbers), default=None)
    if best is None:
        return candidates
    rows, kinds = weighting.noise.rows, (*(f"taps {n}" for n in range(2, LONGEST + 1)), *list_known_taps())
    like = (replace(best.structure, velocity_filter=kind) for kind in kinds)
    fitted = drop_failures(data.fit_gains(one, best.numbers, weighting) for one in like)
    # A gain that is negative is taken away later beside a named difference; free taps may be bent to make up for it.
    fitted = [one for one in fitted if not (one.structure.taps and _is_invalid(law_numbers(one, data.task.gain)))]
    kind = min(fitted, key=lambda one: score(one, rows)).structure.velocity_filter
    named = (
        replace(one.structure, velocity_filter=kind) if one.structure.taps else one.structure for one in candidates
    )
    shortened = [replace(one, structure=structure) for one, structure in zip(candidates, named, strict=True)]
    ranked = shortened if kind.startswith("taps") else sorted(shortened, key=partial(score, rows=rows))
    return unique_structures(ranked)


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
    """Test for negative gains, damping at its bound, or cancelling taps.

    Cancelling taps react to frequencies above the informative ones, and fit quantisation.
    """
    taps = [value for name, value in numbers.items() if is_tap(name)]
    if abs(1.0 - sum(taps)) + sum(map(abs, taps)) > _CANCELLING:
        return True
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
    """Remove parts with negligible effect after refitting.

    Free taps become a named difference if it gives the same torque.
    """

    def unless_other_torque(structure: Structure) -> FittedLaw:
        fitted = fit(task, structure, convert_numbers(structure, best.numbers), best.noise, _SCREENING)
        return best if fitted is None or torque_difference(task, fitted, best) >= MATERIAL else fitted

    for kind in known_taps(best.structure.taps) if best.structure.taps else ():
        best = unless_other_torque(replace(best.structure, velocity_filter=kind))
        if not best.structure.taps:
            break
    for name in best.structure.names:
        if name in _REMOVABLE and name in best.structure.names:
            best = unless_other_torque(remove_part(best.structure, name))
    return best
