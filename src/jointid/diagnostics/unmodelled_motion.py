"""Unmodelled dynamics: the part of a residual that the motion predicts.

The loop colours its noise, so whiteness is no test of the model; and an unmodelled spring or friction depends on more
than the position. So free responses to the simulated wind-up and speeds, and to products of them that other laws of
spring and friction would have, are fitted to the residual without every third part of the record, and predict that
part (`law_comparison.cut`). The residual is used both as it is and whitened, which shows a part that is small beside
noise of other frequencies. It correlates with the motion if the mean logarithm by which its squares fall, over the
parts, exceeds three standard errors. Linear responses alone are the coherence of residual and reference (J. S. Bendat,
A. G. Piersol, Random Data, 2010, chapter 9).

An effect that the parameters absorb is not detected: a second mode changes the stiffness, and leaves no residual.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from jointid.common.arrays import FloatArray
from jointid.common.messages import Message
from jointid.common.text import number
from jointid.diagnostics.law_comparison import TIMES, cut, mean_logarithm, squares_of
from jointid.estimation.problems.closed_loop import ClosedLoopProblem
from jointid.estimation.result.verdict import Reason, Status, Subject, Verdict
from jointid.simulation.simulate import Simulation

_LAGS = 8  # of each response ...
_MEMORY = 0.08  # s that they reach back
_RIDGES = (1e-3, 1e-1, 1.0, 10.0)  # of a column's square: the more, the less is fitted to noise, and the less is seen
_ORDER = 4  # of the filter that makes a residual white
_SURE = 3.0  # standard errors
_LITTLE = 1e-3  # of the torque: simulators and encoders differ by as much
_MUCH = 0.05  # logarithm of the ratio of squares: 2.5 % less error


@dataclass(frozen=True, slots=True)
class PredictedResidual:
    """Part of a residual that the motion predicts.

    Attributes:
        share: of the torque that is predicted in a typical held-out part.
        gain, error: mean over the parts of the logarithm by which squares fall, and its standard error.
    """

    share: float
    gain: float
    error: float

    @property
    def follows(self) -> bool:
        """True if the prediction is significant."""
        return self.gain > max(_SURE * self.error, _MUCH) and self.share > _LITTLE

    @property
    def verdict(self) -> Verdict:
        """The verdict that the residual follows the motion."""
        clause = f"{number(100 * self.share, 2)} % of the torque follows the motion and is not in the model"
        words = f"{clause}, as where spring or friction have another law: jointid diagnose --laws tells"
        values = {"share": self.share, "gain": self.gain, "std": self.error}
        reason = Message(Reason.RESIDUAL_FOLLOWS_MOTION, words, values, clause)
        return Verdict(Subject.REPEATABLE, Status.FAILED, (reason,))


def predict_residual(problem: ClosedLoopProblem, x: FloatArray) -> PredictedResidual | None:
    """Return the part of the residual of a flexible joint that its motion predicts; None for too few rows."""
    run = problem.simulate(x)
    from scipy.signal import lfilter

    if run.load_position is None or run.torque.size != problem.measured.size:
        return None
    error = problem.filter(problem.measured - run.torque)
    inputs = problem.filter(_inputs(run))
    parts = cut(problem)
    if parts is None or not np.any(error):
        return None
    columns = _responses(inputs, problem.sample_time * problem.measured.size / error.size)
    if columns is None or error.size < 2 * columns.shape[1]:
        return None
    before = np.column_stack([np.concatenate([np.zeros(lag), error[:-lag]]) for lag in range(1, _ORDER + 1)])
    taps = np.concatenate([[1.0], -np.linalg.lstsq(before, error, rcond=None)[0]])  # of the prediction error
    white = np.asarray(lfilter(taps, [1.0], error)), np.asarray(lfilter(taps, [1.0], columns, axis=0))
    sizes = problem.size, problem.size * float(np.linalg.norm(white[0]) / np.linalg.norm(error))
    seen = zip(((error, columns), white), sizes, strict=True)
    judged = [_judge(*one, parts, ridge, size) for one, size in seen for ridge in _RIDGES]
    return max(judged, key=lambda one: one.gain / one.error if one.error > 0 else 0.0)


def _judge(
    error: FloatArray, columns: FloatArray, parts: NDArray[np.intp], ridge: float, size: float
) -> PredictedResidual:
    """Return the prediction of a residual, (rows,), by columns, (rows, columns), on held-out parts."""
    products, projected = [], []
    for part in range(TIMES):
        rows = columns[parts % TIMES == part]
        products.append(rows.T @ rows)
        projected.append(rows.T @ error[parts % TIMES == part])
    predicted = np.zeros_like(error)
    for time in range(TIMES):
        kept = parts % TIMES == time
        square = np.sum(products, axis=0) - products[time]
        shrunk = square + np.diag(ridge * np.diag(square) + np.finfo(float).tiny)
        known = np.sum(projected, axis=0) - projected[time]
        predicted[kept] = columns[kept] @ np.linalg.lstsq(shrunk, known, rcond=None)[0]
    left = error - predicted
    mean, spread = mean_logarithm(squares_of(error, parts), squares_of(left, parts))
    share = math.sqrt(-math.expm1(-max(mean, 0.0))) * float(np.linalg.norm(error)) / size
    return PredictedResidual(share, mean, spread)


def _inputs(run: Simulation) -> FloatArray:
    """Return the normalised inputs of springs and frictions, (samples, inputs)."""
    assert run.load_position is not None and run.load_velocity is not None
    raw = run.motor_position - run.load_position, run.motor_velocity, run.load_velocity
    windup, motor, load = (one / (float(np.max(np.abs(one))) or 1.0) for one in raw)
    late = np.linspace(-0.5, 0.5, windup.size)
    columns = [
        windup, windup**3, np.clip(windup, -0.1, 0.1), np.clip(windup, -0.3, 0.3), np.abs(windup) * np.sign(load),
        motor, motor * np.abs(motor), np.sign(motor), np.sign(load), np.exp(-np.abs(motor) / 0.05) * np.sign(motor),
        late * motor, late * np.sign(motor),
    ]  # fmt: skip
    return np.column_stack(columns)


def _responses(inputs: FloatArray, row_time: float) -> FloatArray | None:
    """Return normalised lagged inputs, (rows, inputs * lags); None if the record is hardly longer than a response."""
    step = max(round(_MEMORY / _LAGS / row_time), 1)
    if 2 * _LAGS * step > len(inputs):
        return None
    later = [
        np.vstack([np.zeros((lag * step, inputs.shape[1])), inputs[: len(inputs) - lag * step]]) for lag in range(_LAGS)
    ]
    columns = np.column_stack([*later, np.ones(len(inputs))])
    sizes = np.sqrt(np.mean(columns**2, axis=0))
    return np.asarray(columns / np.where(sizes > 0, sizes, 1.0))
