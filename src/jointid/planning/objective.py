"""The tests of a joint or a robot that a search compares: what each tells of a goal, and what it reaches of each axis.

A test is judged at each joint or robot that there may be. One that exceeds a limit ranks below all others, by the
excess.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from jointid.common.arrays import FloatArray
from jointid.common.errors import JointidError, MethodError
from jointid.models.limits import AxisLimits, find_excess
from jointid.planning.joints import JointModel
from jointid.planning.plans import Family, Plan, Series
from jointid.planning.predict import Goal, PredictedTest
from jointid.planning.robots import RobotModel

MARGIN = 0.97
"""Of each limit, that a test may reach in the search: other joints and other noise reach more."""
ASTRAY = 1e6
"""Score of a test that cannot be simulated, or does not tell every parameter."""

_CLEARLY = 0.02  # of a score: other joints change it by as much


@dataclass(frozen=True, slots=True, eq=False)
class Tried:
    """An evaluated test.

    Attributes:
        plan: None of a test that is given as records.
        score: of the goal, the smaller the better, see `Goal.score`.
        reached: of each axis the largest of each quantity, by name.
        over: by how much the limit that is passed farthest is passed, at most 1 where none is.
        stds: (parameters,) standard deviations at each joint or robot, the known one first.
    """

    plan: Plan | None
    score: float
    reached: tuple[Mapping[str, float], ...]
    over: float
    stds: tuple[FloatArray, ...] = ()

    @property
    def rank(self) -> tuple[float, float]:
        """Sort key: exceeded limits first."""
        return max(self.over, 1.0), self.score


@dataclass(frozen=True, slots=True, eq=False)
class Objective:
    """The tests that are compared.

    Attributes:
        model: what is known.
        goal: what a test is to tell.
        limits: that each axis keeps.
        families: to search; none where a test is given.
    """

    model: JointModel | RobotModel
    goal: Goal
    limits: tuple[AxisLimits, ...]
    families: Sequence[Family | Series] = ()

    def try_plan(self, plan: Plan, *, margin: float = MARGIN, than: Tried | None = None) -> Tried:
        """Judge a plan; see `judge`."""
        return self.judge(plan, self.model.predict_plan(plan), margin=margin, than=than)

    def judge(
        self, plan: Plan | None, each: Iterator[PredictedTest], *, margin: float = 1.0, than: Tried | None = None
    ) -> Tried:
        """Judge a test by its predictions: the mean of their scores, and the largest of what they reach.

        Args:
            plan: the test.
            each: predictions of it at each joint or robot, the known one first.
            margin: admissible share of each limit.
            than: a test to beat; where this one clearly loses at the first joint, the others are skipped.
        """
        scores, stds, reached = list[float](), list[FloatArray](), [dict[str, float]() for _ in self.limits]
        tried = Tried(plan, ASTRAY, (), math.inf)
        while True:
            try:
                with np.errstate(all="ignore"):
                    one = next(each, None)
            except (JointidError, np.linalg.LinAlgError):
                unknown = (*stds, np.full_like(stds[0], np.inf)) if stds else ()
                return Tried(plan, ASTRAY, tuple(reached), math.inf, unknown)
            if one is None:
                return tried
            for most, found in zip(reached, one.reached, strict=True):
                most.update({name: max(size, most.get(name, size)) for name, size in found.items()})
            scores.append(self.goal.score(one))
            stds.append(one.covariance.std)
            score = float(np.mean(scores))
            over = self._worst_excess(reached, margin) if score < ASTRAY else math.inf
            tried = Tried(plan, min(score, ASTRAY), tuple(reached), over, tuple(stds))
            if than is not None and tried.rank > (than.rank[0], than.score + _CLEARLY):
                return tried

    def _worst_excess(self, reached: Sequence[Mapping[str, float]], margin: float) -> float:
        """Return the largest factor by which a share of the limits is exceeded; 0 where none is."""
        ends = ("lower", "upper")  # a position has no share
        factors = [0.0]
        for one, found in zip(self.limits, reached, strict=True):
            asked = {name: size if name in ends else size / margin for name, size in found.items()}
            factors += find_excess(one, asked).values()
        return max(factors)


def complete(
    limits: Sequence[AxisLimits], names: Sequence[str], needed: Collection[str], kept: Collection[str],
    before: Sequence[Mapping[str, float]] | None,
) -> tuple[AxisLimits, ...]:  # fmt: skip
    """Complete the limits of each axis by what the present test reaches; raise where a needed one is missing."""
    found, missing = [], list[str]()
    for one, name, seen in zip(limits, names, before or [{} for _ in names], strict=True):
        if lacking := [what for what in needed if what not in one.stated and what not in seen]:
            missing.append(f"{name} ({', '.join(lacking)})".strip())
        taken = {what: seen[what] for what in kept if what in seen and what not in one.stated}
        found.append(replace(one, **taken))
    if missing:
        raise MethodError(
            f"A search for a test needs limits of each axis, and some are missing: {'; '.join(missing)}. Give them as "
            f"limits = {{ {' = ..., '.join(needed)} = ... }}, or a test there is already."
        )
    return tuple(found)
