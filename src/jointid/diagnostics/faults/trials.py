"""Trials of faults of a flexible joint's mechanics.

The signature of such a fault is the change of the torque per unit of its size, at the size of a start. A fault that
large has effects of higher order, and the joint's parameters absorb a part of it: a derivative does not show the second
mode beside a joint of one mode. So each fault is simulated, beside the same joint without it.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from jointid.common.arrays import FloatArray
from jointid.common.errors import JointidError
from jointid.common.messages import ignore_progress
from jointid.common.parallel import in_threads
from jointid.diagnostics.faults.fault import Fault, FaultSignature
from jointid.estimation.descent import History, least_squares
from jointid.estimation.problems.closed_loop import ClosedLoopProblem
from jointid.models.friction import SymmetricFriction
from jointid.models.joints import FlexibleJoint
from jointid.records.record import Tap
from jointid.simulation.loop_input import to_log
from jointid.simulation.simulated import require_success

_FORCE = 1e-3  # of the largest torque: small enough for the friction to answer it linearly
_WILD = 10.0  # times the torque: a loop that is unstable with a fault so large is not that of the record
_ROUGHLY, _FEW = 1e-4, 20  # tolerance and evaluations of a search that only has to show an effect
_STIFFER = (2.5, 6.0)  # times the stiffness found: beside these springs a fault is tried that hides most of it
_ELSEWHERE = 1.5  # times the same: such a stiffness is that of another minimum


@dataclass(frozen=True, slots=True)
class Trial:
    """A fault of a given size: the joint with it, and the values that differ from those without it.

    `shape` distinguishes the trials of one fault. Nonlinear friction laws have no numbers for each direction: beside a
    friction with them, the fault is tried with the means of both directions, which are `without` it.
    """

    fault: Fault
    joint: FlexibleJoint
    values: Mapping[str, float]
    size: float
    shape: float | None = None
    without: Mapping[str, float] | None = None


@dataclass(frozen=True, slots=True, eq=False)
class FaultFit:
    """A joint with a fault, identified.

    Attributes:
        values: of its parameters, by name.
        change: (samples,) of the torque, by the fault and the other parameters.
        left: norm of the residual.
    """

    values: Mapping[str, float]
    change: FloatArray
    left: float


def vary_mechanics(problem: ClosedLoopProblem, x: FloatArray, faults: Iterable[Fault]) -> Iterator[FaultSignature]:
    """Yield the signatures of faults of a flexible joint's mechanics; none of a rigid one."""
    joint = problem.joint
    if not isinstance(joint, FlexibleJoint):
        return
    run, values = problem.simulate(x), problem.values(x)
    wild = _WILD * float(np.max(np.abs(run.torque)))

    lines = with_joint(problem, replace(joint, friction=SymmetricFriction()))

    def simulate(trial: Trial) -> FloatArray | None:
        other = with_joint(problem, trial.joint)
        try:
            faulty = require_success(other.simulate(other.vector({**values, **trial.values})))
            plain = run if trial.without is None else lines.simulate(lines.vector({**values, **trial.without}))
        except JointidError:  # a loop that is unstable with it is not that of the record
            return None
        raw = faulty.torque - require_success(plain).torque
        return raw / trial.size if np.all(np.abs(raw) < wild) else None

    trials = [trial for fault in faults for trial in list_trials(problem, x, fault)]
    for trial, raw in zip(trials, in_threads(simulate, trials), strict=True):
        if raw is not None:
            yield FaultSignature(trial.fault, problem.filter(raw), trial.shape, raw)


def respond_to_force(problem: ClosedLoopProblem, x: FloatArray, force: FloatArray) -> Iterator[FloatArray]:
    """Yield the change of the torque, (samples,), by a force on the simulated motor; none at a rate of its own."""
    if force.size != problem.experiment.after_limit.size:
        return  # a force at the controller's instants needs the motion there
    largest = float(np.max(np.abs(force), initial=0.0)) or 1.0
    small = _FORCE * float(np.max(np.abs(problem.measured))) / largest

    def simulate(by: float) -> FloatArray:
        return problem.torque(x, lambda e: replace(e, after_limit=e.after_limit + by * force))

    raw = (simulate(small) - simulate(-small)) / (2 * small)
    # The force itself is not in a measured torque.
    yield raw - to_log(problem.experiment, force) if problem.experiment.tap is Tap.MEASURED else raw


def solve_with_fault(problem: ClosedLoopProblem, x: FloatArray, fault: Fault) -> FaultFit | None:
    """Identify the joint with a fault, from all trials of it; None if no residual is smaller."""
    trials = [one for one in list_trials(problem, x, fault) if one.without is None]
    stiffer = _choose_stiffer(problem, x, trials) if fault.softens else []
    return _search_best(problem, x, [*trials, *stiffer])


def search_stiffer(problem: ClosedLoopProblem, x: FloatArray, fault: Fault) -> FaultFit | None:
    """Identify the joint with a fault beside stiffer springs; None unless the spring is, and the residual smaller.

    A joint that is identified without the fault may end in another minimum, which no trial near it leaves.
    """
    trials = [one for one in list_trials(problem, x, fault) if one.without is None]
    best = _search_best(problem, x, _choose_stiffer(problem, x, trials))
    return best if best is not None and best.values["stiffness"] > _ELSEWHERE * problem.values(x)["stiffness"] else None


def _choose_stiffer(problem: ClosedLoopProblem, x: FloatArray, trials: Sequence[Trial]) -> list[Trial]:
    """Return the trial with the least residual beside each of a few stiffer springs."""
    if not trials:  # as of a rigid joint, which has no stiffness
        return []
    stiffness, chosen = problem.values(x)["stiffness"], []
    for times in _STIFFER:
        near = [replace(one, values={**one.values, "stiffness": times * stiffness}) for one in trials]
        left = in_threads(lambda trial: _left_at(problem, x, trial), near)
        chosen += [one for one, size in zip(near, left, strict=True) if size == min(left) < math.inf][:1]
    return chosen


def _left_at(problem: ClosedLoopProblem, x: FloatArray, trial: Trial) -> float:
    """Return the norm of the residual at a trial; infinite if its loop cannot be simulated."""
    other = with_joint(problem, trial.joint)
    try:
        left = float(np.linalg.norm(other.residual(other.vector({**problem.values(x), **trial.values}))))
    except JointidError:
        return math.inf
    return left if math.isfinite(left) else math.inf


def _search_best(problem: ClosedLoopProblem, x: FloatArray, trials: Sequence[Trial]) -> FaultFit | None:
    """Return the best of the searches from trials; None if no residual is smaller."""
    ends = [end for end in in_threads(lambda trial: search(problem, x, trial), trials) if end is not None]
    best = min(ends, key=lambda end: end.left, default=None)
    return best if best is not None and best.left < float(np.linalg.norm(problem.residual(x))) else None


def search(problem: ClosedLoopProblem, x: FloatArray, trial: Trial) -> FaultFit | None:
    """Identify the joint with a fault by a short search from a trial; None if it fails."""
    other = with_joint(problem, trial.joint)
    rough = least_squares(other, _ROUGHLY, _FEW)
    try:
        end = History(ignore_progress).solve(other, rough, other.vector({**problem.values(x), **trial.values})).solution
        run = require_success(other.simulate(end.x))
        return FaultFit(other.values(end.x), run.torque - problem.torque(x), float(np.linalg.norm(end.residual)))
    except (JointidError, np.linalg.LinAlgError):
        return None


def with_joint(problem: ClosedLoopProblem, joint: FlexibleJoint) -> ClosedLoopProblem:
    """Return the problem of a joint with another law, whose additional parameters are free."""
    given = {p.name: p for p in problem.parameters}
    own = tuple(given.get(p.name, p) for p in joint.parameters)
    beside = problem.parameters[len(problem.joint.parameters) :]
    return replace(problem, loop=replace(problem.loop, joint=joint), parameters=(*own, *beside))


def list_trials(problem: ClosedLoopProblem, x: FloatArray, fault: Fault) -> list[Trial]:
    """Return the trials of a fault that change no fixed parameter."""
    joint = problem.joint
    if not isinstance(joint, FlexibleJoint) or fault.try_mechanics is None:
        return []
    run, values = problem.simulate(x), problem.values(x)
    held = {p.name for p in problem.parameters if not p.free}
    return [
        one
        for one in fault.try_mechanics(joint, run, values)
        if not held & {name for name, value in one.values.items() if value != values.get(name)}
    ]
