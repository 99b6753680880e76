"""DIDIM of a robot with flexible joints: rotors, springs, friction on both sides and the links, from torques alone.

A robot of rigid joints is identified first. It fixes sums: of both sides' friction, of rotor and link. These are
split, what it says of each by how well it knows it. Each spring is begun at a frequency, given or the best of a row
of them that all joints go through together; where that leads nowhere, from one frequency of all. The torque error of
all joints is then made least by Levenberg and Marquardt's steps with derivatives by variation
(`solvers.bounded_least_squares`), rotors' inertias and stiffnesses on a logarithmic scale. The joints weigh by their
errors, which are estimated again until they settle, a few times at most: a search may leave a wrong minimum after the
joint that led it there weighs less.

Whether a record shows a spring is asked of each joint alone, by its compliance c = 1/K, in which a rigid joint is not
at infinity but at 0: it is shown where c is more than four of its standard deviations above 0, with the spring not at
the stiffest that is looked for. Otherwise the stiffness is refused, and ``1 / (c + 2 std)`` is its bound from below.

Valid for springs that are linear and tie each rotor to its own link, and rotors that turn fast against the links: their
gyroscopic torques are left out [Spong 1987].
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from jointid.common.errors import MethodError
from jointid.common.messages import Progress, no_choice
from jointid.estimation.robots.didim import RobotFit, identify_rigid_robot, joint_sizes
from jointid.estimation.robots.numbers import robot_parameters
from jointid.estimation.robots.problem import RobotProblem, robot_problem
from jointid.estimation.robots.spring_search import CLOSE, FIRST, OFF, ROUGH, Aim, begin_search, least_error, search
from jointid.estimation.starts.robot_springs import STIFFEST, StartOfSprings, bound_springs, frequency_row
from jointid.models.robots.robot import Robot
from jointid.records.record import Record
from jointid.records.signals.filtering import Filtering
from jointid.simulation.robots import RobotLoop
from jointid.solvers.solve import Status

SLOW = Filtering(cutoff=4.0)
"""Below the modes, where a robot is as good as rigid."""

_NEAR = 0.2  # standard deviations: a change of the rigid robot's parameters that is none where springs are to follow
_TURNS, _SETTLED = 4, 0.4  # searches with new sizes of the joints' errors, and their change that asks for no other
_SHOWN = 4.0  # standard deviations by which a compliance is told from 0
_TWO = 2.0  # of them: the bound of one that is not


_FINE = 3e-5  # tolerance at last
_LAST = 0.1  # of the sum of squares in units of the noise, a step's worth there: all parameters move by 0.3 deviations


@dataclass(frozen=True, slots=True)
class SpringVerdict:
    """Whether the records show the spring of a joint.

    Attributes:
        joint: its name.
        shown: whether they do.
        stiffness: N m/rad or N/m; None where it is refused. deviation: of it, one standard deviation.
        at_least: the stiffness that it has at least, two standard deviations of its compliance away.
        unit: of these, N m/rad or N/m.
    """

    joint: str
    shown: bool
    stiffness: float | None
    deviation: float | None
    at_least: float
    unit: str = "N m/rad"

    def __str__(self) -> str:
        if self.stiffness is None or self.deviation is None:
            least = f"{self.at_least:.3g} {self.unit}"
            return f"{self.joint}: the records do not show a spring; its stiffness is at least {least}"
        return f"{self.joint}: stiffness {self.stiffness:.5g} +- {_TWO * self.deviation:.2g} {self.unit}"


@dataclass(frozen=True, slots=True, eq=False)
class FlexibleRobotFit:
    """What was identified of a robot with flexible joints.

    Attributes:
        fit: all parameters; of a spring that is refused, and of its joint's two sides, no interval is to be believed.
        springs: a verdict for each flexible joint.
        rigid: the robot of rigid joints that the search began from.
        evaluations: simulations with derivatives. message: how the search ended.
    """

    fit: RobotFit
    springs: tuple[SpringVerdict, ...]
    rigid: RobotFit
    evaluations: int
    message: str


def identify_flexible_robot(
    loop: RobotLoop,
    records: Sequence[Record],
    filtering: Filtering | None = None,
    *,
    frequencies: Mapping[str, float] | None = None,
    offsets: bool = True,
    evaluations: int = 60,
    progress: Progress = lambda _: None,
) -> FlexibleRobotFit:
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
        progress: is told the steps.

    Raises:
        RecordError: a record lacks torque or reference, or has the wrong clock or unit.
        MethodError: no joint has a spring, a frequency is missing, the log is too slow to look for one, nothing can be
            simulated at the start, or a robot of rigid joints explains the torques better.
    """
    robot = loop.robot
    require_springs(robot, frequencies)
    parameters = robot_parameters(robot, offsets=offsets, logarithmic=True)
    problem = robot_problem(loop, records, parameters, filtering)
    if frequencies is None:
        frequency_row(problem.sample_time)
    require_frequencies(frequencies, problem.sample_time)
    rigid = identify_rigid_robot(loop, records, SLOW, offsets=offsets, settled=_NEAR, progress=progress)
    return search_springs(
        problem, robot, rigid, lambda start: frequencies or start.search(progress), evaluations, progress
    )


def require_springs(robot: Robot, frequencies: Mapping[str, float] | None) -> None:
    """Raise MethodError if no joint has a spring, or a frequency is missing, or is of no flexible joint."""
    flexible = _springs(robot)
    if not flexible:
        raise MethodError(
            "No joint of this robot has a spring; give one a JointSpring, [joints.spring] of a robot file, or identify "
            "it as rigid, by idim or didim."
        )
    if frequencies is not None and (missing := sorted(set(flexible) - set(frequencies))):
        raise MethodError(
            f"A frequency is needed for each flexible joint; {', '.join(missing)} has none: give one in Hz, or none "
            "at all to have them looked for."
        )
    for name in frequencies or ():
        if name not in flexible:
            raise MethodError(f"A name in frequencies{no_choice(name, flexible)}")


def require_frequencies(frequencies: Mapping[str, float] | None, sample_time: float) -> None:
    """Raise MethodError if a frequency is none that is looked for in such a log."""
    highest = STIFFEST / sample_time
    for name, hertz in (frequencies or {}).items():
        if not 0.0 < hertz <= highest:
            raise MethodError(
                f"The frequency of {name} is {hertz:g} Hz; expected one above 0 and up to {highest:g} Hz, of which a "
                "record of this sample time shows something: correct it, or give none at all to have them looked for."
            )


def _springs(robot: Robot) -> list[str]:
    """Return the names of the flexible joints."""
    return [joint.name for joint in robot.joints if joint.spring is not None]


def search_springs(
    problem: RobotProblem[Any],
    robot: Robot,
    rigid: RobotFit,
    look: Callable[[StartOfSprings], Mapping[str, float]],
    evaluations: int,
    progress: Progress,
) -> FlexibleRobotFit:
    """Return the flexible robot that leaves the least torque error, searched from the rigid one.

    Args:
        problem: of the flexible robot.
        robot: that is identified.
        rigid: what was found of it with stiff joints, below the modes.
        look: for the frequencies of the flexible joints at which the search is to begin, Hz, in the robot split.
        evaluations: at most, of each search.
        progress: is told the steps.

    Raises:
        MethodError: nothing can be simulated at the start, or a robot of rigid joints explains the torques better.
    """
    flexible = _springs(robot)
    problem = problem.weighted(joint_sizes(problem, problem.error(rigid.run), rigid.values.size, least_error(problem)))
    start = StartOfSprings.of(problem.roughly(), rigid, robot.names)
    hertz = look(start)
    problem = bound_springs(problem, start)
    rough = problem.roughly()
    errors = problem.error(rigid.run)
    without = float(np.linalg.norm(errors * problem.weights(errors.size)))
    end = begin_search(rough, start, hertz, without, evaluations, progress)
    if end.solution.status is Status.NOT_EVALUABLE:
        raise MethodError(
            f"The robot cannot be simulated where its search begins: {rough.run(end.solution.x).outcome.value}. Give "
            "other frequencies, or a record in which all joints move more."
        )
    stiff = not end.solution.converged and end.norm > without
    if stiff:
        # No better than without springs: a robot that has none, or whose modes are high, is found from stiff ones.
        before = end.made
        end = search(rough, start.begin(start.all_at(start.stiff)), ROUGH, min(FIRST, evaluations), progress)
        end = replace(end, made=before + end.made)
    kinds = dict(zip(robot.names, (link.kind for link in robot.links), strict=True))
    units = {name: "N/m" if kinds[name] == "prismatic" else "N m/rad" for name in flexible}
    # A search without springs to find goes on for minutes along what the record does not tell.
    if (not end.may_show or (stiff and end.norm > without)) and (seen := end.of(problem).fit()) is not None:
        found = (_judge(seen, problem, name, units[name]) for name in flexible)
        springs = tuple(replace(one, shown=False, stiffness=None, deviation=None) for one in found)
        return FlexibleRobotFit(seen, springs, rigid, seen.iterations, "no joint shows a spring")
    end = search(end.reweighted(), end, CLOSE, evaluations, progress).of(problem)
    for _ in range(_TURNS):
        weighed = end.reweighted()
        end = search(weighed, end, Aim(_FINE, _LAST / end.solution.residual.size), evaluations, progress)
        change = np.log(end.reweighted().sigma / weighed.sigma)
        if not end.solution.converged or np.all(np.abs(change) < _SETTLED):
            break
    fit = end.fit()
    if fit is None:
        raise MethodError(
            f"The search led to where the robot cannot be simulated: {problem.run(end.solution.x).outcome.value}. Give "
            "other frequencies, or leave out springs of joints that are stiff."
        )
    before, after = (np.linalg.norm(problem.by_joint(problem.error(one.run)), axis=1) for one in (rigid, fit))
    if np.all(after >= before):
        raise MethodError(
            "A robot of rigid joints explains the torque of every joint better than the one that the search of springs "
            "ended at; leave the springs out of the robot file, or excite their modes by a multisine."
        )
    springs = tuple(_judge(fit, problem, name, units[name]) for name in flexible)
    return FlexibleRobotFit(fit, springs, rigid, fit.iterations, end.solution.message)


def _judge(fit: RobotFit, problem: RobotProblem[Any], joint: str, unit: str) -> SpringVerdict:
    """Return whether the records show a joint's spring."""
    stiffness, deviation = fit.value(f"{joint}.stiffness")
    compliance, spread = 1.0 / stiffness, deviation / stiffness**2
    bound = problem.free[fit.names.index(f"{joint}.stiffness")].upper
    shown = compliance > _SHOWN * spread and math.log(stiffness) < bound - OFF
    at_least = 1.0 / (compliance + _TWO * spread)
    return SpringVerdict(joint, shown, stiffness if shown else None, deviation if shown else None, at_least, unit)
