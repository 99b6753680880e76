"""Score test of each fault alone: one Gauss-Newton step on the whitened residual.

With J the sensitivities of the free parameters and c the column of a fault (`fault_signatures`), the residual e of a
solved problem is regressed on both. The last coefficient is the size of the fault, and its ratio to its deviation the
statistic. Before that, e, J and c go through one filter that makes the noise nearly white: the prediction error of an
autoregressive model of the part of e that no fault explains. So the statistic is nearly that of the likelihood, which
distinguishes kp from kv or a gain of the log where plain least squares, in a loop that shapes the noise, does not. The
model need not be right: the deviation is the autocorrelation-robust one of `uncertainty`, widened where the remaining
residual is position-dependent (`repeatable`).

All tests of a record are one family: p-values are multiplied by the number of faults, and of shapes tried for one
(Bonferroni). Faults whose columns are collinear, given the joint's parameters, are one.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import TypeAlias

import numpy as np

from jointid.common.arrays import FloatArray, column_norms
from jointid.diagnostics.fault_signatures import INJECTED_GAIN, ONE_SIDED, FaultSignature
from jointid.diagnostics.loop_check import FaultTest
from jointid.uncertainty.covariance import larger, robust
from jointid.uncertainty.position_dependent_error import Cells, by_place, repeatable

_ORDER, _FLOOR = 16, 1e-2  # of the autoregressive model; of its variance, white: a stop band is not to be blown up
_RANK = 1e-10  # of the largest singular value of columns
_COLLINEAR = 1e-12  # of the square of a column: a smaller remainder beside the joint's parameters is rounding
_SAME = 0.999  # cosine of two collinear columns
_LAST = ("gain", INJECTED_GAIN)  # named only where no other fault is collinear
_WIDENED = 0.05  # a test with a larger p-value is not significant, however its deviation is widened

Filter: TypeAlias = Callable[[FloatArray], FloatArray]


@dataclass(frozen=True, slots=True, eq=False)
class _Step:
    """One Gauss-Newton step along the signature of a fault.

    Attributes:
        alternative: with the best of its shapes.
        shapes: how many there were.
        size: of the step.
        gain: decrease of the squared residual.
        alone: (rows,) its whitened column, orthogonal to the other columns.
    """

    alternative: FaultSignature
    shapes: int
    size: float
    gain: float
    alone: FloatArray


def score_signatures(
    residual: FloatArray,
    own: FloatArray,
    alternatives: Sequence[FaultSignature],
    declared: Mapping[str, float],
    where: Callable[[], Cells],
) -> tuple[FaultTest, ...]:
    """Test each fault alone, the strongest first.

    Args:
        residual: (rows,) of a solved problem, in the order of time.
        own: (rows, free) columns of its free parameters, and of faults already corrected.
        alternatives: signatures of all faults: none of them is noise.
        declared: value, by the name of each fault to be tested.
        where: returns the rows' cells; called only where a test is significant.
    """
    whiten = fit_whitener(_remove_regression(np.column_stack([own, *(a.column for a in alternatives)]), residual))
    basis, error = _find_basis(whiten(own)), whiten(residual)
    left = error - basis @ (basis.T @ error)
    steps = [_choose_step([a for a in alternatives if a.name == name], whiten, basis, left) for name in declared]
    groups = _group_identical(steps)
    found = [_test_group(group, left, len(groups), declared, where) for group in groups]
    return tuple(sorted(found, key=lambda s: -measure_strength(s)))


def measure_strength(test: FaultTest) -> float:
    """Return the absolute statistic of a fault; at least 0 for one that can only be positive."""
    return max(test.statistic, 0.0) if test.name in ONE_SIDED else abs(test.statistic)


def fit_whitener(residual: FloatArray) -> Filter:
    """Return the filter that makes a residual nearly white, of signals (rows,) or (rows, columns) alike.

    It is the prediction error of an autoregressive model of order 16, by Yule and Walker, of the residual with 1 % of
    its variance added as white noise.

    Args:
        residual: (rows,), in the order of time.
    """
    from scipy.linalg import solve_toeplitz
    from scipy.signal import lfilter

    rows = residual.size
    order = min(_ORDER, rows // 4)
    products = np.array([residual[lag:] @ residual[: rows - lag] for lag in range(order + 1)]) / rows
    if not products[0] > 0:
        return lambda signals: signals
    products[0] *= 1 + _FLOOR
    weights = solve_toeplitz(products[:-1], products[1:])
    scale = math.sqrt(products[0] - weights @ products[1:])
    taps = np.concatenate([[1.0], -weights]) / scale
    return lambda signals: np.asarray(lfilter(taps, [1.0], signals, axis=0))


def _remove_regression(columns: FloatArray, signal: FloatArray) -> FloatArray:
    """Return the residual of a signal regressed on columns that may be collinear."""
    basis = _find_basis(columns)
    return np.asarray(signal - basis @ (basis.T @ signal))


def _find_basis(columns: FloatArray) -> FloatArray:
    left, sizes, _ = np.linalg.svd(columns / column_norms(columns), full_matrices=False)
    return np.asarray(left[:, sizes > _RANK * sizes[0]])


def _choose_step(shapes: Sequence[FaultSignature], whiten: Filter, basis: FloatArray, left: FloatArray) -> _Step:
    """Return the step with the shape of a fault that decreases the residual most.

    `basis`, (rows, rank), spans the other columns; `left`, (rows,), is the residual orthogonal to them.
    """
    steps = []
    for alternative in shapes:
        column = whiten(alternative.column)
        alone = column - basis @ (basis.T @ column)
        square = float(alone @ alone)
        # A column in the span of the joint's parameters is not identifiable.
        size = float(alone @ left) / square if square > _COLLINEAR * float(column @ column) else 0.0
        gain = size * size * square if size > 0 or alternative.name not in ONE_SIDED else 0.0
        steps.append(_Step(alternative, len(shapes), size, gain, alone))
    return max(steps, key=lambda step: step.gain)


def _group_identical(steps: Sequence[_Step]) -> list[list[_Step]]:
    """Return the steps in groups with collinear columns."""
    groups: list[list[_Step]] = []
    for step in sorted(steps, key=lambda step: step.alternative.name in _LAST):
        size = float(np.linalg.norm(step.alone))
        for group in groups:
            other = group[0].alone
            cosine = float(step.alone @ other) / max(size * float(np.linalg.norm(other)), np.finfo(float).tiny)
            if step.alternative.name not in ONE_SIDED and abs(cosine) > _SAME:
                group.append(step)
                break
        else:
            groups.append([step])
    return groups


def _test_group(
    group: Sequence[_Step], left: FloatArray, family: int, declared: Mapping[str, float], where: Callable[[], Cells]
) -> FaultTest:
    """Return the test of a fault by its size and the autocorrelation-robust deviation of it.

    Regressing the parts orthogonal to the other columns is the regression on all columns (Frisch and Waugh).
    """
    step = group[0]
    a, alone = step.alternative, step.alone[:, np.newaxis]
    after = left - step.size * step.alone
    covariance = robust(alone, alone, after)
    if _compute_p_value(step, float(covariance.std[0]), family) <= _WIDENED and repeatable(after, where()).significant:
        covariance = larger(covariance, by_place(alone, alone, after, where()))
    std = float(covariance.std[0])
    alike = tuple(other.alternative.name for other in group[1:])
    statistic, p_value = step.size / std if std > 0 else 0.0, _compute_p_value(step, std, family)
    return FaultTest(a.name, alike, declared[a.name], step.size, std, statistic, p_value, a.shape)


def _compute_p_value(step: _Step, std: float, family: int) -> float:
    """Return the p-value of a step, adjusted for all tests together."""
    from scipy.stats import norm

    ratio = step.size / std if std > 0 else 0.0
    tail = norm.sf(ratio) if step.alternative.name in ONE_SIDED else 2 * norm.sf(abs(ratio))
    return min(float(tail) * step.shapes * family, 1.0)
