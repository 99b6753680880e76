"""Nelder-Mead simplex by the rules of MATLAB's ``fminsearch``, with restarts."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from jointid.common.arrays import FloatArray
from jointid.solvers.solve import Counted, Problem, Solution, Status, Step, Watch

_IMPROVED = 1e-4  # of the criterion: a restart that gains less was not needed


@dataclass(frozen=True, slots=True, eq=False)
class NelderMead:
    """Settings of the simplex search, with the coefficients and stopping rule of ``fminsearch``.

    Attributes:
        tolerance: relative, of every parameter; the criterion's is its square.
        evaluations: at most, of one run.
        restarts: at most, each from where the last one stopped; it ends when one gains nothing.
        scales: (free,) sizes the parameters are searched on; those of the start when None.
        size: of the residual, which is searched in units of it.
    """

    tolerance: float = 1e-4
    evaluations: int = 6000
    restarts: int = 3
    scales: FloatArray | None = None
    size: float = 1.0

    def solve(self, problem: Problem, start: FloatArray, watch: Watch) -> Solution:
        """Search from a start; bounds are ignored, derivatives evaluated at the end."""
        from scipy.optimize import minimize

        counted, x, trace = Counted.of(problem), start, list[Step]()
        before, scales = counted.evaluations, sizes_of(start) if self.scales is None else self.scales

        def criterion(scaled: FloatArray) -> float:
            norm = float(np.linalg.norm(counted.residual(scaled * scales))) / self.size
            return norm * norm

        def step(scaled: FloatArray, cost: float) -> None:
            norm = self.size * math.sqrt(float(cost))
            trace.append(Step(np.asarray(scaled * scales), norm, counted.evaluations))
            watch(trace[-1])

        best, runs = math.inf, list[str]()
        for restart in range(self.restarts + 1):
            count = counted.evaluations
            found = minimize(
                criterion,
                x / scales,
                method="Nelder-Mead",
                options={
                    "xatol": self.tolerance,
                    "fatol": self.tolerance**2,  # what a simplex of that size spans near a minimum
                    "maxfev": self.evaluations,
                    "maxiter": self.evaluations,
                },
                callback=lambda intermediate_result: step(intermediate_result.x, intermediate_result.fun),
            )
            x, cost = np.asarray(found.x * scales), float(found.fun)
            gained = (best - cost) / max(cost, 1e-300) if math.isfinite(best) else math.inf
            best = min(best, cost)
            runs.append(f"{found.nit} iterations and {counted.evaluations - count} simulations")
            if restart and gained < _IMPROVED:
                break
        why = (
            f"its tolerance of {self.tolerance:g}" if found.success else f"its limit of {self.evaluations} simulations"
        )
        status = Status.STEP_AND_COST if found.success else Status.EVALUATION_LIMIT
        error, J = counted.linearise(x)
        message = f"Nelder-Mead stopped by {why} after {', then '.join(runs)}"
        status = status if J.any() else Status.NOT_EVALUABLE
        return Solution(x, error, J, status, message, tuple(trace), counted.evaluations - before)


def sizes_of(x: FloatArray) -> FloatArray:
    """Search scale of each parameter; 0 gets a scale, too."""
    sizes = np.abs(x)
    return np.asarray(np.where(sizes > 0, sizes, np.max(sizes) * 1e-6))
