"""Shifts of an estimate by what its record does not exclude, which widen its intervals.

Three kinds: undeclared elements of the loop, faults of the mechanics, and a residual that follows the motion.

An element is a filter of velocity or torque, or a delay. One of size s changes the torque by ``s c``. An estimate
without it is off by ``s (J' J)^-1 J' c``, J the columns of its parameters. The record bounds s: the score test of c
beside J gives it with its deviation. The interval holds the shift by the largest s, between 0 and what is usual, that
is within two deviations.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from jointid.common.arrays import FloatArray, column_norms
from jointid.common.parallel import in_threads
from jointid.common.text import join, number
from jointid.diagnostics.axis_torques import AxisTorques
from jointid.diagnostics.diagnosis import Diagnosis
from jointid.diagnostics.faults.fault import Fault, FaultSignature
from jointid.diagnostics.faults.findings import AxisFaults
from jointid.diagnostics.faults.numbers import DELAY, TORQUE_FILTER, VELOCITY_FILTER
from jointid.diagnostics.score import score
from jointid.diagnostics.search_state import INTERVAL
from jointid.diagnostics.unmodelled_motion import PredictedResidual
from jointid.estimation.problems.closed_loop import ClosedLoopProblem
from jointid.estimation.result.answer import SLIGHT
from jointid.estimation.result.estimate import Estimate
from jointid.estimation.result.judge import Widening
from jointid.estimation.result.parts import EstimatedParameter
from jointid.estimation.robots.problem import RobotLoopProblem, SolvedRobot
from jointid.models.controllers import Controller, FirstOrder
from jointid.models.controllers.servo_base import DiagramController
from jointid.simulation.derivatives import respond_to_laws
from jointid.simulation.loop_input import RobotLoop, prepare
from jointid.simulation.simulate import Outcome, Run
from jointid.uncertainty.covariance import Influence
from jointid.uncertainty.position_dependent_error import cells

_USUAL = 1e-3  # s: time constant of a filter, at most; or two periods of the controller
_MATTERS = 0.25  # of a deviation: less widens no interval
_TOLD = 1.0  # deviations: what may be off further is said


class Element(NamedTuple):
    """An element that a controller does not declare: half its largest usual size, s, and the controller with it."""

    fault: Fault
    half: float
    controller: Controller


def list_undeclared(controller: Controller, sample_time: float) -> Iterator[Element]:
    """Yield each usual element that a controller does not declare; `sample_time` is that of the log, s."""
    if not isinstance(controller, DiagramController) or controller.undeclared == "none":
        return
    period = controller.period or sample_time
    half = max(0.5 * _USUAL, period)
    if controller.velocity_filter == (1.0,):
        yield Element(VELOCITY_FILTER, half, replace(controller, velocity_filter=FirstOrder(half)))
    if not controller.torque_filters:
        yield Element(TORQUE_FILTER, half, replace(controller, torque_filters=(FirstOrder(half),)))
    if not controller.delay:
        yield Element(DELAY, 0.5 * period, replace(controller, delay=0.5 * period))


def widen_for_undeclared(fit: Estimate, found: Diagnosis) -> Iterator[Widening]:
    """Yield the shifts of parameters by undeclared elements that are not excluded.

    Args:
        fit: of a joint, or of a robot, under controllers.
        found: its diagnosis; faults that it names are to be corrected, and widen nothing.
    """
    torques, part = found.torques, fit.robot
    tried = _list_elements(fit, found)
    if torques is None or not tried:
        return
    names, scales = [p.name for p in fit.problem.free] if fit.problem is not None else [], np.ones(1)
    if part is not None:
        names, values = list(part.parameters.names), part.values[: len(part.parameters.places)]
        scales = np.where(part.parameters.logarithmic, values, 1.0)
    rows = {row.name: row for row in fit.params.rows if row.stderr}
    sigma = np.sqrt(np.mean(torques.error**2, axis=1))
    sigma[sigma == 0.0] = 1.0
    own = (torques.own / sigma[:, np.newaxis, np.newaxis]).reshape(-1, len(names))
    solve, changes = Influence(own, torques.error).matrix, _changes(fit, torques, tried)
    sizes = in_threads(lambda one: _largest_size(torques, *one), list(zip(tried, changes, strict=True)))
    for (_, element), change, largest in zip(tried, changes, sizes, strict=True):
        if change is None or largest <= 0.0:
            continue
        by = 0.5 * np.abs(scales * (solve @ (change / sigma[:, np.newaxis]).ravel())) * largest / element.half
        moved = {name: float(one) for name, one in zip(names, by, strict=True) if name in rows}
        if any(one > _MATTERS * (rows[name].stderr or 0.0) for name, one in moved.items()):
            what = f"an undeclared {element.fault.title} of up to {number(1e3 * largest, 2)} ms"
            yield _widening(what, moved, rows, '. Declare it, or set undeclared = "none" in [controller]')


def _widening(what: str, by: Mapping[str, float], rows: Mapping[str, EstimatedParameter], remedy: str) -> Widening:
    """Return the shifts of parameters, each as one deviation, and the sentence on those that are large."""
    off = [
        f"{row.symbol} by {number(2 * by[name], 2)} {row.unit}".rstrip()
        for name, row in rows.items()
        if by.get(name, 0.0) > _TOLD * (row.stderr or 0.0)
    ]
    return Widening(dict(by), f"{what} may move {join(off)}, which the intervals hold{remedy}" if off else "")


def _list_elements(fit: Estimate, found: Diagnosis) -> list[tuple[int, Element]]:
    """Return the elements to try, each with its axis: those neither free, nor found as faults."""
    part, problem = fit.robot, fit.problem
    of_axes: tuple[Controller, ...] = () if problem is None else (problem.loop.controller,)
    if part is not None and isinstance(part.setup, RobotLoop) and fit.solved is not None:
        of_axes = part.setup.controllers
    taken = [
        {fault.name for finding in axis.faults.findings for fault in (finding.test.fault, *finding.test.alike)}
        for axis in found.axes
    ]
    free = () if problem is None else tuple(p.name for p in problem.free)
    return [
        (axis, one)
        for axis, controller in enumerate(of_axes)
        for one in list_undeclared(controller, fit.data.sample_time)
        if one.fault.name not in taken[axis] and one.fault.name not in free
    ]


def _changes(fit: Estimate, torques: AxisTorques, tried: Sequence[tuple[int, Element]]) -> Sequence[FloatArray | None]:
    """Return what each element changes of the filtered torques, (n, rows).

    Of a robot to first order in what it changes of the motion. An element under which a joint's loop cannot be
    simulated is not that of the record: None.
    """
    if fit.solved is not None:
        return list(_respond(fit.solved, [(axis, one.controller) for axis, one in tried]))
    problem, x, record = fit.problem, fit.x, fit.record

    def change(one: tuple[int, Element]) -> FloatArray | None:
        assert problem is not None and x is not None and record is not None
        other = replace(problem.loop, controller=one[1].controller)
        run = replace(problem, loop=other, experiment=prepare(other, record)).simulate(x)
        finished = run.outcome is Outcome.FINISHED
        return problem.filter(run.torque)[np.newaxis] - torques.predicted if finished else None

    return in_threads(change, tried) if record is not None else [None] * len(tried)


def _respond(solved: SolvedRobot, others: Sequence[tuple[int, Controller]]) -> FloatArray:
    """Return the changes of a robot's filtered torques by other controllers of axes, (changes, n, rows)."""
    problem, run = solved.problem, solved.run
    assert isinstance(problem, RobotLoopProblem) and isinstance(run, Run)
    each = problem.experiment.axes
    found, direct = respond_to_laws(run, [(j, each[j].with_law(each[j].law_of(other))) for j, other in others])
    for c, ((j, _), own) in enumerate(zip(others, direct, strict=True)):
        if not any(problem.seen) or problem.seen[j] is None:  # else the declared law shows the position
            found[j][:, c] += own
    rows = problem.decimate_each(found)
    return np.moveaxis(rows.reshape(len(each), -1, len(others)), 2, 0)


def _largest_size(torques: AxisTorques, of: tuple[int, Element], change: FloatArray | None) -> float:
    """Return the largest size of an element, s, within two deviations of what its axis' residual shows."""
    if change is None:
        return 0.0
    axis, element = of
    own = torques.own[axis]
    signature = FaultSignature(replace(element.fault, one_sided=True), change[axis] / element.half)
    (test,) = score(
        torques.error[axis], own[:, np.any(own, axis=0)], [signature], {signature.fault: 0.0},
        lambda: cells(torques.position[axis], torques.velocity[axis]), widened=1.0,
    )  # fmt: skip
    return min(test.size + 2 * test.std, 2.0 * element.half)


def widen_for_faults(check: AxisFaults, rows: Mapping[str, EstimatedParameter]) -> Iterator[Widening]:
    """Yield the shifts of parameters by the faults that a check found or suspects.

    Faults of loop and log that move a parameter by more than a thousandth widen no interval: they are corrected, or
    not. Where they are excluded, the joint has what looks like them.

    Args:
        check: of loop and log.
        rows: of the parameters, by name.
    """
    for finding in filter(None, (*check.findings, check.undecided)):
        moved = {name: abs(change.by) for name, change in finding.changes.items()}
        if not finding.test.fault.mechanical:
            moved = {
                name: 0.5 * by
                for name, by in moved.items()
                if abs(finding.changes[name].sigmas) > INTERVAL and by < SLIGHT * abs(rows[name].value or 0.0)
            }
        yield Widening(moved)
    yield Widening({name: 0.5 * by for name, by in check.lacking.items()})  # two deviations hold it
    if (suspect := check.suspected) is not None:
        what = f"the record does not exclude a {suspect.test.title} (p = {number(suspect.test.p_value, 2)}), which"
        yield _widening(what, {name: abs(one.by) for name, one in suspect.changes.items()}, rows, "")


def widen_for_rest(problem: ClosedLoopProblem, x: FloatArray, rest: PredictedResidual) -> Widening:
    """Return the largest shift of each parameter by a residual that follows the motion.

    A part of the torque of that norm, with the shape that shifts a parameter most, shifts it by its norm times the
    deviation of the parameter under unit noise (the inequality of Cauchy and Schwarz). The part that the parameters
    have absorbed is assumed as large as the residual one. The largest shift is two deviations.
    """
    slopes = problem.linearise(x)[1]
    sizes = column_norms(slopes)  # of parameters in units of their own
    # Rows of the pseudo-inverse: their norms are the deviations under unit noise, and never the root of a rounding.
    spread = np.linalg.norm(np.linalg.pinv(slopes / sizes, rcond=1e-8), axis=1) / sizes
    size = 0.5 * rest.share * problem.size
    return Widening({p.name: size * float(by) for p, by in zip(problem.free, spread, strict=True)})
