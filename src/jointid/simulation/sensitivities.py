"""Exact derivatives of a closed loop's torque and states by everything that can be free in an identification.

`simulate_sensitivities` runs a loop once and follows the run with a column per parameter (`tangents`). A parameter may
belong to the joint, to the motor's state at the first sample, or to the controller: any number its law is made of, and
its computing delay. How the controller's output depends on its own numbers, with the position it saw held, is exact,
too: the law is run on the simulated position at two neighbouring values, and is linear in its signals.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from jointid.common.errors import MethodError
from jointid.data.record import FloatArray, Tap, Timing
from jointid.model.controllers import EXCESS, POSITION, REFERENCE, REFERENCE_VELOCITY, Controller, SampledLaw
from jointid.simulation.closed_loop import (
    Initial,
    Outcome,
    Response,
    Run,
    acting,
    as_logged,
    averages,
    response_of,
    run,
)
from jointid.simulation.experiment import ClosedLoop, Experiment

_STEP = 1e-4  # of a controller's number: its output is a low-order polynomial in it
_SMALL = 1e-6  # of a joint's value: where steady motion begins is a rational function of it
_TAPED = 1000  # rows of the tape to begin with
_INITIAL = {"initial_position": (1.0, 0.0), "initial_velocity": (0.0, 1.0)}


@dataclass(frozen=True, slots=True, eq=False)
class Sensitivities:
    """A run and its derivatives, in the order of the names asked for.

    Attributes:
        response: of the loop.
        torque: (samples, names) of the torque as the log shows it.
        motor_position, load_position: (samples, names); empty where positions were not asked for, the second also for a
            rigid joint.
    """

    response: Response
    torque: FloatArray
    motor_position: FloatArray
    load_position: FloatArray


def simulate_sensitivities(
    loop: ClosedLoop,
    experiment: Experiment,
    values: Mapping[str, float],
    names: Sequence[str],
    initial: Initial | None = None,
    *,
    positions: bool = False,
) -> Sensitivities:
    """Run one candidate with its derivatives by the parameters named.

    Args:
        loop: joint and controller.
        experiment: what they are driven with.
        values: every parameter of the joint by name.
        names: of parameters of the joint, "initial_position", "initial_velocity", or numbers of the controller ("kp",
            "kv", "gain", "limit", "delay", ...).
        initial: where the motor is at the first sample.
        positions: also return the derivatives of the positions.

    Of a run that did not finish all derivatives are 0. At a delay of a whole number of periods the derivative is that
    towards longer delays; for a motor at rest, that by its velocity is of a load that moves along.

    Raises:
        MethodError: a name is none of these.
    """
    for name in names:
        if _is_of_law(loop, name):
            _number(loop.controller, name)
    rows = _TAPED + experiment.feedforward.size // 16
    out = run(loop, experiment, values, initial, keep=True, taped=rows)
    if out.counts[1] > rows:  # a joint that turns round and sticks all the time
        out = run(loop, experiment, values, initial, keep=True, taped=int(out.counts[1]))
    response = response_of(experiment, out)
    if out.outcome is not Outcome.FINISHED:
        torque = np.zeros((response.torque.size, len(names)))
        position = torque if positions else torque[:, :0]
        return Sensitivities(response, torque, position, position if loop.joint.model == "flexible" else torque[:, :0])
    # The law's own columns come last in a block.
    order = sorted(range(len(names)), key=lambda i: _is_of_law(loop, names[i]))
    blocks = [order[i : i + _lanes()] for i in range(0, len(order), _lanes())]
    followed = [_followed(loop, experiment, values, [names[i] for i in block], out, positions) for block in blocks]
    back = np.argsort(order) if order != sorted(order) else slice(None)
    command = _joined([du[:, : len(block)] for (du, _), block in zip(followed, blocks, strict=True)])[:, back]
    states = _joined([s[experiment.looked] if positions else s for _, s in followed])[:, ::2, back]
    flexible = loop.joint.model == "flexible"
    return Sensitivities(
        response,
        _logged(experiment, out, command, names),
        states[:, 0] if positions else command[:, :0],
        states[:, 1] if positions and flexible else command[:, :0],
    )


def _joined(blocks: list[FloatArray]) -> FloatArray:
    return blocks[0] if len(blocks) == 1 else np.concatenate(blocks, axis=-1)


def _lanes() -> int:
    from jointid.simulation import tangents

    return tangents.LANES


def _is_of_law(loop: ClosedLoop, name: str) -> bool:
    return name not in _INITIAL and name != "delay" and all(name != p.name for p in loop.joint.parameters)


def _logged(experiment: Experiment, out: Run, command: FloatArray, names: Sequence[str]) -> FloatArray:
    """Return the derivatives of the torque as the log shows it, (samples, names)."""
    torque = as_logged(experiment, command)
    if "delay" in names and experiment.tap is Tap.MEASURED and experiment.timing is Timing.AVERAGED:
        # An edge of the torque that moves takes its height from the mean over the sample time it stands in.
        edges = -np.diff(acting(experiment, out.command + experiment.shown), prepend=out.before)
        torque[:, list(names).index("delay")] += averages(experiment, edges)
    return torque


def _followed(
    loop: ClosedLoop,
    experiment: Experiment,
    values: Mapping[str, float],
    names: Sequence[str],
    out: Run,
    positions: bool,
) -> tuple[FloatArray, FloatArray]:
    """Return the derivatives of the output, (periods, lanes), and of the states, (periods * parts, 4, names)."""
    from jointid.simulation import tangents

    law, width = experiment.law, tangents.LANES
    own = {p.name for p in loop.joint.parameters}
    seeds, start = np.zeros((14, width)), np.zeros((4, width))
    memory, delay, limit = np.zeros((law.C.size, width)), np.zeros(width), np.zeros(width)
    explicit = []
    for j, name in enumerate(names):
        if name in own:
            seeds[:, j] = _seed(loop, name)
            start[:, j] = _start_slope(loop, values, name, out)
        elif name in _INITIAL:
            at = _INITIAL[name]
            start[:, j] = _moved_start(loop, values, out, *at)
            memory[:, j] = law.memory(POSITION, *at)
        elif name == "delay":
            delay[j] = 1.0
        else:
            column, limit[j] = _explicit(loop, experiment, out, name)
            explicit.append(column)
    spring, side, dspring, dinertia, dside = by_mode(out.drive, seeds)
    command = np.empty((out.command.size, width))
    states = np.empty((len(out.states) if positions else 0, 4, width))
    explained = np.column_stack([np.zeros((out.command.size, 0)), *explicit])
    tangents.follow(
        experiment.lengths, experiment.lags, out.states, out.modes, out.tape, int(out.counts[1]), out.command,
        experiment.after_limit, out.before, law.limit, law.A, np.ascontiguousarray(law.B[:, POSITION]),
        np.ascontiguousarray(law.B[:, EXCESS]), law.C, law.D[POSITION], spring, side, dspring, dinertia, dside,
        explained, len(names) - len(explicit), delay, limit, start, memory, command, states,
    )  # fmt: skip
    return command, states[:, :, : len(names)]


def by_mode(drive: FloatArray, seeds: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray, FloatArray]:
    """Return the drive, and its derivatives, by the modes of its two masses, as `tangents.follow` reads them."""
    columns = seeds.shape[1]
    side, dside = np.zeros((2, 3, 3)), np.zeros((2, 2, 3, columns))
    for mass in range(2):
        viscous, viscous_back, coulomb, coulomb_back = range(4 + 4 * mass, 8 + 4 * mass)
        offset = 12 + mass
        for mode, drag, force, sign in ((0, viscous_back, coulomb_back, 1.0), (2, viscous, coulomb, -1.0)):
            side[mass, :, mode] = 1 / drive[mass], drive[drag], sign * drive[force] - drive[offset]
            dside[mass, 0, mode] = seeds[drag]
            dside[mass, 1, mode] = sign * seeds[force] - seeds[offset]
    return drive[2:4].copy(), side, seeds[2:4].copy(), seeds[:2] / drive[:2, np.newaxis], dside


def _seed(loop: ClosedLoop, name: str) -> FloatArray:
    """Return how the drive's coefficients depend on a parameter of the joint: they are linear in it."""
    nothing = {p.name: 0.0 for p in loop.joint.parameters}
    return np.asarray(loop.joint.coefficients(nothing | {name: 1.0}) - loop.joint.coefficients(nothing))


def _start_slope(loop: ClosedLoop, values: Mapping[str, float], name: str, out: Run) -> FloatArray:
    """Return how the state of steady motion at the first sample depends on a parameter of the joint."""
    step = _SMALL * (abs(values[name]) or 1.0)
    ends = [loop.joint.start({**values, name: values[name] + by}, out.position, out.velocity) for by in (-step, step)]
    return np.asarray((ends[1] - ends[0]) / (2 * step))


def _moved_start(
    loop: ClosedLoop, values: Mapping[str, float], out: Run, position: float, velocity: float
) -> FloatArray:
    """Return how the first state depends on the motor's position (1, 0) or velocity (0, 1): affine beside 0."""
    if velocity and out.velocity == 0.0:  # the drag of steady motion jumps there
        return np.array([0.0, 1.0, 0.0, 1.0])
    by = (position, velocity * 0.5 * out.velocity)
    moved = loop.joint.start(values, out.position + by[0], out.velocity + by[1])
    return np.asarray((moved - loop.joint.start(values, out.position, out.velocity)) / (by[0] + by[1]))


def _explicit(loop: ClosedLoop, experiment: Experiment, out: Run, name: str) -> tuple[FloatArray, float]:
    """Return how the output, (periods,), and its limit depend on a number of the law.

    The position, and what the limit cut off, are held.
    """
    value = _number(loop.controller, name)
    step = _STEP * (abs(value) or 1.0)
    law = experiment.law
    inputs = _signals(experiment, out)
    if np.any(law.B[:, EXCESS]):
        # From the output itself: what the limit cut off is its difference from the law's.
        cut, into = np.append(law.D, 0.0), law.B[:, EXCESS]
        back = replace(law, A=law.A - np.outer(into, law.C), B=law.B - np.outer(into, cut))
        inputs[:, EXCESS] = out.command
        inputs[:, EXCESS] -= _answer(back, inputs, out)
    low, high = (_law(loop.controller, name, value + by, experiment) for by in (-step, step))
    slope = (_answer(high, inputs, out) - _answer(low, inputs, out)) / (2 * step)
    limit = 0.0 if high.limit == low.limit else (high.limit - low.limit) / (2 * step)
    return slope, limit


def _law(controller: Controller, name: str, value: float, experiment: Experiment) -> SampledLaw:
    changed: Controller = replace(controller, **{name: value})  # type: ignore[type-var]
    return changed.law(experiment.sample_time)


def _number(controller: Controller, name: str) -> float:
    value = getattr(controller, name, None)
    if name == "period" or not isinstance(value, float | int) or isinstance(value, bool):
        raise MethodError(
            f'"{name}" is no parameter of the joint, no initial state and no number of this '
            f"{type(controller).__name__}, so it has no derivative; name one of these."
        )
    return float(value)


def _signals(experiment: Experiment, out: Run) -> FloatArray:
    """Return all inputs of the law as they were in a run, (periods, 4)."""
    position = out.states[:: experiment.lengths.size, 0]
    return np.column_stack([experiment.inputs[:, :POSITION], position, np.zeros(position.size)])


def _answer(law: SampledLaw, inputs: FloatArray, out: Run) -> FloatArray:
    """Return the law's output before its limit, (periods,)."""
    from jointid.data.recurrences import respond

    reference, velocity = inputs[:, REFERENCE], inputs[:, REFERENCE_VELOCITY]
    slope = (reference[1] - reference[0]) / law.period
    state = (
        law.memory(REFERENCE, reference[0], slope)
        + law.memory(REFERENCE_VELOCITY, velocity[0], 0.0)
        + law.memory(POSITION, out.position, out.velocity)
    )
    answer = np.empty(len(inputs))
    respond(law.A, np.ascontiguousarray(law.B), law.C, np.append(law.D, 0.0), state, inputs, answer)
    return answer
