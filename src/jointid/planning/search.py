"""Search for the most informative test of several families within limits.

A test is a family and numbers between 0 and 1 (`plans`). `Objective` rates its information on the goal and its maxima
on each axis, at each joint or robot of the tolerance. Tests that exceed a limit rank below all others, by the excess.

Random tests of every family start the search; the best of each and then the best of all take adaptive steps of an
evolution strategy (I. Rechenberg's one-fifth rule). New random tests are mixed in while time remains.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from jointid.common.arrays import FloatArray
from jointid.common.errors import JointidError, MethodError
from jointid.common.messages import Progress, pace
from jointid.common.parallel import in_threads
from jointid.models.limits import AxisLimits, find_excess
from jointid.planning.joints import JointModel
from jointid.planning.plans import Family, Plan, Series
from jointid.planning.predict import Goal, PredictedTest
from jointid.planning.robots import RobotModel

MARGIN = 0.97
"""Of each limit, that a test may reach in the search: other joints and other noise reach more."""
ASTRAY = 1e6
"""Score of a test that cannot be simulated, or does not determine every parameter."""
_CLEARLY = 0.02  # of a score: other joints change it by as much
_DRAWN = 6  # tests of each family, to begin with
_FEWEST = 40  # tests that are tried, though the time be over, until one can be simulated
_MOST = 20_000  # tests in all
_STUCK = 2_000  # tests without a gain: an end
_FOLLOWED = ((6, 20), (15, 5), (30, 2))  # rounds in which so many tests, the best there are, are moved
_LED = 10  # moves of the best of all, before others are drawn: twice as many each time
_FIRST_STEP, _GROWS, _SHRINKS = 0.15, 1.4, 0.9  # of the numbers between 0 and 1
_SMALLEST, _LONGEST = 2e-3, 0.5
_MANY = 12  # numbers of a test: of more some are moved at a time, so that one axis changes while the others stay
_PARTS = (0.1, 0.3, 1.0)
_CANDIDATES = 6  # of a search, that are tried in full
_REDUCED = 0.95  # of a signal, where the result passes a limit
_TRIES = 12


@dataclass(frozen=True, slots=True, eq=False)
class Tried:
    """An evaluated test.

    Attributes:
        plan: None of a test that is given as records.
        score: of the goal, the smaller the better, see `Goal.score`.
        reached: of each axis the largest of each quantity, by name.
        over: largest factor by which a limit is exceeded, at most 1 if none is.
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
    """Objective of a search, and the limits of its tests.

    Attributes:
        model: of the joint or robot.
        goal: of a test.
        limits: of each axis.
        families: to search; empty if a test is given.
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
        """Judge a test by its predictions: mean score, and largest maxima.

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
        """Largest factor by which the limits are exceeded; 0 if none is."""
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
    """Complete limits from the present test; refuse if needed ones are missing."""
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


@dataclass(slots=True)
class _Line:
    """A test in the evolution strategy: family, numbers, objective and step length."""

    family: Family | Series
    u: FloatArray
    tried: Tried
    step: float = _FIRST_STEP

    def move(self, asked: Objective, rng: np.random.Generator) -> None:
        """Try two neighbouring tests, and move to the better if it improves."""
        moved = []
        for _ in range(2):
            which = rng.random(self.u.size) < rng.choice(_PARTS) if self.u.size > _MANY else True
            moved.append(np.clip(self.u + self.step * which * rng.standard_normal(self.u.size), 0.0, 1.0))
        tries = in_threads(lambda u: asked.try_plan(Plan(self.family, tuple(u)), than=self.tried), moved)
        first = min(range(2), key=lambda k: tries[k].rank)
        if tries[first].rank < self.tried.rank:
            self.u, self.tried, self.step = moved[first], tries[first], min(self.step * _GROWS, _LONGEST)
        else:
            self.step = max(self.step * _SHRINKS, _SMALLEST)


def search(
    asked: Objective, seconds: float, progress: Progress, *, seed: int = 0, clock: Callable[[], float] = time.monotonic
) -> Iterator[Tried]:
    """Yield improving tests, at least one, until time or progress ends.

    Args:
        asked: the search problem.
        seconds: time limit.
        progress: receives messages.
        seed: of the draws.
        clock: source of time, s.
    """
    ends, rng = clock() + seconds, np.random.default_rng(seed)
    reach = pace(progress, "looking for the most informative test", 100.0, "%")
    best: Tried | None = None
    last = 0
    for count, tried in enumerate(_try_all(asked, rng), start=1):
        if best is None or tried.rank < best.rank:
            best, last = tried, count
            yield best
        # On a busy machine the time may be over before any test that can be simulated was drawn.
        over = clock() > ends or count >= _MOST or count - last >= _STUCK
        if over and (count >= _FEWEST or math.isfinite(best.over)):
            break
        reach(min(100.0 * (1 - (ends - clock()) / seconds), 99.0))
    reach(100.0)


def _try_all(asked: Objective, rng: np.random.Generator) -> Iterator[Tried]:
    """Yield every evaluated test: random ones, then steps of the best."""
    leader: _Line | None = None
    led = _LED
    while True:
        lines: list[_Line] = []
        drawn = [(family, rng.uniform(size=family.size)) for _ in range(_DRAWN) for family in asked.families]
        for pair in (drawn[k : k + 2] for k in range(0, len(drawn), 2)):
            tries = in_threads(lambda one: asked.try_plan(Plan(one[0], tuple(one[1]))), pair)
            lines += [_Line(family, u, tried) for (family, u), tried in zip(pair, tries, strict=True)]
            yield from tries
        best: dict[Family | Series, _Line] = {}
        for line in sorted(lines, key=lambda line: line.tried.rank):
            best.setdefault(line.family, line)
        lines = list(best.values())
        for rounds, kept in _FOLLOWED:
            lines = sorted(lines, key=lambda line: line.tried.rank)[:kept]
            for line in [line for _ in range(rounds) for line in lines]:
                line.move(asked, rng)
                yield line.tried
        leader = min([line for line in (leader, *lines) if line is not None], key=lambda line: line.tried.rank)
        for _ in range(led):
            leader.move(asked, rng)
            yield leader.tried
        led *= 2


def find_best(asked: Objective, seconds: float, seed: int, progress: Progress) -> tuple[Tried, bool]:
    """Return the best test, and whether the search was interrupted.

    The last tests of a quick search are judged in full, since one that has to be reduced to keep the limits may be
    worse than its predecessor.

    Raises:
        MethodError: none could be simulated.
    """
    found, kept = list[Tried](), list[Tried]()
    interrupted = False
    try:
        for tried in search(replace(asked, model=asked.model.roughly(asked.goal)), seconds, progress, seed=seed):
            found.append(tried)
        if math.isinf(found[-1].over):
            raise MethodError(
                "No test could be simulated within these limits; check the limits, the controller and the values."
            )
        for tried in reversed(found[-_CANDIDATES:]):
            kept.append(_keep_within(asked, tried))
            if kept[-1].plan is tried.plan and kept[-1].over <= 1.0:
                break
    except KeyboardInterrupt:
        if not found:
            raise
        interrupted = True
        kept = kept or [_keep_within(asked, found[-1])]
    return min(kept, key=lambda tried: tried.rank), interrupted


def _keep_within(asked: Objective, best: Tried) -> Tried:
    """Reduce a test's signals until it keeps the limits."""
    assert best.plan is not None
    tried = asked.try_plan(best.plan, margin=1.0)
    for _ in range(_TRIES):
        if tried.over <= 1.0 or math.isinf(tried.over):
            break
        assert tried.plan is not None
        tried = asked.try_plan(tried.plan.scale(_REDUCED), margin=1.0)
    return tried
