"""Nonlinear spring and friction laws: searched from the end with linear ones, by the starts of the laws.

The linear spring and the friction of one line that fit best lie between the pieces: everything else about the joint is
nearly right there. Where the pieces begin is not known, and the criterion has more than one valley over it, so that
every start of the laws is followed a little, and the best to the end.
"""

from __future__ import annotations

from collections import ChainMap
from collections.abc import Mapping
from dataclasses import replace
from itertools import product
from typing import NamedTuple

import numpy as np

from jointid.common.arrays import FloatArray
from jointid.common.errors import MethodError
from jointid.common.text import join, pluralise
from jointid.estimation.descent import ROUGH, History, Solved
from jointid.estimation.problems.closed_loop import ClosedLoopProblem
from jointid.models.friction import PARTS, MotionSize
from jointid.models.joints import ClosedLoop, FlexibleJoint, Joint
from jointid.models.springs import Spring
from jointid.simulation.simulate import Simulation


def with_linear_spring(problem: ClosedLoopProblem) -> ClosedLoopProblem:
    """Return the problem of the same joint with a linear spring; itself where it has one."""
    joint = problem.joint
    assert isinstance(joint, FlexibleJoint)
    return problem if joint.spring.linear else _with_joint(problem, replace(joint, spring=Spring()))


def with_linear_laws(problem: ClosedLoopProblem) -> ClosedLoopProblem:
    """Return the problem of the same joint with linear laws; itself where it has no others.

    Raises:
        MethodError: none of its parameters is free.
    """
    if problem.joint.linear == problem.joint:
        return problem
    found = _with_joint(problem, problem.joint.linear)
    if not found.free_joint:
        names = join([p.name for p in problem.free_joint])
        raise MethodError(
            f"Of the joint only what its laws add to a plain one is free, {names}; expected a parameter that the plain "
            "one has, too, with which the search begins: leave its Coulomb friction or its inertia free."
        )
    return found


def _with_joint(problem: ClosedLoopProblem, joint: Joint) -> ClosedLoopProblem:
    """Return the problem of a joint whose parameters are among those of its own."""
    given = {p.name: p for p in problem.parameters}
    own = tuple(replace(given[p.name], symbol=p.symbol) for p in joint.parameters)
    beside = problem.parameters[len(problem.joint.parameters) :]
    return replace(problem, loop=ClosedLoop(joint, problem.loop.controller), parameters=(*own, *beside))


def from_linear_laws(problem: ClosedLoopProblem, found: Solved, tolerance: float, history: History) -> Solved:
    """Search for a joint with nonlinear laws from the end with linear ones, or with a linear spring."""
    joint, linear = problem.joint, found.problem
    surroundings = linear.parameters[len(linear.joint.parameters) :]  # the search may have let the motor begin moving
    own = problem.parameters[: len(joint.parameters)]
    problem = replace(problem, filtering=linear.filtering, parameters=(*own, *surroundings))
    values, run = found.values, linear.simulate(found.x)
    history.tally.evaluations += 1
    given = {p.name: p.start for p in own if p.start is not None}
    starts = law_starts(joint, linear.joint, values, JointMotion.of(run), given)
    history.progress(f"looking for the {name_laws(joint)}, from {pluralise(len(starts), 'start')}")
    ends = [history.solve(problem, ROUGH, problem.vector(start)) for start in starts]
    best = min(ends, key=lambda end: end.norm)
    end = history.finish(best, tolerance)
    if not end.solution.converged:  # along a flat valley a second descent has its damping anew
        end = history.finish(end, tolerance)
    return end.with_starts(found.solution.starts)


class JointMotion(NamedTuple):
    """The motion of a joint with linear laws, for the starts of others.

    Attributes:
        duration: s.
        motor: (samples,) position and velocity. load: of a flexible joint.
    """

    duration: float
    motor: tuple[FloatArray, FloatArray]
    load: tuple[FloatArray, FloatArray] | None = None

    @classmethod
    def of(cls, run: Simulation) -> JointMotion:
        """Return the motion of a simulation."""
        load = None
        if run.load_position is not None and run.load_velocity is not None:
            load = run.load_position, run.load_velocity
        return cls(run.sample_time * run.torque.size, (run.motor_position, run.motor_velocity), load)


def name_laws(joint: Joint) -> str:
    """Return the nonlinear laws of a joint in words: "backlash spring and presliding friction"."""
    laws = [f"{joint.spring.name} spring"] if isinstance(joint, FlexibleJoint) and not joint.spring.linear else []
    laws += [] if joint.friction.linear else [f"{joint.friction.name} friction"]
    laws += [] if joint.ripple is None else ["ripple"]
    return " and ".join(laws)


def law_starts(
    joint: Joint, linear: Joint, values: Mapping[str, float], motion: JointMotion, given: Mapping[str, float]
) -> list[dict[str, float]]:
    """Return the starts of the search of a joint's laws, each with the values of all its parameters.

    Args:
        joint: with nonlinear laws.
        linear: the same with others, which were found.
        values: of its parameters.
        motion: of it.
        given: starts that are stated.
    """
    springs: list[dict[str, float]] = [{}]
    frictions: list[dict[str, float]] = [{}]
    sides = {"": motion.motor}
    if isinstance(joint, FlexibleJoint):
        assert motion.load is not None and isinstance(linear, FlexibleJoint)
        sides = {"motor_": motion.motor, "load_": motion.load}
        windup = float(np.max(np.abs(motion.motor[0] - motion.load[0])))
        if joint.spring != linear.spring and not (values["stiffness"] > 0.0 and windup > 0.0):
            raise MethodError(
                f"A {joint.spring.name} spring is searched from a linear one, and the record shows none; identify "
                'the joint with spring = "linear", or as rigid.'
            )
        springs = list(joint.spring.starts(values, windup)) if joint.spring != linear.spring else springs
    if joint.friction != linear.friction:
        by_side = []
        for prefix, (position, velocity) in sides.items():
            lines = (joint.friction.mean(part, prefix) for part in PARTS)
            viscous, coulomb = (sum(by * values[name] for name, by in line.items()) for line in lines)
            speed, travel = float(np.max(np.abs(velocity))), float(np.ptp(position))
            size = MotionSize(speed, travel, motion.duration, viscous, coulomb)
            by_side.append(joint.friction.starts(size, prefix))
        frictions = [dict(ChainMap(*both)) for both in zip(*by_side, strict=True)]
    still = {} if joint.ripple is None else dict.fromkeys((p.name for p in joint.ripple.parameters), 0.0)
    return [{**still, **values, **spring, **own, **given} for spring, own in product(springs, frictions)]
