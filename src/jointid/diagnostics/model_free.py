"""Shares of the torque that are explained without a model of the joint.

`find_unexplained_share` fits free linear responses. A linear loop answers its reference linearly, and Coulomb friction
is one more input of it, the sign of the velocity. So the torque is fitted by responses, as long as a loop remembers, to
acceleration, velocity and direction of the reference, and to a declared injected signal. The residual is about that of
the right controller and joint: a cause with a clearly larger residual does not explain everything.

`compare_law` compares the logged torque with the torque of the declared controller for the logged motor position. So
law, delay and the gain of the log are tested before a joint is identified. Where the law makes the logged torque,
`excludes` excludes other laws and logs, whatever the joint is.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from enum import StrEnum
from functools import partial

import numpy as np

from jointid.common.arrays import FloatArray, column_norms
from jointid.common.errors import JointidError
from jointid.common.messages import Message
from jointid.common.text import number
from jointid.estimation.problems.closed_loop import ClosedLoopProblem
from jointid.models.controllers import INJECTED, Controller
from jointid.models.joints import ClosedLoop
from jointid.records.record import Record
from jointid.records.signals.filtering import find_noise_limit, lowpass_below_noise
from jointid.simulation.controller_torque import law_outputs
from jointid.simulation.loop_input import prepare, to_log
from jointid.uncertainty.covariance import Influence

MEMORY = 0.3
"""Seconds that a loop remembers."""
SHORTEST = 2.0
"""Seconds of a record: a shorter one, less its borders, has fewer than two samples for each number of the responses."""
_STANDS = 1e-9  # of the greatest velocity
_RIDGE = 1e-10  # of a column's square: responses between samples of a filtered signal are nearly the same
_LATEST = 8  # samples: the largest delay, either way, of the torque
_PARTS = 4  # of a sample: the steps of the delay
_BORDER = 20  # samples at each end that are not compared
_BETTER = 0.8  # of the residual: a delay must reduce it to this
_LAGS = 8  # samples of reference and position in a free law
_OF_LAW = 0.03  # of a torque: what a controller which holds leaves along the logged position, at most
_BEYOND_NOISE = 2.0  # times what any law leaves: the declared one is not what the drive runs
_GAIN = 0.03  # off 1
_LEAVES = 0.1  # of the torque: more is not what rounding leaves
_MORE_THAN_NOISE = 1.25  # times what any law leaves of it
_LATE = 0.25  # samples: no more is no delay
_A_QUARTER, _SURELY = 0.25, 3.0  # of a change, with so many deviations: a record that has less of it excludes it


def find_unexplained_share(problem: ClosedLoopProblem, reference: FloatArray, memory: float = MEMORY) -> float:
    """Return the share of the torque that is no linear response to the reference or an injected signal.

    Args:
        problem: with the torque and its filter.
        reference: (samples,) in m or rad, over the same time.
        memory: length of the responses, s.
    """
    torque = problem.filter(problem.measured)
    if reference.size != problem.measured.size:  # logged at a rate of its own
        at = np.arange(problem.measured.size) * (reference.size / problem.measured.size)
        reference = np.interp(at, np.arange(reference.size), reference)
    velocity = np.gradient(reference)
    moving = np.abs(velocity) > _STANDS * np.max(np.abs(velocity))
    inputs = [np.gradient(velocity), velocity, np.sign(np.where(moving, velocity, 0.0))]
    added = problem.axis.inputs[:, INJECTED] + problem.axis.after_limit
    if np.any(added):
        inputs.append(to_log(problem.axis, added))
    count, seen = len(inputs), problem.filter(np.column_stack(inputs))
    lags = min(math.ceil(memory / (problem.sample_time * reference.size / torque.size)), torque.size)
    rows, width = torque.size, count * lags + 1
    if rows < 2 * width:
        return 0.0
    columns = np.column_stack([*(_lagged(one, lags) for one in seen.T), np.ones(rows)])
    columns /= column_norms(columns)
    weights = np.linalg.solve(columns.T @ columns + _RIDGE * np.eye(width), columns.T @ torque)
    left = float(np.linalg.norm(torque - columns @ weights) / np.linalg.norm(torque))
    return left * math.sqrt(rows / (rows - width))


def _lagged(signal: FloatArray, lags: int, before: float = 0.0) -> FloatArray:
    """Return a signal later by 0, 1, ... samples, (samples, lags), and a value before it."""
    whole = np.concatenate([np.full(lags - 1, before), signal])
    return np.lib.stride_tricks.sliding_window_view(whole, lags)[:, ::-1]


class Agreement(StrEnum):
    """How a declared law agrees with logged torque and motor position."""

    HOLDS = "loop_as_declared"
    DIFFERS = "law_differs"
    SCALED = "law_scaled"
    LATE = "law_late"


@dataclass(frozen=True, slots=True)
class LawOnPosition:
    """Logged torque beside the torque of the declared law for the logged motor position.

    Attributes:
        left: residual as a share of the torque about its mean.
        gain: factor on the law's torque.
        late: delay of the logged torque in addition to the declared one, s; 0 if no shift of more than a quarter of a
            sample explains clearly more.
        left_in_time: residual share with that delay corrected.
        noise: residual share of a free linear law of the last samples of reference and position, which is noise.
    """

    left: float
    gain: float
    late: float
    left_in_time: float
    noise: float

    @property
    def holds(self) -> bool:
        """Whether the declared law makes the logged torque."""
        in_time = self.late == 0.0 and abs(self.gain - 1.0) < _GAIN
        return in_time and self.left < max(_OF_LAW, _BEYOND_NOISE * self.noise)

    @property
    def agreement(self) -> Message:
        """Whether the declared law makes the logged torque of the motor's position, of code `Agreement`."""
        left = f"({number(100 * self.left, 2)} % of the torque is left)"
        code, said = Agreement.HOLDS, f"the declared law makes the torque of the motor's position {left}"
        if self.late and self.left_in_time < 2 * _LEAVES:
            way = f"{number(1e3 * abs(self.late), 2)} ms {'later' if self.late > 0 else 'earlier'}"
            code, said = Agreement.LATE, f"the torque is {way} than the declared law makes it of the motor's position: "
            said += "check the delay, and which instant a logged value stands for (timing)"
        elif self.left > max(_LEAVES, _MORE_THAN_NOISE * self.noise):
            code = Agreement.DIFFERS
            said = (
                f"the declared law does not make the torque of the motor's position {left}: jointid learn-controller "
            )
            said += "learns the law, unless the torque's unit, a sign or a clock is wrong"
        elif abs(self.gain - 1) > max(_GAIN, self.left):
            code, what = Agreement.SCALED, "sign" if self.gain < 0 else "unit or gain"
            said = (
                f"the torque is {number(self.gain, 4)} times what the declared law makes of the motor's position: the "
            )
            said += f"torque's {what}, or the law's last gain, is not as declared"
        return Message(code, said)


def compare_law(record: Record, loop: ClosedLoop) -> LawOnPosition | None:
    """Compare the logged torque with that of the law for the motor's position; None without both.

    The initial value of the integral and a constant torque are free. The position follows a cubic spline between two
    samples of the log. Torques are compared up to the frequency that the noise of the position allows: a law
    differentiates that noise, and a controller that is as declared has not seen it.
    """
    if (followed := _follow(record, loop)) is None:
        return None
    logged, made, see = followed
    assert record.torque is not None
    columns, inside = np.column_stack([made, np.ones(logged.size)]), slice(_BORDER, logged.size - _BORDER)

    def at(late: float) -> tuple[float, FloatArray]:
        """Return the residual of the torque, and the weights, with the law so many samples later."""
        whole = math.floor(late)
        first, last, share = inside.start - whole, inside.stop - whole, late - whole
        delayed = (1 - share) * columns[first:last] + share * columns[first - 1 : last - 1]
        return _regress(logged[inside], delayed)

    left, weights = at(0.0)
    near = min(range(-_LATEST, _LATEST + 1), key=lambda late: at(late)[0])
    shifts = np.clip(near + np.arange(-_PARTS, _PARTS + 1) / _PARTS, -_LATEST, _LATEST)
    late = float(min(shifts, key=lambda late: at(late)[0]))
    in_time, scaled = at(late)
    if in_time > _BETTER * left or abs(late) <= _LATE:
        late, in_time, scaled = 0.0, left, weights
    noise = _regress_on_past(record, logged, see)
    return LawOnPosition(left, float(scaled[0]), late * record.torque.sample_time, in_time, noise)


def excludes(record: Record, loop: ClosedLoop, controller: Controller, late: float = 0.0, gain: float = 0.0) -> bool:
    """Whether a record with a motor position has less than a quarter of a change of law or log.

    The logged torque less that of the law is regressed on the change that another law, or another log, makes of the
    logged motor position. The coefficient is 0 as declared and 1 with the change. The initial value of the integral and
    a constant torque are free.

    Args:
        record: as of `compare_law`.
        loop: as declared, which holds.
        controller: the other law.
        late: delay of the log, s.
        gain: of the log, less 1.
    """
    own, other = _follow(record, loop), _follow(record, replace(loop, controller=controller))
    if own is None or other is None or record.torque is None:
        return False
    (logged, made, _), at = own, np.arange(min(len(own[1]), len(other[1])))
    later = (1.0 + gain) * np.interp(at - late / record.torque.sample_time, at, other[1][: at.size, 0])
    columns = np.column_stack([later - made[: at.size, 0], made[: at.size, 1:], np.ones(at.size)])[_BORDER:-_BORDER]
    left, sizes = (logged - made[:, 0])[: at.size][_BORDER:-_BORDER], column_norms(columns)
    if np.ptp(columns[:, 0]) == 0.0:
        return False
    weights = np.linalg.lstsq(columns / sizes, left, rcond=None)[0]
    std = Influence(columns / sizes, left - columns / sizes @ weights).robust().std
    return bool(abs(weights[0]) + _SURELY * std[0] < _A_QUARTER * sizes[0])


def _follow(
    record: Record, loop: ClosedLoop
) -> tuple[FloatArray, FloatArray, Callable[[FloatArray], FloatArray]] | None:
    """Return the logged torque, (samples,), that of the law, (samples, columns), and the filter of both.

    None without a motor position, or for a law that cannot follow it.
    """
    torque = record.torque
    if record.motor_position is None or record.reference is None or torque is None or record.computed:
        return None
    try:
        made = law_outputs(record.motor_position, prepare(loop, record).axis)
    except JointidError:
        return None
    position, count = record.motor_position, min(torque.values.size, len(made))
    limit = find_noise_limit([position.values], position.sample_time)
    see = partial(lowpass_below_noise, limit=limit, sample_time=torque.sample_time)
    if count < 4 * _BORDER or not np.all(np.isfinite(made)) or np.ptp(torque.values) == 0 or np.ptp(made[:, 0]) == 0:
        return None
    return see(torque.values[:count]), see(made[:count]), see


def _regress_on_past(record: Record, logged: FloatArray, see: Callable[[FloatArray], FloatArray]) -> float:
    """Return the residual share of a torque, filtered by `see`, regressed on the last samples of all signals."""
    time = np.arange(logged.size) * record.torque.sample_time if record.torque is not None else np.arange(0.0)
    seen = {name: np.interp(time, one.time, one.values) for name, one in record.items()}
    r, q = seen["reference"], seen["motor_position"]
    more = [seen[name] for name in ("reference_velocity", "injected") if name in seen]
    total, *signals = see(np.column_stack([np.cumsum(r - q), r - q, np.gradient(q), *more])).T
    late = (_lagged(one, _LAGS, one[0]) for one in signals)
    return _regress(logged, np.column_stack([total, np.ones(r.size), *late]))[0]


def _regress(seen: FloatArray, columns: FloatArray) -> tuple[float, FloatArray]:
    """Return the residual share of a signal about its mean, and the weights of columns, by normal equations.

    The residual is computed itself, so it is no difference of squares.
    """
    sizes = column_norms(columns)
    products = columns.T @ columns / np.outer(sizes, sizes)
    weights = np.linalg.lstsq(products, columns.T @ seen / sizes, rcond=None)[0] / sizes
    rest, whole = float(np.linalg.norm(seen - columns @ weights)), float(np.linalg.norm(seen - seen.mean()))
    return rest / whole if whole else math.inf, weights
