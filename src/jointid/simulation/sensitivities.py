"""Exact derivatives of a closed loop's torque and states by all free parameters.

`simulate_sensitivities` runs a loop once and propagates a column per parameter of joint, initial state or controller,
including its delay. Derivatives by controller numbers are exact, too: the law, linear in its signals, is run on the
simulated position at two neighbouring values.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Container, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache, partial

import numpy as np

from jointid.common.arrays import FloatArray, Room
from jointid.common.errors import MethodError
from jointid.models.controllers import POSITION, SampledLaw, number, respond, with_numbers
from jointid.models.joints import ClosedLoop, Joint
from jointid.records.record import Tap, Timing
from jointid.simulation.closed_loop import (
    ClosedLoopRun,
    Initial,
    Outcome,
    Response,
    first_state,
    run,
)
from jointid.simulation.loop_input import LoopInput, acting, averages, seen_torque, to_log

_STEP = 1e-4  # of a controller's number: its output is a low-order polynomial in it
_FROM_NOTHING = 1e-2  # the step from a number that is 0, to its right alone: of a delay in periods; the law is linear
_SMALL = 1e-6  # of a joint's value: where steady motion begins is a rational function of it
_TAPED = 1000  # rows of the tape to begin with, and one for 16 periods
_ASTRAY = 1e100  # a derivative by which two neighbours part at once; its square would be no number
_ROOM = Room()
_INITIAL = {
    "initial_position": (1.0, 0.0, 0.0),
    "initial_velocity": (0.0, 1.0, 0.0),
    "initial_torque": (0.0, 0.0, 1.0),
}


@dataclass(frozen=True, slots=True, eq=False)
class Sensitivities:
    """A run and its derivatives, in the order of names.

    Attributes:
        torque: (samples, names) of the torque as the log shows it.
        motor_position, load_position: (samples, names); empty where positions were not asked for, the second also for a
            rigid joint.
    """

    response: Response
    torque: FloatArray
    motor_position: FloatArray
    load_position: FloatArray


def zero_sensitivities(response: Response, count: int, positions: bool, flexible: bool) -> Sensitivities:
    """Zero derivatives."""
    torque = np.zeros((response.torque.size, count))
    position = torque if positions else torque[:, :0]
    return Sensitivities(response, torque, position, position if flexible else torque[:, :0])


def simulate_sensitivities(
    loop: ClosedLoop,
    experiment: LoopInput,
    values: Mapping[str, float],
    names: Sequence[str],
    initial: Initial | None = None,
    *,
    positions: bool = False,
) -> Sensitivities:
    """Simulate one candidate with derivatives by named parameters.

    Args:
        loop: joint and controller.
        experiment: its inputs.
        values: every parameter of the joint by name.
        names: of parameters of the joint, "initial_position", "initial_velocity", "initial_torque", or numbers of the
            controller ("position_gain", "velocity_gain", "gain", "limit", "delay", "velocity_filter.time_constant",
            ...).
        initial: where the motor is at the first sample.
        positions: also return the derivatives of the positions.

    Derivatives are 0 for a failed run, and for an unstable loop at its limit, whose trajectories diverge (above 1e100).
    At a delay of whole periods the derivative is one-sided, towards longer delays; at rest, that by the motor's
    velocity includes a load that moves along.
    """
    own, rows = _seeds(loop.joint), _TAPED + experiment.periods // 16
    for name in names:
        if _is_of_law(own, name):
            number(loop.controller, name)
    out = run(loop, experiment, values, initial, keep=True, taped=rows, room=_ROOM)
    if out.plant is None and out.trace.counts[1] > rows:  # a joint that turns round and sticks all the time
        out = run(loop, experiment, values, initial, keep=True, taped=int(out.trace.counts[1]), room=_ROOM)
    return _differentiate(out, names, positions)


def _differentiate(out: ClosedLoopRun, names: Sequence[str], positions: bool) -> Sensitivities:
    """Derivatives of a run, of the positions on demand."""
    experiment, response = out.experiment, out.simulation() if positions else out.response()
    flexible = out.loop.joint.model == "flexible"
    if out.outcome is not Outcome.FINISHED:
        return zero_sensitivities(response, len(names), positions, flexible)
    from jointid.simulation.kernels.drive_sensitivities import LANES

    # The law's own columns come last in a block.
    own = _seeds(out.loop.joint)
    order = sorted(range(len(names)), key=lambda i: _is_of_law(own, names[i]))
    commands, moved = [], []
    for begin in range(0, max(len(names), 1), LANES):
        block = [names[i] for i in order[begin : begin + LANES]]
        output, motion = _propagate(out, block, positions)
        commands.append(output[:, : len(block)])
        moved.append(motion[experiment.log_index, ::2, : len(block)] if positions else np.empty((0, 2, len(block))))
    command, states = _join(commands, order), _join(moved, order)
    torque = to_log(experiment, command)
    if torque.size and not (-_ASTRAY < torque.min() <= torque.max() < _ASTRAY):  # nor a NaN
        return zero_sensitivities(response, len(names), positions, flexible)
    if "delay" in names and experiment.tap is Tap.MEASURED and experiment.timing is Timing.AVERAGED:
        # An edge of the torque that moves takes its height from the mean over the sample time it stands in.
        edges = -np.diff(acting(experiment, seen_torque(experiment, out.trace.u)), prepend=out.before)
        torque[:, list(names).index("delay")] += averages(experiment, edges)
    return Sensitivities(
        response,
        torque,
        states[:, 0] if positions else command[:, :0],
        states[:, 1] if positions and flexible else command[:, :0],
    )


def _join(blocks: Sequence[FloatArray], order: Sequence[int]) -> FloatArray:
    """Join blocks of columns (last axis) in `order`, without copying a single block."""
    whole = blocks[0] if len(blocks) == 1 else np.concatenate(blocks, axis=-1)
    return whole if order == sorted(order) else np.asarray(whole[..., np.argsort(order)])


def _is_of_law(own: Container[str], name: str) -> bool:
    return name not in _INITIAL and name != "delay" and name not in own


def _propagate(out: ClosedLoopRun, names: Sequence[str], positions: bool) -> tuple[FloatArray, FloatArray]:
    """Derivatives of output and states.

    Shapes: (periods, lanes) and (periods * parts, 4, lanes).
    """
    from jointid.simulation.kernels import drive_sensitivities as sensitivity_kernels
    from jointid.simulation.kernels import variation
    from jointid.simulation.plant import NO_LINKS, pack_seeds, plant_of, plant_seeds

    experiment, joint = out.experiment, out.loop.joint
    law, width = experiment.feedback, sensitivity_kernels.LANES
    seeds, start = np.zeros((14, width)), np.zeros((4, width))
    memory, limits = np.zeros((1, law.order, width)), np.zeros((1, law.limits.size, width))
    explicit, by_name, delays = [], _seeds(joint), [(j, 0) for j, name in enumerate(names) if name == "delay"]
    for j, name in enumerate(names):
        if name in by_name:
            seeds[:, j] = by_name[name]
            # At rest it else begins where the motor is, whatever it is like.
            if out.velocity != 0.0 or out.plant is not None:
                start[:, j] = start_slope(lambda at: out.start(at, out.position, out.velocity), out.values, name)
        elif name in _INITIAL:
            at = _INITIAL[name]
            start[:, j] = _start_slope(out, *at[:2]) if any(at[:2]) else 0.0
            memory[0, :, j] = _memory_slope(out, at)
        elif name != "delay":
            column, limits[0, :, j] = _explicit(out, name)
            explicit.append(column)
    periods, elements = len(out.trace.u), law.limits.size
    command = np.empty((1, periods, width))
    states = _ROOM.array("moved", (len(out.trace.states) if positions else 0, 4, width))
    explained = np.stack(explicit, axis=2) if explicit else np.zeros((periods, elements, 0))
    side = np.arange(2) if out.plant is None else np.minimum(np.arange(len(out.plant.masses)), 1)
    at_start = (start[2 * side], start[2 * side + 1], memory, explained[np.newaxis], len(names) - len(explicit), limits)
    moved, slopes = sensitivity_kernels.Moved(*at_start), sensitivity_kernels.Slopes(command, states, NO_LINKS)
    if out.plant is None:
        acts_later = np.array(delays, dtype=np.int64).reshape(-1, 2)
        sensitivity_kernels.follow(
            experiment.sampled,
            out.before,
            out.trace,
            int(out.trace.counts[1]),
            out.drive,
            seeds,
            acts_later,
            moved,
            slopes,
        )
    else:
        blocks = plant_seeds(partial(plant_of, joint), {name: out.values[name] for name in by_name}, names)
        packed = pack_seeds(out.plant, None, blocks, delays=delays)
        variation.follow(
            out.plant, None, NO_LINKS[0], experiment.sampled, np.array([out.before]), out.trace.u[np.newaxis],
            out.trace.excess[np.newaxis], out.trace.tape, packed, moved, slopes,
        )  # fmt: skip
    return command[0], states


@lru_cache(maxsize=64)
def _seeds(joint: Joint) -> Mapping[str, FloatArray]:
    """Return the constant derivatives of the affine kernels' coefficients by a joint's parameters."""
    nothing = dict.fromkeys((p.name for p in joint.parameters), 0.0)
    constant = joint.coefficients(nothing)
    found = {name: joint.coefficients(nothing | {name: 1.0}) - constant for name in nothing}
    for seed in found.values():
        seed.setflags(write=False)
    return found


def start_slope(
    start: Callable[[Mapping[str, float]], FloatArray], values: Mapping[str, float], name: str
) -> FloatArray:
    """Derivative of a steady-motion initial state, given by `start`, by a parameter."""
    step = _SMALL * (abs(values[name]) or 1.0)
    low, high = (start({**values, name: values[name] + by}) for by in (-step, step))
    return np.asarray((high - low) / (2 * step))


def _start_slope(out: ClosedLoopRun, position: float, velocity: float) -> FloatArray:
    """Derivative of the first state by motor position (1, 0) or velocity (0, 1).

    It is affine on one side of 0 where all laws are lines.
    """
    if velocity and out.velocity == 0.0:  # the drag of steady motion jumps there
        return np.array([0.0, 1.0, 0.0, 1.0])
    step = 1.0 if out.plant is None else _SMALL
    by = (step * position, step * velocity * 0.5 * out.velocity)
    moved = out.start(out.values, out.position + by[0], out.velocity + by[1])
    return np.asarray((moved - out.start(out.values, out.position, out.velocity)) / (by[0] + by[1]))


def _memory_slope(out: ClosedLoopRun, by: tuple[float, float, float]) -> FloatArray:
    """Derivative of the feedback's first states by position, velocity and torque."""
    torque = None if out.torque is None else out.torque + by[2]
    here, _ = first_state(out.experiment, out.position, out.velocity, out.torque)
    return first_state(out.experiment, out.position + by[0], out.velocity + by[1], torque)[0] - here


def _explicit(out: ClosedLoopRun, name: str) -> tuple[FloatArray, FloatArray]:
    """Derivatives of elements, (periods, elements), and limits by a law's number.

    Position, and excesses of limits and gates, are held.
    """
    experiment, controller = out.experiment, out.loop.controller
    value = number(controller, name)
    if not math.isfinite(value):  # a limit that never acts
        return np.zeros_like(out.trace.excess), np.zeros(experiment.law.limits.size)
    unit = experiment.law.period if name.endswith("delay") else 1.0
    steps = (-_STEP * abs(value), _STEP * abs(value)) if value else (0.0, _FROM_NOTHING * unit)
    inputs = experiment.inputs.copy()
    inputs[:, POSITION] = out.trace.states[:: experiment.lengths.size, 0]
    low, high = (experiment.law_of(with_numbers(controller, {name: value + by})) for by in steps)
    require_same_structure(low, high, name)
    held, width = _cut(out, inputs), steps[1] - steps[0]
    above, below = (respond(law, inputs, _start_states(law, inputs, out), held) for law in (high, low))
    slope = (above - below) / width
    with np.errstate(invalid="ignore"):
        limits = np.where(np.isinf(low.limits), 0.0, (high.limits - low.limits) / width)
    return slope, limits


def require_same_structure(low: SampledLaw, high: SampledLaw, name: str) -> None:
    """Refuse a controller number whose part is absent, such as an integral."""
    if high.limits.size != low.limits.size or (high.integral() is None) != (low.integral() is None):
        raise MethodError(
            f"The {name} of this controller is 0, and what it belongs to is not there, so it has no derivative; "
            "declare another."
        )


def _cut(out: ClosedLoopRun, inputs: FloatArray) -> FloatArray:
    """Return the excess over limits and gates, (periods, elements)."""
    law = out.experiment.law
    if law.limits.size > 1 or law.phases > 1 or out.experiment.kernel.driven.shape[1]:
        return out.trace.excess
    if not np.any(law.F):
        return np.zeros_like(out.trace.excess)
    # One limit that is fed back: what it cut off is the difference of the output from the law's own.
    output = out.trace.u[:, np.newaxis]
    back = replace(law, A=law.A - law.F @ law.C, B=law.B - law.F @ law.D)
    return np.asarray(output - respond(back, inputs, _start_states(law, inputs, out), output))


def _start_states(law: SampledLaw, inputs: FloatArray, out: ClosedLoopRun) -> FloatArray:
    """States of a law at the first period of a run, (states,)."""
    state = law.known_memory(inputs) + law.memory(POSITION, out.position, out.velocity)
    integral = law.integral() if out.torque is not None else None
    if integral is None or out.torque is None:
        return state
    first = law.C[0, law.output] @ state + law.D[0, law.output] @ inputs[0]
    return np.asarray(state + integral * (out.torque - first))
