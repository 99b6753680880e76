"""IDIM: the inverse dynamic model regressed on measured positions, by the estimator of choice.

Torque and columns are those of `problems.inverse_model`; the estimators are ordinary or weighted least squares, or
instruments from a simulated loop. A robot is identified by `robots.idim`.

**A torque of unstated timing** is one held from its stamp, or one sampled at it, half a sample earlier, which moves
friction and inertia. The residual is a straight line between both readings, and so tells where between or beyond them
its power is least. The reading that is nearer is taken. Each interval is widened by the change of its parameter up to
the least power, and for two deviations of where that is.

**Weights.** A robot has an equation for each joint, one row after the other at every instant. Their errors differ in
size, and weighting makes them alike. A flexible joint's load has an equation without a torque, and is not weighted: by
its own residual it would pull its unknowns towards 0.

**Instruments** come from the closed loop simulated at the estimate itself [Janot, Vandanjon, Gautier 2014]. The
simulated motion is driven by the reference and the known signal alone, so noise and disturbances of the record do not
reach it; positions go through the same filters as the measured ones, and their columns are the instruments Z of
``Z' (Y - W x) = 0``. The next estimate is simulated in turn until nothing changes: two to five simulations. Instruments
need not be perfect, only free of the record's noise: values outside their bounds are simulated at the bound.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Literal, TypeAlias

import numpy as np

from jointid.common.arrays import FloatArray
from jointid.common.errors import MethodError
from jointid.common.parameters import Bounds, Parameter, Quantity
from jointid.common.settings import add_settings_to_docstring, setting
from jointid.common.text import number, pluralise
from jointid.estimation.methods.registry import Method, Task
from jointid.estimation.problems.closed_loop import require_free
from jointid.estimation.problems.inverse_model import (
    ENCODER_OFFSET,
    Inverse,
    MeasuredMotion,
    Rows,
    filter_motion,
    idim_channels,
    inverse_of_joint,
    through_window,
)
from jointid.estimation.result.estimate import Estimate, Settings, build_estimate, build_rows
from jointid.estimation.result.verdict import Check, Reason, Subject, check_of
from jointid.models.controllers import Controller
from jointid.models.joints import ClosedLoop, Joint
from jointid.models.robots.robot import RobotLoop
from jointid.records.record import Record, Timing
from jointid.records.signals.filtering import describe_noise_limit
from jointid.simulation.loop_input import prepare
from jointid.simulation.plant import Numbers
from jointid.simulation.simulate import Outcome, Simulation, motion_at, run_loop
from jointid.simulation.start import Initial
from jointid.solvers.regression import conditioning, least_squares
from jointid.uncertainty.covariance import Covariance, Influence, white
from jointid.uncertainty.model_tests import durbin_wu_hausman

VARIANTS = {
    "ols": "IDIM by ordinary least squares",
    "weighted": "IDIM by weighted least squares, each joint by the size of its error",
    "iv": "IDIM by instrumental variables from the simulated loop",
}
"""How IDIM was run, by its estimator."""

_LEVEL = 0.05  # of the test whether least squares would have done
_SHOWN = 4.0  # deviations: a smaller difference of two encoders' zeros is none
_SLIGHT = 1e-3  # of the torque: a smaller force of that difference is none, as filters leave as much
_CORRELATED = 2.0  # times the deviation of white residuals: neighbouring rows are alike
_LATEST = 8.0  # half samples: beyond, the residual is no straight line
_FLAT = 1e-6  # of the noise: a change of less power is rounding
_LEAST = 1e-24  # of the torque's power: less noise is rounding

_TINY = 1e-12  # of the torque: a size that no error falls below
_SETTLED = 1e-8  # relative: values that change by less with new weights have settled
_CLOSE = 1e-3  # deviations: likewise with new instruments
_TURNS, _SIMULATIONS = 100, 25  # of weights, and of instruments, at most

Estimator: TypeAlias = Literal["ols", "weighted", "iv"]

SimulatedMotion: TypeAlias = Callable[[FloatArray], FloatArray]
"""The raw positions, (samples, n), that a loop makes with the values of all parameters."""


@add_settings_to_docstring
@dataclass(frozen=True, slots=True)
class IDIM(Method):
    """Settings of IDIM."""

    name = "idim"
    title = "IDIM"
    default_for = Joint

    estimator: Estimator | None = setting(
        None,
        "ols, ordinary least squares; weighted, each joint of a robot by the size of its error; "
        "iv, instruments from the simulated loop, for which the controller is needed; without it ols for a joint, "
        "weighted for a robot",
    )

    @classmethod
    def channels(cls, model: str, controller: Controller | None = None) -> tuple[str, ...]:
        """Return torque and motor position, and the load's where the joint is flexible."""
        return idim_channels(model)

    def identify(self, task: Task) -> Estimate:
        """Identify a joint from torque and motor position, and load position where it is flexible.

        The standard deviations are those of the regression, robust to autocorrelation. What repeats with the motion is
        not covered, nor, but by instruments, noise in the positions and disturbances that the loop carries into them.

        Raises:
            RecordError: a channel is missing or cannot be used.
            MethodError: the record does not determine the parameters, or instruments have no loop to come from.
        """
        record, joint, loop, records = task.record, task.joint, task.loop, [task.record, *task.others]
        for one in records:
            one.require(("torque",), "IDIM")
        assert record.torque is not None
        sample_time, estimator = record.torque.sample_time, self.estimator or "ols"
        require_free(task.parameters)
        delay = loop.controller.law(sample_time).delay if loop else 0.0
        inverse = inverse_of_joint(joint, delay)
        motions, by_loop = inverse.measure_logs([[one] for one in records], task.filtering), None
        if estimator == "iv" and loop is not None:
            names = [p.name for p in task.parameters]
            initial = Initial(float(motions[0].q[0, 0]), float(motions[0].v[0, 0]))

            def numbers(values: FloatArray) -> Numbers:
                return Numbers.of_joint(joint, dict(zip(names, map(float, values), strict=True)))

            by_loop = [simulate_motion(loop, record, task.parameters, numbers, initial)]
        known = {p.name: p for p in task.parameters}
        found = None
        if joint.model == "flexible":
            with suppress(MethodError):  # nothing tells it from the other forces
                both = inverse_of_joint(joint, delay, zeros=True)
                found = regress(both, motions, estimator, known | {ENCODER_OFFSET.name: ENCODER_OFFSET}, by_loop)
                found = found if _shows_zeros(found) else None
        solved = found or regress(inverse, motions, estimator, known, by_loop)
        rows, filtering = solved.rows, motions[0].filtering
        stated = (*task.parameters, *((ENCODER_OFFSET,) if ENCODER_OFFSET.name in rows.names else ()))
        parameters = tuple(p.fix(solved.held[p.name]) if p.name in solved.held else p for p in stated)
        free = [i for i, p in enumerate(parameters) if p.free]
        std = {rows.names[i]: float(solved.covariance.std[i]) for i in free}
        values = dict(zip(rows.names, map(float, solved.values), strict=True))
        read = ["torque", *(loop.controller.channels if loop is not None and by_loop is not None else ())]
        read += [*idim_channels(joint.model)[1:], *(("injected",) if record.injected is not None else ())]
        noise = describe_noise_limit(filtering, min(one.limit for one in motions), sample_time, joint.model)
        measured, predicted = torques_along(inverse if found is None else both, motions, solved)
        made = build_estimate(
            records,
            build_rows(parameters, values, std, joint.unit, [p.name for p in task.parameters], held=solved.held),
            solved.covariance.correlation[np.ix_(free, free)],
            (measured[:, 0], predicted[:, 0]),
            float(np.linalg.norm(solved.residual) / np.linalg.norm(rows.Y)),
            solved.residual.size,
            (solved.stop, solved.converged),
            solved.simulations,
            Settings("idim", VARIANTS[estimator], joint, None, filtering, delay, timing=solved.timing),
            read,
            checks=() if solved.test is None else (_compare_instruments(solved.test),),
            warnings=(*solved.said, *noise),
        )
        return replace(made, fit=replace(made.fit, conditioning=conditioning(rows.W[:, free], solved.values[free])))


def _compare_instruments(p_value: float) -> Check:
    rejected = p_value < _LEVEL
    said = "columns are correlated with errors" if rejected else "nothing speaks against least squares"
    said = f"{said} (p = {p_value:.2g}): its values {'are biased' if rejected else 'agree with these'}"
    return check_of(Subject.INSTRUMENTS, not rejected, Reason.MOTION_MEASURED, said, {"p_value": p_value})


def _shows_zeros(found: Solution) -> bool:
    """Test whether two encoders count from different zeros."""
    at, slight = found.rows.names.index(ENCODER_OFFSET.name), _SLIGHT * float(np.sqrt(np.mean(found.rows.Y**2)))
    return bool(abs(found.values[at]) > max(_SHOWN * found.covariance.std[at], slight))


def torques_along(
    inverse: Inverse, motions: Sequence[MeasuredMotion], found: Solution
) -> tuple[FloatArray, FloatArray]:
    """Return the torques of the motors as measured, and as the log would show the model's, (samples, n) each."""
    n, measured, predicted = inverse.driven, list[FloatArray](), list[FloatArray]()
    for motion in (part for whole in motions for part in whole.split()):
        made = inverse.columns_along(motion)[:, :n] @ found.values
        predicted.append(through_window(made[:, :, np.newaxis], motion.filtering)[:, :, 0])
        early = 0.0 if motion.if_sampled is None or found.timing is not Timing.SAMPLED else motion.if_sampled
        measured.append((motion.torque + early)[:, :n])
    return np.vstack(measured), np.vstack(predicted)


def regress(
    inverse: Inverse,
    motions: Sequence[MeasuredMotion],
    estimator: Estimator,
    known: Mapping[str, Parameter],
    simulated: Sequence[SimulatedMotion] | None = None,
) -> Solution:
    """Return the solution of the rows along the motions of one log or several.

    Args:
        inverse: model.
        motions: that were measured.
        estimator: its name.
        known: values and bounds by name; see `solve_rows`.
        simulated: the motion of each log as its loop makes it, for instruments; rows at which a measured mass rests or
            turns round are left out of both.
    """
    if simulated is None:
        motions = [part for motion in motions for part in motion.split()]

    def instruments(values: FloatArray) -> FloatArray:
        each = []
        for motion, simulate_with in zip(motions, simulated or (), strict=True):
            size, positions = len(motion.q), simulate_with(values)[: len(motion.q)]
            whole = np.pad(positions, ((0, size - len(positions)), (0, 0)), "edge")
            each.append(inverse.columns(*filter_motion(whole, motion.sample_time, motion.filtering)))
        return inverse.rows(motions, each).W

    rows, make = inverse.rows(motions), instruments if simulated else None
    held = solve_rows(rows, estimator, known, make)
    if rows.early is None:
        return held
    sampled = solve_rows(replace(rows, Y=rows.Y + rows.early), estimator, known, make)
    at, away, where = _read_timing(rows, held.residual, sampled.residual)
    by = 0.5 * away * np.abs(sampled.values - held.values)
    timing, solution = (Timing.SAMPLED, sampled) if at else (Timing.HELD, held)
    said = (
        f"it is not stated whether the torque is held or sampled: it is read as {timing}, and {where}; the intervals "
        "cover that; state timing of its channel"
    )
    return replace(solution, further=by, timing=timing, said=(said,))


def _read_timing(rows: Rows, held: FloatArray, sampled: FloatArray) -> tuple[int, float, str]:
    """Return the timing of a torque that its record shows, and the undecided half samples.

    Args:
        rows: of the regression.
        held: (rows,) residual of a held torque.
        sampled: (rows,) that of a sampled one.
    """
    each = np.array([held, sampled]).reshape(2, rows.driven, -1)
    power = np.min(np.mean(each**2, axis=2), axis=0)  # of each equation, in units of which the noise is 1
    each /= np.sqrt(np.maximum(power, _LEAST * np.mean(rows.Y**2)))[:, np.newaxis]
    change = each[1] - each[0]
    size = float(np.sum(change**2))
    if not size > _FLAT:
        return 0, 1.0, "the other reading is as possible"
    best, spread = -float(np.sum(each[0] * change)) / size, 2 * _CORRELATED / np.sqrt(size)
    best = float(np.clip(best, -_LATEST, _LATEST))
    at = int(abs(best - 1.0) < abs(best))
    where = (
        f"the record puts it {number(0.5 * best, 2)} ± {number(0.5 * spread, 2)} samples before held (sampled is 0.5, "
        "averaged 1)"
    )
    return at, abs(best - at) + min(spread, 1.0), where


def simulate_motion(
    loop: ClosedLoop | RobotLoop,
    records: Record | Sequence[Record],
    parameters: Sequence[Parameter],
    numbers: Callable[[FloatArray], Numbers],
    initial: Initial | None = None,
) -> SimulatedMotion:
    """Return the positions that a loop makes, of motor and load, or of the joints of a robot.

    Args:
        loop: joint or robot, and controllers.
        records: with the channels that the controllers read.
        parameters: those outside of their bounds are simulated at the bound.
        numbers: of a candidate, from the parameters, (parameters,).
        initial: where the motor of a joint is at the first sample.

    Raises:
        RecordError: a record lacks a channel that its controller reads, or a clock does not divide the controllers'.
        MethodError: controllers or logs share no clock.
    """
    experiment, bounds = prepare(loop, records), Bounds.of(parameters)

    def positions(values: FloatArray) -> FloatArray:
        run = run_loop(experiment, numbers(bounds.clip(values[: len(parameters)])), initial, keep=True)
        if run.outcome is not Outcome.FINISHED:
            raise MethodError(
                f"The instruments of IV come from a simulation, but with these values {run.outcome.value}; check the "
                "controllers' gains, or use another estimator."
            )
        if isinstance(loop, ClosedLoop):
            return motion_at(run, experiment.clock.log_index).position
        return np.asarray(Simulation.of(run).motor_position @ np.linalg.inv(loop.robot.coupling).T)

    return positions


# The estimators

Instruments: TypeAlias = Callable[[FloatArray], FloatArray]
"""The columns on the motion simulated with the values of all parameters, (rows, parameters)."""


@dataclass(frozen=True, eq=False)
class Solution:
    """The result of an estimator.

    Attributes:
        rows: of all parameters. free: indices of those that neither a value nor a bound holds.
        values: (parameters,) of all.
        scale: (rows,) sizes of errors by which the rows were divided.
        instruments: (rows, free) of the last turn; None of least squares.
        turns: solutions that were made. converged: whether the last ones settled.
        held: values of the parameters that a bound holds, by name.
        further: (parameters,) deviations beside those of the rows.
        timing: how torques of unstated timing were read; None where all are stated. said: of that, in a sentence.
    """

    rows: Rows
    free: list[int]
    values: FloatArray
    scale: FloatArray
    instruments: FloatArray | None = None
    turns: int = 1
    converged: bool = True
    held: Mapping[str, float] = field(default_factory=dict)
    further: FloatArray | float = 0.0
    timing: Timing | None = None
    said: tuple[str, ...] = ()

    @property
    def residual(self) -> FloatArray:
        """Of the rows as they are, not weighted, (rows,)."""
        return self.rows.Y - self.rows.W @ self.values

    @property
    def simulations(self) -> int:
        """Of instruments that were made."""
        return 0 if self.instruments is None else self.turns

    @property
    def stop(self) -> str:
        """How it ended, in a sentence."""
        return f"{'settled' if self.converged else 'still changing'} after {pluralise(self.turns, 'solution')}"

    @cached_property
    def covariance(self) -> Covariance:
        """Robust to autocorrelation, and to what the weights are; of fixed parameters 0.

        Of least squares along a measured motion it is widened for that. The equation of a load contains no torque and
        little noise, so its residual is mostly model error, which repeats: deviations are widened by those over
        frequency bands.
        """
        rows, per_row, error = self.rows, self.scale[:, np.newaxis], self.residual / self.scale
        Z = None if self.instruments is None else self.instruments / per_row
        influence = Influence(rows.W[:, self.free] / per_row, error, Z, rows.equations)
        found = influence.robust() if rows.driven > 1 else influence.by_time()
        if rows.equations > rows.driven:
            of_load = error.copy()
            of_load[: error.size // rows.equations * rows.driven] = 0.0
            found = replace(influence, error=of_load).widen_for_bands(found)
        found = influence.widen_for_motion(found) if Z is None else found
        std, correlation = np.zeros(self.values.size), np.eye(self.values.size)
        std[self.free], correlation[np.ix_(self.free, self.free)] = found.std, found.correlation
        return Covariance(np.hypot(std, self.further), correlation)

    @property
    def test(self) -> float | None:
        """Whether least squares would have done in the place of instruments."""
        if self.instruments is None:
            return None
        W, known = self.rows.W, self.values.copy()
        known[self.free] = 0.0
        return durbin_wu_hausman(W[:, self.free], self.rows.Y - W @ known, self.instruments, self.rows.equations)


def solve_rows(
    rows: Rows,
    estimator: Estimator,
    known: Mapping[str, Parameter],
    instruments: Instruments | None = None,
    turns: int | None = None,
) -> Solution:
    """Return the solution of all parameters, some of which are fixed, or held by a bound.

    Unless an inertia is below 0, what violates a bound most, in deviations, is held there, and the rest solved again.

    Args:
        rows: of all parameters.
        estimator: its name.
        known: values and bounds by name; of others there are none.
        instruments: of "iv" alone.
        turns: of weights, at most.

    Raises:
        MethodError: all parameters are fixed, the rows do not determine those that are not, or the estimator is not for
            them.
    """
    if estimator == "iv" and instruments is None:
        raise MethodError(
            'The estimator "iv" simulates the loop for its instruments; expected the controller of each joint: '
            "give it, or use another estimator."
        )
    if estimator == "weighted" and rows.equations > rows.driven:
        raise MethodError('The estimator "weighted" is for a robot; received a flexible joint: use "ols" or "iv".')
    fixed = {name: p.start or 0.0 for name, p in known.items() if not p.free and name in rows.names}
    held, made = dict[str, float](), 0
    while True:
        found = _settle(rows, estimator, fixed | held, instruments, turns or _TURNS)
        made += found.turns
        outside = {
            name: p.lower if value < p.lower else p.upper
            for i, (name, value) in enumerate(zip(rows.names, found.values, strict=True))
            if i in found.free and (p := known.get(name)) is not None and not p.lower <= value <= p.upper
        }
        values = dict(zip(rows.names, found.values, strict=True))
        # No bound, nor one of another, is a remedy of an inertia below 0.
        if not outside or any(known[one].quantity is Quantity.INERTIA and values[one] <= 0.0 for one in outside):
            return replace(found, turns=made, held=held)
        std = dict(zip(rows.names, found.covariance.std, strict=True))
        most = max(
            outside, key=lambda name: abs(values[name] - outside[name]) / (std[name] or abs(values[name]) or 1.0)
        )
        held[most] = outside[most]


def _settle(
    rows: Rows, estimator: Estimator, fixed: Mapping[str, float], instruments: Instruments | None, turns: int
) -> Solution:
    """Solve again with the weights, and with the instruments, of the values before, until these settle.

    Instruments begin at least squares, of several motors weighted.
    """
    values = np.array([fixed.get(name, 0.0) for name in rows.names])
    free = [i for i, name in enumerate(rows.names) if name not in fixed]
    if not free:
        raise MethodError("All parameters are fixed, so there is nothing to identify; leave some of them out.")
    left = replace(rows, Y=rows.Y - rows.W @ values, W=rows.W[:, free], names=tuple(rows.names[i] for i in free))
    found = Solution(rows, free, values, np.ones(rows.Y.size))
    values[free] = _solve(left, found.scale)
    for make in {"ols": (), "weighted": (None,), "iv": (None, instruments)}[estimator]:
        found = replace(found, turns=0, converged=False)
        while found.turns < (turns if make is None else _SIMULATIONS) and not found.converged:
            Z, before = None if make is None else make(found.values)[:, free], found.values
            scale, values = rows.spread_out(_sizes(rows, found.residual)), before.copy()
            values[free] = _solve(left, scale, Z)
            close = _SETTLED * np.abs(before[free])
            if Z is not None:
                close = _CLOSE * white(left.W / scale[:, np.newaxis], (rows.Y - rows.W @ values) / scale).std
            settled = bool(np.all(np.abs(values - before)[free] <= close))
            found = Solution(rows, free, values, scale, Z, found.turns + 1, settled)
    return found


def _solve(rows: Rows, scale: FloatArray, instruments: FloatArray | None = None) -> FloatArray:
    """Return the values that solve ``Z' (Y - W x) = 0``, rows divided by a scale, (rows,); Z is W when None."""
    W, Y = rows.W / scale[:, np.newaxis], rows.Y / scale
    if instruments is None:
        return least_squares(W, Y, rows.names)
    Z = instruments / scale[:, np.newaxis]
    least_squares(Z, Y, rows.names)  # which refuses a motion that does not determine them
    norms = np.linalg.norm(Z, axis=0)
    return np.asarray(np.linalg.solve((Z / norms).T @ (W / norms), (Z / norms).T @ Y) / norms)


def _sizes(rows: Rows, residual: FloatArray) -> FloatArray:
    """Return the size of each equation's error, (equations,); 1 where the equations of a joint are not weighted."""
    if rows.equations > rows.driven:
        return np.ones(rows.equations)
    least = _TINY * float(np.sqrt(np.mean(rows.Y**2)))
    stated = rows.by_equation(np.any(rows.W != 0, axis=1))  # a joint that rests leaves rows of zeros
    each = zip(rows.by_equation(residual), stated, strict=True)
    return np.maximum([float(np.sqrt(np.mean(one[seen] ** 2))) for one, seen in each], least)
