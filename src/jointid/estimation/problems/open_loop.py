"""The problem of a prescribed torque: a joint's parameters in, the filtered error of the motor's position out.

Nothing holds the motor, so every small force that the model lacks drifts away as the double integral of itself: what a
position says slower than ``highpass`` is not of the joint, and is taken off both sides by one filter.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from jointid.common.arrays import FloatArray
from jointid.estimation.problems.base import FAILED, RecordProblem
from jointid.estimation.problems.drive_side import torque_and_position
from jointid.estimation.problems.nuisance_parameters import INITIAL_STATE, LOG_DELAY
from jointid.models.joints import Joint
from jointid.models.parameters import Parameter
from jointid.records.record import Channel, Record
from jointid.records.signals.filtering import Filtering, decimate, differentiate, lowpass
from jointid.simulation.open_loop import OpenLoop, simulate_open_loop

_DRIFT = 0.03  # of the cut-off: positions slower than that are drift
_ORDER = 4  # of the filter that takes it off, each way
_REST = 0.01  # of the root mean square speed: a motor slower than that at the first sample rests
_MOST_LATE = 20.0  # samples that the log may be late, or early
_CONSTANT = ("offset", "gravity_constant")  # forces that push the same way wherever the motor is
_AWAY = 20.0  # times the record's travel: a motor that leaves never turns round, and knows no Coulomb friction


@dataclass(frozen=True, slots=True, eq=False)
class OpenLoopProblem(RecordProblem):
    """The motor position of one record, less its drift, under its own torque.

    The filter's borders are left out before it is applied. Beside the joint's parameters there are the motor's first
    state and ``log_delay``.

    Attributes:
        joint: what is identified.
        torque: that is prescribed.
        highpass: Hz.
        travel: of the motor in the record, drift and all.
    """

    joint: Joint
    torque: Channel
    highpass: float
    travel: float

    @property
    def sample_time(self) -> float:
        """Of torque and position, seconds."""
        return self.torque.sample_time

    def filtered(self, columns: FloatArray) -> FloatArray:
        """Return positions without drift through the problem's own filter, decimated."""
        before, after = self.filtering.borders
        return decimate(columns[before : len(columns) - after], self.filtering, self.sample_time)

    def predicted(self, x: FloatArray) -> FloatArray:
        """Return the position that `measured` should show, (samples,)."""
        return without_drift(simulate_open_loop(self.joint, self.torque, self.values(x)).position, self)

    def residual(self, x: FloatArray) -> FloatArray:
        """Return the filtered position error, (rows,); of a candidate that fails, something large."""
        return self.linearised(x, ())[0]

    def linearised(self, x: FloatArray, names: tuple[str, ...] | None = None) -> tuple[FloatArray, FloatArray]:
        """Return the residual, (rows,), and its derivatives by the free parameters, (rows, free)."""
        names = tuple(p.name for p in self.free) if names is None else names
        run = simulate_open_loop(self.joint, self.torque, self.values(x), names)
        if not run.finished or np.ptp(run.position) > _AWAY * self.travel:
            error = np.full_like(self.measured, FAILED * float(np.std(self.measured)))
            return self.filtered(error), self.filtered(np.zeros((error.size, len(names))))
        seen = without_drift(np.column_stack([run.position, run.derivatives]), self)
        both = self.filtered(np.column_stack([self.measured - seen[:, 0], -seen[:, 1:]]))
        return both[:, 0], both[:, 1:]


def without_drift(positions: FloatArray, problem: OpenLoopProblem) -> FloatArray:
    """Return positions, (samples,) or (samples, columns), less what is slower than `highpass`, both ways."""
    return _fast(positions, problem.highpass, problem.sample_time)


def _fast(positions: FloatArray, highpass: float, sample_time: float) -> FloatArray:
    from scipy.signal import butter, sosfiltfilt

    sections = butter(_ORDER, 2 * highpass * sample_time, "highpass", output="sos")
    padding = min(len(positions) - 1, round(3 / (highpass * sample_time)))
    return np.asarray(sosfiltfilt(sections, positions - positions[:1], axis=0, padlen=padding))


def position_problem(
    record: Record,
    closing: OpenLoop,
    filtering: Filtering,
    parameters: tuple[Parameter, ...],
    log_delay: float | None = None,
    highpass: float | None = None,
) -> OpenLoopProblem:
    """Return the problem of reproducing a record's motor position from its torque.

    Args:
        record: with torque and motor position at one rate.
        closing: the joint.
        filtering: of the positions.
        parameters: of the joint.
        log_delay: seconds by which the log shows the torque later than it acts; free when None.
        highpass: Hz, below which the position is drift; 3 % of the cut-off when None.

    Raises:
        RecordError: a channel is missing, or at another rate.
        MethodError: no parameter of the joint is free.
    """
    torque, position = torque_and_position(record, closing, parameters, "Open-loop identification")
    size, period = min(len(torque), len(position)), torque.sample_time
    filtering = filtering.resolved(period, closing.joint.model)
    assert filtering.cutoff is not None
    highpass = highpass or _DRIFT * filtering.cutoff
    late, most = _MOST_LATE * period, float(np.max(np.abs(torque.values)))
    # A constant force makes a drift, which is not compared: without a bound nothing would hold it.
    parameters = tuple(
        replace(p, lower=max(p.lower, -most), upper=min(p.upper, most)) if p.name in _CONSTANT and p.free else p
        for p in parameters
    )
    delay = replace(LOG_DELAY, free=True, lower=-late, upper=late)
    around = (
        *_first_state(position.values[:size], filtering, period),
        delay if log_delay is None else LOG_DELAY.fixed(log_delay),
    )
    return OpenLoopProblem(
        (*parameters, *around),
        _fast(position.values[:size], highpass, period),
        filtering,
        closing.joint,
        replace(torque, values=torque.values[:size]),
        highpass,
        float(np.ptp(position.values[:size])),
    )


def _first_state(position: FloatArray, filtering: Filtering, period: float) -> tuple[Parameter, Parameter]:
    """Return the motor's first position, fixed, and its first velocity, free if it moves.

    Where a motor begins makes no difference to where it goes; how fast it begins does. One that never turned round
    could take any Coulomb force for a constant one, so the velocity stays within what the record shows.
    """
    assert filtering.position_cutoff is not None
    speed = differentiate(lowpass(position, filtering.position_cutoff, period), period)
    fastest = float(np.max(np.abs(speed)))
    first = replace(INITIAL_STATE[1], start=float(speed[0]), lower=-fastest, upper=fastest)
    resting = abs(float(speed[0])) < _REST * float(np.sqrt(np.mean(speed**2)))
    return INITIAL_STATE[0].fixed(float(position[0])), first.fixed(0.0) if resting else first
