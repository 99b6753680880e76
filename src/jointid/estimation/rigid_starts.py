"""Starts for rigid joints, by regression on an implied motion without simulation.

With a known controller the motor's motion follows from the logged torque:
``position = reference - C^-1(torque)`` needs no guess, and as the gain of a controller is large, it is finer than most
encoders. Or else the motor follows its reference.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from jointid.common.arrays import FloatArray
from jointid.common.errors import MethodError
from jointid.common.messages import Detail, Progress
from jointid.common.parameters import Bounds
from jointid.common.text import number
from jointid.estimation.descent import Solved
from jointid.estimation.problems.inverse_model import (
    Inverse,
    inverse_of_joint,
    inverse_of_robot,
    motion_along,
    steady_weights,
    turn,
)
from jointid.estimation.problems.regression import solve_rows
from jointid.estimation.problems.simulated import ClosedLoopProblem, beginning_position, torque_problem
from jointid.models.controllers import POSITION, REFERENCE, invert
from jointid.records.record import Channel, Record, Tap, Timing
from jointid.simulation.simulate import Outcome
from jointid.solvers.solve import LevenbergMarquardt, solve

if TYPE_CHECKING:
    from jointid.estimation.problems.simulated import Simulated
    from jointid.models.robots.robot import RobotLoop

_BORDERS, _SHORT = 50, 500  # samples at each end of a motion that is a guess, of more than so many
_REWEIGHTINGS = 2
_EVALUATIONS = 10  # enough for two parameters that act almost linearly on the torque
_MOST = 0.5  # of the samples
_TAKEN = 0.5  # of the energy exchanged along a guessed motion: turned signs take 0.84 or more, a joint with play 0.02
_SLOPE = 20  # samples the initial velocity is first read from: the search corrects it


def rigid_starts(problem: ClosedLoopProblem, progress: Progress) -> list[dict[str, float]]:
    """Starts from the inverse of the controller and of regular inertia.

    Raises:
        MethodError: there is none.
    """
    found, failures = list[dict[str, float]](), list[MethodError]()
    for make in (inversion_start, regular_start):
        try:
            found.append(make(problem))
        except MethodError as error:
            failures.append(error)
    if not found:
        raise failures[0]
    if failures:
        progress(Detail(failures[0], "starting from a regular inertia"))
    return found


def inversion_start(problem: ClosedLoopProblem) -> dict[str, float]:
    """Return a start by IDIM on the reconstructed position."""
    torque, position = _invert(problem)
    found = _regress(problem, inverse_of_joint(problem.joint), torque, position, [problem.axis.law.delay])
    return found | first_state(problem, position)


def regular_start(problem: ClosedLoopProblem) -> dict[str, float]:
    """Regular inertia from the reference under perfect tracking, and no friction."""
    experiment, reference = problem.axis, problem.log.poses
    periods = experiment.clock.log_index // experiment.clock.lengths.size
    torque = problem.measured - experiment.logged[periods] + experiment.after_limit[periods]
    regular = {p.name: 0.0 if p.free else p.start or 0.0 for p in problem.parameters}
    regular["inertia"] = abs(_regress(problem, inverse_of_joint(problem.joint), torque, reference)["inertia"])
    return regular | {"initial_position": float(reference[0, 0]), "initial_velocity": 0.0}


def start_with_friction(problem: ClosedLoopProblem, progress: Progress) -> dict[str, float]:
    """Return the regular inertia with the friction of the reconstructed motion."""
    friction = {p.name: p.lower for p in problem.joint.parameters[1:]}
    turned, regular = rigid_starts(problem, progress)[0], regular_start(problem.keeping(dict.fromkeys(friction, 0.0)))
    return regular | {name: max(turned[name], lower) for name, lower in friction.items()}


def require_work(problem: ClosedLoopProblem) -> None:
    """Refuse a torque that takes most of the energy exchanged along its motion."""
    try:
        torque, position = _invert(problem)
    except MethodError:  # a controller without an inverse gives no motion
        return
    # A constant load gives back what lifting it took.
    work = (torque - np.mean(torque)) * np.gradient(position)
    if np.sum(work) < -_TAKEN * np.sum(np.abs(work)):
        raise MethodError(
            f"The torque does {number(float(np.sum(work)), 3)} J of work along its motion; expected more than 0, as "
            "every joint has friction: reverse the sign of torque or reference, or check the unit of both."
        )


def fit_initial_state(problem: ClosedLoopProblem) -> FloatArray:
    """Return the free parameters with the best initial position and velocity.

    A motor at rest and a moving one are two problems (see `descent.search_rigid_joint`), so both are solved.
    """
    try:
        start = first_state(problem, reconstructed_position(problem))
    except MethodError:  # a controller that cannot be inverted: start on the reference, at rest
        start = {"initial_position": float(problem.axis.inputs[0, 0]), "initial_velocity": 0.0}
    both, solver = (problem.keeping({"initial_velocity": 0.0}), problem), LevenbergMarquardt(1e-9, _EVALUATIONS)
    ends = [Solved(p, solve(p, solver, p.vector(start))) for p in both]
    return problem.vector(min(ends, key=lambda end: end.norm).values)


def _regress(
    problem: Simulated,
    inverse: Inverse,
    torques: FloatArray,
    positions: FloatArray,
    delays: Sequence[float] = (0.0,),
    most: float = _MOST,
) -> dict[str, float]:
    """Parameters by IDIM on guessed motor motions, (samples, n) or (samples,), without their ends."""
    torques, positions = (one.reshape(len(one), -1) for one in (torques, positions))
    borders = _BORDERS if len(torques) > _SHORT else 0
    filtering = replace(problem.filtering, borders=(borders, borders), timing="respected")
    held = [Channel(torque, "N m", problem.sample_time, Timing.HELD) for torque in torques.T]  # its unit is not read
    motion = motion_along(held, positions, filtering, delays, limit=np.inf)  # both cut-offs are known
    # What sticks takes any torque below Coulomb's, which a regression would read as less friction.
    weights = steady_weights(motion)[1]
    if np.mean(weights) >= most:  # else the rest shows less than friction at rest bends
        motion = replace(motion, moving=weights)
    fixed = {p.name: p for p in problem.parameters if not p.free}
    found = solve_rows(inverse.rows([turn(inverse.system, motion)]), "weighted", fixed, turns=_REWEIGHTINGS)
    return dict(zip(found.rows.names, map(float, found.values), strict=True))


# The inverse of the controller


def _invert(problem: ClosedLoopProblem) -> tuple[FloatArray, FloatArray]:
    """Applied torque, (samples,), and the motor position that the controller read."""
    command, axis = command_of(problem), problem.axis
    return command + axis.after_limit[:: axis.clock.skips][: command.size], reconstructed_position(problem)


def reconstructed_position(problem: ClosedLoopProblem) -> FloatArray:
    """Return the motor position by the inverse of the controller, (samples,).

    The law's memory of the time before the record is a guess, so the first samples, one more than the law has states,
    are not to be used.

    Raises:
        MethodError: the log does not show the output of every period once, or the law cannot be inverted.
    """
    experiment = problem.axis
    law, inputs = experiment.law, experiment.inputs
    command = command_of(problem)
    if experiment.clock.skips > 1:  # between the periods that the log shows the torque is a straight line
        command = np.interp(np.arange(experiment.periods) / experiment.clock.skips, np.arange(command.size), command)
    slope = float(inputs[1, REFERENCE] - inputs[0, REFERENCE]) / law.period
    # The inverse of a slow position loop forgets a wrong first position as slowly: a motor that moves lags behind.
    home = beginning_position(problem, slope)
    state = law.known_memory(inputs) + law.memory(POSITION, home, slope)
    integral = law.integral()
    if integral is not None:
        there = inputs[0] + home * (np.arange(inputs.shape[1]) == POSITION)
        first = law.C[0, law.output] @ state + law.D[0, law.output] @ there
        state = state + integral * (command[0] - first)
    return invert(law, command, inputs, state)[:: experiment.clock.skips][: experiment.clock.samples]


def command_of(problem: ClosedLoopProblem) -> FloatArray:
    """Logged output of the controller, (samples,), without additions behind its limit.

    Raises:
        MethodError: the log does not show each output once at most.
    """
    experiment = problem.axis
    clock, whole = experiment.clock, np.all(experiment.clock.lags == experiment.clock.lags[0, 0])
    averaged, measured = experiment.timing is Timing.AVERAGED, experiment.tap is Tap.MEASURED
    parted = (averaged or measured) and clock.skips > 1
    if clock.shows > 1 or parted or (averaged and measured and not whole):
        raise MethodError(
            "The controller can be inverted only if the log shows the output of its periods, each once at most."
        )
    # A measured torque shows an output when it acts, an averaged one when its period is over.
    late = int(averaged) + (int(clock.lags[0, 0]) if measured else 0)
    output = np.concatenate([problem.measured[late:], np.full(late, problem.measured[-1])])
    added = experiment.after_limit if measured else experiment.logged
    return np.asarray(output - added[:: clock.skips][: output.size])


def first_state(problem: ClosedLoopProblem, position: FloatArray) -> dict[str, float]:
    """Initial state of a reconstructed motion, from a line through its beginning."""
    law = problem.axis.law
    skip, sample_time = law.order // problem.axis.clock.skips + 1, problem.axis.sample_time
    first = position[skip : skip + _SLOPE]
    slope, value = np.polyfit(np.arange(first.size) * sample_time, first, 1)
    return {"initial_position": float(value - slope * skip * sample_time), "initial_velocity": float(slope)}


# Of a robot


def start_rigid_robot(problem: Simulated, loop: RobotLoop, records: Sequence[Record]) -> FloatArray:
    """Start of a search, (free,), by inverse model on the controllers' motion.

    Rows at rest are left out first, then kept: what switches brings the modes of springs down to what is slow. If a
    controller cannot be inverted, the commanded motion is taken. Regular inertias may have no positive M(q).
    """
    log, failures = problem.log, list[str]()
    experiment, inverse = log.experiment, inverse_of_robot(loop.robot, problem.parameters)
    delays = [one.law.delay for one in experiment.axes]
    for name, most in (("inversion", _MOST), ("inversion", np.inf), ("reference", _MOST)):
        torques, positions = log.measured.copy(), log.poses
        try:
            for j, (own, record) in enumerate(zip(loop.loops, records, strict=True)):
                # Of a slow controller the log shows each output many times.
                if name == "inversion" and experiment.axes[j].clock.shows == 1:
                    alone = torque_problem(record, own, problem.filtering, own.joint.parameters)
                    torques[:, j], positions[:, j] = (one[: len(torques)] for one in _invert(alone))
            found = _regress(problem, inverse, torques, positions, delays, most)
        except MethodError as error:
            failures.append(str(error))
            continue
        x = Bounds.of(problem.free).clip(problem.vector(found))
        outcome = log.run(problem.numbers(x), keep=False).outcome
        if outcome is Outcome.FINISHED:
            return x
        failures.append(f"at the {name} start {outcome.value}.")
    units = ", in SI units and not in a drive's whole numbers," if any(one.computed for one in records) else ","
    raise MethodError(
        "The robot cannot be simulated where its search begins: "
        + " ".join(dict.fromkeys(failures))
        + f" Check the controllers' gains{units} and their period where "
        "they run faster than the log, the signs and units of torques and references, and the joints' places."
    )
