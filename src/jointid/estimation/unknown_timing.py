"""A torque whose timing nobody stated: both readings are fitted, and the answer covers what the record leaves open.

A torque held from its stamp and one sampled at it differ by half a sample, which moves friction and inertia. The
residual power of least squares is nearly a parabola in the shift. Three shifts, held, sampled and averaged, give its
minimum. The reading that is nearer to it is taken. Each interval is widened by the change of its parameter up to the
minimum, and by the change for two deviations of the minimum. A stated timing is obeyed; where the minimum lies nearer
to another reading by more than three deviations, the answer says so.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import Any, TypeAlias

import numpy as np

from jointid.common.errors import JointidError
from jointid.common.text import number
from jointid.estimation.result.assemble import FitResult
from jointid.records.record import Record, Timing

_CORRELATED = 2.0  # times the deviation of white residuals: neighbouring rows are alike
_CONTRADICTED = 1.5  # times two deviations: a stated timing that is farther from the minimum than halfway to another
_READINGS = (Timing.HELD, Timing.SAMPLED, Timing.AVERAGED)

Logs: TypeAlias = Sequence[Record]


def read_as(records: Logs, timing: Timing | None, stated: bool = False) -> Logs:
    """Return records with another timing of the torques that are stated, or are not; None keeps them."""
    return [
        replace(record, torque=replace(record.torque, timing=timing))
        if timing is not None and record.torque is not None and record.torque.stated == stated
        else record
        for record in records
    ]


def read_timing(answer: Mapping[str, Any]) -> Timing | None:
    """Return the timing of an estimate's JSON as which a torque was read; None in files before version 0.3."""
    found = answer.get("torque_timing")
    return None if found is None else Timing(found)


def fit_unstated_timing(records: Logs, fit: Callable[[Logs], FitResult]) -> FitResult:
    """Return the fit by the torque's timing with the smaller residual; intervals cover the other as needed.

    Args:
        records: of one log, or of the joints of a robot.
        fit: of records.
    """
    torques = [record.torque for record in records if record.torque is not None]
    stated = all(torque.stated for torque in torques)
    read = {torque.timing for torque in torques if stated or not torque.stated}
    first = fit(records)
    if len(read) != 1 or (stated and first.fit.simulations):  # instruments are simulated, minutes for a robot
        return first
    own = read.pop()

    try:
        fits = [first if timing is own else fit(read_as(records, timing, stated)) for timing in _READINGS]
    except JointidError:  # another reading determines nothing
        return first
    left = np.array([[*one.fit.axis_errors.values()] or [one.fit.filtered_error] for one in fits]) ** 2
    # Of each equation in units of the least variance that a reading leaves: a sum of as many squares as it has rows.
    costs = np.sum(left / np.maximum(left.min(axis=0), 1e-24), axis=1) * (first.fit.rows / left.shape[1])
    curve = costs[0] - 2 * costs[1] + costs[2]
    if not (np.all(np.isfinite(costs)) and curve > 0):
        return first
    best = float(np.clip(1.0 - 0.5 * (costs[2] - costs[0]) / curve, -1.0, 2.0))
    spread = 2 * _CORRELATED / float(np.sqrt(curve))
    where = (
        f"the record puts it {number(0.5 * best, 2)} +- {number(0.5 * spread, 2)} samples before held (sampled is 0.5, "
        "averaged 1)"
    )
    if stated:
        if abs(best - _READINGS.index(own)) <= 0.5 + _CONTRADICTED * spread:
            return first
        said = f"the torque is stated as {own}, and {where}; check timing of its channel, and the delay"
        return replace(first, checks=replace(first.checks, warnings=(said, *first.checks.warnings)))
    at = int(abs(best - 1.0) < abs(best))
    away = abs(best - at) + min(spread, 1.0)
    chosen, (held, sampled) = fits[at], ({row.name: row for row in one.params.rows} for one in fits[:2])

    def widen(name: str, value: float | None, stderr: float | None) -> float | None:
        a, b = held[name].value, sampled[name].value
        if stderr is None or value is None or a is None or b is None:
            return stderr
        return float(np.hypot(stderr, 0.5 * away * abs(b - a)))

    rows = tuple(replace(row, stderr=widen(row.name, row.value, row.stderr)) for row in chosen.params.rows)
    part = chosen.robot
    if part is not None:  # what is made of all its parameters, as bodies and a payload, has the same errors
        std = np.array([row.stderr or 0.0 for row in rows])
        part = replace(part, covariance=replace(part.covariance, std=std))
    said = (
        f"nobody stated whether the torque is held or sampled: it is read as {_READINGS[at]}, and {where}; the "
        "intervals cover that; state timing of its channel"
    )
    return replace(
        chosen,
        settings=replace(chosen.settings, timing=_READINGS[at]),
        params=replace(chosen.params, rows=rows),
        robot=part,
        checks=replace(chosen.checks, warnings=(said, *chosen.checks.warnings)),
    )
