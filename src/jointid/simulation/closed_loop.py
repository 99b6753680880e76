"""Closed-loop simulation of one candidate."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from enum import StrEnum
from typing import TYPE_CHECKING, Protocol, TypeVar

import numpy as np

from jointid.common.arrays import FloatArray, Room
from jointid.common.errors import MethodError
from jointid.models.controllers import POSITION, REFERENCE
from jointid.models.joints import ClosedLoop
from jointid.models.position_forces import Motion
from jointid.simulation.loop_input import LoopInput, seen_torque, to_log

if TYPE_CHECKING:
    from jointid.simulation.kernels.drive import Trace
    from jointid.simulation.kernels.engine import Plant


class Outcome(StrEnum):
    """Outcome of a simulation; its value is the sentence to print."""

    FINISHED = "the simulation finished"
    DIVERGED = "the loop diverged: it is unstable under its controllers"
    TOO_STIFF = "the motion is too fast for the period of controllers or log to be worth simulating"
    CHATTERING = "a joint started and stopped more often within one period than a real one can"
    NOT_POSITIVE = "its mass matrix is not positive definite in a pose that it reached: no robot has such inertias"
    INVALID = (
        "an inertia or the Coulomb friction is not positive, friction at rest or at the end of the record is less than "
        "nothing, a Stribeck speed is 0, the torques of a spring's pieces do not rise, something winds up over less "
        "than nothing, a share of the torque or of the load is 1 or more, or a value is not a number"
    )


OUTCOMES = tuple(Outcome)
"""How a run ended, by the number that a kernel returns."""

_HARDLY = 0.01  # of the reference's largest speed: at less a friction has not wound up before the first sample


class _Ended(Protocol):
    @property
    def outcome(self) -> Outcome: ...

    @property
    def finished(self) -> float: ...


Run = TypeVar("Run", bound=_Ended)


def require_success(run: Run, of_what: str = "The simulation") -> Run:
    """Return a run that finished.

    Raises:
        MethodError: it failed; the sentence states progress and reason.
    """
    if run.outcome is not Outcome.FINISHED:
        raise MethodError(
            f"{of_what} stopped after {100 * run.finished:.1f} % of the record because {run.outcome.value}; check the "
            "controller's gains and the parameters' values."
        )
    return run


@dataclass(frozen=True, slots=True)
class Initial:
    """Motor position and velocity at the first sample; None: on the reference, at rest.

    `torque` is the output of an integral there; None: its content is 0.
    """

    position: float | None = None
    velocity: float | None = None
    torque: float | None = None


@dataclass(frozen=True, slots=True, eq=False)
class Response:
    """The torque of one run, for an estimator.

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
class Simulation(Response):
    """One run at the log's instants; held after a failure.

    Attributes:
        sample_time: seconds between samples.
        push: (samples,) torque on the motor by controller and injection, before the delay, whatever the log shows.
        motor_position, motor_velocity: (samples,).
        load_position, load_velocity: (samples,), None for a rigid joint.
        motor, load: motion at the instant each torque begins to act, which is where torque = regressor . parameters
            holds exactly; the load's is None for a rigid joint.
    """

    sample_time: float
    push: FloatArray
    motor_position: FloatArray
    motor_velocity: FloatArray
    load_position: FloatArray | None
    load_velocity: FloatArray | None
    motor: Motion
    load: Motion | None


@dataclass(frozen=True, slots=True, eq=False)
class ClosedLoopRun:
    """The kernel's output, period by period.

    Attributes:
        drive: (14,) the joint's coefficients.
        plant: numbers of a joint whose laws are not all lines, which is simulated by `kernels.engine`; or None.
        position, velocity: of the motor at the first sample. torque: the controller's there, where that is said.
        sliding: direction of a motion that began before it; 0 of none.
        before: torque that acted before the first period.
        trace: what the kernel wrote. Of a plant there are no modes, and the tape is that of `kernels.engine`.
        accelerations: (periods * parts, 2) of motor and load just after each torque begins to act, of a plant that was
            kept.
    """

    loop: ClosedLoop
    experiment: LoopInput
    values: Mapping[str, float]
    drive: FloatArray
    plant: Plant | None
    position: float
    velocity: float
    torque: float | None
    sliding: float
    before: float
    trace: Trace
    accelerations: FloatArray
    outcome: Outcome

    def start(self, values: Mapping[str, float], position: float, velocity: float) -> FloatArray:
        """Return the first state of such a run, (4,): `start_state`."""
        return start_state(self.loop, values, position, velocity, self.sliding)

    def response(self) -> Response:
        """Signals for an estimator."""
        torque = to_log(self.experiment, seen_torque(self.experiment, self.trace.u))
        events, _, done, clipped = self.trace.counts.tolist()
        return Response(torque, self.outcome, done / self.trace.u.size, events, clipped / max(done, 1))

    def simulation(self) -> Simulation:
        """The run with states, at the log's instants."""
        experiment, response = self.experiment, self.response()
        flexible = self.loop.joint.model == "flexible"
        states, push = self.trace.states[:, : 4 if flexible else 2], self.trace.u + experiment.after_limit
        accelerations = self.accelerations
        seen = begin = states.T.copy()
        if experiment.log_index.size < len(states) or experiment.lengths.size > 1 or experiment.lags[0] > 0:
            seen, begin = (states[at].T.copy() for at in (experiment.log_index, experiment.torque_index))
            push = push[experiment.log_index // experiment.lengths.size]
            accelerations = accelerations[experiment.torque_index] if self.plant is not None else accelerations

        def motion(side: int) -> Motion:
            found = np.zeros(push.size)
            if self.outcome is not Outcome.INVALID and self.plant is None:
                found = _acceleration(self.drive, begin, push, side)
            elif self.outcome is not Outcome.INVALID:
                found = accelerations[:, side].copy()
            return Motion(begin[2 * side], begin[2 * side + 1], found)

        return Simulation(
            response.torque,
            response.outcome,
            response.finished,
            response.events,
            response.at_limit,
            experiment.sample_time,
            push,
            motor_position=seen[0],
            motor_velocity=seen[1],
            load_position=seen[2] if flexible else None,
            load_velocity=seen[3] if flexible else None,
            motor=motion(0),
            load=motion(1) if flexible else None,
        )


def run(
    loop: ClosedLoop,
    experiment: LoopInput,
    values: Mapping[str, float],
    initial: Initial | None,
    *,
    keep: bool,
    taped: int = 0,
    room: Room | None = None,
) -> ClosedLoopRun:
    """Run one candidate; optionally keep states, modes and a tape, in given memory."""
    from jointid.simulation.kernels import drive as kernels
    from jointid.simulation.plant import integrate, is_possible, motion_of, plant_of

    initial, joint = initial or Initial(), loop.joint
    law = experiment.law
    position = float(experiment.inputs[0, REFERENCE]) if initial.position is None else initial.position
    velocity = initial.velocity or 0.0
    try:
        drive, plant = joint.coefficients(values), None if joint.straight else plant_of(joint, values)
    except KeyError:
        missing = ", ".join(p.name for p in joint.parameters if p.name not in values)
        raise MethodError(f"A simulation needs a value for every parameter; {missing} has none: give one.") from None
    periods, parts, elements = experiment.periods, experiment.lengths.size, law.limits.size
    kept, array = periods * parts if keep else 0, (room or Room()).array
    accelerations = array("accelerations", (kept if plant else 0, 2))
    trace = kernels.Trace(
        np.zeros(periods),  # never in a room: it may be an answer
        array("excess", (periods if keep else 0, elements)),
        array("states", (kept, 4)),
        array("modes", (kept,), np.int16),
        array("tape", (0 if plant else taped, kernels.TAPE)),
        np.zeros(4, dtype=np.int64),
    )
    outcome, before, sliding = Outcome.INVALID, 0.0, 0.0
    possible = _possible(drive) if plant is None else is_possible(plant, periods * law.period)
    if possible and math.isfinite(position) and math.isfinite(velocity):
        state, first = first_state(experiment, position, velocity, initial.torque)
        before = first + experiment.after_limit[0]
        sliding = wound_up(experiment, velocity)
        start = start_state(loop, values, position, velocity, sliding)
        sampled, far = experiment.sampled, experiment.far + abs(position)
        if plant is None:
            status = kernels.run(drive, sampled, before, state[np.newaxis], start, far, trace)
        else:
            masses = len(plant.masses)
            side = np.minimum(np.arange(masses), 1)  # what swings begins with the load
            found = integrate(
                plant, None, np.zeros((0, 10)), sampled, np.array([before]), np.array([far]), state[np.newaxis],
                start[2 * side], start[2 * side + 1], np.full(masses, sliding), keep=keep, room=room,
            )  # fmt: skip
            status, shown = found.status, min(masses, 2)
            trace = kernels.Trace(
                found.command[0], found.excess[0], trace.states, trace.modes, found.tape, found.counts
            )
            if keep:
                moved = motion_of(found.tape, masses, int(found.counts[2]) * parts)
                trace.states[:] = 0.0
                trace.states[: len(moved[0]), : 2 * shown : 2] = moved[0][:, :shown]
                trace.states[: len(moved[0]), 1 : 2 * shown : 2] = moved[1][:, :shown]
                accelerations[: len(moved[0]), :shown] = moved[2][:, :shown]
        outcome = OUTCOMES[status]
    done = int(trace.counts[2])
    trace.u[done:] = trace.u[done - 1] if done else 0.0
    trace.excess[done:] = 0.0
    trace.states[done * parts :] = trace.states[done * parts - 1] if done and keep else 0.0
    accelerations[done * parts :] = 0.0
    if outcome is Outcome.DIVERGED:  # divergence may overflow
        for signal in (trace.u, trace.excess, trace.states, accelerations):
            np.nan_to_num(signal, copy=False, nan=0.0, posinf=0.0, neginf=0.0)
    return ClosedLoopRun(
        loop, experiment, values, drive, plant, position, velocity, initial.torque, sliding, before, trace,
        accelerations, outcome,
    )  # fmt: skip


def first_state(
    experiment: LoopInput, position: float, velocity: float, torque: float | None
) -> tuple[FloatArray, float]:
    """Feedback states at the first period, (states,), and the torque before it."""
    law, integral = experiment.feedback, experiment.integral
    state = experiment.state + experiment.memory @ np.array([position, velocity])
    first = float(experiment.feedforward[law.output, 0] + law.C[0, law.output] @ state)
    first += float(law.D[0, law.output, POSITION] * position)
    if integral is not None and torque is not None:
        state = state + integral * (torque - first)
        first = torque
    return state, min(max(first, -law.limit), law.limit)


def simulate_torque(
    loop: ClosedLoop, experiment: LoopInput, values: Mapping[str, float], initial: Initial | None = None
) -> Response:
    """Run one candidate for its torque alone: as `simulate`, several times faster."""
    return run(loop, experiment, values, initial, keep=False).response()


def simulate(
    loop: ClosedLoop, experiment: LoopInput, values: Mapping[str, float], initial: Initial | None = None
) -> Simulation:
    """Simulate one candidate; failures are in `Response.outcome`.

    Args:
        loop: joint and controller.
        experiment: its inputs.
        values: every parameter of the joint by name.
        initial: where the motor is at the first sample.

    Exact to rounding for held torques where all laws are lines (`Joint.straight`). Others use a Runge-Kutta method,
    whose torque is within some 1e-5 of its peak.
    """
    return run(loop, experiment, values, initial, keep=True).simulation()


def _possible(drive: FloatArray) -> bool:
    """Test for a physical drive: positive masses and non-negative friction and stiffness."""
    row = drive.tolist()  # a few plain numbers take less time than an array of them
    cones = row[6] + row[7] >= 0 and row[10] + row[11] >= 0
    return all(map(math.isfinite, row)) and min(row[:2]) > 0 and min(row[2:4]) >= 0 and cones


def start_state(
    loop: ClosedLoop, values: Mapping[str, float], position: float, velocity: float, sliding: float
) -> FloatArray:
    """State at rest or in steady motion, (4,), with unwound presliding friction at rest."""
    start = loop.joint.start(values, position, velocity)
    if loop.joint.stepped and not sliding:
        start[::2] = loop.joint.start(values, position, 0.0)[::2]
    return start


def wound_up(experiment: LoopInput, velocity: float) -> float:
    """Direction of a motion before the first sample, 0 if negligible."""
    reference = experiment.inputs[:, REFERENCE]
    fastest = float(np.max(np.abs(np.diff(reference)), initial=0.0)) / experiment.law.period
    return math.copysign(1.0, velocity) if abs(velocity) > _HARDLY * fastest > 0.0 else 0.0


def _acceleration(drive: FloatArray, states: FloatArray, torque: FloatArray, side: int) -> FloatArray:
    """Acceleration of motor (0) or load (1) just after `torque` acts; 0 at rest."""
    viscous, viscous_back, coulomb, coulomb_back = drive[4 + 4 * side : 8 + 4 * side]
    push = torque - drive[12] if side == 0 else np.zeros(torque.size) - drive[13]
    if np.any(drive[2:4] != 0.0):
        spring = drive[2] * (states[2] - states[0]) + drive[3] * (states[3] - states[1])
        push = push + spring if side == 0 else push - spring
    velocity = states[1 + 2 * side]
    moving = np.sign(velocity)
    still = np.flatnonzero(velocity == 0)
    moving[still] = (push[still] > coulomb) * 1.0 - (push[still] < -coulomb_back) * 1.0
    forwards = moving > 0
    friction = np.where(forwards, viscous, viscous_back) * velocity + np.where(forwards, coulomb, -coulomb_back)
    push -= friction
    push /= drive[side]
    push[still[moving[still] == 0]] = 0.0
    return np.asarray(push)
