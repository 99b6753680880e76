"""What can be wrong with a record or with what is declared of its loop, made on the digital twin one fault at a time.

The declared loop is the twin's; what moved the axis, or what was logged, differs from it by the fault.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Literal

import numpy as np

from jointid.common.arrays import FloatArray
from jointid.estimation.descent import descend
from jointid.estimation.problems.simulated import ClosedLoopProblem, torque_problem
from jointid.models.joints import ClosedLoop
from jointid.paper.twin import SAMPLE_TIME, twin
from jointid.records.record import Record
from jointid.records.signals.filtering import Filtering
from jointid.simulation.excitation import pulses, trapezoids
from jointid.simulation.loop_input import LoopInput, prepare
from jointid.simulation.simulate import Simulation, require_success
from jointid.simulation.synthesis import simulate, simulated_record

Loop = Literal["L19", "L30"]
Noise = Literal["white", "disturbance"]

STRIBECK_SHARE, STRIBECK_SPEED = 0.3, 5e-3  # of Fc1 + Fc2; m/s
SATURATION = 0.7  # of the largest torque the controller asks for


@dataclass(frozen=True)
class Setting:
    """A loop of the twin as declared, and how large its noise is."""

    loop: ClosedLoop
    record: Record
    truth: dict[str, float]
    noise: dict[str, float]
    peak: float  # of the controller's output


@lru_cache(maxsize=4)
def setting(name: Loop, brief: bool = False) -> Setting:
    """The twin with that loop, and the sizes of its two noises; in brief, 8.4 s of it at two speeds."""
    clean = twin(name, noise="none")
    record = clean.record
    if brief:
        reference = trapezoids((0.083, 0.125), 0.83, 0.2, SAMPLE_TIME, duration=8.4)
        known = pulses(reference.size, SAMPLE_TIME, height=150.0, width=0.02, every=0.4, seed=0)
        record = simulated_record(clean.loop, reference, clean.truth, sample_time=SAMPLE_TIME, injected=known)
    record = record.without("motor_position", "load_position")
    assert record.torque is not None
    assert record.injected is not None
    sizes = {kind: twin(name, noise=kind).noise for kind in ("white", "disturbance")}
    peak = float(np.max(np.abs(record.torque.values - record.injected.channel.values)))
    return Setting(clean.loop, record, dict(clean.truth), sizes, peak)


@dataclass(frozen=True)
class Fault:
    """One thing, or several, that differ from what is declared.

    Attributes:
        law: numbers of the controller that really ran, from those declared.
        log_gain, log_shift: of the torque channel: its gain, and by how many samples it is late.
        limit: of the controller that really ran, as a share of the largest torque it asks for.
        stribeck: whether the motor's friction has more at low speed.
        offset: whether the joint is declared to have none.
    """

    law: Callable[[ClosedLoop], dict[str, float]] = lambda loop: {}
    log_gain: float = 1.0
    log_shift: int = 0
    limit: float | None = None
    stribeck: bool = False
    offset: bool = False


def law(**factors: float) -> Callable[[ClosedLoop], dict[str, float]]:
    """Return the controller's numbers, so many times as large as declared."""
    return lambda loop: {name: getattr(loop.controller, name) * by for name, by in factors.items()}


def later(seconds: float) -> Callable[[ClosedLoop], dict[str, float]]:
    """Return a controller's delay, so much longer than declared."""
    return lambda loop: {"delay": loop.controller.delay + seconds}  # type: ignore[attr-defined]


def line_7(loop: ClosedLoop) -> dict[str, float]:
    """Return position_gain +3 %, velocity_gain -4 %, 0.4 ms later."""
    return law(position_gain=1.03, velocity_gain=0.96)(loop) | later(0.4e-3)(loop)


FAULTS = {
    "position_gain": Fault(law(position_gain=1.03)),
    "velocity_gain": Fault(law(velocity_gain=0.96)),
    "delay": Fault(later(0.4e-3)),
    "offset": Fault(offset=True),
    "log_gain": Fault(log_gain=1.03),
    "limit": Fault(limit=SATURATION),
    "stribeck": Fault(stribeck=True),
    "log_delay": Fault(log_shift=1),
}
"""Single faults by the name of the suspect that is right."""

PAIRS = {
    "position_gain, delay": replace(
        FAULTS["position_gain"], law=lambda loop: law(position_gain=1.03)(loop) | later(0.2e-3)(loop)
    ),
    "velocity_gain, offset": replace(FAULTS["velocity_gain"], offset=True),
    "delay, log_gain": replace(FAULTS["delay"], law=later(0.2e-3), log_gain=1.03),
    "offset, stribeck": Fault(offset=True, stribeck=True),
    "limit, log_delay": Fault(limit=SATURATION, log_shift=1),
    "position_gain, log_delay": replace(FAULTS["position_gain"], log_shift=1),
    "velocity_gain, stribeck": replace(FAULTS["velocity_gain"], stribeck=True),
}
"""Two faults at once, by the names of the suspects that are right."""


def on(name: Loop, fault: str) -> Fault:
    """Return a fault for a loop: 0.4 ms more make L30 itself unstable, a limit cycle that no joint explains."""
    return Fault(later(0.2e-3)) if (name, fault) == ("L30", "delay") else (FAULTS | PAIRS)[fault]


def problem(where: Setting, fault: Fault | None, noise: Noise | None, seed: int = 0) -> ClosedLoopProblem:
    """Return the problem as declared, of a record with the fault and the noise, the motor at rest at the start."""
    fault = fault or Fault()
    torque = _logged(where, fault, noise, seed)
    assert where.record.torque is not None
    record = replace(where.record, torque=replace(where.record.torque, values=torque))
    parameters = tuple(p.fix(0.0) if fault.offset and p.name == "offset" else p for p in where.loop.joint.parameters)
    return torque_problem(record, where.loop, Filtering(), parameters).keeping({"initial_velocity": 0.0})


def solved(made: ClosedLoopProblem, where: Setting, tolerance: float = 1e-6) -> FloatArray:
    """Return the least-squares parameters, from the truth."""
    return descend(made, made.vector(where.truth), tolerance).x


def _logged(where: Setting, fault: Fault, noise: Noise | None, seed: int) -> FloatArray:
    """Return the torque as logged, (samples,)."""
    white = np.random.default_rng([seed, 7]).standard_normal(len(where.record.torque or ()))
    size = where.noise["disturbance"] if noise == "disturbance" else 0.0
    torque = fault.log_gain * _run(where, fault, size * white).torque
    if fault.log_shift:
        torque = np.concatenate([np.full(fault.log_shift, torque[0]), torque[: -fault.log_shift]])
    return torque + where.noise["white"] * white if noise == "white" else torque


def _run(where: Setting, fault: Fault, force: FloatArray) -> Simulation:
    """Return the run of the loop that really ran."""
    numbers = fault.law(where.loop)
    if fault.limit is not None:
        numbers["limit"] = fault.limit * where.peak / where.loop.controller.gain  # type: ignore[attr-defined]
    controller = replace(where.loop.controller, **numbers)  # type: ignore[type-var]
    loop = replace(where.loop, controller=controller)
    experiment = prepare(loop, where.record)
    if fault.stribeck:
        return _with_stribeck(loop, experiment, where.truth, force)
    return _pushed(loop, experiment, where.truth, force)


def _pushed(loop: ClosedLoop, experiment: LoopInput, truth: dict[str, float], force: FloatArray) -> Simulation:
    axis = experiment.axis
    acted = experiment.alone(replace(axis, after_limit=axis.after_limit + force))
    return require_success(simulate(loop, acted, truth))


def _with_stribeck(loop: ClosedLoop, experiment: LoopInput, truth: dict[str, float], force: FloatArray) -> Simulation:
    """Return the run with Stribeck friction on the motor: the force its own motion gives, found by repetition."""
    size = STRIBECK_SHARE * (truth["motor_coulomb"] + truth["load_coulomb"])
    friction = np.zeros_like(force)
    for _ in range(30):
        run = _pushed(loop, experiment, truth, force + friction)
        assert run.load_position is not None
        velocity = run.motor_velocity
        spring = truth["stiffness"] * (run.load_position - run.motor_position)
        push = run.torque + force + spring - truth["offset"]
        resting = -np.clip(push, -size, size)
        moving = -size * np.exp(-((velocity / STRIBECK_SPEED) ** 2)) * np.sign(velocity)
        after = np.where(velocity == 0.0, resting, moving)
        friction = friction + 0.5 * (after - friction)
    return run
