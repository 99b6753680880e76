"""Shifts of an estimate by undeclared elements of a loop.

The elements are filters of velocity and torque, and a delay. An element of size s changes the torque by ``s c``. An
estimate without it is off by ``s (J' J)^-1 J' c``, J the columns of its parameters. The record bounds s: the score
test of c beside J gives it with its deviation. The interval holds the shift by the largest s, between 0 and what is
usual, that is within two deviations.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator, Sequence
from dataclasses import replace

import numpy as np

from jointid.common.arrays import FloatArray
from jointid.common.parallel import in_threads
from jointid.common.text import join, number
from jointid.diagnostics.axis_torques import AxisTorques
from jointid.diagnostics.faults.fault import Fault, FaultSignature
from jointid.diagnostics.faults.numbers import DELAY, TORQUE_FILTER, VELOCITY_FILTER
from jointid.diagnostics.score import score
from jointid.estimation.result.assemble import Widening
from jointid.estimation.result.estimate import Estimate
from jointid.estimation.robots.problem import RobotLoopProblem, SolvedRobot
from jointid.estimation.robots.simulated import SimulatedRobot
from jointid.models.controllers import Controller, FirstOrder
from jointid.models.controllers.servo_base import DiagramController
from jointid.simulation.closed_loop import Outcome
from jointid.simulation.loop_input import prepare
from jointid.simulation.robot_sensitivities import respond_to_laws
from jointid.simulation.robots import RobotLoop, RobotRun
from jointid.uncertainty.covariance import Influence
from jointid.uncertainty.position_dependent_error import cells

_USUAL = 1e-3  # s: time constant of a filter, at most; or two periods of the controller
_MATTERS = 0.25  # of a deviation: less widens no interval
_TOLD = 1.0  # deviations: what may be off further is said


def list_undeclared(controller: Controller, sample_time: float) -> Iterator[tuple[Fault, float, Controller]]:
    """Yield each usual element that a controller does not declare.

    Beside it stands half its largest usual size, s, and the controller with it.

    Args:
        controller: as declared.
        sample_time: of the log, s.
    """
    if not isinstance(controller, DiagramController) or controller.undeclared == "none":
        return
    period = controller.period or sample_time
    half = max(0.5 * _USUAL, period)
    if controller.velocity_filter == (1.0,):
        yield VELOCITY_FILTER, half, replace(controller, velocity_filter=FirstOrder(half))
    if not controller.torque_filters:
        yield TORQUE_FILTER, half, replace(controller, torque_filters=(FirstOrder(half),))
    if not controller.delay:
        yield DELAY, 0.5 * period, replace(controller, delay=0.5 * period)


def widen_for_undeclared(fit: Estimate, torques: AxisTorques, named: Sequence[Collection[str]]) -> list[Widening]:
    """Return the shifts of parameters by undeclared elements that are not excluded.

    Args:
        fit: of a joint, or of a robot, under controllers.
        torques: of its record, beside its own.
        named: names of the faults that were found, of each axis: they are to be corrected, and widen nothing.
    """
    columns = _columns(fit, torques, named)
    if not columns:
        return []
    names, scales = _free(fit)
    known = {row.name: row for row in fit.params.rows if row.stderr}
    sigma = np.sqrt(np.mean(torques.error**2, axis=1))
    sigma[sigma == 0.0] = 1.0
    own = (torques.own / sigma[:, np.newaxis, np.newaxis]).reshape(-1, len(names))
    solve = Influence(own, torques.error).matrix
    moved: dict[str, float] = {}
    elements: dict[str, float] = {}
    sizes = in_threads(lambda one: _largest_size(torques, one[0], one[1], one[3]), columns)
    for (_, fault, half, column), size in zip(columns, sizes, strict=True):
        largest = min(size, 2.0 * half)
        by = np.abs(scales * (solve @ (column / sigma[:, np.newaxis]).ravel())) * max(largest, 0.0)
        off = {name: float(one) for name, one in zip(names, by, strict=True) if name in known}
        if any(one > 2 * _MATTERS * (known[name].stderr or 0.0) for name, one in off.items()):
            moved = {name: max(one, moved.get(name, 0.0)) for name, one in off.items()}
            elements[fault.title] = max(elements.get(fault.title, 0.0), largest)
    if not moved:
        return []
    each = [f"{title} of up to {number(1e3 * size, 2)} ms" for title, size in elements.items()]
    why, said = f"an undeclared {' or '.join(each)}", ""
    far = [name for name, by in moved.items() if by > 2 * _TOLD * (known[name].stderr or 0.0)]
    if far:
        shifts = [f"{known[name].symbol} by {number(moved[name], 2)} {known[name].unit}".rstrip() for name in far]
        said = f"{why} may move {join(shifts)}, which the intervals hold. Declare it, or set undeclared = "
        said += '"none" in [controller]'
    return [Widening({name: 0.5 * by for name, by in moved.items()}, said)]  # half in two deviations


def _free(fit: Estimate) -> tuple[tuple[str, ...], FloatArray]:
    """Return the names of an estimate's columns, and their scales."""
    part = fit.robot
    if isinstance(part, SimulatedRobot):
        values = part.values[: len(part.parameters.places)]
        return part.parameters.names, np.where(part.parameters.logarithmic, values, 1.0)
    assert fit.problem is not None
    names = tuple(p.name for p in fit.problem.free)
    return names, np.ones(len(names))


def _columns(
    fit: Estimate, torques: AxisTorques, named: Sequence[Collection[str]]
) -> list[tuple[int, Fault, float, FloatArray]]:
    """Return the axis of each undeclared element, its fault, half its size, and the torque per second of it, (n, rows).

    Of a robot to first order in what it changes of the motion. An element under which a joint's loop cannot be
    simulated is not that of the record.
    """
    part, problem, x = fit.robot, fit.problem, fit.x
    if isinstance(part, SimulatedRobot) and isinstance(part.setup, RobotLoop) and fit.solved is not None:
        of_axes = part.setup.controllers
    elif problem is not None:
        of_axes = (problem.loop.controller,)
    else:
        return []
    taken = () if problem is None else tuple(p.name for p in problem.free)
    tried = [
        (axis, fault, half, other)
        for axis, one in enumerate(of_axes)
        for fault, half, other in list_undeclared(one, fit.data.sample_time)
        if fault.name not in taken and fault.name not in named[axis]
    ]
    if not tried:
        return []
    if fit.solved is not None:
        changes = _respond(fit.solved, [(axis, other) for axis, _, _, other in tried])
        return [(a, fault, half, one / half) for (a, fault, half, _), one in zip(tried, changes, strict=True)]
    record = fit.record
    if problem is None or x is None or record is None:
        return []

    def predict(controller: Controller) -> FloatArray | None:
        changed = replace(problem.loop, controller=controller)
        run = replace(problem, loop=changed, experiment=prepare(changed, record)).simulate(x)
        return problem.filter(run.torque)[np.newaxis] if run.outcome is Outcome.FINISHED else None

    found = in_threads(lambda one: predict(one[3]), tried)
    pairs = zip(tried, found, strict=True)
    return [(a, fault, half, (p - torques.predicted) / half) for (a, fault, half, _), p in pairs if p is not None]


def _respond(solved: SolvedRobot, others: Sequence[tuple[int, Controller]]) -> FloatArray:
    """Return the changes of a robot's filtered torques by other controllers of axes, (changes, n, rows)."""
    problem, run = solved.problem, solved.run
    assert isinstance(problem, RobotLoopProblem) and isinstance(run, RobotRun)
    each = problem.experiment.experiments
    found, direct = respond_to_laws(run, [(j, each[j].with_law(each[j].law_of(other))) for j, other in others])
    for c, ((j, _), own) in enumerate(zip(others, direct, strict=True)):
        if not any(problem.seen) or problem.seen[j] is None:  # else the declared law shows the position
            found[j][:, c] += own
    rows = problem.decimate_each(found)
    return np.moveaxis(rows.reshape(len(each), -1, len(others)), 2, 0)


def _largest_size(torques: AxisTorques, axis: int, fault: Fault, column: FloatArray) -> float:
    """Return the largest size of an element, s, within two deviations of what its axis' residual shows."""
    own = torques.own[axis]
    signature = FaultSignature(replace(fault, one_sided=True), column[axis])
    (test,) = score(
        torques.error[axis], own[:, np.any(own, axis=0)], [signature], {signature.fault: 0.0},
        lambda: cells(torques.position[axis], torques.velocity[axis]), widened=1.0,
    )  # fmt: skip
    return test.size + 2 * test.std
