"""Simulation of a joint or robot under controllers, and simulated records."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Literal, cast

import numpy as np
from numpy.typing import ArrayLike

from jointid.common.errors import MethodError
from jointid.common.parameters import POSITION_UNIT
from jointid.models.joints import ClosedLoop
from jointid.models.robots.robot import RobotLoop
from jointid.records.record import Channel, Injection, InjectionPoint, Record, Tap, Timing, takes_record
from jointid.simulation.derivatives import columns_of
from jointid.simulation.loop_input import LoopInput, prepare, to_log
from jointid.simulation.plant import Numbers
from jointid.simulation.simulate import MassMotion, Simulation, require_success, run_loop
from jointid.simulation.start import Initial

_ASTRAY = 0.5, 0.1  # of a reference's travel, and rad or m: a joint that is farther off does not follow


@takes_record
def simulate(
    loop: ClosedLoop | RobotLoop,
    record: Record | Sequence[Record] | LoopInput,
    values: Mapping[str, float] | Numbers | None = None,
    initial: Initial | None = None,
    *,
    steps: int | None = None,
) -> Simulation:
    """Simulate a joint or robot under its controllers; failures are an `outcome`.

    Args:
        loop: joint and controller, or robot and controllers.
        record: with the reference and any injection, or the result of `prepare`; for a robot a record of each
            joint. Torques and positions in it are not read.
        values: every parameter of the joint by name; the numbers of a robot, by default its own.
        initial: state of a joint's motor at the first sample.
        steps: of a robot's integrator per part of a period; None keeps the fastest motion below 0.5 rad a step.

    A piecewise linear joint is exact to rounding. All other joints and robots are integrated by a
    Runge-Kutta method of order 4 between located events.

    Raises:
        RecordError: a channel that a controller reads is missing, or a clock does not divide the controllers'.
        MethodError: a robot has an initial state or not one record for each joint, or controllers or logs share no
            clock.
    """
    experiment = record if isinstance(record, LoopInput) else prepare(loop, record)
    if isinstance(loop, ClosedLoop):
        numbers = Numbers.of_joint(loop.joint, cast("Mapping[str, float]", values or {}))
    else:
        numbers = Numbers.of(loop.robot) if values is None else cast("Numbers", values)
        if initial is not None:
            raise MethodError("A robot begins at rest or as its references move; received `initial`: leave it out.")
    return Simulation.of(run_loop(experiment, numbers, initial, keep=True, steps=steps))


def simulated_record(
    loop: ClosedLoop,
    reference: ArrayLike,
    values: Mapping[str, float],
    *,
    sample_time: float,
    reference_velocity: ArrayLike | None = None,
    injected: ArrayLike | None = None,
    at: InjectionPoint | str = InjectionPoint.AFTER_LIMIT,
    in_torque: bool = True,
    disturbance: ArrayLike | None = None,
    torque_noise: ArrayLike | None = None,
    encoder_step: float = 0.0,
    initial: Initial | None = None,
    tap: Tap | str = Tap.COMMAND,
    name: str = "simulation",
) -> Record:
    """Simulate a loop along a reference and return its log.

    Args:
        loop: joint and controller.
        reference: (samples,) commanded position.
        values: every parameter of the joint by name.
        sample_time: of the log, seconds.
        reference_velocity: (samples,) where the controller reads one.
        injected: (samples,) a known signal, logged too.
        at: where it is added, see `Injection`.
        in_torque: whether the logged torque contains it.
        disturbance: (samples,) an unknown force on the motor, inside the loop; not logged.
        torque_noise: (samples,) added to the logged torque only.
        encoder_step: positions are rounded to multiples of it in the log; the loop sees them exactly.
        initial: state of the motor at the first sample.
        tap: where the torque is logged.
        name: of the record.

    Raises:
        MethodError: the loop cannot be simulated with these values, or a disturbance or noise is not as long as the
            reference; the sentence says which.
    """
    kind = loop.joint.kind
    position, force = POSITION_UNIT[kind], loop.joint.force_unit

    def channel(array: ArrayLike, unit: str, timing: Timing = Timing.SAMPLED) -> Channel:
        return Channel(np.asarray(array, dtype=np.float64), unit, sample_time, timing, name)

    given = None if injected is None else channel(injected, force, Timing.HELD)
    driven = Record(
        torque=channel(np.zeros(np.size(reference)), force, Timing.HELD),
        tap=Tap(tap),
        reference=channel(reference, position),
        reference_velocity=None if reference_velocity is None else channel(reference_velocity, f"{position}/s"),
        injected=None if given is None else Injection(given, InjectionPoint(at), in_torque),
        name=name,
    )
    experiment = forced = prepare(loop, driven)
    axis = experiment.axis
    for what, signal in (("disturbance", disturbance), ("torque_noise", torque_noise)):
        if signal is not None and np.size(signal) != np.size(reference):
            raise MethodError(
                f"{what} has a value for each sample of the reference, {np.size(reference)}; received "
                f"{np.size(signal)}: give as many."
            )
    if disturbance is not None:
        extra = np.repeat(np.asarray(disturbance, dtype=np.float64), axis.clock.skips)
        forced = experiment.alone(axis.push(extra[:: axis.clock.shows][: axis.periods]))
    found = require_success(simulate(loop, forced, values, initial))
    # A force from outside is in no current of the motor, though it acts as an injected signal does.
    torque = found.torque - to_log(axis, forced.axis.shown - axis.shown)
    torque = torque if torque_noise is None else torque + np.asarray(torque_noise, dtype=np.float64)[: torque.size]
    moved, load = (
        position if position is None or not encoder_step else np.round(position / encoder_step) * encoder_step
        for position in (found.motor_position, found.load_position)
    )
    assert moved is not None
    return replace(found, torque=torque, motor_position=moved, load_position=load).records([driven], force)[0]


def add_feed_forward(
    loop: RobotLoop, records: Sequence[Record], kind: Literal["gravity", "inverse-model"] = "inverse-model"
) -> tuple[Record, ...]:
    """Inject the robot model's torque along the references before the limits.

    Args:
        loop: robot and controllers; the model is the robot with its own numbers, links and rotors without springs.
        records: one for each joint, with references at one rate.
        kind: the weight alone, or the whole inverse model without Coulomb friction.

    Raises:
        MethodError: a record has no reference, or references differ in rate or length.
    """
    robot, moves = loop.robot.rigid.linear, float(kind == "inverse-model")
    given = [record.reference for record in records if record.reference is not None]
    if len(given) < len(records) or len({(channel.sample_time, len(channel)) for channel in given}) != 1:
        raise MethodError("A feed-forward is computed from references of one rate and one length; give one per joint.")
    sample_time = given[0].sample_time
    q = np.column_stack([channel.values for channel in given])
    v = moves * np.gradient(q, sample_time, axis=0)
    motion = MassMotion(q, v, moves * np.gradient(v, sample_time, axis=0), np.sign(v))
    numbers = Numbers.of(robot)
    keys = [place for place in numbers.not_zero() if place.own != "coulomb"]
    made = []
    for j, (own, columns) in enumerate(columns_of(robot.tree, numbers, keys, motion, range(len(records)))):
        values = columns @ [numbers[keys[c]] for c in own]
        torque = Channel(values, robot.torque_unit(j), sample_time, Timing.HELD, "computed")
        made.append(replace(records[j], injected=Injection(torque, InjectionPoint.BEFORE_LIMIT)))
    return tuple(made)


def tracking_errors(records: Sequence[Record], run: Simulation) -> dict[int, float]:
    """Largest deviation, rad or m, of each joint not following its reference.

    A joint follows if it stays within half of its reference's travel plus 0.1 rad or m. A slow loop or a weight stays
    within these limits; a joint without gains falls.
    """
    at, found = np.arange(len(run.motor_position)) * run.sample_time, {}
    for j, record in enumerate(records):
        if record.reference is not None:
            reference = np.interp(at, record.reference.time, record.reference.values)
            off = float(np.max(np.abs(run.motor_position[:, j] - reference)))
            if off > _ASTRAY[0] * np.ptp(reference) + _ASTRAY[1]:
                found[j] = off
    return found
