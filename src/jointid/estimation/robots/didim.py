"""DIDIM of a robot: all parameters from the motors' torques and the commanded references alone.

**Rigid joints.** The robot is simulated under its controllers at the current parameters, and the regressor W of the
simulated motion gives the next change of the parameters, by least squares over the joints' filtered errors, each
divided by its size::

    tau - tau_sim = W dx

in the residual form of M. Gautier, A. Janot and P.-O. Vandanjon (A new closed-loop output error method for parameter
identification of robot dynamics, IEEE Transactions on Control Systems Technology 21, 2013). The measurement's noise
does not reach W, which so acts as instruments for the derivatives J of the torques; the covariance is theirs, robust to
autocorrelation (`uncertainty.covariance`), with J by variation. The search begins at what the inverse model finds on a
motion that the records imply. The column of Coulomb friction is that of the direction of sliding, but of the velocity's
sign where it is now 0 or less: a mass without it never rests, and a fixed point with a negative one would stay. Viscous
and Coulomb friction are not let below 0. Valid for rigid joints, or below about a fifth of the first resonance; the
robot at rest at the first sample, or moving as its references do.

**Flexible joints.** The torque error of all joints is made least by Levenberg and Marquardt's steps with derivatives by
variation (`solvers.bounded_least_squares`), rotors' inertias and stiffnesses on a logarithmic scale. The joints are
weighted by their errors. The steps in order:

1. The robot of rigid joints, split into rotors, springs and links (`starts.robot_springs`).
2. A frequency for each spring, given or the best of a row of them; and a rough descent from there.
3. Where that leads nowhere: rough descents from one frequency of all springs, and from stiff springs.
4. Where no spring can be seen then, the answer is that none is shown. A search for them would go on for minutes along
   what the record does not tell.
5. A close descent, and fine ones, each with the joints' errors estimated anew, until these settle. A search may leave a
   wrong minimum after the joint that led it there weighs less.

Whether a record shows a spring is asked of each joint alone, by its compliance c = 1/K, in which a rigid joint is not
at infinity but at 0: it is shown where c is more than four of its standard deviations above 0, with the spring not at
the stiffest of the search. Otherwise the stiffness is refused, and ``1 / (c + 2 std)`` is its bound from below. Valid
for springs that are linear and tie each rotor to its own link, and rotors that turn fast against the links: their
gyroscopic torques are left out [Spong 1987].

**Laws that are not linear**, and free delays of the torques, are searched from the end with linear ones, axis by axis.
As of one joint (`starts.nonlinear_laws`) every start of an axis's laws is followed a little, and the best is kept. The
axes before it have their laws by then, those after it lines. At last all are searched together to the full tolerance.
Free delays come before the laws: a law is found where torque and motion are in time alone. Where no delay is declared,
that search begins at the fixed point of several delays that leaves the least torque error.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from jointid.common.arrays import FloatArray
from jointid.common.errors import MethodError
from jointid.common.messages import Progress, ignore_progress, no_choice
from jointid.common.parameters import Bounds, Parameter
from jointid.common.text import pluralise
from jointid.estimation.methods.didim import DIDIM
from jointid.estimation.problems.base import DELAY, DELAYS
from jointid.estimation.problems.closed_loop import torque_problem
from jointid.estimation.result.robot import SpringVerdict
from jointid.estimation.robots.fit import NEAR, OFF, SETTLED, UNSEEN, Descents, End, RobotFit, fixed_point
from jointid.estimation.robots.numbers import (
    add_delays,
    apply_constraints,
    find_free_delays,
    name_in_robot,
    robot_parameters,
    with_delays,
)
from jointid.estimation.robots.problem import (
    EXACT,
    RobotLoopProblem,
    RobotProblem,
    RobotRuns,
    add_problems,
    robot_problem,
)
from jointid.estimation.robots.regression import Records, each_log
from jointid.estimation.starts.inverse_controller import command_of, reconstructed_position
from jointid.estimation.starts.nonlinear_laws import JointMotion, law_starts, name_laws
from jointid.estimation.starts.robot_springs import STIFFEST, StartOfSprings, bound_springs, frequency_row
from jointid.models.controllers import numbers_of
from jointid.models.joints import ClosedLoop, RigidJoint
from jointid.models.robots.robot import Robot, RobotJoint
from jointid.records.record import Channel, Record, Timing
from jointid.records.signals.filtering import (
    Filtering,
    apply_window,
    differentiate_twice,
    lowpass,
    settle,
    window_torque,
)
from jointid.simulation.derivatives import columns_of
from jointid.simulation.loop_input import RobotLoop
from jointid.simulation.robot_numbers import NumberOf, law_places, values_of_joint
from jointid.simulation.simulate import MassMotion, Outcome, Run, motion_at
from jointid.solvers.solve import Status

SLOW = Filtering(cutoff=4.0)
"""Below the modes, where a robot is as good as rigid."""

_REWEIGHTINGS = 2
_SHOWN = 4.0  # standard deviations by which a compliance differs from 0
_REACH, _FACTOR = math.log(3.0), 2.0  # of a step: of a parameter on a logarithmic scale, and over the start of a law's
_LATE = 2e-3  # s of a step: a delay by at most so much
_DAMPED = 5.0  # of a step: a spring's damping by at most so many times what it begins with


def search_robot(
    loop: RobotLoop,
    records: Records,
    filtering: Filtering | None = None,
    settings: DIDIM | None = None,
    *,
    known: Mapping[str, Parameter] | None = None,
    settled: float = SETTLED,
    progress: Progress = ignore_progress,
) -> RobotFit:
    """Identify a robot from torques and references; positions in the records are not read.

    Args:
        loop: the robot, whose joints with a spring are flexible, and its controllers. Of its numbers only the links'
            places and gravity are read.
        records: one for each joint, with torque and reference, of one log; or those of several logs. To show a spring
            the motion must excite its mode, as a multisine on top of it does.
        filtering: that torques, columns and derivatives go through alike; its cut-off above the modes.
        settings: of the method.
        known: values and bounds to keep, by name; see `apply_constraints`.
        settled: the largest change of a parameter that ends the search of rigid joints, standard deviations.
        progress: receives each step.

    Raises:
        RecordError: a record lacks torque or reference, or has the wrong clock or unit.
        MethodError: the records do not determine the parameters, nothing can be simulated at the start, a frequency is
            missing, or a robot of rigid joints explains the torques better than the springs that were found.
    """
    settings, known, logs = settings or DIDIM(), known or {}, each_log(records)
    late = find_free_delays(loop, settings.free)
    if any(loop.robot.flexible):
        return _search_flexible(loop, logs, filtering, settings, known, late, progress)
    robot = loop.robot.rigid
    settled = settled if robot.linear.joints == robot.joints and not late else NEAR

    def pose(of: Robot, under: RobotLoop, freed: Sequence[int]) -> list[RobotLoopProblem]:
        under = replace(under, robot=of)
        parameters = apply_constraints(robot_parameters(of, offsets=settings.offsets), known)
        parameters = add_delays(parameters, under, freed)
        return [robot_problem(under, log, parameters, filtering) for log in logs]

    def search(under: RobotLoop) -> RobotFit:
        parts = pose(robot.linear, under, ())
        x, run = _start_rigid(parts[0], replace(under, robot=robot.linear), logs[0])
        problem: RobotProblem[Any] = parts[0]
        if len(parts) > 1:
            problem = add_problems(parts)
            run = problem.run(x)
            if run.outcome is not Outcome.FINISHED:
                raise MethodError(
                    "The robot cannot be simulated along all logs from the start that the first gives: "
                    f"{run.outcome.value}. Name a livelier record first."
                )
        return fixed_point(problem, x, run, settings.iterations, progress, settled)

    undeclared = [j for j in late if not numbers_of(loop.controllers[j]).get(DELAY)]
    tried = [with_delays(loop, dict.fromkeys(undeclared, delay)) for delay in DELAYS] if undeclared else [loop]
    ends, failures = list[tuple[RobotFit, RobotLoop]](), list[MethodError]()
    for under in tried:
        try:
            ends.append((search(under), under))
        except MethodError as error:  # no robot is stable with such a delay
            failures.append(error)
    if not ends:
        raise failures[0]
    end, near = min(ends, key=lambda one: float(np.linalg.norm(one[0].relative_error)))

    def with_laws(of: Robot) -> RobotProblem[Any]:
        return add_problems(pose(of, near, late))

    return _search_laws(robot, end, with_laws, known, settings.evaluations, progress, delays=bool(late))


# The start of rigid joints


def _start_rigid(problem: RobotLoopProblem, loop: RobotLoop, records: Sequence[Record]) -> tuple[FloatArray, Any]:
    """Return the start of a search and its simulation: the inverse model on the motion that the controllers saw.

    Where a controller cannot be turned round, the commanded motion is taken. A start of regular inertias is not tried:
    M(q) of one may not be positive definite in a pose.
    """
    clock = problem.experiment.clock
    commanded = problem.experiment.references[clock.log_index // clock.lengths.size]
    failures = []
    for name in ("inversion", "reference"):
        try:
            torques, positions = problem.measured, commanded
            if name == "inversion":
                torques, positions = _reconstruct(problem, loop, records, commanded)
        except MethodError as error:
            failures.append(str(error))
            continue
        x = _regress(problem, torques, positions)
        run = problem.run(x)
        if run.outcome is Outcome.FINISHED:
            return x, run
        failures.append(f"at the {name} start {run.outcome.value}.")
    alone = ", in SI units and not in a drive's whole numbers," if any(one.computed for one in records) else ","
    raise MethodError(
        "The robot cannot be simulated where its search begins: "
        + " ".join(failures)
        + f" Check the controllers' gains{alone} and their period where "
        "they run faster than the log, the signs and units of torques and references, and the joints' places."
    )


def _reconstruct(
    problem: RobotLoopProblem, loop: RobotLoop, records: Sequence[Record], commanded: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Return the motors' torques and the positions that the controllers must have seen, (samples, n) each."""
    measured, found = problem.measured, []
    for j, (link, controller, record) in enumerate(zip(loop.robot.links, loop.controllers, records, strict=True)):
        if problem.experiment.axes[j].clock.shows > 1:  # the log shows each output of this slow controller many times
            found.append((measured[:, j], commanded[:, j]))
            continue
        joint = RigidJoint(link.kind)
        alone = torque_problem(record, ClosedLoop(joint, controller), problem.filtering, joint.parameters)
        found.append((command_of(alone)[: len(measured)], reconstructed_position(alone)[: len(measured)]))
    torques, positions = (np.column_stack([pair[i] for pair in found]) for i in range(2))
    return torques, positions


def _regress(problem: RobotLoopProblem, torques: FloatArray, positions: FloatArray) -> FloatArray:
    """Return the inverse model's weighted estimate on a motion, within bounds."""
    sample_time, cutoff = problem.sample_time, problem.filtering.position_cutoff
    assert cutoff is not None
    n, each_loop = torques.shape[1], problem.experiment.axes
    smooth = lowpass(positions, cutoff, sample_time)
    each = [differentiate_twice(column, sample_time) for column in smooth.T]
    velocity, acceleration = (np.column_stack([pair[i] for pair in each]) for i in range(2))
    motion = MassMotion(smooth, velocity, acceleration, np.sign(settle(velocity)))
    parameters = problem.parameters
    rotors = parameters.base.rotors
    columns = columns_of(problem.tree, parameters.base, parameters.places, motion, rotors)
    held = [Channel(torques[:, j], "N m", sample_time, Timing.HELD) for j in range(n)]  # its unit is not read
    seen = np.column_stack(
        [window_torque(channel, each.law.delay) for channel, each in zip(held, each_loop, strict=True)]
    )
    borders = slice(*(50, len(seen) - 50) if len(seen) > 500 else (0, len(seen)))
    Y = problem.decimate(seen[borders])
    W = problem.decimate_columns([(own, apply_window(values)[borders]) for own, values in columns])
    floor = EXACT * float(np.linalg.norm(Y))
    return Bounds.of(problem.free).clip(problem.step(W, Y, floor, _REWEIGHTINGS)[1])


# Springs


def _search_flexible(
    loop: RobotLoop,
    logs: Sequence[Sequence[Record]],
    filtering: Filtering | None,
    settings: DIDIM,
    known: Mapping[str, Parameter],
    late: Sequence[int],
    progress: Progress,
) -> RobotFit:
    robot, frequencies = loop.robot, settings.frequencies or None

    def pose(of: Robot, freed: Sequence[int] = late) -> RobotProblem[Any]:
        parameters = apply_constraints(robot_parameters(of, offsets=settings.offsets, logarithmic=True), known)
        parameters, own = add_delays(parameters, loop, freed), replace(loop, robot=of)
        return add_problems([robot_problem(own, log, parameters, filtering) for log in logs])

    linear = replace(loop, robot=robot.linear)
    problem = pose(linear.robot, ())
    require_springs(robot, frequencies, problem.sample_time)
    stiff = replace(linear, robot=linear.robot.rigid)
    slow = replace(settings, free=(), frequencies={}, iterations=DIDIM().iterations)
    rigid = search_robot(stiff, logs, SLOW, slow, settled=NEAR, known=known, progress=progress)
    found = search_springs(problem, linear.robot, rigid, frequencies, settings.evaluations, progress)
    fit = _search_laws(robot, found, pose, known, settings.evaluations, progress, delays=bool(late))
    if fit is found:
        return found
    return replace(fit, iterations=found.iterations + fit.iterations, springs=_judge_springs(fit, robot))


def require_springs(robot: Robot, frequencies: Mapping[str, float] | None, sample_time: float) -> None:
    """Refuse a search of springs without one, or from frequencies that are missing or out of range.

    Args:
        robot: with the springs.
        frequencies: Hz, in which the search is to begin, by joint; None to search them.
        sample_time: s, of the records.

    Raises:
        MethodError: no joint has a spring, or a frequency is missing, of no flexible joint, or out of range.
    """
    flexible = [joint.name for joint in robot.joints if joint.spring is not None]
    if not flexible:
        raise MethodError(
            "No joint of this robot has a spring; give one a JointSpring, [joints.spring] of a robot file, or identify "
            "it as rigid, by idim or didim."
        )
    if frequencies is None:
        frequency_row(sample_time)
        return
    highest = STIFFEST / sample_time
    for name, hertz in frequencies.items():
        if name not in flexible:
            raise MethodError(f"A name in frequencies{no_choice(name, flexible)}")
        if not 0.0 < hertz <= highest:
            raise MethodError(
                f"The frequency of {name} is {hertz:g} Hz; expected one above 0 and up to {highest:g} Hz, of which a "
                "record of this sample time shows something: correct it, or give none at all to have them searched."
            )
    if missing := sorted(set(flexible) - set(frequencies)):
        raise MethodError(
            f"A frequency is needed for each flexible joint; {', '.join(missing)} has none: give one in Hz, or none "
            "at all to have them searched."
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
                replace(one, shown=False, stiffness=None, deviation=None) for one in _judge_springs(seen, robot)
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
    return replace(fit, springs=_judge_springs(fit, robot))


def _judge_springs(fit: RobotFit, robot: Robot) -> tuple[SpringVerdict, ...]:
    """Return whether the records show the spring of each flexible joint."""
    found = []
    for joint, link in zip(robot.joints, robot.links, strict=True):
        if joint.spring is None:
            continue
        stiffness, deviation = fit.value(f"{joint.name}.stiffness")
        compliance, spread = 1.0 / stiffness, deviation / stiffness**2
        bound = fit.parameters.parameters[fit.names.index(f"{joint.name}.stiffness")].upper
        shown = compliance > _SHOWN * spread and math.log(stiffness) < bound - OFF
        at_least, unit = 1.0 / (compliance + UNSEEN * spread), "N/m" if link.kind == "prismatic" else "N m/rad"
        told, std = (stiffness, deviation) if shown else (None, None)
        found.append(SpringVerdict(joint.name, shown, told, std, at_least, unit))
    return tuple(found)


# Delays and laws that are not linear


def _search_laws(
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
    assert isinstance(run, Run)
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
