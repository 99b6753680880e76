"""The motor's motion that the known controller must have seen to put out the logged torque.

``position = reference - C^-1(torque)`` needs no guess, and as the gain of a controller is large, it is finer than most
encoders.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from jointid.common.arrays import FloatArray
from jointid.common.errors import MethodError
from jointid.estimation.problems.closed_loop import ClosedLoopProblem, beginning_position
from jointid.models.controllers import POSITION, REFERENCE, invert
from jointid.records.record import Tap, Timing

_SETTLED = 5.0  # periods of the position filter's cut-off after which a fault is forgotten
_SLOPE = 20  # samples the initial velocity is first read from: the search corrects it


def reconstructed_position(problem: ClosedLoopProblem) -> FloatArray:
    """Return the motor position by the inverse of the controller, (samples,).

    The law's memory of what was before the record is a guess, so the first samples, one more than the law has states,
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
    """Return the logged output of the controller, (samples,), without what is added behind its limit.

    Raises:
        MethodError: the log does not show each output once at most.
    """
    experiment = problem.axis
    whole = np.all(experiment.clock.lags == experiment.clock.lags[0, 0])
    averaged, measured = experiment.timing is Timing.AVERAGED, experiment.tap is Tap.MEASURED
    if (
        experiment.clock.shows > 1
        or ((averaged or measured) and experiment.clock.skips > 1)
        or (averaged and measured and not whole)
    ):
        raise MethodError(
            "The controller can be turned round only when the log shows the output of its periods, each once at most."
        )
    # A measured torque shows an output when it acts, an averaged one when its period is over.
    late = int(averaged) + (int(experiment.clock.lags[0, 0]) if measured else 0)
    output = np.concatenate([problem.measured[late:], np.full(late, problem.measured[-1])])
    added = experiment.after_limit if measured else experiment.logged
    return np.asarray(output - added[:: experiment.clock.skips][: output.size])


def torque_behind_limit(problem: ClosedLoopProblem) -> FloatArray:
    """Return the torque that acts on the motor, (samples,): the command and what is added behind its limit."""
    command = command_of(problem)
    return np.asarray(command + problem.axis.after_limit[:: problem.axis.clock.skips][: command.size])


def first_state(problem: ClosedLoopProblem, position: FloatArray) -> dict[str, float]:
    """Return the initial state of a reconstructed motion: a line through its first usable samples."""
    law = problem.axis.law
    skip, sample_time = law.order // problem.axis.clock.skips + 1, problem.axis.sample_time
    first = position[skip : skip + _SLOPE]
    slope, value = np.polyfit(np.arange(first.size) * sample_time, first, 1)
    return {"initial_position": float(value - slope * skip * sample_time), "initial_velocity": float(slope)}


def invertible_samples(problem: ClosedLoopProblem) -> NDArray[np.bool_]:
    """Return the samples that the controller's limit does not affect.

    Where nothing would be left, all of them: a poor start is better than none.
    """
    experiment = problem.axis
    output = np.abs(command_of(problem))
    cutoff = problem.filtering.position_cutoff
    assert cutoff is not None
    reach = experiment.law.order + round(_SETTLED / (cutoff * experiment.sample_time))
    at_limit = output >= experiment.law.limit * (1 - 1e-9)
    if not np.any(at_limit):
        return ~at_limit
    limited = np.convolve(at_limit, np.ones(2 * reach + 1))[reach : reach + at_limit.size] > 0.5
    return ~limited if np.mean(limited) < 0.5 else np.ones_like(limited)
