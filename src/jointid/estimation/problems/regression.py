"""Linear regressions of stacked equations: ordinary or weighted least squares, or instruments.

**A torque of unstated timing** is one held from its stamp, or one sampled at it, half a sample earlier, which moves
friction and inertia. The rows are solved once, midway; their change between both readings is one more column, which
determines the reading of least power, between or beyond them. The nearer reading is taken. Each interval is widened by
the change of its parameter up to the least power, and by two deviations of its place.

**Weights.** The errors of a robot's joints differ in size by powers of ten from base to wrist, and those of several
records may. Each joint's rows of a record are divided by the size of their own error, until that settles [Gautier 1997,
who does it once]. Without weights ("ols") the large joints decide the wrist's parameters. A flexible joint's load has
no torque, and its motor's weight: by its own residual it would pull its unknowns towards 0.

**Instruments** are columns Z free of the record's noise: ``Z' (Y - W x) = 0``. They are made anew with each solution.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Literal, TypeAlias

import numpy as np

from jointid.common.arrays import FloatArray
from jointid.common.errors import MethodError
from jointid.common.parameters import Bounds, Parameter, Quantity
from jointid.common.text import number
from jointid.records.record import Timing
from jointid.solvers.solve import least_squares
from jointid.uncertainty.covariance import Covariance, Influence, white

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
        equations: number of equations with common instants.
        driven: number of the first ones, which have the torque of a motor; the others are homogeneous.
        series: rows of each record in one equation; empty for one record.
        early: (rows,) change of the torque if it is read as sampled; None if all timings are stated.
    """

    Y: FloatArray
    W: FloatArray
    names: tuple[str, ...]
    equations: int
    driven: int = 1
    series: tuple[int, ...] = ()
    early: FloatArray | None = None

    def relative_errors(self, values: FloatArray) -> FloatArray:
        """Residual share of each motor's torque, (driven,), including a joint's load."""
        left, whole = (one.reshape(self.driven, -1) for one in (self.Y - self.W @ values, self.Y))
        return np.asarray(np.linalg.norm(left, axis=1) / np.linalg.norm(whole, axis=1))


@dataclass(frozen=True, eq=False)
class Solution:
    """The result of an estimator.

    Attributes:
        rows: of all parameters. free: indices of those without a fixed value or active bound.
        values: (parameters,) of all.
        scale: (rows,) sizes of errors by which the rows were divided.
        instruments: (rows, free) of the last turn; None of least squares.
        turns: number of solutions. converged: whether the last ones settled.
        held: values of the parameters that a bound holds, by name.
        further: (parameters,) deviations beside those of the rows.
        timing: reading of torques of unstated timing; None if all are stated. said: on that, in a sentence.
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
    timing: Timing | None = None
    said: tuple[str, ...] = ()

    def fix(self, parameters: Sequence[Parameter]) -> tuple[Parameter, ...]:
        """Fix the parameters that a value or a bound holds."""
        pairs = enumerate(zip(parameters, map(float, self.values), strict=True))
        return tuple(p if i in self.free else p.fix(value) for i, (p, value) in pairs)

    @property
    def residual(self) -> FloatArray:
        """Of the rows as they are, not weighted, (rows,)."""
        return self.rows.Y - self.rows.W @ self.values

    @cached_property
    def covariance(self) -> Covariance:
        """Covariance robust to autocorrelation and for these weights; 0 when fixed.

        For least squares along a measured motion it is widened for the bias. The equation of a load contains no torque
        and little noise, so its residual is mostly model error, which repeats: deviations are widened by those over
        frequency bands.
        """
        rows, per_row, error = self.rows, self.scale[:, np.newaxis], self.residual / self.scale
        Z = None if self.instruments is None else self.instruments / per_row
        influence = Influence(rows.W[:, self.free] / per_row, error, Z, rows.equations, rows.series)
        found = influence.robust() if rows.driven > 1 else influence.by_time()
        if rows.equations > rows.driven:
            of_load = error.copy()
            of_load[: error.size // rows.equations * rows.driven] = 0.0
            found = replace(influence, error=of_load).widen_for_bands(found)
        found = influence.widen_for_motion(found) if Z is None else found
        std, correlation = np.zeros(self.values.size), np.eye(self.values.size)
        std[self.free], correlation[np.ix_(self.free, self.free)] = found.std, found.correlation
        return Covariance(np.hypot(std, self.further), correlation)


def solve_rows(
    rows: Rows,
    estimator: Estimator,
    known: Mapping[str, Parameter],
    instruments: Instruments | None = None,
    turns: int = 100,
) -> Solution:
    """Solve for all parameters, some fixed or held by a bound.

    Unless an inertia is below 0, the parameter that violates a bound most, in deviations, is held there, and the rest
    solved again.

    `known` has values and bounds by name, `instruments` are for "iv" only, and `turns` limits the turns of weights.

    Raises:
        MethodError: all parameters are fixed, or the rows do not determine those that are not.
    """
    if estimator == "iv" and instruments is None:
        raise MethodError(
            'The estimator "iv" simulates the loop for its instruments; expected the controller of each joint: '
            "give it, or use another estimator."
        )
    rows = rows if rows.early is None else replace(rows, Y=rows.Y + 0.5 * rows.early)
    stated = [known.get(name) or Parameter(name, name, Quantity.RATIO) for name in rows.names]
    fixed = {name: p.start or 0.0 for name, p in zip(rows.names, stated, strict=True) if not p.free}
    held, made, bounds = dict[str, float](), 0, Bounds.of(stated)
    while True:
        found = _settle(rows, estimator, fixed | held, instruments, turns)
        found = found if rows.early is None else _read_timing(found, rows.early)
        made += found.turns
        values = found.values
        there = np.where(np.isin(np.arange(values.size), found.free), bounds.clip(values), values)
        outside = np.flatnonzero(there != values)
        # No bound, nor one of another, is a remedy of an inertia below 0.
        if not outside.size or any(stated[i].quantity is Quantity.INERTIA and values[i] <= 0.0 for i in outside):
            return replace(found, turns=made, held=held)
        std = found.covariance.std
        sizes = np.where(std > 0.0, std, np.where(values == 0.0, 1.0, np.abs(values)))
        most = outside[np.argmax(np.abs(there - values)[outside] / sizes[outside])]
        held[rows.names[most]] = float(there[most])


def _settle(
    rows: Rows, estimator: Estimator, fixed: Mapping[str, float], instruments: Instruments | None, turns: int
) -> Solution:
    """Repeat with the previous weights and instruments until the values settle.

    Instruments begin at least squares, weighted for several motors.
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
        while found.turns < (turns if make is None else 25) and not found.converged:
            Z, before = None if make is None else make(found.values)[:, free], found.values
            beside = found.residual if rows.early is None else found.scale * _split_timing(found, rows.early)[-1]
            scale, values = _scale(rows, beside), before.copy()
            values[free] = _solve(left, scale, Z)
            close = 1e-8 * np.abs(before[free])  # relative: values that change by less with new weights have settled
            if Z is not None:
                close = 1e-3 * white(left.W / scale[:, np.newaxis], (rows.Y - rows.W @ values) / scale).std
            settled = bool(np.all(np.abs(values - before)[free] <= close))
            found = Solution(rows, free, values, scale, Z, found.turns + 1, settled)
    return found


def _solve(rows: Rows, scale: FloatArray, instruments: FloatArray | None = None) -> FloatArray:
    """Solve the scaled equations of instruments; Z defaults to W."""
    W, Y = rows.W / scale[:, np.newaxis], rows.Y / scale
    if instruments is None:
        return least_squares(W, Y, rows.names)
    Z = instruments / scale[:, np.newaxis]
    least_squares(Z, Y, rows.names)  # which refuses a motion that does not determine them
    norms = np.linalg.norm(Z, axis=0)
    return np.asarray(np.linalg.solve((Z / norms).T @ (W / norms), (Z / norms).T @ Y) / norms)


def _scale(rows: Rows, residual: FloatArray) -> FloatArray:
    """Error size of each row's equation in its record, (rows,)."""
    least, series = 1e-12 * float(np.sqrt(np.mean(rows.Y**2))), rows.series or (residual.size // rows.equations,)
    at, each = np.cumsum((0, *series[:-1])), (residual**2, 1.0 * np.any(rows.W != 0.0, axis=1))
    powers, seen = (np.add.reduceat(one.reshape(rows.equations, -1), at, axis=1) for one in each)
    sizes = np.maximum(np.sqrt(powers / np.maximum(seen, 1.0)), least)  # a joint that rests leaves rows of zeros
    return np.repeat(np.resize(sizes[: rows.driven], sizes.shape), series, axis=1).ravel()


def _split_timing(midway: Solution, early: FloatArray) -> tuple[FloatArray, float, float, FloatArray]:
    """Shift of the values by the change of reading, its squared residual, how much fits, and the scaled rest."""
    rows, free, by = midway.rows, midway.free, np.zeros(midway.values.size)
    left = replace(rows, Y=early, W=rows.W[:, free], names=tuple(rows.names[i] for i in free))
    by[free] = _solve(left, midway.scale, midway.instruments)
    residual, change = midway.residual / midway.scale, (early - rows.W @ by) / midway.scale
    size = float(change @ change)
    best = -float(residual @ change) / max(size, np.finfo(float).tiny)
    return by, size, best, residual + best * change


def _read_timing(midway: Solution, early: FloatArray) -> Solution:
    """Choose the held or sampled torque, half a change from midway, and widen for remaining doubt."""
    rows, (by, size, best, rest) = midway.rows, _split_timing(midway, early)
    timing, away, where = Timing.HELD, 1.0, "the other reading is as possible"
    noise = max(float(np.mean(rest**2)), 1e-24 * float(np.mean((rows.Y / midway.scale) ** 2)))
    if size > 1e-6 * noise:  # a change of less power is rounding
        spread, best = 4.0 * np.sqrt(noise / size), float(np.clip(best + 0.5, -8.0, 8.0))  # neighbours are alike
        late = best > 0.5  # half samples: far beyond both readings the residual is no straight line
        timing, away = Timing.SAMPLED if late else Timing.HELD, abs(best - late) + min(spread, 1.0)
        place = f"{number(0.5 * best, 2)} ± {number(0.5 * spread, 2)} samples before held"
        where = f"the record puts it {place} (sampled is 0.5, averaged 1)"
    said = (
        f"it is not stated whether the torque is held or sampled: it is read as {timing}, and {where}; the intervals "
        "cover that; state timing of its channel"
    )
    shift = 0.5 if timing is Timing.SAMPLED else -0.5
    read, values = replace(rows, Y=rows.Y + shift * early, early=None), midway.values + shift * by
    return replace(midway, rows=read, values=values, further=0.5 * away * np.abs(by), timing=timing, said=(said,))
