"""Fit of one law: gains by linear least squares, its other numbers by a search (variable projection).

With given filters, clocks and ki of a cascade a law is linear in its gains (Golub and Pereyra 2003, Inverse Problems
19). In a search the gains are weighted by the noise that no law explains. Laws are compared, and the numbers of the
best one are found, under the noise of their own reaction to the position, see `noise`.
"""

from __future__ import annotations

import contextlib
import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from jointid.common.arrays import FloatArray, column_norms
from jointid.common.errors import MethodError
from jointid.controller_id.columns import COLUMNS, coefficient_columns, columns, injected_torque, law_coefficients
from jointid.controller_id.loop_record import LoopRecord, shift
from jointid.controller_id.noise import Noise, estimate_noise, position_response
from jointid.controller_id.structures import INTEGRAL, LATE, Structure, bounds, controller, may_be_negative, starts
from jointid.uncertainty.covariance import Covariance, Influence, covariance_of, larger

_STEP, _ENOUGH = 1e-4, 1e-5  # of a filter's number, for its difference; of the cost, for the end of a search
_STEPS = 12  # of the last search, for all numbers
_HELD = 300_000  # samples of which columns are kept for other laws with the same filters
_DAMPED = 1.01 * bounds("velocity_filter.damping", 1.0, 1)[0]  # what is below has run to the bound


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
        """|G| from position to torque, times the shape of the position's error, (frequencies,)."""
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
        """Take a record, and the delays of its log that laws may have; all frequencies weigh alike."""
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
        """Fit a law from the best of its starts, and from what is known of a similar one; None if it is impossible.

        The numbers that the torque is not linear in take so many evaluations; with 0 they are those of the start.
        """
        tried = []
        for numbers in starts(structure, known, self.log.period):
            with contextlib.suppress(MethodError):  # a filter that cannot be at this rate
                tried.append((self.solve(structure, numbers), numbers))
        if not tried:
            return None
        begun, numbers = min(tried, key=lambda one: one[0].score(noise))
        if not numbers or not evaluations:
            return begun
        found, *_ = self._search(
            self.solve, structure, numbers, noise, max_nfev=evaluations, ftol=_ENOUGH, diff_step=_STEP
        )
        undamped = any(name.endswith("damping") and value < _DAMPED for name, value in found.items())
        return None if undamped else self.solve(structure, found)

    def solve(self, structure: Structure, numbers: Mapping[str, float]) -> FittedLaw:
        """Solve for a law's gains, none negative, with given filters, ki of a cascade and delay.

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
        """Return a law with given numbers, and what it leaves."""
        Z, _ = self._columns(structure, numbers)
        coefficients = law_coefficients(structure, numbers)
        residual = Z[:, COLUMNS + self._late.index(structure.late)] - Z[:, :COLUMNS] @ coefficients
        return FittedLaw(self.log, structure, dict(numbers), coefficients, residual)

    def finish(self, one: FittedLaw) -> tuple[FittedLaw, Covariance]:
        """Fit all numbers of a law under its own noise; return it with their covariance.

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
        """Transform of columns and torques, and the triangle of both when whitened, of the structure's filters.

        The torques are those less 0, 1, ... samples late.
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
        """Minimise a law's whitened residual over numbers; return them, with sensitivities and residual over time.

        `make` returns a law, with its gains from the others or with all numbers; `options` are of `least_squares`.
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
    """Numbers of a P-PI on the full reference velocity with the larger rate as kp; those of other laws stay.

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
