"""IDIM: the inverse dynamic model regressed on measured positions, by the estimator of choice.

Torque and columns are those of `problems.inverse_model`; the estimators, ordinary or weighted least squares or
instruments from a simulated loop, those of `linear`. A robot is identified by `robots.idim`.

**A torque of unstated timing** is one held from its stamp, or one sampled at it, half a sample earlier, which moves
friction and inertia. The residual is a straight line between both readings, and so tells where between or beyond them
its power is least. The reading that is nearer is taken. Each interval is widened by the change of its parameter up to
the least power, and for two deviations of where that is.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from typing import TypeAlias

import numpy as np

from jointid.common.arrays import FloatArray
from jointid.common.errors import MethodError
from jointid.common.parameters import Bounds, Parameter
from jointid.common.settings import add_settings_to_docstring, setting
from jointid.common.text import number
from jointid.estimation.methods.linear import Estimator, Solution, solve_rows
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
from jointid.estimation.result.build_result import build_estimate, build_rows
from jointid.estimation.result.estimate import Estimate
from jointid.estimation.result.parts import Checks, Params, Settings
from jointid.models.controllers import Controller
from jointid.models.joints import ClosedLoop, Joint
from jointid.records.record import Record, Timing
from jointid.records.signals.filtering import describe_noise_limit
from jointid.simulation.loop_input import prepare
from jointid.simulation.simulate import Outcome
from jointid.simulation.start import Initial
from jointid.simulation.synthesis import simulate
from jointid.solvers.regression import conditioning

VARIANTS = {
    "ols": "IDIM by ordinary least squares",
    "weighted": "IDIM by weighted least squares, each joint by the size of its error",
    "iv": "IDIM by instrumental variables from the simulated loop",
}
"""How IDIM was run, by its estimator."""

_SHOWN = 4.0  # deviations: a smaller difference of two encoders' zeros is none
_SLIGHT = 1e-3  # of the torque: a smaller force of that difference is none, as filters leave as much
_CORRELATED = 2.0  # times the deviation of white residuals: neighbouring rows are alike
_LATEST = 8.0  # half samples: beyond, the residual is no straight line
_FLAT = 1e-6  # of the noise: a change of less power is rounding
_LEAST = 1e-24  # of the torque's power: less noise is rounding

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
        record, joint, loop = task.record, task.joint, task.loop
        record.require(("torque",), "IDIM")
        assert record.torque is not None
        sample_time, estimator = record.torque.sample_time, self.estimator or "ols"
        require_free(task.parameters)
        delay = loop.controller.law(sample_time).delay if loop else 0.0
        inverse = inverse_of_joint(joint, delay)
        motion = inverse.measure([record], task.filtering)
        by_loop = None
        if estimator == "iv" and loop is not None:
            by_loop = [_simulate_joint(record, loop, motion, task.parameters)]
        known = {p.name: p for p in task.parameters}
        found = None
        if joint.model == "flexible":
            with suppress(MethodError):  # nothing tells it from the other forces
                zeros = inverse_of_joint(joint, delay, zeros=True)
                found = regress(zeros, [motion], estimator, known | {ENCODER_OFFSET.name: ENCODER_OFFSET}, by_loop)
                found = found if found.shows_zeros else None
        found = found or regress(inverse, [motion], estimator, known, by_loop)
        solved, rows, filtering = found.solution, found.solution.rows, motion.filtering
        stated = (*task.parameters, *((ENCODER_OFFSET,) if ENCODER_OFFSET.name in rows.names else ()))
        parameters = tuple(p.fix(solved.held[p.name]) if p.name in solved.held else p for p in stated)
        free = [i for i, p in enumerate(parameters) if p.free]
        std = {rows.names[i]: float(solved.covariance.std[i]) for i in free}
        values = dict(zip(rows.names, map(float, solved.values), strict=True))
        read = ["torque", *(loop.controller.channels if loop is not None and by_loop is not None else ())]
        read += [*idim_channels(joint.model)[1:], *(("injected",) if record.injected is not None else ())]
        noise = describe_noise_limit(filtering, motion.limit, sample_time, joint.model)
        measured, predicted = found.torques
        made = build_estimate(
            [record],
            Params(
                build_rows(parameters, values, std, joint.unit, [p.name for p in task.parameters], held=solved.held),
                tuple(std),
                solved.covariance.correlation[np.ix_(free, free)],
            ),
            (measured[:, 0], predicted[:, 0]),
            float(np.linalg.norm(solved.residual) / np.linalg.norm(rows.Y)),
            solved.residual.size,
            (solved.stop, solved.converged),
            solved.simulations,
            Settings("idim", VARIANTS[estimator], joint, None, filtering, delay, timing=found.timing),
            read,
            Checks(warnings=(*found.said, *noise), tests=() if solved.test is None else (solved.test,)),
        )
        return replace(made, fit=replace(made.fit, conditioning=conditioning(rows.W[:, free], solved.values[free])))


@dataclass(frozen=True, slots=True, eq=False)
class Regression:
    """A regression along measured motions and its solution.

    Attributes:
        motions: of each log. columns: of each, (samples, equations, parameters), raw.
        solution: of their rows.
        timing: how torques of unstated timing were read; None where all are stated. said: of that, in a sentence.
    """

    motions: Sequence[MeasuredMotion]
    columns: Sequence[FloatArray]
    solution: Solution
    timing: Timing | None = None
    said: tuple[str, ...] = ()

    @property
    def torques(self) -> tuple[FloatArray, FloatArray]:
        """Torques of the motors as measured, and of the model as the log would show them, (samples, n) each."""
        n, found = self.solution.rows.driven, list[FloatArray]()
        for motion, columns in zip(self.motions, self.columns, strict=True):
            found.append(through_window(columns[:, :n], motion.filtering) @ self.solution.values)
        return np.vstack([motion.torque[:, :n] for motion in self.motions]), np.vstack(found)

    @property
    def shows_zeros(self) -> bool:
        """True if two encoders count from different zeros."""
        rows, found = self.solution.rows, self.solution
        at, slight = rows.names.index(ENCODER_OFFSET.name), _SLIGHT * float(np.sqrt(np.mean(rows.Y**2)))
        return bool(abs(found.values[at]) > max(_SHOWN * found.covariance.std[at], slight))


def regress(
    inverse: Inverse,
    motions: Sequence[MeasuredMotion],
    estimator: Estimator,
    known: Mapping[str, Parameter],
    simulated: Sequence[SimulatedMotion] | None = None,
) -> Regression:
    """Return the regression along the motions of one log or several.

    Args:
        inverse: model.
        motions: that were measured.
        estimator: its name.
        known: values and bounds by name; see `solve_rows`.
        simulated: the motion of each log as its loop makes it, for instruments; rows at which a measured mass rests or
            turns round are left out of both.
    """
    columns = [inverse.columns_along(motion) for motion in motions]

    def instruments(values: FloatArray) -> FloatArray:
        each = []
        for motion, simulate_with in zip(motions, simulated or (), strict=True):
            size, positions = len(motion.q), simulate_with(values)[: len(motion.q)]
            whole = np.pad(positions, ((0, size - len(positions)), (0, 0)), "edge")
            each.append(inverse.columns(*filter_motion(whole, motion.sample_time, motion.filtering)))
        return inverse.rows(motions, each).W

    rows, make = inverse.rows(motions, columns), instruments if simulated else None
    held, early = solve_rows(rows, estimator, known, make), [motion.sampled for motion in motions]
    if all(one is motion for one, motion in zip(early, motions, strict=True)):
        return Regression(motions, columns, held)
    sampled = solve_rows(replace(rows, Y=inverse.torques(early)), estimator, known, make)
    at, away, where = _read_timing(rows, held.residual, sampled.residual)
    by = 0.5 * away * np.abs(sampled.values - held.values)
    timing, solution, read = (Timing.SAMPLED, sampled, early) if at else (Timing.HELD, held, motions)
    said = (
        f"it is not stated whether the torque is held or sampled: it is read as {timing}, and {where}; the intervals "
        "cover that; state timing of its channel"
    )
    return Regression(read, columns, replace(solution, further=by), timing, (said,))


def _read_timing(rows: Rows, held: FloatArray, sampled: FloatArray) -> tuple[int, float, str]:
    """Return whether a torque is sampled, the half samples that are undecided, and the timing that the record shows.

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


def require_simulated(outcome: Outcome) -> None:
    """Refuse instruments from a simulation that did not end."""
    if outcome is not Outcome.FINISHED:
        raise MethodError(
            f"The instruments of IV come from a simulation, but with these values {outcome.value}; check the "
            "controllers' gains, or use another estimator."
        )


def _simulate_joint(
    record: Record, loop: ClosedLoop, motion: MeasuredMotion, parameters: Sequence[Parameter]
) -> SimulatedMotion:
    """Return the positions that a loop makes, of motor and load.

    The simulation starts at the measured position and velocity.

    Raises:
        RecordError: the record lacks a channel the controller reads.
    """
    experiment, initial = prepare(loop, record), Initial(float(motion.q[0, 0]), float(motion.v[0, 0]))
    names, bounds = [p.name for p in parameters], Bounds.of(parameters)

    def positions(values: FloatArray) -> FloatArray:
        near = bounds.clip(values[: len(names)])
        run = simulate(loop, experiment, dict(zip(names, map(float, near), strict=True)), initial)
        require_simulated(run.outcome)
        return np.column_stack([run.motor_position, *([] if run.load_position is None else [run.load_position])])

    return positions
