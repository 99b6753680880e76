"""A study: a judge over many seeds, and shares of its outcomes with the bounds that the documentation claims."""

from __future__ import annotations

import random
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from studies.seeds import Task

HELD, FAILED, UNCOUNTED = "1", "0", "-"
LEVEL = 1e-3
"""Largest probability that a check fails a right program."""
_PART, _LEAST = 10, 8  # a tenth is drawn, and of a small study at least so many tasks


@dataclass(frozen=True, slots=True)
class Share:
    """A share of a study's outcomes, and the bounds that the documentation claims for it.

    Attributes:
        label: of the row in the documentation.
        holds: whether an outcome has the property; None where the outcome does not count.
        at_least, at_most: bounds of the share in the long run.
        tested: whether a check compares it; if not, it only details another share of too few tasks to be compared.
    """

    label: str
    holds: Callable[[Any], bool | None]
    at_least: float = 0.0
    at_most: float = 1.0
    tested: bool = True


@dataclass(frozen=True, slots=True)
class Study:
    """A study.

    Attributes:
        name: on the command line and in the documentation.
        shows: what it shows, in a line.
        judge: function of a seed and the settings, as "module:name"; it returns what JSON holds, or a dataclass of it.
        seeds: judged with each of the settings.
        shares: of the outcomes; an outcome of None counts in none of them.
        settings: other arguments of the judge.
    """

    name: str
    shows: str
    judge: str
    seeds: Sequence[int]
    shares: tuple[Share, ...]
    settings: tuple[Mapping[str, Any], ...] = ({},)

    def tasks(self, seeds: Sequence[int] | None = None) -> list[Task]:
        """Return a task for each seed and setting, all seeds of the first setting first."""
        return [Task(self.judge, seed, one) for one in self.settings for seed in seeds or self.seeds]

    def draw(self, word: str) -> list[int]:
        """Return the places of the tasks that a word draws: a tenth of all, without replacement."""
        count = len(self.settings) * len(self.seeds)
        size = min(count, max(-(-count // _PART), _LEAST))
        return sorted(random.Random(f"{word} {self.name}").sample(range(count), size))  # noqa: S311

    def count(self, outcomes: Sequence[Any]) -> dict[str, str]:
        """Return for each share one letter an outcome: whether it holds, fails or does not count."""
        return {share.label: "".join(_letter(share, one) for one in outcomes) for share in self.shares}


def counted(letters: str) -> tuple[int, int]:
    """Return how many tasks hold, and how many count."""
    return letters.count(HELD), len(letters) - letters.count(UNCOUNTED)


def draw_studies(studies: Sequence[Study], word: str) -> list[Study]:
    """Return a quarter of the studies, drawn by a word, in their order."""
    drawn = random.Random(word).sample(range(len(studies)), -(-len(studies) // 4))  # noqa: S311
    return [studies[place] for place in sorted(drawn)]


def is_claimed(study: Study, share: Share, letters: str, studies: int) -> bool:
    """Return whether chance allows the drawn outcomes if the true share is at the claimed bound.

    An exact binomial test. All tests of a run together fail a right program with a probability of at most `LEVEL`: each
    study has the same part of it, and within a study each test (Bonferroni).
    """
    from scipy.stats import binom

    held, of = counted(letters)
    chances = []
    if share.at_least > 0.0:
        chances.append(binom.cdf(held, of, share.at_least))
    if share.at_most < 1.0:
        chances.append(binom.sf(held - 1, of, share.at_most))
    tests = sum((one.at_least > 0.0) + (one.at_most < 1.0) for one in study.shares if one.tested)
    return bool(min(chances) >= LEVEL / studies / tests)


def _letter(share: Share, outcome: Any) -> str:
    holds = None if outcome is None else share.holds(outcome)
    return UNCOUNTED if holds is None else HELD if holds else FAILED
