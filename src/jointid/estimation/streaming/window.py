"""One window of a long record: how it begins, which of its rows count, and what they say.

A window begins in the middle of a motion. It begins where the law, turned round, puts the motor for the torque that was
logged, at the speed of the reference; what of that is wrong the loop forgets within the settling time, of which nothing
is counted, at either end: the zero-phase filter looks both ways. Neighbouring windows overlap by twice the settling
time, so that the rows that count follow each other without a gap. How long it takes is measured (`settling_of`): 0.3 s
in the paper's stiff loop, seconds in a slow one with an integral.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from jointid.common.arrays import FloatArray
from jointid.common.errors import MethodError
from jointid.estimation.problems.closed_loop import ClosedLoopProblem, torque_problem
from jointid.estimation.problems.nuisance_parameters import INITIAL_STATE, INITIAL_TORQUE
from jointid.estimation.search.starts import beginning_position
from jointid.estimation.streaming.position_bins import Place, Places
from jointid.models.controllers import REFERENCE
from jointid.models.parameters import Parameter
from jointid.records.chunks import Chunk
from jointid.records.record import Record
from jointid.records.signals.filtering import Filtering
from jointid.simulation.closed_loop import Outcome
from jointid.simulation.loop_input import ClosedLoop
from jointid.uncertainty.jackknife import Sums

_FORGOTTEN = 0.01  # of the torque
_RINGS = 10.0  # periods of its cut-off that the zero-phase filter rings


@dataclass(frozen=True, slots=True, eq=False)
class Model:
    """What is identified, alike in every window.

    Attributes:
        loop: joint and controller.
        parameters: of the joint.
        free: names of what surrounds it and is identified, too.
        filtering: as declared.
        settling: samples at either end of a window that are simulated and not counted.
    """

    loop: ClosedLoop
    parameters: tuple[Parameter, ...]
    free: tuple[str, ...]
    filtering: Filtering
    settling: int

    def problem(self, record: Record, disturbed: float = 0.0) -> ClosedLoopProblem:
        """Return the problem of one window, with its state at the first sample kept.

        Args:
            record: the window.
            disturbed: by how much its beginning is to be wrong, as a share of the window's torque and speed.

        Raises:
            RecordError: a channel is missing.
        """
        known = tuple(p.fixed(0.0) for p in (*INITIAL_STATE, INITIAL_TORQUE))
        problem = torque_problem(record, self.loop, self.filtering, self.parameters, known).freeing(*self.free)
        inputs, period = problem.experiment.inputs, problem.experiment.law.period
        torque = float(problem.filtered(problem.measured)[0])  # a single sample has all of the noise
        velocity = float(inputs[1, REFERENCE] - inputs[0, REFERENCE]) / period
        torque += disturbed * float(np.std(problem.measured))
        velocity += disturbed * float(np.std(np.diff(inputs[:, REFERENCE]))) / period
        position = beginning_position(replace(problem, measured=np.full(1, torque)), velocity)
        values = {"initial_position": position, "initial_velocity": velocity, "initial_torque": torque}
        return problem.keeping(values)


def settling_of(model: Model, record: Record, values: Mapping[str, float]) -> int:
    """Return how many samples a window takes to forget how it began, and its filter to forget what lies beside it.

    A beginning that is off by the window's whole torque and speed, as no window's is, must show in no later sample of
    the torque by more than a hundredth.

    Args:
        model: of the joint and its loop.
        record: a window that moves.
        values: of the parameters, by name.

    Raises:
        RecordError: a channel is missing.
    """
    problem, other = model.problem(record), model.problem(record, disturbed=1.0)
    x = problem.vector(values)
    apart = np.abs(problem.torque(x) - other.torque(x)) > _FORGOTTEN * float(np.std(problem.measured))
    remembers = int(np.flatnonzero(apart)[-1]) + 1 if apart.any() else 0
    assert problem.filtering.cutoff is not None
    return remembers + math.ceil(_RINGS / (problem.filtering.cutoff * problem.experiment.sample_time))


@dataclass(frozen=True, slots=True, eq=False)
class Window:
    """What one window says.

    Attributes:
        number: of it, from 0.
        begin, end: seconds from the first sample of the record, of what counts.
        sums: over its rows.
        at_limit: share of its periods in which the controller was at its limit.
    """

    number: int
    begin: float
    end: float
    sums: Sums
    at_limit: float


class NotSimulatedError(MethodError):
    """A window whose loop could not be simulated to its end."""


def moves(record: Record) -> bool:
    """Whether anything is asked of the axis in a window."""
    assert record.reference is not None
    return record.injected is not None or float(np.ptp(record.reference.values)) > 0


def motion(problem: ClosedLoopProblem) -> tuple[FloatArray, FloatArray]:
    """Return the reference's position and velocity at the log's instants, (samples,) each."""
    experiment = problem.experiment
    position = experiment.inputs[experiment.looked // experiment.lengths.size, REFERENCE]
    return position, np.gradient(position, experiment.sample_time)


def looked_at(
    piece: Chunk, model: Model, values: Mapping[str, float], places: Places
) -> tuple[Window, dict[int, Place]] | None:
    """Return what a window says, and what it says at each place, by its number; None where nothing of it counts.

    Args:
        piece: the window, with its settling times.
        model: of the joint and its loop.
        values: of the parameters that are free, by name.
        places: that repeat.

    Raises:
        NotSimulatedError: the loop cannot be simulated to the window's end.
    """
    problem = model.problem(piece.record)
    samples, keep = problem.measured.size, problem.filtering.decimation or 1
    at = np.arange((samples - 1) % keep, samples, keep)
    counted = (at >= model.settling) & (at < samples - model.settling)
    if not counted.any():
        return None
    response, columns = problem.sensitivities(problem.vector(values))
    begin, step = piece.record.begin, problem.experiment.sample_time
    if response.outcome is not Outcome.FINISHED:
        raise NotSimulatedError(
            f"The window that begins at {begin:.0f} s cannot be simulated, because {response.outcome.value}; check "
            "the controller and the start, or begin from another window."
        )
    error, J = problem.error(response)[counted], -problem.filtered(columns)[counted]
    measured = problem.filtered(problem.measured)[counted]
    label = places.label(*(signal[at[counted]] for signal in motion(problem)))
    rows = {int(one): label == one for one in np.unique(label)}
    there = {one: Place.of(error[these], J[these], measured[these]) for one, these in rows.items()}
    first, last = at[counted][0], at[counted][-1]
    window = Window(
        piece.number, begin + first * step, begin + (last + keep) * step, Sums.of(error, J, measured),
        response.at_limit,
    )  # fmt: skip
    return window, there
