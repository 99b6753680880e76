"""What laws explain whatever their gains: a regression on what they are made of, their filters and clocks given.

With e = r - q, the filtered difference v = F D q, F the velocity's filter and S a sum over time, the torque of every
law of `structures` is::

    u = T(z) (a1 e + a2 v + a3 D r + a4 F D r + a5 S e + a6 r + a7 F q + a8 w + a9 S w
              + a10 D r + a11 D D r + a12 sign(D r) + a13)

w the record's own reference velocity, T(z) the torque's filter. Each law has some of the coefficients, or ties them:
a cascade with an integral is ``kv (1 + ki S) (kp e + f D r - v)``, linear in ``kv kp``, ``kv f`` and ``kv`` for a given
ki. So only the filters' few numbers, ki and a delay are searched for (variable projection: Golub and Pereyra 2003,
Inverse Problems 19), and where all coefficients are free, what is left is the least that any law can leave: filters
and clocks are told from each other before a law is chosen.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from jointid.data.record import FloatArray, Timing
from jointid.learning.noise import Noise, noise_of, seen_from
from jointid.learning.structures import (
    ACCELERATION,
    COULOMB,
    FIELDS,
    INTEGRAL,
    LATE,
    VELOCITY,
    Structure,
    bounds,
    filters_of,
)
from jointid.learning.structures import CONSTANT as BALANCE
from jointid.learning.watched import Watched
from jointid.model.controllers import DIRECTION, POSITION, REFERENCE, REFERENCE_VELOCITY
from jointid.model.controllers.filters import Filter, as_filter

_NEAR = 0.98  # of the plateau: what is above may have been cut
_LEAD = 64  # samples of straight motion before the first, in which the filters settle
_SLOPE = 5  # samples that tell how fast that is
_DEPENDENT = 1e-9  # of a column: what is left of it beside the others is rounding
_STEP = 1e-4  # of a number, for its difference
_EVALUATIONS = 6  # of a search for filters' numbers: the law is fitted exactly later
_SCALES = {"depth": 0.3, "ki": 1.0}  # sizes of numbers that may be 0
ERROR, SPEED, FED, FED_FILTERED, SUM, COMMAND, FILTERED, CHANNEL, CHANNEL_SUM, VISCOUS, BENT, SIGN, ONE = range(13)
EVERY = np.eye(13)
"""All coefficients free."""


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
        frame: clocks and filters.
        numbers: where they were worked out.
        blocks: (rows, 13) the columns, and their derivative by each number.
        targets: (rows, delays) the torque.
        late: the log's delays.
    """

    frame: Structure
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
        scale = np.linalg.norm(X, axis=0)
        scale = np.where(scale > 0, scale, 1.0)
        gains = np.linalg.lstsq(X / scale, self.targets, rcond=_DEPENDENT)[0] / scale[:, np.newaxis]
        costs = np.empty(len(self.late))
        for i, target in enumerate(self.targets.T):
            full = np.column_stack([X, *(move @ gains[:, i] for move in moves)])
            size = np.linalg.norm(full, axis=0)
            full = full / np.where(size > 0, size, 1.0)
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
        noise = noise_of(one.residual, one.response, watched.torque, self.kept, watched.error)
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
        kept, added, size = self.kept[:, np.newaxis], self.watched.added, self.watched.samples
        columns = self._columns(structure, numbers) @ mixed * kept
        # The torque is moved, not the columns: they serve all delays.
        targets = np.column_stack([_earlier(self.watched.torque + added, n) - added for n in late]) * kept
        scale = np.linalg.norm(columns, axis=0)
        scale = np.where(scale > 0, scale, 1.0)
        weights = standing.weights
        heard = weights > 0
        X, Y = (_stacked((np.fft.rfft(x, axis=0) * weights[:, np.newaxis])[heard]) for x in (columns / scale, targets))
        coefficients = np.linalg.lstsq(X, Y, rcond=_DEPENDENT)[0] / scale[:, np.newaxis]
        gains, residuals = mixed @ coefficients, targets - columns @ coefficients
        found = []
        for i, n in enumerate(late):
            response = self._response(structure, numbers, gains[:, i])
            spectrum = np.fft.rfft(residuals[:, i]) * self._weights(standing, response)
            cost = float(np.linalg.norm(np.fft.irfft(spectrum, size)) ** 2)
            like = replace(structure, late=n)
            found.append(Explained(like, dict(numbers), cost, gains[:, i], response, residuals[:, i]))
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
        base, kept = self._columns(frame, numbers), self.kept[:, np.newaxis]
        blocks = [base]
        for name, value in numbers.items():
            step = _STEP * max(value, _SCALES.get(name.rpartition(".")[2], 0.0))
            blocks.append((self._columns(frame, {**numbers, name: value + step}) - base) / step)
        added = self.watched.added
        targets = np.column_stack([_earlier(self.watched.torque + added, n) - added for n in late])
        stacked = np.hstack([*blocks, targets]) * kept
        scale = np.linalg.norm(stacked, axis=0)
        scale = np.where(scale > 0, scale, 1.0)
        weights = standing.weights
        heard = weights > 0
        white = _stacked((np.fft.rfft(stacked / scale, axis=0) * weights[:, np.newaxis])[heard])
        triangle: FloatArray = np.asarray(np.linalg.qr(white, mode="r")) * (
            scale * math.sqrt(2.0 / self.watched.samples)
        )
        width = base.shape[1]
        split = [triangle[:, i : i + width] for i in range(0, width * len(blocks), width)]
        return Compressed(frame, dict(numbers), tuple(split), triangle[:, width * len(blocks) :], tuple(late))

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
        low, high = np.array([bounds(n, self.watched.period / one.structure.rate) for n in names]).reshape(-1, 2).T

        def explained(x: FloatArray) -> Explained:
            numbers = dict(zip(names, map(float, x), strict=True))
            return self.explained(one.structure, numbers, standing, free=free)[0]

        def white(x: FloatArray) -> FloatArray:
            found = explained(x)
            return _stacked(np.fft.rfft(found.residual) * self._weights(standing, found.response))

        start = np.array(list(one.numbers.values()))
        if not names:
            return explained(start)
        sizes = np.maximum(start, [_SCALES.get(name.rpartition(".")[2], 0.0) for name in names])
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

    def _weights(self, standing: Standing, response: FloatArray) -> FloatArray:
        return standing.noise.weights(response) if self.own else standing.weights

    def _columns(self, structure: Structure, numbers: Mapping[str, float]) -> FloatArray:
        """Return what the coefficients of the module's equation are of, as the log would show it, (samples, 13)."""
        watched, rate, period = self.watched, structure.rate, self.watched.period / structure.rate
        lead, slope = _LEAD * rate, _SLOPE * rate
        inputs = watched.inputs(rate, structure.curved)
        r, q = (_led(inputs[:, i] - inputs[0, POSITION], lead, slope) for i in (REFERENCE, POSITION))
        r = _delayed(r, numbers.get("reference_delay", 0.0) / period)
        velocity, torque = filters_of(structure, numbers)
        filtered = _passed(velocity, np.column_stack([q, r]), period)
        speed = _rate(filtered, period)
        e, fed = r - q, _rate(r, period)
        w, direction = (np.concatenate([np.full(lead, x[0]), x]) for x in inputs[:, [REFERENCE_VELOCITY, DIRECTION]].T)
        direction = _delayed(direction, numbers.get("reference_delay", 0.0) / period)
        viscous, bent = fed, _rate(_rate(r, period), period)
        if structure.every > 1:  # the lead is a whole number of the slower loop's periods
            at = np.arange(r.size)
            last = np.maximum(at - (at - structure.offset) % structure.every, 0)
            fed = (r[last] - r[np.maximum(last - structure.every, 0)]) / (structure.every * period)
            e, w = e[last], w[last]
        e_sum, fed_sum, speed_sum, w_sum = (_summed(one, lead) * period for one in (e, fed, speed[:, 0], w))
        columns = np.column_stack([
            e, speed[:, 0], fed, speed[:, 1], e_sum, fed_sum, speed_sum, w, w_sum,
            viscous, bent, direction, np.ones(r.size),
        ])  # fmt: skip
        shown = _passed(torque, columns, period)[lead:]
        assert watched.record.torque is not None
        if watched.record.torque.timing is not Timing.AVERAGED:
            return shown[::rate]
        means = shown.reshape(-1, rate, shown.shape[1]).mean(axis=1)
        return np.concatenate([means[:1], means[:-1]])

    def _response(self, structure: Structure, numbers: Mapping[str, float], gains: FloatArray) -> FloatArray:
        """Return |G| from the position to the torque, as if the position loop were as fast as the velocity loop."""
        period = self.watched.period / structure.rate
        filters = filters_of(structure, numbers)

        def response(hertz: FloatArray) -> NDArray[np.complex128]:
            back = np.exp(-2j * np.pi * hertz * period)
            velocity, torque = (_at(one, back, period) for one in filters)
            slope = (1.0 - back) / period
            slope = np.where(slope == 0.0, 1e-300, slope)
            inner = (gains[SPEED] * slope + gains[FILTERED] * back) * velocity
            return np.asarray(torque * (inner - gains[ERROR] - gains[SUM] * back / slope))

        watched = self.watched
        return seen_from(response, watched.period, watched.samples, structure.rate) * watched.error.shape


def regression(watched: Watched) -> Regression:
    """Return the regression on a record's stretch."""
    inside = np.asarray(np.abs(watched.torque) < _NEAR * (watched.plateau or math.inf), dtype=np.float64)
    kept = watched.kept * inside
    for n in LATE:  # the same rows for every delay
        kept = kept * _earlier(inside, n)
    kept[-max(LATE) :] = 0.0
    return Regression(watched, kept)


def gains_of(one: Explained, gain: float) -> dict[str, float]:
    """Return the numbers of a law from what its own regression found.

    Args:
        one: what was found.
        gain: torque per controller unit.
    """
    structure, ki = one.structure, one.numbers.get("ki", 0.0)
    parts = _parts(structure, ki)
    values = np.linalg.lstsq(np.column_stack(list(parts.values())), one.gains / gain, rcond=None)[0]
    found = one.numbers | dict(zip(parts, map(float, values), strict=True))
    if structure.cascade:
        kv = max(found["kv"], 1e-12 * abs(found["kp"]), 1e-300)
        found |= {"kp": found["kp"] / kv, "kv": kv}
        if "velocity_feedforward" in found:
            found["velocity_feedforward"] /= kv
    return {name: found.get(name, 0.0) for name in structure.names if name != "limit"}


def _mixed(structure: Structure, ki: float) -> FloatArray:
    return np.column_stack(list(_parts(structure, ki).values()))


def _parts(structure: Structure, ki: float) -> dict[str, FloatArray]:
    """Return what each gain of a law is a coefficient of, as combinations of the columns."""
    inner = ki if structure.cascade else 0.0
    fed = {"channel": EVERY[CHANNEL] + inner * EVERY[CHANNEL_SUM]}.get(
        structure.reference_velocity, EVERY[FED] + inner * EVERY[COMMAND]
    )
    speed = -EVERY[SPEED] - inner * EVERY[FILTERED]
    parts = {"kp": EVERY[ERROR] + inner * EVERY[SUM]}
    if structure.cascade:
        parts["kv"] = speed + (fed if structure.reference_velocity == "full" else 0.0)
        if structure.reference_velocity in ("share", "channel"):
            parts["velocity_feedforward"] = fed
    else:
        own = {"difference": EVERY[FED_FILTERED], "channel": EVERY[CHANNEL]}
        parts["kd"] = speed + own.get(structure.reference_velocity, 0.0)
        if structure.integrates:
            parts["ki"] = EVERY[SUM]
    beside = {VELOCITY: VISCOUS, ACCELERATION: BENT, COULOMB: SIGN, BALANCE: ONE}
    parts |= {FIELDS[name]: EVERY[i] for name, i in beside.items() if name in structure.feedforward}
    return parts | ({INTEGRAL: EVERY[ONE]} if structure.integrates else {})


def _led(signal: FloatArray, lead: int, slope: int) -> FloatArray:
    """Return a signal with a straight line before it, as it begins."""
    rate = (signal[slope] - signal[0]) / slope
    return np.concatenate([signal[0] + rate * np.arange(-lead, 0), signal])


def _earlier(signal: FloatArray, samples: int) -> FloatArray:
    return np.concatenate([signal[samples:], np.full(samples, signal[-1])])


def _delayed(signal: FloatArray, periods: float) -> FloatArray:
    at = np.arange(signal.size)
    return np.asarray(np.interp(at - periods, at, signal)) if periods else signal


def _rate(signal: FloatArray, period: float) -> FloatArray:
    return np.asarray(np.diff(signal, axis=0, prepend=signal[:1]) / period)


def _summed(signal: FloatArray, lead: int) -> FloatArray:
    """Return the sums of the earlier values from the first sample on, where an integral's content is reckoned."""
    sums = np.concatenate([[0.0], np.cumsum(signal[:-1])])
    return sums - sums[lead]


def _stacked(spectrum: NDArray[np.complex128]) -> FloatArray:
    return np.concatenate([spectrum.real, spectrum.imag])


def _passed(one: Filter | Sequence[float], signals: FloatArray, period: float) -> FloatArray:
    """Return signals, (periods, signals), behind a filter that has seen their first values for ever."""
    from scipy.signal import lfilter, lfilter_zi

    b, a = as_filter(one).coefficients(period)
    if len(b) == len(a) == 1:
        return signals * (b[0] / a[0])
    settled = lfilter_zi(b, a)[:, np.newaxis] * signals[:1]
    return np.asarray(lfilter(b, a, signals, axis=0, zi=settled)[0])


def _at(one: Filter | Sequence[float], back: FloatArray, period: float) -> FloatArray:
    b, a = as_filter(one).coefficients(period)
    return np.asarray(np.polyval(b[::-1], back) / np.polyval(a[::-1], back))
