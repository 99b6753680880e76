"""Screening of laws by regression with free gains, their ranking by Schwarz's criterion, and their equivalence.

The criterion is the whitened cost relative to the best structure, plus the penalty of the structure's parts, with one
row per informative frequency. A difference of ten means odds of exp(-5) to 1.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from operator import attrgetter
from typing import TypeVar

import numpy as np

from jointid.common.errors import MethodError
from jointid.common.messages import Progress, follow, ignore_progress
from jointid.controller_id.fitting import FittedLaw, Task
from jointid.controller_id.regression import CompressedFrame, Regression, RegressionFit, Weighting, initial_weighting
from jointid.controller_id.structure_moves import list_laws
from jointid.controller_id.structures import (
    COMMON,
    INTEGRAL_GAINS,
    INTERPOLATIONS,
    LATE,
    RATES,
    SLOWER,
    TORQUE_FILTERS,
    VELOCITY_FILTERS,
    NumberedStructure,
    Structure,
    starts,
)

_Law = TypeVar("_Law", bound=NumberedStructure)

ALIKE = 10.0  # of the criterion: a smaller difference does not distinguish two laws
MATERIAL = 1e-3  # of the torque's rms: a part that carries less is none
FRAMES, LAWS = "screening clocks and filters, with free gains", "screening all laws with all clocks and filters"
_FINEST = 8  # frames whose filters' numbers are searched for
_DELAYS = 2  # of the log's, with which laws are tried
_COST = attrgetter("cost")


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

    Of two with equal filters and torques equal within `MATERIAL`, the one with fewer numbers ranks first, since
    direction-dependent encoder errors can be significant.
    """
    own, rivals = criterion(best, best), []
    for one in others:
        worse, distance = criterion(one, best) - own, torque_difference(task, one, best)
        more = one.structure.parts - best.structure.parts
        first, second = one.structure, best.structure
        same_velocity = first.velocity_filter == second.velocity_filter
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


def screen_frames(regression: Regression, progress: Progress = ignore_progress) -> tuple[Weighting, list[int]]:
    """Return the weighting for the comparison of laws, and the likeliest delays.

    The noise is that of the best frame with free gains. First all frames share one spectrum, since a law's own would
    reward a strong reaction to the position; then each has its own, since a shared one would reward filters.
    """
    weighting = initial_weighting(regression)
    fitted = unique_structures(_fit_all_frames(regression, weighting, progress), by=_COST)
    best = sorted(fitted, key=_COST)[:_FINEST]
    for own in (False, False, True):
        weighting = regression.weighting(best[0])
        finer = replace(regression, own=own)
        best = sorted((finer.refine(one, weighting) for one in best), key=_COST)
    late = list(dict.fromkeys(one.structure.late for one in best))
    return regression.weighting(best[0]), late[:_DELAYS]


def rank_candidates(
    regression: Regression,
    weighting: Weighting,
    late: Sequence[int],
    channel: bool,
    progress: Progress = ignore_progress,
) -> list[NumberedStructure]:
    """Rank all laws in all frames, each at its best start."""
    started: list[NumberedStructure] = []
    period, frames = regression.log.period, list(_frames(Structure()))
    for frame in follow(frames, progress, LAWS, len(frames), "clocks and filters"):
        plain = frame.rate == frame.every == 1
        for delayed in (False, True) if plain and frame.torque_filter == "none" else (False,):
            laws = [law for law in list_laws(frame, channel) if law.reference_delay == delayed]
            for numbers in starts(replace(frame, reference_delay=delayed), {}, period):
                try:
                    compressed = regression.compress(frame, numbers, weighting, late if plain else [0])
                except MethodError:  # a filter that cannot be at this rate
                    continue
                for law in laws:
                    started += _start_laws(compressed, law, period)
    return sorted(unique_structures(started, by=_COST), key=partial(score, rows=weighting.noise.rows))


def start_law(
    regression: Regression, law: Structure, started: Iterable[Mapping[str, float]], weighting: Weighting
) -> NumberedStructure | None:
    """Best starting point of a law; None if impossible."""
    found = []
    for numbers in started:
        ki = numbers.get("integral_gain") if law.cascade else None
        others = {name: value for name, value in numbers.items() if name != "integral_gain"}
        try:
            compressed = regression.compress(law, others, weighting, [law.late])
        except MethodError:  # a filter or a delay that cannot be
            continue
        found.append(NumberedStructure(law, dict(numbers), float(compressed.costs(law, ki)[0])))
    return min(found, key=_COST, default=None)


def _start_laws(compressed: CompressedFrame, law: Structure, period: float) -> Iterator[NumberedStructure]:
    gains = INTEGRAL_GAINS if law.cascade and law.integrates else (None,)
    for share in gains:
        ki = None if share is None else share / period
        numbers = compressed.numbers if ki is None else compressed.numbers | {"integral_gain": ki}
        for late, cost in zip(compressed.late, compressed.costs(law, ki), strict=True):
            yield NumberedStructure(replace(law, late=late), numbers, float(cost))


def _fit_all_frames(regression: Regression, weighting: Weighting, progress: Progress) -> Iterator[RegressionFit]:
    frames = list(_frames(Structure()))
    for frame in follow(frames, progress, FRAMES, len(frames), "clocks and filters"):
        late = (0, *LATE) if frame.rate == frame.every == 1 else (0,)
        for numbers in starts(frame, {}, regression.log.period):
            try:
                yield from regression.fit_gains(frame, numbers, weighting, late)
            except MethodError:  # a filter that cannot be at this rate
                continue


def _frames(plain: Structure) -> Iterator[Structure]:
    """Yield clocks with common filters, and the log's clock with all filter pairs."""
    for filtered in VELOCITY_FILTERS:
        like = replace(plain, velocity_filter=filtered)
        yield like
        if filtered in COMMON:
            yield from (replace(like, torque_filter=one) for one in TORQUE_FILTERS[1:])
            yield from (replace(like, rate=n, interpolation=way) for n in RATES for way in INTERPOLATIONS)
            yield from (replace(like, every=n, offset=k) for n in SLOWER for k in range(n))
