"""Coverage of the intervals: the paper's statistics against those that an estimate reports.

Many noisy runs of the twin are identified from torque alone by least squares. Each time two intervals of 2 sigma are
formed about the same estimate, and it is counted how often each holds the truth. An honest one does in about 95 % of
the runs. The viscous frictions are hardly told apart, so their sum is judged as well.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from jointid.estimation.descent import descend
from jointid.estimation.problems.simulated import torque_problem
from jointid.paper.reproduce import inverse_model_deviations
from jointid.paper.twin import twin
from jointid.records.signals.filtering import Filtering
from jointid.uncertainty.covariance import Influence
from jointid.uncertainty.identifiability import identifiability
from jointid.uncertainty.model_tests import whiteness
from jointid.uncertainty.position_dependent_error import uncertainty

_ENOUGH = 1e-6  # relative: far below a deviation
_VISCOUS = ("motor_viscous", "load_viscous")


@dataclass(frozen=True, slots=True)
class CoverageRun:
    """One run.

    Attributes:
        error: of each parameter of the joint, by name.
        inverse_model: deviations by the paper's statistics.
        sensitivities: deviations by the output sensitivities, as an estimate reports them.
        white: whether the residual is said to be white.
        repeats: whether the residual is said to repeat with the motion, which it does not.
        sum_error: of Fv1 + Fv2, in its deviations.
        correlation: of Fv1 and Fv2.
        inseparable: whether the run says that Fv1 and Fv2 are known only by their sum.
    """

    error: dict[str, float]
    inverse_model: dict[str, float]
    sensitivities: dict[str, float]
    white: bool
    repeats: bool
    sum_error: float
    correlation: float
    inseparable: bool


def judge(seed: int, loop: Literal["L19", "L30"], noise: Literal["disturbance", "white"]) -> CoverageRun:
    """Identify one noisy twin, from a fit that begins at the truth."""
    axis = twin(loop, noise=noise, seed=seed)
    record = axis.record.without("motor_position", "load_position")
    problem = torque_problem(record, axis.loop, Filtering(), axis.loop.joint.parameters)
    problem = problem.keeping({"initial_velocity": 0.0})
    truth = problem.vector({**axis.truth, "initial_position": 0.0})
    end = descend(problem, truth, _ENOUGH)
    x, J = end.x, -end.jacobian
    error, names = problem.residual(x), [p.name for p in problem.free]
    joint = names[: len(problem.free_joint)]
    known = uncertainty(Influence(J, error), problem.cells(problem.simulate(x)))
    cutoff, step = problem.filtering.cutoff, problem.sample_time * (problem.filtering.decimation or 1)
    assert cutoff is not None
    found = whiteness(error, step, cutoff)
    told = identifiability(problem.free, problem.units, x, J, known.covariance)
    (viscous,) = (one for one in told.physical if one.combination.name == "total viscous")
    motor, load = (names.index(name) for name in _VISCOUS)
    by_paper = inverse_model_deviations(problem, x)
    return CoverageRun(
        error={name: float(x[i] - truth[i]) for i, name in enumerate(joint)},
        inverse_model={name: float(by_paper[i]) for i, name in enumerate(joint)},
        sensitivities={name: float(known.covariance.std[i]) for i, name in enumerate(joint)},
        white=bool(found is not None and found.white),
        repeats=bool(known.repeatable.significant),
        sum_error=float((viscous.value - sum(axis.truth[name] for name in _VISCOUS)) / viscous.std),
        correlation=float(known.covariance.correlation[motor, load]),
        inseparable=any(one.values.get("parameters") == ["motor_viscous", "load_viscous"] for one in told.limitations),
    )
