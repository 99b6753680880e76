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
from functools import cached_property
from typing import Literal, TypeAlias

import numpy as np

from jointid.common.arrays import FloatArray
from jointid.common.errors import MethodError
from jointid.common.parameters import Parameter, Quantity
from jointid.common.text import pluralise
from jointid.estimation.problems.inverse_model import Rows
from jointid.solvers.regression import least_squares
from jointid.uncertainty.covariance import Covariance, Influence, white
from jointid.uncertainty.model_tests import EndogeneityTest, durbin_wu_hausman

_TINY = 1e-12  # of the torque: a size that no error falls below
_SETTLED = 1e-8  # relative: values that change by less with new weights have settled
_CLOSE = 1e-3  # deviations: likewise with new instruments
_TURNS, _SIMULATIONS = 100, 25  # of weights, and of instruments, at most

Estimator: TypeAlias = Literal["ols", "weighted", "iv"]

Instruments: TypeAlias = Callable[[FloatArray], FloatArray]
"""The columns on the motion simulated with the values of all parameters, (rows, parameters)."""


@dataclass(frozen=True, eq=False)
class Solution:
    """The result of an estimator.

    Attributes:
        rows: of all parameters. free: indices of those that neither a value nor a bound holds.
        values: (parameters,) of all.
        scale: (rows,) sizes of errors by which the rows were divided.
        instruments: (rows, free) of the last turn; None of least squares.
        turns: solutions that were made. converged: whether the last ones settled.
        held: values of the parameters that a bound holds, by name.
        further: (parameters,) deviations beside those of the rows.
    """

    rows: Rows
    free: list[int]
    values: FloatArray
    scale: FloatArray
    instruments: FloatArray | None = None
    turns: int = 1
    converged: bool = True
    held: Mapping[str, float] = field(default_factory=dict)
    further: FloatArray | float = 0.0

    @property
    def residual(self) -> FloatArray:
        """Of the rows as they are, not weighted, (rows,)."""
        return self.rows.Y - self.rows.W @ self.values

    @property
    def simulations(self) -> int:
        """Of instruments that were made."""
        return 0 if self.instruments is None else self.turns

    @property
    def stop(self) -> str:
        """How it ended, in a sentence."""
        return f"{'settled' if self.converged else 'still changing'} after {pluralise(self.turns, 'solution')}"

    @cached_property
    def covariance(self) -> Covariance:
        """Robust to autocorrelation, and to what the weights are; of fixed parameters 0.

        Of least squares along a measured motion it is widened for that. The equation of a load contains no torque and
        little noise, so its residual is mostly model error, which repeats: deviations are widened by those over
        frequency bands.
        """
        rows, per_row, error = self.rows, self.scale[:, np.newaxis], self.residual / self.scale
        Z = None if self.instruments is None else self.instruments / per_row
        influence = Influence(rows.W[:, self.free] / per_row, error, Z, rows.equations)
        found = influence.robust() if rows.driven > 1 else influence.by_time()
        if rows.equations > rows.driven:
            of_load = error.copy()
            of_load[: error.size // rows.equations * rows.driven] = 0.0
            found = replace(influence, error=of_load).widen_for_bands(found)
        found = influence.widen_for_motion(found) if Z is None else found
        std, correlation = np.zeros(self.values.size), np.eye(self.values.size)
        std[self.free], correlation[np.ix_(self.free, self.free)] = found.std, found.correlation
        return Covariance(np.hypot(std, self.further), correlation)

    @property
    def test(self) -> EndogeneityTest | None:
        """Whether least squares would have done in the place of instruments."""
        if self.instruments is None:
            return None
        W, known = self.rows.W, self.values.copy()
        known[self.free] = 0.0
        return durbin_wu_hausman(W[:, self.free], self.rows.Y - W @ known, self.instruments, self.rows.equations)


def solve_rows(
    rows: Rows,
    estimator: Estimator,
    known: Mapping[str, Parameter],
    instruments: Instruments | None = None,
    turns: int | None = None,
) -> Solution:
    """Return the solution of all parameters, some of which are fixed, or held by a bound.

    Unless an inertia is below 0, what violates a bound most, in deviations, is held there, and the rest solved again.

    Args:
        rows: of all parameters.
        estimator: its name.
        known: values and bounds by name; of others there are none.
        instruments: of "iv" alone.
        turns: of weights, at most.

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
    held, made = dict[str, float](), 0
    while True:
        found = _settle(rows, estimator, fixed | held, instruments, turns or _TURNS)
        made += found.turns
        outside = {
            name: p.lower if value < p.lower else p.upper
            for i, (name, value) in enumerate(zip(rows.names, found.values, strict=True))
            if i in found.free and (p := known.get(name)) is not None and not p.lower <= value <= p.upper
        }
        values = dict(zip(rows.names, found.values, strict=True))
        # No bound, nor one of another, is a remedy of an inertia below 0.
        if not outside or any(known[one].quantity is Quantity.INERTIA and values[one] <= 0.0 for one in outside):
            return replace(found, turns=made, held=held)
        std = dict(zip(rows.names, found.covariance.std, strict=True))
        most = max(
            outside, key=lambda name: abs(values[name] - outside[name]) / (std[name] or abs(values[name]) or 1.0)
        )
        held[most] = outside[most]


def _settle(
    rows: Rows, estimator: Estimator, fixed: Mapping[str, float], instruments: Instruments | None, turns: int
) -> Solution:
    """Solve again with the weights, and with the instruments, of the values before, until these settle.

    Instruments begin at least squares, of several motors weighted.
    """
    values = np.array([fixed.get(name, 0.0) for name in rows.names])
    free = [i for i, name in enumerate(rows.names) if name not in fixed]
    if not free:
        raise MethodError("All parameters are fixed, so there is nothing to identify; leave some of them out.")
    left = replace(rows, Y=rows.Y - rows.W @ values, W=rows.W[:, free], names=tuple(rows.names[i] for i in free))
    found = Solution(rows, free, values, np.ones(rows.Y.size))
    values[free] = _solve(left, found.scale)
    for make in {"ols": (), "weighted": (None,), "iv": (None, instruments)}[estimator]:
        found = replace(found, turns=0, converged=False)
        while found.turns < (turns if make is None else _SIMULATIONS) and not found.converged:
            Z, before = None if make is None else make(found.values)[:, free], found.values
            scale, values = rows.spread_out(_sizes(rows, found.residual)), before.copy()
            values[free] = _solve(left, scale, Z)
            close = _SETTLED * np.abs(before[free])
            if Z is not None:
                close = _CLOSE * white(left.W / scale[:, np.newaxis], (rows.Y - rows.W @ values) / scale).std
            settled = bool(np.all(np.abs(values - before)[free] <= close))
            found = Solution(rows, free, values, scale, Z, found.turns + 1, settled)
    return found


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


def _sizes(rows: Rows, residual: FloatArray) -> FloatArray:
    """Return the size of each equation's error, (equations,); 1 where the equations of a joint are not weighted."""
    if rows.equations > rows.driven:
        return np.ones(rows.equations)
    least = _TINY * float(np.sqrt(np.mean(rows.Y**2)))
    stated = rows.by_equation(np.any(rows.W != 0, axis=1))  # a joint that rests leaves rows of zeros
    each = zip(rows.by_equation(residual), stated, strict=True)
    return np.maximum([float(np.sqrt(np.mean(one[seen] ** 2))) for one, seen in each], least)
