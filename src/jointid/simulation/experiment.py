"""What a loop is driven with: all that does not depend on the joint's parameters, computed once.

`prepare` turns a record into an `Experiment`: the controller lowered to its sampled law, its answer to the reference,
and the cut of a controller period into the parts in which the torque, or what the log looks at, changes.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from jointid.common.errors import RecordError
from jointid.data.record import Channel, FloatArray, InjectionPoint, Record, Tap, Timing
from jointid.model.controllers import (
    POSITION,
    REFERENCE,
    REFERENCE_VELOCITY,
    Controller,
    SampledLaw,
    run,
    scaled,
)
from jointid.model.joints import Joint, require_units

_SNAP = 1e-6  # of a period: instants closer than this are the same instant
_SAME_RATE = 1e-4  # two clocks whose rates differ by less than crystals do are one clock
_FEWEST = 10  # periods that can be simulated to any purpose
_MOST = 200  # periods to one log sample, or the other way round: more is a mistake
_FAR = 1e3  # times the commanded travel: a motor this far away will not come back


@dataclass(frozen=True, slots=True)
class ClosedLoop:
    """A joint under its controller: from reference alone to torque."""

    joint: Joint
    controller: Controller

    @property
    def channels(self) -> tuple[str, ...]:
        """Names of the channels a record must have to be compared with this loop."""
        return ("torque", *self.controller.channels)


@dataclass(frozen=True, slots=True, eq=False)
class Experiment:
    """What a loop was driven with, at the controller's instants; made by `prepare`.

    Attributes:
        law: the controller's state-space form.
        inputs: (periods, 3) reference, reference velocity, and a column of zeros for the position.
        before_limit, after_limit: (periods,) what is added to the output; in the log or not, see below.
        logged: (periods,) the part of `after_limit` that the logged torque contains.
        feedforward: (periods,) the law's answer to everything but the position.
        sample_time: of the log, which is every `every`-th period, or shows each period `repeat` times.
        lengths, lags: the parts of a period, see `kernels.run`.
        looked: (samples,) which of all parts, period after period, begin at the log's instants.
        far: a motor position that no loop comes back from, reckoned from the initial one.
        tap: where the torque is logged. timing: what a logged value is.
        samples: of the log.
    """

    law: SampledLaw
    inputs: FloatArray
    before_limit: FloatArray
    after_limit: FloatArray
    logged: FloatArray
    feedforward: FloatArray
    sample_time: float
    every: int
    repeat: int
    lengths: FloatArray
    lags: NDArray[np.int64]
    looked: NDArray[np.intp]
    far: float
    tap: Tap
    timing: Timing
    samples: int

    @property
    def shown(self) -> FloatArray:
        """What the logged torque contains beside the controller's output, (periods,)."""
        return self.after_limit if self.tap is Tap.MEASURED else self.logged

    def with_law(self, law: SampledLaw) -> Experiment:
        """Return the same experiment under another law of the same period and delay."""
        return _experiment(
            law, self.inputs, self.before_limit, self.after_limit, self.logged, self.sample_time, self.samples,
            self.tap, self.timing,
        )  # fmt: skip

    def scaled(self, factor: float) -> Experiment:
        """Return the same experiment under the law with its output `factor` times as large."""
        return self.with_law(scaled(self.law, factor))


def prepare(loop: ClosedLoop, record: Record) -> Experiment:
    """Return what the record drove the loop with.

    Raises:
        RecordError: a channel the controller reads is missing, or its clock does not divide the controller's.
    """
    record.require(loop.controller.channels, "The simulation of this controller")
    require_units(record, loop.joint)
    assert record.reference is not None
    log = record.torque or record.reference
    law = loop.controller.law(log.sample_time)
    periods = math.floor(min(record.duration / law.period, 1e9) + _SNAP)
    if periods < _FEWEST:
        raise RecordError(
            f"The record lasts {record.duration:.4g} s, fewer than {_FEWEST} of the controller's periods of "
            f"{law.period:.4g} s; use a longer one, or correct the period."
        )
    _ratio(law.period, log.sample_time, "the log")
    inputs = np.zeros((periods, 3))
    inputs[:, REFERENCE] = at_period(record.reference, law.period, periods, "reference")
    if "reference_velocity" in loop.controller.channels:
        assert record.reference_velocity is not None
        velocity = at_period(record.reference_velocity, law.period, periods, "reference_velocity")
        inputs[:, REFERENCE_VELOCITY] = velocity
    before, after, logged = (np.zeros(periods) for _ in range(3))
    if record.injected is not None:
        signal = at_period(record.injected.channel, law.period, periods, "injected")
        if record.injected.at is InjectionPoint.BEFORE_LIMIT:
            before = signal
        else:
            after = signal
            logged = signal * record.injected.in_torque
    timing = record.torque.timing if record.torque is not None else Timing.HELD
    samples = math.floor(record.duration / log.sample_time + _SNAP)
    return _experiment(law, inputs, before, after, logged, log.sample_time, samples, record.tap, timing)


def at_period(channel: Channel, period: float, periods: int, name: str) -> FloatArray:
    """Return a channel at the controller's instants.

    A channel that is faster than the controller is picked; one that is slower is held until its next sample, or, if it
    is sampled (as a reference is, unless it is declared held), interpolated linearly.

    Raises:
        RecordError: neither of the two periods is a multiple of the other.
    """
    every, repeat = _ratio(period, channel.sample_time, name)
    if repeat > 1 and channel.timing is Timing.SAMPLED:
        at = np.arange(periods) / repeat
        return np.asarray(np.interp(at, np.arange(channel.values.size), channel.values), dtype=np.float64)
    return np.asarray(np.repeat(channel.values[::every], repeat)[:periods])


def _ratio(long: float, short: float, name: str) -> tuple[int, int]:
    """Return (every, repeat): how many of `short` make one `long`, or the other way round; one of them is 1."""
    ratio = long / short
    every, repeat = max(round(min(ratio, 1e9)), 1), max(round(min(1 / ratio, 1e9)), 1)
    if max(every, repeat) > _MOST or abs(ratio * repeat / every - 1) > _SAME_RATE:
        raise RecordError(
            f"The controller's period and the sample time of {name}, {long:.9g} s and {short:.9g} s, are not the same, "
            f"nor is one a multiple of the other up to {_MOST} times; correct the period, or resample the log."
        )
    return every, repeat


def _experiment(
    law: SampledLaw,
    inputs: FloatArray,
    before_limit: FloatArray,
    after_limit: FloatArray,
    logged: FloatArray,
    sample_time: float,
    samples: int,
    tap: Tap,
    timing: Timing,
) -> Experiment:
    repeat, every = _ratio(law.period, sample_time, "the log")
    lengths, lags = _parts(law, repeat)
    starts = np.cumsum(lengths) - lengths
    inside = [int(np.argmin(np.abs(starts - j * law.period / repeat))) for j in range(repeat)]
    looked = (np.arange(0, len(inputs), every)[:, np.newaxis] * lengths.size + inside).reshape(-1)[:samples]
    reference, velocity = inputs[:, REFERENCE], inputs[:, REFERENCE_VELOCITY]
    slope = (reference[1] - reference[0]) / law.period if reference.size > 1 else 0.0
    state = law.memory(REFERENCE, reference[0], slope) + law.memory(REFERENCE_VELOCITY, velocity[0], 0.0)
    feedforward = run(law, inputs, state) + before_limit
    far = _far(law, feedforward, after_limit)
    return Experiment(
        law, inputs, before_limit, after_limit, logged, feedforward, sample_time, every, repeat, lengths, lags,
        looked, far, tap, timing, looked.size,
    )  # fmt: skip


def _parts(law: SampledLaw, repeat: int) -> tuple[FloatArray, NDArray[np.int64]]:
    """Cut a period where the torque changes (the delay) and where the log looks (a log faster than the loop)."""
    late = law.delay / law.period
    whole = math.floor(late + _SNAP)
    fraction = max(late - whole, 0.0)
    fraction = 0.0 if fraction < _SNAP else fraction
    cuts = [j / repeat for j in range(repeat)]
    if all(abs(cut - fraction) > _SNAP for cut in cuts):
        cuts = sorted([*cuts, fraction])
    lengths = np.diff([*cuts, 1.0]) * law.period
    lags = [whole + 1 if cut < fraction - _SNAP else whole for cut in cuts]
    return lengths, np.array(lags, dtype=np.int64)


def _far(law: SampledLaw, feedforward: FloatArray, after_limit: FloatArray) -> float:
    gain = abs(law.D[POSITION])
    if gain == 0.0:
        return math.inf
    asked = feedforward / gain
    travel = float(np.ptp(asked) + np.max(np.abs(after_limit)) / gain)
    return float(np.max(np.abs(asked))) + _FAR * travel + 1e-9
