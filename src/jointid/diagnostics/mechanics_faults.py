"""Signatures of what a flexible joint has and its model has not: in the spring, behind the load, in the friction.

Each is the change of the torque where the joint has another law of its spring or friction, as large as a search for it
begins with, per unit of its size:

- ``cubic_spring``: the spring is stiffer by this share at the largest wind-up than near none, smoothly or in pieces;
- ``backlash``: the spring pushes only behind a gap; the size says how many gaps of a width that is tried;
- ``second_mode``: this share of the load swings on a spring of its own, at a few times the first mode;
- ``load_dependent_friction``: the load's friction grows by this share of the torque that drives it;
- ``winding_friction``: Coulomb friction winds up behind each reversal, over a displacement that is tried;
- ``changing_friction``: this share of the viscous, or of the Coulomb, friction is lost between the first sample and the
  last;
- ``cogging``: a force of this size comes back with the motor's position, of a period that is looked for (`cogging`).

A fault that large moves the motion by more than its first order says, and is partly made up for by the joint's
parameters: a joint of one mode, as stiff as both springs of one that has two, leaves of the second mode what no
derivative at it shows. So each is simulated as it is, beside the same joint without it.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from itertools import product

import numpy as np

from jointid.common.arrays import FloatArray
from jointid.common.errors import JointidError
from jointid.common.messages import silent
from jointid.diagnostics.fault_signature import FaultSignature
from jointid.estimation.descent import History, least_squares
from jointid.estimation.problems.closed_loop import ClosedLoopProblem
from jointid.models.friction import (
    PARTS,
    DriftingFriction,
    LoadDependentFriction,
    PreslidingFriction,
    SymmetricFriction,
)
from jointid.models.joints import FlexibleJoint, frictions_beside, springs_beside
from jointid.models.springs import Backlash, CubicSpring, ElasticLoad, ThreePieceSpring
from jointid.simulation.closed_loop import Simulation, in_threads
from jointid.simulation.simulated import require_success

CUBIC_SPRING, BACKLASH, SECOND_MODE = "cubic_spring", "backlash", "second_mode"
COGGING = "cogging"
LOAD_DEPENDENT_FRICTION, CHANGING_FRICTION = "load_dependent_friction", "changing_friction"
WINDING_FRICTION = "winding_friction"
MECHANICS = (
    CUBIC_SPRING, BACKLASH, SECOND_MODE, LOAD_DEPENDENT_FRICTION, WINDING_FRICTION, CHANGING_FRICTION, COGGING,
)  # fmt: skip
ONE_SIDED = (
    BACKLASH,
    SECOND_MODE,
    COGGING,
    LOAD_DEPENDENT_FRICTION,
    WINDING_FRICTION,
)  # their size can only be positive

VISCOUS, COULOMB = 1.0, 0.0  # shapes of a friction that changes

_SHARE, _MODES = 0.25, (1.4, 1.8, 2.3, 3.0, 4.0)  # of the load that swings, at times the first mode
_WILD = 10.0  # times the torque: a loop that is unstable with a fault so large is not that of the record
_DISTANCES = (1e-4, 3e-4, 1e-3, 3e-3, 1e-2)  # of the travel, over which friction winds up
_LOSS, _LOST = 0.03, 0.2  # of the load's torque, and of a friction at the end
_LEAST = 0.05  # of the load: a smaller part rings at any frequency that the noise has, and moves no other parameter
_ROUGHLY, _FEW = 1e-4, 20  # tolerance and evaluations of a search that only has to show whether there is something
_SIDES = ("motor_", "load_")


@dataclass(frozen=True, slots=True)
class _Trial:
    """A fault of some size: the joint that has it, and its values where they are others than without it.

    `shape` tells a trial from the others of that fault. No law of friction beyond lines has numbers of its own for each
    direction: beside such lines a fault of it is tried with the means of both, which are `without` it.
    """

    name: str
    joint: FlexibleJoint
    values: Mapping[str, float]
    size: float
    shape: float | None = None
    without: Mapping[str, float] | None = None


def vary_mechanics(problem: ClosedLoopProblem, x: FloatArray) -> Iterator[FaultSignature]:
    """Yield the signatures of a flexible joint's mechanics; none of a rigid one."""
    joint = problem.joint
    if not isinstance(joint, FlexibleJoint):
        return
    run, values = problem.simulate(x), problem.values(x)
    wild = _WILD * float(np.max(np.abs(run.torque)))

    lines = with_joint(problem, replace(joint, friction=SymmetricFriction()))

    def simulate(trial: _Trial) -> FloatArray | None:
        other = with_joint(problem, trial.joint)
        try:
            faulty = require_success(other.simulate(other.vector({**values, **trial.values})))
            plain = run if trial.without is None else lines.simulate(lines.vector({**values, **trial.without}))
        except JointidError:  # a loop that is unstable with it is not that of the record
            return None
        raw = faulty.torque - require_success(plain).torque
        return raw / trial.size if np.all(np.abs(raw) < wild) else None

    trials = _list_trials(problem, x)
    for trial, raw in zip(trials, in_threads(simulate, trials), strict=True):
        if raw is not None:
            yield FaultSignature(trial.name, problem.filtered(raw), trial.shape, raw)


def search_second_mode(problem: ClosedLoopProblem, x: FloatArray) -> Iterator[FaultSignature]:
    """Yield the signatures of a load that swings, where searches for it end at one.

    The modes that are tried are few, and what swings moves all the rest: from three of them a search of some steps
    finds what a small part of it shows.

    Args:
        problem: of a joint with a linear spring, solved.
        x: (free,) its parameters.
    """
    trials = [one for one in _list_trials(problem, x) if one.name == SECOND_MODE][::2]
    joint = problem.joint
    assert isinstance(joint, FlexibleJoint)
    for end in in_threads(lambda trial: _search(problem, x, trial), trials):
        if end is not None and (share := end.values["swinging_share"]) > _LEAST:
            raw, mode = end.change / share, joint.frequencies(end.values)["second_free_free"]
            yield FaultSignature(SECOND_MODE, problem.filtered(raw), mode, raw)


def solve_with_fault(problem: ClosedLoopProblem, x: FloatArray, name: str) -> FaultFit | None:
    """Return the joint with a fault, identified from all that was tried of it; None where no search for it ends better.

    Args:
        problem: of the joint without it, solved.
        x: (free,) its parameters.
        name: of the fault.
    """
    trials = [one for one in _list_trials(problem, x) if one.name == name and one.without is None]
    ends = [end for end in in_threads(lambda trial: _search(problem, x, trial), trials) if end is not None]
    best = min(ends, key=lambda end: end.left, default=None)
    return best if best is not None and best.left < float(np.linalg.norm(problem.residual(x))) else None


@dataclass(frozen=True, slots=True, eq=False)
class FaultFit:
    """A joint with a fault, identified.

    Attributes:
        values: of its parameters, by name.
        change: (samples,) of the torque, by the fault and by what the other parameters become with it.
        left: norm of the residual.
    """

    values: Mapping[str, float]
    change: FloatArray
    left: float


def _search(problem: ClosedLoopProblem, x: FloatArray, trial: _Trial) -> FaultFit | None:
    """Return where a search of some steps from a trial ends; None where it fails."""
    other = with_joint(problem, trial.joint)
    rough = replace(least_squares(other, _ROUGHLY), evaluations=_FEW)
    try:
        end = History(silent).solve(other, rough, other.vector({**problem.values(x), **trial.values})).solution
        run = require_success(other.simulate(end.x))
        return FaultFit(other.values(end.x), run.torque - problem.torque(x), float(np.linalg.norm(end.residual)))
    except (JointidError, np.linalg.LinAlgError):
        return None


def with_joint(problem: ClosedLoopProblem, joint: FlexibleJoint) -> ClosedLoopProblem:
    """Return the problem of a joint with another law: what both have is as it was, what it adds is free."""
    given = {p.name: p for p in problem.parameters}
    own = tuple(given.get(p.name, p) for p in joint.parameters)
    beside = problem.parameters[len(problem.joint.parameters) :]
    return replace(problem, loop=replace(problem.loop, joint=joint), parameters=(*own, *beside))


def _list_trials(problem: ClosedLoopProblem, x: FloatArray) -> list[_Trial]:
    """Return the faults that are tried of a flexible joint."""
    joint, run, values = problem.joint, problem.simulate(x), problem.values(x)
    assert isinstance(joint, FlexibleJoint)
    held = {p.name for p in problem.parameters if not p.free}
    trials = (*_try_springs(joint, run, values), *_try_frictions(joint, run, values))
    return [
        one for one in trials if not held & {name for name, value in one.values.items() if value != values.get(name)}
    ]


def _try_springs(joint: FlexibleJoint, run: Simulation, values: Mapping[str, float]) -> Iterator[_Trial]:
    """Yield what may be instead of a linear spring, and behind it."""
    assert run.load_position is not None
    windup, stiffness = float(np.max(np.abs(run.motor_position - run.load_position))), values["stiffness"]
    if not (joint.spring.linear and windup > 0.0 and stiffness > 0.0 and values["load_inertia"] > 0.0):
        return
    for law in springs_beside(joint):
        other = replace(joint, spring=law)
        if isinstance(law, CubicSpring | ThreePieceSpring):
            for start in law.starts(values, windup):
                torque = law.torque({**values, **start}, np.array([windup]), np.zeros(1))
                more = float(torque[0]) / (start["stiffness"] * windup) - 1.0
                yield _Trial(CUBIC_SPRING, other, start, more, more)
        elif isinstance(law, Backlash):
            for start in law.starts(values, windup):
                yield _Trial(BACKLASH, other, start, 1.0, 0.5 * start["gap"])
        elif isinstance(law, ElasticLoad):
            first = joint.frequencies(values)["free_free"]
            for times in _MODES:
                yield _Trial(SECOND_MODE, other, law.start(values, _SHARE, times), _SHARE, times * first)


def _try_frictions(joint: FlexibleJoint, run: Simulation, values: Mapping[str, float]) -> Iterator[_Trial]:
    """Yield what may be instead of a friction of lines; of one with lines for each direction beside their means."""
    if not joint.friction.linear:
        return
    duration, plain = run.sample_time * run.torque.size, joint.friction == SymmetricFriction()
    mean = {
        f"{side}{part}": sum(by * values[name] for name, by in joint.friction.mean(part, side).items())
        for part, side in product(PARTS, _SIDES)
    }
    for law in frictions_beside(joint):
        other = replace(joint, friction=law)
        still = mean | {p.name: 0.0 for p in other.parameters if p.name.endswith(("_drift", "_per_torque"))}
        without = None if plain else still
        if isinstance(law, LoadDependentFriction):
            grows = still | {"load_friction_per_torque": _LOSS}
            yield _Trial(LOAD_DEPENDENT_FRICTION, other, grows, _LOSS, without=without)
        elif law == PreslidingFriction():
            travel = float(np.ptp(run.motor_position))
            for share in _DISTANCES:
                distances = {f"{side}presliding_distance": share * travel for side in _SIDES}
                yield _Trial(WINDING_FRICTION, other, still | distances, 1.0, share * travel, without)
        elif isinstance(law, DriftingFriction):
            for part, shape in zip(PARTS, (VISCOUS, COULOMB), strict=True):
                falls = {f"{side}{part}_drift": -_LOST * mean[f"{side}{part}"] / duration for side in _SIDES}
                yield _Trial(CHANGING_FRICTION, other, still | falls, _LOST, shape, without)
