"""Whether a record shows a joint's spring at all; where it does not, how soft the spring could be.

A search always ends somewhere, and its end has a stiffness. That number is reported only when

- the flexible joint explains the torque significantly better than a rigid one, by a test made for a compliance that
  cannot be negative (`boundary`);
- what it explains is more than the error that repeats with the motion and remains: a model that lacks more than the
  spring gives may as well have made the spring up;
- inertias and stiffness are told from 0, and the mode is one that a log of this rate can follow;
- starts apart led to the same end;
- the profile of the compliance 1/K12 is bounded on both sides.

Otherwise the record says only how soft the spring may be, for each of some shares of the load in the inertia
(`stiffness_bounds`).
"""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from jointid.common.arrays import FloatArray
from jointid.common.message import Message
from jointid.common.progress import Progress
from jointid.estimation.problems.closed_loop import ClosedLoopProblem
from jointid.estimation.result.stiffness_bounds import bounded
from jointid.estimation.search.exploration import FASTEST, frequency_of
from jointid.estimation.search.history import History, least_squares
from jointid.models.joints import FlexibleJoint, split_by_mode
from jointid.simulation.closed_loop import in_threads
from jointid.simulation.loop_input import ClosedLoop
from jointid.uncertainty.model_tests import BoundaryTest, flexible_against_rigid
from jointid.uncertainty.position_dependent_error import Uncertainty, uncertainty
from jointid.uncertainty.profile import Profile, profile_compliance
from jointid.uncertainty.verdict import Reason, Status, StiffnessBound, Subject, Verdict

SHARES = (0.05, 0.1, 0.2, 0.33, 0.5)
"""Of the load in the inertia, for which a bound is given."""

_TEST_SHARES = (0.1, 0.33, 0.6)
# Times the cut-off, with each of those shares: the best counts, in every draw of the test as in the record. A mode
# rings for 1 / (4 pi damping) periods, so that a coarser grid misses the one that is there; the last is a compliance.
_TEST_MODES = (*(0.3 * 1.08**i for i in range(16)), 2.5)
_FAR = 0.5  # of the rigid joint's sum of squares: what chance cannot make of it with a few parameters more
_TIGHT = 0.2  # of the stiffness: a 2-sigma interval this narrow needs no profile
_POSITIVE = ("motor_inertia", "load_inertia", "stiffness")


@dataclass(frozen=True, slots=True, eq=False)
class Visibility:
    """What a record shows of a joint's spring.

    Attributes:
        shown: whether its stiffness is reported.
        test: of the flexible joint against the rigid one.
        profile: of the compliance, where one was needed.
        reasons: why the stiffness is refused, a sentence each.
        rigid: values of the rigid joint on the same band. rigid_std: standard deviations of those that were free.
        rigid_error: (rows,) what it leaves.
        bounds: where the stiffness is refused.
        simulations: that all this took.
    """

    shown: bool
    test: BoundaryTest
    profile: Profile | None
    reasons: tuple[str, ...]
    rigid: Mapping[str, float]
    rigid_std: Mapping[str, float]
    rigid_error: FloatArray
    bounds: tuple[StiffnessBound, ...]
    simulations: int

    @property
    def verdict(self) -> Verdict:
        """Whether the stiffness is reported, and why not."""
        if self.shown:
            return Verdict(Subject.STIFFNESS, Status.PASSED, (Message(Reason.STIFFNESS_SHOWN, str(self.test)),))
        first, *others = self.reasons
        said = (f"not identifiable from this record: {first}", *others)
        return Verdict(
            Subject.STIFFNESS, Status.FAILED, tuple(Message(Reason.STIFFNESS_NOT_SHOWN, one) for one in said)
        )


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
    rigid, at = _rigid(problem, problem.values(x))
    error, J = rigid.linearised(at.x)
    where = rigid.cells(rigid.simulate(at.x))
    remains = problem.residual(x)
    left = float(remains @ remains)
    # Where every spring on the rigid joint makes the loop unstable, the one that was found is the one to test.
    springs = _springs(problem, rigid.values(at.x), error) or [(remains - error)[:, np.newaxis]]
    # So far from the rigid joint a linear step towards the spring finds nothing; what the fit itself gained counts.
    fitted = left if left < _FAR * float(error @ error) else None
    test = flexible_against_rigid(error, J, springs, where, fitted)
    runs = at.simulations + 4 + len(_TEST_SHARES) * len(_TEST_MODES)
    reasons = [] if test.significant else [str(test)]
    reasons += _doubts(problem, x, known, error, together)
    found = None
    if not reasons:
        found, reasons = _profiled(problem, x, known)
        runs += found.evaluations if found else 0
    judged = uncertainty(J, J, error, where, [p.name for p in rigid.free])
    bounds: tuple[StiffnessBound, ...] = ()
    if reasons:
        progress("the record does not show the spring; looking how soft it may be")
        mode = frequency_of(problem.values(x))
        each = [bounded(problem, rigid.values(at.x), share, mode) for share in shares]
        bounds, runs = tuple(bound for bound, _ in each), runs + sum(used for _, used in each)
    names = [p.name for p in rigid.free]
    std = dict(zip(names, map(float, judged.covariance.std), strict=True))
    return Visibility(not reasons, test, found, tuple(reasons), rigid.values(at.x), std, error, bounds, runs)


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
    values, spread = problem.values(x), dict(zip((p.name for p in problem.free), known.covariance.std, strict=True))
    for name in _POSITIVE:
        if name in spread and values[name] <= 2 * float(spread[name]):
            found.append(f"the interval of {name} holds 0")
    mode, reach = frequency_of(values), FASTEST / problem.experiment.sample_time
    if mode > reach:
        found.append(f"the mode that was found, at {mode:.3g} Hz, is faster than a log of this rate can follow")
    if together[1] > 1 and together[0] < 2:
        found.append(f"of {together[1]} starts no two led to the same flexible joint")
    return found


@dataclass(frozen=True, slots=True, eq=False)
class _Solved:
    x: FloatArray
    simulations: int


def _solved(problem: ClosedLoopProblem, values: Mapping[str, float], progress: Progress) -> _Solved:
    history = History(progress)
    found = history.solve(problem, least_squares(problem, 1e-8), problem.vector(values)).solution
    return _Solved(found.x, found.evaluations)


def _quietly(_: str) -> None:
    """Say nothing of a fit that is only a means."""


def _rigid(problem: ClosedLoopProblem, values: Mapping[str, float]) -> tuple[ClosedLoopProblem, _Solved]:
    """Return the problem of a rigid joint on the same band, solved."""
    flexible = problem.loop.joint
    assert isinstance(flexible, FlexibleJoint)
    joint = flexible.rigid
    surroundings = problem.parameters[len(flexible.parameters) :]
    loop = ClosedLoop(joint, problem.loop.controller)
    rigid = replace(problem, loop=loop, parameters=(*joint.parameters, *surroundings))
    start = {p.name: values[p.name] for p in surroundings}
    start |= {p.name: _total(values, p.name) for p in joint.parameters}
    return rigid, _solved(rigid, start, _quietly)


def _total(values: Mapping[str, float], name: str) -> float:
    """Return the value of a rigid joint's parameter: the sum of both sides of the flexible one."""
    return values[name] if name in values else values[f"motor_{name}"] + values[f"load_{name}"]


def _split(problem: ClosedLoopProblem, rigid: Mapping[str, float], share: float, frequency: float) -> dict[str, float]:
    """Return a flexible joint of a rigid one: its friction on the motor's side, a spring for a mode there."""
    values = {p.name: rigid.get(p.name, 0.0) for p in problem.parameters}
    values |= {f"motor_{name}": value for name, value in rigid.items() if f"motor_{name}" in values}
    whole = rigid["inertia"]
    return values | split_by_mode(whole, share, frequency)


def _springs(problem: ClosedLoopProblem, rigid: Mapping[str, float], error: FloatArray) -> list[FloatArray]:
    """Return what springs would do to the residual, each (rows, 1), at some load shares and modes."""
    cutoff = problem.filtering.cutoff
    assert cutoff is not None
    free = problem.all_free()

    def bent(at: tuple[float, float]) -> FloatArray:
        values = _split(problem, rigid, at[0], at[1] * cutoff)
        return free.residual(np.array([values[p.name] for p in free.parameters]))

    tried = in_threads(bent, list(itertools.product(_TEST_SHARES, _TEST_MODES)))
    size = 10 * float(np.linalg.norm(problem.filtered(problem.measured)))
    return [(one - error)[:, np.newaxis] for one in tried if np.linalg.norm(one) < size]  # the others are unstable


def _profiled(problem: ClosedLoopProblem, x: FloatArray, known: Uncertainty) -> tuple[Profile | None, list[str]]:
    """Return the profile of the compliance, where its interval is not narrow anyway, and what is wrong with it."""
    names = [p.name for p in problem.free]
    if "stiffness" not in names:
        return None, []
    at = names.index("stiffness")
    std, value = float(known.covariance.std[at]), float(x[at])
    if 2 * std <= _TIGHT * value:
        return None, []
    found = profile_compliance(problem, x, known.covariance, problem.joint.unit)
    if found.bounded:
        return found, []
    side = "stiff" if found.interval[0] is None else "soft"
    return found, [f"the profile of the compliance has no end on its {side} side ({found})"]
