"""IDIM: the inverse dynamic model regressed on measured positions, by the estimator of choice.

Torque and columns are those of `inverse_model`; ordinary least squares by QR, weighted or robust least squares
(`linear`), or instruments from a simulated loop (`instruments`).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from itertools import combinations
from typing import Literal, TypeAlias

import numpy as np

from jointid.common.arrays import FloatArray
from jointid.common.errors import MethodError
from jointid.common.progress import Progress
from jointid.common.settings import check_settings, documented, setting
from jointid.estimation.methods.harmonic_period import PeriodColumn, is_searched, moved, with_periods
from jointid.estimation.methods.instruments import Instrumented, by_instruments, simulated_instruments
from jointid.estimation.methods.inverse_model import InverseModel, idim_channels, motion_of
from jointid.estimation.methods.linear import Rows, Solution, ordinary, robust, weighted
from jointid.estimation.methods.registry import Method
from jointid.estimation.problems.closed_loop import require_free
from jointid.estimation.result.build_estimate import build_data, build_rows, poor_fit
from jointid.estimation.result.estimate import Estimate, relative_error
from jointid.estimation.result.params import Params
from jointid.estimation.result.parts import Checks, Fit, Settings
from jointid.models.controllers import Controller
from jointid.models.disturbances import Effect, effect_parameters, require_effects
from jointid.models.joints import Joint, acts_on_whole
from jointid.models.parameters import Parameter
from jointid.records.record import Record, Timing
from jointid.records.signals.filtering import Filtering
from jointid.simulation.loop_input import ClosedLoop
from jointid.uncertainty.covariance import words

Estimator: TypeAlias = Literal["ols", "weighted", "robust", "iv"]

_VARIANTS = {
    "ols": "IDIM by ordinary least squares",
    "weighted": "IDIM by weighted least squares, each equation by the size of its error",
    "robust": "IDIM by robust least squares (Tukey's bisquare)",
    "iv": "IDIM by instrumental variables from the simulated loop",
}
_LINEARISATIONS = 10  # of the force by a period, at most
_SETTLED = 1e-3  # deviations of the period
_ALIKE = 0.99  # a correlation that says two forces are known only together


@documented
@dataclass(frozen=True, slots=True)
class IDIM(Method):
    """Settings of IDIM; its effects are further columns, `PositionHarmonics` or `Drift`."""

    name = "idim"
    title = "IDIM"
    default_for = Joint

    estimator: Estimator = setting(
        "ols",
        "ordinary least squares; weighted, each equation of a flexible joint by the size of its error; robust, rows "
        "that do not fit weigh less or nothing; iv, instruments from the simulated loop, for which the controller is "
        "needed",
    )
    effects: tuple[Effect, ...] = ()

    def __post_init__(self) -> None:
        check_settings(self)

    @classmethod
    def called(cls, model: str) -> str:
        """Return what a sentence on its needs calls it: they are the joint model's."""
        return "IDIM of a flexible joint" if model == "flexible" else cls.title

    @classmethod
    def channels(cls, model: str, controller: Controller | None = None) -> tuple[str, ...]:
        """Return torque and motor position, and the load's where the joint is flexible."""
        del controller
        return idim_channels(model)

    @classmethod
    def compared(cls, model: str) -> tuple[tuple[str, Method], ...]:
        """Return a run for each estimator; the weights change nothing of a rigid joint's one equation."""
        weighted = (("IDIM-WLS", cls("weighted")),) if model == "flexible" else ()
        return (("IDIM-LS", cls()), *weighted, ("IDIM-IRLS", cls("robust")), ("IDIM-IV", cls("iv")))

    def identify(
        self,
        record: Record,
        joint: Joint,
        loop: ClosedLoop | None,
        parameters: tuple[Parameter, ...],
        filtering: Filtering,
        progress: Progress,
    ) -> Estimate:
        """Identify a joint; see `identify_idim`."""
        del progress
        delay = loop.controller.law(record.torque.sample_time).delay if loop and record.torque else 0.0
        return identify_idim(record, joint, parameters, filtering, delay, self, loop)


@dataclass(frozen=True, slots=True, eq=False)
class _Regression:
    """One record, ready for any estimator.

    Attributes:
        parameters: of joint and effects, in the order of the model's columns.
        effects: as they are now; their columns, and those of searched periods, follow the joint's.
        model: torque and columns, raw.
        rows: of the free parameters, the fixed ones' torque taken off.
    """

    parameters: tuple[Parameter, ...]
    effects: tuple[Effect, ...]
    model: InverseModel
    rows: Rows

    @property
    def free(self) -> list[int]:
        """Which parameters are estimated."""
        return [i for i, p in enumerate(self.parameters) if p.free]

    def whole(self, free: FloatArray) -> FloatArray:
        """Return the values of all parameters."""
        values = _kept(self.parameters)
        values[self.free] = free
        return values


@dataclass(frozen=True, slots=True, eq=False)
class _Found:
    """A regression and its solution; `periods` that were searched for, by the name of their parameter."""

    regression: _Regression
    solution: Solution
    instrumented: Instrumented | None
    effects: tuple[Effect, ...]
    periods: dict[str, float]


def identify_idim(
    record: Record,
    joint: Joint,
    parameters: tuple[Parameter, ...],
    filtering: Filtering,
    delay: float = 0.0,
    settings: IDIM | None = None,
    loop: ClosedLoop | None = None,
) -> Estimate:
    """Identify a joint from torque and motor position, and load position where it is flexible.

    Args:
        record: with the channels, at one rate.
        joint: rigid or flexible.
        parameters: of the joint; free ones are estimated.
        filtering: how the signals are filtered.
        delay: seconds from the logged torque to the torque that acts.
        settings: which estimator, and further columns.
        loop: the joint under its controller, for instruments.

    The standard deviations are those of the regression, robust to autocorrelation. What repeats with the motion is not
    covered, nor, but by instruments, noise in the positions and disturbances that the loop carries into them.

    Raises:
        RecordError: a channel is missing or cannot be used.
        MethodError: the record does not determine the parameters, or instruments have no loop to come from.
    """
    settings = settings or IDIM()
    record.require(("torque",), "IDIM")
    assert record.torque is not None
    sample_time = record.torque.sample_time
    require_effects(settings.effects, joint)
    if settings.estimator == "iv" and loop is None:
        raise MethodError(
            "IDIM-IV simulates the closed loop for its instruments, so it needs the controller; give a ClosedLoop, or "
            "use another estimator."
        )
    filtering = filtering.resolved(sample_time, joint.model)

    def regression(effects: tuple[Effect, ...]) -> _Regression:
        model = motion_of(record, delay, filtering, joint, effects)
        every = (*parameters, *effect_parameters(effects))
        return _Regression(every, effects, model, _rows(every, model, filtering, sample_time))

    def solved(made: _Regression) -> Instrumented | Solution:
        if settings.estimator != "iv":
            return {"ols": ordinary, "weighted": weighted, "robust": robust}[settings.estimator](made.rows)
        assert loop is not None
        instruments = simulated_instruments(record, loop, made.model, made.parameters, filtering, made.effects)
        return by_instruments(made.rows, instruments, _kept(made.parameters), made.free)

    def searched(effects: tuple[Effect, ...]) -> tuple[Effect, ...]:
        made = regression(tuple(effect for effect in effects if not is_searched(effect)))
        return with_periods(effects, made.model, made.rows, filtering, sample_time)

    found = _found(settings.effects, searched, regression, solved)
    driven = loop.controller.channels if loop is not None and found.instrumented is not None else ()
    return _answer(record, joint, filtering, delay, settings, found, driven)


def _rows(parameters: tuple[Parameter, ...], model: InverseModel, filtering: Filtering, sample_time: float) -> Rows:
    require_free(parameters)
    free = [i for i, p in enumerate(parameters) if p.free]
    Y, W = model.decimated(filtering, sample_time, _kept(parameters))
    return Rows(Y, W[:, free], tuple(parameters[i].name for i in free), len(model.torque))


def _kept(parameters: tuple[Parameter, ...]) -> FloatArray:
    """Return the values of the fixed parameters, 0 for the free ones, (parameters,)."""
    return np.array([0.0 if p.free else p.start or 0.0 for p in parameters])


def _found(
    given: tuple[Effect, ...],
    searched: Callable[[tuple[Effect, ...]], tuple[Effect, ...]],
    regression: Callable[[tuple[Effect, ...]], _Regression],
    solved: Callable[[_Regression], Instrumented | Solution],
) -> _Found:
    """Return the solution; where periods were searched for, they are estimated with the other parameters."""
    unknown = [is_searched(effect) for effect in given]
    effects = searched(given) if any(unknown) else given
    made = regression(effects)
    found = solved(made)
    periods: dict[str, float] = {}
    for _ in range(_LINEARISATIONS if any(unknown) else 0):
        values = dict(zip(made.rows.names, _solution(found).fit.values, strict=True))
        tangents = [PeriodColumn.of(effect, values) for effect, was in zip(effects, unknown, strict=True) if was]
        made = regression((*effects, *tangents))
        found = solved(made)
        change = dict(zip(made.rows.names, _solution(found).fit.values, strict=True))
        std = dict(zip(made.rows.names, _solution(found).covariance.std, strict=True))
        effects = moved(effects, tangents, change)
        periods = {tangent.name: float(tangent.period + change[tangent.name]) for tangent in tangents}
        if all(abs(change[name]) <= _SETTLED * std[name] for name in periods):
            break
    return _Found(made, _solution(found), found if isinstance(found, Instrumented) else None, effects, periods)


def _solution(found: Instrumented | Solution) -> Solution:
    return found.solution if isinstance(found, Instrumented) else found


def _answer(
    record: Record,
    joint: Joint,
    filtering: Filtering,
    delay: float,
    settings: IDIM,
    found: _Found,
    driven: tuple[str, ...],
) -> Estimate:
    assert record.torque is not None
    regression, solution, iv = found.regression, found.solution, found.instrumented
    model, values = regression.model, regression.whole(found.solution.fit.values)
    measured, predicted = model.torque[0], model.columns[0] @ values
    injected = ("injected",) if record.injected is not None else ()
    named = dict(zip((p.name for p in regression.parameters), map(float, values), strict=True)) | found.periods
    std = dict(zip(regression.rows.names, map(float, solution.covariance.std), strict=True))
    return Estimate(
        params=Params(
            build_rows(regression.parameters, named, std, joint.unit, named.keys() - found.periods.keys()),
            regression.rows.names,
            solution.covariance.correlation,
            f"of the regression, {words(solution.covariance)}",
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
            trace=iv.trace if iv else (),
            simulations=len(iv.trace) - 1 if iv else 0,
            stop=_stop(settings, found),
            converged=iv.converged if iv else True,
        ),
        checks=Checks(
            warnings=(
                *_warnings(record, filtering, solution.fit.relative_error),
                *_like_gravity(regression.rows.names, solution.covariance.correlation),
            ),
            tests=(iv.test,) if iv else (),
        ),
        data=build_data(
            record, ("torque", *driven, *idim_channels(joint.model)[1:], *injected), record.torque.sample_time
        ),
        settings=Settings(
            method="idim",
            variant=_VARIANTS[settings.estimator],
            joint=joint,
            loop=None,
            filtering=filtering,
            delay=delay,
            effects=found.effects,
        ),
    )


def _stop(settings: IDIM, found: _Found) -> str:
    solution, iv = found.solution, found.instrumented
    if iv is not None:
        count = len(iv.trace) - 1
        return (
            f"{'converged: nothing changes any more' if iv.converged else 'still changing'} after {count} simulations"
        )
    if settings.estimator == "ols":
        return "a linear regression has one step"
    lost = 100 * float(np.mean(solution.shares == 0.0))
    without = f"; {lost:.2g} % of the rows do not fit and weigh nothing" if settings.estimator == "robust" else ""
    return f"{solution.steps} reweightings until nothing changes{without}"


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
    found = list(filtering.warnings(record.torque.sample_time))
    if filtering.timing == "as_sampled" and record.torque.timing is not Timing.SAMPLED:
        found.append(
            f"the torque is {record.torque.timing.value} but read as sampled, half a period early, as the published "
            'results were; timing = "respected" is right'
        )
    return (*found, *poor_fit(error))
