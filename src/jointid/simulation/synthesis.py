"""Simulated records of a loop, as a drive would log them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike

from jointid.common.arrays import FloatArray
from jointid.common.parameters import POSITION_UNIT, TORQUE_UNIT
from jointid.models.joints import ClosedLoop
from jointid.records.record import Channel, Injection, InjectionPoint, Record, Tap, Timing
from jointid.simulation.closed_loop import Initial, Simulation, simulate
from jointid.simulation.loop_input import prepare, to_log
from jointid.simulation.simulated import require_success


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
        MethodError: the loop cannot be simulated with these values; the sentence says why.
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
    if disturbance is None:
        run = require_success(simulate(loop, experiment, values, initial))
    else:
        extra = np.repeat(np.asarray(disturbance, dtype=np.float64), experiment.every)
        extra = extra[:: experiment.repeat][: experiment.after_limit.size]
        forced = replace(experiment, after_limit=experiment.after_limit + extra)
        run = require_success(simulate(loop, forced, values, initial))
        # A force from outside is in no current of the motor, though it acts as an injected signal does.
        run = replace(run, torque=run.torque - to_log(experiment, forced.shown - experiment.shown))
    return as_record(driven, run, torque_noise=torque_noise, encoder_step=encoder_step)


def as_record(
    driven: Record, run: Simulation, *, torque_noise: ArrayLike | None = None, encoder_step: float = 0.0
) -> Record:
    """Build the log of a run: inputs, torque and positions.

    `driven` are the run's inputs; for noise and encoder step see `simulated_record`.
    """
    assert driven.reference is not None
    logged, position = driven.torque, driven.reference.unit
    unit, timing = (_TORQUE_OF[position], Timing.HELD) if logged is None else (logged.unit, logged.timing)
    torque = run.torque if torque_noise is None else run.torque + np.asarray(torque_noise, dtype=np.float64)

    def channel(values: FloatArray, unit: str, timing: Timing = Timing.SAMPLED) -> Channel:
        return Channel(values, unit, run.sample_time, timing, "simulated")

    return replace(
        driven,
        torque=channel(torque, unit, timing),
        motor_position=channel(_quantise(run.motor_position, encoder_step), position),
        load_position=None
        if run.load_position is None
        else channel(_quantise(run.load_position, encoder_step), position),
    )


_TORQUE_OF = {POSITION_UNIT[kind]: TORQUE_UNIT[kind] for kind in POSITION_UNIT}


def _quantise(position: FloatArray, step: float) -> FloatArray:
    return np.asarray(np.round(position / step) * step) if step else position
