"""DIDIM of a robot with flexible joints: rotors, springs, friction on both sides and the links, from torques alone.

The torque error of all joints is made least by Levenberg and Marquardt's steps with derivatives by variation
(`solvers.bounded_least_squares`), rotors' inertias and stiffnesses on a logarithmic scale. The joints are weighted by
their errors. The steps in order:

1. The robot of rigid joints, split into rotors, springs and links (`starts.robot_springs`).
2. A frequency for each spring, given or the best of a row of them; and a rough descent from there.
3. Where that leads nowhere: rough descents from one frequency of all springs, and from stiff springs.
4. Where no spring can be seen then, the answer is that none is shown. A search for them would go on for minutes along
   what the record does not tell.
5. A close descent, and fine ones, each with the joints' errors estimated anew, until these settle. A search may leave a
   wrong minimum after the joint that led it there weighs less.

Whether a record shows a spring is asked of each joint alone, by its compliance c = 1/K, in which a rigid joint is not
at infinity but at 0: it is shown where c is more than four of its standard deviations above 0, with the spring not at
the stiffest of the search. Otherwise the stiffness is refused, and ``1 / (c + 2 std)`` is its bound from below.

Valid for springs that are linear and tie each rotor to its own link, and rotors that turn fast against the links: their
gyroscopic torques are left out [Spong 1987].
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from jointid.common.errors import MethodError
from jointid.common.messages import Progress, no_choice
from jointid.common.parameters import Parameter
from jointid.estimation.result.robot import SpringVerdict
from jointid.estimation.robots.didim import identify_rigid_robot
from jointid.estimation.robots.fit import NEAR, OFF, UNSEEN, Descents, RobotFit
from jointid.estimation.robots.laws import search_laws
from jointid.estimation.robots.numbers import add_delays, apply_constraints, find_free_delays, robot_parameters
from jointid.estimation.robots.problem import RobotProblem, add_problems, robot_problem
from jointid.estimation.robots.regression import Records, each_log
from jointid.estimation.starts.robot_springs import STIFFEST, StartOfSprings, bound_springs, frequency_row
from jointid.models.robots.robot import Robot
from jointid.records.signals.filtering import Filtering
from jointid.simulation.robots import RobotLoop
from jointid.solvers.solve import Status

SLOW = Filtering(cutoff=4.0)
"""Below the modes, where a robot is as good as rigid."""

_SHOWN = 4.0  # standard deviations by which a compliance differs from 0


def identify_flexible_robot(
    loop: RobotLoop,
    records: Records,
    filtering: Filtering | None = None,
    *,
    frequencies: Mapping[str, float] | None = None,
    offsets: bool = True,
    evaluations: int = 60,
    known: Mapping[str, Parameter] | None = None,
    free: Sequence[str] = (),
    progress: Progress = lambda _: None,
) -> RobotFit:
    """Identify a robot, of which some joints are flexible, from torques and references; positions are not read.

    Args:
        loop: the robot, whose joints with a spring are flexible, and its controllers. Of the robot's numbers only the
            links' places and gravity are read.
        records: one for each joint, with torque and reference, of one log; to show a spring the motion must excite its
            mode, as a multisine on top of it does.
        filtering: that torques and derivatives go through alike; its cut-off above the modes.
        frequencies: Hz, of the mode of rotor against link of each flexible joint with the others stiff, where the
            search is to begin; None looks for it between 5 and 38 Hz.
        offsets: whether each motor has a constant torque that is identified, too.
        evaluations: simulations with derivatives, at most, of each search; there are three to eleven.
        known: values and bounds to keep, by name; see `apply_constraints`.
        free: of the delays of the torques, see `find_free_delays`; springs are searched under those declared.
        progress: receives the steps.

    Raises:
        RecordError: a record lacks torque or reference, or has the wrong clock or unit.
        MethodError: no joint has a spring, a frequency is missing, the log is too slow to look for one, nothing can be
            simulated at the start, or a robot of rigid joints explains the torques better.
    """
    robot = loop.robot
    require_springs(robot, frequencies)
    known = known or {}

    late = find_free_delays(loop, free)

    def pose(of: Robot, freed: Sequence[int] = late) -> RobotProblem[Any]:
        parameters = apply_constraints(robot_parameters(of, offsets=offsets, logarithmic=True), known)
        parameters, own = add_delays(parameters, loop, freed), replace(loop, robot=of)
        return add_problems([robot_problem(own, log, parameters, filtering) for log in each_log(records)])

    linear = replace(loop, robot=robot.linear)
    problem = pose(linear.robot, ())
    if frequencies is None:
        frequency_row(problem.sample_time)
    require_frequencies(frequencies, problem.sample_time)
    rigid = identify_rigid_robot(linear, records, SLOW, offsets=offsets, settled=NEAR, known=known, progress=progress)
    found = search_springs(problem, linear.robot, rigid, frequencies, evaluations, progress)
    fit = search_laws(robot, found, pose, known, evaluations, progress, delays=bool(late))
    if fit is found:
        return found
    return replace(fit, iterations=found.iterations + fit.iterations, springs=judge_springs(fit, robot))


def require_springs(robot: Robot, frequencies: Mapping[str, float] | None) -> None:
    """Raise MethodError if no joint has a spring, or a frequency is missing, or is of no flexible joint."""
    flexible = [joint.name for joint in robot.joints if joint.spring is not None]
    if not flexible:
        raise MethodError(
            "No joint of this robot has a spring; give one a JointSpring, [joints.spring] of a robot file, or identify "
            "it as rigid, by idim or didim."
        )
    if frequencies is not None and (missing := sorted(set(flexible) - set(frequencies))):
        raise MethodError(
            f"A frequency is needed for each flexible joint; {', '.join(missing)} has none: give one in Hz, or none "
            "at all to have them searched."
        )
    for name in frequencies or ():
        if name not in flexible:
            raise MethodError(f"A name in frequencies{no_choice(name, flexible)}")


def require_frequencies(frequencies: Mapping[str, float] | None, sample_time: float) -> None:
    """Refuse a frequency outside the range of the search."""
    highest = STIFFEST / sample_time
    for name, hertz in (frequencies or {}).items():
        if not 0.0 < hertz <= highest:
            raise MethodError(
                f"The frequency of {name} is {hertz:g} Hz; expected one above 0 and up to {highest:g} Hz, of which a "
                "record of this sample time shows something: correct it, or give none at all to have them searched."
            )


def search_springs(
    problem: RobotProblem[Any],
    robot: Robot,
    rigid: RobotFit,
    frequencies: Mapping[str, float] | None,
    evaluations: int,
    progress: Progress,
) -> RobotFit:
    """Search the flexible robot of the least torque error, from the rigid one; see the module.

    Args:
        problem: of the flexible robot.
        robot: that is identified.
        rigid: what was found of it with stiff joints, below the modes.
        frequencies: of the flexible joints at which the search is to begin, Hz; None to search them.
        evaluations: at most, of each descent.
        progress: receives the steps.

    Raises:
        MethodError: nothing can be simulated at the start, or a robot of rigid joints explains the torques better.
    """
    error = problem.error(rigid.run)
    problem = problem.reweight(error, rigid.values.size)
    start = StartOfSprings.of(problem.roughly(), rigid, robot.names)
    hertz = frequencies or start.search(progress)
    problem = bound_springs(problem, start)
    rough = problem.roughly()
    error = rough.error(rough.simulate(rigid.run.numbers))
    without = float(np.linalg.norm(error * rough.weights(error.size)))
    descents = Descents(evaluations, progress)
    end = descents.begin(rough, start, hertz, without)
    if end.solution.status is Status.NOT_EVALUABLE:
        raise MethodError(
            f"The robot cannot be simulated where its search begins: {rough.run(end.solution.x).outcome.value}. Give "
            "other frequencies, or a record in which all joints move more."
        )
    stiff = not end.solution.converged and end.norm > without
    if stiff:
        # No better than without springs: a robot that has none, or whose modes are high, is found from stiff ones.
        end = descents.from_start(rough, start, start.all_at(start.stiff))

    if not end.may_show or (stiff and end.norm > without):
        seen = end.of(problem).fit(descents.made)
        if seen is not None:
            springs = tuple(
                replace(one, shown=False, stiffness=None, deviation=None) for one in judge_springs(seen, robot)
            )
            return replace(seen, springs=springs)
    end = descents.finish(problem, end)
    fit = end.fit(descents.made)
    if fit is None:
        raise MethodError(
            f"The search led to where the robot cannot be simulated: {problem.run(end.solution.x).outcome.value}. Give "
            "other frequencies, or leave out springs of joints that are stiff."
        )
    before, after = (problem.norms(problem.error(one.run)) for one in (rigid, fit))
    if np.all(after >= before):
        raise MethodError(
            "A robot of rigid joints explains the torque of every joint better than the one that the search of springs "
            "ended at; leave the springs out of the robot file, or excite their modes by a multisine."
        )
    return replace(fit, springs=judge_springs(fit, robot))


def judge_springs(fit: RobotFit, robot: Robot) -> tuple[SpringVerdict, ...]:
    """Return whether the records show the spring of each flexible joint."""
    return tuple(
        _judge(fit, joint.name, "N/m" if link.kind == "prismatic" else "N m/rad")
        for joint, link in zip(robot.joints, robot.links, strict=True)
        if joint.spring is not None
    )


def _judge(fit: RobotFit, joint: str, unit: str) -> SpringVerdict:
    """Return whether the records show a joint's spring."""
    stiffness, deviation = fit.value(f"{joint}.stiffness")
    compliance, spread = 1.0 / stiffness, deviation / stiffness**2
    bound = fit.parameters.parameters[fit.names.index(f"{joint}.stiffness")].upper
    shown = compliance > _SHOWN * spread and math.log(stiffness) < bound - OFF
    at_least = 1.0 / (compliance + UNSEEN * spread)
    return SpringVerdict(joint, shown, stiffness if shown else None, deviation if shown else None, at_least, unit)
