"""Trials of faults of a flexible joint's mechanics.

The signature of such a fault is the change of the torque per unit of its size, at the size of a start. A fault that
large has effects of higher order, and the joint's parameters absorb a part of it: a derivative does not show the second
mode beside a joint of one mode. So each fault is simulated, beside the same joint without it.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, replace

import numpy as np

from jointid.common.arrays import FloatArray
from jointid.common.errors import JointidError
from jointid.common.messages import ignore_progress
from jointid.common.parallel import in_threads
from jointid.diagnostics.faults.fault import Fault, FaultSignature, Trial
from jointid.estimation.descent import History, least_squares
from jointid.estimation.problems.closed_loop import ClosedLoopProblem
from jointid.models.joints import FlexibleJoint
from jointid.simulation.closed_loop import require_success

_WILD = 10.0  # times the torque: a loop that is unstable with a fault so large is not that of the record
_ROUGHLY, _FEW = 1e-4, 20  # tolerance and evaluations of a search that only has to show an effect


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

    def simulate(trial: Trial) -> FloatArray | None:
        other = _with_joint(problem, trial.joint)
        try:
            faulty = require_success(other.simulate(other.vector({**values, **trial.values})))
        except JointidError:  # a loop that is unstable with it is not that of the record
            return None
        raw = faulty.torque - run.torque
        return raw / trial.size if np.all(np.abs(raw) < wild) else None

    trials = [(fault, trial) for fault in faults for trial in list_trials(problem, x, fault)]
    for (fault, trial), raw in zip(trials, in_threads(simulate, [one for _, one in trials]), strict=True):
        if raw is not None:
            yield FaultSignature(fault, problem.filter(raw), trial.shape, raw)


def solve_with_fault(problem: ClosedLoopProblem, x: FloatArray, fault: Fault) -> FaultFit | None:
    """Identify the joint with a fault, from all trials of it; None if no residual is smaller."""
    ends = in_threads(lambda trial: _search(problem, x, trial), list_trials(problem, x, fault))
    best = min((end for end in ends if end is not None), key=lambda end: end.left, default=None)
    return best if best is not None and best.left < float(np.linalg.norm(problem.residual(x))) else None


def _search(problem: ClosedLoopProblem, x: FloatArray, trial: Trial) -> FaultFit | None:
    """Identify the joint with a fault by a short search from a trial; None if it fails."""
    other = _with_joint(problem, trial.joint)
    rough = least_squares(_ROUGHLY, _FEW)
    try:
        end = History(ignore_progress).solve(other, rough, other.vector({**problem.values(x), **trial.values})).solution
        run = require_success(other.simulate(end.x))
        return FaultFit(other.values(end.x), run.torque - problem.torque(x), float(np.linalg.norm(end.residual)))
    except (JointidError, np.linalg.LinAlgError):
        return None


def _with_joint(problem: ClosedLoopProblem, joint: FlexibleJoint) -> ClosedLoopProblem:
    """Return the problem of a joint with another law, whose additional parameters are free."""
    given = {p.name: p for p in problem.parameters}
    own = tuple(given.get(p.name, p) for p in joint.parameters)
    beside = problem.parameters[len(problem.joint.parameters) :]
    return replace(problem, loop=replace(problem.loop, joint=joint), parameters=(*own, *beside))


def list_trials(problem: ClosedLoopProblem, x: FloatArray, fault: Fault) -> list[Trial]:
    """Return the trials of a fault that change no fixed parameter."""
    joint = problem.joint
    if not isinstance(joint, FlexibleJoint) or fault.trials is None:
        return []
    run, values = problem.simulate(x), problem.values(x)
    held = {p.name for p in problem.parameters if not p.free}
    return [
        one
        for one in fault.trials(joint, run, values)
        if not held & {name for name, value in one.values.items() if value != values.get(name)}
    ]
