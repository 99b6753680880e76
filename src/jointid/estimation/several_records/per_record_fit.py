"""Each of several records by itself: a start for the fit of all of them, the level of its residual, what it says alone.

By itself a record is fitted as it will be with the others, by bounded least squares with the exact Jacobian, from what
its own identification found; only the gain of its drive, which no record tells alone, is kept at 1. Its residual gives
the weights of its rows in the fit of all records, and in another one of itself (`whitened`).
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from jointid.common.arrays import FloatArray
from jointid.common.errors import MethodError
from jointid.estimation.problems.closed_loop import ClosedLoopProblem
from jointid.estimation.problems.several_records import at_rows, several, whitening
from jointid.estimation.result.estimate import Estimate
from jointid.models.parameters import TORQUE_UNIT
from jointid.solvers.solve import Solution, solve
from jointid.solvers.trust_region import TrustRegion
from jointid.uncertainty.covariance import bandwidth
from jointid.uncertainty.position_dependent_error import Repeatable, Uncertainty, cells, uncertainty

SOLVER = TrustRegion(1e-10, evaluations=100)
"""Of one record, and of several together."""

_NOTHING_LEFT = 1e-6  # of the torque: a residual below it is rounding, and no level


@dataclass(frozen=True, slots=True, eq=False)
class BySelf:
    """One record fitted by itself.

    Attributes:
        problem: what was solved, per torque of the log.
        end: its solution, in rows that are weighted.
        error: (rows,) its residual, not weighted.
        level: rms of the residual over its degrees of freedom.
        weights: taps of the filter that the rows go through.
        uncertainty: of the solution.
        repeatable: what of the residual repeats with the motion.
        simulations: that this took.
    """

    problem: ClosedLoopProblem
    end: Solution
    error: FloatArray
    level: float
    weights: FloatArray
    uncertainty: Uncertainty
    repeatable: Repeatable
    simulations: int

    @property
    def values(self) -> dict[str, float]:
        """Every parameter by name, the fixed ones too."""
        return self.problem.values(self.end.x)

    def acting(self, gain: float) -> dict[str, float]:
        """Return them with those of the joint per torque that acts, which is so many times the log's."""
        own = {p.name for p in self.problem.loop.joint.parameters}
        return {n: gain * v if n in own else v for n, v in self.values.items()} | {"drive_gain": gain}


def by_itself(problem: ClosedLoopProblem, values: Mapping[str, float]) -> BySelf:
    """Fit one record, all of its rows weighing the same.

    Args:
        problem: of the record.
        values: where to begin, by name.
    """
    end = solve(problem, SOLVER, problem.vector(values))
    level = float(np.linalg.norm(end.residual)) / math.sqrt(max(end.residual.size - end.x.size, 1))
    judged, level = _judged(problem, end), max(level, _nothing(problem))
    weights = np.array([1.0 / level])
    return BySelf(problem, end, end.residual, level, weights, judged, judged.repeatable, end.evaluations + 1)


def whitened(one: BySelf) -> BySelf:
    """Fit a record again, its rows weighted by the spectrum of its residual; one that leaves nothing stays as it is."""
    if one.level <= _nothing(one.problem):
        return one
    weights = whitening(one.error, one.level, bandwidth(one.error.size))
    end = solve(several([one.problem]).weighing([weights]), SOLVER, one.end.x)
    error, judged, used = one.problem.residual(end.x), _judged(one.problem, end), end.evaluations + 2
    return replace(one, end=end, error=error, weights=weights, uncertainty=judged, simulations=one.simulations + used)


def _nothing(problem: ClosedLoopProblem) -> float:
    """Return the level of a residual that is as good as none."""
    return _NOTHING_LEFT * float(np.sqrt(np.mean(problem.filtered(problem.measured) ** 2)))


def _judged(problem: ClosedLoopProblem, end: Solution) -> Uncertainty:
    where, joint = cells(*at_rows(problem, problem.simulate(end.x))), problem.loop.joint
    unit = joint.torque_unit or TORQUE_UNIT[joint.kind]
    return uncertainty(end.jacobian, end.jacobian, end.residual, where, [p.name for p in problem.free], unit)


def starts(estimates: Sequence[Estimate]) -> list[dict[str, float]]:
    """Return the values each record starts from; one that it refused is another record's.

    Raises:
        MethodError: a parameter is refused by all of them.
    """
    every = [{p.name: p.value for p in e.params if p.value is not None} for e in estimates]
    anywhere = {name: value for each in reversed(every) for name, value in each.items()}
    lost = [p.name for p in estimates[0].params if p.name not in anywhere]
    if lost:
        raise MethodError(
            f"No record by itself tells {', '.join(lost)}, so nothing is known to start from; "
            "identify the joint as rigid, or record a motion that shows it."
        )
    return [anywhere | each for each in every]
