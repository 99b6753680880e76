"""Where a cascade with an integral is looked for first: by a regression that holds it without its filter's numbers.

With e = r - q and S the sum of T e, a P-PI law with the share f of the reference's velocity is::

    u = kv (kp + f ki) e - kv v + kv f dr/dt + kv kp ki S + kv ki (f - 1) q + ...

linear in five coefficients, of which the gains follow. Gauss and Newton from the gains of a PID would not come here.
"""

from __future__ import annotations

import math

import numpy as np

from jointid.data.record import FloatArray
from jointid.learning.watched import Watched, later
from jointid.model.controllers import CONSTANT, DIRECTION, POSITION, REFERENCE, as_filter
from jointid.model.controllers.filters import Filter

_NEAR = 0.98  # of the plateau: what is above may have been cut


def cascade_start(
    watched: Watched, velocity_filter: Filter | tuple[float, ...], late: int, gain: float
) -> dict[str, float]:
    """Return gains of a P-PI law with all feed-forwards, roughly.

    Args:
        watched: the record.
        velocity_filter: of the law, with numbers.
        late: samples by which the log shows the torque late.
        gain: torque per controller unit.
    """
    from scipy.signal import lfilter

    inputs, period = watched.inputs(1), watched.period
    r, q = inputs[:, REFERENCE], inputs[:, POSITION]
    b, a = as_filter(velocity_filter).coefficients(period)
    velocity = lfilter(b, a, _rate(q, period))
    columns = np.column_stack([
        r - q, velocity, _rate(r, period), np.cumsum(r - q) * period, q - q[0],
        _rate(_rate(r, period), period), inputs[:, DIRECTION], inputs[:, CONSTANT],
    ])  # fmt: skip
    rows = np.flatnonzero(watched.kept * (np.abs(watched.torque) < _NEAR * (watched.plateau or math.inf)))
    rows = rows[rows >= late]
    X = columns[rows - late]
    scale = np.linalg.norm(X, axis=0)
    scale = np.where(scale > 0, scale, 1.0)
    torque = watched.torque + watched.added - later(watched.added, late)
    found = np.linalg.lstsq(X / scale, torque[rows] / gain, rcond=1e-12)[0] / scale
    kv = max(float(-found[1]), 1e-12)
    share = min(max(float(found[2]) / kv, 0.0), 2.0)
    half, product = 0.5 * float(found[0]) / kv, float(found[3]) / kv
    kp = half + math.sqrt(max(half**2 - share * product, 0.0))
    return {
        "kp": max(kp, 1e-12), "kv": kv, "ki": max(product / kp, 0.0) if kp > 0 else 0.0,
        "velocity_feedforward": share, "acceleration_feedforward": max(float(found[5]), 0.0),
        "coulomb_feedforward": max(float(found[6]), 0.0), "integral": 0.0,
    }  # fmt: skip


def _rate(signal: FloatArray, period: float) -> FloatArray:
    return np.asarray(np.diff(signal, prepend=signal[:1]) / period)
