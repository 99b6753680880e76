"""IDIM: the inverse dynamic model regressed on measured positions, by the estimator of choice.

Torque and columns are those of `problems.inverse_model`; the estimators, ordinary or weighted least squares or
instruments from a simulated loop, those of `linear`.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np

from jointid.common.arrays import FloatArray
from jointid.common.errors import MethodError
from jointid.common.parameters import Parameter
from jointid.common.settings import add_settings_to_docstring, setting
from jointid.estimation.methods.linear import (
    Estimator,
    Rows,
    Solution,
    instruments_of,
    not_simulated,
    solve_rows,
)
from jointid.estimation.methods.registry import Method, Task
from jointid.estimation.problems.closed_loop import require_free
from jointid.estimation.problems.inverse_model import (
    ENCODER_OFFSET,
    SAID,
    MeasuredMotion,
    idim_channels,
    joint_columns,
    motion_of,
    through_window,
)
from jointid.estimation.result.build_result import build_data, build_rows
from jointid.estimation.result.estimate import Estimate, relative_error
from jointid.estimation.result.parts import Checks, Fit, Params, Settings
from jointid.models.controllers import Controller
from jointid.models.joints import ClosedLoop, Joint
from jointid.records.record import Record, Timing
from jointid.records.signals.filtering import Filtering
from jointid.records.signals.position_noise import describe_noise_limit
from jointid.simulation.closed_loop import Initial, Outcome, simulate
from jointid.simulation.loop_input import prepare
from jointid.solvers.regression import conditioning

_VARIANTS = {
    "ols": "IDIM by ordinary least squares",
    "weighted": "IDIM by weighted least squares, each equation by the size of its error",
    "iv": "IDIM by instrumental variables from the simulated loop",
}
_SHOWN = 4.0  # deviations: a smaller difference of two encoders' zeros is none
_SLIGHT = 1e-3  # of the torque: a smaller force of that difference is none, as filters leave as much


@add_settings_to_docstring
@dataclass(frozen=True, slots=True)
class IDIM(Method):
    """Settings of IDIM."""

    name = "idim"
    title = "IDIM"
    default_for = Joint

    estimator: Estimator | None = setting(
        None,
        "ols, ordinary least squares; weighted, each equation of a flexible joint or a robot by the size of its error; "
        "iv, instruments from the simulated loop, for which the controller is needed; without it ols for a joint, "
        "weighted for a robot",
    )

    @classmethod
    def describe(cls, model: str) -> str:
        """Return the method's name as used within a sentence."""
        return "IDIM of a flexible joint" if model == "flexible" else cls.title

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
        delay = loop.controller.law(sample_time).delay if loop else 0.0
        motion = motion_of(record, delay, task.filtering, joint)
        filtering = motion.filtering

        def solve_with(zeros: bool) -> _Found:
            parameters = (*task.parameters, *((ENCODER_OFFSET,) if zeros else ()))
            require_free(parameters)
            of = partial(joint_columns, joint, zeros=zeros)
            columns, by_loop = of(motion.q, motion.v, motion.a), None
            names = tuple(p.name for p in parameters)
            rows = Rows(motion.thinned_torque(), motion.decimate_columns(columns), names, columns.shape[1])
            if estimator == "iv" and loop is not None:
                by_loop = instruments_of(motion, _simulate_loop(record, loop, motion, task.parameters), of)
            solution = solve_rows(rows, estimator, {p.name: p for p in parameters}, by_loop)
            return _Found(parameters, columns, rows, solution)

        found = solve_with(joint.model == "flexible" and _zeros_differ(solve_with))
        solved, covariance = found.solution, found.solution.covariance
        held = solved.held
        parameters = [p.fix(held[p.name]) if p.name in held else p for p in found.parameters]
        free = [i for i, p in enumerate(parameters) if p.free]
        values = dict(zip(found.rows.names, map(float, solved.values), strict=True))
        std = {found.rows.names[i]: float(covariance.std[i]) for i in free}
        correlation = covariance.correlation[np.ix_(free, free)]
        measured = motion.torque[:, 0]
        predicted = through_window(found.columns[:, :1], filtering)[:, 0] @ solved.values
        read = ["torque", *(loop.controller.channels if loop is not None and estimator == "iv" else ())]
        read += [*idim_channels(joint.model)[1:], *(("injected",) if record.injected is not None else ())]
        return Estimate(
            params=Params(
                build_rows(parameters, values, std, joint.unit, [p.name for p in task.parameters], held=held),
                tuple(std),
                correlation,
            ),
            fit=Fit(
                measured=measured,
                predicted=predicted,
                borders=filtering.borders,
                relative_error=relative_error(measured, predicted, filtering.borders),
                filtered_error=float(np.linalg.norm(solved.residual) / np.linalg.norm(found.rows.Y)),
                rows=solved.residual.size,
                conditioning=conditioning(found.rows.W[:, free], solved.values[free]),
                simulations=solved.simulations,
                stop=solved.stop,
                converged=solved.converged,
            ),
            checks=Checks(
                warnings=(
                    *describe_noise_limit(filtering, motion.limit, sample_time, joint.model),
                    *_of_rest(motion),
                    *_warnings(record, filtering),
                ),
                tests=() if solved.test is None else (solved.test,),
            ),
            data=build_data(record, tuple(read), sample_time),
            settings=Settings("idim", _VARIANTS[estimator], joint, None, filtering, delay),
        )


@dataclass(frozen=True, slots=True, eq=False)
class _Found:
    """A regression and its solution.

    Attributes:
        parameters: of the joint, and perhaps of the encoders' zeros, in the order of the columns.
        columns: (samples, equations, parameters) raw. rows: of all parameters. solution: of these.
    """

    parameters: tuple[Parameter, ...]
    columns: FloatArray
    rows: Rows
    solution: Solution


def _zeros_differ(solve_with: Callable[[bool], _Found]) -> bool:
    """Return True if a record shows that its two encoders count from different zeros."""
    try:
        found = solve_with(True)
    except MethodError:  # nothing tells it from the other forces
        return False
    rows, solution = found.rows, found.solution
    at = rows.names.index(ENCODER_OFFSET.name)
    least = max(_SHOWN * solution.covariance.std[at], _SLIGHT * float(np.sqrt(np.mean(rows.Y**2))))
    return bool(abs(solution.values[at]) > least)


def _simulate_loop(
    record: Record, loop: ClosedLoop, motion: MeasuredMotion, parameters: Sequence[Parameter]
) -> Callable[[FloatArray], FloatArray]:
    """Return a function from the values of parameters to the positions that the loop makes, (samples, sides).

    The simulation starts at the measured position and velocity. Instruments need not be perfect: values outside their
    bounds are simulated at the bound.

    Raises:
        RecordError: the record lacks a channel the controller reads.
    """
    experiment, initial = prepare(loop, record), Initial(float(motion.q[0, 0]), float(motion.v[0, 0]))

    def run_loop(values: FloatArray) -> FloatArray:
        pairs = zip(parameters, values, strict=False)
        run = simulate(loop, experiment, {p.name: min(max(float(x), p.lower), p.upper) for p, x in pairs}, initial)
        if run.outcome is not Outcome.FINISHED:
            raise not_simulated(run.outcome.value)
        return np.column_stack([run.motor_position, *([] if run.load_position is None else [run.load_position])])

    return run_loop


def _of_rest(motion: MeasuredMotion) -> tuple[str, ...]:
    """Return a sentence on a record in which the motor rests."""
    if motion.resting <= SAID:
        return ()
    return (
        f"the motor rests in {100 * motion.resting:.0f} % of the record, where friction takes what it must and the "
        "torque says nothing of it: these rows are left out",
    )


def _warnings(record: Record, filtering: Filtering) -> tuple[str, ...]:
    assert record.torque is not None
    if filtering.timing != "as_sampled" or record.torque.timing is Timing.SAMPLED:
        return ()
    said = f"the torque is {record.torque.timing.value} but read as sampled, half a period early, as the published "
    return (f'{said}results were; timing = "respected" is right',)
