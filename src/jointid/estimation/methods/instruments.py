"""IDIM-IV: instruments from the closed loop simulated at the estimate itself [Janot, Vandanjon, Gautier 2014].

The simulated motion is driven by the reference and the known signal alone, so noise and disturbances of the record do
not reach it; positions go through the same filters as the measured ones, and their columns are the instruments Z of
``Z' (Y - W x) = 0``. The next estimate is simulated in turn until nothing changes: two to five simulations.

Instruments need not be perfect, only free of the record's noise. So values beyond their bounds are simulated at the
bound, and effects that the loop does not have (ripple, drift) are put on the simulated motion as columns.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from jointid.common.arrays import FloatArray
from jointid.common.errors import MethodError
from jointid.estimation.methods.inverse_model import InverseModel, inverse_model
from jointid.estimation.methods.linear import Rows, Solution, instrumental, ordinary
from jointid.estimation.result.parts import Iteration
from jointid.models.disturbances import Effect
from jointid.models.parameters import Parameter
from jointid.records.record import Channel, Record
from jointid.records.signals.filtering import Filtering
from jointid.simulation.closed_loop import Initial, Outcome, simulate
from jointid.simulation.loop_input import ClosedLoop, prepare
from jointid.uncertainty.endogeneity_test import ChiSquareTest, durbin_wu_hausman

_SETTLED = 1e-3  # deviations: values that change by less have settled
_MOST = 25  # simulations

Instruments = Callable[[FloatArray], FloatArray]
"""The columns on the motion simulated with the values of all parameters, (rows, parameters)."""


@dataclass(frozen=True, slots=True, eq=False)
class Instrumented:
    """What instruments found: the solution, how it was reached, and whether least squares would have done."""

    solution: Solution
    trace: tuple[Iteration, ...]
    converged: bool
    test: ChiSquareTest


def simulated_instruments(
    record: Record,
    loop: ClosedLoop,
    model: InverseModel,
    parameters: Sequence[Parameter],
    filtering: Filtering,
    effects: Sequence[Effect],
) -> Instruments:
    """Return what simulates the loop and gives the columns on its motion; it begins where the measured one does.

    Raises:
        RecordError: the record lacks a channel the controller reads.
    """
    assert record.torque is not None
    experiment = prepare(loop, record)
    sample_time, size = record.torque.sample_time, model.torque.shape[1]
    initial = Initial(float(model.motor.position[0]), float(model.motor.velocity[0]))
    names = [p.name for p in loop.joint.parameters]
    torque = Channel(np.zeros(size), record.torque.unit, sample_time, record.torque.timing)

    def columns(values: FloatArray) -> FloatArray:
        pairs = zip(parameters, values, strict=True)
        possible = {p.name: min(max(float(value), p.lower), p.upper) for p, value in pairs if p.name in names}
        run = simulate(loop, experiment, possible, initial)
        if run.outcome is not Outcome.FINISHED:
            raise MethodError(
                f"The instruments of IV come from a simulation, but with these values {run.outcome.value}; check the "
                "controller's gains, or use another estimator."
            )
        positions = (run.motor_position, *(() if run.load_position is None else (run.load_position,)))
        whole = tuple(np.pad(position[:size], (0, max(size - position.size, 0)), "edge") for position in positions)
        moved = inverse_model(loop.joint, torque, whole, filtering, effects=effects)
        return moved.thinned(moved.columns, filtering, sample_time)

    return columns


def by_instruments(rows: Rows, instruments: Instruments, kept: FloatArray, free: Sequence[int]) -> Instrumented:
    """Return the fixed point of simulating and solving, from ordinary least squares.

    Args:
        rows: the regression of the free parameters.
        instruments: as from `simulated_instruments`.
        kept: (parameters,) values of the fixed parameters, 0 for the free ones.
        free: which parameters are free.

    Raises:
        MethodError: a simulation fails, or the instruments do not determine the parameters.
    """
    solution, chosen = ordinary(rows), list(free)
    trace = [_line(0, rows, solution, None, None)]
    Z = rows.W
    for number in range(1, _MOST + 1):
        whole = kept.copy()
        whole[chosen] = solution.fit.values
        Z = instruments(whole)[:, chosen]
        before, solution = solution, instrumental(rows, Z, solution.fit.values)
        trace.append(_line(number, rows, solution, before, trace[-1]))
        change = np.abs(solution.fit.values - before.fit.values)
        if np.all(change <= _SETTLED * solution.covariance.std):
            break
    settled = bool(np.all(change <= _SETTLED * solution.covariance.std))
    return Instrumented(solution, tuple(trace), settled, durbin_wu_hausman(rows.W, rows.Y, Z, rows.equations))


def _line(number: int, rows: Rows, solution: Solution, before: Solution | None, last: Iteration | None) -> Iteration:
    values = solution.fit.values
    norm = float(np.linalg.norm(solution.fit.residual))
    step = change = None
    if before is not None and last is not None:
        size = np.where(values == 0, 1.0, np.abs(values))
        step = float(np.max(np.abs(values - before.fit.values) / size))
        change = abs(norm / last.residual_norm - 1.0) if last.residual_norm else 0.0
    return Iteration(number, dict(zip(rows.names, map(float, values), strict=True)), norm, change, step, number)
