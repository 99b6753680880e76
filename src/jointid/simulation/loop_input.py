"""Parameter-independent inputs of closed-loop simulations of axes, and their logs.

`prepare` lowers each controller to its sampled law, computes its response to its reference, and cuts the steps of the
clock that the controllers share at changes of their torques and at log instants. A joint is a robot of one axis without
a tree.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from copy import copy
from dataclasses import dataclass, field, fields, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from jointid.common.arrays import FloatArray
from jointid.common.errors import MethodError, RecordError
from jointid.common.text import join
from jointid.models.controllers import (
    INJECTED,
    POSITION,
    REFERENCE,
    Controller,
    Interpolation,
    SampledLaw,
    law_inputs,
    respond,
    shift_start,
)
from jointid.models.joints import ClosedLoop
from jointid.models.linear import SNAP
from jointid.models.robots.robot import RobotLoop, Tree
from jointid.records.record import InjectionPoint, Record, Tap, Timing, require_units
from jointid.records.resampling import at_period, period_ratio, running_mean
from jointid.simulation.kernels import SampledLoop
from jointid.simulation.plant import DELAY, Numbers

_FEWEST = 10  # periods that can be simulated to any purpose
_SLOWLY = 1e-4  # of the sampling frequency: there a loop holds its position
_FAR = 1e3  # times the commanded travel: a motor this far away will not come back
_FINEST = 16  # steps of the shortest period, at most: the time of a simulation grows with them
_FIRST = 7  # instants of a reference, through which a cubic says how it moves


@dataclass(frozen=True, slots=True, eq=False)
class Clock:
    """The clock of controllers, and of the log.

    Attributes:
        steps: number of simulated steps.
        lengths: (parts,) of a step [s]. Within a part no torque changes, and the log has no instant.
        lags: (axes, parts) how many steps ago the output that acts there was put out, or a later one that is held.
        every: (axes,) steps of each controller's period.
        sample_time: of the log, s, which is every `skips`-th step, or shows each step `shows` times.
        log_index: (samples,) number of the part that begins at each instant of the log, counted over all steps.
        torque_index: (axes, samples) those at which the newest torque of each axis, as the log shows it, begins to act.
    """

    steps: int
    lengths: FloatArray
    lags: NDArray[np.int64]
    every: NDArray[np.int64]
    sample_time: float
    skips: int
    shows: int
    log_index: NDArray[np.intp]
    torque_index: NDArray[np.intp]

    @classmethod
    def of(cls, laws: Sequence[SampledLaw], step: float, steps: int, sample_time: float, samples: int) -> Clock:
        """Cut the steps at the laws' delays and at log instants."""
        shows, skips = period_ratio(step, sample_time, "the log")
        late = np.array([law.delay / step for law in laws])
        whole = np.floor(late + SNAP)
        within = np.where(late - whole < SNAP, 0.0, late - whole)
        cuts = [j / shows for j in range(shows)]
        for cut in within.tolist():
            cuts += [cut] if all(abs(cut - one) > SNAP for one in cuts) else []
        cuts.sort()
        lengths, parts = np.diff([*cuts, 1.0]) * step, len(cuts)
        lags = (whole[:, np.newaxis] + (np.array(cuts) < within[:, np.newaxis] - SNAP)).astype(np.int64)
        every = np.array([round(law.period / step) for law in laws], dtype=np.int64)
        starts = np.cumsum(lengths) - lengths
        inside = [int(np.argmin(np.abs(starts - j * step / shows))) for j in range(shows)]
        log_index = (np.arange(0, steps, skips)[:, np.newaxis] * parts + inside).reshape(-1)[:samples]
        newest, at = np.argmin(lags, axis=1)[:, np.newaxis], log_index // parts
        put_out = at // every[:, np.newaxis] * every[:, np.newaxis] + np.take_along_axis(lags, newest, axis=1)
        torque_index = np.minimum(put_out, steps - 1) * parts + newest
        return cls(steps, lengths, lags, every, sample_time, skips, shows, log_index, torque_index)

    @property
    def samples(self) -> int:
        """Of the log."""
        return self.log_index.size

    def repeat(self, axis: int, values: FloatArray) -> FloatArray:
        """Return values of a controller's periods at every step, (steps,)."""
        return np.repeat(values, self.every[axis])[: self.steps]

    def own(self, axis: int, values: FloatArray, periods: int) -> FloatArray:
        """Values of steps at a controller's periods, (periods, ...), the last held."""
        every = int(self.every[axis])
        if every == 1 and len(values) == periods:
            return values
        return np.asarray(values[np.minimum(np.arange(periods) * every, (len(values) - 1) // every * every)])


@dataclass(frozen=True, slots=True, eq=False)
class AxisInput:
    """Inputs of one controller, at its own instants; see `prepare`.

    Attributes:
        controller: as declared. law: its state-space form.
        inputs: (periods, INPUTS) of the law, with a column of zeros for the position.
        after_limit: (periods,) addition to the output, in the log or not, see `logged`.
        logged: (periods,) the part of `after_limit` that the logged torque contains.
        sample_time: of the log, s. samples: of it.
        tap: where the torque is logged. timing: what a logged value is.
        begin: seconds from the first sample of the record's file to the first here, see `Record`.
        clock: of this controller alone.
        feedback: motion-dependent part of the law. integral: (states,) see `SampledLaw.integral`.
        memory: (states, 2) of the feedback at the first period, from a motor position of 1 before, and from a velocity
            of 1.
        feedforward: (elements, periods) response of the law's elements to all inputs except the position.
        driven: (periods, states) further inputs of the feedback's states, used if the response would diverge, as of an
            integrator; else (0, states).
        state: (states,) of the feedback at the first period, without the part of the position.
    """

    controller: Controller
    law: SampledLaw
    inputs: FloatArray
    after_limit: FloatArray
    logged: FloatArray
    sample_time: float
    samples: int
    tap: Tap
    timing: Timing
    begin: float
    clock: Clock = field(init=False)
    feedback: SampledLaw = field(init=False)
    integral: FloatArray | None = field(init=False)
    memory: FloatArray = field(init=False)
    feedforward: FloatArray = field(init=False)
    driven: FloatArray = field(init=False)
    state: FloatArray = field(init=False)

    def __post_init__(self) -> None:
        law, inputs = self.law, self.inputs
        (feedback, beforehand), state = law.split(), law.known_memory(inputs)
        if law.integrates:
            moved, elements = law.fed_back(), law.limits.size
            found = respond(beforehand, inputs, state[~moved])
            driven, feedforward, state = found[:, elements:], found[:, :elements].T, state[moved]
        else:
            driven, feedforward = np.zeros((0, feedback.order)), respond(law, inputs, state).T
            state = np.zeros(feedback.order)
        memory = np.column_stack([feedback.memory(POSITION, 1.0, 0.0), feedback.memory(POSITION, 0.0, 1.0)])
        clock = Clock.of([law], law.period, len(inputs), self.sample_time, self.samples)
        made = (clock, feedback, feedback.integral(), memory, feedforward, driven, state)
        for one, value in zip((one for one in fields(self) if not one.init), made, strict=True):
            object.__setattr__(self, one.name, value)

    @property
    def periods(self) -> int:
        """Number of simulated controller periods."""
        return len(self.inputs)

    @property
    def shown(self) -> FloatArray:
        """Part of the logged torque in addition to the controller's output, (periods,)."""
        return self.after_limit if self.tap is Tap.MEASURED else self.logged

    @property
    def reference_motion(self) -> tuple[float, float]:
        """Velocity and acceleration of the reference at its first sample."""
        reference = self.inputs[:_FIRST, REFERENCE]
        cubic = np.polyfit(np.arange(reference.size) * self.law.period, reference - reference[0], 3)
        return float(cubic[2]), float(2.0 * cubic[1])

    @property
    def by_motion(self) -> FloatArray:
        """Initial output per unit initial motor position and velocity, (2,)."""
        law = self.feedback
        return np.asarray(law.C[0, law.output] @ self.memory + np.array([law.D[0, law.output, POSITION], 0.0]))

    def push(self, torque: FloatArray) -> AxisInput:
        """Return the inputs with a further torque behind the limit, (periods,)."""
        found = copy(self)
        object.__setattr__(found, "after_limit", self.after_limit + torque)
        return found

    def law_of(self, controller: Controller) -> SampledLaw:
        """Law of a controller with its phase relative to the record's file."""
        return shift_start(controller, self.begin).law(self.sample_time)


@dataclass(frozen=True, slots=True, eq=False)
class LoopInput:
    """Parameter-independent inputs of a simulation of all axes; made by `prepare`.

    Attributes:
        axes: input of each axis.
        clock: common to their controllers.
        sampled: controllers and inputs as the kernels read them.
        tree: of the links (`models.robots.equations`), None of a joint.
        speeds, accelerations: (n,) of the shafts at the first sample of a robot.
        payload: (10,) inertial parameters of a known payload on the last link, or ().
        far: (n,) distance from each initial motor position beyond which a loop has diverged.
    """

    axes: tuple[AxisInput, ...]
    tree: Tree | None
    speeds: FloatArray
    accelerations: FloatArray
    payload: tuple[float, ...] = ()
    names: tuple[str, ...] = ("",)
    clock: Clock = field(init=False)
    sampled: SampledLoop = field(init=False)
    far: FloatArray = field(init=False)

    def __post_init__(self) -> None:
        clock = _share_clock(self.axes, self.names)
        post = _fill_up([clock.repeat(j, each.after_limit) for j, each in enumerate(self.axes)])
        sampled = SampledLoop(clock.lengths, clock.lags, clock.every, **_pack_laws(self.axes), post=post)
        object.__setattr__(self, "clock", clock)
        object.__setattr__(self, "sampled", sampled)
        object.__setattr__(self, "far", np.array([_far(each) for each in self.axes]))

    @property
    def axis(self) -> AxisInput:
        """The axis of a joint."""
        return self.axes[0]

    @property
    def references(self) -> FloatArray:
        """Commanded positions per step, (steps, n), held between the controllers' instants."""
        held = [self.clock.repeat(j, each.inputs[:, REFERENCE]) for j, each in enumerate(self.axes)]
        return np.column_stack(held)

    def alone(self, axis: AxisInput) -> LoopInput:
        """Return the inputs of a joint with another axis."""
        return replace(self, axes=(axis,))

    def under(self, controller: Controller) -> LoopInput:
        """Inputs of a joint under another controller of equal period and delay."""
        return self.alone(replace(self.axis, law=self.axis.law_of(controller), controller=controller))

    def delayed(self, numbers: Numbers) -> LoopInput:
        """Inputs of a robot with the torque delays among its numbers."""
        late = [own.get(DELAY) for own in numbers.values]
        if self.tree is None or all(one is None for one in late):
            return self
        each = zip(self.axes, late, strict=True)
        later = (one if by is None else replace(one, law=replace(one.law, delay=float(by))) for one, by in each)
        return replace(self, axes=tuple(later))

    def to_log(self, signals: FloatArray) -> FloatArray:
        """Logged torques, (samples, n), of torques per step, (n, steps)."""
        clock, axes = self.clock, enumerate(self.axes)
        found = [to_log(each, clock.own(j, signals[j], each.periods) + each.shown)[: clock.samples] for j, each in axes]
        return np.column_stack(found) if len(found) > 1 else found[0][:, np.newaxis]  # without a copy


def prepare(loop: ClosedLoop | RobotLoop, record: Record | Sequence[Record]) -> LoopInput:
    """Prepare the inputs of a closed-loop simulation.

    Args:
        loop: joint and controller, or robot and controllers.
        record: of a joint; or one for each joint of a robot, of one log: its reference and injection.

    Raises:
        RecordError: a channel that a controller reads is missing, or its clock does not divide the controller's.
        MethodError: there is not one record for each joint, or controllers or logs share no clock.
    """
    loops = loop.loops
    records = (record,) if isinstance(record, Record) else tuple(record)
    if len(records) != len(loops):
        raise MethodError(
            f"A simulation takes a record of each joint, {len(loops)}, in order; received {len(records)}."
        )
    axes = tuple(map(_prepare_axis, loops, records))
    if isinstance(loop, ClosedLoop):
        return LoopInput(axes, None, np.zeros(1), np.zeros(1))
    motion = np.array([each.reference_motion if loop.in_motion else (0.0, 0.0) for each in axes]).T.copy()
    return LoopInput(axes, loop.robot.tree, motion[0], motion[1], records[-1].payload, loop.robot.names)


def along(
    law: SampledLaw, inputs: FloatArray, position: FloatArray, speed: float = 0.0
) -> tuple[FloatArray, FloatArray]:
    """A law's inputs with a motor position, (periods,), and initial states."""
    inputs = inputs.copy()
    inputs[:, POSITION] = position
    return inputs, law.known_memory(inputs) + law.memory(POSITION, float(position[0]), speed)


def _prepare_axis(loop: ClosedLoop, record: Record) -> AxisInput:
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
    return AxisInput(
        loop.controller, law, inputs, after, logged, log.sample_time, samples, record.tap, timing, record.begin
    )


def _share_clock(axes: Sequence[AxisInput], names: Sequence[str]) -> Clock:
    """Return the clock of controllers, each with its own.

    Raises:
        MethodError: logs differ in rate or length, or the periods have no common step that is worth simulating.
    """
    if len(axes) == 1:
        return axes[0].clock
    periods, rates = np.array([(each.law.period, each.sample_time) for each in axes]).T
    lasts = np.array([each.periods for each in axes]) * periods
    longest = max(float(np.max(periods)), rates[0])
    apart = (np.abs(rates - rates[0]) > SNAP * rates[0]) | (np.abs(lasts - lasts[0]) > (1 + SNAP) * longest)
    if np.any(apart):
        raise MethodError(
            f"A robot is simulated along one log; the records of {join(np.array(names)[apart].tolist())} differ from "
            f"that of {names[0]} in sample time or length: give all joints the same."
        )
    shortest = float(np.min(periods))
    ratios = periods / shortest
    finest = (n for n in range(1, _FINEST + 1) if np.allclose(n * ratios, np.round(n * ratios), rtol=SNAP, atol=0.0))
    step = next((shortest / n for n in finest), None)
    if step is None:
        said = join([f"{name} {1e3 * period:.6g} ms" for name, period in zip(names, periods, strict=True)])
        raise MethodError(
            f"A robot's controllers share a clock, of which each period is so many steps; received {said}, and no step "
            f"of a {_FINEST}th of the shortest or more divides them: correct the periods."
        )
    steps = min(each.periods * round(each.law.period / step) for each in axes)
    samples = min(each.clock.samples for each in axes)
    return Clock.of([each.law for each in axes], step, steps, axes[0].sample_time, samples)


def _pack_laws(axes: Sequence[AxisInput]) -> dict[str, NDArray[Any]]:
    """Controllers as arrays of `SampledLoop`, with responses to all inputs except positions."""
    laws = [each.feedback for each in axes]
    phases = math.lcm(*(law.phases for law in laws))
    longest = max(each.periods for each in axes) if any(each.driven.size for each in axes) else 0

    def repeat(name: str) -> FloatArray:
        each = [getattr(law, name[0]) for law in laws]
        of_position = [one[:, :, POSITION] if name in ("Bq", "D") else one for one in each]
        return _fill_up([np.concatenate([one] * (phases // len(one))) for one in of_position])

    return {name: repeat(name) for name in ("A", "Bq", "F", "C", "D", "E")} | {
        "limits": _fill_up([law.limits for law in laws], math.inf),
        "gates": _fill_up([law.gates for law in laws], -1),
        "driven": _fill_up([each.driven for each in axes], 0.0, (longest, 0)),
        "output": np.array([law.output for law in laws]),
        "w": _fill_up([each.feedforward for each in axes]),
    }


def _fill_up(arrays: Sequence[NDArray[Any]], beyond: float = 0.0, least: tuple[int, ...] = ()) -> NDArray[Any]:
    """Stack arrays, each padded to the largest sizes."""
    sizes = np.max([array.shape for array in arrays] + ([least] if least else []), axis=0)
    whole = np.full((len(arrays), *sizes), beyond, dtype=arrays[0].dtype)
    for one, own in zip(whole, arrays, strict=True):
        one[tuple(slice(size) for size in own.shape)] = own
    return whole


def _far(axis: AxisInput) -> float:
    # Of a fast loop most of the gain within a period is that of the velocity, and holds no position.
    law = axis.law
    gain = min(law.stiffness, float(abs(law.feedback(np.array([_SLOWLY / law.period]))[0])))
    if not gain > 0.0:
        return math.inf
    asked = axis.feedforward[law.output] / gain
    travel = float(np.ptp(asked) + np.max(np.abs(axis.after_limit)) / gain)
    return float(np.max(np.abs(asked))) + _FAR * travel + 1e-9


def to_log(axis: AxisInput, signal: FloatArray) -> FloatArray:
    """Convert a controller signal to the logged torque (linear; maybe a view).

    The signal, (periods,) or (periods, columns), is the torque before the delay: piecewise constant over periods.
    """
    clock = axis.clock
    if axis.timing is not Timing.AVERAGED:
        plain = clock.skips == clock.lengths.size == 1 and not (axis.tap is Tap.MEASURED and np.any(clock.lags))
        return signal[: clock.samples] if plain else np.take(signal, _sources(axis, len(signal))[clock.log_index], 0)
    lengths = np.tile(axis.clock.lengths, len(signal)).reshape(-1, *(1,) * (signal.ndim - 1))
    means = averages(axis, lengths * (shown := acting(axis, signal)))
    means[0] = shown[0]
    return means


def acting(axis: AxisInput, signal: FloatArray) -> FloatArray:
    """Signal at the tap in each part of each period, flattened."""
    return np.take(signal, _sources(axis, len(signal)), axis=0)


def _sources(axis: AxisInput, periods: int) -> NDArray[np.int64]:
    """Source period of the signal at the tap, for each part."""
    lags = axis.clock.lags[0] * (axis.tap is Tap.MEASURED)
    return np.asarray(np.maximum(np.arange(periods)[:, np.newaxis] - lags, 0).reshape(-1), dtype=np.int64)


def averages(axis: AxisInput, integrals: FloatArray) -> FloatArray:
    """Mean over each sample time before a log instant, from partial integrals."""
    integral, log_index = np.zeros((len(integrals) + 1, *integrals.shape[1:])), axis.clock.log_index
    np.cumsum(integrals, axis=0, out=integral[1:])
    means = np.zeros((log_index.size, *integrals.shape[1:]))
    means[1:] = np.diff(integral[log_index], axis=0) / axis.sample_time
    return means
