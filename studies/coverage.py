"""Coverage of the intervals: the paper's statistics against those that an estimate reports.

Many noisy runs of the twin are identified from torque alone by least squares. Each time two intervals of 2 sigma are
formed about the same estimate, and it is counted how often each holds the truth. An honest one does in about 95 % of
the runs. The viscous frictions are hardly told apart, so their sum is judged as well.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal

import numpy as np

from jointid.common.arrays import FloatArray
from jointid.estimation.methods.flexible import inverse_model_covariance, refined_least_squares
from jointid.estimation.problems.closed_loop import torque_problem
from jointid.paper.twin import twin
from jointid.records.signals.filtering import Filtering
from jointid.uncertainty.identifiability import identifiability
from jointid.uncertainty.position_dependent_error import uncertainty
from jointid.uncertainty.residual_tests import whiteness
from studies.seeds import judge_seeds

_ENOUGH = 1e-6  # relative: far below a deviation
_VISCOUS = ("motor_viscous", "load_viscous")


@dataclass(frozen=True, slots=True)
class Coverage:
    """Coverage of the 2-sigma intervals, by parameter.

    Attributes:
        runs: how many.
        inverse_model: share by the paper's statistics.
        sensitivities: share by the output sensitivities, as an estimate reports them.
        spread: standard deviation of the estimates over the runs, relative to the truth.
        bias: mean error over the runs, in those standard deviations.
        not_white: share of the runs whose residual is said not to be white.
        repeats: share of the runs whose residual is said to repeat with the motion, which it does not.
        viscous_sum: share of the runs in which the interval of Fv1 + Fv2 held the truth.
        viscous_correlation: of Fv1 and Fv2, that of the run which tells them apart best.
        inseparable: share of the runs that say Fv1 and Fv2 are known only by their sum.
    """

    runs: int
    inverse_model: Mapping[str, float]
    sensitivities: Mapping[str, float]
    spread: Mapping[str, float]
    bias: Mapping[str, float]
    not_white: float
    repeats: float
    viscous_sum: float
    viscous_correlation: float
    inseparable: float


@dataclass(frozen=True, slots=True)
class _Run:
    """One run: errors and deviations of the joint's parameters, and the verdicts."""

    error: list[float]
    paper: list[float]
    honest: list[float]
    white: bool
    repeats: bool
    sum_held: bool
    correlation: float
    inseparable: bool


def coverage(
    runs: int,
    loop: Literal["L19", "L30"] = "L19",
    noise: Literal["disturbance", "white"] = "white",
    seed: int = 1,
    out: Path | None = None,
) -> Coverage:
    """Identify the twin from its torque many times, with the noise that gives the paper's 8 %.

    Args:
        runs: how many.
        loop: of the twin.
        noise: white on the log, or a white force inside the loop, which is coloured in the torque.
        seed: of the first run's noise; the others follow.
        out: folder in which runs are kept, and found again.
    """
    seeds, settings = range(seed, seed + runs), {"loop": loop, "noise": noise}
    found = [_Run(**run) for run in judge_seeds("studies.coverage:judge", seeds, settings, out=out)]
    axis = twin(loop, noise="none")
    names = [p.name for p in axis.loop.joint.parameters]
    truth = np.array([axis.truth[name] for name in names])
    error = np.array([run.error for run in found])
    scatter = error.std(axis=0, ddof=1)

    def by_name(values: FloatArray) -> dict[str, float]:
        return dict(zip(names, map(float, values), strict=True))

    def share(std: list[list[float]]) -> dict[str, float]:
        return by_name(np.mean(np.abs(error) <= 2 * np.array(std), axis=0))

    return Coverage(
        runs,
        inverse_model=share([run.paper for run in found]),
        sensitivities=share([run.honest for run in found]),
        spread=by_name(scatter / np.abs(truth)),
        bias=by_name(error.mean(axis=0) / scatter),
        not_white=float(np.mean([not run.white for run in found])),
        repeats=float(np.mean([run.repeats for run in found])),
        viscous_sum=float(np.mean([run.sum_held for run in found])),
        viscous_correlation=max(run.correlation for run in found),
        inseparable=float(np.mean([run.inseparable for run in found])),
    )


def judge(seed: int, loop: Literal["L19", "L30"], noise: Literal["disturbance", "white"]) -> _Run:
    """Identify one noisy twin, from a fit that begins at the truth."""
    axis = twin(loop, noise=noise, seed=seed)
    record = axis.record.without("motor_position", "load_position")
    problem = torque_problem(record, axis.loop, Filtering(), axis.loop.joint.parameters)
    still = tuple(p.fixed(0.0) if p.name == "initial_velocity" else p for p in problem.parameters)
    problem = replace(problem, parameters=still)
    truth = problem.vector({**axis.truth, "initial_position": 0.0})
    x, J = refined_least_squares(problem, truth, _ENOUGH)
    error, names = problem.residual(x), [p.name for p in problem.free]
    joint = len(problem.free_joint)
    known = uncertainty(J, J, error, problem.cells(problem.simulate(x)), names)
    cutoff, step = problem.filtering.cutoff, problem.experiment.sample_time * (problem.filtering.decimation or 1)
    assert cutoff is not None
    found = whiteness(error, step, cutoff)
    told = identifiability(problem.free, problem.units, x, J, known.covariance)
    (viscous,) = (one for one in told.physical if one.combination.name == "total viscous")
    motor, load = (names.index(name) for name in _VISCOUS)
    return _Run(
        error=(x - truth)[:joint].tolist(),
        paper=inverse_model_covariance(problem, x, error).std.tolist(),
        honest=known.covariance.std[:joint].tolist(),
        white=bool(found is not None and found.white),
        repeats=bool(known.repeatable.significant),
        sum_held=bool(abs(viscous.value - sum(axis.truth[name] for name in _VISCOUS)) <= 2 * viscous.std),
        correlation=float(known.covariance.correlation[motor, load]),
        inseparable=any(one.values.get("parameters") == ["motor_viscous", "load_viscous"] for one in told.limitations),
    )
