"""Derivatives of simulations by differences of whole runs."""

from dataclasses import replace

import numpy as np

from jointid.common.arrays import FloatArray
from jointid.models.controllers import number, with_numbers
from jointid.models.joints import ClosedLoop
from jointid.records.record import Record
from jointid.simulation.loop_input import prepare
from jointid.simulation.simulate import Outcome, Simulation
from jointid.simulation.start import Initial
from jointid.simulation.synthesis import simulate

AT_REST = Initial()


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


def error_beside_differences(
    columns: tuple[FloatArray, ...],
    loop: ClosedLoop,
    record: Record,
    values: dict[str, float],
    name: str,
    steps: tuple[float, ...],
    start: Initial = AT_REST,
    *,
    back: float = 1.0,
) -> float:
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
