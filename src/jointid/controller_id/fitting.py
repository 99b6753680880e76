"""Fit of one structure: Gauss-Newton on the whitened residual, and covariance.

`solvers` is not used, since a search makes a few bounded steps from each of hundreds of starts.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from jointid.common.arrays import FloatArray, column_norms
from jointid.common.errors import MethodError
from jointid.common.parameters import Bounds
from jointid.controller_id.columns import law_coefficients, response
from jointid.controller_id.loop_record import LoopRecord
from jointid.controller_id.noise import Noise, estimate_noise
from jointid.controller_id.structures import INTEGRAL, NumberedStructure, Structure, bounds, controller
from jointid.models.controllers import Controller, SampledLaw
from jointid.uncertainty.covariance import Covariance, covariance_of, larger, robust

_STEP = 1e-5  # of a number, for its difference
_ENOUGH = 1e-7  # of the cost: a smaller improvement ends the search
_SHARES = 0.25 ** np.arange(6)  # of a step, one after the other, until one goes down


@dataclass(frozen=True, slots=True, eq=False)
class FittedLaw(NumberedStructure):
    """A structure with numbers, and the `noise` that whitened its residual."""

    noise: Noise


@dataclass(frozen=True, slots=True, eq=False)
class Task:
    """A record and the gain of the drive's chain."""

    log: LoopRecord
    gain: float

    def select_strongest(self, samples: int) -> Task:
        """Restrict the task to the samples with the strongest reference acceleration."""
        return Task(self.log.select_strongest(samples), self.gain)

    def controller(self, structure: Structure, numbers: Mapping[str, float]) -> Controller:
        """Return a law."""
        return controller(structure, numbers, self.log.period, self.gain)

    def law(self, structure: Structure, numbers: Mapping[str, float]) -> SampledLaw:
        """Return a law as it is run."""
        return self.controller(structure, numbers).law(self.log.period)

    def residual(self, structure: Structure, numbers: Mapping[str, float]) -> FloatArray:
        """Logged less predicted torque, (samples,), 0 where excluded."""
        law = self.law(structure, numbers)
        predicted = self.log.predict(
            law, numbers.get(INTEGRAL, 0.0) * self.gain, structure.interpolation, structure.average
        )
        return (self.log.torque - predicted) * self.log.kept

    def response(self, structure: Structure, numbers: Mapping[str, float]) -> FloatArray:
        """Magnitude of a law's response to the position."""
        return response(self.log, structure, numbers, law_coefficients(structure, numbers, self.gain))

    def whiten(self, structure: Structure, numbers: Mapping[str, float], noise: Noise) -> FloatArray:
        """Return the residual made white by a noise, (samples,)."""
        error = self.residual(structure, numbers)
        seen = self.response(structure, numbers) if noise.position else np.zeros(error.size // 2 + 1)
        return np.fft.irfft(np.fft.rfft(error) * noise.weights(seen), error.size)

    def noise(self, structure: Structure, numbers: Mapping[str, float]) -> Noise:
        """Noise that explains a law's residual."""
        log, left = self.log, self.residual(structure, numbers)
        heard = self.response(structure, numbers)
        return estimate_noise(left, heard, log.torque, log.kept, log.error.most, log.informative)

    def slopes(self, structure: Structure, x: FloatArray, base: FloatArray, noise: Noise) -> FloatArray:
        """Derivatives of the whitened residual by differences, (samples, numbers)."""
        names, period = structure.names, self.log.period
        J = np.empty((base.size, x.size))
        for i, name in enumerate(names):
            high = bounds(name, period, structure.rate)[1]
            step = _STEP * max(abs(x[i]), self._size(name, x, names))
            step = -step if x[i] + step > high else step
            moved = x.copy()
            moved[i] += step
            J[:, i] = (self.whiten(structure, dict(zip(names, moved, strict=True)), noise) - base) / step
        return J

    def _size(self, name: str, x: FloatArray, names: tuple[str, ...]) -> float:
        """Scale of a parameter's difference step."""
        period, cascade = self.log.period, names[1] == "velocity_gain"
        gain = abs(float(x[0] * x[1] if cascade else x[0])) or 1.0  # controller units per m
        rate = abs(float(x[1])) or gain * period  # controller units per m/s
        force = float(np.max(np.abs(self.log.torque))) / self.gain
        sizes = {
            INTEGRAL: force, "constant_feedforward": force, "coulomb_feedforward": force, "limit": force,
            "derivative_gain": rate, "velocity_gain": rate, "viscous_feedforward": rate, "acceleration_feedforward":
            1e-2 * rate,
            "time_constant": period, "reference_delay": period, "frequency": 1e-2 / period, "bandwidth": 1e-2 / period,
        }  # fmt: skip
        return sizes.get(name.rpartition(".")[2], 1.0 if cascade or not name.startswith("k") else gain)


def fit(task: Task, structure: Structure, start: Mapping[str, float], noise: Noise, steps: int = 8) -> FittedLaw | None:
    """Fit a structure's numbers near a start; None if impossible or divergent."""
    names, period = structure.names, task.log.period
    limits = Bounds(*np.array([bounds(name, period, structure.rate) for name in names]).T)
    x = limits.clip(np.array([start[name] for name in names], dtype=np.float64))

    def whiten(x: FloatArray) -> FloatArray:
        return task.whiten(structure, dict(zip(names, x, strict=True)), noise)

    try:
        white = whiten(x)
        cost = float(white @ white)
        for _ in range(steps):
            before = cost
            change = _gauss_newton_step(task.slopes(structure, x, white, noise), white, x, limits)
            for share in _SHARES:
                tried = limits.clip(x + share * change)
                after = whiten(tried)
                if (new := float(after @ after)) < cost:
                    x, white, cost = tried, after, new
                    break
            if not math.isfinite(cost):
                return None
            if before - cost <= _ENOUGH * before:
                break
    except MethodError:
        return None
    return FittedLaw(structure, dict(zip(names, map(float, x), strict=True)), cost, noise)


def order_rates(task: Task, one: FittedLaw) -> FittedLaw:
    """Return a P-PI on the full reference velocity with the larger rate as kp.

    kp and ki are the two roots of one equation, for ``kv (kp + ki)``, ``kv (1 - ki T)`` and ``kv kp ki``; exchanging
    them gives the same law with another kv. Position loops are usually the faster ones. Other laws stay.
    """
    structure, known, period = one.structure, one.numbers, task.log.period / one.structure.rate
    like = replace(structure, law="P-PI", reference_velocity="full", velocity_filter="none", every=1)
    if structure != like or known["position_gain"] >= known["integral_gain"]:
        return one
    kp, kv, ki = (known[name] for name in ("position_gain", "velocity_gain", "integral_gain"))
    # What the other root is follows from the product and the sum of both, each with its own kv.
    proportional, slope, integral = kv * (kp + ki), kv * (1.0 - ki * period), kv * kp * ki
    other = integral / ((slope + proportional * period) * ki)
    gain = slope / (1.0 - other * period)
    found = known | {"position_gain": integral / (gain * other), "velocity_gain": gain, "integral_gain": other}
    return fit(task, structure, found, one.noise) or one


def _gauss_newton_step(J: FloatArray, white: FloatArray, x: FloatArray, limits: Bounds) -> FloatArray:
    """Gauss-Newton step; numbers that would leave their bounds stay."""
    free = np.ones(x.size, dtype=np.bool_)
    norms = column_norms(J)
    scaled = J / norms
    normal, right = scaled.T @ scaled, -scaled.T @ white
    for _ in range(x.size):
        change = np.zeros(x.size)
        change[free] = np.linalg.lstsq(normal[np.ix_(free, free)], right[free], rcond=1e-13)[0] / norms[free]
        stuck = free & limits.find_blocking(x, change)
        if not np.any(stuck):
            break
        free &= ~stuck
    return change


def covariance(task: Task, best: FittedLaw) -> Covariance:
    """Covariance of a law's numbers, robust against remaining colour and unequal variance."""
    noise = task.noise(best.structure, best.numbers)
    x = np.array(list(best.numbers.values()))
    white = task.whiten(best.structure, best.numbers, noise)
    J = -task.slopes(best.structure, x, white, noise)
    return larger(robust(J, J, white), covariance_by_frequency(J, white))


def covariance_by_frequency(J: FloatArray, white: FloatArray) -> Covariance:
    """Covariance from the scores by frequency: J (samples, numbers), white residual.

    Quantisation noise is largest at slow motion, where the signal is. Heteroscedasticity over frequencies (White 1980,
    real transform) covers that; a smoothed spectrum would not.
    """
    norms = column_norms(J)
    products = np.fft.rfft(J / norms, axis=0).conj() * np.fft.rfft(white)[:, np.newaxis]
    scores = 2.0 / white.size * np.real(products)
    spread = np.linalg.pinv((J / norms).T @ (J / norms))
    found = covariance_of(spread @ (scores.T @ scores) @ spread.T, 0)
    return Covariance(found.std / norms, found.correlation, 0)
