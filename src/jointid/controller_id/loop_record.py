"""Controller inputs and output from a record, and law torque prediction."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from itertools import groupby

import numpy as np

from jointid.common.arrays import FloatArray
from jointid.common.errors import RecordError
from jointid.common.text import join
from jointid.controller_id.noise import PositionError, informative_frequencies, position_error
from jointid.controller_id.structures import LATE, SLOWER
from jointid.models.controllers import (
    INJECTED,
    POSITION,
    REFERENCE,
    REFERENCE_VELOCITY,
    Interpolation,
    law_inputs,
)
from jointid.records.checks import find_encoder_step
from jointid.records.record import InjectionPoint, Record, Tap, Timing
from jointid.records.resampling import at_period, running_mean

_NEEDED = ("torque", "reference", "motor_position")
_FEWEST = 500  # samples
_BEGIN = 20  # samples that are left out: what the law's filters hold at the first one is only guessed
_SETTLED = 100  # samples that are left out of a stretch, which begins in motion
_PLATEAU = 3  # samples in a row at the top, to be a limit
_ROUNDING = 1e-12  # of the torque: what is left of it when it is all injected
_NEAR = 0.98  # of the plateau: what is above may have been cut
_TOP = 6.0  # deviations of the log's noise within which a torque is at the top


@dataclass(frozen=True, slots=True, eq=False)
class LoopRecord:
    """Inputs and output of the controller, prepared from part of a record.

    Attributes:
        record: with torque, reference and motor position.
        begin: index of the first sample in the record.
        period: of the log, seconds.
        torque: (samples,) of the controller, without a logged addition after the limit.
        added: (samples,) that addition.
        kept: (samples,) 1 where the residual counts, else 0.
        plateau: largest torque, if the log is constant there; else None.
        error: of the logged position.
        informative: (frequencies,) 1 where the record is informative of its law, else 0.
        unexplained: (samples,) torque that no law explains, 0 where a limit acts.
    """

    record: Record
    begin: int
    period: float
    torque: FloatArray
    added: FloatArray
    kept: FloatArray
    plateau: float | None
    error: PositionError
    informative: FloatArray
    unexplained: FloatArray
    _inputs: dict[tuple[int, Interpolation, int], FloatArray] = field(default_factory=dict)

    @property
    def samples(self) -> int:
        """Number of samples of the log."""
        return self.torque.size

    @property
    def free(self) -> FloatArray:
        """(samples,) 1 where the residual counts and no limit acts, else 0."""
        return self.kept * _below_limit(self.torque, self.plateau)

    def select_strongest(self, samples: int) -> LoopRecord:
        """Select the samples with the strongest reference acceleration."""
        if samples >= self.samples:
            return self
        assert self.record.reference is not None
        reference = at_period(self.record.reference, self.period, self.samples, "reference")
        bent = np.concatenate([np.zeros(2), np.cumsum(np.diff(reference, 2) ** 2)])
        begin = int(np.argmax(bent[samples:] - bent[:-samples]))
        begin -= begin % max(SLOWER)  # a slower loop is in the same phase as on the whole record
        rows = slice(begin, begin + samples)
        kept = self.kept[rows].copy()
        kept[:_SETTLED] = 0.0
        return _listen(self.record, begin, self.torque[rows], self.added[rows], kept, self.plateau)

    def inputs(self, rate: int, interpolation: Interpolation, average: int = 0) -> FloatArray:
        """Inputs of a law, (periods, INPUTS); `average` of the reference in samples."""
        key = rate, interpolation, average
        if key not in self._inputs:
            filled = interpolation if rate > 1 else None
            read = _read_inputs(self.record, self.period, self.begin + self.samples, rate, filled)
            read = _average_reference(read, average * rate) if average else read
            self._inputs[key] = read[self.begin * rate :].copy()
        return self._inputs[key]

    def to_log(self, signals: FloatArray, rate: int) -> FloatArray:
        """Sample a law's signals, (periods, signals), as the log shows a torque."""
        assert self.record.torque is not None
        if self.record.torque.timing is not Timing.AVERAGED:
            return signals[::rate]
        return shift(signals.reshape(-1, rate, signals.shape[1]).mean(axis=1), 1)


def shift(signals: FloatArray, samples: int) -> FloatArray:
    """Shift signals later by samples, earlier if negative; the ends are held."""
    return np.asarray(signals[np.clip(np.arange(len(signals)) - samples, 0, len(signals) - 1)])


def prepare_loop_record(record: Record) -> LoopRecord:
    """Prepare a record for learning."""
    missing = [name for name in _NEEDED if getattr(record, name) is None]
    missing += ["torque"] if record.computed else []  # that of the law which is declared
    if missing:
        raise RecordError(
            f"A controller is learned from torque, reference and the measured motor position; {record.name} is read "
            f"without {join(missing)}: name its column below [record.channels], or declare the law."
        )
    assert record.torque is not None and record.motor_position is not None and record.reference is not None
    period = record.torque.sample_time
    samples = math.floor(record.duration / period + 1e-6)
    torque = record.torque.values[:samples].copy()
    injected, added = record.injected, np.zeros(samples)
    in_log = injected is not None and (injected.in_torque or record.tap is Tap.MEASURED)
    if injected is not None and in_log and injected.at is InjectionPoint.AFTER_LIMIT:
        added = at_period(injected.channel, period, samples, "injected")
        if record.torque.timing is Timing.AVERAGED:  # as the torque, a sample shows the mean of the one before it
            added = shift(added, 1)
    torque -= added
    still = [name for name in ("reference", "motor_position") if np.ptp(getattr(record, name).values) == 0.0]
    still += ["torque, less what was injected,"] * bool(np.ptp(torque) <= _ROUNDING * np.max(np.abs(torque + added)))
    if samples < _FEWEST or still:
        said = f"{', '.join(still)} constant" if still else f"{samples} samples"
        raise RecordError(
            f"A controller is learned from {_FEWEST} samples or more, with a motion; this one has {said}: use another."
        )
    kept = np.ones(samples)
    kept[:_BEGIN] = 0.0
    return _listen(record, 0, torque, added, kept, _plateau(torque, added))


def _listen(
    record: Record, begin: int, torque: FloatArray, added: FloatArray, kept: FloatArray, plateau: float | None
) -> LoopRecord:
    """Determine the position's error and the informative frequencies of a stretch."""
    assert record.torque is not None and record.motor_position is not None
    period = record.torque.sample_time
    own = _read_inputs(record, period, begin + torque.size, 1, None)[begin:]
    error = position_error(own[:, POSITION], find_encoder_step(record.motor_position))
    heard = informative_frequencies(own, torque, added, kept * _below_limit(torque, plateau), error)
    return LoopRecord(record, begin, period, torque, added, kept, plateau, error, *heard)


def _below_limit(torque: FloatArray, plateau: float | None) -> FloatArray:
    return np.asarray(np.abs(torque) < _NEAR * (plateau or math.inf), dtype=np.float64)


def _read_inputs(record: Record, period: float, samples: int, rate: int, filled: Interpolation | None) -> FloatArray:
    """Inputs of a law with `rate` periods per sample, (periods, INPUTS)."""
    periods, own = samples * rate, period / rate
    assert record.motor_position is not None and record.reference is not None
    velocity = None
    if record.reference_velocity is not None:
        velocity = at_period(record.reference_velocity, own, periods, "reference_velocity", filled)
    inputs = law_inputs(at_period(record.reference, own, periods, "reference", filled), velocity)
    inputs[:, POSITION] = at_period(record.motor_position, own, periods, "motor_position", "spline")
    if record.injected is not None and record.injected.at is InjectionPoint.BEFORE_LIMIT:
        inputs[:, INJECTED] = at_period(record.injected.channel, own, periods, "injected")
    return inputs


def _average_reference(inputs: FloatArray, periods: int) -> FloatArray:
    """Average the reference and its velocity in a law's inputs, (periods, INPUTS)."""
    reference, velocity = inputs[:, REFERENCE], inputs[:, REFERENCE_VELOCITY]
    reference = running_mean(reference, periods, float(reference[1] - reference[0]))
    averaged = law_inputs(reference, running_mean(velocity, periods, 0.0))
    averaged[:, [POSITION, INJECTED]] = inputs[:, [POSITION, INJECTED]]
    return averaged


def _plateau(torque: FloatArray, added: FloatArray) -> float | None:
    """Largest torque that a log holds, or None."""
    # In a late log, what was added is still in the torque for as many samples.
    changed = np.concatenate([[False], np.diff(added) != 0.0])
    size = np.abs(torque) * (np.convolve(changed, np.ones(max(LATE) + 1))[: torque.size] < 0.5)
    second = np.abs(np.diff(torque, 2))
    noise = float(np.median(second)) / (0.6745 * math.sqrt(6.0))
    top = float(np.max(size))
    inside = size >= top - max(_TOP * noise, 1e-6 * top)
    # Standing, not turning: the torque changes from sample to sample no more than its noise does.
    still = np.concatenate([[False], np.abs(np.diff(torque)) <= max(_TOP * noise, 1e-9 * top)])
    longest = max((len(list(run)) for stands, run in groupby(inside & still) if stands), default=0)
    return float(np.median(size[inside])) if longest >= _PLATEAU - 1 else None
