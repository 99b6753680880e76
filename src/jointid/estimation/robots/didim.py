"""The search of a robot's parameters: by DIDIM from torques and references, or on the drive side of its motors.

The robot is simulated (`problems.simulated`), and the torque error of all joints is made least by steps with
derivatives by variation (`solvers.bounded_least_squares`). The joints are weighted by their errors, which are estimated
anew until they settle; the covariance is robust to autocorrelation (`uncertainty.covariance`). Viscous and Coulomb
friction are not let below 0. Under its controllers the robot is at rest at the first sample, or moving as its
references do.

**Rigid joints.** From what the inverse model finds on a motion that the records imply, Gauss and Newton's steps settle
in two or three. Valid for rigid joints, or below about a fifth of the first resonance.

**Flexible joints.** Steps are Levenberg and Marquardt's, with rotors' inertias and stiffnesses on a logarithmic scale:

1. The robot of rigid joints, split into rotors, springs and links (`starts.robot_springs`).
2. A frequency for each spring, given or the best of a row of them; and a rough descent from there.
3. Where that leads nowhere: rough descents from one frequency of all springs, and from stiff springs.
4. Where no spring can be seen then, the answer is that none is shown. A search for them would go on for minutes along
   what the record does not tell.
5. A close descent, and fine ones. A search may leave a wrong minimum after the joint that led it there weighs less.

Whether a record shows a spring is asked of each joint alone, by its compliance c = 1/K, in which a rigid joint is not
at infinity but at 0: it is shown where c is more than four of its standard deviations above 0, with the spring not at
the stiffest of the search. Otherwise the stiffness is refused, and ``1 / (c + 2 std)`` is its bound from below. Valid
for springs that are linear and tie each rotor to its own link, and rotors that turn fast against the links: their
gyroscopic torques are left out [Spong 1987].

**Laws that are not linear**, and free delays of the torques, are searched from the end with linear ones, axis by axis.
As of one joint (`starts.nonlinear_laws`) every start of an axis's laws is followed a little, and the best is kept. The
axes before it have their laws by then, those after it lines. At last all are searched together to the full tolerance.
Free delays come before the laws: a law is found where torque and motion are in time alone. Where no delay is declared,
that search begins at the best rigid robot of several delays.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import replace
from typing import Any, cast

import numpy as np

from jointid.common.arrays import FloatArray
from jointid.common.errors import MethodError
from jointid.common.messages import Progress, ignore_progress
from jointid.common.parameters import Bounds, Parameter
from jointid.common.text import join, pluralise
from jointid.estimation.methods.didim import DIDIM
from jointid.estimation.methods.drive_side import DriveSideFit
from jointid.estimation.methods.idim import solve_rows
from jointid.estimation.problems.base import DELAY, DELAYS
from jointid.estimation.problems.closed_loop import torque_problem
from jointid.estimation.problems.inverse_model import Records, each_log, inverse_of_robot, motion_along
from jointid.estimation.problems.simulated import Simulated, outcome_of, pose_robot
from jointid.estimation.result.verdict import SpringVerdict
from jointid.estimation.robots.fit import OFF, UNSEEN, Descents, RobotFit
from jointid.estimation.robots.numbers import (
    apply_constraints,
    find_free_delays,
    name_in_robot,
    robot_parameters,
    with_delays,
)
from jointid.estimation.starts.inverse_controller import command_of, reconstructed_position
from jointid.estimation.starts.nonlinear_laws import JointMotion, law_starts, name_laws
from jointid.estimation.starts.robot_springs import STIFFEST, StartOfSprings, bound_springs, frequency_row
from jointid.models.controllers import numbers_of
from jointid.models.joints import ClosedLoop, RigidJoint
from jointid.models.robots.robot import Robot, RobotJoint
from jointid.records.record import Channel, Record, Timing
from jointid.records.signals.filtering import Filtering
from jointid.simulation.drive_side import RobotDriveSide
from jointid.simulation.loop_input import RobotLoop
from jointid.simulation.plant import values_of_joint
from jointid.simulation.simulate import Outcome, motion_at
from jointid.solvers.solve import Status

SLOW = Filtering(cutoff=4.0)
"""Below the modes, where a robot is as good as rigid."""

_SHOWN = 4.0  # standard deviations by which a compliance differs from 0
_REWEIGHTINGS = 2
_BORDERS, _SHORT = 50, 500  # samples at each end of a motion that is a guess, of more than so many


def search_robot(
    setup: RobotLoop | RobotDriveSide,
    records: Records,
    filtering: Filtering | None = None,
    settings: DIDIM | DriveSideFit | None = None,
    *,
    known: Mapping[str, Parameter] | None = None,
    progress: Progress = ignore_progress,
) -> RobotFit:
    """Identify a robot from torques and references, or along the motion of its motors.

    Args:
        setup: the robot, whose joints with a spring are flexible, and its controllers; or the robot along its motors'
            motion. Of its numbers only the links' places and gravity are read.
        records: one for each joint, with torque and reference or with torque and motor position behind the gear, of one
            log; or those of several logs. To show a spring the motion must excite its mode, as a multisine on top of it
            does.
        filtering: that torques, columns and derivatives go through alike, its cut-off above the modes; of measured
            positions the cut-off is five times that.
        settings: of the method.
        known: values and bounds to keep, by name; see `apply_constraints`.
        progress: receives each step.

    Raises:
        RecordError: a record lacks a channel, or has the wrong clock or unit.
        MethodError: the records do not determine the parameters, nothing can be simulated at the start, a frequency is
            missing, a robot of rigid joints explains the torques better than the springs that were found, or one of
            several logs along a motion begins in motion.
    """
    known, robot, along, near = known or {}, setup.robot, isinstance(setup, RobotDriveSide), cast("Any", setup)
    how: Any = settings or (DriveSideFit() if along else DIDIM())
    evaluations, frequencies, late, delay = how.evaluations, how.frequencies or None, tuple[int, ...](), 0.0
    if along:
        robot.require_linear("The drive side of a robot takes", 'identify the robot by "didim"', springs=True)
        delay = how.log_delay
    else:
        late, near = find_free_delays(near, how.free), replace(near, robot=robot.linear)
    stated = all(record.torque.stated for log in each_log(records) for record in log if record.torque is not None)

    def pose(
        under: Any,
        through: Filtering | None,
        freed: Sequence[int] = (),
        delay: float | None = 0.0,
        limits: Mapping[str, Parameter] = known,
    ) -> Simulated:
        parameters = robot_parameters(under.robot, offsets=how.offsets, logarithmic=True, whole=not along)
        parameters = apply_constraints(parameters, limits)
        return pose_robot(under, records, parameters, through, freed, delay, stated=stated)

    def search_rigid(under: Any, through: Filtering | None) -> RobotFit:
        problem, descents = pose(under, through), Descents(evaluations, progress)
        if not along:
            return descents.settle(problem, _start_rigid(problem, under, each_log(records)[0]))
        # To leave rows out is to multiply by what switches, and that brings the modes, which this robot has not, down
        # to what is slow: of a twin of six joints it left 23 % of a joint's torque, and 4 % with the rows.
        problem = problem.map_logs(lambda log: log.with_rows(np.ones_like(log.motion.moving)))
        return descents.settle(problem, np.zeros(len(problem.free)))

    if along or any(robot.flexible):
        problem = pose(near, filtering, delay=delay)
        require_springs(robot, frequencies, problem.sample_time)
        rigid = search_rigid(replace(near, robot=near.robot.rigid), SLOW)
        found = search_springs(problem, near.robot, rigid, frequencies, evaluations, progress)
        whole = problem.map_logs(lambda log: log.thoroughly())
        if whole is not problem and not any(one.shown for one in found.springs):
            progress("no spring is seen by the beginning of the record; searching along all of it")
            found = search_springs(whole, near.robot, rigid, frequencies, evaluations, progress)
    else:
        undeclared = [j for j in late if not numbers_of(near.controllers[j]).get(DELAY)]
        ends, failures = list[tuple[RobotFit, RobotLoop]](), list[MethodError]()
        for one in DELAYS if undeclared else (0.0,):
            try:
                under = with_delays(near, dict.fromkeys(undeclared, one))
                ends.append((search_rigid(under, filtering), under))
            except MethodError as error:  # no robot is stable with such a delay
                failures.append(error)
        if not ends:
            raise failures[0]
        found, near = min(ends, key=lambda end: float(np.linalg.norm(end[0].relative_error)))

    def with_laws(of: Robot) -> Simulated:
        found_within = {p.name: p for p in found.parameters.parameters}  # springs have bounds that a search gave them
        return pose(replace(near, robot=of), filtering, late, limits={**known, **found_within})

    if along or (robot.linear.joints == robot.joints and not late):
        return found
    fit = _search_laws(robot, found, with_laws, known, evaluations, progress, delays=bool(late))
    return replace(fit, iterations=found.iterations + fit.iterations, springs=_judge_springs(fit, robot))


# The start of rigid joints


def _start_rigid(problem: Simulated, loop: RobotLoop, records: Sequence[Record]) -> FloatArray:
    """Return the start of a search: the inverse model on the motion that the controllers saw.

    Where a controller cannot be turned round, the commanded motion is taken. A start of regular inertias is not tried:
    M(q) of one may not be positive definite in a pose.
    """
    log, failures = problem.log, list[str]()
    clock = log.experiment.clock
    commanded = log.experiment.references[clock.log_index // clock.lengths.size]
    for name, read in (("inversion", _reconstruct), ("reference", lambda *_: (log.measured, commanded))):
        try:
            x = _regress(problem, loop.robot, *read(problem, loop, records, commanded))
        except MethodError as error:
            failures.append(str(error))
            continue
        outcome = log.run(problem.parameters.numbers(problem.parameters.values(x)), keep=False).outcome
        if outcome is Outcome.FINISHED:
            return x
        failures.append(f"at the {name} start {outcome.value}.")
    alone = ", in SI units and not in a drive's whole numbers," if any(one.computed for one in records) else ","
    raise MethodError(
        "The robot cannot be simulated where its search begins: "
        + " ".join(failures)
        + f" Check the controllers' gains{alone} and their period where "
        "they run faster than the log, the signs and units of torques and references, and the joints' places."
    )


def _reconstruct(
    problem: Simulated, loop: RobotLoop, records: Sequence[Record], commanded: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Return the motors' torques and the positions that the controllers must have seen, (samples, n) each."""
    log, positions = problem.log, commanded.copy()
    torques = log.measured.copy()
    for j, (link, controller, record) in enumerate(zip(loop.robot.links, loop.controllers, records, strict=True)):
        if log.experiment.axes[j].clock.shows > 1:  # the log shows each output of this slow controller many times
            continue
        joint = RigidJoint(link.kind)
        alone = torque_problem(record, ClosedLoop(joint, controller), problem.filtering, joint.parameters)
        torques[:, j] = command_of(alone)[: len(torques)]
        positions[:, j] = reconstructed_position(alone)[: len(torques)]
    return torques, positions


def _regress(problem: Simulated, robot: Robot, torques: FloatArray, positions: FloatArray) -> FloatArray:
    """Return the inverse model's weighted estimate on a motion, within bounds."""
    parameters, borders = problem.parameters, _BORDERS if len(torques) > _SHORT else 0
    held = [Channel(torque, "N m", problem.sample_time, Timing.HELD) for torque in torques.T]  # its unit is not read
    filtering = replace(problem.filtering, borders=(borders, borders), timing="respected")
    delays = [one.law.delay for one in problem.log.experiment.axes]
    motion, joints = motion_along(held, positions, filtering, delays), np.linalg.inv(robot.coupling).T
    motion = replace(motion, q=motion.q @ joints, v=motion.v @ joints, a=motion.a @ joints)
    rows = inverse_of_robot(robot, parameters).rows([motion])
    found = solve_rows(rows, "weighted", {one.name: one for one in parameters.fixed}, turns=_REWEIGHTINGS)
    return Bounds.of(problem.free).clip(found.values[: len(parameters.places)])


# Springs


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
    if set(frequencies) != set(flexible) or not all(0.0 < hertz <= highest for hertz in frequencies.values()):
        raise MethodError(
            f"frequencies has a number for each of {join(flexible)}, above 0 and up to {highest:g} Hz, of which a "
            f"record of this sample time shows something; received {dict(frequencies)}: correct it, or give none at "
            "all to have them searched."
        )


def search_springs(
    problem: Simulated,
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
    error = problem.error(rigid.runs)
    problem = problem.reweight(error, rigid.values.size)
    start = StartOfSprings.of(problem.roughly(), rigid, robot.names)
    hertz = frequencies or start.search(progress)
    problem = bound_springs(problem, start)
    rough = problem.roughly()
    error = rough.error(rough.simulate(rigid.numbers))
    without = float(np.linalg.norm(error * rough.weights(error.size)))
    descents = Descents(evaluations, progress)
    end = descents.begin(rough, start, hertz, without)
    if end.solution.status is Status.NOT_EVALUABLE:
        raise MethodError(
            f"The robot cannot be simulated where its search begins: {outcome_of(rough.run(end.solution.x)).value}. "
            "Give other frequencies, or a record in which all joints move more."
        )
    stiff = not end.solution.converged and end.norm > without
    if stiff:
        # No better than without springs: a robot that has none, or whose modes are high, is found from stiff ones.
        end = descents.from_start(rough, start, start.all_at(start.stiff))

    if not end.may_show or (stiff and end.norm > without):
        with suppress(MethodError):
            seen = end.of(problem).fit(descents.tally.evaluations)
            return replace(seen, springs=tuple(map(_refuse, _judge_springs(seen, robot))))
    fit = descents.refine(problem, end).fit(descents.tally.evaluations)
    before, after = (problem.norms(problem.error(one.runs)) for one in (rigid, fit))
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
        judged = SpringVerdict(joint.name, True, stiffness, deviation, at_least, unit)
        found.append(judged if shown else _refuse(judged))
    return tuple(found)


def _refuse(judged: SpringVerdict) -> SpringVerdict:
    return replace(judged, shown=False, stiffness=None, deviation=None)


# Delays and laws that are not linear


def _search_laws(
    robot: Robot,
    linear: RobotFit,
    pose: Callable[[Robot], Simulated],
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
    descents, best, sigma = Descents(evaluations, progress), None, linear.problem.sigma
    values, numbers = dict(zip(linear.names, linear.values, strict=True)), linear.numbers
    changed = [i for i, joint in enumerate(robot.joints) if joint.linear != joint]
    for i in (*([-1] if delays else []), *changed):  # the delays, then axis by axis
        laws = replace(robot, joints=(*robot.joints[: i + 1], *(other.linear for other in robot.joints[i + 1 :])))
        problem = replace(pose(laws), sigma=sigma)
        values |= {p.name: p.start for p in problem.free if p.name not in values and p.start is not None}
        if i < 0:
            progress("looking for the delays of the torques")
            best, what = descents.follow(problem, values), "delays"
        else:
            joint = robot.joints[i]
            starts = _starts_of(joint, values_of_joint(numbers, i), _motion_of(linear, i), known)
            progress(f"{joint.name}: looking for the {name_laws(joint.model)}, from {pluralise(len(starts), 'start')}")
            ends = [descents.follow(problem, values | start) for start in starts]
            best, what = min(ends, key=lambda end: end.norm), f"laws of {joint.name}"
        if not best.solution.jacobian.any():
            raise MethodError(
                f"The robot cannot be simulated where the search of the {what} begins: "
                f"{outcome_of(best.problem.run(best.solution.x)).value}. Declare simpler laws, or state starts of "
                "their parameters."
            )
        found = problem.parameters.values(best.solution.x)
        values, numbers = dict(zip(problem.parameters.names, found, strict=True)), problem.parameters.numbers(found)
        sigma = best.reweight().sigma
    assert best is not None
    return descents.refine(problem, best).fit(descents.tally.evaluations)


def _starts_of(
    joint: RobotJoint, values: Mapping[str, float], motion: JointMotion, known: Mapping[str, Parameter]
) -> list[dict[str, float]]:
    """Return the starts of one axis's laws, by the names of the robot's parameters."""
    own = {p.name: known.get(name_in_robot(joint.name, p.name)) for p in joint.model.parameters}
    given = {name: p.start for name, p in own.items() if p is not None and p.start is not None}
    starts = law_starts(joint.model, joint.linear.model, values, motion, given)
    return [{name_in_robot(joint.name, name): x for name, x in start.items()} for start in starts]


def _motion_of(fit: RobotFit, joint: int) -> JointMotion:
    """Return the simulated motion of one axis."""
    run = fit.runs[0]
    clock, rotor = run.experiment.clock, run.numbers.motors[joint]
    seen = motion_at(run, clock.log_index)
    motor, link = ((seen.position[:, row], seen.velocity[:, row]) for row in (rotor, joint))
    return JointMotion(clock.sample_time * clock.samples, motor, link if rotor != joint else None)
