"""Where a search begins: from the controller turned round, from a regular joint, or from given values."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from jointid.common.arrays import FloatArray
from jointid.common.errors import MethodError
from jointid.estimation.problems.closed_loop import ClosedLoopProblem
from jointid.estimation.problems.inverse_model import InverseModel, inverse_model
from jointid.models.controllers import POSITION, REFERENCE, invert
from jointid.models.joints import RigidJoint
from jointid.records.record import Channel, Tap, Timing
from jointid.solvers.gauss_newton import GaussNewton
from jointid.solvers.regression import least_squares
from jointid.solvers.solve import solve

_SETTLED = 5.0  # periods of the position filter's cut-off after which a fault is forgotten
_STEPS = 6  # enough for two parameters that act almost linearly on the torque
_SLOPE = 20  # samples the initial velocity is first read from: the search corrects it


@dataclass(frozen=True, slots=True, eq=False)
class Start:
    """Where a search begins.

    Attributes:
        values: of every parameter, by name.
        nominal_inertia: the inertia at which the simulated controller's gains are the real ones, while they are
            scaled with the inertia; None when they need not be.
    """

    values: dict[str, float]
    nominal_inertia: float | None


def reconstructed_position(problem: ClosedLoopProblem) -> FloatArray:
    """Return the motor position the known controller must have seen to put out the logged torque, (samples,).

    ``position = reference - C^-1(torque)``: no guess is needed, and because the controller's gain is large the result
    is finer than most encoders. The law's memory of what was before the record is a guess, so the first samples,
    one more than the law has states, are not to be used.

    Raises:
        MethodError: the log does not show the output of every period once, or the law cannot be inverted.
    """
    experiment = problem.experiment
    law, inputs = experiment.law, experiment.inputs
    command = _command(problem)
    if experiment.every > 1:  # the log shows some of the periods: between them the torque is taken as a straight line
        command = np.interp(np.arange(experiment.periods) / experiment.every, np.arange(command.size), command)
    element = law.tap if experiment.tap is Tap.COMMAND else law.output
    slope = (inputs[1, REFERENCE] - inputs[0, REFERENCE]) / law.period
    state = law.known_memory(inputs) + law.memory(POSITION, inputs[0, REFERENCE], slope)
    integral = law.integral()
    if integral is not None:
        there = inputs[0] + inputs[0, REFERENCE] * (np.arange(inputs.shape[1]) == POSITION)
        first = law.C[0, law.output] @ state + law.D[0, law.output] @ there
        state = state + integral * (command[0] - first)
    return invert(law, command, inputs, state, element)[:: experiment.every][: experiment.samples]


def _command(problem: ClosedLoopProblem) -> FloatArray:
    """Return the controller's output as the log shows it, (samples,), without what is added behind its limit."""
    experiment = problem.experiment
    whole = np.all(experiment.lags == experiment.lags[0])
    averaged, measured = experiment.timing is Timing.AVERAGED, experiment.tap is Tap.MEASURED
    if (
        experiment.repeat > 1
        or ((averaged or measured) and experiment.every > 1)
        or (averaged and measured and not whole)
    ):
        raise MethodError(
            "The controller can be turned round only when the log shows the output of its periods, each once at most; "
            'choose start = "regular".'
        )
    # A measured torque shows an output when it acts, an averaged one when its period is over.
    late = int(averaged) + (int(experiment.lags[0]) if measured else 0)
    output = np.concatenate([problem.measured[late:], np.full(late, problem.measured[-1])])
    added = experiment.after_limit if measured else experiment.logged
    return np.asarray(output - added[:: experiment.every][: output.size])


def initial_state(problem: ClosedLoopProblem, position: FloatArray) -> dict[str, float]:
    """Return where a reconstructed motion begins: a line through its first usable samples."""
    law = problem.experiment.law
    skip, sample_time = law.order // problem.experiment.every + 1, problem.experiment.sample_time
    first = position[skip : skip + _SLOPE]
    slope, value = np.polyfit(np.arange(first.size) * sample_time, first, 1)
    return {"initial_position": float(value - slope * skip * sample_time), "initial_velocity": float(slope)}


def fit_initial_state(problem: ClosedLoopProblem) -> tuple[FloatArray, int]:
    """Return the initial state that fits best, position and velocity, and the simulations it took.

    A motor at rest and a moving one are two problems (see `didim`), so both are solved.
    """
    try:
        start = initial_state(problem, reconstructed_position(problem))
    except MethodError:  # a controller that cannot be inverted: start on the reference, at rest
        start = {"initial_position": float(problem.experiment.inputs[0, 0]), "initial_velocity": 0.0}
    problems = (problem.keeping({"initial_velocity": 0.0}), problem)
    solver = GaussNewton(tolerance=1e-9, step_tolerance=math.inf, iterations=_STEPS, halvings=0)
    ends = [(p, solve(p, solver, p.vector(start))) for p in problems]
    which, best = min(ends, key=lambda end: float(np.linalg.norm(end[1].residual)))
    return problem.vector(which.values(best.x)), sum(end.evaluations for _, end in ends)


def inversion_start(problem: ClosedLoopProblem) -> Start:
    """Return what IDIM finds on the reconstructed position: nearly what it finds on a measured one."""
    joint, position = _rigid(problem), reconstructed_position(problem)
    command = _command(problem)
    acting = command + problem.experiment.after_limit[:: problem.experiment.every][: command.size]
    found = _regressed(problem, joint, acting, position, _unlimited(problem), problem.experiment.law.delay)
    return Start(_kept(problem, found | initial_state(problem, position)), None)


def regular_start(problem: ClosedLoopProblem, given: dict[str, float] | None = None) -> Start:
    """Return a regular inertia and no friction, or the given values, with the controller's gains to be scaled.

    The loop of an inertia that is `n` times too large, under gains that are `n` times too large, moves like the real
    one; regressing on its motion gives good values at once. The real loop's own inertia is first read off the
    reference, as if the axis tracked it perfectly.
    """
    experiment, joint = problem.experiment, _rigid(problem)
    periods = experiment.looked // experiment.lengths.size
    reference = experiment.inputs[periods, REFERENCE]
    torque = problem.measured - experiment.logged[periods] + experiment.after_limit[periods]
    tracked = _regressed(problem, joint, torque, reference, np.ones(torque.size, dtype=np.bool_))
    known = next(p for p in problem.parameters if p.name == "inertia")
    nominal = abs(tracked["inertia"]) if known.free else float(known.start or 1.0)
    regular = {p.name: 0.0 for p in problem.parameters} | {"inertia": nominal}
    regular |= {"initial_position": float(reference[0]), "initial_velocity": 0.0}
    return Start(_kept(problem, regular | (given or {})), nominal)


def given_start(problem: ClosedLoopProblem) -> Start:
    """Return the starts the parameters carry; those without one begin as in `regular_start`."""
    given = {p.name: p.start for p in problem.parameters if p.start is not None}
    if given.get("inertia", 1.0) <= 0:
        raise MethodError(f"A start for the inertia must be positive; received {given['inertia']}.")
    return regular_start(problem, given)


def _unlimited(problem: ClosedLoopProblem) -> NDArray[np.bool_]:
    """Return where the law can be turned round: away from its limit, and from what the filter smears of it.

    Where nothing would be left, everything: a poor start is better than none.
    """
    experiment = problem.experiment
    output = np.abs(_command(problem))
    cutoff = problem.filtering.position_cutoff
    assert cutoff is not None
    reach = experiment.law.order + round(_SETTLED / (cutoff * experiment.sample_time))
    at_limit = output >= experiment.law.limit * (1 - 1e-9)
    if not np.any(at_limit):
        return ~at_limit
    limited = np.convolve(at_limit, np.ones(2 * reach + 1))[reach : reach + at_limit.size] > 0.5
    return ~limited if np.mean(limited) < 0.5 else np.ones_like(limited)


def _regressed(
    problem: ClosedLoopProblem,
    joint: RigidJoint,
    torque: FloatArray,
    position: FloatArray,
    known: NDArray[np.bool_],
    delay: float = 0.0,
) -> dict[str, float]:
    """Return what IDIM finds where the position is known; elsewhere it is bridged, and both sides weigh nothing."""
    sample_time, instants = problem.experiment.sample_time, np.arange(torque.size)
    filtering = replace(problem.filtering, borders=(50, 50) if torque.size > 500 else (0, 0), timing="respected")
    held = Channel(torque, joint.force_unit, sample_time, Timing.HELD)
    if not np.all(known):
        position = np.interp(instants, instants[known], position[known])
    model = inverse_model(joint, held, (position,), filtering, delay)
    if not np.all(known):
        columns = model.columns * known[:, np.newaxis]
        model = InverseModel(model.torque * known, columns, model.inside, model.motor)
    parameters, free = problem.parameters[: len(joint.parameters)], problem.free_joint
    kept = np.array([0.0 if p.free else p.start or 0.0 for p in parameters])
    Y, W = model.decimated(filtering, sample_time, kept, compiled=True)
    names = tuple(p.name for p in free)
    found = least_squares(W[:, [p.free for p in parameters]], Y, names).values
    return dict(zip(names, map(float, found), strict=True))


def _kept(problem: ClosedLoopProblem, values: dict[str, float]) -> dict[str, float]:
    """Return the values with every fixed parameter at what it is fixed to."""
    return values | {p.name: p.start or 0.0 for p in problem.parameters if not p.free}


def _rigid(problem: ClosedLoopProblem) -> RigidJoint:
    if not isinstance(problem.loop.joint, RigidJoint):
        raise MethodError("This start is for a rigid joint; identify the joint as rigid first.")
    return problem.loop.joint
