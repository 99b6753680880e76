"""The estimate of a joint whose motion or torque is prescribed: on the drive side, or in open loop."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from jointid.common.arrays import FloatArray
from jointid.estimation.problems.drive_side import DriveSideProblem
from jointid.estimation.problems.nuisance_parameters import LOG_DELAY
from jointid.estimation.problems.open_loop import OpenLoopProblem
from jointid.estimation.result.build_estimate import (
    NOT_CONVERGED,
    build_data,
    build_rows,
    find_at_bound,
    warn_of_bounds,
    warn_of_inseparable,
)
from jointid.estimation.result.estimate import (
    Checks,
    Estimate,
    Fit,
    Iteration,
    Settings,
    poor_fit,
    relative_error,
)
from jointid.estimation.result.params import Params
from jointid.records.record import Record
from jointid.simulation.drive_side import LOAD_STATE
from jointid.solvers.solution import Solution
from jointid.uncertainty.covariance import Covariance, band_words, words


def build_prescribed_estimate(
    record: Record,
    problem: DriveSideProblem | OpenLoopProblem,
    x: FloatArray,
    solution: Solution,
    covariance: Covariance,
    channels: tuple[str, ...],
    method: tuple[str, str],
    before: Sequence[str] = (),
    after: Sequence[str] = (),
) -> Estimate:
    """Return the estimate; more simulations, and the initial state, are for the caller to add.

    Args:
        record: what was identified from.
        problem: what was solved.
        x: free parameters: the solution's, or those that instruments gave in their place.
        solution: of least squares.
        covariance: of the errors of x.
        channels: that were read.
        method: its name, and how it was run.
        before: warnings before those of the search and the parameters.
        after: warnings after them.
    """
    values, predicted, error = problem.values(x), problem.predicted(x), problem.residual(x)
    spread = dict(zip((p.name for p in problem.free), map(float, covariance.std), strict=True))
    lost, own = _find_lost(values, spread), {p.name for p in problem.joint.parameters}
    borders, compared = problem.filtering.borders, "position" if isinstance(problem, OpenLoopProblem) else "torque"
    filtered_error = float(np.linalg.norm(error) / problem.size)
    known = _warn(problem, x, covariance, lost, solution)
    return Estimate(
        params=Params(
            build_rows(problem.parameters, values, spread, problem.joint.unit, own, lost),
            tuple(p.name for p in problem.free),
            covariance.correlation,
            f"from the sensitivities of the {compared}: {words(covariance)}; {band_words()}",
        ),
        fit=Fit(
            measured=problem.measured,
            predicted=predicted,
            borders=borders,
            relative_error=relative_error(problem.measured, predicted, borders),
            filtered_error=filtered_error,
            rows=error.size,
            trace=_trace(problem, solution),
            simulations=solution.evaluations,
            stop=solution.message,
            converged=solution.converged,
            compared="position" if isinstance(problem, OpenLoopProblem) else "torque",
        ),
        checks=Checks(warnings=(*before, *known, *after, *poor_fit(filtered_error))),
        data=build_data(record, channels, problem.sample_time),
        settings=Settings(
            method=method[0],
            variant=method[1],
            joint=problem.joint,
            loop=None,
            filtering=problem.filtering,
            delay=-values[LOG_DELAY.name],
        ),
    )


def _trace(problem: DriveSideProblem | OpenLoopProblem, solution: Solution) -> tuple[Iteration, ...]:
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


def _find_lost(values: Mapping[str, float], spread: Mapping[str, float]) -> tuple[str, ...]:
    """Return the names of the inertias and the stiffness that the record does not tell from 0."""
    physical = ("motor_inertia", "load_inertia", "stiffness")
    return tuple(name for name in physical if name in spread and values[name] <= 2 * spread[name])


def _warn(
    problem: DriveSideProblem | OpenLoopProblem,
    x: FloatArray,
    covariance: Covariance,
    lost: Sequence[str],
    solution: Solution,
) -> tuple[str, ...]:
    """Return what the reader of an estimate must know of the search and the parameters."""
    found = [f"{name} is not identifiable from this record: its interval holds 0" for name in lost]
    found += [] if solution.converged else [NOT_CONVERGED]
    found += [
        f"{p.name} is not told by this record: it may be anything within its bounds"
        for p, std in zip(problem.free, covariance.std, strict=True)
        if 2 * std > p.upper - p.lower
    ]
    columns = np.linalg.norm(solution.jacobian, axis=0).clip(1e-300)
    near = 1e-6 * np.maximum(np.abs(x), np.linalg.norm(solution.residual) / columns)
    found += warn_of_bounds(find_at_bound(problem.free, x, near))
    names = [p.name for p in problem.free]
    told = [i for i, name in enumerate(names) if name not in LOAD_STATE]
    found += warn_of_inseparable(names, covariance.correlation, told)
    return (*found, *problem.filtering.warnings(problem.sample_time))
