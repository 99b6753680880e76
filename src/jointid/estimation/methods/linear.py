"""The estimators of ``Y = W x``: ordinary and weighted least squares, and instrumental variables.

A robot has an equation for each joint, one row after the other at every instant. Their errors differ in size, and
weighting makes them alike. A flexible joint's load has an equation without a torque, and is not weighted: by its own
residual it would pull its unknowns towards 0.

The instruments of IDIM-IV come from the closed loop simulated at the estimate itself [Janot, Vandanjon, Gautier 2014].
The simulated motion is driven by the reference and the known signal alone, so noise and disturbances of the record do
not reach it; positions go through the same filters as the measured ones, and their columns are the instruments Z of
``Z' (Y - W x) = 0``. The next estimate is simulated in turn until nothing changes: two to five simulations.

Instruments need not be perfect, only free of the record's noise. So values outside their bounds are simulated at the
bound.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Literal, TypeAlias

import numpy as np

from jointid.common.arrays import FloatArray
from jointid.common.errors import MethodError
from jointid.common.parameters import Parameter, Quantity
from jointid.estimation.problems.inverse_model import MeasuredMotion
from jointid.solvers.regression import least_squares
from jointid.uncertainty.covariance import Covariance, Influence
from jointid.uncertainty.model_tests import EndogeneityTest, durbin_wu_hausman

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


def rows_of(
    motions: Sequence[MeasuredMotion], columns: Sequence[FloatArray], names: tuple[str, ...], driven: int
) -> Rows:
    """Return the regression along the motions of one log or several; columns are (samples, n, parameters) of each."""
    n = columns[0].shape[1]
    Y = join_rows([motion.thinned_torque() for motion in motions], n)
    W = join_rows([motion.decimate_columns(each) for motion, each in zip(motions, columns, strict=True)], n)
    return Rows(Y, W, names, n, driven)


def join_rows(each: Sequence[FloatArray], equations: int) -> FloatArray:
    """Return the rows of several logs as of one: those of one equation after those of the other.

    Args:
        each: (rows,) or (rows, columns) of each log.
        equations: how many share their instants.
    """
    whole = np.concatenate([rows.reshape(equations, -1, *rows.shape[1:]) for rows in each], axis=1)
    return whole.reshape(-1, *whole.shape[2:])


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
    test: EndogeneityTest | None = None


def solve_rows(
    rows: Rows, estimator: Estimator, known: Mapping[str, Parameter], instruments: Instruments | None = None
) -> Solution:
    """Return the solution of all parameters, with deviations of 0 for those that are fixed, or held by a bound.

    Unless an inertia is below 0, what violates a bound most, in deviations, is held there, and the rest solved again.

    Args:
        rows: of all parameters.
        estimator: its name.
        known: values and bounds by name; of others there are none.
        instruments: of "iv" alone.

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

    def columns(values: FloatArray) -> FloatArray:
        assert instruments is not None
        whole = kept.copy()
        whole[free] = values
        return instruments(whole)[:, free]

    solution = by_instruments(left, columns) if estimator == "iv" else least_squares_of(left, estimator)
    if not fixed:
        return solution
    std, correlation = np.zeros(kept.size), np.eye(kept.size)
    kept[free], std[free] = solution.values, solution.covariance.std
    correlation[np.ix_(free, free)] = solution.covariance.correlation
    return replace(solution, values=kept, covariance=Covariance(std, correlation))


def least_squares_of(rows: Rows, estimator: Estimator = "ols") -> Solution:
    """Return ordinary least squares, or "weighted": each equation divided by its error's size, until that settles.

    Raises:
        MethodError: the rows do not determine the parameters, or one of the weighted equations has no torque.
    """
    scale = np.ones(rows.Y.size)
    values, steps, settled = _solve_for(rows, scale), 0, False
    if estimator == "ols" or rows.equations == 1:
        return _conclude(rows, values, scale)
    if rows.equations > rows.driven:
        raise MethodError('The estimator "weighted" is for a robot; received a flexible joint: use "ols" or "iv".')
    while steps < _REWEIGHTINGS and not settled:
        scale = rows.spread_out(_sizes(rows, values))
        before, values = values, _solve_for(rows, scale)
        steps += 1
        settled = bool(np.all(np.abs(values - before) <= _SETTLED * np.abs(values)))
    stop = f"{steps} reweightings {'until nothing changes' if settled else 'and still changing'}"
    return replace(_conclude(rows, values, scale), stop=stop, converged=settled)


def by_instruments(rows: Rows, instruments: Instruments) -> Solution:
    """Return the fixed point of simulating and solving, from least squares, of several motors weighted.

    Args:
        rows: the regression of the free parameters.
        instruments: from their values the columns that the errors of rows cannot reach.

    Raises:
        MethodError: a simulation fails, or the instruments do not determine the parameters.
    """
    solution = least_squares_of(rows, "ols" if rows.driven == 1 else "weighted")
    number, settled, Z = 0, False, rows.W
    while number < _SIMULATIONS and not settled:
        number += 1
        Z, scale = instruments(solution.values), rows.spread_out(_sizes(rows, solution.values))
        before, solution = solution, _conclude(rows, _solve_for(rows, scale, Z), scale, Z)
        change = np.abs(solution.values - before.values)
        settled = bool(np.all(change <= _CLOSE * solution.covariance.std))
    test = durbin_wu_hausman(rows.W, rows.Y, Z, rows.equations)
    stop = f"{'converged: nothing changes any more' if settled else 'still changing'} after {number} simulations"
    return replace(solution, stop=stop, simulations=number, converged=settled, test=test)


def _solve_for(rows: Rows, scale: FloatArray, instruments: FloatArray | None = None) -> FloatArray:
    """Return the values that solve ``Z' (Y - W x) = 0``, rows divided by a scale, (rows,); Z is W when None."""
    W, Y = rows.W / scale[:, np.newaxis], rows.Y / scale
    if instruments is None:
        return least_squares(W, Y, rows.names)
    Z = instruments / scale[:, np.newaxis]
    try:
        least_squares(Z, Y, rows.names)
    except MethodError as error:
        raise MethodError(
            f"The simulated motion does not determine the parameters ({str(error).split(';')[0]}); check that the "
            "controller is the one the record was made with, or use another estimator."
        ) from None
    norms = np.linalg.norm(Z, axis=0)
    return np.asarray(np.linalg.solve((Z / norms).T @ (W / norms), (Z / norms).T @ Y) / norms)


def _conclude(rows: Rows, values: FloatArray, scale: FloatArray, instruments: FloatArray | None = None) -> Solution:
    """Return a solution with its robust covariance; of least squares along a measured motion widened for that.

    The equation of the load contains no torque and little noise, so its residual is mostly model error, which repeats:
    its deviations are widened by those over frequency bands.
    """
    residual = rows.Y - rows.W @ values
    error, per_row = residual / scale, scale[:, np.newaxis]
    Z = None if instruments is None else instruments / per_row
    influence = Influence(rows.W / per_row, error, Z, rows.equations)
    found = influence.robust() if rows.driven > 1 else influence.by_time()
    if rows.equations > rows.driven:
        of_load = error.copy()
        of_load[: error.size // rows.equations * rows.driven] = 0.0
        found = replace(influence, error=of_load).widen_for_bands(found)
    return Solution(values, residual, influence.widen_for_motion(found) if Z is None else found)


def _sizes(rows: Rows, values: FloatArray) -> FloatArray:
    """Return the size of each equation's error, (equations,); 1 where the equations of a joint are not weighted."""
    if rows.equations > rows.driven:
        return np.ones(rows.equations)
    least = _TINY * float(np.sqrt(np.mean(rows.Y**2)))
    error = rows.by_equation(rows.Y - rows.W @ values)
    stated = rows.by_equation(np.any(rows.W != 0, axis=1))  # a joint that rests leaves rows of zeros
    squares = [float(np.mean(one[seen] ** 2)) for one, seen in zip(error, stated, strict=True)]
    return np.maximum(np.sqrt(squares), least)
