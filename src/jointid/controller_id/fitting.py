"""Fit of one law: linear least squares, and a search (variable projection).

With e = r - q, the filtered difference v = F D q, F the velocity's filter and S a sum over time, the torque of every
law of `structures` is::

    u = T(z) (a1 e + a2 v + a3 D r + a4 F D r + a5 S e + a6 r + a7 F q + a8 w + a9 S w
              + a10 D r + a11 D D r + a12 sign(D r) + a13)

w is the record's own reference velocity, T(z) the torque's filter; a slower position loop holds e, w and the first D r,
with its sum, a6. Each law has some of the coefficients, or couples them: a cascade with an integral is
``kv (1 + ki S) (kp e + f D r - v)``, linear in ``kv kp``, ``kv f`` and ``velocity_gain`` for a given ki.

So with given filters, clocks and ki a law is linear in its gains (Golub and Pereyra 2003, Inverse Problems 19). In a
search the gains are weighted by the noise that no law explains. Laws are compared, and the numbers of the best one are
found, under the noise of their own reaction to the position, see `noise`.
"""

from __future__ import annotations

import contextlib
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from jointid.common.arrays import FloatArray, column_norms
from jointid.common.errors import MethodError
from jointid.controller_id.loop_record import LoopRecord, shift
from jointid.controller_id.noise import Noise, estimate_noise, position_response
from jointid.controller_id.structures import (
    ACCELERATION,
    COULOMB,
    FIELDS,
    INTEGRAL,
    LATE,
    VELOCITY,
    Structure,
    bounds,
    controller,
    filters_of,
    may_be_negative,
    starts,
)
from jointid.controller_id.structures import CONSTANT as BALANCE
from jointid.models.controllers import DIRECTION, INJECTED, POSITION, REFERENCE, REFERENCE_VELOCITY
from jointid.models.controllers.filters import Filter, as_filter
from jointid.uncertainty.covariance import Covariance, Influence, covariance_of, larger

_STEP, _ENOUGH = 1e-4, 1e-5  # of a filter's number, for its difference; of the cost, for the end of a search
_STEPS = 12  # of the last search, for all numbers
_HELD = 300_000  # samples of which columns are kept for other laws with the same filters
_DAMPED = 1.01 * bounds("velocity_filter.damping", 1.0, 1)[0]  # what is below has run to the bound
_LEAD = 64  # samples of straight motion before the first, in which the filters settle
_ROUNDING = 1e-14  # of the reference
_SLOPE = 5  # samples that determine that speed

_ERROR, _SPEED, _FED, _FED_FILTERED, _SUM, _COMMAND, _FILTERED, _CHANNEL, _CHANNEL_SUM, *_BESIDE = range(13)
_VISCOUS, _BENT, _SIGN, _ONE = _BESIDE
COLUMNS = 13
EVERY = np.eye(COLUMNS)


def columns(log: LoopRecord, structure: Structure, numbers: Mapping[str, float]) -> FloatArray:
    """Columns of the module's equation as logged, (samples, 13).

    `numbers` needs those of the filters and the reference's delay.
    """
    rate, period = structure.rate, log.period / structure.rate
    lead, slope = _LEAD * rate, _SLOPE * rate
    inputs = log.inputs(rate, structure.interpolation, structure.average)
    r, q = (_prepend_line(inputs[:, i] - inputs[0, POSITION], lead, slope) for i in (REFERENCE, POSITION))
    r = _delay(r, numbers.get("reference_delay", 0.0) / period)
    velocity, torque = filters_of(structure, numbers)
    speed = _differentiate(_filter_signals(velocity, np.column_stack([q, r]), period), period)
    e, fed = r - q, _differentiate(r, period)
    w, direction = (np.concatenate([np.full(lead, x[0]), x]) for x in inputs[:, [REFERENCE_VELOCITY, DIRECTION]].T)
    w, direction = (_delay(one, numbers.get("reference_delay", 0.0) / period) for one in (w, direction))
    viscous, bent = fed, _differentiate(fed, period)
    # Between two samples that lines join nothing is bent: what is left is rounding, and must not be a column.
    bent[np.abs(bent) < _ROUNDING * np.max(np.abs(r)) / period**2] = 0.0
    if structure.every > 1:  # the lead is a whole number of the slower loop's periods
        at = np.arange(r.size)
        last = np.maximum(at - (at - structure.offset) % structure.every, 0)
        fed = (r[last] - r[np.maximum(last - structure.every, 0)]) / (structure.every * period)
        e, w = e[last], w[last]
    e_sum, fed_sum, speed_sum, w_sum = (_running_sum(one, lead) * period for one in (e, fed, speed[:, 0], w))
    found = np.column_stack([
        e, speed[:, 0], fed, speed[:, 1], e_sum, fed_sum, speed_sum, w, w_sum,
        viscous, bent, direction, np.ones(r.size),
    ])  # fmt: skip
    return log.to_log(_filter_signals(torque, found, period)[lead:], rate)


def injected_torque(log: LoopRecord, structure: Structure, numbers: Mapping[str, float]) -> FloatArray:
    """Torque injected before the limit, as logged, (samples, 1)."""
    rate, (_, torque) = structure.rate, filters_of(structure, numbers)
    signal = log.inputs(rate, structure.interpolation)[:, [INJECTED]]
    return log.to_log(_filter_signals(torque, signal, log.period / rate), rate)


def coefficient_columns(structure: Structure, ki: float) -> dict[str, FloatArray]:
    """Combination of all columns that each gain of a law multiplies."""
    inner = ki if structure.cascade else 0.0
    fed = {"channel": EVERY[_CHANNEL] + inner * EVERY[_CHANNEL_SUM]}.get(
        structure.reference_velocity, EVERY[_FED] + inner * EVERY[_COMMAND]
    )
    speed = -EVERY[_SPEED] - inner * EVERY[_FILTERED]
    parts = {"position_gain": EVERY[_ERROR] + inner * EVERY[_SUM]}
    if structure.cascade:
        parts["velocity_gain"] = speed + (fed if structure.reference_velocity == "full" else 0.0)
        if structure.reference_velocity in ("share", "channel"):
            parts["velocity_feedforward"] = fed
    else:
        own = {"difference": EVERY[_FED_FILTERED], "channel": EVERY[_CHANNEL]}
        parts["derivative_gain"] = speed + own.get(structure.reference_velocity, 0.0)
        if structure.integrates:
            parts["integral_gain"] = EVERY[_SUM]
    beside = {VELOCITY: _VISCOUS, ACCELERATION: _BENT, COULOMB: _SIGN, BALANCE: _ONE}
    parts |= {FIELDS[name]: EVERY[i] for name, i in beside.items() if name in structure.feedforward}
    return parts | ({INTEGRAL: EVERY[_ONE]} if structure.integrates else {})


def law_coefficients(structure: Structure, numbers: Mapping[str, float]) -> FloatArray:
    """Coefficients of a law with its numbers, (COLUMNS,)."""
    known = dict(numbers)
    if structure.cascade:
        known["position_gain"] *= known["velocity_gain"]
        known["velocity_feedforward"] = known["velocity_gain"] * known.get("velocity_feedforward", 0.0)
    parts = coefficient_columns(structure, known.get("integral_gain", 0.0))
    return np.asarray(sum(known[name] * part for name, part in parts.items()))


def _prepend_line(signal: FloatArray, lead: int, slope: int) -> FloatArray:
    """Extrapolate a signal backwards by a straight line."""
    rate = (signal[slope] - signal[0]) / slope
    return np.concatenate([signal[0] + rate * np.arange(-lead, 0), signal])


def _delay(signal: FloatArray, periods: float) -> FloatArray:
    at = np.arange(signal.size)
    return np.asarray(np.interp(at - periods, at, signal)) if periods else signal


def _differentiate(signal: FloatArray, period: float) -> FloatArray:
    return np.asarray(np.diff(signal, axis=0, prepend=signal[:1]) / period)


def _running_sum(signal: FloatArray, lead: int) -> FloatArray:
    """Sum of earlier values from the first sample on."""
    sums = np.concatenate([[0.0], np.cumsum(signal[:-1])])
    return np.asarray(sums - sums[lead])


def _filter_signals(one: Filter | Sequence[float], signals: FloatArray, period: float) -> FloatArray:
    """Filter signals, (periods, signals), from the steady state of their first values."""
    from scipy.signal import lfilter, lfilter_zi

    b, a = as_filter(one).coefficients(period)
    if len(b) == len(a) == 1:
        return np.asarray(signals * (b[0] / a[0]))
    settled = lfilter_zi(b, a)[:, np.newaxis] * signals[:1]
    return np.asarray(lfilter(b, a, signals, axis=0, zi=settled)[0])


@dataclass(frozen=True, eq=False)
class FittedLaw:
    """A structure with numbers.

    Attributes:
        log: that it is fitted to.
        numbers: by the structure's names, in torque.
        coefficients: of all `columns`.
        residual: (frequencies,) the real transform of the torque that the law leaves, scaled to a periodogram.
    """

    log: LoopRecord
    structure: Structure
    numbers: dict[str, float]
    coefficients: FloatArray
    residual: NDArray[np.complex128]

    @cached_property
    def response(self) -> FloatArray:
        """Gain from position to torque, times the position error's shape, (frequencies,)."""
        log, feedback = self.log, {name: x for name, x in self.numbers.items() if not name.endswith("feedforward")}
        law = controller(self.structure, feedback, log.period, 1.0).law(log.period)
        return position_response(law.feedback, log.period, log.samples, self.structure.rate) * log.error.shape

    @cached_property
    def noise(self) -> Noise:
        """Noise that explains the residual."""
        log, power = self.log, np.abs(self.residual) ** 2
        return estimate_noise(power, self.response, float(np.mean(log.torque**2)), log.error.most, log.informative)

    def whiten(self, noise: Noise) -> NDArray[np.complex128]:
        """Residual made white by a noise, (frequencies,)."""
        return np.asarray(self.residual * noise.weights(self.response if noise.position else np.zeros(1)))

    def score(self, noise: Noise) -> float:
        """Schwarz's criterion; a difference of ten means odds of exp(-5) to 1."""
        cost = float(np.linalg.norm(self.whiten(noise))) ** 2
        return noise.rows * math.log(max(cost, 1e-300)) + self.structure.weight(noise.rows)


class Fitter:
    """Fits laws to a record.

    Attributes:
        log: the record.
        kept: (samples,) 1 where the torque counts: not at the begin, nor at a limit, with any delay of the log.
        shared: the noise by which the gains of all laws are weighted.
    """

    def __init__(self, log: LoopRecord, late: tuple[int, ...] = (0, *LATE)) -> None:
        """Take a record and admissible log delays; weight all frequencies equally."""
        self.log, self._late, self.kept = log, late, np.ones(log.samples)
        for n in late:
            self.kept *= shift(log.free, -n)
            self.kept[log.samples - n :] = 0.0
        self.shared = Noise(1.0, 0.0, log.informative)
        self._held: dict[tuple[object, ...], tuple[NDArray[np.complex128], FloatArray]] = {}

    def share(self, one: FittedLaw) -> None:
        """Weight all gains by the noise of one law."""
        self.shared = Noise(1.0, 0.0, one.noise.weights(one.response))
        self._held.clear()

    def fit(self, structure: Structure, known: Mapping[str, float], noise: Noise, evaluations: int) -> FittedLaw | None:
        """Fit a law from the best of its starts; None if impossible.

        `known` has numbers of a similar law for the starts. `evaluations` limits the nonlinear search; 0 skips it.
        """
        tried = []
        for numbers in starts(structure, known, self.log.period):
            with contextlib.suppress(MethodError):  # a filter that cannot be at this rate
                tried.append((self.solve(structure, numbers), numbers))
        if not tried:
            return None
        start, numbers = min(tried, key=lambda one: one[0].score(noise))
        if not numbers or not evaluations:
            return start
        found, *_ = self._search(
            self.solve, structure, numbers, noise, max_nfev=evaluations, ftol=_ENOUGH, diff_step=_STEP
        )
        undamped = any(name.endswith("damping") and value < _DAMPED for name, value in found.items())
        return None if undamped else self.solve(structure, found)

    def solve(self, structure: Structure, numbers: Mapping[str, float]) -> FittedLaw:
        """Solve non-negative least squares for a law's gains, filters and delays given.

        Raises:
            MethodError: a filter cannot be at this rate.
        """
        from scipy.optimize import nnls

        _, R = self._columns(structure, numbers)
        parts = coefficient_columns(structure, numbers.get("integral_gain", 0.0))
        mixed = np.column_stack(list(parts.values()))
        free = [i for i, name in enumerate(parts) if may_be_negative(name)]
        A = R[:, :COLUMNS] @ np.column_stack([mixed, -mixed[:, free]])
        scale = column_norms(A)
        gains = nnls(A / scale, R[:, COLUMNS + self._late.index(structure.late)])[0] / scale
        gains[free] -= gains[len(parts) :]
        found = {**numbers, **dict(zip(parts, map(float, gains), strict=False))}
        if structure.cascade:
            rate = found["velocity_gain"] = max(found["velocity_gain"], 1e-12 * found["position_gain"], 1e-300)
            found["position_gain"] /= rate
            if "velocity_feedforward" in found:
                found["velocity_feedforward"] /= rate
        return self.law(structure, {name: found[name] for name in structure.names})

    def law(self, structure: Structure, numbers: Mapping[str, float]) -> FittedLaw:
        """Evaluate a law with given numbers, and its residual."""
        Z, _ = self._columns(structure, numbers)
        coefficients = law_coefficients(structure, numbers)
        residual = Z[:, COLUMNS + self._late.index(structure.late)] - Z[:, :COLUMNS] @ coefficients
        return FittedLaw(self.log, structure, dict(numbers), coefficients, residual)

    def finish(self, one: FittedLaw) -> tuple[FittedLaw, Covariance]:
        """Fit all numbers of a law under its own noise, with covariance.

        The covariance is robust against remaining colour and unequal variance.
        """
        fitter = Fitter(self.log, (one.structure.late,))
        one = fitter.law(one.structure, order_rates(one, self.log.period))
        for _ in range(2):  # the noise follows the law
            found, J, white = fitter._search(fitter.law, one.structure, one.numbers, one.noise, max_nfev=_STEPS)
            one = fitter.law(one.structure, found)
        seen = Influence(J, white)
        # Quantisation noise is largest at slow motion, where the signal is: unequal over frequencies (White 1980).
        moved = seen.by_frequency()
        return one, larger(seen.robust(), covariance_of(moved.T @ moved))

    def predict(self, one: FittedLaw) -> FloatArray:
        """Torque of a law, (samples,), as logged, without limit."""
        log, structure = self.log, one.structure
        shown = columns(log, structure, one.numbers) @ one.coefficients
        shown = shown + log.added + injected_torque(log, structure, one.numbers)[:, 0]
        return shift(shown, structure.late) - log.added

    def _columns(self, structure: Structure, numbers: Mapping[str, float]) -> tuple[NDArray[np.complex128], FloatArray]:
        """Transform of columns and torques, and their whitened triangular factor.

        The torques are advanced by each admissible delay of the log.
        """
        own = {name: value for name, value in numbers.items() if "." in name or name == "reference_delay"}
        key = (structure.frame, tuple(own.items()))
        if key not in self._held:
            if len(self._held) >= max(_HELD // self.log.samples, 2):
                self._held.clear()
            added = self.log.added
            X, known = columns(self.log, structure, own), injected_torque(self.log, structure, own)
            torques = [shift(self.log.torque + added, -n) - added - known[:, 0] for n in self._late]
            Z = np.fft.rfft(np.column_stack([X, *torques]) * self.kept[:, np.newaxis], axis=0)
            Z /= math.sqrt(float(np.sum(self.kept)))
            weights = self.shared.weights(np.zeros(len(Z)))
            white = Z[weights > 0] * weights[weights > 0, np.newaxis]
            rows = np.concatenate([white.real, white.imag])
            norms = column_norms(rows)
            self._held[key] = Z, np.asarray(np.linalg.qr(rows / norms, mode="r") * norms)
        return self._held[key]

    def _search(
        self,
        make: Callable[[Structure, dict[str, float]], FittedLaw],
        structure: Structure,
        numbers: Mapping[str, float],
        noise: Noise,
        **options: Any,
    ) -> tuple[dict[str, float], FloatArray, FloatArray]:
        """Minimise a law's whitened residual; return numbers, sensitivities and residual over time.

        `make` builds a law from numbers, and may solve for its gains; `options` are of `least_squares`.
        """
        from scipy.optimize import least_squares  # itself: a search takes a few steps from each of hundreds of starts

        period, force = self.log.period, float(np.std(self.log.torque))
        least = {
            INTEGRAL: force, "constant_feedforward": force, "depth": 0.3, "integral_gain": 1e-3 / period,
            "reference_delay": 0.1 * period,
        }  # fmt: skip
        sizes = np.array([abs(v) or 1.0 for v in numbers.values()])
        sizes = np.maximum(sizes, [least.get(name.rpartition(".")[2], 0.0) for name in numbers])
        low, high = np.array([bounds(name, period, structure.rate) for name in numbers]).T / sizes

        def white(x: FloatArray) -> FloatArray:
            law = make(structure, dict(zip(numbers, map(float, x * sizes), strict=True)))
            return np.fft.irfft(law.whiten(noise), self.log.samples)

        x = np.clip(np.array(list(numbers.values())) / sizes, low + 1e-6, high - 1e-6)
        end = least_squares(white, x, bounds=(low, high), **options)
        return dict(zip(numbers, map(float, end.x * sizes), strict=True)), -end.jac / sizes, end.fun


def order_rates(one: FittedLaw, period: float) -> dict[str, float]:
    """Order the rates of a P-PI, the larger one as kp.

    kp and ki are the two roots of one equation, for ``kv (kp + ki)``, ``kv (1 - ki T)`` and ``kv kp ki``; exchanging
    them gives the same law with another kv. Position loops are usually the faster ones.
    """
    structure, known, period = one.structure, one.numbers, period / one.structure.rate
    like = replace(structure, law="P-PI", reference_velocity="full", velocity_filter="none", every=1)
    if structure != like or known["position_gain"] >= known["integral_gain"]:
        return known
    kp, kv, ki = (known[name] for name in ("position_gain", "velocity_gain", "integral_gain"))
    # What the other root is follows from the product and the sum of both, each with its own kv.
    proportional, slope, integral = kv * (kp + ki), kv * (1.0 - ki * period), kv * kp * ki
    other = integral / ((slope + proportional * period) * ki)
    gain = slope / (1.0 - other * period)
    return known | {"position_gain": integral / (gain * other), "velocity_gain": gain, "integral_gain": other}
