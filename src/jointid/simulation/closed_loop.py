"""The closed loop, run: `simulate` takes one candidate through an experiment, `simulate_many` many on all cores."""

from __future__ import annotations

import math
import os
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from enum import StrEnum
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from jointid.common.errors import MethodError
from jointid.data.record import Channel, FloatArray, Record, Tap, Timing
from jointid.model.controllers import (
    EXCESS,
    POSITION,
    REFERENCE,
    Cascade,
)
from jointid.model.joints import Motion, RigidJoint
from jointid.simulation.experiment import ClosedLoop, Experiment, prepare

T = TypeVar("T")
R = TypeVar("R")


class Outcome(StrEnum):
    """How a simulation ended; its value is the sentence to print."""

    FINISHED = "the simulation finished"
    DIVERGED = "the loop diverged: this joint is unstable under this controller"
    TOO_STIFF = "the joint's own motion is too fast for the controller's period to be worth simulating"
    CHATTERING = "the joint started and stopped more often within one period than a real one can"
    INVALID = "an inertia or the Coulomb friction is not positive, or a value is not a number"


_OUTCOMES = (Outcome.FINISHED, Outcome.DIVERGED, Outcome.TOO_STIFF, Outcome.CHATTERING)


@dataclass(frozen=True, slots=True)
class Initial:
    """Position and velocity of the motor at the first sample; None: on the reference, at rest."""

    position: float | None = None
    velocity: float | None = None


@dataclass(frozen=True, slots=True, eq=False)
class Response:
    """The torque of one run, all that an estimator compares.

    Attributes:
        torque: (samples,) as the record's torque channel would show it; after a failure, its last value.
        outcome: how the run ended.
        finished: share of the experiment that was simulated.
        events: reversals, stops and starts that were located.
        at_limit: share of the periods in which the controller was at its limit.
    """

    torque: FloatArray
    outcome: Outcome
    finished: float
    events: int
    at_limit: float


@dataclass(frozen=True, slots=True, eq=False)
class Simulation:
    """One run of a loop, at the log's instants.

    Attributes:
        sample_time: seconds between samples.
        torque, outcome, finished, events, at_limit: see `Response`; after a failure everything is held.
        motor_position, motor_velocity: (samples,).
        load_position, load_velocity: (samples,), None for a rigid joint.
        motor, load: motion at the instant each torque begins to act, which is where torque = regressor . parameters
            holds exactly; the load's is None for a rigid joint.
    """

    sample_time: float
    torque: FloatArray
    motor_position: FloatArray
    motor_velocity: FloatArray
    load_position: FloatArray | None
    load_velocity: FloatArray | None
    motor: Motion
    load: Motion | None
    outcome: Outcome
    finished: float
    events: int
    at_limit: float

    @property
    def time(self) -> FloatArray:
        """Instants of the samples, shape (samples,)."""
        return np.asarray(np.arange(self.torque.size) * self.sample_time, dtype=np.float64)


@dataclass(frozen=True, slots=True, eq=False)
class Run:
    """What came out of the kernel, period by period.

    Attributes:
        drive: (14,) the joint's coefficients.
        position, velocity: of the motor at the first sample.
        before: torque that acted before it.
        command: (periods,) output of the controller after its limit.
        states, modes, tape: see `kernels.run`; empty when they were not kept.
        outcome: how it ended.
        counts: events, Taylor steps (rows of the tape), periods simulated, periods at the limit.
    """

    drive: FloatArray
    position: float
    velocity: float
    before: float
    command: FloatArray
    states: FloatArray
    modes: NDArray[np.int8]
    tape: FloatArray
    outcome: Outcome
    counts: NDArray[np.int64]


def run(
    loop: ClosedLoop,
    experiment: Experiment,
    values: Mapping[str, float],
    initial: Initial | None,
    *,
    keep: bool,
    taped: int = 0,
) -> Run:
    """Run one candidate; `keep` its states and modes, and so many rows of its tape."""
    from jointid.simulation import kernels

    initial = initial or Initial()
    law = experiment.law
    position = float(experiment.inputs[0, REFERENCE]) if initial.position is None else initial.position
    velocity = initial.velocity or 0.0
    missing = [p.name for p in loop.joint.parameters if p.name not in values]
    if missing:
        raise MethodError(f"A simulation needs a value for every parameter; {', '.join(missing)} has none: give one.")
    drive = loop.joint.coefficients(values)
    periods, parts = experiment.feedforward.size, experiment.lengths.size
    command = np.empty(periods)
    states = np.empty((periods * parts if keep else 0, 4))
    modes, tape = np.empty(len(states), dtype=np.int8), np.empty((taped, kernels.TAPE))
    counts = np.zeros(4, dtype=np.int64)
    outcome, before = Outcome.INVALID, 0.0
    if _possible(drive) and math.isfinite(position) and math.isfinite(velocity):
        state = law.memory(POSITION, position, velocity)
        first = experiment.feedforward[0] + law.C @ state + law.D[POSITION] * position
        before = min(max(first, -law.limit), law.limit) + experiment.after_limit[0]
        status = kernels.run(
            drive, experiment.lengths, experiment.lags, state, law.A,
            np.ascontiguousarray(law.B[:, POSITION]), np.ascontiguousarray(law.B[:, EXCESS]), law.C,
            law.D[POSITION], law.limit, experiment.feedforward, experiment.after_limit, before,
            loop.joint.start(values, position, velocity), experiment.far + abs(position), command, states, modes, tape,
            counts,
        )  # fmt: skip
        outcome = _OUTCOMES[status]
    done = int(counts[2])
    command[done:] = command[done - 1] if done else 0.0
    states[done * parts :] = states[done * parts - 1] if done and keep else 0.0
    if outcome is Outcome.DIVERGED:  # what diverges may do so beyond the largest number
        np.nan_to_num(command, copy=False, nan=0.0, posinf=0.0, neginf=0.0)
        np.nan_to_num(states, copy=False, nan=0.0, posinf=0.0, neginf=0.0)
    return Run(drive, position, velocity, before, command, states, modes, tape, outcome, counts)


def simulate_torque(
    loop: ClosedLoop, experiment: Experiment, values: Mapping[str, float], initial: Initial | None = None
) -> Response:
    """Run one candidate for its torque alone: as `simulate`, several times faster."""
    return response_of(experiment, run(loop, experiment, values, initial, keep=False))


def response_of(experiment: Experiment, out: Run) -> Response:
    """Return what an estimator sees of a run."""
    return Response(as_logged(experiment, out.command + experiment.shown), out.outcome, *_tally(out))


def simulate(
    loop: ClosedLoop, experiment: Experiment, values: Mapping[str, float], initial: Initial | None = None
) -> Simulation:
    """Run one candidate; never raises for a candidate's sake: see `Response.outcome`.

    Args:
        loop: joint and controller.
        experiment: what they are driven with.
        values: every parameter of the joint by name.
        initial: where the motor is at the first sample.

    Exact to rounding for held torques and friction that is piecewise linear in velocity.
    """
    return simulation_of(loop, experiment, run(loop, experiment, values, initial, keep=True))


def simulation_of(loop: ClosedLoop, experiment: Experiment, out: Run) -> Simulation:
    """Return a run whose states were kept at the log's instants."""
    parts, periods = experiment.lengths.size, out.command.size
    seen = out.states[experiment.looked]
    # The part whose torque is the newest begins where a torque begins to act.
    newest = int(np.argmin(experiment.lags))
    rows = np.minimum(np.arange(periods) + experiment.lags[newest], periods - 1) * parts + newest
    begin = out.states[rows]
    push = out.command + experiment.after_limit
    which = experiment.looked // parts

    def motion(side: int) -> Motion:
        possible = out.outcome is not Outcome.INVALID
        acceleration = _acceleration(out.drive, begin, push, side) if possible else np.zeros(periods)
        return Motion(*(v[which] for v in (begin[:, 2 * side], begin[:, 2 * side + 1], acceleration)))

    flexible = loop.joint.model == "flexible"
    return Simulation(
        experiment.sample_time,
        as_logged(experiment, out.command + experiment.shown),
        seen[:, 0],
        seen[:, 1],
        seen[:, 2] if flexible else None,
        seen[:, 3] if flexible else None,
        motion(0),
        motion(1) if flexible else None,
        out.outcome,
        *_tally(out),
    )


def _tally(out: Run) -> tuple[float, int, float]:
    events, _, done, clipped = (int(count) for count in out.counts)
    return done / out.command.size, events, clipped / max(done, 1)


def _possible(drive: FloatArray) -> bool:
    """Whether a row of coefficients is a drive at all: positive masses, a spring, cones that are not empty."""
    cones = drive[6] + drive[7] >= 0 and drive[10] + drive[11] >= 0
    return bool(np.all(np.isfinite(drive)) and drive[0] > 0 and drive[1] > 0 and min(drive[2:4]) >= 0 and cones)


def as_logged(experiment: Experiment, signal: FloatArray) -> FloatArray:
    """Return a signal of the controller's instants as the log's torque channel shows it; linear in it.

    The signal, (periods,) or (periods, columns), is the controller's output, or at a tap that measures what acts the
    torque before the delay: piecewise constant over periods, or over the parts of periods.
    """
    shown = acting(experiment, signal)
    if experiment.timing is not Timing.AVERAGED:
        return shown if experiment.looked.size == len(shown) else np.asarray(shown[experiment.looked])
    lengths = np.tile(experiment.lengths, len(signal)).reshape(-1, *(1,) * (signal.ndim - 1))
    means = averages(experiment, lengths * shown)
    means[0] = shown[0]
    return means


def acting(experiment: Experiment, signal: FloatArray) -> FloatArray:
    """Return a signal of the controller's instants in each part of each period as the tap sees it, parts in a row."""
    parts = experiment.lengths.size
    if experiment.tap is Tap.MEASURED:
        sources = (np.arange(len(signal))[:, np.newaxis] - experiment.lags).reshape(-1)
        return np.asarray(signal[np.maximum(sources, 0)])
    return signal if parts == 1 else np.repeat(signal, parts, axis=0)


def averages(experiment: Experiment, integrals: FloatArray) -> FloatArray:
    """Return the mean over each sample time that ends at an instant of the log, from the integrals over the parts."""
    integral = np.zeros((len(integrals) + 1, *integrals.shape[1:]))
    np.cumsum(integrals, axis=0, out=integral[1:])
    means = np.zeros((experiment.looked.size, *integrals.shape[1:]))
    means[1:] = np.diff(integral[experiment.looked], axis=0) / experiment.sample_time
    return means


def _acceleration(drive: FloatArray, states: FloatArray, torque: FloatArray, side: int) -> FloatArray:
    """Return the acceleration of the motor (side 0) or load (1) just after `torque` begins to act; 0 at rest."""
    viscous, viscous_back, coulomb, coulomb_back = drive[4 + 4 * side : 8 + 4 * side]
    spring = drive[2] * (states[:, 2] - states[:, 0]) + drive[3] * (states[:, 3] - states[:, 1])
    push = torque - drive[12] + spring if side == 0 else -drive[13] - spring
    velocity = states[:, 1 + 2 * side]
    moving = np.where(velocity != 0, np.sign(velocity), (push > coulomb) * 1.0 - (push < -coulomb_back) * 1.0)
    forwards, backwards = viscous * velocity + coulomb, viscous_back * velocity - coulomb_back
    friction = np.where(moving > 0, forwards, backwards)
    return np.asarray(np.where(moving == 0, 0.0, (push - friction) / drive[side]))


def simulate_many(
    loop: ClosedLoop,
    experiment: Experiment,
    candidates: Sequence[Mapping[str, float]],
    initial: Initial | None = None,
    workers: int | None = None,
) -> list[Response]:
    """Run many candidates for their torque, on all cores (or `workers` of them); the order is kept.

    The compiled kernel releases the interpreter, so threads are enough, and nothing is copied or pickled.
    """
    return in_threads(lambda values: simulate_torque(loop, experiment, values, initial), candidates, workers)


def in_threads(function: Callable[[T], R], items: Sequence[T], workers: int | None = None) -> list[R]:
    """Map a function over items with threads, one per core."""
    workers = min(workers or os.cpu_count() or 1, max(len(items), 1))
    if workers == 1:
        return [function(item) for item in items]
    with ThreadPoolExecutor(workers) as pool:
        return list(pool.map(function, items))


def require_finished(simulation: Simulation) -> Simulation:
    """Return the simulation, or raise a `MethodError` that says how it failed."""
    if simulation.outcome is not Outcome.FINISHED:
        raise MethodError(
            f"The simulation stopped after {100 * simulation.finished:.1f} % of the record because "
            f"{simulation.outcome.value}; check the controller's gains and the parameters' values."
        )
    return simulation


def warm_up() -> None:
    """Compile the simulation, or load it from the cache: what the first simulation would otherwise wait for."""
    loop = ClosedLoop(RigidJoint(), Cascade(kp=1.0, kv=1.0))
    still = Record(reference=Channel(np.zeros(10), "m", 1.0))
    simulate_torque(loop, prepare(loop, still), dict.fromkeys(("inertia", "viscous", "coulomb", "offset"), 1.0))
