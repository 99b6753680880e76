"""Search for the most informative test, over several families, within the axis limits.

A test is a family and numbers between 0 and 1. An `Objective` says what it tells, and what it reaches of each axis:
of a joint (`joint_tests`) or of a robot (`robot_tests`). A test that exceeds a limit ranks below all others, by the
excess. Random tests of every family start the search; the best of each and then the best of all take adaptive steps of
an evolution strategy (I. Rechenberg's one-fifth rule). New random tests are mixed in while time remains.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Protocol, Self

import numpy as np

from jointid.common.arrays import FloatArray
from jointid.common.errors import JointidError, MethodError
from jointid.common.messages import Progress, Work
from jointid.common.parallel import in_threads
from jointid.models.limits import AxisLimits, find_excess
from jointid.planning.goals import Goal
from jointid.planning.predict import PredictedTest

MARGIN = 0.97
"""Of each limit, that a test may reach in the search: other joints and other noise reach more."""
ASTRAY = 1e6
"""Score of a test that cannot be simulated, or does not tell every parameter."""

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
_CLEARLY = 0.02  # of a score: other joints change it by as much
_REDUCED = 0.95  # of a signal, where the result passes a limit
_TRIES = 12


class Plan(Protocol):
    """A test that can be made smaller."""

    def scale(self, factor: float) -> Self:
        """Return the test with smaller signals; itself where nothing can be scaled."""
        ...


class Family(Protocol):
    """One kind of test, as numbers between 0 and 1."""

    @property
    def size(self) -> int:
        """How many numbers say one of its tests."""
        ...


class Objective(Protocol):
    """What a search asks: tests of its families, and what each of them tells and reaches."""

    @property
    def families(self) -> Sequence[Any]:
        """Families to search."""
        ...

    def plan(self, family: Any, u: Sequence[float]) -> Any:
        """Return a family's test for numbers between 0 and 1."""
        ...

    def try_plan(self, plan: Any, *, margin: float = MARGIN, than: Tried | None = None) -> Tried:
        """Judge a test; see `judge`."""
        ...


@dataclass(frozen=True, slots=True, eq=False)
class Tried:
    """An evaluated test.

    Attributes:
        score: of the goal, the smaller the better, see `Goal.score`.
        reached: of each axis the largest of each quantity, by name.
        over: by how much the limit that is passed farthest is passed, at most 1 where none is.
        stds: (parameters,) standard deviations at each joint or robot, the known one first.
    """

    plan: Any
    score: float
    reached: tuple[Mapping[str, float], ...]
    over: float
    stds: tuple[FloatArray, ...] = ()

    @property
    def rank(self) -> tuple[float, float]:
        """Sort key: exceeded limits first."""
        return max(self.over, 1.0), self.score


def judge(
    plan: Any,
    each: Iterator[PredictedTest],
    count: int,
    goal: Goal,
    limits: Sequence[AxisLimits],
    *,
    margin: float = 1.0,
    than: Tried | None = None,
) -> Tried:
    """Judge a test by its predictions: the mean of their scores, and the largest of what they reach.

    Args:
        plan: the test.
        each: predictions of it at several joints or robots that it may be for, the known one first.
        count: of these.
        goal: that the score is of.
        limits: of each axis.
        margin: admissible share of each limit.
        than: a test to beat; where this one clearly loses at the first joint, the others are skipped.
    """
    scores, stds, reached = list[float](), list[FloatArray](), [dict[str, float]() for _ in limits]
    tried = Tried(plan, ASTRAY, (), math.inf)
    for _ in range(count):
        try:
            with np.errstate(all="ignore"):
                one = next(each)
        except (JointidError, np.linalg.LinAlgError):
            unknown = (*stds, np.full_like(stds[0], np.inf)) if stds else ()
            return Tried(plan, ASTRAY, tuple(reached), math.inf, unknown)
        for most, found in zip(reached, one.reached, strict=True):
            most.update({name: max(size, most.get(name, size)) for name, size in found.items()})
        scores.append(goal.score(one.covariance.matrix, one.joint, one.values))
        stds.append(one.covariance.std)
        score = min(float(np.mean(scores)), ASTRAY)
        tried = Tried(plan, score, tuple(reached), _worst_excess(limits, reached, margin), tuple(stds))
        if than is not None and tried.rank > (than.rank[0], than.score + _CLEARLY):
            break
    return tried


def _worst_excess(limits: Sequence[AxisLimits], reached: Sequence[Mapping[str, float]], margin: float) -> float:
    """Return the largest factor by which a share of the limits is exceeded; 0 where none is."""
    ends = ("lower", "upper")  # a position has no share
    factors = [0.0]
    for one, found in zip(limits, reached, strict=True):
        asked = {name: size if name in ends else size / margin for name, size in found.items()}
        factors += find_excess(one, asked).values()
    return max(factors)


@dataclass(slots=True)
class _Line:
    """A test in the evolution strategy: family, numbers, objective and step length."""

    family: Family
    u: FloatArray
    tried: Tried
    step: float = _FIRST_STEP

    def move(self, asked: Objective, rng: np.random.Generator) -> None:
        """Try two neighbouring tests, and move to the better one if it improves."""
        moved = []
        for _ in range(2):
            which = rng.random(self.u.size) < rng.choice(_PARTS) if self.u.size > _MANY else True
            moved.append(np.clip(self.u + self.step * which * rng.standard_normal(self.u.size), 0.0, 1.0))
        tries = in_threads(lambda u: asked.try_plan(asked.plan(self.family, list(u)), than=self.tried), moved)
        first = min(range(2), key=lambda k: tries[k].rank)
        if tries[first].rank < self.tried.rank:
            self.u, self.tried, self.step = moved[first], tries[first], min(self.step * _GROWS, _LONGEST)
        else:
            self.step = max(self.step * _SHRINKS, _SMALLEST)


def search(
    asked: Objective,
    begin: Sequence[Plan],
    seconds: float,
    progress: Progress,
    *,
    seed: int = 0,
    clock: Callable[[], float] = time.monotonic,
) -> Iterator[Tried]:
    """Yield ever better tests until the time is over, or many tests bring no gain; at least one.

    Args:
        asked: the search problem.
        begin: first tests to compare with, such as the present one.
        seconds: time limit.
        progress: receives messages.
        seed: of the draws.
        clock: source of time, s.
    """
    ends, rng = clock() + seconds, np.random.default_rng(seed)
    work = Work(progress, "looking for the test that tells most", 100.0, "%")
    best: Tried | None = None
    last = 0
    for count, tried in enumerate(_try_all(asked, begin, rng), start=1):
        if best is None or tried.rank < best.rank:
            best, last = tried, count
            yield best
        # On a busy machine the time may be over before any test that can be simulated was drawn.
        over = clock() > ends or count >= _MOST or count - last >= _STUCK
        if over and (count >= _FEWEST or math.isfinite(best.over)):
            break
        work.reach(min(100.0 * (1 - (ends - clock()) / seconds), 99.0))
    work.reach(100.0)


def _try_all(asked: Objective, begin: Sequence[Plan], rng: np.random.Generator) -> Iterator[Tried]:
    """Yield every evaluated test: given ones, random ones, then steps of the best."""
    yield from (asked.try_plan(plan) for plan in begin)
    leader: _Line | None = None
    led = _LED
    while True:
        lines: list[_Line] = []
        drawn = [(family, rng.uniform(size=family.size)) for _ in range(_DRAWN) for family in asked.families]
        for pair in (drawn[k : k + 2] for k in range(0, len(drawn), 2)):
            tries = in_threads(lambda one: asked.try_plan(asked.plan(one[0], list(one[1]))), pair)
            lines += [_Line(family, u, tried) for (family, u), tried in zip(pair, tries, strict=True)]
            yield from tries
        best: dict[Family, _Line] = {}
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


def look(
    asked: Objective, begin: Sequence[Plan], seconds: float, seed: int, progress: Progress
) -> tuple[list[Tried], bool]:
    """Return successively better tests, and whether the search was interrupted.

    Raises:
        MethodError: none could be simulated.
    """
    found: list[Tried] = []
    interrupted = False
    try:
        for tried in search(asked, begin, seconds, progress, seed=seed):
            found.append(tried)
    except KeyboardInterrupt:
        if not found:
            raise
        interrupted = True
    if not found or math.isinf(found[-1].over):
        raise MethodError(
            "No test could be simulated within these limits; check the limits, the controller and the values."
        )
    return found, interrupted


def choose(asked: Objective, found: Sequence[Tried], progress: Progress) -> tuple[Tried, bool]:
    """Return the best test by a full objective, and whether it was interrupted.

    A test that has to be reduced to keep the limits may be worse than its predecessor.
    """
    kept: list[Tried] = []
    last = found[-_CANDIDATES:]
    work = Work(progress, "trying the best of them in full", float(len(last)), "tests")
    try:
        for tried in reversed(last):
            kept.append(_keep_within(asked, tried))
            work.reach(float(len(kept)))
            if kept[-1].plan is tried.plan and kept[-1].over <= 1.0:
                break
    except KeyboardInterrupt:
        return min(kept or [found[-1]], key=lambda tried: tried.rank), True
    return min(kept, key=lambda tried: tried.rank), False


def _keep_within(asked: Objective, best: Tried) -> Tried:
    """Reduce a test's signals until it keeps the limits."""
    tried = asked.try_plan(best.plan, margin=1.0)
    for _ in range(_TRIES):
        smaller = tried.plan.scale(_REDUCED)
        if tried.over <= 1.0 or math.isinf(tried.over) or smaller is tried.plan:
            break
        tried = asked.try_plan(smaller, margin=1.0)
    return tried
