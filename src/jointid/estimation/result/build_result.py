"""The builder of a fit: what every problem's solution says alike, with the differences as arguments.

Rigid or flexible, of one record, of several or of a long log, an answer has a row for each parameter, says how well the
torque is explained, and what its reader must be warned of.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from jointid.common.arrays import FloatArray
from jointid.common.messages import Message
from jointid.common.parameters import ADDED, Bounds, Parameter, Quantity
from jointid.estimation.problems.base import LOG_DELAY, RecordProblem
from jointid.estimation.problems.closed_loop import ClosedLoopProblem, initial_of
from jointid.estimation.problems.prescribed import DriveSideProblem
from jointid.estimation.result.assemble import FitResult
from jointid.estimation.result.estimate import fingerprint, relative_error
from jointid.estimation.result.parts import Checks, Data, EstimatedParameter, Fit, Iteration, Params, Settings
from jointid.models.controllers import Cascade, Controller
from jointid.models.joints import ClosedLoop, FlexibleJoint, Joint, acts_on_whole
from jointid.records.record import Record
from jointid.simulation.closed_loop import Initial, Simulation
from jointid.simulation.prescribed import LOAD_STATE
from jointid.solvers.solve import Solution
from jointid.uncertainty.covariance import FOR_MEASURED_MOTION, Covariance, band_words, words
from jointid.uncertainty.identifiability import Combination, Identifiability, Kind, Known, identifiability
from jointid.uncertainty.position_dependent_error import Uncertainty
from jointid.uncertainty.residual_tests import ResidualReport, residual_report
from jointid.uncertainty.verdict import (
    MOTION_MEASURED,
    POOR_FIT,
    Status,
    StiffnessBound,
    Verdict,
    bounds_verdict,
    fit_verdict,
    identifiability_verdict,
    only_sums_verdict,
    residual_verdicts,
    solver_verdict,
)

NOT_CONVERGED = "the search did not converge; the values are where it stopped"
NOT_SIMULATED = "with these values nothing can be simulated, so nothing is known of them; give other starts"

_PHYSICAL = (Quantity.INERTIA, Quantity.STIFFNESS)  # what no joint has none of
_AT_LIMIT = 0.01  # of the periods: more is said
_INSEPARABLE = 0.95  # a correlation that says two parameters are known only together
_NEAR = 1e-6  # of a parameter's size: how near to a bound is at it


@dataclass(frozen=True, slots=True, eq=False)
class Visibility:
    """Identifiability of a joint's spring.

    Attributes:
        verdict: whether its stiffness is reported, and why not.
        rigid: values of the rigid joint on the same band. rigid_std: standard deviations of those that it determines.
        rigid_error: (rows,) what it leaves.
        bounds: where the stiffness is refused.
        simulations: that all this took.
        notes: on the deviations of the rigid joint, where the stiffness is refused.
    """

    verdict: Verdict
    rigid: Mapping[str, float]
    rigid_std: Mapping[str, float]
    rigid_error: FloatArray
    bounds: tuple[StiffnessBound, ...]
    simulations: int
    notes: tuple[Message, ...] = ()

    @property
    def shown(self) -> bool:
        """Whether the stiffness is reported."""
        return self.verdict.status is Status.PASSED


def build_params(
    problem: RecordProblem,
    x: FloatArray,
    std: Mapping[str, float],
    correlation: FloatArray,
    basis: str,
    lost: Collection[str] = (),
    held: Collection[str] = (),
    *,
    fixed: bool = True,
) -> Params:
    """Return the parameters of a problem's solution, those of the joint and of what surrounds it.

    Args:
        problem: of one record, of several, or of a window of a log.
        x: its free parameters.
        std: standard errors of the free parameters, by name; none for those that are missing.
        correlation: of their errors.
        basis: how the standard errors were obtained, in a sentence.
        lost: names of free parameters that the record does not determine.
        held: names of those at a bound.
        fixed: whether fixed parameters around the joint are in the table.
    """
    own, units = {p.name for p in problem.joint.parameters}, problem.units
    shown = (p for p in problem.parameters if fixed or p.free or p.name in own)
    rows = build_rows(shown, problem.values(x), std, lambda p: units[p.name], own, lost, held)
    return Params(rows, tuple(p.name for p in problem.free), correlation, basis)


def name_deviations(problem: RecordProblem, covariance: Covariance) -> dict[str, float]:
    """Return the standard errors of a problem's free parameters by name."""
    return {p.name: float(std) for p, std in zip(problem.free, covariance.std, strict=False)}


def build_fit(
    problem: RecordProblem,
    predicted: FloatArray,
    error: FloatArray,
    stop: str,
    *,
    converged: bool,
    simulations: int,
    trace: tuple[Iteration, ...] = (),
    residuals: ResidualReport | None = None,
    initial: Initial | None = None,
) -> Fit:
    """Return the fit of a problem's solution.

    Args:
        problem: that was solved.
        predicted: (samples,) what the model says, raw.
        error: (rows,) filtered.
        stop: why the search ended.
        converged: whether that is a good end.
        simulations: that were run.
        trace: every iteration.
        residuals: tests of the filtered error.
        initial: the motor's state at the first sample.
    """
    borders = problem.filtering.borders
    return Fit(
        measured=problem.measured,
        predicted=predicted,
        borders=borders,
        relative_error=relative_error(problem.measured, predicted, borders),
        filtered_error=problem.filtered_error(error),
        rows=error.size,
        simulations=simulations,
        stop=stop,
        converged=converged,
        trace=trace,
        residuals=residuals,
        initial=initial,
    )


def build_rows(
    parameters: Iterable[Parameter],
    values: Mapping[str, float],
    std: Mapping[str, float],
    unit: Callable[[Parameter], str],
    of_joint: Collection[str],
    lost: Collection[str] = (),
    held: Collection[str] = (),
) -> tuple[EstimatedParameter, ...]:
    """Return the table of an estimate; one of several records' own parameters, ``name@2``, is under its plain name.

    Args:
        parameters: in its order.
        values: of all of them, by name.
        std: standard deviations of the free ones, by name.
        unit: of a parameter.
        of_joint: names of those that belong to the joint, and not to what surrounds it.
        lost: names of free ones that the record does not determine.
        held: names of those at a bound.
    """
    return tuple(
        EstimatedParameter(
            p.name.partition("@")[0],
            p.symbol.partition("@")[0],
            unit(p),
            values[p.name],
            std.get(p.name),
            p.free,
            p.free and p.name not in lost,
            of_joint=p.name.partition("@")[0] in of_joint,
            at_bound=min(p.lower, p.upper, key=lambda b: abs(values[p.name] - b)) if p.name in held else None,
        )
        for p in parameters
    )


def build_data(record: Record, channels: tuple[str, ...], sample_time: float) -> Data:
    """Return the data of an estimate from one record."""
    assert record.torque is not None
    return Data(
        channels=channels,
        record=record.name,
        sample_time=sample_time,
        torque_unit=record.torque.unit,
        fingerprint=fingerprint(record.torque.values),
    )


def build_closed_loop_result(
    record: Record,
    problem: ClosedLoopProblem,
    x: FloatArray,
    run: Simulation,
    end: tuple[str, bool],
    known: Uncertainty,
    J: FloatArray,
    variant: str,
    trace: Sequence[Iteration],
    simulations: int,
    *,
    spring: Visibility | None = None,
) -> FitResult:
    """Return the fit that ends a simulation of the loop.

    Args:
        record: what was identified from.
        problem: what was solved.
        x: free parameters.
        run: simulation with them.
        end: why the search ended, and whether that is a good end.
        known: of the errors of the free parameters.
        J: (rows, free) sensitivities, filtered.
        variant: how the method was run, in words.
        trace: every iteration.
        simulations: that were run.
        spring: what the record shows of the spring of a flexible joint.
    """
    assert record.torque is not None
    assert problem.filtering.cutoff is not None
    values, (stop, converged) = problem.values(x), end
    error, whole = problem.filter_error(run, problem.measured[:, np.newaxis])
    step = problem.sample_time * (problem.filtering.decimation or 1)
    report = residual_report(
        error, whole[:, 0], step, problem.filtering.cutoff, record.torque.unit,
        rigid_error=None if spring is None else spring.rigid_error, repeatable=known.repeatable,
    )  # fmt: skip
    stated = identifiability(problem.free, problem.units, x, J, known.covariance)
    fit = build_fit(
        problem, run.torque, error, stop, converged=converged, simulations=simulations,
        trace=tuple(trace), residuals=report, initial=initial_of(values),
    )  # fmt: skip
    held = find_active_bounds(problem.free, x, error, J)
    covariance, basis = known.covariance, f"from the output sensitivities, {known.basis}"
    params = build_params(problem, x, name_deviations(problem, covariance), covariance.correlation, basis, held=held)
    bounds: tuple[StiffnessBound, ...] = ()
    determined = identifiability_verdict(stated)
    if spring is not None and not spring.shown:
        params, stated = _refuse(params, stated, problem.joint, spring)
        determined, bounds = only_sums_verdict(), spring.bounds
    return FitResult(
        params=params,
        fit=fit,
        checks=Checks(
            warnings=(
                *([] if converged else [NOT_CONVERGED]),
                *warn_of_limit(run.at_limit),
                *poor_fit(fit.filtered_error),
                *ask_of_gains(problem.loop.controller, problem.loop.joint, values, problem.sample_time),
            ),
            notes=tuple(map(str, (*known.warnings, *(() if spring is None else spring.notes)))),
            verdicts=(
                solver_verdict(stop, converged),
                fit_verdict(report),
                *residual_verdicts(report),
                determined,
                bounds_verdict(held),
                *([] if spring is None else [spring.verdict]),
            ),
            known=stated,
            bounds=bounds,
        ),
        data=build_data(record, list_loop_channels(problem.loop, record), problem.sample_time),
        settings=Settings(
            "didim",
            variant,
            system=problem.joint,
            loop=problem.loop_at(x),
            filtering=problem.filtering,
            delay=values.get("delay", problem.experiment.law.delay),
        ),
        problem=problem,
        x=x,
    )


def _refuse(
    params: Params, stated: Identifiability, joint: Joint, spring: Visibility
) -> tuple[Params, Identifiability]:
    """Return the parameters without those that part the motor from the load, and the sums of both sides instead."""
    assert isinstance(joint, FlexibleJoint)
    sums = tuple(
        Known(_sum_of(p, joint.unit(p)), spring.rigid[p.name], std, std / (abs(spring.rigid[p.name]) or 1.0))
        for p in joint.rigid.parameters
        if (std := spring.rigid_std.get(p.name)) is not None and not acts_on_whole(p.name) and p.quantity in ADDED
    )
    parted = ("motor_", "load_", *(p.name for p in joint.spring.parameters))
    rows = []
    for p in params.rows:
        if p.free and p.name in spring.rigid_std:  # of both joints: a spring that is not shown narrows no interval
            rows.append(replace(p, value=spring.rigid[p.name], stderr=spring.rigid_std[p.name]))
        elif p.free and (p.name.startswith(parted) or (p.of_joint and p.name in spring.rigid)):
            rows.append(replace(p, value=None, stderr=None, identifiable=False))
        else:
            rows.append(p)
    stated = replace(stated, parameters=(), physical=sums, directions=(), limitations=(), undetermined=())
    return replace(params, rows=tuple(rows)), stated


def _sum_of(p: Parameter, unit: str) -> Combination:
    """Return the sum of both sides that a rigid joint's parameter is."""
    formula = f"{p.symbol}1 + {p.symbol}2" if p.symbol[-1] not in "+-" else f"{p.symbol} of both sides"
    weights = {f"motor_{p.name}": 1.0, f"load_{p.name}": 1.0}
    return Combination(f"total {p.name}", formula, unit, weights, Kind.SUM, p.name)


def build_prescribed_result(
    record: Record,
    problem: DriveSideProblem,
    solution: Solution,
    covariance: Covariance,
    channels: tuple[str, ...],
    method: tuple[str, str],
    *,
    earlier: int,
    after: Sequence[str] = (),
) -> FitResult:
    """Return the fit of a joint whose motion is prescribed: on the drive side.

    Args:
        record: what was identified from.
        problem: what was solved.
        solution: of least squares.
        covariance: of the errors of its parameters.
        channels: that were read.
        method: its name, and how it was run.
        earlier: simulations beside those of the solution.
        after: warnings after those of the search and the parameters.
    """
    x = solution.x
    lost = find_lost(problem.free, x, covariance.std)
    fit = build_fit(
        problem, problem.predict(x), problem.residual(x), solution.message, converged=solution.converged,
        simulations=earlier + solution.evaluations, trace=_trace(problem, solution),
    )  # fmt: skip
    names = [p.name for p in problem.free]
    # What moves nothing has no deviation, which is no deviation of 0; where nothing can be simulated, all of it.
    idle = tuple(name for name, column in zip(names, solution.jacobian.T, strict=True) if not column.any())
    simulated = len(idle) < len(names)
    held = find_active_bounds(problem.free, x, solution.residual, solution.jacobian)
    warnings = (
        *warn_of_lost(lost),
        *([] if solution.converged else [NOT_CONVERGED]),
        *([] if simulated else [NOT_SIMULATED]),
        *(
            f"{p.name} is not determined by this record: it may be anything within its bounds"
            for p, std in zip(problem.free, covariance.std, strict=True)
            if simulated and (p.name in idle or 2 * std > p.upper - p.lower)
        ),
        *warn_of_bounds(held),
        *warn_of_inseparable(names, covariance.correlation, [i for i, n in enumerate(names) if n not in LOAD_STATE]),
        *after,
        *poor_fit(fit.filtered_error),
    )
    std = {name: one for name, one in name_deviations(problem, covariance).items() if name not in idle}
    basis = f"from the sensitivities of the torque: {words(covariance)}; {band_words()}"
    basis += FOR_MEASURED_MOTION if MOTION_MEASURED in after else ""
    delay = -problem.values(x)[LOG_DELAY.name]
    return FitResult(
        params=build_params(problem, x, std, covariance.correlation, basis, (*lost, *idle), held),
        fit=fit,
        checks=Checks(warnings=warnings),
        data=build_data(record, channels, problem.sample_time),
        settings=Settings(*method, system=problem.joint, loop=None, filtering=problem.filtering, delay=delay),
    )


def _trace(problem: DriveSideProblem, solution: Solution) -> tuple[Iteration, ...]:
    """Return every step of a descent."""
    lines: list[Iteration] = []
    for number, (x, norm) in enumerate((step.x, step.norm) for step in solution.trace):
        change = step = None
        if lines:
            before = problem.vector(lines[-1].values)
            change = abs(norm - lines[-1].residual_norm) / max(lines[-1].residual_norm, 1e-300)
            step = float(np.max(np.abs(x - before) / np.maximum(np.abs(x), 1e-300)))
        lines.append(Iteration(number, problem.values(x), norm, change, step, number + 1))
    return tuple(lines)


def list_loop_channels(loop: ClosedLoop, record: Record) -> tuple[str, ...]:
    """Return the channels of a record that a simulation of its loop reads."""
    return (*loop.channels, *(("injected",) if record.injected is not None else ()))


def find_lost(free: Sequence[Parameter], x: FloatArray, std: FloatArray) -> tuple[str, ...]:
    """Return the inertias and stiffnesses whose interval holds 0."""
    found = zip(free, x, std, strict=True)
    return tuple(p.name for p, value, spread in found if p.quantity in _PHYSICAL and value <= 2 * spread)


def find_active_bounds(free: Sequence[Parameter], x: FloatArray, error: FloatArray, J: FloatArray) -> tuple[str, ...]:
    """Return the names of the free parameters that a bound holds.

    A descent ends a little inside of a bound. So near is a millionth of the value, or, since a bound may be 0, of the
    change that would move the residual by all of its size, where that is more.

    Args:
        free: the parameters.
        x: (free,) what was found for them.
        error: (rows,) residual there.
        J: (rows, free) its derivatives, of either sign.
    """
    norms = np.linalg.norm(J, axis=0)
    size = np.maximum(np.abs(x), np.linalg.norm(error) / np.where(norms > 0, norms, np.inf))
    held = Bounds.of(free).find_active(x, _NEAR * size)
    return tuple(p.name for p, at in zip(free, held, strict=True) if at)


def warn_of_lost(names: Iterable[str], records: str = "this record") -> list[str]:
    """Return a sentence on each parameter whose interval holds 0."""
    return [f"{name} is not identifiable from {records}: its interval holds 0" for name in names]


def warn_of_bounds(names: Iterable[str], records: str = "record") -> list[str]:
    """Return a sentence on each parameter that a bound holds."""
    return [f"{name} is at its bound, where it does not follow the {records}" for name in names]


def warn_of_limit(share: float) -> list[str]:
    """Return a sentence on a controller that was at its limit in more than a few of its periods."""
    if share <= _AT_LIMIT:
        return []
    return [
        f"the controller is at its limit in {100 * share:.1f} % of the periods, where the torque says nothing of the "
        "joint"
    ]


def warn_of_inseparable(
    names: Sequence[str], correlation: FloatArray, stated: Sequence[int], records: str = "this record"
) -> list[str]:
    """Return a sentence on each two parameters that are known only together.

    Args:
        names: of the free parameters.
        correlation: of their errors.
        stated: which of them are of interest.
        records: what does not tell them apart.
    """
    return [
        f"{names[i]} and {names[j]} are hard to tell apart in {records} (correlation {correlation[i, j]:+.3f})"
        for i in stated
        for j in stated
        if j < i and abs(correlation[i, j]) > _INSEPARABLE
    ]


def poor_fit(filtered_error: float) -> tuple[str, ...]:
    """Return a warning where a model leaves more of the torque unexplained than friction laws and noise usually do."""
    if filtered_error <= POOR_FIT:
        return ()
    return (
        f"the model leaves {100 * filtered_error:.0f} % of the filtered torque unexplained, which is more than a right "
        "model does; check signs, units, the controller and its limit, and whether the joint is what it is said to be",
    )


_FASTEST = 1.0  # of a velocity loop, rad per period: at 2 its difference equation is unstable without any delay
_SLOWEST = 0.5  # of a velocity loop, of the position gain: the loop's damping is then 0.35


def ask_of_gains(
    controller: Controller, joint: Joint, values: Mapping[str, float], sample_time: float
) -> tuple[str, ...]:
    """Return the question whether two gains are exchanged; none where they can be as they are, or no better so.

    A velocity loop of rate ``velocity_gain x gain / inertia`` carries a position loop that is slower than itself, and
    is itself slower than its sampling.

    Args:
        controller: of the joint; only a cascade has two gains in a row.
        joint: whose inertia is that of all it moves.
        values: of its parameters.
        sample_time: of the log [s].
    """
    inertia = sum(values[p.name] for p in joint.parameters if p.name in ("inertia", "motor_inertia", "load_inertia"))
    if not isinstance(controller, Cascade) or inertia <= 0:
        return ()
    per_gain = controller.gain * controller.ratio**2 / inertia
    period = controller.period or sample_time

    def possible(position: float, velocity: float) -> bool:
        return _SLOWEST * position <= velocity * per_gain <= _FASTEST / period

    position, velocity = controller.position_gain, controller.velocity_gain
    if possible(position, velocity) or not possible(velocity, position):
        return ()
    return (
        f"a velocity loop of {velocity * per_gain:.3g} rad/s beside a position gain of {position:.3g} 1/s, sampled "
        f"every {period:.3g} s; exchanged, they were {position * per_gain:.3g} rad/s and {velocity:.3g} 1/s, as loops "
        "are: are position_gain and velocity_gain exchanged? (Kv of a drive is position_gain, Kp of its speed loop "
        "velocity_gain.)",
    )
