"""Whether a record shows a joint's spring at all; where it does not, how soft the spring could be.

A search always ends somewhere, and its end has a stiffness. That number is reported only when

- the flexible joint explains the torque significantly better than a rigid one, by a test made for a compliance that
  cannot be negative (`uncertainty.model_tests`);
- what it explains is more than the error that repeats with the motion and remains: a model that lacks more than the
  spring gives may as well have made the spring up;
- inertias and stiffness are told from 0, and the mode is one that a log of this rate can follow;
- starts apart led to the same end;
- the profile of the compliance 1/K12 is bounded on both sides.

Otherwise the record says only how soft the spring may be. Low frequencies bound ZZ2^2/K12, and a mode in the band would
ring, so the bound is a function of the load's share of the inertia, which is not known either. For one such share
joints from soft to stiff are tried, with inertia, friction and offset fitted anew, until one is as good as the best but
for what the noise allows. The bounds are for a lightly damped mode (a heavily damped one would look rigid, too) and for
friction on the motor's side: friction on the load's, behind a spring, only lags at reversals, as real friction does
without any spring.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from jointid.common.arrays import FloatArray
from jointid.common.messages import Message
from jointid.common.progress import Progress, silent
from jointid.estimation.problems.closed_loop import ClosedLoopProblem
from jointid.estimation.result.build_estimate import find_lost
from jointid.estimation.search.flexible_search import FASTEST, crossover, frequency_of
from jointid.estimation.search.history import History, least_squares
from jointid.models.joints import FlexibleJoint, split_by_mode
from jointid.models.parameters import Parameter, Quantity
from jointid.records.signals.filtering import Filtering
from jointid.simulation.closed_loop import in_threads
from jointid.simulation.loop_input import ClosedLoop
from jointid.solvers.solve import Bounds, Solution, solve
from jointid.solvers.trust_region import TrustRegion
from jointid.uncertainty.covariance import robust, white
from jointid.uncertainty.model_tests import flexible_against_rigid
from jointid.uncertainty.position_dependent_error import Uncertainty, uncertainty
from jointid.uncertainty.profile import profile_compliance
from jointid.uncertainty.verdict import Reason, Status, StiffnessBound, Subject, Verdict

SHARES = (0.05, 0.1, 0.2, 0.33, 0.5)
"""Of the load in the inertia, for which a bound is given."""

_TEST_SHARES = (0.1, 0.33, 0.6)
# Times the cut-off, with each of those shares: the best counts, in every draw of the test as in the record. A mode
# rings for 1 / (4 pi damping) periods, so that a coarser grid misses the one that is there; the last is a compliance.
_TEST_MODES = (*(0.3 * 1.08**i for i in range(16)), 2.5)
_FAR = 0.5  # of the rigid joint's sum of squares: what chance cannot make of it with a few parameters more
_TIGHT = 0.2  # of the stiffness: a 2-sigma interval this narrow needs no profile

# Of the bounds
_BAND = 0.15  # of the sampling frequency, in which a bound is looked for: modes above the fitted band show there
_SOFTEST, _STIFFEST = 0.5, 6.0  # modes that are tried, times the crossover of the loop and the fitted band
_STEPS = 10  # between them
_HALVINGS = 3  # of the last step
_SOLVER = TrustRegion(1e-4, evaluations=6, cost_tolerance=1e-5, eager=False)
_QUANTILE = 2.706  # of chi-square with one degree of freedom, at 90 %: one side of it is passed by one in twenty


@dataclass(frozen=True, slots=True, eq=False)
class Visibility:
    """What a record shows of a joint's spring.

    Attributes:
        verdict: whether its stiffness is reported, and why not.
        rigid: values of the rigid joint on the same band. rigid_std: standard deviations of those that were free.
        rigid_error: (rows,) what it leaves.
        bounds: where the stiffness is refused.
        simulations: that all this took.
    """

    verdict: Verdict
    rigid: Mapping[str, float]
    rigid_std: Mapping[str, float]
    rigid_error: FloatArray
    bounds: tuple[StiffnessBound, ...]
    simulations: int

    @property
    def shown(self) -> bool:
        """Whether the stiffness is reported."""
        return self.verdict.status is Status.PASSED


def visible(
    problem: ClosedLoopProblem,
    x: FloatArray,
    known: Uncertainty,
    together: tuple[int, int],
    progress: Progress,
    shares: Sequence[float] = SHARES,
) -> Visibility:
    """Return whether a record shows the spring of an estimate, or else how soft it may be.

    Args:
        problem: of the flexible joint, as it was solved.
        x: its free parameters.
        known: how well.
        together: how many of how many starts led to the estimate.
        progress: is told.
        shares: of the load in the inertia, for which bounds are looked for.
    """
    rigid, at = _fit_rigid(problem, problem.values(x))
    error, J = rigid.linearised(at.x)
    where = rigid.cells(rigid.simulate(at.x))
    remains = problem.residual(x)
    left = float(remains @ remains)
    # Where every spring on the rigid joint makes the loop unstable, the one that was found is the one to test.
    springs = _springs(problem, rigid.values(at.x), error) or [(remains - error)[:, np.newaxis]]
    # So far from the rigid joint a linear step towards the spring finds nothing; what the fit itself gained counts.
    fitted = left if left < _FAR * float(error @ error) else None
    test = flexible_against_rigid(error, J, springs, where, fitted)
    runs = at.evaluations + 4 + len(_TEST_SHARES) * len(_TEST_MODES)
    reasons = [] if test.significant else [str(test)]
    reasons += _doubts(problem, x, known, error, together)
    if not reasons:
        used, reasons = _follow_compliance(problem, x, known)
        runs += used
    values, bounds = rigid.values(at.x), list[StiffnessBound]()
    if reasons:
        progress("the record does not show the spring; looking how soft it may be")
        for share in shares:
            bound, used = _bound(problem, values, share, frequency_of(problem.values(x)))
            bounds.append(bound)
            runs += used
        reasons[0] = f"not identifiable from this record: {reasons[0]}"
        refused = tuple(Message(Reason.STIFFNESS_NOT_SHOWN, reason) for reason in reasons)
        verdict = Verdict(Subject.STIFFNESS, Status.FAILED, refused)
    else:
        verdict = Verdict(Subject.STIFFNESS, Status.PASSED, (Message(Reason.STIFFNESS_SHOWN, str(test)),))
    names = [p.name for p in rigid.free]
    judged = uncertainty(J, J, error, where, names)
    std = dict(zip(names, map(float, judged.covariance.std), strict=True))
    return Visibility(verdict, values, std, error, tuple(bounds), runs)


def _doubts(
    problem: ClosedLoopProblem, x: FloatArray, known: Uncertainty, rigid_error: FloatArray, together: tuple[int, int]
) -> list[str]:
    """Return why the spring that was found is not to be believed, whatever a test says."""
    found = []
    left = float(np.sum(problem.residual(x) ** 2))
    gained, repeated = float(np.sum(rigid_error**2)) - left, known.repeatable.share * left
    if known.repeatable.significant and gained < repeated:
        found.append(
            f"the spring explains {100 * gained / left:.2g} % of what remains, less than the "
            f"{100 * repeated / left:.2g} % of it that repeats with the motion and no noise explains: it may stand for "
            "something else"
        )
    found += [f"the interval of {name} holds 0" for name in find_lost(problem.free, x, known.covariance.std)]
    mode, reach = frequency_of(problem.values(x)), FASTEST / problem.experiment.sample_time
    if mode > reach:
        found.append(f"the mode that was found, at {mode:.3g} Hz, is faster than a log of this rate can follow")
    if together[1] > 1 and together[0] < 2:
        found.append(f"of {together[1]} starts no two led to the same flexible joint")
    return found


def _fit_rigid(problem: ClosedLoopProblem, values: Mapping[str, float]) -> tuple[ClosedLoopProblem, Solution]:
    """Return the problem of a rigid joint on the same band, and its solution."""
    flexible = problem.joint
    assert isinstance(flexible, FlexibleJoint)
    joint = flexible.rigid
    surroundings = problem.parameters[len(flexible.parameters) :]
    loop = ClosedLoop(joint, problem.loop.controller)
    rigid = replace(problem, loop=loop, parameters=(*joint.parameters, *surroundings))
    start = {p.name: values[p.name] for p in surroundings}
    for p in joint.parameters:  # the sum of both sides
        start[p.name] = values[p.name] if p.name in values else values[f"motor_{p.name}"] + values[f"load_{p.name}"]
    return rigid, History(silent).solve(rigid, least_squares(rigid, 1e-8), rigid.vector(start)).solution


def _springs(problem: ClosedLoopProblem, rigid: Mapping[str, float], error: FloatArray) -> list[FloatArray]:
    """Return what springs would do to the residual, each (rows, 1), at some load shares and modes."""
    cutoff = problem.filtering.cutoff
    assert cutoff is not None
    free = problem.all_free()

    def bent(at: tuple[float, float]) -> FloatArray:
        values = {p.name: rigid.get(p.name, 0.0) for p in problem.parameters}
        # Its friction is on the motor's side.
        values |= {f"motor_{name}": value for name, value in rigid.items() if f"motor_{name}" in values}
        values |= split_by_mode(rigid["inertia"], at[0], at[1] * cutoff)
        return free.residual(np.array([values[p.name] for p in free.parameters]))

    tried = in_threads(bent, list(itertools.product(_TEST_SHARES, _TEST_MODES)))
    size = 10 * float(np.linalg.norm(problem.filtered(problem.measured)))
    return [(one - error)[:, np.newaxis] for one in tried if np.linalg.norm(one) < size]  # the others are unstable


def _follow_compliance(problem: ClosedLoopProblem, x: FloatArray, known: Uncertainty) -> tuple[int, list[str]]:
    """Return the simulations of a profile of the compliance, and what is wrong with it; of a narrow interval, none."""
    names = [p.name for p in problem.free]
    if "stiffness" not in names:
        return 0, []
    at = names.index("stiffness")
    std, value = float(known.covariance.std[at]), float(x[at])
    if 2 * std <= _TIGHT * value:
        return 0, []
    found = profile_compliance(problem, x, known.covariance, problem.joint.unit)
    if found.bounded:
        return found.evaluations, []
    side = "stiff" if found.interval[0] is None else "soft"
    return found.evaluations, [f"the profile of the compliance has no end on its {side} side ({found})"]


# How soft the spring may be


@dataclass(frozen=True, slots=True, eq=False)
class _AtMode:
    """A flexible problem with its load share and its mode held, lightly damped, its friction on the motor's side.

    Free are the whole inertia, and what is free beside inertias, spring, damper and the load's friction.
    """

    problem: ClosedLoopProblem
    share: float
    mode: float

    @property
    def free(self) -> tuple[Parameter, ...]:
        """The whole inertia, then the others."""
        whole = Parameter("inertia", "ZZ", Quantity.INERTIA, lower=1e-300)
        return whole, *(p for p in self.problem.free if not _is_held(p))

    def values(self, x: FloatArray) -> dict[str, float]:
        """Return every parameter of the flexible problem."""
        values = {p.name: (p.start or 0.0) if not p.free else 0.0 for p in self.problem.parameters}
        values |= dict(zip((p.name for p in self.free[1:]), map(float, x[1:]), strict=True))
        return values | split_by_mode(float(x[0]), self.share, self.mode)

    def residual(self, x: FloatArray) -> FloatArray:
        """Return the residual, (rows,)."""
        problem = self.problem.all_free()
        return problem.residual(problem.vector(self.values(x)))

    def linearised(self, x: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the residual, (rows,), and its derivatives, (rows, free)."""
        problem = self.problem.all_free()
        error, J = problem.linearised(problem.vector(self.values(x)))
        if not np.isfinite(np.vdot(J, J)):
            # The derivatives of a diverging loop overflow when they are squared; there is no way down from it.
            return error, np.zeros((error.size, len(self.free)))
        by = {p.name: J[:, i] for i, p in enumerate(problem.free)}
        whole = sum(part * by[name] for name, part in split_by_mode(1.0, self.share, self.mode).items())
        return error, np.column_stack([whole, *(by[p.name] for p in self.free[1:])])


def _is_held(p: Parameter) -> bool:
    return p.name.startswith("load_") or p.name in ("motor_inertia", "stiffness", "damping")


def _solve_held(held: _AtMode, start: FloatArray) -> Solution:
    """Return the best joint with its mode and share held; of an unstable loop, a cost beyond all others."""
    bounds = Bounds.of(held.free)
    inside = np.clip(start, bounds.lower + 1e-6 * np.abs(start), bounds.upper - 1e-6 * np.abs(start))
    return solve(held, _SOLVER, inside)


def _bound(
    problem: ClosedLoopProblem, rigid: Mapping[str, float], share: float, found: float
) -> tuple[StiffnessBound, int]:
    """Return the softest spring at a load share, and the simulations it took to find.

    The mode that a search found, though refused, is tried beside the others: between two of them it would be missed,
    and a bound above it stated.

    Args:
        problem: of the flexible joint, as it was solved.
        rigid: every parameter of a rigid joint on the same band, and of what surrounds it.
        share: of the load in the inertia.
        found: Hz, free-free, of the mode that was found.
    """
    sample_time, law, cutoff = problem.experiment.sample_time, problem.experiment.law, problem.filtering.cutoff
    assert cutoff is not None
    band = Filtering(cutoff=max(_BAND / sample_time, cutoff)).resolved(sample_time, "flexible")
    wide = replace(problem, filtering=band)
    high = _STIFFEST * cutoff
    low = min(_SOFTEST * crossover(law, rigid["inertia"]), 0.5 * high)
    modes = sorted({*map(float, np.geomspace(low, high, _STEPS)), *([found] if low < found < high else [])})
    stiff = _AtMode(wide, share, high)
    named = {f"motor_{name}": value for name, value in rigid.items()} | dict(rigid)
    ends: dict[float, Solution] = {}
    costs: dict[float, float] = {}
    x = np.array([named[p.name] for p in stiff.free])
    for mode in reversed(modes):  # from what is nearly rigid, each from the last
        ends[mode] = end = _solve_held(_AtMode(wide, share, mode), x)
        costs[mode] = float(end.residual @ end.residual)
        x = end.x if costs[mode] < 2 * costs[high] else ends[high].x
    limit = min(costs.values()) + _threshold(stiff, ends[high].x)
    runs = sum(end.evaluations for end in ends.values()) + 2
    softest = next(mode for mode in modes if costs[mode] <= limit)
    if softest == low:
        return StiffnessBound(share, None, None), runs
    rejected = modes[modes.index(softest) - 1]
    x = ends[softest].x
    for _ in range(_HALVINGS):
        middle = math.sqrt(rejected * softest)
        end = _solve_held(_AtMode(wide, share, middle), x)
        runs += end.evaluations
        rejected, softest = (rejected, middle) if float(end.residual @ end.residual) <= limit else (middle, softest)
    reduced = share * (1 - share) * rigid["inertia"]
    return StiffnessBound(share, reduced * (2 * math.pi * rejected) ** 2, rejected), runs


def _threshold(stiff: _AtMode, x: FloatArray) -> float:
    """Return how much worse than the best a joint may be: chi-square, times what autocorrelation makes of it.

    The ratio of the compliance's robust deviation to that of a white residual is taken where the spring is stiff.
    """
    error, J = stiff.linearised(x)
    stiffer = _AtMode(stiff.problem, stiff.share, 1.2 * stiff.mode)
    J = np.column_stack([J, stiffer.residual(x) - error])
    ratio = float(robust(J, J, error).std[-1] / white(J, error).std[-1])
    return _QUANTILE * ratio**2 * float(error @ error) / (error.size - x.size)
