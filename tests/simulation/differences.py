"""Derivatives of simulations by differences of whole runs."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from jointid.common.arrays import FloatArray
from jointid.models.controllers import number, with_numbers
from jointid.models.joints import ClosedLoop
from jointid.records.record import Record
from jointid.simulation.derivatives import differentiate
from jointid.simulation.drive_side import DriveSideRun, differentiate_drive_side, moves_links
from jointid.simulation.loop_input import LoopInput, prepare
from jointid.simulation.plant import Numbers, Place
from jointid.simulation.simulate import Outcome, Run, Simulation, run_loop
from jointid.simulation.start import Initial
from jointid.simulation.synthesis import simulate

AT_REST = Initial()


class Sensitivities(NamedTuple):
    """A joint's run, and its derivatives: of the torque and of positions, (samples, names)."""

    run: Run
    torque: FloatArray
    motor_position: FloatArray
    load_position: FloatArray


def sensitivities(
    loop: ClosedLoop, experiment: LoopInput, values: Mapping[str, float], names: Sequence[str],
    start: Initial = AT_REST, *, positions: bool = False,
) -> Sensitivities:  # fmt: skip
    """Simulate a joint with derivatives by named parameters."""
    run = run_loop(experiment, Numbers.of_joint(loop.joint, values), start, keep=True)
    (torque,), moved = differentiate(run, [Place(0, name) for name in names], positions=positions)
    motor, load = (moved[:, i] if moved.shape[1] > i else torque[:, :0] for i in range(2))
    return Sensitivities(run, torque, motor, load)


def drive_side_slopes(run: DriveSideRun, places: Sequence[Place]) -> FloatArray:
    """Return the derivatives of the torques that a prescribed motion takes, (parts, n, places)."""
    found = differentiate_drive_side(run, places)
    for i, (own, columns) in enumerate(run.columns(places)):
        alone = [not moves_links(places[c], run.numbers) for c in own]
        found[:, i, own[alone]] = columns[:, alone]
    return found


def simulate_moved(
    loop: ClosedLoop, record: Record, values: dict[str, float], name: str, by: float, start: Initial = AT_REST
) -> Simulation:
    """Simulate a loop with a parameter of the joint, of the start or of the controller moved."""
    if name in values:
        values = values | {name: values[name] + by}
    elif name.startswith("initial_"):
        word = name.removeprefix("initial_")
        start = replace(start, **{word: (getattr(start, word) or 0.0) + by})
    else:
        controller = with_numbers(loop.controller, {name: number(loop.controller, name) + by})
        loop = replace(loop, controller=controller)
    run = simulate(loop, prepare(loop, record), values, start)
    assert run.outcome is Outcome.FINISHED
    return run


def differences(experiment: LoopInput, numbers: Numbers, places: Sequence[Place], steps: int) -> FloatArray:
    """Return the derivatives by central differences of whole runs, (samples, n, parameters)."""
    x, columns = np.array([numbers[place] for place in places]), []
    for c in range(x.size):
        step = 1e-5 * max(abs(x[c]), 0.05) * (np.arange(x.size) == c)
        both = [run_loop(experiment, numbers.with_values(places, x + s), steps=steps).torque for s in (step, -step)]
        columns.append((both[0] - both[1]) / (2 * step[c]))
    return np.stack(columns, axis=2)


def error_beside_differences(
    columns: tuple[FloatArray, ...], loop: ClosedLoop, record: Record, values: dict[str, float], name: str,
    steps: tuple[float, ...], start: Initial = AT_REST, *, back: float = 1.0,
) -> float:  # fmt: skip
    """Return the relative error of derivatives, of the best step; the worst of torque, motor and load position.

    A difference has an error of its own: rounding where the step is short, curvature where it is long.

    Args:
        columns: derivatives of the torque; or of the motor's and the load's position, too.
        loop, record, values, start: of the simulation.
        name: of the parameter.
        steps: by which it is moved.
        back: share of a step to the other side; 0 for a difference to one side.
    """
    errors = []
    for step in steps:
        low, high = (simulate_moved(loop, record, values, name, by, start) for by in (-back * step, step))
        each = []
        for found, signal in zip(columns, ("torque", "motor_position", "load_position"), strict=False):
            expected = (getattr(high, signal) - getattr(low, signal)) / ((1.0 + back) * step)
            off, size = (float(np.linalg.norm(one)) for one in (found - expected, expected))
            each.append(off / size if off else 0.0)
        errors.append(max(each))
    return min(errors)
