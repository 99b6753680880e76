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

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from typing import Literal, TypeAlias

import numpy as np

from jointid.common.arrays import FloatArray
from jointid.common.errors import MethodError
from jointid.common.parameters import Parameter, Quantity
from jointid.estimation.problems.inverse_model import Rows
from jointid.solvers.regression import least_squares
from jointid.uncertainty.covariance import Covariance, Influence, white
from jointid.uncertainty.model_tests import EndogeneityTest, durbin_wu_hausman

_TINY = 1e-12  # of the torque: a size that no error falls below
_CLOSE = 1e-3  # deviations: values that change by less with new weights or instruments have settled
_TURNS = 25  # of weights or instruments, at most

Estimator: TypeAlias = Literal["ols", "weighted", "iv"]

Instruments: TypeAlias = Callable[[FloatArray], FloatArray]
"""The columns on the motion simulated with the values of all parameters, (rows, parameters)."""


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
    stop: str
    converged: bool
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
        MethodError: all parameters are fixed, the rows do not determine those that are not, or the estimator is not for
            them.
    """
    if estimator == "iv" and instruments is None:
        raise MethodError(
            'The estimator "iv" simulates the loop for its instruments; expected the controller of each joint: '
            "give it, or use another estimator."
        )
    if estimator == "weighted" and rows.equations > rows.driven:
        raise MethodError('The estimator "weighted" is for a robot; received a flexible joint: use "ols" or "iv".')
    fixed = {name: p.start or 0.0 for name, p in known.items() if not p.free and name in rows.names}
    held, simulations = dict[str, float](), 0
    while True:
        solution = _solve_free(rows, estimator, fixed | held, instruments)
        simulations += solution.simulations
        solution = replace(solution, simulations=simulations, held=dict(held))
        beyond = dict[str, tuple[float, float]]()
        for name, value, spread in zip(rows.names, solution.values, solution.covariance.std, strict=True):
            p = known.get(name)
            if p is None or name in fixed or name in held or p.lower <= value <= p.upper:
                continue
            if p.quantity is Quantity.INERTIA and value <= 0.0:  # no bound, nor one of another, is a remedy
                return solution
            bound = p.lower if value < p.lower else p.upper
            beyond[name] = abs(value - bound) / (spread or abs(value) or 1.0), bound
        if not beyond:
            return solution
        most = max(beyond, key=lambda name: beyond[name][0])
        held[most] = beyond[most][1]


def _solve_free(
    rows: Rows, estimator: Estimator, fixed: Mapping[str, float], instruments: Instruments | None
) -> Solution:
    """Return the solution with some parameters fixed.

    Instruments begin at least squares, of several motors weighted; each is a fixed point of solving, again with the
    weights, and with the instruments, of the values before.
    """
    whole = np.array([fixed.get(name, 0.0) for name in rows.names])
    free = [i for i, name in enumerate(rows.names) if name not in fixed]
    if not free:
        raise MethodError("All parameters are fixed, so there is nothing to identify; leave some of them out.")
    left = replace(rows, Y=rows.Y - rows.W @ whole, W=rows.W[:, free], names=tuple(rows.names[i] for i in free))
    scale, turns, settled, Z = np.ones(rows.Y.size), 1, True, None
    values = _solve(left, scale)
    for simulated in {"ols": (), "weighted": (False,), "iv": (False, True)}[estimator]:
        turns, settled = 0, False
        while turns < _TURNS and not settled:
            turns += 1
            if simulated and instruments is not None:
                whole[free] = values
                Z = instruments(whole)[:, free]
            scale = rows.spread_out(_sizes(left, values))
            before, values = values, _solve(left, scale, Z)
            spread = white(left.W / scale[:, np.newaxis], (left.Y - left.W @ values) / scale).std
            settled = bool(np.all(np.abs(values - before) <= _CLOSE * spread))
    covariance = _covariance_of(left, values, scale, Z)
    whole[free] = values
    std, correlation = np.zeros(whole.size), np.eye(whole.size)
    std[free], correlation[np.ix_(free, free)] = covariance.std, covariance.correlation
    return Solution(
        whole,
        rows.Y - rows.W @ whole,
        Covariance(std, correlation),
        f"{'settled' if settled else 'still changing'} after {turns} {'solution' if turns == 1 else 'solutions'}",
        settled,
        0 if Z is None else turns,
        test=None if Z is None else durbin_wu_hausman(left.W, left.Y, Z, left.equations),
    )


def _solve(rows: Rows, scale: FloatArray, instruments: FloatArray | None = None) -> FloatArray:
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


def _covariance_of(rows: Rows, values: FloatArray, scale: FloatArray, instruments: FloatArray | None) -> Covariance:
    """Return the robust covariance of a solution; of least squares along a measured motion widened for that.

    The equation of the load contains no torque and little noise, so its residual is mostly model error, which repeats:
    its deviations are widened by those over frequency bands.
    """
    error, per_row = (rows.Y - rows.W @ values) / scale, scale[:, np.newaxis]
    Z = None if instruments is None else instruments / per_row
    influence = Influence(rows.W / per_row, error, Z, rows.equations)
    found = influence.robust() if rows.driven > 1 else influence.by_time()
    if rows.equations > rows.driven:
        of_load = error.copy()
        of_load[: error.size // rows.equations * rows.driven] = 0.0
        found = replace(influence, error=of_load).widen_for_bands(found)
    return influence.widen_for_motion(found) if Z is None else found


def _sizes(rows: Rows, values: FloatArray) -> FloatArray:
    """Return the size of each equation's error, (equations,); 1 where the equations of a joint are not weighted."""
    if rows.equations > rows.driven:
        return np.ones(rows.equations)
    least = _TINY * float(np.sqrt(np.mean(rows.Y**2)))
    error = rows.by_equation(rows.Y - rows.W @ values)
    stated = rows.by_equation(np.any(rows.W != 0, axis=1))  # a joint that rests leaves rows of zeros
    squares = [float(np.mean(one[seen] ** 2)) for one, seen in zip(error, stated, strict=True)]
    return np.maximum(np.sqrt(squares), least)
