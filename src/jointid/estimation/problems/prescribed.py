"""The problem of the drive side: the motor's motion is prescribed, and the torque compared.

The motor's motion comes from the record, filtered; the torque it takes is predicted
(`simulation.prescribed`) and seen as the log saw it: late by ``log_delay``, and a first-order ``current_lag`` away,
where these are free. Both act on the prediction. On the measurement they would let a fit shrink both sides to nothing.
While the motor rests, its friction takes what it must and the torque says nothing; these samples have no weight, on
both sides alike and before the filter, which would smear them. Nor have those about reversals of a rigid joint.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from jointid.common.arrays import FloatArray
from jointid.common.parameters import Parameter, Quantity
from jointid.estimation.problems.base import FAILED, LOG_DELAY, RecordProblem
from jointid.estimation.problems.closed_loop import require_free
from jointid.estimation.problems.inverse_model import torque_and_positions
from jointid.estimation.problems.rest import moving_weights, steady_weights
from jointid.models.joints import Joint
from jointid.records.record import Record, Tap
from jointid.records.signals.filtering import Filtering, lowpass, window_parts, window_torque
from jointid.records.signals.position_noise import find_noise_limit
from jointid.simulation.prescribed import (
    LOAD_STATE,
    PARTS,
    DriveSide,
    DriveSideRun,
    PrescribedMotion,
    prescribed_motion,
    simulate_drive_side,
)

CURRENT_LAG = Parameter("current_lag", "T i", Quantity.TIME, free=False, start=0.0, lower=0.0)
"""Time constant between the log and the torque, beside the delay: a command is logged before the current loop that
makes it a torque, a measured torque behind a filter of the drive."""

_LOAD_PARAMETERS = (
    Parameter(LOAD_STATE[0], "dq12(0)", Quantity.POSITION),
    Parameter(LOAD_STATE[1], "dv12(0)", Quantity.VELOCITY),
)


@dataclass(frozen=True, slots=True, eq=False)
class DriveSideProblem(RecordProblem):
    """The torque of one record along its own motor motion; the torque is through `filtering.window_torque`.

    Beside the joint's parameters there are those of `LOAD_STATE`, ``log_delay`` and ``current_lag``. The filter's
    borders are left out before it is applied.

    Attributes:
        joint: what is identified.
        motion: of the motor, prescribed.
        weights: (samples,) 0 where the motor rests, or as a rigid joint turns round, else 1.
        leads: whether the log shows the torque before its ``current_lag``, as a command does; else behind it.
        sample_time: seconds.
    """

    joint: Joint
    motion: PrescribedMotion
    weights: FloatArray
    leads: bool
    sample_time: float

    @property
    def inside(self) -> slice:
        """The samples that are compared."""
        return self.filtering.inside(self.measured.size)

    def predict(self, x: FloatArray) -> FloatArray:
        """Return the prediction of `measured`, (samples,)."""
        return self.simulate(x, ())[0]

    def residual(self, x: FloatArray) -> FloatArray:
        """Return the filtered, decimated error, (rows,); of a candidate that fails, something large."""
        return self._compare(x, ())[0]

    def linearise(self, x: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the residual, (rows,), and its derivatives by the free parameters, (rows, free)."""
        return self._compare(x, tuple(p.name for p in self.free))

    def _compare(self, x: FloatArray, names: tuple[str, ...]) -> tuple[FloatArray, FloatArray]:
        prediction, slopes, finished = self.simulate(x, names)
        error = self.measured - prediction
        if not finished:
            error = np.full_like(self.measured, FAILED * float(np.sqrt(np.mean(self.measured**2))))
        seen = self.filter(np.column_stack([error, -slopes]))
        return seen[:, 0], seen[:, 1:]

    def filter(self, columns: FloatArray) -> FloatArray:
        """Return signals, (samples,) or (samples, columns), weighted, through the problem's own filter."""
        weights = self.weights if columns.ndim == 1 else self.weights[:, np.newaxis]
        return self.filtering.decimate((weights * columns)[self.inside], self.sample_time)

    def simulate(self, x: FloatArray, names: tuple[str, ...]) -> tuple[FloatArray, FloatArray, bool]:
        """Return the predicted torque, (samples,), its derivatives, and their validity."""
        values = self.values(x)
        inner = tuple(n for n in names if n not in (LOG_DELAY.name, CURRENT_LAG.name))
        run = simulate_drive_side(self.joint, self.motion, values, inner)
        cells, lag = np.column_stack([run.torque, run.derivatives]), values[CURRENT_LAG.name]
        late, by_lag = values[LOG_DELAY.name] / self.sample_time, np.zeros((self.measured.size, 1))
        if lag > 0 and not self.leads:
            cells, moved = behind_lag(cells, self.motion.step, lag)
            by_lag = window_parts(moved, PARTS, late)
        seen = window_parts(cells, PARTS, late)
        by_delay = window_parts(cells[:, :1], PARTS, late, 1) / self.sample_time
        if self.leads and lag > 0:
            seen -= lag / self.sample_time * window_parts(cells, PARTS, late, 1)
        if self.leads:  # the rate of a signal is what its delay takes from it
            by_lag = -by_delay
            by_delay = by_delay - lag / self.sample_time**2 * window_parts(cells[:, :1], PARTS, late, 2)
        columns = dict(zip(inner, seen[:, 1:].T, strict=True))
        columns |= {LOG_DELAY.name: by_delay[:, 0], CURRENT_LAG.name: by_lag[:, 0]}
        slopes = [columns[name] for name in names]
        return seen[:, 0], np.column_stack([np.zeros((len(seen), 0)), *slopes]), run.finished

    def run(self, x: FloatArray) -> DriveSideRun:
        """Return the simulation itself, part by part."""
        return simulate_drive_side(self.joint, self.motion, self.values(x))


def behind_lag(cells: FloatArray, step: float, lag: float) -> tuple[FloatArray, FloatArray]:
    """Return signals behind a first-order lag, (cells, columns), and how the first depends on the lag, (cells, 1).

    Signals are constant over cells of `step` seconds, and so are the answers: means over the cells. Exact.
    """
    from scipy.signal import lfilter

    kept = float(np.exp(-step / lag))
    slope = kept * step / lag**2  # of `kept` by the lag
    state = np.vstack([cells[:1], lfilter([1 - kept], [1, -kept], cells, axis=0, zi=kept * cells[:1])[0]])
    rise = np.diff(state, axis=0) / step
    moved = np.append(0.0, lfilter([1.0], [1, -kept], slope * (state[:-1, 0] - cells[:, 0])))
    return cells - lag * rise, (-rise[:, 0] - lag * np.diff(moved) / step)[:, np.newaxis]


def motion_problem(
    record: Record,
    setup: DriveSide,
    filtering: Filtering,
    parameters: tuple[Parameter, ...],
    surroundings: tuple[Parameter, ...] = (),
) -> DriveSideProblem:
    """Return the problem of reproducing a record's torque along its motor motion.

    Args:
        record: with torque and motor position at one rate, the position sampled.
        setup: the joint.
        filtering: of position and torque.
        parameters: of the joint.
        surroundings: changed ``log_delay`` and ``current_lag``; both are fixed at 0 otherwise.

    Raises:
        RecordError: a channel is missing, or at another rate.
        MethodError: no parameter of the joint is free.
    """
    require_free(parameters)
    torque, (position,) = torque_and_positions(record, setup.joint, ("motor_position",), "Drive-side identification")
    sample_time = torque.sample_time
    filtering = filtering.resolve(sample_time, setup.joint.model, find_noise_limit([position], sample_time))
    assert filtering.position_cutoff is not None
    smooth = lowpass(position, filtering.position_cutoff, sample_time)
    motion = _from_rest(prescribed_motion(smooth, sample_time))
    weights = weights_of(motion)
    if setup.joint.model == "rigid":  # a spring smooths the jump of the load's acceleration at a reversal
        weights = steady_weights(motion.velocity[::PARTS], filtering.position_cutoff, sample_time)[1]
    given = {p.name: p for p in surroundings}
    around = tuple(given.get(p.name, p) for p in (LOG_DELAY, CURRENT_LAG))
    return DriveSideProblem(
        (*parameters, *_load_state(setup.joint, motion), *around),
        window_torque(torque),
        filtering,
        setup.joint,
        motion,
        weights,
        record.tap is not Tap.MEASURED,
        sample_time,
    )


def weights_of(motion: PrescribedMotion) -> FloatArray:
    """Return 0 for the samples at which the motor rests, and 1 for the others (see the module)."""
    return moving_weights(motion.velocity[::PARTS])


def _from_rest(motion: PrescribedMotion) -> PrescribedMotion:
    """Return the motion with no velocity at the first sample if the motor rests there.

    The rounding of an encoder would have a load that moves steadily begin where its Coulomb force drags it.
    """
    return motion if weights_of(motion)[0] else motion.from_rest()


def _load_state(joint: Joint, motion: PrescribedMotion) -> tuple[Parameter, ...]:
    """Return the load's first state, free where the motor moves then: a load at rest rests where it was left."""
    if joint.model == "rigid":
        return ()
    moving = bool(weights_of(motion)[0])
    return tuple(replace(p, free=moving, start=0.0) for p in _LOAD_PARAMETERS)
