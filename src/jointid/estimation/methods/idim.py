"""IDIM: the inverse dynamic model regressed on measured positions, by the estimator of choice.

Torque and columns are those of `inverse_model`; the estimators, ordinary or weighted least squares or
instruments from a simulated loop, those of `linear`.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from jointid.common.errors import MethodError
from jointid.common.parameters import Parameter
from jointid.common.settings import add_settings_to_docstring, setting
from jointid.estimation.methods.linear import (
    Estimator,
    Rows,
    Solution,
    simulated_instruments,
    solve_rows,
)
from jointid.estimation.methods.registry import Method, Task
from jointid.estimation.problems.closed_loop import require_free
from jointid.estimation.problems.inverse_model import (
    ENCODER_OFFSET,
    InverseModel,
    idim_channels,
    motion_of,
    noise_limit_of,
)
from jointid.estimation.problems.rest import SAID
from jointid.estimation.result.assemble import FitResult
from jointid.estimation.result.build_result import build_data, build_rows
from jointid.estimation.result.estimate import relative_error
from jointid.estimation.result.parts import Checks, Fit, Params, Settings
from jointid.models.controllers import Controller
from jointid.models.joints import Joint
from jointid.records.record import Record, Timing
from jointid.records.signals.filtering import Filtering
from jointid.records.signals.position_noise import describe_noise_limit
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

    def identify(self, task: Task) -> FitResult:
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
        limit = noise_limit_of(record, joint, idim_channels(joint.model)[1:])
        filtering = task.filtering.resolve(sample_time, joint.model, limit)

        def solve_with(zeros: bool) -> _Found:
            parameters = (*task.parameters, *((ENCODER_OFFSET,) if zeros else ()))
            require_free(parameters)
            model = motion_of(record, delay, filtering, joint, zeros=zeros)
            Y, W = model.decimate(filtering, sample_time, np.zeros(len(parameters)))
            rows = Rows(Y, W, tuple(p.name for p in parameters), len(model.torque))
            columns = None
            if estimator == "iv" and loop is not None:
                columns = simulated_instruments(record, loop, model, parameters, filtering)
            return _Found(
                parameters, model, rows, solve_rows(rows, estimator, {p.name: p for p in parameters}, columns)
            )

        found = solve_with(joint.model == "flexible" and _zeros_differ(solve_with))
        model, solved, covariance = found.model, found.solution, found.solution.covariance
        held = solved.held
        parameters = [p.fix(held[p.name]) if p.name in held else p for p in found.parameters]
        free = [i for i, p in enumerate(parameters) if p.free]
        values = dict(zip(found.rows.names, map(float, solved.values), strict=True))
        std = {found.rows.names[i]: float(covariance.std[i]) for i in free}
        correlation = covariance.correlation[np.ix_(free, free)]
        measured, predicted = model.torque[0], model.columns[0] @ solved.values
        read = ["torque", *(loop.controller.channels if loop is not None and estimator == "iv" else ())]
        read += [*idim_channels(joint.model)[1:], *(("injected",) if record.injected is not None else ())]
        return FitResult(
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
                    *describe_noise_limit(filtering, limit, sample_time, joint.model),
                    *_of_rest(model),
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
        parameters: of the joint, and perhaps of the encoders' zeros, in the order of the model's columns.
        model: torque and columns, raw. rows: of all parameters. solution: of these.
    """

    parameters: tuple[Parameter, ...]
    model: InverseModel
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


def _of_rest(model: InverseModel) -> tuple[str, ...]:
    """Return a sentence on a record in which the motor rests."""
    if model.resting <= SAID:
        return ()
    return (
        f"the motor rests in {100 * model.resting:.0f} % of the record, where friction takes what it must and the "
        "torque says nothing of it: these rows are left out",
    )


def _warnings(record: Record, filtering: Filtering) -> tuple[str, ...]:
    assert record.torque is not None
    if filtering.timing != "as_sampled" or record.torque.timing is Timing.SAMPLED:
        return ()
    said = f"the torque is {record.torque.timing.value} but read as sampled, half a period early, as the published "
    return (f'{said}results were; timing = "respected" is right',)
