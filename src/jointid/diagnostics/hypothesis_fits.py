"""Identification of a joint under each fault hypothesis, for the residual of the torque.

Of each hypothesis the two best starts are followed for a few steps; those far behind the best hypothesis are given up,
the others converge. A flexible joint is first identified as rigid, far below its resonance, which shows a wrong sign or
size; only the remaining hypotheses are fitted to the whole band.
"""

from __future__ import annotations

import math
import time
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import takewhile

import numpy as np

from jointid.common.arrays import FloatArray
from jointid.common.errors import JointidError
from jointid.common.parallel import in_threads
from jointid.diagnostics.faults.fault import Hypothesis
from jointid.estimation.methods.drive_side import DriveSideProblem
from jointid.estimation.methods.stiffness_search import rigid_cutoff
from jointid.estimation.problems.base import DELAY, DELAYS, DRIVE_AND_LOG
from jointid.estimation.problems.closed_loop import ClosedLoopProblem, torque_problem
from jointid.estimation.starts.flexible_joint import frequencies_to_try, start_with_mode
from jointid.estimation.starts.rigid_joint import inversion_start, regular_start
from jointid.models.controllers import numbers_of, with_numbers
from jointid.models.joints import ClosedLoop, FlexibleJoint, Joint
from jointid.records.signals.filtering import Filtering
from jointid.solvers.bounded_least_squares import LevenbergMarquardt
from jointid.solvers.solve import Solution, solve

FIRST, MORE = 5, 12
"""Evaluations of the first part of a descent, and of the rest."""

ASTRAY = 3.0
"""Times the torque: a loop with such a residual runs away."""

_TOLERANCE = 1e-4  # of a fit that only has to show its residual
_STARTS = 2  # of a cause, that are followed
_BEHIND = 2.5  # times the least error: a cause with more after its first steps is given up
_NEAREST = 1.5  # times the least error: the descent of a cause with no more is followed to its end
_TO_ITS_END = 40  # evaluations, at most
_ROUGHLY = 0.05  # of the torque: additional residual of a rigid model of a flexible joint
_RANGE = 1e4  # times its start, up and down: bounds of a number
_SHARES = (0.35, 0.65)  # of the load in the inertia of a flexible joint
_NEAR = (0.5, 1.0, 2.0)  # times the number of the rigid joint, which is approximate
_FEW = 10  # loops of a hypothesis, which are all tried then
_APART = 2  # one of so many frequencies of the grid is tried


@dataclass(frozen=True, slots=True, eq=False)
class Fit:
    """Solution under a hypothesis: problem with its number free, parameters, and residual share of the torque."""

    hypothesis: Hypothesis
    problem: ClosedLoopProblem
    x: FloatArray
    error: float

    @property
    def values(self) -> dict[str, float]:
        """The value of every parameter."""
        return self.problem.values(self.x)

    @property
    def number(self) -> float | None:
        """The corrected number; None if the hypothesis has none."""
        name, chosen, factor = self.hypothesis.free, self.hypothesis.number, self.hypothesis.factor
        if chosen is not None:  # that of the start which ended best
            return chosen(self.problem)
        return (factor or 1.0) * self.values[name] if name else factor


def fit_rigid(tried: Sequence[Hypothesis], joint: Joint, loss: float = 0.0, until: float = math.inf) -> list[Fit]:
    """Fit a rigid joint under each hypothesis; one that is worse by less than the share `loss` is not given up.

    What is not begun by `until`, in seconds of `time.process_time`, is left out, and descents end there.
    """

    def begin(hypothesis: Hypothesis) -> list[Fit]:
        loops = [replace(loop, joint=joint) for loop in hypothesis.loops]
        problems = [p for loop in loops if (p := pose(hypothesis, loop)) is not None]
        starts = (
            start_at(hypothesis, p, p.vector({**values, **late}))
            for p in problems
            for values in _rigid_starts(p)
            for late in _delays_to_try(p)
        )
        return _choose_best(starts, until)

    return _race(in_threads(begin, tried), loss, until)


def fit_below_resonance(tried: Sequence[Hypothesis], joint: FlexibleJoint, until: float = math.inf) -> list[Fit]:
    """Fit a flexible joint as rigid, far below its resonance, under each hypothesis; see `fit_rigid`."""
    low = []
    for one in tried:
        assert one.record.torque is not None
        period = one.record.torque.sample_time
        low.append(replace(one, filtering=Filtering(cutoff=rigid_cutoff(one.record)).resolve(period)))
    return fit_rigid(low, joint.rigid, _ROUGHLY, until)


def fit_flexible(tried: Sequence[Hypothesis], loop: ClosedLoop, until: float = math.inf) -> list[Fit]:
    """Fit a flexible joint under the hypotheses that a rigid one does not exclude far below the resonance."""
    assert isinstance(loop.joint, FlexibleJoint)
    wide = {(one.fault, one.factor, one.free): one for one in tried}
    fits = fit_below_resonance(tried, loop.joint, until)
    possible = [(fit, wide[fit.hypothesis.fault, fit.hypothesis.factor, fit.hypothesis.free]) for fit in fits]
    least = min((fit.error for fit, _ in possible), default=math.inf)

    def list_starts(rigid: Fit, hypothesis: Hypothesis) -> Iterator[Fit]:
        for problem in (pose(hypothesis, one) for one in _loops_near(hypothesis, rigid)):
            if problem is None:
                continue
            law, sample_time = problem.axis.law, problem.axis.sample_time
            for hertz in frequencies_to_try(law, rigid.values["inertia"], sample_time)[::_APART]:
                for share in _SHARES:
                    start = start_with_mode(problem, rigid.values, hertz, share)
                    for late in _delays_to_try(problem):
                        yield start_at(hypothesis, problem, problem.vector({**start, **late}))

    left = [pair for pair in possible if pair[0].error <= max(_BEHIND * least, least + _ROUGHLY)]
    return _race(in_threads(lambda pair: _choose_best(list_starts(*pair), until), left), 0.0, until)


def _loops_near(hypothesis: Hypothesis, rigid: Fit) -> tuple[ClosedLoop, ...]:
    """Return the loops of the starts: with numbers near that of the rigid joint, and a few others."""
    name, first = hypothesis.free, hypothesis.loops[0]
    if name not in hypothesis.numbers:
        return hypothesis.loops
    numbers = [rigid.values[name] * by for by in _NEAR]
    near = [replace(first, controller=with_numbers(first.controller, {name: one})) for one in numbers]
    return (*near, *(hypothesis.loops if len(hypothesis.loops) <= _FEW else ()))


def pose(hypothesis: Hypothesis, loop: ClosedLoop) -> ClosedLoopProblem | None:
    """Return the problem of a hypothesis with one of its loops, its number fixed; None if there is none."""
    around = [one for one in hypothesis.beside if one in DRIVE_AND_LOG or one in numbers_of(loop.controller)]
    try:
        problem = torque_problem(hypothesis.record, loop, hypothesis.filtering, loop.joint.parameters)
        return problem.keeping({"initial_velocity": 0.0}).freeing(*around)
    except JointidError:
        return None


def _delays_to_try(problem: ClosedLoopProblem) -> Iterator[dict[str, float]]:
    """Yield values of a free delay where none is declared, or once none."""
    undeclared = any(p.name == DELAY and p.free and not p.start for p in problem.parameters)
    yield from ({DELAY: late} for late in DELAYS) if undeclared else ({},)


def _rigid_starts(problem: ClosedLoopProblem) -> Iterator[dict[str, float]]:
    """Yield starts by the inverted controller, and by a motor that follows the reference exactly."""
    for start in (inversion_start, regular_start):
        try:
            values = dict(start(problem).values)
        except JointidError:
            continue
        values["inertia"] = abs(values["inertia"])
        for p in problem.free_joint:
            values[p.name] = min(max(values[p.name], p.lower), p.upper)
        yield values


def start_at(hypothesis: Hypothesis, problem: ClosedLoopProblem, x: FloatArray) -> Fit:
    """Return a start with its residual share of the torque."""
    if problem.size == 0.0:  # a torque that the filter removes
        return Fit(hypothesis, problem, x, math.inf)
    with np.errstate(all="ignore"):  # a loop that runs away
        left = float(np.linalg.norm(problem.residual(x))) / problem.size
    return Fit(hypothesis, problem, x, left if math.isfinite(left) else math.inf)


def _choose_best(starts: Iterable[Fit], until: float) -> list[Fit]:
    """Return the few best starts of a hypothesis, with its number free."""
    in_time = takewhile(lambda _: time.process_time() < until, starts)
    best = sorted((one for one in in_time if one.error < ASTRAY), key=lambda one: one.error)[:_STARTS]
    free = []
    for fit in best:
        name = fit.hypothesis.free
        problem = fit.problem if name is None else fit.problem.freeing(name)
        for number in (p for p in problem.parameters if p.name == name):
            start = number.start or 0.0
            wide = replace(number, lower=start / _RANGE, upper=start * _RANGE)
            problem = problem.replace_parameters({number.name: wide})
        free.append(replace(fit, problem=problem, x=problem.vector(fit.values)))
    return free


def _race(started: Sequence[list[Fit]], loss: float, until: float) -> list[Fit]:
    """Return the solutions, the best first; a hypothesis far behind the best one is given up early."""

    def go_on(fit: Fit, evaluations: int) -> Fit | None:
        return descend(fit, evaluations) if time.process_time() < until else fit

    first = [list(filter(None, in_threads(lambda fit: go_on(fit, FIRST), starts))) for starts in started]
    least = min((fit.error for fits in first for fit in fits), default=math.inf)
    bound = max(_BEHIND * least, least + loss)
    ends = []
    for fits in first:
        if not fits:
            continue
        best = min(fits, key=lambda fit: fit.error)
        if best.error <= bound:
            best = min((go_on(fit, MORE) or fit for fit in fits if fit.error <= bound), key=lambda fit: fit.error)
        ends.append(best)
    nearest = min((fit.error for fit in ends), default=0.0) * _NEAREST
    far = [fit for fit in ends if fit.error > nearest]
    near = [fit for fit in ends if fit.error <= nearest]  # to their minima, where their numbers can be stated
    further = [min(fit, go_on(fit, _TO_ITS_END) or fit, key=lambda one: one.error) for fit in near]
    return sorted((*further, *far), key=lambda fit: fit.error)


def follow(problem: ClosedLoopProblem | DriveSideProblem, x: FloatArray, evaluations: int) -> Solution:
    """Solve with a limited number of evaluations."""
    return solve(problem, LevenbergMarquardt(_TOLERANCE, evaluations), x)


def descend(fit: Fit, evaluations: int) -> Fit | None:
    """Return the fit after a limited descent; None if it fails."""
    try:
        with np.errstate(all="ignore"):
            solution = follow(fit.problem, fit.x, evaluations)
    except (JointidError, np.linalg.LinAlgError):  # a loop that runs away, or a part of the law that vanishes
        return None
    error = float(np.linalg.norm(solution.residual)) / fit.problem.size
    return replace(fit, x=solution.x, error=error) if error < ASTRAY else None
