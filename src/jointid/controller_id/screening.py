"""Screen clocks and filters before a law is chosen: each by its regression with free gains."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from jointid.common.errors import MethodError
from jointid.common.progress import Progress, silent
from jointid.controller_id.noise import Noise
from jointid.controller_id.regression import CompressedFrame, Regression, RegressionFit, Weighting
from jointid.controller_id.structure_moves import list_laws
from jointid.controller_id.structures import (
    COMMON,
    INTEGRAL_GAINS,
    LATE,
    MEANS,
    RATES,
    SLOWER,
    TORQUE_FILTERS,
    Structure,
    starts,
)

_FINEST = 8  # frames whose filters' numbers are searched for
_DELAYS = 2  # of the log's, with which laws are tried


class Candidate(NamedTuple):
    """A law, and where to begin.

    Attributes:
        structure: of the law.
        numbers: of its filters, ki of a cascade, and the reference's delay.
        cost: what it would leave after a step of Gauss and Newton.
    """

    structure: Structure
    numbers: dict[str, float]
    cost: float


def initial_weighting(regression: Regression) -> Weighting:
    """Return the weighting before anything is known of the noise: all informative frequencies alike."""
    log = regression.log
    return Weighting(Noise(float(np.var(log.torque)), 0.0, log.informative), np.ones(log.samples // 2 + 1))


def screen_frames(regression: Regression, progress: Progress = silent) -> tuple[Weighting, list[int]]:
    """Return the weighting under which laws are compared, and the log's likeliest delays.

    What is quiet beside the noise shows only once something explains the rest: the noise is that of the frame that
    explains most whatever the gains, and all are judged again under it. At first by one spectrum, as the law's own
    would reward a far-off law for reacting to the position; at last by each its own, as one for all would reward a
    filter that keeps the noise away.
    """
    weighting = initial_weighting(regression)
    progress("screening clocks and filters, with free gains")
    best = _best_per_structure(_fit_all_frames(regression, weighting))[:_FINEST]
    for own in (False, False, True):
        weighting = regression.weighting(best[0])
        finer = replace(regression, own=own)
        best = sorted((finer.refine(one, weighting) for one in best), key=lambda one: one.cost)
    late = list(dict.fromkeys(one.structure.late for one in best))
    return regression.weighting(best[0]), late[:_DELAYS]


def rank_candidates(
    regression: Regression, weighting: Weighting, late: Sequence[int], channel: bool, progress: Progress = silent
) -> list[Candidate]:
    """Return all laws in all frames, each where it begins best, the likeliest first.

    Args:
        regression: on a stretch of a record.
        weighting: what they are judged under.
        late: the log's delays that are tried.
        channel: whether the record has the reference's velocity.
        progress: is told the turns.
    """
    progress("screening all laws with all clocks and filters")
    period, rows = regression.log.period, weighting.noise.rows
    best: dict[Structure, Candidate] = {}
    for frame in _frames(Structure()):
        plain = frame.rate == frame.every == 1
        for delayed in (False, True) if plain and frame.torque_filter == "none" else (False,):
            laws = [law for law in list_laws(frame, channel) if law.reference_delay == delayed]
            for numbers in starts(replace(frame, reference_delay=delayed), {}, period):
                try:
                    compressed = regression.compress(frame, numbers, weighting, late if plain else [0])
                except MethodError:  # a filter that cannot be at this rate
                    continue
                for one in (one for law in laws for one in _start_laws(compressed, law, period)):
                    if one.structure not in best or one.cost < best[one.structure].cost:
                        best[one.structure] = one
    return sorted(best.values(), key=lambda one: one.cost + one.structure.weight(rows))


def start_law(
    regression: Regression, law: Structure, begun: Iterable[Mapping[str, float]], weighting: Weighting
) -> Candidate | None:
    """Return the best starting point of a law; None if it is impossible.

    Args:
        regression: on a stretch of a record.
        law: the law.
        begun: numbers to begin from.
        weighting: what it is judged under.
    """
    found = []
    for numbers in begun:
        ki = numbers.get("ki") if law.cascade else None
        others = {name: value for name, value in numbers.items() if name != "ki"}
        try:
            compressed = regression.compress(law, others, weighting, [law.late])
        except MethodError:  # a filter or a delay that cannot be
            continue
        found.append(Candidate(law, dict(numbers), float(compressed.costs(law, ki)[0])))
    return min(found, key=lambda one: one.cost, default=None)


def _start_laws(compressed: CompressedFrame, law: Structure, period: float) -> Iterator[Candidate]:
    gains = INTEGRAL_GAINS if law.cascade and law.integrates else (None,)
    for share in gains:
        ki = None if share is None else share / period
        numbers = compressed.numbers if ki is None else compressed.numbers | {"ki": ki}
        for late, cost in zip(compressed.late, compressed.costs(law, ki), strict=True):
            yield Candidate(replace(law, late=late), numbers, float(cost))


def _best_per_structure(explained: Iterator[RegressionFit]) -> list[RegressionFit]:
    best: dict[Structure, RegressionFit] = {}
    for one in explained:
        if one.structure not in best or one.cost < best[one.structure].cost:
            best[one.structure] = one
    return sorted(best.values(), key=lambda one: one.cost)


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
    for filtered in ("none", *(f"mean {n}" for n in MEANS), "first order", "second order"):
        like = replace(plain, velocity_filter=filtered)
        yield like
        if filtered in COMMON:
            yield from (replace(like, torque_filter=one) for one in TORQUE_FILTERS[1:])
            yield from (replace(like, rate=n, curved=curved) for n in RATES for curved in (False, True))
            yield from (replace(like, every=n, offset=k) for n in SLOWER for k in range(n))
