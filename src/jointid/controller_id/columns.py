"""Regressor columns of the controller laws, given filters and clocks.

With e = r - q, the filtered difference v = F D q, F the velocity's filter and S a sum over time, the torque of every
law of `structures` is::

    u = T(z) (a1 e + a2 v + a3 D r + a4 F D r + a5 S e + a6 r + a7 F q + a8 w + a9 S w
              + a10 D r + a11 D D r + a12 sign(D r) + a13)

w is the record's own reference velocity, T(z) the torque's filter; a slower position loop holds e, w and the first D r,
with its sum, a6. Each law has some of the coefficients, or couples them: a cascade with an integral is
``kv (1 + ki S) (kp e + f D r - v)``, linear in ``kv kp``, ``kv f`` and ``velocity_gain`` for a given ki.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from jointid.common.arrays import FloatArray
from jointid.controller_id.loop_record import LoopRecord
from jointid.controller_id.structures import ACCELERATION, COULOMB, FIELDS, INTEGRAL, VELOCITY, Structure, filters_of
from jointid.controller_id.structures import CONSTANT as BALANCE
from jointid.models.controllers import DIRECTION, INJECTED, POSITION, REFERENCE, REFERENCE_VELOCITY
from jointid.models.controllers.filters import Filter, as_filter

_LEAD = 64  # samples of straight motion before the first, in which the filters settle
_ROUNDING = 1e-14  # of the reference
_SLOPE = 5  # samples that tell how fast that is

_ERROR, _SPEED, _FED, _FED_FILTERED, _SUM, _COMMAND, _FILTERED, _CHANNEL, _CHANNEL_SUM, *_BESIDE = range(13)
_VISCOUS, _BENT, _SIGN, _ONE = _BESIDE
COLUMNS = 13
EVERY = np.eye(COLUMNS)


def columns(log: LoopRecord, structure: Structure, numbers: Mapping[str, float]) -> FloatArray:
    """Columns of the module's equation as logged, (samples, 13).

    `numbers` needs those of the filters and the reference's delay.
    """
    rate, period = structure.rate, log.period / structure.rate
    lead, slope = _LEAD * rate, _SLOPE * rate
    inputs = log.inputs(rate, structure.interpolation, structure.average)
    r, q = (_prepend_line(inputs[:, i] - inputs[0, POSITION], lead, slope) for i in (REFERENCE, POSITION))
    r = _delay(r, numbers.get("reference_delay", 0.0) / period)
    velocity, torque = filters_of(structure, numbers)
    speed = _differentiate(_filter_signals(velocity, np.column_stack([q, r]), period), period)
    e, fed = r - q, _differentiate(r, period)
    w, direction = (np.concatenate([np.full(lead, x[0]), x]) for x in inputs[:, [REFERENCE_VELOCITY, DIRECTION]].T)
    w, direction = (_delay(one, numbers.get("reference_delay", 0.0) / period) for one in (w, direction))
    viscous, bent = fed, _differentiate(fed, period)
    # Between two samples that lines join nothing is bent: what is left is rounding, and must not be a column.
    bent[np.abs(bent) < _ROUNDING * np.max(np.abs(r)) / period**2] = 0.0
    if structure.every > 1:  # the lead is a whole number of the slower loop's periods
        at = np.arange(r.size)
        last = np.maximum(at - (at - structure.offset) % structure.every, 0)
        fed = (r[last] - r[np.maximum(last - structure.every, 0)]) / (structure.every * period)
        e, w = e[last], w[last]
    e_sum, fed_sum, speed_sum, w_sum = (_running_sum(one, lead) * period for one in (e, fed, speed[:, 0], w))
    found = np.column_stack([
        e, speed[:, 0], fed, speed[:, 1], e_sum, fed_sum, speed_sum, w, w_sum,
        viscous, bent, direction, np.ones(r.size),
    ])  # fmt: skip
    return log.to_log(_filter_signals(torque, found, period)[lead:], rate)


def injected_torque(log: LoopRecord, structure: Structure, numbers: Mapping[str, float]) -> FloatArray:
    """Torque injected before the limit, as logged, (samples, 1)."""
    rate, (_, torque) = structure.rate, filters_of(structure, numbers)
    signal = log.inputs(rate, structure.interpolation)[:, [INJECTED]]
    return log.to_log(_filter_signals(torque, signal, log.period / rate), rate)


def coefficient_columns(structure: Structure, ki: float) -> dict[str, FloatArray]:
    """Combination of all columns that each gain of a law multiplies."""
    inner = ki if structure.cascade else 0.0
    fed = {"channel": EVERY[_CHANNEL] + inner * EVERY[_CHANNEL_SUM]}.get(
        structure.reference_velocity, EVERY[_FED] + inner * EVERY[_COMMAND]
    )
    speed = -EVERY[_SPEED] - inner * EVERY[_FILTERED]
    parts = {"position_gain": EVERY[_ERROR] + inner * EVERY[_SUM]}
    if structure.cascade:
        parts["velocity_gain"] = speed + (fed if structure.reference_velocity == "full" else 0.0)
        if structure.reference_velocity in ("share", "channel"):
            parts["velocity_feedforward"] = fed
    else:
        own = {"difference": EVERY[_FED_FILTERED], "channel": EVERY[_CHANNEL]}
        parts["derivative_gain"] = speed + own.get(structure.reference_velocity, 0.0)
        if structure.integrates:
            parts["integral_gain"] = EVERY[_SUM]
    beside = {VELOCITY: _VISCOUS, ACCELERATION: _BENT, COULOMB: _SIGN, BALANCE: _ONE}
    parts |= {FIELDS[name]: EVERY[i] for name, i in beside.items() if name in structure.feedforward}
    return parts | ({INTEGRAL: EVERY[_ONE]} if structure.integrates else {})


def law_coefficients(structure: Structure, numbers: Mapping[str, float]) -> FloatArray:
    """Coefficients of a law with its numbers, (COLUMNS,)."""
    known = dict(numbers)
    if structure.cascade:
        known["position_gain"] *= known["velocity_gain"]
        known["velocity_feedforward"] = known["velocity_gain"] * known.get("velocity_feedforward", 0.0)
    parts = coefficient_columns(structure, known.get("integral_gain", 0.0))
    return np.asarray(sum(known[name] * part for name, part in parts.items()))


def _prepend_line(signal: FloatArray, lead: int, slope: int) -> FloatArray:
    """Extrapolate a signal backwards by a straight line."""
    rate = (signal[slope] - signal[0]) / slope
    return np.concatenate([signal[0] + rate * np.arange(-lead, 0), signal])


def _delay(signal: FloatArray, periods: float) -> FloatArray:
    at = np.arange(signal.size)
    return np.asarray(np.interp(at - periods, at, signal)) if periods else signal


def _differentiate(signal: FloatArray, period: float) -> FloatArray:
    return np.asarray(np.diff(signal, axis=0, prepend=signal[:1]) / period)


def _running_sum(signal: FloatArray, lead: int) -> FloatArray:
    """Sum of earlier values from the first sample on."""
    sums = np.concatenate([[0.0], np.cumsum(signal[:-1])])
    return np.asarray(sums - sums[lead])


def _filter_signals(one: Filter | Sequence[float], signals: FloatArray, period: float) -> FloatArray:
    """Filter signals, (periods, signals), from the steady state of their first values."""
    from scipy.signal import lfilter, lfilter_zi

    b, a = as_filter(one).coefficients(period)
    if len(b) == len(a) == 1:
        return np.asarray(signals * (b[0] / a[0]))
    settled = lfilter_zi(b, a)[:, np.newaxis] * signals[:1]
    return np.asarray(lfilter(b, a, signals, axis=0, zi=settled)[0])
