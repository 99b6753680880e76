"""What the declared controller makes of the reference and the motor's logged position, beside the logged torque.

No joint is needed for that: with the position known the law is all there is between them. So the law, the delay and the
log's gain are seen before anything is identified, and apart from what the joint is.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from jointid.common.arrays import FloatArray
from jointid.common.errors import JointidError
from jointid.models.controllers import POSITION, respond, run
from jointid.models.joints import ClosedLoop
from jointid.records.record import Record
from jointid.records.resampling import at_period
from jointid.simulation.loop_input import LoopInput, prepare, to_log

_LATEST = 8.0  # samples, to both sides, that the torque may be later than the law makes it
_PARTS = 4  # of a sample: the steps in which that is looked for
_BORDER = 20  # samples at each end that are not compared
_BETTER = 0.8  # times: what a delay must leave of the rest to be one
_LAGS = 8  # samples of reference and position that a free law sees


@dataclass(frozen=True, slots=True)
class LawOnPosition:
    """How the torque follows from the declared law, the reference and the motor's position.

    Attributes:
        left: share of the torque that is left, about its mean.
        gain: by which the law's torque is to be multiplied.
        late: seconds that the logged torque is later than the law, with its declared delay, makes it; 0 where no
            shift explains clearly more.
        left_in_time: share that is left with the torque so much earlier.
        noise: share that is left by any law that sums up the last samples of reference and position, and their
            difference: what of the torque is noise of its log.
    """

    left: float
    gain: float
    late: float
    left_in_time: float
    noise: float


def compare_law(record: Record, loop: ClosedLoop) -> LawOnPosition | None:
    """Compare the logged torque with what the law makes of the motor's position; None without one.

    The integral's value at the first sample, and a constant in the torque, are free. A law that runs faster than the
    log sees a position between two samples, which is taken as a straight line.
    """
    torque = record.torque
    if record.motor_position is None or record.reference is None or torque is None:
        return None
    try:
        made = _torques(record, prepare(loop, record))
    except JointidError:
        return None
    if made is None:
        return None
    count = min(torque.values.size, len(made))
    logged, made = torque.values[:count], made[:count]
    if count < 4 * _BORDER or not np.all(np.isfinite(made)) or np.ptp(logged) == 0 or np.ptp(made[:, 0]) == 0:
        return None
    shifts = np.arange(-_LATEST * _PARTS, _LATEST * _PARTS + 1) / _PARTS
    fits = [_fit(logged, made, shift) for shift in shifts]
    left, gain = fits[int(np.argmin(np.abs(shifts)))]
    best = int(np.argmin([one[0] for one in fits]))
    noise = _regress(record, logged)
    late = _between(shifts, np.array([one[0] ** 2 for one in fits]), best) * torque.sample_time
    if fits[best][0] > _BETTER * left:
        return LawOnPosition(left, gain, 0.0, left, noise)
    return LawOnPosition(left, fits[best][1], late, fits[best][0], noise)


def _torques(record: Record, experiment: LoopInput) -> FloatArray | None:
    """Return the law's torque as it would be logged, (samples, columns), and behind it what 1 of its integral adds."""
    law, channel = experiment.law, record.motor_position
    assert channel is not None
    inputs = experiment.inputs.copy()
    inputs[:, POSITION] = at_period(channel, law.period, experiment.periods, "motor_position")
    start = law.known_memory(inputs) + law.memory(POSITION, float(inputs[0, POSITION]), 0.0)
    output = run(law, inputs, start).tapped + experiment.shown
    integral, columns = law.integral(), [output]
    if integral is not None:
        columns.append(respond(law, np.zeros_like(inputs), integral)[:, law.output])
    return to_log(experiment, np.column_stack(columns))


def _regress(record: Record, logged: FloatArray) -> float:
    """Return what is left of a torque by free weights of the last samples of what a law sees, of any law."""
    time = np.arange(logged.size) * record.torque.sample_time if record.torque is not None else np.arange(0.0)
    seen = {name: np.interp(time, one.time, one.values) for name, one in record.items()}
    r, q = seen["reference"], seen["motor_position"]
    columns = [np.cumsum(r - q), np.ones(r.size)]
    for signal in (r - q, np.gradient(q), *(seen[n] for n in ("reference_velocity", "injected") if n in seen)):
        columns += [np.concatenate([np.full(lag, signal[0]), signal[: signal.size - lag]]) for lag in range(_LAGS)]
    return _left(logged, np.column_stack(columns))[0]


def _fit(logged: FloatArray, made: FloatArray, shift: float) -> tuple[float, float]:
    """Return what is left of a torque if what the law makes acts so many samples later, and by which gain it does."""
    at = np.arange(logged.size)
    inside = slice(_BORDER, logged.size - _BORDER)
    later = np.column_stack([np.interp(at - shift, at, one) for one in made.T])[inside]
    rest, weights = _left(logged[inside], np.column_stack([later, np.ones(len(later))]))
    return rest, float(weights[0])


def _left(seen: FloatArray, columns: FloatArray) -> tuple[float, FloatArray]:
    """Return the share of a signal, about its mean, that columns leave, and their weights."""
    size = np.linalg.norm(columns, axis=0)
    size[size == 0.0] = 1.0
    weights = np.linalg.lstsq(columns / size, seen, rcond=None)[0]
    rest, whole = float(np.linalg.norm(seen - (columns / size) @ weights)), float(np.linalg.norm(seen - seen.mean()))
    return rest / whole if whole else math.inf, weights / size


def _between(at: FloatArray, values: FloatArray, best: int) -> float:
    """Return where the parabola through the least of values and its neighbours is least."""
    if not 0 < best < at.size - 1:
        return float(at[best])
    before, here, after = values[best - 1 : best + 2]
    bend = before - 2 * here + after
    moved = 0.5 * (before - after) / bend if bend > 0 else 0.0
    return float(at[best] + moved * (at[1] - at[0]))
