"""Parameter-independent inputs of a closed-loop simulation, and its log.

`prepare` lowers the controller to its sampled law, computes its response to the reference, and cuts a period at changes
of the torque and at log instants.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from jointid.common.arrays import FloatArray
from jointid.common.errors import RecordError
from jointid.models.controllers import (
    INJECTED,
    POSITION,
    Controller,
    Interpolation,
    SampledLaw,
    law_inputs,
    respond,
    scale,
    shift_start,
)
from jointid.models.joints import ClosedLoop
from jointid.models.linear import SNAP
from jointid.records.record import InjectionPoint, Record, Tap, Timing, require_units
from jointid.records.resampling import at_period, period_ratio, running_mean

if TYPE_CHECKING:
    from jointid.simulation.kernels.drive import Feedback, SampledLoop

_FEWEST = 10  # periods that can be simulated to any purpose
_SLOWLY = 1e-4  # of the sampling frequency: there a loop holds its position
_FAR = 1e3  # times the commanded travel: a motor this far away will not come back


@dataclass(frozen=True, slots=True, eq=False)
class LoopInput:
    """Inputs of a closed-loop simulation at the controller's instants; see `prepare`.

    Attributes:
        law: the controller's state-space form. feedback: what of it the motion moves, and the same as the kernels read
            it, with what is `driven`.
        memory: (states, 2) of the feedback, what a motor position of 1 leaves before the first period, and a velocity
            of 1. integral: (states,) see `SampledLaw.integral`.
        inputs: (periods, INPUTS) of the law, with a column of zeros for the position.
        after_limit: (periods,) what is added to the output; in the log or not, see below.
        logged: (periods,) the part of `after_limit` that the logged torque contains.
        feedforward: (elements, periods) the answer of the law's elements to everything but the position.
        state: (states,) of the feedback at the first period, but for what the position leaves.
        sample_time: of the log, which is every `every`-th period, or shows each period `repeat` times.
        lengths, lags: the parts of a period, see `kernels.run`.
        log_index: (samples,) which of all parts, period after period, begin at the log's instants. torque_index:
            (samples,) those at which the newest torque of the same periods begins to act.
        far: a motor position that no loop comes back from, reckoned from the initial one.
        tap: where the torque is logged. timing: what a logged value is.
        begin: seconds from the first sample of the record's file to the first here, see `Record`.
        shows: whether the logged torque contains anything beside the controller's output, see `shown`.
    """

    law: SampledLaw
    feedback: SampledLaw
    kernel: Feedback
    memory: FloatArray
    integral: FloatArray | None
    inputs: FloatArray
    after_limit: FloatArray
    logged: FloatArray
    feedforward: FloatArray
    state: FloatArray
    sample_time: float
    every: int
    repeat: int
    lengths: FloatArray
    lags: NDArray[np.int64]
    log_index: NDArray[np.intp]
    torque_index: NDArray[np.intp]
    far: float
    tap: Tap
    timing: Timing
    samples: int
    begin: float
    shows: bool = field(init=False)
    sampled: SampledLoop = field(init=False)

    def __post_init__(self) -> None:
        from jointid.simulation.kernels.drive import SampledLoop

        sampled = SampledLoop(
            self.lengths, self.lags[np.newaxis], np.ones(1, dtype=np.int64), self.kernel, self.feedforward[np.newaxis],
            self.after_limit[np.newaxis],
        )  # fmt: skip
        object.__setattr__(self, "sampled", sampled)
        object.__setattr__(self, "shows", bool(np.any(self.shown)))

    @property
    def periods(self) -> int:
        """Number of simulated controller periods."""
        return len(self.inputs)

    @property
    def injected(self) -> bool:
        """True if a signal is added to the controller's output."""
        return bool(np.any(self.inputs[:, INJECTED]) or np.any(self.after_limit))

    @property
    def shown(self) -> FloatArray:
        """The part of the logged torque beside the controller's output, (periods,)."""
        return self.after_limit if self.tap is Tap.MEASURED else self.logged

    def law_of(self, controller: Controller) -> SampledLaw:
        """Law of a controller with its phase relative to the record's file."""
        return shift_start(controller, self.begin).law(self.sample_time)

    def with_law(self, law: SampledLaw) -> LoopInput:
        """Replace the law by one of the same period and delay."""
        return _build_input(
            law, self.inputs, self.after_limit, self.logged, self.sample_time, self.samples, self.tap, self.timing,
            self.begin,
        )  # fmt: skip

    def delayed(self, delay: float) -> LoopInput:
        """Let the torque act by another delay, s, later than the law puts it out."""
        law = replace(self.law, delay=delay)
        cut = _cut_periods(law, self.periods, self.repeat, self.every, self.samples)
        return replace(self, law=law, lengths=cut[0], lags=cut[1], log_index=cut[2], torque_index=cut[3])

    def scale(self, factor: float) -> LoopInput:
        """Scale the law's output and what is added to it."""
        more = replace(self, after_limit=factor * self.after_limit, logged=factor * self.logged)
        return more.with_law(scale(self.law, factor))


def prepare(loop: ClosedLoop, record: Record) -> LoopInput:
    """Prepare the inputs of a closed-loop simulation from a record.

    Raises:
        RecordError: a channel the controller reads is missing, or its clock does not divide the controller's.
    """
    record.require(loop.controller.channels, "The simulation of this controller")
    require_units(record, loop.joint.kind, loop.joint.torque_unit)
    assert record.reference is not None
    log = record.torque or record.reference
    law = shift_start(loop.controller, record.begin).law(log.sample_time)
    periods = math.floor(min(record.duration / law.period, 1e9) + SNAP)
    if periods < _FEWEST:
        raise RecordError(
            f"The record lasts {record.duration:.4g} s, fewer than {_FEWEST} of the controller's periods of "
            f"{law.period:.4g} s; use a longer one, or correct the period."
        )
    if not law.delay <= record.duration:
        raise RecordError(
            f"The controller's delay of {law.delay:.4g} s is longer than the record, {record.duration:.4g} s; correct "
            "the delay."
        )
    period_ratio(law.period, log.sample_time, "the log")
    filled: Interpolation | None = getattr(loop.controller, "interpolation", None)
    averaged = getattr(loop.controller, "reference_average", 0.0) / law.period
    velocity = None
    if "reference_velocity" in loop.controller.channels:
        assert record.reference_velocity is not None
        velocity = at_period(record.reference_velocity, law.period, periods, "reference_velocity", filled)
        velocity = running_mean(velocity, averaged, 0.0)
    reference = at_period(record.reference, law.period, periods, "reference", filled)
    inputs = law_inputs(running_mean(reference, averaged, float(reference[1] - reference[0])), velocity)
    after, logged = np.zeros(periods), np.zeros(periods)
    if record.injected is not None:
        signal = at_period(record.injected.channel, law.period, periods, "injected")
        if record.injected.at is InjectionPoint.BEFORE_LIMIT:
            inputs[:, INJECTED] = signal
        else:
            after = signal
            logged = signal * record.injected.in_torque
    timing = record.torque.timing if record.torque is not None else Timing.HELD
    samples = math.floor(record.duration / log.sample_time + SNAP)
    return _build_input(law, inputs, after, logged, log.sample_time, samples, record.tap, timing, record.begin)


def _build_input(
    law: SampledLaw,
    inputs: FloatArray,
    after_limit: FloatArray,
    logged: FloatArray,
    sample_time: float,
    samples: int,
    tap: Tap,
    timing: Timing,
    begin: float,
) -> LoopInput:
    from jointid.simulation.kernels.drive import Feedback

    repeat, every = period_ratio(law.period, sample_time, "the log")
    lengths, lags, log_index, torque_index = _cut_periods(law, len(inputs), repeat, every, samples)
    feedback, feedforward, driven, state = _split_law(law, inputs)
    far = _far(law, feedforward[law.output], after_limit)
    B, D = np.ascontiguousarray(feedback.B[:, :, POSITION]), np.ascontiguousarray(feedback.D[:, :, POSITION])
    A, F, C, E = (np.ascontiguousarray(one)[np.newaxis] for one in (feedback.A, feedback.F, feedback.C, feedback.E))
    limits, gates, output = law.limits[np.newaxis], law.gates[np.newaxis], np.array([law.output])
    kernel = Feedback(A, B[np.newaxis], F, C, D[np.newaxis], E, limits, gates, driven[np.newaxis], output)
    memory = np.column_stack([feedback.memory(POSITION, 1.0, 0.0), feedback.memory(POSITION, 0.0, 1.0)])
    return LoopInput(
        law, feedback, kernel, memory, feedback.integral(), inputs, after_limit, logged,
        feedforward, state, sample_time, every, repeat, lengths,
        lags, log_index, torque_index, far, tap, timing, log_index.size, begin,
    )  # fmt: skip


def _split_law(law: SampledLaw, inputs: FloatArray) -> tuple[SampledLaw, FloatArray, FloatArray, FloatArray]:
    """Split a law into motion-dependent part and known signals; see `LoopInput`.

    Known inputs of the states are used where the elements' responses would diverge, as for an integrator; else none.
    """
    feedback, beforehand = law.split()
    moved = law.fed_back()
    state = law.known_memory(inputs)
    if not law.integrates:
        feedforward = respond(law, inputs, state).T
        return feedback, np.ascontiguousarray(feedforward), np.zeros((0, feedback.order)), np.zeros(feedback.order)
    found, elements = respond(beforehand, inputs, state[~moved]), law.limits.size
    driven = np.ascontiguousarray(found[:, elements:])
    return feedback, np.ascontiguousarray(found[:, :elements].T), driven, state[moved]


def _cut_periods(
    law: SampledLaw, periods: int, repeat: int, every: int, samples: int
) -> tuple[FloatArray, NDArray[np.int64], NDArray[np.intp], NDArray[np.intp]]:
    """Cut a period at the delay and at log instants: return `lengths`, `lags`, and both indices of `LoopInput`."""
    late = law.delay / law.period
    whole = math.floor(late + SNAP)
    fraction = max(late - whole, 0.0)
    fraction = 0.0 if fraction < SNAP else fraction
    cuts = [j / repeat for j in range(repeat)]
    if all(abs(cut - fraction) > SNAP for cut in cuts):
        cuts = sorted([*cuts, fraction])
    lengths = np.diff([*cuts, 1.0]) * law.period
    lags = np.array([whole + 1 if cut < fraction - SNAP else whole for cut in cuts], dtype=np.int64)
    starts = np.cumsum(lengths) - lengths
    inside = [int(np.argmin(np.abs(starts - j * law.period / repeat))) for j in range(repeat)]
    log_index = (np.arange(0, periods, every)[:, np.newaxis] * lengths.size + inside).reshape(-1)[:samples]
    newest = int(np.argmin(lags))
    torque_index = np.minimum(log_index // lengths.size + lags[newest], periods - 1) * lengths.size + newest
    return lengths, lags, log_index, torque_index


def _far(law: SampledLaw, feedforward: FloatArray, after_limit: FloatArray) -> float:
    # Of a fast loop most of the gain within a period is that of the velocity, and holds no position.
    slowly = float(abs(law.feedback(np.array([_SLOWLY / law.period]))[0]))
    gain = min(law.stiffness, slowly)
    if not gain > 0.0:
        return math.inf
    asked = feedforward / gain
    travel = float(np.ptp(asked) + np.max(np.abs(after_limit)) / gain)
    return float(np.max(np.abs(asked))) + _FAR * travel + 1e-9


def seen_torque(experiment: LoopInput, command: FloatArray) -> FloatArray:
    """Torque at the log's tap, (periods,), of the controller's output."""
    return command + experiment.shown if experiment.shows else command


def to_log(experiment: LoopInput, signal: FloatArray) -> FloatArray:
    """Convert a controller signal to the log's torque channel; linear.

    The signal, (periods,) or (periods, columns), is the torque before the delay: piecewise constant over periods, or
    parts of periods.
    """
    if experiment.timing is not Timing.AVERAGED:
        return np.asarray(signal[_sources(experiment, len(signal))[experiment.log_index]])
    lengths = np.tile(experiment.lengths, len(signal)).reshape(-1, *(1,) * (signal.ndim - 1))
    means = averages(experiment, lengths * (shown := acting(experiment, signal)))
    means[0] = shown[0]
    return means


def acting(experiment: LoopInput, signal: FloatArray) -> FloatArray:
    """Signal at the tap in each part of each period, parts in a row."""
    return np.asarray(signal[_sources(experiment, len(signal))])


def _sources(experiment: LoopInput, periods: int) -> NDArray[np.int64]:
    """Return the period of which the signal is at the tap in each part of each period."""
    lags = experiment.lags * (experiment.tap is Tap.MEASURED)
    return np.asarray(np.maximum(np.arange(periods)[:, np.newaxis] - lags, 0).reshape(-1), dtype=np.int64)


def averages(experiment: LoopInput, integrals: FloatArray) -> FloatArray:
    """Mean over each sample time up to a log instant, from integrals over parts."""
    integral = np.zeros((len(integrals) + 1, *integrals.shape[1:]))
    np.cumsum(integrals, axis=0, out=integral[1:])
    means = np.zeros((experiment.log_index.size, *integrals.shape[1:]))
    means[1:] = np.diff(integral[experiment.log_index], axis=0) / experiment.sample_time
    return means
