"""A torque of unstated timing: both readings are fitted, and the answer covers what the record leaves open.

**IDIM.** A torque held from its stamp and one sampled at it differ by half a sample. That moves friction and inertia.
The residual power of least squares is nearly a parabola in the shift. Three shifts, held, sampled and averaged, give
its minimum. The reading that is nearer to it is taken. Each interval is widened by the change of its parameter up to
the minimum, and by the change for two deviations of the minimum. A stated timing is obeyed; where the minimum lies
nearer to another reading by more than three deviations, the answer says so. A minimum that is more than half a sample
away from every possible reading may be that of a late log: its delay is estimated by further shifts, and said. It is
taken off where all joints show it, and friction under load or a torque constant that falls does not explain as much.

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
from jointid.estimation.result.assemble import FitResult
from jointid.estimation.result.parts import Settings
from jointid.records.record import Channel, Record, Timing
from jointid.uncertainty.covariance import Covariance
from jointid.uncertainty.verdict import Reason

_CORRELATED = 2.0  # times the deviation of white residuals: neighbouring rows are alike
_FLAT = 1e-6  # cost: less is taken for rounding, and the record does not tell the readings apart
_CONTRADICTED = 1.5  # times two deviations: a stated timing that is farther from the minimum than halfway to another
_DELAY_SAID = (
    "it is not stated whether the torque is held or sampled: log_delay, which makes up for the difference, is "
    "estimated, counts from a held torque, and its interval covers half a sample; state timing of its channel"
)
_LATE = 1.0  # half samples beyond every possible reading: a minimum further away may be that of a late log
_BETTER = 16.0  # squared deviations, by which a delay must explain more than friction under load or another constant
_BEND, _SPAN = 0.02, 5  # of the torque: a step of these; samples to each side that tell the direction
_APART = 2.0  # half samples, by which the delay of one joint's torque must differ to be said
_LONGEST, _STEP, _TRIES = 20, 2.0, 12  # samples of delay; half samples of a search's first steps; these
_READINGS = (Timing.HELD, Timing.SAMPLED, Timing.AVERAGED)

Logs: TypeAlias = Sequence[Record]
_Way: TypeAlias = Callable[[FloatArray, FloatArray], FloatArray]  # of a torque and the direction of the motion


def read_as(records: Logs, timing: Timing | None, stated: bool = False, late: float | None = None) -> Logs:
    """Return records with another timing of the torques that are stated, or are not, and a later log.

    Args:
        records: to read.
        timing: None keeps it.
        stated: whether the torques of stated timing are read so, or the others.
        late: seconds by which the log shows every torque late; None keeps it.
    """

    def read(torque: Channel) -> Channel:
        own = timing if timing and torque.stated == stated else torque.timing
        return replace(torque, timing=own, late=torque.late if late is None else late)

    return [one if one.torque is None else replace(one, torque=read(one.torque)) for one in records]


def read_as_identified(records: Logs, settings: Settings) -> Logs:
    """Return records of a robot with torques as its estimate by IDIM read them: their timing, and the log's delay."""
    return read_as(records, settings.timing, late=-settings.delay)


def fit_unstated_timing(records: Logs, fit: Callable[[Logs], FitResult]) -> FitResult:
    """Return the fit by the timing, held or sampled, nearer the minimum.

    A fit that cannot be compared with another reading says so. A stated timing is kept.

    Args:
        records: of one log, or of the joints of a robot.
        fit: of records.
    """
    torques = [record.torque for record in records if record.torque is not None]
    stated = all(torque.stated for torque in torques)
    read = {torque.timing for torque in torques if stated or not torque.stated}
    first = fit(records)
    if first.settings.method == "drive_side" and not stated:
        return _widen(first, {LOG_DELAY.name: 0.25 * first.data.sample_time}, _DELAY_SAID)  # half in two deviations
    if first.settings.method != "idim" or (stated and (len(read) != 1 or first.fit.simulations)):
        return first  # instruments are simulated, minutes for a robot
    own, fits = min(read, key=_READINGS.index), dict[Timing, FitResult]()
    if len(read) == 1 and not first.fit.interrupted:
        fits = _fit_readings(lambda timing: first if timing is own else fit(read_as(records, timing, stated)))
    if not fits.keys() >= {Timing.HELD, Timing.SAMPLED}:
        said = (
            f"it is not stated whether the torque is held or sampled: it is read as {' and '.join(sorted(read))}; the "
            "other reading is as possible, and the intervals do not cover it; state timing of its channel"
        )
        return first if stated else _widen(first, {}, said)

    best, spread, told = _find_minimum(fits)
    both = [fits[timing] for timing in _READINGS[:2]]
    change = {name: 0.5 * abs(by) for name, by in _moved(both[1], both[0]).items()}
    late = None
    # A stated timing may be wrong: what another one makes up for is no delay.
    # Of a wrong sign no shift is the best, and each try fits the robot anew.
    signs = any(one.code is Reason.FRICTION_NEGATIVE for verdict in first.checks.verdicts for one in verdict.reasons)
    if not signs and max(-best, best - (2 if stated else 1)) > max(_LATE, _CONTRADICTED * spread):
        late = _fit_late_log(records, fit, own if stated else Timing.HELD, best, stated=stated)
    if late is None and told and (apart := _find_apart(fits, best)):
        joint, off = apart
        said = (
            f"the torque of {joint} seems logged {number(0.5 * abs(off), 2)} samples "
            f"{'later' if off > 0 else 'earlier'} than those of the other joints: nothing is taken off, and the "
            "intervals cover it; check the time stamps and the friction of this joint"
        )
        late = first if stated else replace(first, settings=replace(first.settings, timing=own))
        late = _widen(late, {name: abs(off) * by for name, by in change.items()}, said)
    if late is not None:
        return late
    best = float(np.clip(best, -1.0, 2.0))
    at = int(abs(best - 1.0) < abs(best))
    where = (
        f"the record puts it {number(0.5 * best, 2)} ± {number(0.5 * spread, 2)} samples before held (sampled is "
        "0.5, averaged 1)"
        if told
        else "the other reading is as possible"
    )
    if stated:
        said = f"the torque is stated as {own}, and {where}; check timing of its channel, and the delay"
        agrees = abs(best - _READINGS.index(own)) <= 0.5 + _CONTRADICTED * spread
        return first if agrees else _widen(first, {}, said)
    away = abs(best - at) + min(spread, 1.0)
    chosen, by = both[at], {name: away * one for name, one in change.items()}
    said = (
        f"it is not stated whether the torque is held or sampled: it is read as {_READINGS[at]}, and {where}; the "
        "intervals cover that; state timing of its channel"
    )
    return _widen(replace(chosen, settings=replace(chosen.settings, timing=_READINGS[at])), by, said)


def _fit_readings(fit: Callable[[Timing], FitResult]) -> dict[Timing, FitResult]:
    """Return the fits of the readings that determine something."""
    found = dict[Timing, FitResult]()
    for timing in _READINGS:
        with suppress(JointidError):
            found[timing] = fit(timing)
    return found


def _moved(one: FitResult, other: FitResult) -> dict[str, float]:
    """Return how far the values of one fit are from those of another; what only one of them has is 0 in the other."""
    here, there = ({row.name: row.value or 0.0 for row in fit.params.rows} for fit in (one, other))
    return {name: here.get(name, 0.0) - there.get(name, 0.0) for name in here | there}


def _find_minimum(fits: Mapping[Timing, FitResult]) -> tuple[float, float, bool]:
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


def _squares(found: FitResult) -> FloatArray:
    """Return the residual power of each equation, as a share of the torque's."""
    return np.array([*found.fit.axis_errors.values()] or [found.fit.filtered_error]) ** 2


def _fit_late_log(
    records: Logs, fit: Callable[[Logs], FitResult], own: Timing, best: float, *, stated: bool
) -> FitResult | None:
    """Return the fit without the delay of the log, or an undelayed one that covers it; None where no shift is the best.

    Args:
        records: of one log, or of the joints of a robot.
        fit: of records.
        own: reading that the delay counts from.
        best: where the minimum may be, in half samples before a held torque.
        stated: whether the torques' timing is.
    """
    period = next(record.torque.sample_time for record in records if record.torque is not None)
    best, move = float(np.clip(best, -_STEP, _STEP)), 0.0
    for _ in range(_TRIES):
        if abs(best) > 2 * _LONGEST:
            return None
        before = 0.5 * (best - 1.0) * period  # the middle one of three readings is then where the minimum may be
        fits = _fit_readings(lambda timing, late=before: fit(read_as(records, timing, stated, late)))  # type: ignore[misc]
        if len(fits) < len(_READINGS):
            return None
        off, spread, told = _find_minimum(fits)
        if told and abs(off - 1.0) < 1.0:
            best += off - 1.0
            break
        # Far away the squares are no parabola: they only say on which side the minimum is.
        ahead = off > (1.0 if told else 0.0)
        move = (2.0 * move if move > 0.0 else _STEP) if ahead else (2.0 * move if move < 0.0 else -_STEP)
        best += move
    else:
        return None
    late = 0.5 * (best - _READINGS.index(own)) * period
    found = fit(read_as(records, own, stated, late))
    size = f"{number(1e3 * abs(late), 3)} ± {number(500 * spread * period, 2)} ms {'later' if late > 0 else 'earlier'}"
    kept = fit(read_as(records, own, stated))
    others = _shift_otherwise(records, fit, found, kept)
    if others or _find_apart(fits, 1.0):
        shifts = _moved(found, kept), *others
        by = {name: 0.5 * max(abs(one.get(name, 0.0)) for one in shifts) for name in shifts[0]}  # in two deviations
        said = (
            f"the log may show the torque {size} than the positions, or that of one joint; or friction grows with the "
            "load, or the torque constant falls with the torque: nothing is taken off, and the intervals cover these "
            "changes"
        )
        return _widen(kept if stated else replace(kept, settings=replace(kept.settings, timing=own)), by, said)
    change = _moved(fits[Timing.SAMPLED], fits[Timing.HELD])
    by = {name: 0.5 * spread * abs(one) for name, one in change.items()}
    said = (
        f"the log shows the torque {size} than the positions: this delay is estimated and taken off, and the intervals "
        "cover it; correct the log's time stamps, or declare the filter that delays the torque"
    )
    settings = replace(found.settings, delay=found.settings.delay - late, timing=None if stated else own)
    return _widen(replace(found, settings=settings), by, said)


def _find_apart(fits: Mapping[Timing, FitResult], best: float) -> tuple[str, float] | None:
    """Return the joint whose residual is least farthest from the common minimum, and by how many half samples.

    None where all agree.

    Args:
        fits: of all readings.
        best: the common minimum, in half samples before a held torque.
    """
    left = np.array([_squares(fits[one]) for one in _READINGS])
    costs = left / np.maximum(left.min(axis=0), 1e-24) * fits[Timing.HELD].fit.rows / left.shape[1]
    curve = np.maximum(costs[0] - 2 * costs[1] + costs[2], _FLAT)
    away = 1.0 - 0.5 * (costs[2] - costs[0]) / curve - best
    least = np.maximum(_APART, _CONTRADICTED * 2 * _CORRELATED * np.sqrt(2 / curve))
    # Of what is farther than the longest delay the squares are no parabola.
    sizes = np.where((np.abs(away) > least) & (np.abs(away) < 2 * _LONGEST), np.abs(away), 0.0)
    at, names = int(np.argmax(sizes)), [*fits[Timing.HELD].fit.axis_errors]
    return (names[at], float(away[at])) if names and sizes[at] > 0.0 else None


def _shift_otherwise(
    records: Logs, fit: Callable[[Logs], FitResult], found: FitResult, kept: FitResult
) -> list[dict[str, float]]:
    """Return how another error of the torque moves the parameters, of each that explains as much as a delay.

    Args:
        records: of one log, or of the joints of a robot.
        fit: of records.
        found: without the delay.
        kept: with it.
    """
    least, shifts = np.maximum(_squares(found), 1e-24), list[dict[str, float]]()
    for way in (_under_load, _falling):
        costs = [
            float(np.sum(_squares(one) / least - 1)) * found.fit.rows / least.size
            for one in (fit(_bend(records, way, -_BEND)), kept, fit(_bend(records, way, _BEND)))
        ]
        curve, slope = costs[0] - 2 * costs[1] + costs[2], 0.5 * (costs[2] - costs[0])
        if curve > 0.0 and costs[1] - 0.5 * slope**2 / curve < _BETTER:
            shifts.append(_moved(fit(_bend(records, way, -_BEND * slope / curve, whole=True)), kept))
    return shifts


def _bend(records: Logs, way: _Way, by: float, *, whole: bool = False) -> Logs:
    """Return records without a multiple of an error of the torque.

    Unless `whole`, the part of the error that is a scale of the torque stays.
    """

    def bend(torque: Channel, position: Channel) -> Channel:
        moved = np.convolve(position.values, [1.0, *[0.0] * (2 * _SPAN - 1), -1.0], "same")
        other, own = way(torque.values, np.interp(torque.time, position.time, np.sign(moved))), torque.values
        scale = 0.0 if whole else (other @ own) / (own @ own)
        return replace(torque, values=own + by * (other - scale * own))

    return [
        replace(one, torque=bend(one.torque, one.motor_position)) if one.torque and one.motor_position else one
        for one in records
    ]


def _under_load(torque: FloatArray, direction: FloatArray) -> FloatArray:
    """Return friction of gears under load."""
    return np.abs(torque) * direction


def _falling(torque: FloatArray, direction: FloatArray) -> FloatArray:
    """Return the change of a torque by a torque constant that falls with it."""
    del direction
    size = np.abs(torque)
    return np.asarray(torque * size / size.max(), dtype=np.float64)


def all_stated(logs: Sequence[Logs]) -> bool:
    """Return whether the timing of every torque is stated."""
    return all(record.torque.stated for log in logs for record in log if record.torque is not None)


def cover_both_readings(
    logs: Sequence[Logs], fit: Callable[[Sequence[Logs]], tuple[FloatArray, Covariance]]
) -> tuple[FloatArray, Covariance]:
    """Fit, with intervals that cover held and sampled torques of unstated timing.

    Args:
        logs: records of the joints of each.
        fit: of logs: values, (parameters,), and their covariance.
    """
    values, covariance = fit(logs)
    if all_stated(logs):
        return values, covariance
    held, sampled = (fit([read_as(log, timing) for log in logs])[0] for timing in _READINGS[:2])
    return values, replace(covariance, std=np.hypot(covariance.std, 0.5 * (sampled - held)))  # half in two deviations


def _widen(found: FitResult, by: Mapping[str, float], said: str) -> FitResult:
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
