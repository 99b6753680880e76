"""What laws explain whatever their gains: regressions on the columns they are made of, their filters and clocks given.

Only the filters' few numbers, the ki of a cascade and a delay are searched for (variable projection: Golub and Pereyra
2003, Inverse Problems 19). Where all coefficients are free, what is left is the least that any law can leave: filters
and clocks are told from each other before a law is chosen.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from jointid.common.arrays import FloatArray, column_norms
from jointid.controller_id.columns import EVERY, columns, injected, parts_of, response
from jointid.controller_id.loop_record import Watched
from jointid.controller_id.noise import Noise, noise_of
from jointid.controller_id.structures import LATE, Structure, bounds

_DEPENDENT = 1e-9  # of a column: what is left of it beside the others is rounding
_STEP = 1e-4  # of a number, for its difference
_EVALUATIONS = 6  # of a search for filters' numbers: the law is fitted exactly later


class Standing(NamedTuple):
    """What laws are judged under.

    Attributes:
        noise: of torque and position.
        response: |G| of the law that it is the noise of, by which a regression is weighted.
    """

    noise: Noise
    response: FloatArray

    @property
    def weights(self) -> FloatArray:
        """One over the square root of the noise's spectrum, 0 where that is left out."""
        return self.noise.weights(self.response)


@dataclass(frozen=True, slots=True, eq=False)
class Explained:
    """What a structure explains.

    Attributes:
        structure: of the law; of a frame, only the clocks and filters of it count.
        numbers: of its filters, ki of a cascade, and the reference's delay.
        cost: sum of the squares of the whitened residual.
        gains: the regression's coefficients, in torque.
        response: |G| of what was found, at the frequencies of the real transform.
        residual: (samples,) what is left.
    """

    structure: Structure
    numbers: dict[str, float]
    cost: float
    gains: FloatArray
    response: FloatArray
    residual: FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class Compressed:
    """A frame's columns, how they change with its numbers, and the torque: rotated into few rows.

    Attributes:
        numbers: of the filters, where they were worked out.
        blocks: (rows, 13) the columns, and their derivative by each number.
        targets: (rows, delays) the torque.
        late: the log's delays.
    """

    numbers: dict[str, float]
    blocks: tuple[FloatArray, ...]
    targets: FloatArray
    late: tuple[int, ...]

    def costs(self, structure: Structure, ki: float | None) -> FloatArray:
        """Return what a law would leave once its numbers have taken a step of Gauss and Newton, for each delay.

        Args:
            structure: of the law.
            ki: of a cascade's integral.
        """
        mixed = _mixed(structure, ki or 0.0)
        X, moves = self.blocks[0] @ mixed, [block @ mixed for block in self.blocks[1:]]
        if ki:
            moves.append(self.blocks[0] @ (_mixed(structure, 2.0 * ki) - mixed) / ki)
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
        watched: the stretch.
        kept: (samples,) 1 where the torque counts: not at the begin, nor at a limit.
        own: whether a law's cost is under its own response, or under that which the regression is weighted by.
    """

    watched: Watched
    kept: FloatArray
    own: bool = False

    def standing(self, one: Explained) -> Standing:
        """Return the noise that explains what is left, with the law it is the noise of."""
        watched = self.watched
        noise = noise_of(one.residual, one.response, watched.torque, self.kept, watched.error.most, watched.heard)
        return Standing(noise, one.response)

    def explained(
        self,
        structure: Structure,
        numbers: Mapping[str, float],
        standing: Standing,
        late: Sequence[int] | None = None,
        free: bool = True,
    ) -> list[Explained]:
        """Return what is explained with given filters, for several delays of the log.

        Args:
            structure: of the law.
            numbers: of filters, ki and delay.
            standing: what it is judged under.
            late: samples by which the log may show the torque late; those of the structure when None.
            free: whether all coefficients are free, or only those of the structure's law.

        Raises:
            MethodError: the filters cannot be.
        """
        late = [structure.late] if late is None else late
        mixed = EVERY if free else _mixed(structure, numbers.get("ki", 0.0))
        X = (columns(self.watched, structure, numbers) @ mixed) * self.kept[:, np.newaxis]
        Y = self._targets(structure, numbers, late)
        scale = column_norms(X)
        seen, wanted = (_white(one, standing.weights) for one in (X / scale, Y))
        coefficients = np.linalg.lstsq(seen, wanted, rcond=_DEPENDENT)[0] / scale[:, np.newaxis]
        gains, residuals = mixed @ coefficients, Y - X @ coefficients
        found = []
        for i, n in enumerate(late):
            magnitude = response(self.watched, structure, numbers, gains[:, i])
            spectrum = np.fft.rfft(residuals[:, i]) * self._weights(standing, magnitude)
            cost = float(np.linalg.norm(np.fft.irfft(spectrum, self.watched.samples)) ** 2)
            like = replace(structure, late=n)
            found.append(Explained(like, dict(numbers), cost, gains[:, i], magnitude, residuals[:, i]))
        return found

    def compressed(
        self, frame: Structure, numbers: Mapping[str, float], standing: Standing, late: Sequence[int]
    ) -> Compressed:
        """Return what any law needs to know of a frame, in few rows: the triangle of a QR decomposition.

        Args:
            frame: clocks and filters.
            numbers: of the filters, and of the reference's delay where the laws have one.
            standing: what the laws are judged under.
            late: samples by which the log may show the torque late.

        Raises:
            MethodError: the filters cannot be.
        """
        base = columns(self.watched, frame, numbers)
        blocks = [base]
        for name, value in numbers.items():
            step = _STEP * max(value, _least(name, self.watched.period))
            blocks.append((columns(self.watched, frame, {**numbers, name: value + step}) - base) / step)
        stacked = np.hstack([*blocks, self._targets(frame, numbers, late)]) * self.kept[:, np.newaxis]
        scale = column_norms(stacked)
        triangle: FloatArray = np.asarray(np.linalg.qr(_white(stacked / scale, standing.weights), mode="r"))
        triangle = triangle * (scale * math.sqrt(2.0 / self.watched.samples))
        width = base.shape[1]
        split = [triangle[:, i : i + width] for i in range(0, width * len(blocks), width)]
        return Compressed(dict(numbers), tuple(split), triangle[:, width * len(blocks) :], tuple(late))

    def refined(
        self, one: Explained, standing: Standing, free: bool = True, evaluations: int = _EVALUATIONS
    ) -> Explained:
        """Return a structure with its numbers where it explains most.

        Args:
            one: the structure, and where to begin.
            standing: what it is judged under.
            free: whether all coefficients are free.
            evaluations: at most, beside those of the derivatives.
        """
        from scipy.optimize import least_squares

        names = list(one.numbers)
        low, high = np.array([bounds(n, self.watched.period, one.structure.rate) for n in names]).reshape(-1, 2).T

        def explained(x: FloatArray) -> Explained:
            numbers = dict(zip(names, map(float, x), strict=True))
            return self.explained(one.structure, numbers, standing, free=free)[0]

        def white(x: FloatArray) -> FloatArray:
            found = explained(x)
            return _stacked(np.fft.rfft(found.residual) * self._weights(standing, found.response))

        start = np.array(list(one.numbers.values()))
        if not names:
            return explained(start)
        sizes = np.maximum(start, [_least(name, self.watched.period) for name in names])
        inside = np.clip(start, low + 1e-6 * sizes, np.where(np.isfinite(high), high - 1e-6 * sizes, high))
        found = least_squares(
            white,
            inside,
            bounds=(low, high),
            x_scale=sizes,
            diff_step=np.full(start.size, _STEP),
            max_nfev=evaluations,
            ftol=1e-5,
        )
        return explained(found.x)

    def _targets(self, structure: Structure, numbers: Mapping[str, float], late: Sequence[int]) -> FloatArray:
        """Return the torque as much earlier, (samples, delays): it is moved, and the columns serve all delays."""
        added = self.watched.added
        known = injected(self.watched, structure, numbers)
        moved = [_earlier(self.watched.torque + added, n) - added for n in late]
        return np.asarray((np.column_stack(moved) - known) * self.kept[:, np.newaxis])

    def _weights(self, standing: Standing, response: FloatArray) -> FloatArray:
        return standing.noise.weights(response) if self.own else standing.weights


def regression(watched: Watched) -> Regression:
    """Return the regression on a record's stretch."""
    free, kept = watched.free, watched.free
    for n in LATE:  # the same rows for every delay
        kept = kept * _earlier(free, n)
    kept[-max(LATE) :] = 0.0
    return Regression(watched, kept)


def gains_of(one: Explained, gain: float) -> dict[str, float]:
    """Return the numbers of a law from what its own regression found.

    Args:
        one: what was found.
        gain: torque per controller unit.
    """
    structure, ki = one.structure, one.numbers.get("ki", 0.0)
    parts = parts_of(structure, ki)
    values = np.linalg.lstsq(np.column_stack(list(parts.values())), one.gains / gain, rcond=None)[0]
    found = one.numbers | dict(zip(parts, map(float, values), strict=True))
    if structure.cascade:
        size = max(abs(found["kv"]), 1e-12 * abs(found["kp"]), 1e-300)
        found |= {"kp": found["kp"] / size, "kv": math.copysign(size, found["kv"])}
        if "velocity_feedforward" in found:
            found["velocity_feedforward"] /= size
    return {name: found.get(name, 0.0) for name in structure.names if name != "limit"}


def _mixed(structure: Structure, ki: float) -> FloatArray:
    return np.column_stack(list(parts_of(structure, ki).values()))


def _earlier(signal: FloatArray, samples: int) -> FloatArray:
    return np.concatenate([signal[samples:], np.full(samples, signal[-1])])


def _least(name: str, sample_time: float) -> float:
    """Return what the size of a number that may be 0 is reckoned as."""
    last = name.rpartition(".")[2]
    return {"depth": 0.3, "ki": 1e-3 / sample_time, "reference_delay": 0.1 * sample_time}.get(last, 0.0)


def _white(X: FloatArray, weights: FloatArray) -> FloatArray:
    """Return columns made white, at the frequencies that are heard."""
    heard = weights > 0
    return _stacked(np.fft.rfft(X, axis=0)[heard] * weights[heard, np.newaxis])


def _stacked(spectrum: NDArray[np.complex128]) -> FloatArray:
    return np.concatenate([spectrum.real, spectrum.imag])
