"""Simulation of a joint or a robot under its controllers, and the records that its drives would log."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, overload

import numpy as np
from numpy.typing import ArrayLike

from jointid.common.arrays import FloatArray
from jointid.common.errors import MethodError
from jointid.common.parameters import POSITION_UNIT
from jointid.models.joints import ClosedLoop
from jointid.records.record import Channel, Injection, InjectionPoint, Record, Tap, Timing
from jointid.simulation.closed_loop import Initial, Simulation, require_success
from jointid.simulation.closed_loop import simulate as simulate_joint
from jointid.simulation.loop_input import LoopInput, prepare, to_log

if TYPE_CHECKING:  # a joint needs no kernel of a robot
    from jointid.simulation.robot_numbers import RobotNumbers
    from jointid.simulation.robots import RobotLoop, RobotSimulation


@overload
def simulate(
    loop: ClosedLoop, record: Record | LoopInput, values: Mapping[str, float], initial: Initial | None = None
) -> Simulation: ...


@overload
def simulate(
    loop: RobotLoop, record: Sequence[Record], values: RobotNumbers | None = None, *, steps: int | None = None
) -> RobotSimulation: ...


def simulate(
    loop: ClosedLoop | RobotLoop,
    record: Record | LoopInput | Sequence[Record],
    values: Mapping[str, float] | RobotNumbers | None = None,
    initial: Initial | None = None,
    *,
    steps: int | None = None,
) -> Simulation | RobotSimulation:
    """Simulate a joint or a robot under its controllers; a failure is the simulation's `outcome`.

    Args:
        loop: joint and controller, or robot and controllers.
        record: with the reference and what is injected, or what `prepare` makes of it; for a robot a record of each
            joint. Torques and positions in it are not read.
        values: every parameter of the joint by name; the numbers of a robot, by default its own.
        initial: where the motor of a joint is at the first sample.
        steps: of a robot's integrator per part of a period; None keeps the fastest motion below 0.5 rad a step.

    A joint with piecewise linear laws is exact to rounding. Position-dependent gravity is held over each part of a
    period, with second-order error. Smooth laws and robots are integrated by a Runge-Kutta method of order
    4 between located events.

    Raises:
        RecordError: a channel that a controller reads is missing, or a clock does not divide the controllers'.
        MethodError: there is not one record for each joint of a robot, or controllers or logs share no clock.
    """
    if isinstance(loop, ClosedLoop):
        if isinstance(record, Sequence) or not isinstance(values, Mapping):
            raise MethodError("A joint is simulated from one record, with the value of each parameter by name.")
        prepared = record if isinstance(record, LoopInput) else prepare(loop, record)
        return simulate_joint(loop, prepared, values, initial)
    from jointid.simulation.robot_numbers import RobotNumbers
    from jointid.simulation.robots import RobotLoop, prepare_robot, run_robot, simulation_of

    if not (isinstance(loop, RobotLoop) and isinstance(record, Sequence) and isinstance(values, RobotNumbers | None)):
        raise MethodError(
            "A robot is simulated from its RobotLoop, a record of each joint and RobotNumbers; give these."
        )
    numbers = RobotNumbers.of(loop.robot) if values is None else values
    return simulation_of(run_robot(prepare_robot(loop, record), numbers, keep=True, steps=steps))


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
        initial: where the motor is at the first sample.
        tap: where the torque is logged.
        name: of the record.

    Raises:
        MethodError: the loop cannot be simulated with these values, or the disturbance is not as long as the reference;
            the sentence says which.
    """
    kind = loop.joint.kind
    position, force = POSITION_UNIT[kind], loop.joint.force_unit

    def channel(array: ArrayLike, unit: str, timing: Timing = Timing.SAMPLED) -> Channel:
        return Channel(np.asarray(array, dtype=np.float64), unit, sample_time, timing, name)

    driven = Record(
        torque=channel(np.zeros(np.size(reference)), force, Timing.HELD),
        tap=Tap(tap),
        reference=channel(reference, position),
        reference_velocity=None if reference_velocity is None else channel(reference_velocity, f"{position}/s"),
        injected=None
        if injected is None
        else Injection(channel(injected, force, Timing.HELD), InjectionPoint(at), in_torque),
        name=name,
    )
    experiment = prepare(loop, driven)
    if disturbance is not None and np.size(disturbance) != np.size(reference):
        raise MethodError(
            f"A disturbance has a value for each sample of the reference, {np.size(reference)}; received "
            f"{np.size(disturbance)}: give as many."
        )
    if disturbance is None:
        run = require_success(simulate_joint(loop, experiment, values, initial))
    else:
        extra = np.repeat(np.asarray(disturbance, dtype=np.float64), experiment.every)
        extra = extra[:: experiment.repeat][: experiment.after_limit.size]
        forced = replace(experiment, after_limit=experiment.after_limit + extra)
        run = require_success(simulate_joint(loop, forced, values, initial))
        # A force from outside is in no current of the motor, though it acts as an injected signal does.
        run = replace(run, torque=run.torque - to_log(experiment, forced.shown - experiment.shown))
    return as_record(driven, run, force, torque_noise=torque_noise, encoder_step=encoder_step)


def as_record(
    driven: Record, run: Simulation, force: str, *, torque_noise: ArrayLike | None = None, encoder_step: float = 0.0
) -> Record:
    """Build the log of a run: inputs, torque and positions.

    `driven` are the run's inputs, `force` is the unit of the joint's torque; for noise and encoder step see
    `simulated_record`.
    """
    assert driven.reference is not None
    logged, position = driven.torque, driven.reference.unit
    timing = Timing.HELD if logged is None else logged.timing
    torque = run.torque if torque_noise is None else run.torque + np.asarray(torque_noise, dtype=np.float64)

    def channel(values: FloatArray, unit: str, timing: Timing = Timing.SAMPLED) -> Channel:
        return Channel(values, unit, run.sample_time, timing, "simulated")

    return replace(
        driven,
        torque=channel(torque, force, timing),
        motor_position=channel(_quantise(run.motor_position, encoder_step), position),
        load_position=None
        if run.load_position is None
        else channel(_quantise(run.load_position, encoder_step), position),
    )


def _quantise(position: FloatArray, step: float) -> FloatArray:
    return np.asarray(np.round(position / step) * step) if step else position
