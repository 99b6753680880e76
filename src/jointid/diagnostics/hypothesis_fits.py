"""Identify a joint again under each hypothesis of what is wrong, to see what that leaves of the torque.

All of them begin, few are carried on. Of the starts of a hypothesis the two that leave least are followed for a few
steps; those that are then far behind the best one are given up, the others go on to the end. A flexible joint is first
identified as rigid, far below its resonance, which says what has the wrong sign or size; only what is left then is
fitted to the whole band.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from jointid.common.arrays import FloatArray, triangle
from jointid.common.errors import JointidError
from jointid.common.parameters import Parameter
from jointid.diagnostics.faults.fault import Hypothesis
from jointid.estimation.methods.stiffness_search import RIGID_CUTOFF
from jointid.estimation.problems.closed_loop import ClosedLoopProblem, torque_problem
from jointid.estimation.problems.prescribed import DriveSideProblem
from jointid.estimation.starts.flexible_joint import frequencies_to_try, start_with_mode
from jointid.estimation.starts.rigid_joint import inversion_start, regular_start
from jointid.models.controllers import numbers_of, with_numbers
from jointid.models.joints import ClosedLoop, FlexibleJoint, Joint
from jointid.records.signals.filtering import Filtering
from jointid.simulation.closed_loop import in_threads
from jointid.solvers.bounded_least_squares import LevenbergMarquardt
from jointid.solvers.solve import Solution, solve

FIRST, MORE = 5, 12
"""Evaluations of a descent that begins, and of one that goes on."""

ASTRAY = 3.0
"""Times the torque: a loop that leaves so much runs away."""

_TOLERANCE = 1e-4  # of a fit that only has to show what is left
_STARTS = 2  # of a cause, that are followed
_BEHIND = 2.5  # times the least error: a cause that leaves more, after its first steps, is given up
_ROUGHLY = 0.05  # of the torque: as much more is left by a rigid model of a flexible joint, whatever is the cause
_AWAY = 1e50  # a derivative so large is of a loop that runs away
_RANGE = 1e4  # times its start, up and down: where a number is looked for
_SHARES = (0.35, 0.65)  # of the load in the inertia of a flexible joint
_NEAR = (0.5, 1.0, 2.0)  # times the number that a rigid joint gives, which says it only roughly
_FEW = 6  # loops of a hypothesis, which are all tried then
_APART = 2  # one of so many frequencies of the grid is tried


@dataclass(frozen=True, slots=True, eq=False)
class Fit:
    """Where a hypothesis stands: its problem with its number free, the parameters, and the share that is left."""

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
        """The number that was put right, as it was found; None where the hypothesis has none."""
        name, chosen = self.hypothesis.free, self.hypothesis.number
        if chosen is not None:  # that of the start which ended best
            return chosen(self.problem)
        return self.values[name] if name else self.hypothesis.factor


def fit_rigid(tried: Sequence[Hypothesis], joint: Joint, loss: float = 0.0) -> list[Fit]:
    """Return where the hypotheses end with a rigid joint; a share as large as `loss` is no reason to give one up."""

    def begun(hypothesis: Hypothesis) -> list[Fit]:
        loops = [replace(loop, joint=joint) for loop in hypothesis.loops]
        problems = [p for loop in loops if (p := pose(hypothesis, loop)) is not None]
        return _best(start_at(hypothesis, p, p.vector(values)) for p in problems for values in _rigid_starts(p))

    return _race(in_threads(begun, tried), loss)


def fit_flexible(tried: Sequence[Hypothesis], loop: ClosedLoop) -> list[Fit]:
    """Return where the hypotheses end with a flexible joint, from what a rigid one leaves far below its resonance."""
    assert isinstance(loop.joint, FlexibleJoint)
    fits = fit_rigid([replace(one, filtering=_low(one)) for one in tried], loop.joint.rigid, _ROUGHLY)
    wide = {(one.fault, one.factor, one.free): one for one in tried}
    least = min((fit.error for fit in fits), default=math.inf)

    def begun(rigid: Fit) -> list[Fit]:
        of = rigid.hypothesis
        hypothesis = wide[of.fault, of.factor, of.free]
        problems = [pose(hypothesis, one) for one in _loops_near(hypothesis, rigid)]
        return _best(
            start for p in problems if p is not None for start in _flexible_starts(hypothesis, p, rigid.values)
        )

    left = [fit for fit in fits if fit.error <= max(_BEHIND * least, least + _ROUGHLY)]
    return _race(in_threads(begun, left), 0.0)


def _loops_near(hypothesis: Hypothesis, rigid: Fit) -> tuple[ClosedLoop, ...]:
    """Return the loops to begin from: with the number that the rigid joint gives, or near it, and a few others."""
    name, first = hypothesis.free, hypothesis.loops[0]
    if name is None:
        return hypothesis.loops
    numbers = [rigid.values[name] * by for by in _NEAR]
    near = [replace(first, controller=with_numbers(first.controller, {name: one})) for one in numbers]
    return (*near, *(hypothesis.loops if len(hypothesis.loops) <= _FEW else ()))


def _flexible_starts(hypothesis: Hypothesis, problem: ClosedLoopProblem, rigid: Mapping[str, float]) -> Iterator[Fit]:
    """Yield starts of a flexible joint: a rigid one's values, divided between the sides, with modes of a grid."""
    law, sample_time = problem.experiment.law, problem.experiment.sample_time
    for hertz in frequencies_to_try(law, rigid["inertia"], sample_time)[::_APART]:
        for share in _SHARES:
            yield start_at(hypothesis, problem, problem.vector(start_with_mode(problem, rigid, hertz, share)))


def _low(hypothesis: Hypothesis) -> Filtering:
    assert hypothesis.record.torque is not None
    sample_time = hypothesis.record.torque.sample_time
    return Filtering(cutoff=RIGID_CUTOFF / sample_time).resolve(sample_time)


def pose(hypothesis: Hypothesis, loop: ClosedLoop) -> ClosedLoopProblem | None:
    """Return the problem of a hypothesis with one of its loops, its number held; None where it has none."""
    try:
        problem = torque_problem(hypothesis.record, loop, hypothesis.filtering, loop.joint.parameters)
    except JointidError:
        return None
    return problem.keeping({"initial_velocity": 0.0})


def _rigid_starts(problem: ClosedLoopProblem) -> Iterator[dict[str, float]]:
    """Yield starts: from the controller turned round, and from a motor that is where the reference asks it to be."""
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
    """Return a start, with the share of the torque that it leaves."""
    if problem.size == 0.0:  # a torque of which the filter leaves nothing
        return Fit(hypothesis, problem, x, math.inf)
    with np.errstate(all="ignore"):  # a loop that runs away
        left = float(np.linalg.norm(problem.residual(x))) / problem.size
    return Fit(hypothesis, problem, x, left if math.isfinite(left) else math.inf)


def _best(starts: Iterable[Fit]) -> list[Fit]:
    """Return the few starts of a hypothesis that leave least, with its number free."""
    found = sorted((one for one in starts if one.error < ASTRAY), key=lambda one: one.error)[:_STARTS]
    return [_freed(one) for one in found]


def _freed(fit: Fit) -> Fit:
    name = fit.hypothesis.free
    if name is None:
        return fit
    start = numbers_of(fit.problem.loop.controller)[name]
    problem = fit.problem.freeing(name)
    bounded = {
        p.name: replace(p, lower=start / _RANGE, upper=start * _RANGE) for p in problem.parameters if p.name == name
    }
    problem = problem.changed(bounded)
    return replace(fit, problem=problem, x=problem.vector(fit.values | {name: start}))


def _race(started: Sequence[list[Fit]], loss: float) -> list[Fit]:
    """Return where each hypothesis ends that is not given up on the way, the best first."""
    first = [list(filter(None, in_threads(lambda fit: descend(fit, FIRST), starts))) for starts in started]
    least = min((fit.error for fits in first for fit in fits), default=math.inf)
    bound = max(_BEHIND * least, least + loss)
    ends = []
    for fits in first:
        if not fits:
            continue
        best = min(fits, key=lambda fit: fit.error)
        if best.error <= bound:
            best = min((descend(fit, MORE) or fit for fit in fits if fit.error <= bound), key=lambda fit: fit.error)
        ends.append(best)
    return sorted(ends, key=lambda fit: fit.error)


@dataclass(frozen=True, slots=True, eq=False)
class _Condensed:
    """A problem in as many rows as it has parameters, and one: the triangle of its slopes beside its residual.

    Every product that a descent asks for is the same; a loop that runs away has no way down.
    """

    problem: ClosedLoopProblem | DriveSideProblem

    @property
    def free(self) -> tuple[Parameter, ...]:
        return self.problem.free

    def residual(self, x: FloatArray) -> FloatArray:
        return self.linearise(x)[0]

    def linearise(self, x: FloatArray) -> tuple[FloatArray, FloatArray]:
        error, slopes = self.problem.linearise(x)
        both = np.column_stack([slopes, error])
        if not np.max(np.abs(both)) < _AWAY:
            return np.full(x.size + 1, _AWAY), np.zeros((x.size + 1, x.size))
        rows = triangle(both)
        return rows[:, -1], rows[:, :-1]


def follow(problem: ClosedLoopProblem | DriveSideProblem, x: FloatArray, evaluations: int) -> Solution:
    """Return where so many evaluations lead down from a start."""
    return solve(_Condensed(problem), LevenbergMarquardt(_TOLERANCE, evaluations), x)


def descend(fit: Fit, evaluations: int) -> Fit | None:
    """Return where a descent leads; None where there is none."""
    try:
        with np.errstate(all="ignore"):
            solution = follow(fit.problem, fit.x, evaluations)
    except (JointidError, np.linalg.LinAlgError):  # a loop that runs away, or a part of the law that vanishes
        return None
    error = float(np.linalg.norm(solution.residual)) / fit.problem.size
    return replace(fit, x=solution.x, error=error) if error < ASTRAY else None
