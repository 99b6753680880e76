"""Open-loop identification: the logged torque is prescribed, and the motor's position is compared.

Nothing holds the motor, so every small force that the model lacks drifts away as the double integral of itself: what a
position says slower than ``highpass`` is not of the joint, and is taken off both sides by one filter. Unlike the
drive-side criterion this one needs no derivative of a position, and noise of the encoder does not bias it; but it takes
the logged torque for exact, and a loop around the drive makes it as endogenous.

It begins where the drive-side identification of the same record ends (`drive_side`).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from jointid.common.arrays import FloatArray
from jointid.common.errors import MethodError
from jointid.common.progress import Progress, silent
from jointid.estimation.methods.drive_side import (
    DriveSideFit,
    covariance_of,
    identify_drive_side,
    reported,
    trace_of,
    unsure,
    warnings_of,
)
from jointid.estimation.problems.drive_side_problem import torque_and_position
from jointid.estimation.problems.nuisance_parameters import INITIAL_STATE, LOG_DELAY
from jointid.estimation.result.estimate import Estimate, fingerprint, poor_fit, relative_error
from jointid.estimation.result.estimated import EstimatedParameter
from jointid.models.joints import Joint
from jointid.models.parameters import Parameter
from jointid.records.record import Channel, Record
from jointid.records.signals import Filtering, decimate, derivative, lowpass
from jointid.simulation.closed_loop import Initial
from jointid.simulation.drive_side import DriveSide
from jointid.simulation.open_loop import OpenLoop, simulate_open_loop
from jointid.solvers.levenberg_marquardt import LevenbergMarquardt
from jointid.solvers.solution import Solution
from jointid.solvers.solve import solve
from jointid.uncertainty.bands import band_words
from jointid.uncertainty.covariance import words

_DRIFT = 0.03  # of the cut-off: positions slower than that are drift
_ORDER = 4  # of the filter that takes it off, each way
_REST = 0.01  # of the root mean square speed: a motor slower than that at the first sample rests
_MOST_LATE = 20.0  # samples that the log may be late, or early
_CONSTANT = ("offset", "gravity_constant")  # forces that push the same way wherever the motor is
_AWAY = 20.0  # times the record's travel: a motor that leaves never turns round, and knows no Coulomb friction
_FAILED = 1e3  # times the position: the error of a candidate that cannot be simulated


@dataclass(frozen=True, slots=True)
class OpenLoopFit:
    """Settings of the open-loop identification.

    Attributes:
        log_delay: seconds by which the log shows the torque later than it acts; estimated when None.
        highpass: Hz, below which the position is drift; 3 % of the cut-off when None.
        frequency: motor-locked, Hz, for the start; a grid is tried when None.
        tolerance: relative, on the parameters and the criterion.
    """

    log_delay: float | None = None
    highpass: float | None = None
    frequency: float | None = None
    tolerance: float = 1e-8

    def __post_init__(self) -> None:
        given = [value for value in (self.highpass, self.frequency, self.tolerance) if value is not None]
        if not min(given) > 0:
            raise MethodError(
                "Frequencies and the tolerance are positive; received "
                f"{self.highpass}, {self.frequency} and {self.tolerance}."
            )


@dataclass(frozen=True, slots=True, eq=False)
class OpenLoopProblem:
    """The motor position of one record under its own torque; a `criterion.Criterion`.

    Attributes:
        joint: what is identified.
        torque: that is prescribed.
        parameters: all of the joint, then the motor's first state and ``log_delay``.
        measured: (samples,) position without its drift.
        filtering: resolved; its borders are left out before it is applied.
        highpass: Hz.
        travel: of the motor in the record, drift and all.
    """

    joint: Joint
    torque: Channel
    parameters: tuple[Parameter, ...]
    measured: FloatArray
    filtering: Filtering
    highpass: float
    travel: float

    @property
    def sample_time(self) -> float:
        """Of torque and position, seconds."""
        return self.torque.sample_time

    @property
    def free(self) -> tuple[Parameter, ...]:
        """The parameters that are identified."""
        return tuple(p for p in self.parameters if p.free)

    def values(self, x: FloatArray) -> dict[str, float]:
        """Return every parameter by name, the fixed ones too."""
        found = dict(zip((p.name for p in self.free), map(float, x), strict=True))
        return {p.name: found.get(p.name, p.start or 0.0) for p in self.parameters}

    def vector(self, values: Mapping[str, float]) -> FloatArray:
        """Return the free parameters of `values`, in order; one that is not there starts as declared."""
        return np.array([values.get(p.name, p.start or 0.0) for p in self.free])

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
            error = np.full_like(self.measured, _FAILED * float(np.std(self.measured)))
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
    record: Record, closing: OpenLoop, filtering: Filtering, parameters: tuple[Parameter, ...], settings: OpenLoopFit
) -> OpenLoopProblem:
    """Return the problem of reproducing a record's motor position from its torque.

    Raises:
        RecordError: a channel is missing, or at another rate.
        MethodError: no parameter of the joint is free.
    """
    torque, position = torque_and_position(record, closing, parameters, "Open-loop identification")
    size, period = min(len(torque), len(position)), torque.sample_time
    filtering = filtering.resolved(period, closing.joint.model)
    assert filtering.cutoff is not None
    highpass = settings.highpass or _DRIFT * filtering.cutoff
    late, most = _MOST_LATE * period, float(np.max(np.abs(torque.values)))
    # A constant force makes a drift, which is not compared: without a bound nothing would hold it.
    parameters = tuple(
        replace(p, lower=max(p.lower, -most), upper=min(p.upper, most)) if p.name in _CONSTANT and p.free else p
        for p in parameters
    )
    delay = replace(LOG_DELAY, free=True, lower=-late, upper=late)
    around = (
        *_first_state(position.values[:size], filtering, period),
        delay if settings.log_delay is None else LOG_DELAY.fixed(settings.log_delay),
    )
    return OpenLoopProblem(
        closing.joint,
        replace(torque, values=torque.values[:size]),
        (*parameters, *around),
        _fast(position.values[:size], highpass, period),
        filtering,
        highpass,
        float(np.ptp(position.values[:size])),
    )


def _first_state(position: FloatArray, filtering: Filtering, period: float) -> tuple[Parameter, Parameter]:
    """Return the motor's first position, fixed, and its first velocity, free if it moves.

    Where a motor begins makes no difference to where it goes; how fast it begins does. One that never turned round
    could take any Coulomb force for a constant one, so the velocity stays within what the record shows.
    """
    assert filtering.position_cutoff is not None
    speed = derivative(lowpass(position, filtering.position_cutoff, period), period)
    fastest = float(np.max(np.abs(speed)))
    first = replace(INITIAL_STATE[1], start=float(speed[0]), lower=-fastest, upper=fastest)
    resting = abs(float(speed[0])) < _REST * float(np.sqrt(np.mean(speed**2)))
    return INITIAL_STATE[0].fixed(float(position[0])), first.fixed(0.0) if resting else first


def identify_open_loop(
    record: Record,
    closing: OpenLoop,
    parameters: tuple[Parameter, ...],
    filtering: Filtering,
    settings: OpenLoopFit | None = None,
    progress: Progress = silent,
) -> Estimate:
    """Identify a joint from the torque that drives it in open loop, and the motor position that follows.

    Args:
        record: with torque and motor position at one rate.
        closing: the joint.
        parameters: of the joint; a start of its own replaces that of the method.
        filtering: of the compared positions; its borders should outlast the transient of a load that was not in
            steady motion at the first sample.
        settings: see `OpenLoopFit`.
        progress: is told the iterations.

    Raises:
        RecordError: a channel is missing, or at another rate.
        MethodError: no start gives a joint with positive inertias.
    """
    settings = settings or OpenLoopFit()
    problem = position_problem(record, closing, filtering, parameters, settings)
    progress("identifying the drive side for a start")
    begin = DriveSideFit(settings.log_delay, 0.0, settings.frequency, "never")
    first = identify_drive_side(record, DriveSide(closing.joint), parameters, filtering, begin, progress)
    found = {p.name: p.value for p in first.parameters if p.value is not None}
    given = {p.name: p.start for p in problem.parameters if p.start is not None}
    start, solver = problem.vector({**found, **given}), LevenbergMarquardt(settings.tolerance)
    solution = solve(problem, solver, start, reported(progress))
    return _answer(record, problem, replace(solution, evaluations=solution.evaluations + first.simulations))


def _answer(record: Record, problem: OpenLoopProblem, solution: Solution) -> Estimate:
    assert record.torque is not None
    covariance, x = covariance_of(solution), solution.x
    values, predicted = problem.values(x), problem.predicted(x)
    spread = dict(zip((p.name for p in problem.free), map(float, covariance.std), strict=True))
    own, lost = {p.name for p in problem.joint.parameters}, unsure(values, spread)
    rows = tuple(
        EstimatedParameter(
            p.name, p.symbol, problem.joint.unit(p), values[p.name], spread.get(p.name), p.free,
            p.free and p.name not in lost, of_joint=p.name in own,
        )
        for p in problem.parameters
    )  # fmt: skip
    borders = problem.filtering.borders
    filtered_error = float(np.linalg.norm(solution.residual) / np.linalg.norm(problem.filtered(problem.measured)))
    drift = f"positions slower than {problem.highpass:g} Hz are drift in open loop, and were not compared"
    return Estimate(
        method="open_loop",
        variant="open loop by least squares",
        joint=problem.joint,
        loop=None,
        parameters=rows,
        channels=("torque", "motor_position"),
        record=record.name,
        sample_time=problem.sample_time,
        torque_unit=record.torque.unit,
        measured=problem.measured,
        predicted=predicted,
        borders=borders,
        relative_error=relative_error(problem.measured, predicted, borders),
        filtered_error=filtered_error,
        rows=solution.residual.size,
        conditioning=None,
        initial=Initial(values["initial_position"], values["initial_velocity"]),
        filtering=problem.filtering,
        trace=trace_of(problem, solution),
        simulations=solution.evaluations,
        stop=solution.message,
        converged=solution.converged,
        intervals=f"from the sensitivities of the position: {words(covariance)}; {band_words()}",
        warnings=(drift, *warnings_of(problem, x, covariance, lost, solution), *poor_fit(filtered_error)),
        fingerprint=fingerprint(record.torque.values),
        delay=-values[LOG_DELAY.name],
        correlation=covariance.correlation,
        compared="position",
    )
