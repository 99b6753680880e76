"""Search for the most informative test, over several families, within the axis limits.

A test is a family and numbers between 0 and 1 (`plans`). It is simulated with noise at the rough joint and at others of
its interval; its objective is the mean, its maxima the largest. A test that exceeds a limit ranks below all others, by
the excess. Random tests of every family start the search; the best of each and then the best of all take adaptive
steps of an evolution strategy (I. Rechenberg's one-fifth rule). New random tests are mixed in while time remains.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from jointid.common.arrays import FloatArray
from jointid.common.errors import JointidError
from jointid.common.messages import Progress, Work
from jointid.common.parameters import Parameter
from jointid.models.joints import ClosedLoop
from jointid.models.limits import AxisLimits, find_excess
from jointid.planning.goals import Goal
from jointid.planning.plans import Family, Plan, Room, families_in
from jointid.planning.predict import (
    Noise,
    PredictedTest,
    RoughPrediction,
    planned_record,
    predict_roughly,
    predict_test,
)
from jointid.records.record import InjectionPoint, Record, Tap
from jointid.records.signals.filtering import Filtering
from jointid.simulation.closed_loop import in_threads

_MARGIN = 0.97  # of each limit, that a test may reach in the search: other joints and other noise reach more
_ASTRAY = 1e6  # a test that cannot be simulated
_CLEARLY = 0.02  # of a score: other joints change it by as much
_DRAWN = 6  # tests of each family, to begin with
_FEWEST = 40  # tests that are tried, though the time be over, until one can be simulated
_FOLLOWED = ((6, 20), (15, 5), (30, 2))  # rounds in which so many tests, the best there are, are moved
_LED = 10  # moves of the best of all, before others are drawn
_FIRST_STEP, _GROWS, _SHRINKS = 0.15, 1.4, 0.9  # of the numbers between 0 and 1
_SMALLEST, _LONGEST = 2e-3, 0.5


@dataclass(frozen=True, slots=True, eq=False)
class Purpose:
    """Purpose of a test.

    Attributes:
        joints: values of every parameter, one mapping a joint that it may be; first the one that is roughly known.
        goal: what the test is to tell.
        tap: where its torque will be logged.
    """

    loop: ClosedLoop
    joints: tuple[Mapping[str, float], ...]
    noise: Noise
    goal: Goal
    samples: int
    sample_time: float
    tap: Tap
    filtering: Filtering
    parameters: Mapping[str, Parameter]

    def predict(
        self, test: Record, *, motor_encoder: float | None = None, load_encoder: float | None = None
    ) -> PredictedTest:
        """Predict a test at the rough joint; see `predict_test`."""
        return predict_test(
            self.loop, self.joints[0], test, self.noise, filtering=self.filtering, parameters=self.parameters,
            motor_encoder=motor_encoder, load_encoder=load_encoder,
        )  # fmt: skip

    def predict_roughly(self, test: Record) -> Iterator[RoughPrediction]:
        """Predict a test at each joint; see `predict_roughly`."""
        return predict_roughly(
            self.loop, self.joints, test, self.noise, filtering=self.filtering, parameters=self.parameters
        )


@dataclass(frozen=True, slots=True, eq=False)
class Asked:
    """The search problem.

    Attributes:
        purpose: what the test is planned for.
        at, in_torque: where a signal is added, and whether the log contains it, see `Injection`.
    """

    purpose: Purpose
    limits: AxisLimits
    room: Room
    at: InjectionPoint = InjectionPoint.AFTER_LIMIT
    in_torque: bool = True

    def record(self, plan: Plan, samples: int | None = None) -> Record:
        """Return a test as a record for the drive."""
        reference, injected = plan.play(samples or self.purpose.samples, self.purpose.sample_time)
        return planned_record(
            self.purpose.loop, reference, self.purpose.sample_time, injected, at=self.at, in_torque=self.in_torque,
            tap=self.purpose.tap,
        )  # fmt: skip


@dataclass(frozen=True, slots=True, eq=False)
class Tried:
    """An evaluated test.

    Attributes:
        score: of the goal, the smaller the better, see `Goal.score`; the mean over the joints.
        reached: the largest of each quantity over the joints, by name.
        over: by how much the limit that is passed farthest is passed, at most 1 where none is.
    """

    plan: Plan
    score: float
    reached: Mapping[str, float]
    over: float

    @property
    def rank(self) -> tuple[float, float]:
        """Sort key: exceeded limits first."""
        return max(self.over, 1.0), self.score


def try_plan(asked: Asked, plan: Plan, *, margin: float = _MARGIN, than: Tried | None = None) -> Tried:
    """Evaluate a test at every joint.

    Args:
        asked: the search problem.
        plan: the test.
        margin: admissible share of each limit.
        than: a test to beat; if it clearly loses at the first joint, the others are skipped.
    """
    test = asked.record(plan)
    scores, most = [], dict[str, float]()
    tried = Tried(plan, _ASTRAY, most, math.inf)
    predictions = asked.purpose.predict_roughly(test)
    for values in asked.purpose.joints:
        try:
            with np.errstate(all="ignore"):
                one = next(predictions)
        except (JointidError, np.linalg.LinAlgError):
            return replace(tried, score=_ASTRAY, over=math.inf)
        scores.append(asked.purpose.goal.score(one.covariance, one.names, values))
        for name, size in one.reached.items():
            most[name] = max(most.get(name, 0.0), size)
        factors = find_excess(asked.limits, {name: size / margin for name, size in most.items()})
        tried = Tried(plan, float(np.mean(scores)), most, max(factors.values(), default=0.0))
        if than is not None and tried.rank > (than.rank[0], than.score + _CLEARLY):
            break
    return tried


@dataclass(slots=True)
class _Line:
    """A test in the evolution strategy: family, numbers, objective and step length."""

    family: Family
    u: FloatArray
    tried: Tried
    step: float = _FIRST_STEP

    def move(self, asked: Asked, rng: np.random.Generator) -> None:
        """Try two neighbouring tests, and move to the better one if it improves."""
        moved = [np.clip(self.u + self.step * rng.standard_normal(self.u.size), 0.0, 1.0) for _ in range(2)]
        tries = in_threads(lambda u: try_plan(asked, self.family.plan(list(u), asked.room), than=self.tried), moved)
        first = min(range(2), key=lambda k: tries[k].rank)
        if tries[first].rank < self.tried.rank:
            self.u, self.tried, self.step = moved[first], tries[first], min(self.step * _GROWS, _LONGEST)
        else:
            self.step = max(self.step * _SHRINKS, _SMALLEST)


def search(
    asked: Asked,
    begin: Sequence[Plan],
    seconds: float,
    progress: Progress,
    *,
    families: Sequence[Family] | None = None,
    seed: int = 0,
    clock: Callable[[], float] = time.monotonic,
) -> Iterator[Tried]:
    """Yield ever better tests until the time is over; at least one.

    Args:
        asked: the search problem.
        begin: first tests to compare with, such as the present one.
        seconds: time limit.
        progress: receives messages.
        families: to search; all possible ones when None.
        seed: of the draws.
        clock: source of time, s.
    """
    ends, rng = clock() + seconds, np.random.default_rng(seed)
    work = Work(progress, "looking for the test that tells most", 100.0, "%")
    best: Tried | None = None
    for count, tried in enumerate(_try_all(asked, begin, families or families_in(asked.room), rng), start=1):
        if best is None or tried.rank < best.rank:
            best = tried
            yield best
        # On a busy machine the time may be over before any test that can be simulated was drawn.
        if clock() > ends and (count >= _FEWEST or math.isfinite(best.over)):
            break
        work.reach(min(100.0 * (1 - (ends - clock()) / seconds), 99.0))
    work.reach(100.0)


def _try_all(
    asked: Asked, begin: Sequence[Plan], families: Sequence[Family], rng: np.random.Generator
) -> Iterator[Tried]:
    """Yield every evaluated test: given ones, random ones, then steps of the best."""
    yield from (try_plan(asked, plan) for plan in begin)
    leader: _Line | None = None
    while True:
        lines: list[_Line] = []
        drawn = [(family, rng.uniform(size=family.size)) for _ in range(_DRAWN) for family in families]
        for pair in (drawn[k : k + 2] for k in range(0, len(drawn), 2)):
            tries = in_threads(lambda one: try_plan(asked, one[0].plan(list(one[1]), asked.room)), pair)
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
        for _ in range(_LED):
            leader.move(asked, rng)
            yield leader.tried
