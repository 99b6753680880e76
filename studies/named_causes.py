"""Causes that are named where a record does not fit the declared drive, by the axis and the mistake."""

from __future__ import annotations

from dataclasses import dataclass

from jointid.diagnostics.explain import find_causes
from tests.mistakes import (
    PAIRS,
    AxisName,
    Mistake,
    axis,
    is_misled,
    mistakes_of,
    more_mistakes_of,
    tell,
    varied,
    without_mistake,
    without_positions,
)


@dataclass(frozen=True, slots=True)
class NamedCauses:
    """What was named of one mistake.

    Attributes:
        right: causes one of which must be named. named: those that are.
        misled: whether only wrong ones are named, without that more than one thing may be wrong.
        worded: whether the words are there that must be.
    """

    right: tuple[str, ...]
    named: tuple[str, ...]
    misled: bool
    worded: bool


def find_mistake(name: AxisName, mistake: str) -> Mistake:
    """Return the mistake of that name that can be made on an axis."""
    made = axis(name)
    return next(one for one in (*mistakes_of(made), *more_mistakes_of(made), *PAIRS) if one.name == mistake)


def judge(seed: int, name: AxisName, mistake: str) -> NamedCauses:
    """Make a mistake on an axis, and name its cause."""
    one = find_mistake(name, mistake)
    record, loop = one.make(axis(name), seed)
    named, words = tell(without_positions(record) if one in PAIRS else record, loop)
    return NamedCauses(tuple(sorted(one.right)), named, is_misled(one, named), one.said in words)


def judge_healthy(seed: int, name: AxisName) -> int:
    """Return how many causes are named on an axis of other numbers under other gains, on which nothing is wrong."""
    record, loop = without_mistake(varied(axis(name), seed), seed)
    return len(find_causes(record, loop).explanations)
