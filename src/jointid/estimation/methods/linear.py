"""The estimators of ``Y = W x``: ordinary and weighted least squares, and instrumental variables.

A flexible joint has two equations, one row after the other at every instant. Their errors differ in size, that of the
motor's by the noise of the torque, that of the load's by what filters and friction laws leave; weighting makes them
alike. But the load's equation is homogeneous, all its unknowns stand on one side. Weighted by its own residual r it
would pull them towards 0, by the share ``n var`` for n rows and the relative variance `var` with which the motor's
equation knows their common scale: on the paper's axis by 3 to 11 %. So its size is taken large enough for the pull to
stay below a tenth of the deviation, ``s^2 >= 10 ||r||^2 s1 / ||u||``, where u is the torque that this scale explains
alone and s1 its error.

The instruments of IDIM-IV come from the closed loop simulated at the estimate itself [Janot, Vandanjon, Gautier 2014].
The simulated motion is driven by the reference and the known signal alone, so noise and disturbances of the record do
not reach it; positions go through the same filters as the measured ones, and their columns are the instruments Z of
``Z' (Y - W x) = 0``. The next estimate is simulated in turn until nothing changes: two to five simulations.

Instruments need not be perfect, only free of the record's noise. So values outside their bounds are simulated at the
bound, and effects that the loop does not have (ripple, drift) are put on the simulated motion as columns.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TypeAlias

import numpy as np

from jointid.common.arrays import FloatArray
from jointid.common.errors import MethodError
from jointid.common.parameters import Parameter
from jointid.estimation.problems.inverse_model import InverseModel, inverse_model
from jointid.estimation.result.parts import Iteration
from jointid.models.disturbances import Effect
from jointid.models.joints import ClosedLoop
from jointid.records.record import Channel, Record
from jointid.records.signals.filtering import Filtering
from jointid.simulation.closed_loop import Initial, Outcome, simulate
from jointid.simulation.loop_input import prepare
from jointid.solvers.regression import Fit, least_squares
from jointid.uncertainty.covariance import Covariance, sandwich, with_bands, with_measured_motion
from jointid.uncertainty.covariance import robust as robust_covariance
from jointid.uncertainty.model_tests import ChiSquareTest, durbin_wu_hausman

_PULL = 10.0  # deviations in units of which the pull of a homogeneous equation stays below one
_SETTLED = 1e-8  # relative change of the values that ends a reweighting
_REWEIGHTINGS = 100
_TINY = 1e-12  # of the torque: a size that no error falls below
_CLOSE = 1e-3  # deviations: values that change by less between two simulations have settled
_SIMULATIONS = 25  # of instruments, at most

Instruments: TypeAlias = Callable[[FloatArray], FloatArray]
"""The columns on the motion simulated with the values of all parameters, (rows, parameters)."""


@dataclass(frozen=True, slots=True, eq=False)
class Rows:
    """A linear regression.

    Attributes:
        Y: (rows,) the torque, filtered and decimated; the rows of one equation after those of the other.
        W: (rows, parameters) the columns.
        names: of the parameters.
        equations: how many share their instants.
        driven: how many of them, the first, have the torque of a motor; the others are homogeneous.
    """

    Y: FloatArray
    W: FloatArray
    names: tuple[str, ...]
    equations: int
    driven: int = 1

    def by_equation(self, values: FloatArray) -> FloatArray:
        """Return the values of all rows, (equations, instants)."""
        return values.reshape(self.equations, -1)

    def spread_out(self, sizes: FloatArray) -> FloatArray:
        """Return one number for each row, (rows,), from one for each equation."""
        return np.repeat(sizes, self.Y.size // self.equations)


@dataclass(frozen=True, slots=True, eq=False)
class Solution:
    """The result of an estimator.

    Attributes:
        fit: values, residual and conditioning; its relative error is of the rows as they are, not weighted.
        covariance: robust to autocorrelation, and to what the weights are.
        steps: reweightings, or simulations of instruments, that were made; 1 for none.
        trace: of the simulations of instruments.
        converged: whether these were enough.
        test: whether least squares would have done in the place of instruments.
    """

    fit: Fit
    covariance: Covariance
    steps: int
    trace: tuple[Iteration, ...] = ()
    converged: bool = True
    test: ChiSquareTest | None = None


def describe_stop(estimator: str, solution: Solution) -> str:
    """Return how an estimator ended, in a sentence."""
    if estimator == "iv":
        how = "converged: nothing changes any more" if solution.converged else "still changing"
        return f"{how} after {solution.steps} simulations"
    if estimator == "ols":
        return "a linear regression has one step"
    how = "until nothing changes" if solution.converged else "and still changing"
    return f"{solution.steps} reweightings {how}"


def _covariance(rows: Rows, Z: FloatArray, J: FloatArray, error: FloatArray) -> Covariance:
    """Return the robust covariance over rows, widened by that over frequency bands for the equation of the load.

    That equation contains no torque and little noise, so its residual is mostly model error, which repeats.
    """
    if rows.driven > 1:  # the motors of a robot
        return robust_covariance(Z, J, error, equations=rows.equations)
    found = sandwich(Z, J, error, rows.equations)
    if rows.equations == rows.driven:
        return found
    of_load = error.copy()
    of_load[: error.size // rows.equations * rows.driven] = 0.0
    return with_bands(found, Z, J, of_load, rows.equations)


def ordinary(rows: Rows) -> Solution:
    """Return ordinary least squares."""
    fit = least_squares(rows.W, rows.Y, rows.names)
    covariance = _covariance(rows, rows.W, rows.W, fit.residual)
    covariance = with_measured_motion(covariance, rows.W, rows.W, fit.residual, rows.equations)
    return Solution(fit, covariance, 1)


def weighted_least_squares(rows: Rows) -> Solution:
    """Return least squares with each equation divided by the size of its error, repeated until that is settled.

    Raises:
        MethodError: there is one equation, whose weight changes nothing; or as `least_squares`.
    """
    if rows.equations == 1:
        raise MethodError(
            "Weighting balances the two equations of a flexible joint; a rigid joint has one, whose weight changes "
            'nothing: use estimator = "ols".'
        )
    values, steps, settled = least_squares(rows.W, rows.Y, rows.names).values, 0, False
    while steps < _REWEIGHTINGS and not settled:
        scale = rows.spread_out(_sizes(rows, values))
        weighted = rows.W / scale[:, np.newaxis]
        before, values = values, least_squares(weighted, rows.Y / scale, rows.names).values
        steps += 1
        settled = bool(np.all(np.abs(values - before) <= _SETTLED * np.abs(values)))
    error = (rows.Y - rows.W @ values) / scale
    covariance = _covariance(rows, weighted, weighted, error)
    covariance = with_measured_motion(covariance, weighted, weighted, error, rows.equations)
    return Solution(_plain_fit(rows, values, weighted), covariance, steps, converged=settled)


ESTIMATORS: Mapping[str, Callable[[Rows], Solution]] = {
    "ols": ordinary,
    "weighted": weighted_least_squares,
}
"""The estimators without instruments, by name."""


def instrumental(rows: Rows, Z: FloatArray, values: FloatArray) -> Solution:
    """Return the solution of ``Z' (Y - W x) = 0``, each equation divided by the size of its error at `values`.

    Args:
        rows: the regression.
        Z: (rows, parameters) the instruments: columns that the errors of W and Y cannot reach.
        values: (parameters,) of the step before.

    Raises:
        MethodError: the instruments do not determine the parameters.
    """
    sizes = _sizes(rows, values)
    scale = rows.spread_out(sizes)[:, np.newaxis]
    Zs, Ws, Ys = Z / scale, rows.W / scale, rows.Y / scale[:, 0]
    try:
        least_squares(Zs, Ys, rows.names)
    except MethodError as error:
        raise MethodError(
            f"The simulated motion does not determine the parameters ({str(error).split(';')[0]}); check that the "
            "controller is the one the record was made with, or use another estimator."
        ) from None
    norms = np.linalg.norm(Zs, axis=0)
    found = np.linalg.solve((Zs / norms).T @ (Ws / norms), (Zs / norms).T @ Ys) / norms
    covariance = _covariance(rows, Zs, Ws, Ys - Ws @ found)
    return Solution(_plain_fit(rows, found, Ws), covariance, 1)


def simulated_instruments(
    record: Record,
    loop: ClosedLoop,
    model: InverseModel,
    parameters: Sequence[Parameter],
    filtering: Filtering,
    effects: Sequence[Effect],
) -> Instruments:
    """Return a function from parameters to the regressor on the simulated motion.

    The simulation starts at the measured position and velocity.

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
        moved = replace(moved, moving=model.moving)  # of the same rows
        return moved.decimate_columns(moved.columns, filtering, sample_time)

    return columns


def by_instruments(rows: Rows, instruments: Instruments, kept: FloatArray, free: Sequence[int]) -> Solution:
    """Return the fixed point of simulating and solving, from ordinary least squares, of several motors weighted.

    Args:
        rows: the regression of the free parameters.
        instruments: as from `simulated_instruments`.
        kept: (parameters,) values of the fixed parameters, 0 for the free ones.
        free: which parameters are free.

    Raises:
        MethodError: a simulation fails, or the instruments do not determine the parameters.
    """
    solution, chosen = ordinary(rows) if rows.driven == 1 else weighted_least_squares(rows), list(free)
    trace = [_line(0, rows, solution, None, None)]
    Z = rows.W
    for number in range(1, _SIMULATIONS + 1):
        whole = kept.copy()
        whole[chosen] = solution.fit.values
        Z = instruments(whole)[:, chosen]
        before, solution = solution, instrumental(rows, Z, solution.fit.values)
        trace.append(_line(number, rows, solution, before, trace[-1]))
        change = np.abs(solution.fit.values - before.fit.values)
        settled = bool(np.all(change <= _CLOSE * solution.covariance.std))
        if settled:
            break
    test = durbin_wu_hausman(rows.W, rows.Y, Z, rows.equations)
    return replace(solution, steps=len(trace) - 1, trace=tuple(trace), converged=settled, test=test)


def _line(number: int, rows: Rows, solution: Solution, before: Solution | None, last: Iteration | None) -> Iteration:
    values = solution.fit.values
    norm = float(np.linalg.norm(solution.fit.residual))
    step = change = None
    if before is not None and last is not None:
        size = np.where(values == 0, 1.0, np.abs(values))
        step = float(np.max(np.abs(values - before.fit.values) / size))
        change = abs(norm / last.residual_norm - 1.0) if last.residual_norm else 0.0
    return Iteration(number, dict(zip(rows.names, map(float, values), strict=True)), norm, change, step, number)


def _plain_fit(rows: Rows, values: FloatArray, W: FloatArray) -> Fit:
    """Return given values as a `Fit`, with the error of the rows as they are and the conditioning of W."""
    shape = least_squares(W, rows.Y, rows.names)
    residual = rows.Y - rows.W @ values
    sigma = float(np.linalg.norm(residual) / math.sqrt(rows.Y.size - values.size))
    error = float(np.linalg.norm(residual) / np.linalg.norm(rows.Y))
    return Fit(values, shape.std, residual, sigma, error, shape.conditioning)


def _sizes(rows: Rows, values: FloatArray) -> FloatArray:
    """Return the size of each equation's error, (equations,), a homogeneous one's held back (see the module)."""
    error, torque = rows.by_equation(rows.Y - rows.W @ values), rows.by_equation(rows.Y)
    least = _TINY * _rms(rows.Y)
    stated = rows.by_equation(np.any(rows.W != 0, axis=1))  # a joint that rests leaves rows of zeros
    sizes = np.array([max(_rms(equation[seen]), least) for equation, seen in zip(error, stated, strict=True)])
    for number in np.flatnonzero(~np.any(torque, axis=1)):
        of_it = np.arange(rows.equations).repeat(torque.shape[1]) == number
        inside = np.any(rows.W[of_it] != 0, axis=0)
        scale, others = rows.W[~of_it][:, inside] @ values[inside], rows.W[~of_it][:, ~inside]
        alone = np.linalg.norm(scale - others @ np.linalg.lstsq(others, scale, rcond=None)[0])
        rest = float(np.delete(sizes, number).max())
        pull = _PULL * float(error[number] @ error[number]) * rest / max(float(alone), least)
        sizes[number] = max(sizes[number], math.sqrt(pull))
    return sizes


def _rms(error: FloatArray) -> float:
    return float(np.sqrt(np.mean(error**2)))
