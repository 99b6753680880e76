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
bound.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Literal, TypeAlias

import numpy as np

from jointid.common.arrays import FloatArray
from jointid.common.errors import MethodError
from jointid.common.parameters import Parameter, Quantity
from jointid.estimation.problems.inverse_model import MeasuredMotion, filter_motion
from jointid.solvers.regression import least_squares
from jointid.uncertainty.covariance import Covariance, Influence
from jointid.uncertainty.model_tests import ChiSquareTest, durbin_wu_hausman

_PULL = 10.0  # deviations in units of which the pull of a homogeneous equation stays below one
_SETTLED = 1e-8  # relative change of the values that ends a reweighting
_REWEIGHTINGS = 100
_TINY = 1e-12  # of the torque: a size that no error falls below
_CLOSE = 1e-3  # deviations: values that change by less between two simulations have settled
_SIMULATIONS = 25  # of instruments, at most

Estimator: TypeAlias = Literal["ols", "weighted", "iv"]

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
        values: (parameters,) of all. residual: (rows,) of the rows as they are, not weighted.
        covariance: robust to autocorrelation, and to what the weights are; of fixed parameters 0.
        stop: how it ended, in a sentence. converged: whether that is a good end.
        simulations: of instruments that were made.
        held: values of the parameters that a bound holds, by name.
        test: whether least squares would have done in the place of instruments.
    """

    values: FloatArray
    residual: FloatArray
    covariance: Covariance
    stop: str = "a linear regression has one step"
    converged: bool = True
    simulations: int = 0
    held: Mapping[str, float] = field(default_factory=dict)
    test: ChiSquareTest | None = None


def solve_rows(
    rows: Rows, estimator: Estimator, known: Mapping[str, Parameter], instruments: Instruments | None = None
) -> Solution:
    """Return the solution of all parameters, with deviations of 0 for those that are fixed, or held by a bound.

    Unless an inertia is below 0, what violates a bound most, in deviations, is held there, and the rest solved again.

    Args:
        rows: of all parameters.
        estimator: its name; one equation needs no weights.
        known: values and bounds by name; of others there are none.
        instruments: of "iv" alone, as from `instruments_of`.

    Raises:
        MethodError: all parameters are fixed, or the rows do not determine those that are not.
    """
    if estimator == "iv" and instruments is None:
        raise MethodError(
            'The estimator "iv" simulates the loop for its instruments; expected the controller of each joint: '
            "give it, or use another estimator."
        )
    fixed = {name: p.start or 0.0 for name, p in known.items() if not p.free and name in rows.names}
    held, simulations = dict[str, float](), 0
    while True:
        solution = _solve_free(rows, estimator, fixed | held, instruments)
        simulations += solution.simulations
        found, std = solution.values, solution.covariance.std
        beyond = dict[str, tuple[float, float]]()
        for name, value, spread in zip(rows.names, found, std, strict=True):
            p = known.get(name)
            if p is None or name in fixed or name in held or p.lower <= value <= p.upper:
                continue
            if p.quantity is Quantity.INERTIA and value <= 0.0:  # no bound, nor one of another, is a remedy
                return replace(solution, simulations=simulations, held=held)
            bound = p.lower if value < p.lower else p.upper
            beyond[name] = abs(value - bound) / (spread or abs(value) or 1.0), bound
        if not beyond:
            return replace(solution, simulations=simulations, held=held)
        most = max(beyond, key=lambda name: beyond[name][0])
        held[most] = beyond[most][1]


def _solve_free(
    rows: Rows, estimator: Estimator, fixed: Mapping[str, float], instruments: Instruments | None
) -> Solution:
    kept = np.array([fixed.get(name, 0.0) for name in rows.names])
    free = [i for i, name in enumerate(rows.names) if name not in fixed]
    if not free:
        raise MethodError("All parameters are fixed, so there is nothing to identify; leave some of them out.")
    left = replace(rows, Y=rows.Y - rows.W @ kept, W=rows.W[:, free], names=tuple(rows.names[i] for i in free))
    if instruments is not None and estimator == "iv":
        solution = _by_instruments(left, instruments, kept, free)
    else:
        solution = ordinary(left) if estimator == "ols" or rows.equations == 1 else weighted_least_squares(left)
    if not fixed:
        return solution
    std, correlation = np.zeros(kept.size), np.eye(kept.size)
    kept[free], std[free] = solution.values, solution.covariance.std
    correlation[np.ix_(free, free)] = solution.covariance.correlation
    covariance = replace(solution.covariance, std=std, correlation=correlation)
    return replace(solution, values=kept, covariance=covariance)


def _covariance(rows: Rows, W: FloatArray, error: FloatArray, instruments: FloatArray | None = None) -> Covariance:
    """Return the robust covariance; of least squares along a measured motion widened for that.

    The equation of the load contains no torque and little noise, so its residual is mostly model error, which repeats:
    its deviations are widened by those over frequency bands.
    """
    influence = Influence(W, error, instruments, rows.equations)
    found = influence.robust() if rows.driven > 1 else influence.by_time()
    if rows.equations > rows.driven:
        of_load = error.copy()
        of_load[: error.size // rows.equations * rows.driven] = 0.0
        found = replace(influence, error=of_load).widen_for_bands(found)
    return influence.widen_for_motion(found) if instruments is None else found


def ordinary(rows: Rows) -> Solution:
    """Return ordinary least squares."""
    values = least_squares(rows.W, rows.Y, rows.names)
    residual = rows.Y - rows.W @ values
    return Solution(values, residual, _covariance(rows, rows.W, residual))


def weighted_least_squares(rows: Rows) -> Solution:
    """Return least squares with each equation divided by the size of its error, repeated until that is settled."""
    values, steps, settled = least_squares(rows.W, rows.Y, rows.names), 0, False
    while steps < _REWEIGHTINGS and not settled:
        scale = rows.spread_out(_sizes(rows, values))
        weighted = rows.W / scale[:, np.newaxis]
        before, values = values, least_squares(weighted, rows.Y / scale, rows.names)
        steps += 1
        settled = bool(np.all(np.abs(values - before) <= _SETTLED * np.abs(values)))
    residual = rows.Y - rows.W @ values
    covariance = _covariance(rows, weighted, residual / scale)
    stop = f"{steps} reweightings {'until nothing changes' if settled else 'and still changing'}"
    return Solution(values, residual, covariance, stop, settled)


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
    covariance = _covariance(rows, Ws, Ys - Ws @ found, Zs)
    return Solution(found, rows.Y - rows.W @ found, covariance)


def instruments_of(
    motion: MeasuredMotion,
    simulate: Callable[[FloatArray], FloatArray],
    columns: Callable[[FloatArray, FloatArray, FloatArray], FloatArray],
) -> Instruments:
    """Return a function from the values of all parameters to the columns on the simulated motion.

    Args:
        motion: that was measured; rows at which its masses rest or turn round are left out of both.
        simulate: from the values to the raw positions, (samples, n).
        columns: on positions, velocities and accelerations, (samples, n) each.
    """
    size = len(motion.q)

    def made(values: FloatArray) -> FloatArray:
        positions = simulate(values)[:size]
        whole = np.pad(positions, ((0, size - len(positions)), (0, 0)), "edge")
        return motion.decimate_columns(columns(*filter_motion(whole, motion.sample_time, motion.filtering)))

    return made


def not_simulated(outcome: str) -> MethodError:
    """Return the refusal of instruments from a simulation that did not end."""
    return MethodError(
        f"The instruments of IV come from a simulation, but with these values {outcome}; check the controllers' gains, "
        "or use another estimator."
    )


def _by_instruments(rows: Rows, instruments: Instruments, kept: FloatArray, free: Sequence[int]) -> Solution:
    """Return the fixed point of simulating and solving, from ordinary least squares, of several motors weighted.

    Args:
        rows: the regression of the free parameters.
        instruments: the columns of all parameters on the simulated motion.
        kept: (parameters,) values of the fixed parameters, 0 for the free ones.
        free: which parameters are free.

    Raises:
        MethodError: a simulation fails, or the instruments do not determine the parameters.
    """
    solution, chosen = ordinary(rows) if rows.driven == 1 else weighted_least_squares(rows), list(free)
    number, settled, Z = 0, False, rows.W
    while number < _SIMULATIONS and not settled:
        number += 1
        whole = kept.copy()
        whole[chosen] = solution.values
        Z = instruments(whole)[:, chosen]
        before, solution = solution, instrumental(rows, Z, solution.values)
        change = np.abs(solution.values - before.values)
        settled = bool(np.all(change <= _CLOSE * solution.covariance.std))
    test = durbin_wu_hausman(rows.W, rows.Y, Z, rows.equations)
    stop = f"{'converged: nothing changes any more' if settled else 'still changing'} after {number} simulations"
    return replace(solution, stop=stop, simulations=number, converged=settled, test=test)


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
