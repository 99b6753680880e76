"""Drawn outcomes compared with the stored ones, by exact tests that a right program nearly always passes.

A tenth of a study's tasks is drawn at random and judged again. Each share of the drawn outcomes is compared with that
of the stored outcomes of all *other* tasks, given how many hold in both together. That number is hypergeometric in
two cases: if the program reproduces its stored outcomes, since the draw is random, and if it makes independent new ones
of the same distribution, since drawn and stored outcomes are then exchangeable (Fisher's exact test). A beta-binomial
would hold in the second case alone, and on average over a prior.

The documentation's claim is tested by the exact binomial test at the claimed bound, twice: by the drawn tasks alone,
and by all tasks, with the new outcomes in the place of those stored of the drawn tasks. The smaller of both
probabilities counts, doubled.

All tests together fail a right program with a probability of at most `LEVEL`. Each study has the same part of it, and
within a study each test (Bonferroni).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, TypeAlias

import numpy as np

from jointid.common.arrays import FloatArray
from studies.study import HELD, UNCOUNTED, Share, Study

Counts: TypeAlias = tuple[Any, int]
"""How many tasks hold, a number or an array of them, and how many count."""

LEVEL = 1e-3
"""Largest probability that a check fails a right program."""


@dataclass(frozen=True, slots=True)
class Compared:
    """A share of the drawn tasks beside the stored ones.

    Attributes:
        study, label: of the share.
        drawn, others: how many hold, of how many that count: of the drawn tasks, and of all others as stored.
        by_chance: probability of a difference at least as large.
        by_claim: probability of a share as far beyond the claimed bounds, of the drawn tasks or of all.
        level: below which either probability is a failure.
        changed: places of the drawn tasks whose outcome is another than the stored one.
    """

    study: str
    label: str
    drawn: tuple[int, int]
    others: tuple[int, int]
    by_chance: float
    by_claim: float
    level: float
    changed: tuple[int, ...]

    @property
    def passed(self) -> bool:
        """True if chance allows the difference from the others and from the claim."""
        return min(self.by_chance, self.by_claim) >= self.level


def compare(
    study: Study, stored: Mapping[str, str], places: Sequence[int], found: Mapping[str, str], studies: int
) -> list[Compared]:
    """Compare the drawn outcomes of a study with the stored ones.

    Args:
        study: the study.
        stored: letters of all tasks, by share; see `Study.count`.
        places: of the drawn tasks.
        found: letters of the drawn tasks, by share.
        studies: how many are checked in one run.
    """
    level = compute_level(study, studies)
    tested = (one for one in study.shares if one.tested)
    return [_compare(study, one, stored[one.label], places, found[one.label], level) for one in tested]


def compute_level(study: Study, studies: int) -> float:
    """Return the level of each of a study's tests, two for a share, where so many studies are checked."""
    return LEVEL / studies / (2 * sum(share.tested for share in study.shares))


def _compare(study: Study, share: Share, stored: str, places: Sequence[int], found: str, level: float) -> Compared:
    drawn = set(places)
    others = "".join(letter for place, letter in enumerate(stored) if place not in drawn)
    changed = tuple(place for place, letter in zip(places, found, strict=True) if stored[place] != letter)
    new, old = counted(found), counted(others)
    by_chance, by_claim = (float(compute(new, old, share)) for compute in (compute_chance, compute_claim_chance))
    return Compared(study.name, share.label, new, old, by_chance, by_claim, level, changed)


def counted(letters: str) -> tuple[int, int]:
    """Return how many tasks hold, and how many count."""
    return letters.count(HELD), len(letters) - letters.count(UNCOUNTED)


def compute_chance(drawn: Counts, others: Counts, share: Share) -> FloatArray:
    """Return the probability of drawn outcomes as unlike the others, on the sides that the claim bounds."""
    from scipy.stats import hypergeom

    if drawn[1] == 0 or others[1] == 0:  # nothing to compare
        return np.ones(np.shape(drawn[0]))
    law = hypergeom(drawn[1] + others[1], drawn[0] + others[0], drawn[1])
    return _on_bounded_sides(np.asarray(law.cdf(drawn[0])), np.asarray(law.sf(drawn[0] - 1)), share)


def compute_claim_chance(drawn: Counts, others: Counts, share: Share) -> FloatArray:
    """Return the probability of a share as far beyond the claimed bounds, of the drawn outcomes or of all."""
    every = drawn[0] + others[0], drawn[1] + others[1]
    chances = np.minimum(_compute_excess(drawn, share), _compute_excess(every, share))
    return np.asarray(np.minimum(1.0, 2 * chances))


def _compute_excess(counts: Counts, share: Share) -> FloatArray:
    """Return the probability of a share as far beyond the claimed bounds, if the true one is at a bound."""
    from scipy.stats import binom

    held, of = counts
    fewer, more = binom.cdf(held, of, share.at_least), binom.sf(held - 1, of, share.at_most)
    return _on_bounded_sides(np.asarray(fewer), np.asarray(more), share)


def _on_bounded_sides(fewer: FloatArray, more: FloatArray, share: Share) -> FloatArray:
    """Return the probability on the side that is bounded; twice the smaller one where both sides are."""
    sides = [fewer] * (share.at_least > 0.0) + [more] * (share.at_most < 1.0)
    return np.asarray(np.minimum(1.0, len(sides) * np.minimum.reduce(sides)))
