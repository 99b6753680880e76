"""Shifts of an estimate by what its record does not exclude, which widen its intervals.

Two kinds: undeclared elements of the loop, and faults that were found or are suspected.

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

from jointid.common.arrays import FloatArray
from jointid.common.errors import JointidError
from jointid.common.parallel import in_threads
from jointid.common.text import join, number
from jointid.diagnostics.axis_torques import AxisTorques
from jointid.diagnostics.diagnosis import Diagnosis
from jointid.diagnostics.score import score
from jointid.diagnostics.search_state import INTERVAL
from jointid.diagnostics.suspects import DELAY, TORQUE_FILTER, VELOCITY_FILTER, AxisFaults, Fault, FaultSignature
from jointid.estimation.problems.simulated import decimate_each
from jointid.estimation.result.estimate import Estimate, EstimatedParameter
from jointid.estimation.result.verdict import SLIGHT, Widening
from jointid.estimation.robots.didim import RobotFit
from jointid.models.controllers import Controller, FirstOrder
from jointid.models.controllers.servo_base import DiagramController
from jointid.models.robots.robot import RobotLoop
from jointid.simulation.derivatives import respond_to_laws
from jointid.simulation.simulate import require_success
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
    axis: int = 0


def list_undeclared(controller: Controller, sample_time: float, axis: int = 0) -> Iterator[Element]:
    """Yield each usual element that a controller does not declare; `sample_time` is that of the log, s."""
    if not isinstance(controller, DiagramController) or controller.undeclared == "none":
        return
    period = controller.period or sample_time
    half = max(0.5 * _USUAL, period)
    if controller.velocity_filter == (1.0,):
        yield Element(VELOCITY_FILTER, half, replace(controller, velocity_filter=FirstOrder(half)), axis)
    if not controller.torque_filters:
        yield Element(TORQUE_FILTER, half, replace(controller, torque_filters=(FirstOrder(half),)), axis)
    if not controller.delay:
        yield Element(DELAY, 0.5 * period, replace(controller, delay=0.5 * period), axis)


def widen_for_undeclared(fit: Estimate, found: Diagnosis) -> Iterator[Widening]:
    """Yield the shifts of parameters by undeclared elements that are not excluded.

    Args:
        fit: of a joint, or of a robot, under controllers.
        found: its diagnosis; faults that it names are to be corrected, and widen nothing.
    """
    torques, part, problem = found.torques, fit.robot, fit.problem
    names: Sequence[str] = ()
    controllers: Sequence[Controller] = ()
    scales: FloatArray | float = 1.0
    if problem is not None:
        names, controllers = [p.name for p in problem.free], [problem.loop.controller]
    elif part is not None and isinstance(part.setup, RobotLoop) and fit.solved is not None:
        names, controllers = part.parameters.names, part.setup.controllers
        scales = np.where(part.parameters.logarithmic, part.values[: len(part.parameters.places)], 1.0)
    tried = list[Element]()
    for k, (controller, axis) in enumerate(zip(controllers, found.axes, strict=False)):
        known = {*names, *(str(one) for f in axis.faults.findings for one in (f.test.fault, *f.test.alike))}
        elements = list_undeclared(controller, fit.data.sample_time, k)
        tried += [one for one in elements if one.fault.name not in known]
    if torques is None or not tried:
        return
    rows = {row.name: row for row in fit.rows if row.stderr}
    solve = Influence(torques.stack(torques.own), torques.stack(torques.error)).matrix
    changes = _simulate(fit, torques, tried) if fit.solved is None else _respond(fit.solved, tried)
    sizes = in_threads(lambda one: _largest_size(torques, *one), list(zip(tried, changes, strict=True)))
    for element, change, largest in zip(tried, changes, sizes, strict=True):
        by = 0.5 * np.abs(scales * (solve @ torques.stack(change))) * largest / element.half
        moved = {name: float(one) for name, one in zip(names, by, strict=True) if name in rows}
        if any(one > _MATTERS * (rows[name].stderr or 0.0) for name, one in moved.items()):
            what = f"an undeclared {element.fault.title} of up to {number(1e3 * largest, 2)} ms"
            yield _widening(what, moved, rows, '. Declare it, or set undeclared = "none" in [controller]')


def _simulate(fit: Estimate, torques: AxisTorques, tried: Sequence[Element]) -> Sequence[FloatArray]:
    """Return the changes of a joint's filtered torque by each element, (1, rows).

    An element under which the loop cannot be simulated is not that of the record: it changes nothing.
    """
    problem, x, record = fit.problem, fit.x, fit.records[0] if fit.records else None

    def change(one: Element) -> FloatArray:
        assert problem is not None and x is not None and record is not None
        try:
            run = require_success(problem.under(one.controller, record).simulate(x))
            return problem.filter(run.torque)[np.newaxis] - torques.predicted
        except JointidError:
            return np.zeros_like(torques.predicted)

    return in_threads(change, tried)


def _respond(solved: RobotFit, tried: Sequence[Element]) -> Sequence[FloatArray]:
    """Return the changes of a robot's filtered torques by each element, (n, rows), to first order."""
    log, run = solved.problem.log, solved.runs[0]
    each = log.experiment.axes
    others = [(one.axis, replace(each[one.axis], law=each[one.axis].law_of(one.controller))) for one in tried]
    found, direct = respond_to_laws(run, others)
    for c, (one, own) in enumerate(zip(tried, direct, strict=True)):
        if not any(log.seen) or log.seen[one.axis] is None:  # else the declared law shows the position
            found[one.axis][:, c] += own
    rows = decimate_each(log, found)
    return list(np.moveaxis(rows.reshape(len(each), -1, len(others)), 2, 0))


def _largest_size(torques: AxisTorques, element: Element, change: FloatArray) -> float:
    """Return the largest size of an element, s, within two deviations of what its axis' residual shows."""
    axis, own = element.axis, torques.own[element.axis]
    signature = FaultSignature(replace(element.fault, one_sided=True), change[axis] / element.half)
    (test,) = score(
        torques.error[axis], own[:, np.any(own, axis=0)], [signature], {signature.fault: 0.0},
        cells(torques.position[axis], torques.velocity[axis]), widened=1.0,
    )  # fmt: skip
    return min(max(test.size + 2 * test.std, 0.0), 2.0 * element.half)


def widen_for_faults(check: AxisFaults, rows: Mapping[str, EstimatedParameter]) -> Iterator[Widening]:
    """Yield the shifts of parameters by the faults that a check found or suspects.

    Faults of loop and log that move a parameter by more than a thousandth widen no interval: they are corrected, or
    not. Where they are excluded, the joint has what looks like them.

    Args:
        check: of loop and log.
        rows: of the parameters, by name.
    """
    for finding in check.findings:
        moved = {name: abs(change.by) for name, change in finding.changes.items()}
        if not finding.test.fault.mechanical:
            moved = {
                name: 0.5 * by
                for name, by in moved.items()
                if abs(finding.changes[name].sigmas) > INTERVAL and by < SLIGHT * abs(rows[name].value or 0.0)
            }
        yield moved, ""
    for suspect in check.suspected:
        what = f"what looks like a {suspect.test.fault.title} (p = {number(suspect.test.p_value, 2)})"
        if suspect.law is not None:
            what = f"that {suspect.law.words}, which this record does not exclude,"
        yield _widening(what, {name: abs(one.by) for name, one in suspect.changes.items()}, rows, "")


def _widening(what: str, by: Mapping[str, float], rows: Mapping[str, EstimatedParameter], remedy: str) -> Widening:
    """Return the shifts of parameters, each as one deviation, and the sentence on those that are large."""
    off = [
        f"{row.symbol} by {number(2 * by[name], 2)} {row.unit}".rstrip()
        for name, row in rows.items()
        if by.get(name, 0.0) > _TOLD * (row.stderr or 0.0)
    ]
    return dict(by), f"{what} may move {join(off)}, which the intervals hold{remedy}" if off else ""
