"""Clocks and filters, told from each other before a law is: each with what it explains whatever the gains."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from jointid.common.errors import MethodError
from jointid.common.progress import Progress, silent
from jointid.controller_id.noise import Noise
from jointid.controller_id.regression import Compressed, Explained, Regression, Standing
from jointid.controller_id.structure_moves import all_laws
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


def unheard(regression: Regression) -> Standing:
    """Return what laws are judged under before anything is known of the noise."""
    watched = regression.watched
    return Standing(Noise(float(np.var(watched.torque)), 0.0, watched.heard), np.ones(watched.samples // 2 + 1))


def survey(regression: Regression, progress: Progress = silent) -> tuple[Standing, list[int]]:
    """Return what laws may be judged under, and the log's likeliest delays.

    What is quiet beside the noise shows only once something explains the rest: the noise is that of the frame that
    explains most whatever the gains, and all are judged again under it. At first by one spectrum, as the law's own
    would reward a far-off law for reacting to the position; at last by each its own, as one for all would reward a
    filter that keeps the noise away.
    """
    standing = unheard(regression)
    progress("what explains the torque, whatever the gains")
    best = _best_of_each(_all_explained(regression, standing))[:_FINEST]
    for own in (False, False, True):
        standing = regression.standing(best[0])
        finer = replace(regression, own=own)
        best = sorted((finer.refined(one, standing) for one in best), key=lambda one: one.cost)
    late = list(dict.fromkeys(one.structure.late for one in best))
    return regression.standing(best[0]), late[:_DELAYS]


def candidates(
    regression: Regression, standing: Standing, late: Sequence[int], channel: bool, progress: Progress = silent
) -> list[Candidate]:
    """Return all laws in all frames, each where it begins best, the likeliest first.

    Args:
        regression: on a stretch of a record.
        standing: what they are judged under.
        late: the log's delays that are tried.
        channel: whether the record has the reference's velocity.
        progress: is told the turns.
    """
    progress("all laws, with all clocks and filters")
    period, rows = regression.watched.period, standing.noise.rows
    best: dict[Structure, Candidate] = {}
    for frame in _frames(Structure()):
        plain = frame.rate == frame.every == 1
        for delayed in (False, True) if plain and frame.torque_filter == "none" else (False,):
            laws = [law for law in all_laws(frame, channel) if law.reference_delay == delayed]
            for numbers in starts(replace(frame, reference_delay=delayed), {}, period):
                try:
                    compressed = regression.compressed(frame, numbers, standing, late if plain else [0])
                except MethodError:  # a filter that cannot be at this rate
                    continue
                for one in (one for law in laws for one in _begun(compressed, law, period)):
                    if one.structure not in best or one.cost < best[one.structure].cost:
                        best[one.structure] = one
    return sorted(best.values(), key=lambda one: one.cost + one.structure.weight(rows))


def begin(
    regression: Regression, law: Structure, begun: Iterable[Mapping[str, float]], standing: Standing
) -> Candidate | None:
    """Return where a law begins best; None where it cannot be.

    Args:
        regression: on a stretch of a record.
        law: the law.
        begun: numbers to begin from.
        standing: what it is judged under.
    """
    found = []
    for numbers in begun:
        ki = numbers.get("ki") if law.cascade else None
        others = {name: value for name, value in numbers.items() if name != "ki"}
        try:
            compressed = regression.compressed(law, others, standing, [law.late])
        except MethodError:  # a filter or a delay that cannot be
            continue
        found.append(Candidate(law, dict(numbers), float(compressed.costs(law, ki)[0])))
    return min(found, key=lambda one: one.cost, default=None)


def _begun(compressed: Compressed, law: Structure, period: float) -> Iterator[Candidate]:
    gains = INTEGRAL_GAINS if law.cascade and law.integrates else (None,)
    for share in gains:
        ki = None if share is None else share / period
        numbers = compressed.numbers if ki is None else compressed.numbers | {"ki": ki}
        for late, cost in zip(compressed.late, compressed.costs(law, ki), strict=True):
            yield Candidate(replace(law, late=late), numbers, float(cost))


def _best_of_each(explained: Iterator[Explained]) -> list[Explained]:
    best: dict[Structure, Explained] = {}
    for one in explained:
        if one.structure not in best or one.cost < best[one.structure].cost:
            best[one.structure] = one
    return sorted(best.values(), key=lambda one: one.cost)


def _all_explained(regression: Regression, standing: Standing) -> Iterator[Explained]:
    for frame in _frames(Structure()):
        late = (0, *LATE) if frame.rate == frame.every == 1 else (0,)
        for numbers in starts(frame, {}, regression.watched.period):
            try:
                yield from regression.explained(frame, numbers, standing, late)
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
