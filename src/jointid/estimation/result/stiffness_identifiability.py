"""Whether a record shows a joint's spring at all; where it does not, how soft the spring could be.

A search always ends somewhere, and its end has a stiffness. That number is reported only when

- the flexible joint explains the torque significantly better than a rigid one, by a test made for a compliance that
  cannot be negative (`uncertainty.model_tests`);
- what it explains is more than the error that repeats with the motion and remains: a model that lacks more than the
  spring gives may as well have made the spring up;
- motor and load move, inertias and stiffness are distinguished from 0, and the mode is oscillatory and within the
  range of a log of this rate;
- starts apart led to the same end;
- where the spring explains little, no joint with a mode elsewhere explains the torque as well, and none that is rigid;
- the profile of the compliance 1/K12 is bounded on both sides.

Otherwise the record says only how soft the spring may be. Low frequencies bound ZZ2^2/K12, and a mode in the band would
ring, so the bound is a function of the load's share of the inertia, which is not known either: see `stiffness_bounds`.
A random force in the loop (`methods.force_in_loop`) changes the mean torque through the friction. Where that moves a
parameter of the rigid joint, its intervals are widened, and each bound is the softer one with and without that change.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from jointid.common.arrays import FloatArray
from jointid.common.messages import Message, Progress
from jointid.common.parallel import in_threads
from jointid.estimation.descent import History, descend
from jointid.estimation.methods.force_in_loop import InLoop, allow_for_force, simulate_mean, widened_for_force
from jointid.estimation.problems.closed_loop import ClosedLoopProblem
from jointid.estimation.result.build_result import Visibility, find_lost
from jointid.estimation.result.stiffness_bounds import (
    SHARES,
    ModeProfile,
    bound_all,
    damping_ratio,
    friction_on_motor,
    profile_modes,
    spring,
)
from jointid.estimation.starts.flexible_joint import FASTEST, frequency_of
from jointid.estimation.starts.nonlinear_laws import with_linear_spring
from jointid.models.joints import ClosedLoop, FlexibleJoint, of_whole, split_by_mode
from jointid.solvers.solve import Solution
from jointid.uncertainty.identifiability import find_separable
from jointid.uncertainty.model_tests import flexible_against_rigid
from jointid.uncertainty.position_dependent_error import Uncertainty, uncertainty
from jointid.uncertainty.profile import Profiling, profile_compliance
from jointid.uncertainty.verdict import Reason, Status, StiffnessBound, Subject, Verdict

_TEST_SHARES = (0.1, 0.33, 0.6)
# Times the cut-off, with each of those shares: the best counts, in every draw of the test as in the record. A mode
# rings for 1 / (4 pi damping) periods, so that a coarser grid misses the one that is there; the last is a compliance.
_TEST_MODES = (*(0.3 * 1.08**i for i in range(16)), 2.5)
_FAR = 0.5  # of the rigid joint's sum of squares: what chance cannot make of it with a few parameters more
_TIGHT = 0.2  # of the stiffness: a 2-sigma interval this narrow needs no profile

_BOUNDED = Profiling(points=5, evaluations=15, tolerance=1e-4)  # asks whether there is an end, not where it is
_LITTLE = 0.3  # of the rigid joint's sum of squares: a spring that explains less may be another one
_SAME = 0.2  # of a stiffness: springs that the profile, on a band of its own, does not tell apart
_APART = 3.0  # deviations: stiffnesses that are not the same
_BOTH_SIDES = 1.42  # times a bound's threshold is an interval's at 95 %: 3.841 / 2.706


def visible(
    problem: ClosedLoopProblem,
    x: FloatArray,
    J: FloatArray,
    known: Uncertainty,
    together: tuple[int, int],
    progress: Progress,
    shares: Sequence[float] = SHARES,
) -> Visibility:
    """Return whether a record shows the spring of an estimate, or else how soft it may be.

    Args:
        problem: of the flexible joint, as it was solved.
        x: its free parameters.
        J: (rows, free) the derivatives of the torque there, filtered.
        known: how well.
        together: how many of how many starts led to the estimate.
        progress: receives messages.
        shares: of the load in the inertia, for which bounds are searched.
    """
    rigid, at = _fit_rigid(problem, problem.values(x))
    error, slopes = rigid.linearise(at.x)
    where = rigid.cells(rigid.simulate(at.x))
    values, found, runs = rigid.values(at.x), problem.values(x), at.evaluations + 4
    names = [p.name for p in rigid.free]
    judged = uncertainty(slopes, slopes, error, where, problem.torque_unit)
    reasons, said, made = _doubts(problem, x, J, known, error, together), "", None
    if not reasons:
        remains = problem.residual(x)
        left = float(remains @ remains)
        # Where every spring on the rigid joint makes the loop unstable, the one that was found is the one to test.
        springs = _springs(with_linear_spring(problem), rigid.values(at.x), error) or [(remains - error)[:, np.newaxis]]
        # So far from the rigid joint a linear step towards the spring finds nothing; what the fit itself gained counts.
        fitted = left if left < _FAR * float(error @ error) else None
        test = flexible_against_rigid(error, slopes, springs, where, fitted)
        runs += len(_TEST_SHARES) * len(_TEST_MODES)
        reasons, said = [] if test.significant else [str(test)], str(test)
        if not reasons and test.gained < _LITTLE:
            made = profile_modes(with_linear_spring(problem), values, found, thorough=True)
            reasons = _other_springs(made, found["stiffness"], known, [p.name for p in problem.free])
    if not reasons:
        used, reasons = _follow_compliance(problem, x, known)
        runs += used
    bounds: tuple[StiffnessBound, ...] = ()
    if reasons:
        progress("the record does not show the spring; looking how soft it may be")
        made = made or profile_modes(with_linear_spring(problem), values, found, thorough=False)
        bounds = bound_all(made, shares)
        history = History(progress)
        moved = allow_for_force(rigid, at.x, -slopes, judged.covariance.std, history)
        judged = widened_for_force(judged, rigid, at.x, moved)
        if moved is not None:
            change = simulate_mean(rigid, *moved) - rigid.torque(moved[0])
            linear = with_linear_spring(replace(problem, measured=problem.measured - change))
            beside = profile_modes(linear, rigid.values(moved[0]), found, thorough=False)
            softest = [
                min(pair, key=lambda one: one.stiffness or 0.0)
                for pair in zip(bounds, bound_all(beside, shares), strict=True)
            ]
            bounds = tuple(softest)
            runs += history.tally.evaluations + beside.simulations
        reasons[0] = f"not identifiable from this record: {reasons[0]}"
        refused = tuple(Message(Reason.STIFFNESS_NOT_SHOWN, reason) for reason in reasons)
        verdict = Verdict(Subject.STIFFNESS, Status.FAILED, refused)
    else:
        verdict = Verdict(Subject.STIFFNESS, Status.PASSED, (Message(Reason.STIFFNESS_SHOWN, said),))
    runs += 0 if made is None else made.simulations
    stated = zip(names, judged.covariance.std, slopes.any(axis=0) & find_separable(slopes), strict=True)
    std = {name: float(one) for name, one, determined in stated if determined}
    notes = tuple(one for one in judged.warnings if one.code is InLoop.FORCE)
    return Visibility(verdict, values, std, bounds, runs, notes)


def _other_springs(made: ModeProfile, stiffness: float, known: Uncertainty, names: Sequence[str]) -> list[str]:
    """Return the other admissible springs at 95 %, a rigid joint included."""
    if not math.isfinite(made.threshold):
        return ["a joint that is nearly rigid cannot be simulated, so that no other spring is excluded"]
    limit = min(made.stiff.cost, *(end.cost for end in made.minima), math.inf) + _BOTH_SIDES * made.threshold
    if made.stiff.least <= limit:
        return ["a joint that is nearly rigid explains the torque as well, within 95 %"]
    std = float(known.covariance.std[names.index("stiffness")]) if "stiffness" in names else 0.0
    for end in made.minima:
        other = spring(end.at)["stiffness"]
        if end.least <= limit and abs(other - stiffness) > max(_APART * std, _SAME * stiffness):
            return [
                f"a spring of {other:.3g}, with its mode at {end.mode:.3g} Hz, explains the torque as well as the one "
                f"of {stiffness:.3g} that was found, within 95 %"
            ]
    return []


def _doubts(
    problem: ClosedLoopProblem,
    x: FloatArray,
    J: FloatArray,
    known: Uncertainty,
    rigid_error: FloatArray,
    together: tuple[int, int],
) -> list[str]:
    """Return why the spring that was found is not to be believed, whatever a test says."""
    # Whatever its inertia, a mass that its friction holds makes the same torque: where the search left it says nothing.
    idle = {p.name for p, column in zip(problem.free, J.T, strict=True) if not column.any()}
    found = [
        f"with the joint that was found the {side} never moves, so that no torque tells its inertia"
        for side in ("motor", "load")
        if f"{side}_inertia" in idle
    ]
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
    ratio = damping_ratio(problem.values(x))
    if ratio > 1:
        found.append(f"the mode that was found is damped by {100 * ratio:.3g} %, so that it does not swing")
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
    start |= {p.name: of_whole(p, values) for p in joint.parameters}
    return rigid, descend(rigid, rigid.vector(start), 1e-8)


def _springs(problem: ClosedLoopProblem, rigid: Mapping[str, float], error: FloatArray) -> list[FloatArray]:
    """Return the effects of springs on the residual, each (rows, 1), at some load shares and modes."""
    cutoff = problem.filtering.cutoff
    assert cutoff is not None
    free = problem.all_free()

    def residual_at(at: tuple[float, float]) -> FloatArray:
        values = friction_on_motor(problem.parameters, rigid)
        values |= split_by_mode(rigid["inertia"], at[0], at[1] * cutoff)
        return free.residual(np.array([values[p.name] for p in free.parameters]))

    tried = in_threads(residual_at, list(itertools.product(_TEST_SHARES, _TEST_MODES)))
    size = 10 * float(np.linalg.norm(problem.filter(problem.measured)))
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
    found = profile_compliance(problem, x, known.covariance, problem.joint.unit, _BOUNDED)
    if found.bounded:
        return found.evaluations, []
    side = "stiff" if found.interval[0] is None else "soft"
    return found.evaluations, [f"the profile of the compliance has no end on its {side} side ({found})"]
