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
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from jointid.common.arrays import FloatArray
from jointid.common.errors import MethodError
from jointid.common.messages import Progress, no_choice
from jointid.common.parameters import Parameter, Quantity
from jointid.estimation.result.robot import SpringVerdict
from jointid.estimation.robots.didim import RobotFit, conclude, identify_rigid_robot
from jointid.estimation.robots.numbers import apply_constraints, robot_parameters
from jointid.estimation.robots.problem import RobotProblem, add_problems, robot_problem
from jointid.estimation.robots.regression import Records, each_log
from jointid.estimation.starts.robot_springs import STIFFEST, StartOfSprings, bound_springs, frequency_row
from jointid.models.robots.robot import Robot
from jointid.records.signals.filtering import Filtering
from jointid.simulation.robots import RobotLoop, RobotOutcome
from jointid.solvers.bounded_least_squares import LevenbergMarquardt
from jointid.solvers.solve import Counted, Solution, Status, Step, solve
from jointid.uncertainty.covariance import white

SLOW = Filtering(cutoff=4.0)
"""Below the modes, where a robot is as good as rigid."""

_NEAR = 0.2  # standard deviations: a change of the rigid robot's parameters that is none where springs are to follow
_COMMON = 11.25, 16.875, 25.3125  # Hz of all springs, where the first descent leads nowhere
_FIRST, _TRIED = 12, 6  # evaluations of a rough descent, mostly enough; and of those from other frequencies
_ROUGH, _CLOSE = (3e-2, 1e-2), (1e-3, 1e-4)  # tolerance, and what a step is to promise: shares of the criterion
_FINE = 3e-5  # tolerance at last
_LAST = 0.1  # of the sum of squares in units of the noise, a step's worth there: all parameters move by 0.3 deviations
_FALLING = 0.7  # of its error before a step: a descent that is on its way
_POOR = 0.1  # of a joint's filtered torque: an error that is more than noise
_TURNS, _SETTLED = 4, 0.4  # descents with new sizes of the joints' errors, and their change that asks for no other
_OFF = 1e-3  # of the stiffest, on a logarithmic scale: a spring that is not at its bound
_SHOWN = 4.0  # standard deviations by which a compliance differs from 0
_TWO = 2.0  # of them: the bound of one that is not


@dataclass(frozen=True, slots=True, eq=False)
class FlexibleRobotFit:
    """The fit of a robot with flexible joints.

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
    records: Records,
    filtering: Filtering | None = None,
    *,
    frequencies: Mapping[str, float] | None = None,
    offsets: bool = True,
    evaluations: int = 60,
    known: Mapping[str, Parameter] | None = None,
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
        known: values and bounds to keep, by name; see `apply_constraints`.
        progress: receives the steps.

    Raises:
        RecordError: a record lacks torque or reference, or has the wrong clock or unit.
        MethodError: no joint has a spring, a frequency is missing, the log is too slow to look for one, nothing can be
            simulated at the start, or a robot of rigid joints explains the torques better.
    """
    robot = loop.robot
    require_springs(robot, frequencies)
    parameters = apply_constraints(robot_parameters(robot, offsets=offsets, logarithmic=True), known or {})
    problem = add_problems([robot_problem(loop, log, parameters, filtering) for log in each_log(records)])
    if frequencies is None:
        frequency_row(problem.sample_time)
    require_frequencies(frequencies, problem.sample_time)
    rigid = identify_rigid_robot(loop, records, SLOW, offsets=offsets, settled=_NEAR, known=known, progress=progress)
    return search_springs(
        problem, robot, rigid, lambda start: frequencies or start.search(progress), evaluations, progress
    )


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
    look: Callable[[StartOfSprings], Mapping[str, float]],
    evaluations: int,
    progress: Progress,
) -> FlexibleRobotFit:
    """Search the flexible robot of the least torque error, from the rigid one; see the module.

    Args:
        problem: of the flexible robot.
        robot: that is identified.
        rigid: what was found of it with stiff joints, below the modes.
        look: for the frequencies of the flexible joints at which the search is to begin, Hz, in the robot split.
        evaluations: at most, of each descent.
        progress: receives the steps.

    Raises:
        MethodError: nothing can be simulated at the start, or a robot of rigid joints explains the torques better.
    """
    error = problem.error(rigid.run)
    problem = problem.reweight(error, rigid.values.size)
    start = StartOfSprings.of(problem.roughly(), rigid, robot.names)
    hertz = look(start)
    problem = bound_springs(problem, start)
    rough = problem.roughly()
    without = float(np.linalg.norm(error * problem.weights(error.size)))
    descents = _Descents(evaluations, progress)
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

    def judge_springs(fit: RobotFit) -> tuple[SpringVerdict, ...]:
        return tuple(
            _judge(fit, problem, joint.name, "N/m" if link.kind == "prismatic" else "N m/rad")
            for joint, link in zip(robot.joints, robot.links, strict=True)
            if joint.spring is not None
        )

    if not end.may_show or (stiff and end.norm > without):
        seen = end.of(problem).fit(descents.made)
        if seen is not None:
            springs = tuple(replace(one, shown=False, stiffness=None, deviation=None) for one in judge_springs(seen))
            return FlexibleRobotFit(seen, springs, rigid, descents.made, "no joint shows a spring")
    end = descents.from_end(end.reweight(), end, _CLOSE).of(problem)
    for _ in range(_TURNS):
        weighed = end.reweight()
        end = descents.from_end(weighed, end, (_FINE, _LAST / end.solution.residual.size))
        change = np.log(end.reweight().sigma / weighed.sigma)
        if not end.solution.converged or np.all(np.abs(change) < _SETTLED):
            break
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
    return FlexibleRobotFit(fit, judge_springs(fit), rigid, descents.made, end.solution.message)


@dataclass(frozen=True, slots=True, eq=False)
class _End:
    """The end of a descent.

    Attributes:
        problem: as the descent weighed it.
        solution: of that.
        reach: (free,) how far one step may move each parameter.
        finer: whether the problem simulates finer than the descent did, so that what is known of the end is only nearly
            so.
    """

    problem: RobotProblem[Any]
    solution: Solution
    reach: FloatArray
    finer: bool = False

    def of(self, problem: RobotProblem[Any]) -> _End:
        """Return the end as one of a problem that is simulated finer."""
        finer = problem.roughly() is not problem
        return replace(self, problem=problem.with_sigma(self.problem.sigma), finer=finer)

    def linearise(self) -> tuple[FloatArray, FloatArray]:
        """Return the error, (rows,), and its derivatives, (rows, free), not weighted."""
        weights = self.problem.weights(self.solution.residual.size)
        return self.solution.residual / weights, self.solution.jacobian / weights[:, np.newaxis]

    def reweight(self) -> RobotProblem[Any]:
        """Return the problem with the sizes of the errors that are left."""
        error, slopes = self.linearise()
        return self.problem.reweight(error, slopes.shape[1])

    @property
    def norm(self) -> float:
        """Of the weighted error that is left."""
        return float(np.linalg.norm(self.solution.residual))

    @property
    def may_show(self) -> bool:
        """Whether a longer search may find a spring: of one its compliance is above two deviations, off its end."""
        x, known = self.solution.x, white(self.solution.jacobian, self.solution.residual)
        return any(
            parameter.quantity is Quantity.STIFFNESS and 0.0 < std < 1.0 / _TWO and value < parameter.upper - _OFF
            for parameter, std, value in zip(self.problem.free, known.std, x, strict=True)
        )

    @property
    def leads_on(self) -> bool:
        """Whether the descent is on its way, or has ended with little of each joint's torque left."""
        trace = self.solution.trace
        if not self.solution.converged:
            return len(trace) > 1 and trace[-1].norm < _FALLING * trace[-2].norm
        left = self.problem.norms(self.linearise()[0])
        return not np.any(left > _POOR * self.problem.sizes)

    def fit(self, made: int) -> RobotFit | None:
        """Return the fit after so many evaluations; None where the robot cannot be simulated there."""
        x = self.solution.x
        run = self.problem.run(x)
        if run.outcome is not RobotOutcome.FINISHED:
            return None
        J = -self.linearise()[1]
        return conclude(self.problem, x, run, J, J, made, self.solution.converged)


class _Descents:
    """Descents to the least weighted torque error, with the evaluations of all counted.

    Args:
        evaluations: at most, of each.
        progress: receives the steps.
    """

    def __init__(self, evaluations: int, progress: Progress) -> None:
        self.evaluations, self.progress, self.made = evaluations, progress, 0

    def begin(
        self, problem: RobotProblem[Any], start: StartOfSprings, hertz: Mapping[str, float], without: float
    ) -> _End:
        """Descend from these frequencies, Hz, and from others if that fails; return the best end.

        A descent fails if it creeps or leaves much of a joint's torque unexplained. Others are not tried if it leaves
        more than the rigid robot, `without`, which may have no springs. A robot split into wrong rotors may look best
        on wrong frequencies. Of 200 random robots four did, and all came down from one frequency of all springs.
        """
        best = self.from_start(problem, start, start.values(hertz))
        if best.leads_on or best.norm > without:
            return best
        chosen = None
        for frequency in (f for f in _COMMON if f < start.stiff):
            values = start.all_at(frequency)
            other = self.from_start(problem, start, values, _TRIED)
            if other.norm < best.norm:
                best, chosen = other, values
        if chosen is not None and not best.solution.converged:
            # From its start once more: from an end the first steps would be long, and may leave the way.
            best = self.from_start(problem, start, chosen)
        return best

    def from_start(
        self, problem: RobotProblem[Any], start: StartOfSprings, values: FloatArray, evaluations: int = _FIRST
    ) -> _End:
        """Descend roughly from values of all parameters."""
        x = problem.parameters.to_search_variables(values)
        return self._descend(Counted(problem), x, start.reach(values), _ROUGH, min(evaluations, self.evaluations))

    def from_end(self, problem: RobotProblem[Any], end: _End, aim: tuple[float, float]) -> _End:
        """Descend from where another descent ended, with other weights."""
        counted, x = Counted(problem), end.solution.x
        if not end.finer:
            error, slopes = end.linearise()
            weights = problem.weights(error.size)
            counted.remember(x, error * weights, slopes * weights[:, np.newaxis])
        return self._descend(counted, x, end.reach, aim, self.evaluations)

    def _descend(
        self, counted: Counted, x: FloatArray, reach: FloatArray, aim: tuple[float, float], evaluations: int
    ) -> _End:
        def watch(step: Step) -> None:
            self.progress(f"{step.evaluations} simulations: weighted torque error {step.norm:.6g}")

        problem = counted.problem
        assert isinstance(problem, RobotProblem)
        (tolerance, worth), exact = aim, problem.floor / float(np.max(problem.sigma))
        found = solve(counted, LevenbergMarquardt(tolerance, evaluations, reach, worth, exact), x, watch)
        self.made += found.evaluations
        return _End(problem, found, reach)


def _judge(fit: RobotFit, problem: RobotProblem[Any], joint: str, unit: str) -> SpringVerdict:
    """Return whether the records show a joint's spring."""
    stiffness, deviation = fit.value(f"{joint}.stiffness")
    compliance, spread = 1.0 / stiffness, deviation / stiffness**2
    bound = problem.free[fit.names.index(f"{joint}.stiffness")].upper
    shown = compliance > _SHOWN * spread and math.log(stiffness) < bound - _OFF
    at_least = 1.0 / (compliance + _TWO * spread)
    return SpringVerdict(joint, shown, stiffness if shown else None, deviation if shown else None, at_least, unit)
