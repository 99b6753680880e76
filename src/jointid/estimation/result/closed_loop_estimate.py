"""The answer of an identification in closed loop: the estimate that a search's end, its simulation and its errors make.

Rigid or flexible, by whatever search, an answer says alike how well the torque is explained, what is known of each
parameter, and what its reader must be warned of.
"""

from __future__ import annotations

import numpy as np

from jointid.common.arrays import FloatArray
from jointid.estimation.problems.closed_loop import ClosedLoopProblem, initial_of
from jointid.estimation.result.build_estimate import (
    NOT_CONVERGED,
    build_data,
    build_rows,
    find_at_bound,
    list_loop_channels,
    warn_of_limit,
)
from jointid.estimation.result.estimate import (
    Checks,
    Estimate,
    Fit,
    Settings,
    poor_fit,
    relative_error,
)
from jointid.estimation.result.params import Params
from jointid.records.record import Record
from jointid.simulation.closed_loop import Simulation
from jointid.uncertainty.identifiability import identifiability
from jointid.uncertainty.position_dependent_error import Uncertainty
from jointid.uncertainty.residual_tests import residual_report
from jointid.uncertainty.verdict import (
    bounds_verdict,
    fit_verdict,
    identifiability_verdict,
    residual_verdicts,
    solver_verdict,
)


def build_closed_loop_estimate(
    record: Record,
    problem: ClosedLoopProblem,
    x: FloatArray,
    run: Simulation,
    end: tuple[str, bool],
    known: Uncertainty,
    J: FloatArray,
    rigid_error: FloatArray | None = None,
) -> Estimate:
    """Return the estimate that ends a simulation of the loop; how it was found is for the caller to add.

    Args:
        record: what was identified from.
        problem: what was solved.
        x: free parameters.
        run: simulation with them.
        end: why the search ended, and whether that is a good end.
        known: of the errors of the free parameters.
        J: (rows, free) sensitivities, filtered.
        rigid_error: (rows,) what a rigid joint leaves, for a flexible one.
    """
    assert record.torque is not None
    assert problem.filtering.cutoff is not None
    values, joint, borders = problem.values(x), problem.loop.joint, problem.filtering.borders
    spread = dict(zip((p.name for p in problem.free), map(float, known.covariance.std), strict=True))
    own = {p.name for p in joint.parameters}
    error, whole = problem.seen(run, problem.measured[:, np.newaxis])
    whole = whole[:, 0]
    left = float(np.linalg.norm(error) / np.linalg.norm(whole))
    step = problem.experiment.sample_time * (problem.filtering.decimation or 1)
    report = residual_report(
        error, whole, step, problem.filtering.cutoff, record.torque.unit, rigid_error=rigid_error,
        repeatable=known.repeatable,
    )  # fmt: skip
    told = identifiability(problem.free, problem.units, x, J, known.covariance)
    verdicts = (
        solver_verdict(*end),
        fit_verdict(report),
        *residual_verdicts(report),
        identifiability_verdict(told),
        bounds_verdict(_touched(problem, x)),
    )
    return Estimate(
        params=Params(
            build_rows(problem.parameters, values, spread, joint.unit, own),
            tuple(p.name for p in problem.free),
            known.covariance.correlation,
            f"from the output sensitivities, {known.basis}",
        ),
        fit=Fit(
            measured=problem.measured,
            predicted=run.torque,
            borders=borders,
            relative_error=relative_error(problem.measured, run.torque, borders),
            filtered_error=left,
            rows=error.size,
            conditioning=None,
            initial=initial_of(values),
            trace=(),
            simulations=0,
            stop=end[0],
            converged=end[1],
            residuals=report,
        ),
        checks=Checks(warnings=_warnings(problem, run, known, end[1], left), verdicts=verdicts, known=told),
        data=build_data(record, list_loop_channels(problem.loop, record), problem.experiment.sample_time),
        settings=Settings(
            method="didim",
            variant="DIDIM",
            joint=joint,
            loop=problem.loop_at(x),
            filtering=problem.filtering,
            delay=values.get("delay", problem.experiment.law.delay),
        ),
    )


def _touched(problem: ClosedLoopProblem, x: FloatArray) -> tuple[str, ...]:
    """Return the names of the parameters that a bound holds."""
    scale = np.where(x != 0.0, np.abs(x), np.max(np.abs(x)) * 1e-6)
    return find_at_bound(problem.free, x, 1e-6 * scale)


def _warnings(
    problem: ClosedLoopProblem, run: Simulation, known: Uncertainty, converged: bool, left: float
) -> tuple[str, ...]:
    found = [*([] if converged else [NOT_CONVERGED]), *warn_of_limit(run.at_limit)]
    aliased = problem.filtering.warnings(problem.experiment.sample_time)
    return (*found, *map(str, known.warnings), *aliased, *poor_fit(left))
