"""Regressions on a law's columns for given filters and clocks (variable projection).

Only filter numbers, the ki of a cascade and a delay are searched (Golub and Pereyra 2003, Inverse Problems 19). Free
coefficients give the minimum over all laws, so that filters and clocks can be compared before laws.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from jointid.common.arrays import FloatArray, column_norms
from jointid.controller_id.columns import coefficient_columns, columns, design, injected_torque, response
from jointid.controller_id.loop_record import LoopRecord
from jointid.controller_id.noise import Noise, estimate_noise, lagged_columns, regress, signal_and_past
from jointid.controller_id.structures import INTERPOLATIONS, LATE, NumberedStructure, Structure, bounds
from jointid.models.controllers import DIRECTION, INJECTED, POSITION, REFERENCE, REFERENCE_VELOCITY

_DEPENDENT = 1e-9  # of a column: what is left of it beside the others is rounding
_STEP = 1e-4  # of a number, for its difference
_EVALUATIONS = 6  # of a search for filters' numbers: the law is fitted exactly later


class Weighting(NamedTuple):
    """Noise and response that weight a regression.

    Attributes:
        response: |G| of the law that it is the noise of, by which a regression is weighted.
    """

    noise: Noise
    response: FloatArray

    @property
    def weights(self) -> FloatArray:
        """One over the square root of the noise spectrum, 0 where excluded."""
        return self.noise.weights(self.response)


@dataclass(frozen=True, slots=True, eq=False)
class RegressionFit(NumberedStructure):
    """Regression of a structure or a frame of clocks and filters on the torque.

    Attributes:
        gains: the regression's coefficients, in torque.
        response: |G| of what was found, at the frequencies of the real transform.
        residual: (samples,) what is left.
    """

    gains: FloatArray
    response: FloatArray
    residual: FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class CompressedFrame:
    """A frame's columns, derivatives and torque, rotated into few rows.

    Attributes:
        numbers: of the filters, where they were worked out.
        blocks: (rows, columns) the columns, and their derivative by each number.
        targets: (rows, delays) the torque.
        late: the log's delays.
    """

    numbers: dict[str, float]
    blocks: tuple[FloatArray, ...]
    targets: FloatArray
    late: tuple[int, ...]

    def costs(self, structure: Structure, ki: float | None) -> FloatArray:
        """Cost of a law after one Gauss-Newton step, for each delay."""
        mixed = design(structure, ki or 0.0)
        X, moves = self.blocks[0] @ mixed, [block @ mixed for block in self.blocks[1:]]
        if ki:
            moves.append(self.blocks[0] @ (design(structure, 2.0 * ki) - mixed) / ki)
        scale = column_norms(X)
        gains = np.linalg.lstsq(X / scale, self.targets, rcond=_DEPENDENT)[0] / scale[:, np.newaxis]
        costs = np.empty(len(self.late))
        for i, target in enumerate(self.targets.T):
            full = np.column_stack([X, *(move @ gains[:, i] for move in moves)])
            full = full / column_norms(full)
            left = target - full @ np.linalg.lstsq(full, target, rcond=_DEPENDENT)[0]
            costs[i] = left @ left
        return costs


@dataclass(frozen=True, slots=True, eq=False)
class Regression:
    """The regression on a record's stretch.

    Attributes:
        kept: (samples,) 1 where the torque counts: not at the begin, nor at a limit.
        own: whether a law's cost is under its own response, or under that which the regression is weighted by.
    """

    log: LoopRecord
    kept: FloatArray
    own: bool = False

    def weighting(self, one: RegressionFit) -> Weighting:
        """Noise that explains a fit's residual, with its law."""
        log = self.log
        noise = estimate_noise(one.residual, one.response, log.torque, self.kept, log.error.most, log.informative)
        return Weighting(noise, one.response)

    def fit_gains(
        self,
        structure: Structure,
        numbers: Mapping[str, float],
        weighting: Weighting,
        late: Sequence[int] | None = None,
        free: bool = True,
    ) -> list[RegressionFit]:
        """Regress the torque with given filters, for several delays of the log.

        Args:
            structure: of the law.
            numbers: of filters, ki and delay.
            weighting: of the residual.
            late: delays of the logged torque in samples; those of the structure when None.
            free: whether all coefficients are free.
        """
        late = [structure.late] if late is None else late
        mixed = design(structure, numbers.get("integral_gain", 0.0), free)
        X = (columns(self.log, structure, numbers) @ mixed) * self.kept[:, np.newaxis]
        Y = self._targets(structure, numbers, late)
        scale = column_norms(X)
        seen, wanted = (_whiten(one, weighting.weights) for one in (X / scale, Y))
        coefficients = np.linalg.lstsq(seen, wanted, rcond=_DEPENDENT)[0] / scale[:, np.newaxis]
        multiples, residuals = mixed @ coefficients, Y - X @ coefficients
        found = []
        for i, n in enumerate(late):
            gains = multiples[:, i]
            magnitude = response(self.log, structure, numbers, gains)
            spectrum = np.fft.rfft(residuals[:, i]) * self._weights(weighting, magnitude)
            cost = float(np.linalg.norm(np.fft.irfft(spectrum, self.log.samples)) ** 2)
            like = replace(structure, late=n)
            found.append(RegressionFit(like, dict(numbers), cost, gains, magnitude, residuals[:, i]))
        return found

    def compress(
        self, frame: Structure, numbers: Mapping[str, float], weighting: Weighting, late: Sequence[int]
    ) -> CompressedFrame:
        """Compress a frame's columns to the triangle of a QR decomposition.

        Args:
            frame: clocks and filters.
            numbers: of the filters, and of the reference's delay where the laws have one.
            weighting: of the residual.
            late: possible delays of the logged torque, in samples.
        """
        base = columns(self.log, frame, numbers)
        blocks = [base]
        for name, value in numbers.items():
            step = _STEP * max(value, _smallest_scale(name, self.log.period))
            blocks.append((columns(self.log, frame, {**numbers, name: value + step}) - base) / step)
        stacked = np.hstack([*blocks, self._targets(frame, numbers, late)]) * self.kept[:, np.newaxis]
        scale = column_norms(stacked)
        triangle: FloatArray = np.asarray(np.linalg.qr(_whiten(stacked / scale, weighting.weights), mode="r"))
        triangle = triangle * (scale * math.sqrt(2.0 / self.log.samples))
        width = base.shape[1]
        split = [triangle[:, i : i + width] for i in range(0, width * len(blocks), width)]
        return CompressedFrame(dict(numbers), tuple(split), triangle[:, width * len(blocks) :], tuple(late))

    def refine(
        self, one: RegressionFit, weighting: Weighting, free: bool = True, evaluations: int = _EVALUATIONS
    ) -> RegressionFit:
        """Optimise a structure's nonlinear numbers; `free` as in `fit_gains`."""
        from scipy.optimize import least_squares  # itself: `solvers` search for an end, and this stops long before

        initial = one.numbers
        names = list(initial)
        low, high = np.array([bounds(n, self.log.period, one.structure.rate) for n in names]).reshape(-1, 2).T

        def fit_gains(x: FloatArray) -> RegressionFit:
            numbers = dict(zip(names, map(float, x), strict=True))
            return self.fit_gains(one.structure, numbers, weighting, free=free)[0]

        def white(x: FloatArray) -> FloatArray:
            found = fit_gains(x)
            return _stack(np.fft.rfft(found.residual) * self._weights(weighting, found.response))

        start = np.array(list(initial.values()))
        if not names:
            return fit_gains(start)
        sizes = np.maximum(start, [_smallest_scale(name, self.log.period) for name in names])
        inside = np.clip(start, low + 1e-6 * sizes, np.where(np.isfinite(high), high - 1e-6 * sizes, high))
        found = least_squares(
            white, inside, bounds=(low, high), x_scale=sizes, diff_step=np.full(start.size, _STEP),
            max_nfev=evaluations, ftol=1e-5,
        )  # fmt: skip
        return fit_gains(found.x)

    def _targets(self, structure: Structure, numbers: Mapping[str, float], late: Sequence[int]) -> FloatArray:
        """Advanced torques, (samples, delays), so that columns serve all delays."""
        added = self.log.added
        known = injected_torque(self.log, structure, numbers)
        moved = [_advance(self.log.torque + added, n) - added for n in late]
        return np.asarray((np.column_stack(moved) - known) * self.kept[:, np.newaxis])

    def _weights(self, weighting: Weighting, response: FloatArray) -> FloatArray:
        return weighting.noise.weights(response) if self.own else weighting.weights


def regression(log: LoopRecord) -> Regression:
    """Return the regression on a record's stretch."""
    free, kept = log.free, log.free
    for n in LATE:  # the same rows for every delay
        kept = kept * _advance(free, n)
    kept[-max(LATE) :] = 0.0
    return Regression(log, kept)


def initial_weighting(regression: Regression) -> Weighting:
    """Initial weighting: all informative frequencies alike."""
    log = regression.log
    return Weighting(Noise(float(np.var(log.torque)), 0.0, log.informative), np.ones(log.samples // 2 + 1))


def law_numbers(one: RegressionFit, gain: float) -> dict[str, float]:
    """Numbers of a law from its regression; `gain` is torque per controller unit."""
    structure, ki = one.structure, one.numbers.get("integral_gain", 0.0)
    parts = coefficient_columns(structure, ki)
    values = np.linalg.lstsq(np.column_stack(list(parts.values())), one.gains / gain, rcond=None)[0]
    found = one.numbers | dict(zip(parts, map(float, values), strict=True))
    if structure.cascade:
        size = max(abs(found["velocity_gain"]), 1e-12 * abs(found["position_gain"]), 1e-300)
        found |= {
            "position_gain": found["position_gain"] / size,
            "velocity_gain": math.copysign(size, found["velocity_gain"]),
        }
        if "velocity_feedforward" in found:
            found["velocity_feedforward"] /= size
    return {name: found.get(name, 0.0) for name in structure.names if name != "limit"}


def _advance(signal: FloatArray, samples: int) -> FloatArray:
    return np.concatenate([signal[samples:], np.full(samples, signal[-1])])


def _smallest_scale(name: str, sample_time: float) -> float:
    """Smallest scale of a parameter, for values near 0."""
    last = name.rpartition(".")[2]
    return {"depth": 0.3, "integral_gain": 1e-3 / sample_time, "reference_delay": 0.1 * sample_time}.get(last, 0.0)


def _whiten(X: FloatArray, weights: FloatArray) -> FloatArray:
    informative = weights > 0
    return _stack(np.fft.rfft(X, axis=0)[informative] * weights[informative, np.newaxis])


def _stack(spectrum: NDArray[np.complex128]) -> FloatArray:
    return np.concatenate([spectrum.real, spectrum.imag])


LAGS = 16  # samples of reference and position
_BESIDE = 4  # samples of what else a law reads
_MUCH = 3.0  # times what the regression leaves, in rms: an F of 9, of hundreds of rows
_MATERIAL = 2e-3  # of the torque's rms: a law that leaves less is good enough for whatever it is needed for


@dataclass(frozen=True, slots=True)
class BesideRegression:
    """Residual of a law compared with that of a plain regression.

    Attributes:
        law: share of the torque's rms that the law leaves.
        regression: that the regression leaves.
    """

    law: float
    regression: float

    @property
    def another(self) -> bool:
        """True if the drive's law is another."""
        return self.law > max(_MUCH * self.regression, _MATERIAL)


def compare_with_regression(log: LoopRecord, residual: FloatArray) -> BesideRegression:
    """Compare a law's residual with a plain regression.

    Only samples within the limit and informative frequencies count; elsewhere the position error dominates.

    Args:
        log: the record.
        residual: (samples,) logged less the law's torque.
    """
    inputs, kept = log.inputs(1, INTERPOLATIONS[0]), log.free
    r, q = (inputs[:, i] - inputs[0, REFERENCE] for i in (REFERENCE, POSITION))
    asked = [np.ones((r.size, 1)), np.cumsum(r - q)[:, np.newaxis], *signal_and_past(r, LAGS)]
    beside = (inputs[:, DIRECTION], inputs[:, REFERENCE_VELOCITY], inputs[:, INJECTED], log.added)
    asked += [lagged_columns(one, _BESIDE) for one in beside if np.ptp(one)]
    _, left = regress(asked, signal_and_past(q, LAGS), log.torque, kept)
    size = math.sqrt(float(np.mean((log.torque * kept) ** 2))) or 1.0
    informative = np.fft.rfft(np.column_stack([residual, left]) * kept[:, np.newaxis], axis=0)
    informative *= (log.informative > 0)[:, np.newaxis]
    rms = np.sqrt(np.mean(np.fft.irfft(informative, log.samples, axis=0) ** 2, axis=0))
    return BesideRegression(*(float(one) / size for one in rms))
