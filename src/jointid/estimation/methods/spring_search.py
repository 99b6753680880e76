"""The search for a spring in pieces: from where a linear one ended, by the starts of its law, down by least squares.

The linear spring that fits best is one between the pieces: everything else about the joint is nearly right there. Where
the pieces begin is not known, and the criterion has more than one valley over it, so that every start of the law is
followed a little, and the best to the end.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from jointid.estimation.methods.search import History, Solved, least_squares
from jointid.estimation.problems.closed_loop import ClosedLoopProblem
from jointid.models.joints import ClosedLoop, FlexibleJoint

_ROUGHLY, _FEW = 1e-5, 30  # tolerance and evaluations of a descent that only has to show where it leads


def with_linear_spring(problem: ClosedLoopProblem) -> ClosedLoopProblem:
    """Return the problem of the same joint with a linear spring; itself where it has one."""
    joint = problem.joint
    assert isinstance(joint, FlexibleJoint)
    if joint.spring.linear:
        return problem
    given, linear = {p.name: p for p in problem.parameters}, joint.linear
    own = tuple(replace(given[p.name], symbol=p.symbol) for p in linear.parameters)
    loop = ClosedLoop(linear, problem.loop.controller)
    return replace(problem, loop=loop, parameters=(*own, *problem.parameters[len(joint.parameters) :]))


def from_linear_spring(problem: ClosedLoopProblem, found: Solved, tolerance: float, history: History) -> Solved:
    """Return where the search for a spring in pieces ends.

    Args:
        problem: of the joint with the spring in pieces.
        found: with a linear spring, see `with_linear_spring`.
        tolerance: of the parameters and the criterion.
        history: of the search.
    """
    joint, linear = problem.joint, found.problem
    assert isinstance(joint, FlexibleJoint)
    surroundings = linear.parameters[len(joint.linear.parameters) :]  # the search may have let the motor begin moving
    own = problem.parameters[: len(joint.parameters)]
    problem = replace(problem, filtering=linear.filtering, parameters=(*own, *surroundings))
    values, run = linear.values(found.solution.x), linear.simulate(found.solution.x)
    history.tally.evaluations += 1
    assert run.load_position is not None
    windup = float(np.max(np.abs(run.motor_position - run.load_position)))
    given = {p.name: p.start for p in own if p.start is not None}
    starts = [{**values, **start, **given} for start in joint.spring.starts(values["stiffness"], windup)]
    history.progress(f"looking for a {joint.spring.name} spring, from {len(starts)} starts")
    rough = replace(least_squares(problem, _ROUGHLY), evaluations=_FEW)
    ends = [history.solve(problem, rough, problem.vector(start)).solution for start in starts]
    best = min(ends, key=lambda end: float(np.linalg.norm(end.residual)))
    end = history.solve(problem, least_squares(problem, tolerance), best.x).solution
    return Solved(problem, replace(end, starts=found.solution.starts))
