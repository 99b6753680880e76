"""IDIM: the inverse dynamic model regressed on measured positions, by the estimator of choice.

Torque and columns are those of `inverse_model`; the estimators, ordinary or weighted least squares or
instruments from a simulated loop, those of `linear`.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from itertools import combinations
from typing import Literal, TypeAlias

import numpy as np

from jointid.common.arrays import FloatArray
from jointid.common.errors import MethodError
from jointid.common.parameters import Parameter
from jointid.common.settings import add_settings_to_docstring, declare, setting
from jointid.estimation.methods.linear import (
    ESTIMATORS,
    Rows,
    Solution,
    by_instruments,
    describe_stop,
    simulated_instruments,
)
from jointid.estimation.methods.registry import Method, Task
from jointid.estimation.problems.closed_loop import require_free
from jointid.estimation.problems.inverse_model import (
    InverseModel,
    idim_channels,
    motion_of,
    noise_limit_of,
)
from jointid.estimation.problems.rest import SAID
from jointid.estimation.result.assemble import FitResult
from jointid.estimation.result.build_result import build_data, build_rows, poor_fit
from jointid.estimation.result.estimate import relative_error
from jointid.estimation.result.parts import Checks, Fit, Params, Settings
from jointid.models.controllers import Controller
from jointid.models.disturbances import (
    Effect,
    EncoderOffset,
    effect_parameters,
    require_effects,
)
from jointid.models.joints import Joint, acts_on_whole
from jointid.records.record import Record, Timing
from jointid.records.signals.filtering import Filtering
from jointid.records.signals.position_noise import describe_noise_limit
from jointid.uncertainty.covariance import FOR_MEASURED_MOTION, band_words, words
from jointid.uncertainty.verdict import MOTION_MEASURED

Estimator: TypeAlias = Literal["ols", "weighted", "iv"]

_VARIANTS = {
    "ols": "IDIM by ordinary least squares",
    "weighted": "IDIM by weighted least squares, each equation by the size of its error",
    "iv": "IDIM by instrumental variables from the simulated loop",
}
_SHOWN = 4.0  # deviations: a smaller difference of two encoders' zeros is none
_SLIGHT = 1e-3  # of the torque: a smaller force of that difference is none, as filters leave as much
_ALIKE = 0.99  # a correlation that says two forces are known only together


@add_settings_to_docstring
@dataclass(frozen=True, slots=True)
class IDIM(Method):
    """Settings of IDIM; its effects are further columns, `PositionHarmonics` or `Drift`."""

    name = "idim"
    title = "IDIM"
    default_for = Joint

    estimator: Estimator | None = setting(
        None,
        "ols, ordinary least squares; weighted, each equation of a flexible joint or a robot by the size of its error; "
        "iv, instruments from the simulated loop, for which the controller is needed; without it ols for a joint, "
        "weighted for a robot",
    )
    effects: tuple[Effect, ...] = ()
    fixed: Mapping[str, float] = field(
        default_factory=dict,
        hash=False,
        metadata=declare("of a robot: by the symbols of parameters what they are known to be", systems=("robot",)),
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
        sample_time = record.torque.sample_time
        delay = loop.controller.law(sample_time).delay if loop else 0.0
        require_effects(self.effects, joint)
        if self.estimator == "iv" and loop is None:
            raise MethodError(
                "IDIM-IV simulates the closed loop for its instruments, so it needs the controller; give a ClosedLoop, "
                "or use another estimator."
            )
        limit = noise_limit_of(record, joint, idim_channels(joint.model)[1:])
        filtering = task.filtering.resolve(sample_time, joint.model, limit)
        noise = describe_noise_limit(filtering, limit, sample_time, joint.model)

        def regression(effects: tuple[Effect, ...]) -> _Regression:
            model = motion_of(record, delay, filtering, joint, effects)
            return _Regression.of((*task.parameters, *effect_parameters(effects)), model, filtering, sample_time)

        def solve_with(effects: tuple[Effect, ...]) -> _Found:
            made = regression(effects)
            if self.estimator != "iv":
                return _Found(made, ESTIMATORS[self.estimator or "ols"](made.rows), effects)
            assert loop is not None
            columns = simulated_instruments(record, loop, made.model, made.parameters, filtering, effects)
            return _Found(made, by_instruments(made.rows, columns, made.kept, made.free), effects)

        own = self.effects
        if joint.model == "flexible" and EncoderOffset() not in own and _zeros_differ(solve_with):
            own = (*own, EncoderOffset())
        return _answer(task, self, filtering, delay, solve_with(own), noise)


@dataclass(frozen=True, slots=True, eq=False)
class _Regression:
    """One record, ready for any estimator.

    Attributes:
        parameters: of joint and effects, in the order of the model's columns.
        model: torque and columns, raw.
        rows: of the free parameters, the fixed ones' torque taken off.
        free: which parameters are estimated.
        kept: (parameters,) values of the fixed parameters, 0 for the free ones.
    """

    parameters: tuple[Parameter, ...]
    model: InverseModel
    rows: Rows
    free: list[int]
    kept: FloatArray

    @classmethod
    def of(
        cls, parameters: tuple[Parameter, ...], model: InverseModel, filtering: Filtering, sample_time: float
    ) -> _Regression:
        """Return the regression of a model on its free parameters."""
        require_free(parameters)
        free = [i for i, p in enumerate(parameters) if p.free]
        kept = np.array([0.0 if p.free else p.start or 0.0 for p in parameters])
        Y, W = model.decimate(filtering, sample_time, kept)
        rows = Rows(Y, W[:, free], tuple(parameters[i].name for i in free), len(model.torque))
        return cls(parameters, model, rows, free, kept)


@dataclass(frozen=True, slots=True, eq=False)
class _Found:
    """A regression and its solution.

    Attributes:
        regression, solution: that belong together.
        effects: whose columns follow the joint's.
    """

    regression: _Regression
    solution: Solution
    effects: tuple[Effect, ...]


def _zeros_differ(solve_with: Callable[[tuple[Effect, ...]], _Found]) -> bool:
    """Return True if a record shows that its two encoders count from different zeros."""
    offset = EncoderOffset()
    try:
        found = solve_with((offset,))
    except MethodError:  # nothing tells it from the other forces
        return False
    rows, solution = found.regression.rows, found.solution
    at = rows.names.index(offset.parameters[0].name)
    least = max(_SHOWN * solution.covariance.std[at], _SLIGHT * float(np.sqrt(np.mean(rows.Y**2))))
    return bool(abs(solution.fit.values[at]) > least)


def _answer(
    task: Task, settings: IDIM, filtering: Filtering, delay: float, found: _Found, noise: tuple[str, ...]
) -> FitResult:
    record, joint, loop = task.record, task.joint, task.loop
    assert record.torque is not None
    regression, solution = found.regression, found.solution
    values = regression.kept.copy()
    values[regression.free] = solution.fit.values
    measured, predicted = regression.model.torque[0], regression.model.columns[0] @ values
    driven = loop.controller.channels if loop is not None and settings.estimator == "iv" else ()
    injected = ("injected",) if record.injected is not None else ()
    named = dict(zip((p.name for p in regression.parameters), map(float, values), strict=True))
    std = dict(zip(regression.rows.names, map(float, solution.covariance.std), strict=True))
    return FitResult(
        params=Params(
            build_rows(regression.parameters, named, std, joint.unit, named.keys()),
            regression.rows.names,
            solution.covariance.correlation,
            f"of the regression, {words(solution.covariance)}"
            + (f", {band_words()} in the load's equation" if joint.model == "flexible" else "")
            + ("" if settings.estimator == "iv" else FOR_MEASURED_MOTION),
        ),
        fit=Fit(
            measured=measured,
            predicted=predicted,
            borders=filtering.borders,
            relative_error=relative_error(measured, predicted, filtering.borders),
            filtered_error=solution.fit.relative_error,
            rows=solution.fit.residual.size,
            conditioning=solution.fit.conditioning,
            initial=None,
            trace=solution.trace,
            simulations=max(len(solution.trace) - 1, 0),
            stop=describe_stop(settings.estimator or "ols", solution),
            converged=solution.converged,
        ),
        checks=Checks(
            warnings=(
                *(() if settings.estimator == "iv" else (MOTION_MEASURED,)),
                *noise,
                *_of_rest(regression.model),
                *_warnings(record, filtering, solution.fit.relative_error),
                *_like_gravity(regression.rows.names, solution.covariance.correlation),
            ),
            tests=() if solution.test is None else (solution.test,),
        ),
        data=build_data(
            record, ("torque", *driven, *idim_channels(joint.model)[1:], *injected), record.torque.sample_time
        ),
        settings=Settings(
            method="idim",
            variant=_VARIANTS[settings.estimator or "ols"],
            system=joint,
            loop=None,
            filtering=filtering,
            delay=delay,
            effects=found.effects,
        ),
    )


def _of_rest(model: InverseModel) -> tuple[str, ...]:
    """Return a sentence on a record in which the motor rests."""
    if model.resting <= SAID:
        return ()
    return (
        f"the motor rests in {100 * model.resting:.0f} % of the record, where friction takes what it must and the "
        "torque says nothing of it: these rows are left out",
    )


def _like_gravity(names: tuple[str, ...], correlation: FloatArray) -> tuple[str, ...]:
    """Return a sentence on each two of the forces on the load, and the offset, that a short travel makes alike."""
    forces = [i for i, name in enumerate(names) if acts_on_whole(name)]
    return tuple(
        f"{names[i]} and {names[j]} are hard to tell apart in this record (correlation {correlation[i, j]:+.3f}); let "
        "the load travel further, or give one of them a value"
        for i, j in combinations(forces, 2)
        if abs(correlation[i, j]) > _ALIKE
    )


def _warnings(record: Record, filtering: Filtering, error: float) -> tuple[str, ...]:
    assert record.torque is not None
    found = []
    if filtering.timing == "as_sampled" and record.torque.timing is not Timing.SAMPLED:
        found.append(
            f"the torque is {record.torque.timing.value} but read as sampled, half a period early, as the published "
            'results were; timing = "respected" is right'
        )
    return (*found, *poor_fit(error))
