"""Delays and nonlinear laws of a robot's axes: searched one after the other, from the end with linear ones.

As of one joint (`starts.nonlinear_laws`) every start of an axis's laws is followed a little, and the best is kept. The
axes before it have their laws by then, those after it lines. At last all are searched together to the full tolerance.
Free delays of the torques come before the laws: a law is found where torque and motion are in time alone.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from jointid.common.errors import MethodError
from jointid.common.messages import Progress
from jointid.common.parameters import Parameter
from jointid.common.text import pluralise
from jointid.estimation.robots.fit import Descents, End, RobotFit
from jointid.estimation.robots.numbers import name_in_robot
from jointid.estimation.robots.problem import RobotProblem, RobotRuns
from jointid.estimation.starts.nonlinear_laws import JointMotion, law_starts, name_laws
from jointid.models.robots.robot import Robot, RobotJoint
from jointid.simulation.robot_numbers import NumberOf, law_places, values_of_joint
from jointid.simulation.robots import RobotRun, motion_at

_REACH, _FACTOR = math.log(3.0), 2.0  # of a step: of a parameter on a logarithmic scale, and over the start of a law's
_LATE = 2e-3  # s of a step: a delay by at most so much
_DAMPED = 5.0  # of a step: a spring's damping by at most so many times what it begins with


def search_laws(
    robot: Robot,
    linear: RobotFit,
    pose: Callable[[Robot], RobotProblem[Any]],
    known: Mapping[str, Parameter],
    evaluations: int,
    progress: Progress,
    *,
    delays: bool = False,
) -> RobotFit:
    """Search the laws of a robot from the fit of `Robot.linear`, and the free delays of its torques.

    Args:
        robot: with its laws.
        linear: the fit with linear ones; itself the answer of a robot without others.
        pose: the problem of a robot, by its laws, with the delays that are free.
        known: starts of parameters, by name.
        evaluations: simulations with derivatives, at most, of each descent.
        progress: receives the steps.
        delays: whether any is free; each begins where its parameter does.

    Raises:
        MethodError: an axis cannot be simulated at any start of its laws, or where the search ends.
    """
    if robot.linear.joints == robot.joints and not delays:
        return linear
    descents, best, sigma = Descents(evaluations, progress), None, linear.sigma
    values, numbers = dict(zip(linear.names, linear.values, strict=True)), linear.run.numbers
    bounds = {p.name: p for p in linear.parameters.parameters}
    changed = [i for i, joint in enumerate(robot.joints) if joint.linear != joint]
    for i in (*([-1] if delays else []), *changed):  # the delays, then axis by axis
        laws = replace(robot, joints=(*robot.joints[: i + 1], *(other.linear for other in robot.joints[i + 1 :])))
        problem = _restore_bounds(pose(laws), bounds).with_sigma(sigma)
        values |= {p.name: p.start for p in problem.free if p.name not in values and p.start is not None}
        if i < 0:
            progress("looking for the delays of the torques")
            best, what = _descend(descents, problem, values), "delays"
        else:
            joint = robot.joints[i]
            starts = _starts_of(joint, values_of_joint(numbers, i), _motion_of(linear, i), known)
            progress(f"{joint.name}: looking for a {name_laws(joint.model)}, from {pluralise(len(starts), 'start')}")
            ends = [_descend(descents, problem, values | start) for start in starts]
            best, what = min(ends, key=lambda end: end.norm), f"laws of {joint.name}"
        if not best.solution.jacobian.any():
            raise MethodError(
                f"The robot cannot be simulated where the search of the {what} begins: "
                f"{best.problem.run(best.solution.x).outcome.value}. Declare simpler laws, or state starts of their "
                "parameters."
            )
        found = problem.parameters.values(best.solution.x)
        values, numbers = dict(zip(problem.parameters.names, found, strict=True)), problem.parameters.numbers(found)
        sigma = best.reweight().sigma
    assert best is not None
    end = descents.finish(problem, best)
    fit = end.fit(descents.made)
    if fit is None:
        raise MethodError(
            "The search of the laws led to where the robot cannot be simulated: "
            f"{problem.run(end.solution.x).outcome.value}. Declare simpler laws, or state starts of their parameters."
        )
    return fit


def _starts_of(
    joint: RobotJoint, values: Mapping[str, float], motion: JointMotion, known: Mapping[str, Parameter]
) -> list[dict[str, float]]:
    """Return the starts of one axis's laws, by the names of the robot's parameters."""
    own = {p.name: known.get(name_in_robot(joint.name, p.name)) for p in joint.model.parameters}
    given = {name: p.start for name, p in own.items() if p is not None and p.start is not None}
    starts = law_starts(joint.model, joint.linear.model, values, motion, given)
    return [{name_in_robot(joint.name, name): x for name, x in start.items()} for start in starts]


def _restore_bounds(problem: RobotProblem[Any], bounds: Mapping[str, Parameter]) -> RobotProblem[Any]:
    """Return the problem with the bounds that the search with linear laws had."""
    parameters = tuple(
        replace(p, lower=bounds[p.name].lower, upper=bounds[p.name].upper) if p.name in bounds else p
        for p in problem.free
    )
    return replace(problem, parameters=replace(problem.parameters, parameters=parameters))


def _motion_of(fit: RobotFit, joint: int) -> JointMotion:
    """Return the simulated motion of one axis."""
    run = fit.run.each[0] if isinstance(fit.run, RobotRuns) else fit.run
    assert isinstance(run, RobotRun)
    clock, rotor = run.experiment.clock, int(run.numbers.rotors[joint])
    seen = motion_at(run, clock.log_index)
    motor, link = ((seen.position[:, row], seen.velocity[:, row]) for row in (rotor, joint))
    return JointMotion(clock.sample_time * clock.samples, motor, link if rotor != joint else None)


def _descend(descents: Descents, problem: RobotProblem[Any], values: Mapping[str, float]) -> End:
    """Descend close to the minimum that a start leads to."""
    parameters = problem.parameters
    begin = np.array([values[name] for name in parameters.names])
    reach = np.where(parameters.logarithmic, _REACH, np.inf)
    own = {place for place, _ in law_places(parameters.base)}
    for c, place in enumerate(parameters.places):
        damping = place.of is NumberOf.SPRING and place.column == 1
        if place.of is NumberOf.DELAY:
            reach[c] = _LATE
        elif (place in own or damping) and begin[c] != 0.0:
            reach[c] = (_DAMPED if damping else _FACTOR) * abs(begin[c])
    return descents.follow(problem.roughly(), begin, reach)
