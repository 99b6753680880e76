"""A torque of unstated timing: both readings are fitted, and the answer covers what the record leaves open.

**IDIM.** A torque held from its stamp and one sampled at it differ by half a sample. That moves friction and inertia.
The residual power of least squares is nearly a parabola in the shift. Three shifts, held, sampled and averaged, give
its minimum. The reading that is nearer to it is taken. Each interval is widened by the change of its parameter up to
the minimum, and by the change for two deviations of the minimum. A stated timing is obeyed.

**The drive side.** The log's delay is a parameter, and another reading changes it by half a sample
and nothing else. So it is estimated, also where it was given, and its own interval covers half a sample.

**DIDIM.** A controller's output is the same at its stamp and until its next period. Both readings are one.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import replace
from typing import TypeAlias

import numpy as np

from jointid.common.arrays import FloatArray
from jointid.common.errors import JointidError
from jointid.common.text import number
from jointid.estimation.problems.base import LOG_DELAY
from jointid.estimation.result.estimate import Estimate
from jointid.records.record import Channel, Record, Timing

_CORRELATED = 2.0  # times the deviation of white residuals: neighbouring rows are alike
_FLAT = 1e-6  # cost: less is taken for rounding, and the record does not tell the readings apart
_DELAY_SAID = (
    "it is not stated whether the torque is held or sampled: log_delay, which makes up for the difference, is "
    "estimated, counts from a held torque, and its interval covers half a sample; state timing of its channel"
)
_LATEST = 8.0  # half samples: beyond, the residual power is no parabola
_READINGS = (Timing.HELD, Timing.SAMPLED, Timing.AVERAGED)

Logs: TypeAlias = Sequence[Record]


def read_as(records: Logs, timing: Timing | None) -> Logs:
    """Return records with another timing of the torques that do not state it; None keeps it."""

    def read(torque: Channel) -> Channel:
        return replace(torque, timing=timing) if timing and not torque.stated else torque

    return [one if one.torque is None else replace(one, torque=read(one.torque)) for one in records]


def fit_unstated_timing(records: Logs, fit: Callable[[Logs], Estimate]) -> Estimate:
    """Return the fit by the timing, held or sampled, nearer the minimum.

    A fit that cannot be compared with another reading says so. A stated timing is kept.

    Args:
        records: of one log, or of the joints of a robot.
        fit: of records.
    """
    first = fit(records)
    read = {one.torque.timing for one in records if one.torque is not None and not one.torque.stated}
    if read and first.settings.method == "drive_side":
        return _widen(first, {LOG_DELAY.name: 0.25 * first.data.sample_time}, _DELAY_SAID)  # half in two deviations
    if not read or first.settings.method != "idim":
        return first
    own, fits = min(read, key=_READINGS.index), dict[Timing, Estimate]()
    if len(read) == 1:
        fits = _fit_readings(lambda timing: first if timing is own else fit(read_as(records, timing)))
    if not fits.keys() >= {Timing.HELD, Timing.SAMPLED}:
        said = (
            f"it is not stated whether the torque is held or sampled: it is read as {' and '.join(sorted(read))}; the "
            "other reading is as possible, and the intervals do not cover it; state timing of its channel"
        )
        return _widen(first, {}, said)

    best, spread, told = _find_minimum(fits)
    both = [fits[timing] for timing in _READINGS[:2]]
    change = {name: 0.5 * abs(by) for name, by in _moved(both[1], both[0]).items()}
    best = float(np.clip(best, -_LATEST, _LATEST))
    at = int(abs(best - 1.0) < abs(best))
    where = (
        f"the record puts it {number(0.5 * best, 2)} ± {number(0.5 * spread, 2)} samples before held (sampled is "
        "0.5, averaged 1)"
        if told
        else "the other reading is as possible"
    )
    away = abs(best - at) + min(spread, 1.0)
    chosen, by = both[at], {name: away * one for name, one in change.items()}
    said = (
        f"it is not stated whether the torque is held or sampled: it is read as {_READINGS[at]}, and {where}; the "
        "intervals cover that; state timing of its channel"
    )
    return _widen(replace(chosen, settings=replace(chosen.settings, timing=_READINGS[at])), by, said)


def _fit_readings(fit: Callable[[Timing], Estimate]) -> dict[Timing, Estimate]:
    """Return the fits of the readings that determine something."""
    found = dict[Timing, Estimate]()
    for timing in _READINGS:
        with suppress(JointidError):
            found[timing] = fit(timing)
    return found


def _moved(one: Estimate, other: Estimate) -> dict[str, float]:
    """Return how far the values of one fit are from those of another; what only one of them has is 0 in the other."""
    here, there = ({row.name: row.value or 0.0 for row in fit.params.rows} for fit in (one, other))
    return {name: here.get(name, 0.0) - there.get(name, 0.0) for name in here | there}


def _find_minimum(fits: Mapping[Timing, Estimate]) -> tuple[float, float, bool]:
    """Return the delay of least residual in half samples, two deviations, and its significance.

    Args:
        fits: of a held and a sampled torque at least; without the averaged one nothing is told.
    """
    left = np.array([_squares(one) for one in fits.values()])
    # Of each equation in units of the least variance that a reading leaves: a sum of as many squares as it has rows.
    rows = fits[Timing.HELD].fit.rows / left.shape[1]
    costs = np.sum(left / np.maximum(left.min(axis=0), 1e-24), axis=1) * rows
    curve = float(costs[0] - 2 * costs[1] + costs[2]) if len(costs) == len(_READINGS) else 0.0
    if np.isfinite(curve) and curve > _FLAT:
        return 1.0 - 0.5 * float(costs[2] - costs[0]) / curve, 2 * _CORRELATED * float(np.sqrt(2 / curve)), True
    return float(costs[0] - costs[1] > _FLAT), np.inf, False  # the cost rises by 1 within sqrt(2 / curve)


def _squares(found: Estimate) -> FloatArray:
    """Return the residual power of each equation, as a share of the torque's."""
    return np.array([*found.fit.axis_errors.values()] or [found.fit.filtered_error]) ** 2


def all_stated(logs: Sequence[Logs]) -> bool:
    """Return whether the timing of every torque is stated."""
    return all(record.torque.stated for log in logs for record in log if record.torque is not None)


def _widen(found: Estimate, by: Mapping[str, float], said: str) -> Estimate:
    """Return a fit with these further deviations of parameters, by name, and the reason as its first warning."""
    rows = tuple(
        row if row.stderr is None else replace(row, stderr=float(np.hypot(row.stderr, by.get(row.name, 0.0))))
        for row in found.params.rows
    )
    part = found.robot
    if part is not None:  # what is made of all its parameters, as bodies and a payload, has the same errors
        std = np.hypot(part.covariance.std, [by.get(name, 0.0) for name in part.names])
        part = replace(part, covariance=replace(part.covariance, std=std))
    checks = replace(found.checks, warnings=(said, *found.checks.warnings))
    return replace(found, params=replace(found.params, rows=rows), robot=part, checks=checks)
