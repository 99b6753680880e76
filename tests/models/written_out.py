"""The laws of docs/controllers.md written out once more, signal by signal, with no code of jointid.

The bilinear rule is SciPy's, at a sampling frequency that is bent to be exact at one frequency; a filter is its
recurrence. Nothing here knows of states, elements or matrices.
"""

import math
from typing import Any

import numpy as np
from scipy.signal import bilinear, lfilter

from jointid.models.controllers import PD, PID, Cascade, FirstOrder, Notch, SecondOrder
from jointid.models.controllers.filters import DigitalFilter, MovingAverage

SETTLED = 4000  # periods of uniform motion before the first period: all filters here have forgotten by then
Array = np.ndarray[Any, np.dtype[np.float64]]


def bent(numerator: list[float], denominator: list[float], frequency: float, T: float) -> tuple[Any, Any]:
    """The bilinear rule, exact at a frequency."""
    return bilinear(numerator, denominator, math.pi * frequency / math.tan(math.pi * frequency * T))


def coefficients(made: Any, T: float) -> tuple[Array, Array]:
    """Numerator and denominator of a filter in powers of 1/z, the latter beginning with 1."""
    match made:
        case DigitalFilter():
            b, a = made.numerator, made.denominator
        case MovingAverage():
            b, a = np.full(made.samples, 1 / made.samples), [1.0]
        case FirstOrder():
            pole = math.exp(-T / made.time_constant) if made.time_constant else 0.0
            b, a = [1 - pole], [1.0, -pole]
        case SecondOrder():
            w = 2 * math.pi * made.frequency
            b, a = bent([1.0], [1 / w**2, 2 * made.damping / w, 1.0], made.frequency, T)
            if made.numerator_frequency is not None:
                w = 2 * math.pi * made.numerator_frequency
                zeros = [1 / w**2, 2 * made.numerator_damping / w, 1.0]
                c, d = bent([1.0], zeros, made.numerator_frequency, T)
                b = np.array(d) * b[0] / c[0]  # both have (1 + 1/z)^2 above, which cancels
        case Notch():
            w, width = 2 * math.pi * made.frequency, 2 * math.pi * made.bandwidth
            b, a = bent([1.0, made.depth * width, w**2], [1.0, width, w**2], made.frequency, T)
        case _:
            b, a = made, [1.0]
    return np.asarray(b, dtype=float), np.asarray(a, dtype=float)


def filtered(made: Any, T: float, x: Array) -> Array:
    return np.asarray(lfilter(*coefficients(made, T), x))


def late(x: Array, seconds: float, T: float) -> Array:
    """A signal later by a time: a straight line between two of its values."""
    k = np.arange(x.size)
    return np.interp(k - seconds / T, k, x)


def torque_of(law: Cascade | PD, T: float, r: Array, rv: Array, direction: Array, injected: Array, q: Array) -> Array:
    """Return the torque behind `SETTLED` periods, in which nothing is limited and no integral grows."""
    r, rv, direction = (late(x, law.reference_delay, T) for x in (r, rv, direction))
    v = filtered(law.velocity_filter, T, np.diff(q, prepend=q[0]) / T)
    dr = np.diff(r, prepend=r[0]) / T
    fed = law.acceleration_feedforward * np.diff(dr, prepend=0.0) / T + law.viscous_feedforward * dr
    fed += law.coulomb_feedforward * direction + law.constant_feedforward
    k = np.arange(-SETTLED, r.size - SETTLED)
    if isinstance(law, Cascade):
        n = round(law.position_period / T) if law.position_period else 1
        at = np.arange(r.size) - (k - round(law.position_offset / T)) % n  # when the position loop acted last
        slow = (r - np.roll(r, n)) / (n * T) if law.reference_velocity == "difference" else rv
        command = (law.position_gain * (r - q) + law.velocity_feedforward * slow)[at]
        command = np.where(k < 0, command, np.clip(command, -law.velocity_limit, law.velocity_limit))
        into, u, weight = T * (command - v), law.velocity_gain * (command - v), law.velocity_gain * law.integral_gain
    else:
        wanted = {"difference": filtered(law.velocity_filter, T, dr), "channel": rv, "none": 0.0 * rv}
        u = law.position_gain * (r - q) + law.derivative_gain * (wanted[law.reference_velocity] - v)
        into, weight = T * (r - q), law.integral_gain if isinstance(law, PID) else 0.0
    known, limit = law.gain * (u + fed) + injected, law.limit * law.gain
    for one in law.torque_filters:
        known = filtered(one, T, known)
    each = [coefficients(one, T) for one in law.torque_filters]
    memory = [np.zeros(max(len(b), len(a)) - 1) for b, a in each]
    out, content = np.zeros(r.size - SETTLED), 0.0
    for i, m in enumerate(known[SETTLED:]):
        x = np.array([law.gain * weight * content])  # what the integral adds, through the filters
        for f, (b, a) in enumerate(each):
            x, memory[f] = lfilter(b, a, x, zi=memory[f])
        raw = m + x[0]
        out[i] = min(max(raw, -limit), limit)
        step = into[SETTLED + i]
        windup = getattr(law, "anti_windup", "none")
        if windup == "hold" and step * (raw - out[i]) > 0:
            step = 0.0
        if windup == "track" and weight:
            step += (out[i] - raw) / (law.gain * weight)
        content += step
    return out
