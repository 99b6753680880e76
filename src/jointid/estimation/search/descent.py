"""A criterion on its way down: the filtered torque error of a problem, its descents, and what they cost.

Two ways down: least squares with the output sensitivities, by SciPy's bounded trust region; and Nelder-Mead by the
rules of MATLAB's ``fminsearch``, restarted because it stops early.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from jointid.common.arrays import FloatArray
from jointid.common.errors import MethodError
from jointid.common.progress import Progress
from jointid.estimation.problems.closed_loop import Problem
from jointid.estimation.result.estimate import Iteration
from jointid.solvers.levenberg_marquardt import arrived

if TYPE_CHECKING:
    from scipy.optimize import OptimizeResult

_EVALUATIONS = 60  # of one refinement
_REASONS = {-2: "the criterion", 2: "the criterion", 3: "the parameters", 4: "the criterion and the parameters"}
_IMPROVED = 1e-4  # of the criterion: a restart that gains less was not needed


class Descent:
    """A criterion on its way down: what it is evaluated on, what it cost, and the trace."""

    def __init__(self, problem: Problem, progress: Progress) -> None:
        self.problem, self.progress = problem, progress
        self.trace: list[Iteration] = []
        self.simulations = 0
        self.scales = np.ones(len(problem.free))
        self.size = float(np.linalg.norm(problem.filtered(problem.measured)))
        self._last: tuple[Problem, FloatArray, FloatArray, FloatArray] | None = None

    def residual(self, x: FloatArray) -> FloatArray:
        """Return the filtered torque error; large and finite where the loop cannot be simulated."""
        self.simulations += 1
        return self.problem.residual(x)

    def linearised(self, x: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the filtered torque error and its derivatives; asked twice for one point, it runs once."""
        if self._last is None or self._last[0] is not self.problem or not np.array_equal(self._last[1], x):
            self.simulations += 1
            self._last = (self.problem, x.copy(), *self.problem.linearised(x))
        return self._last[2], self._last[3]

    def note(self, x: FloatArray, norm: float) -> None:
        """Add a line to the trace, and tell every tenth."""
        before = self.trace[-1] if self.trace else None
        change = step = None
        if before is not None:
            change = abs(norm - before.residual_norm) / before.residual_norm if before.residual_norm else 0.0
            last = self.problem.vector(before.values)
            step = float(np.max(np.abs(x - last) / np.where(x != 0.0, np.abs(x), 1.0)))
        values, number = self.problem.values(x), len(self.trace)
        self.trace.append(Iteration(number, values, norm, change, step, self.simulations))
        if number % 100 == 0 or number < 10:  # a simplex takes more than a thousand steps
            self.progress(f"iteration {number}: torque error {100 * norm / self.size:.4f} %")


@dataclass(frozen=True, slots=True, eq=False)
class Refined:
    """Where a descent by least squares ended.

    Attributes:
        x: the free parameters. fun: (rows,) the residual there. jac: (rows, free) its derivatives.
        status: why it ended there, as SciPy numbers it; nfev: evaluations.
    """

    x: FloatArray
    fun: FloatArray
    jac: FloatArray
    status: int
    nfev: int


def reason(status: int, evaluations: int, tolerance: float) -> tuple[str, bool]:
    """Return why a descent by least squares ended, in a sentence, and whether that is a good end."""
    if status not in _REASONS:
        return f"not converged after {evaluations} evaluations", False
    return f"converged: {_REASONS[status]} changed by less than {100 * tolerance:g} %", True


def refined(descent: Descent, x: FloatArray, tolerance: float, evaluations: int = _EVALUATIONS) -> Refined:
    """Return where one least-squares descent within the bounds ends.

    Each parameter is searched in units of its start, and the residual in units of the torque, so that the search is
    the same in any units. From where nothing can be simulated there is no way down: the start comes back.
    """
    from scipy.optimize import least_squares

    x = np.clip(x, *(np.array([getattr(p, side) for p in descent.problem.free]) for side in ("lower", "upper")))
    error, J = descent.linearised(x)
    if J.any() and arrived(descent.problem.free, x, error, J, tolerance):
        return Refined(x, error, J, status=2, nfev=1)
    norms = np.linalg.norm(J, axis=0)
    sizes = float(np.linalg.norm(error)) / np.where(norms > 0, norms, np.inf)
    unit, size = np.where(x != 0.0, np.abs(x), np.where(sizes > 0, sizes, 1.0)), descent.size or 1.0

    def residual(y: FloatArray) -> FloatArray:
        return descent.linearised(y * unit)[0] / size

    def jacobian(y: FloatArray) -> FloatArray:
        return descent.linearised(y * unit)[1] * (unit / size)

    free = descent.problem.free

    def step(intermediate_result: OptimizeResult) -> None:
        at = np.asarray(intermediate_result.x * unit)
        descent.note(at, size * math.sqrt(2 * float(intermediate_result.cost)))
        if arrived(free, at, *descent.linearised(at), tolerance):
            raise StopIteration

    found = least_squares(
        residual,
        x / unit,
        jacobian,
        (np.array([p.lower for p in free]) / unit, np.array([p.upper for p in free]) / unit),
        x_scale="jac",
        xtol=tolerance,
        ftol=tolerance,
        gtol=None,
        max_nfev=evaluations if J.any() else 1,
        callback=step,
    )
    return Refined(
        np.asarray(found.x * unit),
        np.asarray(found.fun * size),
        np.asarray(found.jac) * (size / unit),
        int(found.status),
        int(found.nfev),
    )


def with_free(
    descent: Descent, x: FloatArray, names: tuple[str, ...], tolerance: float
) -> tuple[FloatArray, str, bool]:
    """Go on by least squares with more of what surrounds the joint free, and return where, why there, and how well.

    Args:
        descent: at the end of its descent; its problem is exchanged for the wider one.
        x: where it ended.
        names: of what is freed, see `surroundings`.
        tolerance: of the parameters and the criterion.

    Raises:
        MethodError: nothing around the joint has such a name, or one record cannot tell it.
    """
    if isinstance(names, str):
        raise MethodError(f'What is freed is a list of names; received "{names}": write free=("{names}",).')
    if "drive_gain" in names:
        raise MethodError(
            "One record cannot tell the drive_gain from the scale of the joint; free log_gain or a gain of the law, or "
            "identify from two records with a known mass between them."
        )
    values = descent.problem.values(x)
    descent.problem = descent.problem.freeing(*names)
    end = refined(descent, descent.problem.vector(values), tolerance)
    return end.x, *reason(end.status, end.nfev, tolerance)


def by_simplex(
    descent: Descent, x: FloatArray, tolerance: float, simulations: int, restarts: int
) -> tuple[FloatArray, str, bool]:
    """Nelder-Mead by the rules of ``fminsearch``: its simplex, coefficients and stopping rule, scaled parameters."""
    from scipy.optimize import minimize

    def criterion(scaled: FloatArray) -> float:
        norm = float(np.linalg.norm(descent.residual(scaled * descent.scales))) / descent.size
        return norm * norm

    best, runs = math.inf, []
    for restart in range(restarts + 1):
        before = descent.simulations
        found = minimize(
            criterion,
            x / descent.scales,
            method="Nelder-Mead",
            options={
                "xatol": tolerance,
                "fatol": tolerance**2,  # of the torque's: what a simplex of that size spans near a minimum
                "maxfev": simulations,
                "maxiter": simulations,
            },
            callback=lambda intermediate_result: descent.note(
                intermediate_result.x * descent.scales, descent.size * math.sqrt(float(intermediate_result.fun))
            ),
        )
        x = np.asarray(found.x * descent.scales)
        gained = (best - float(found.fun)) / max(float(found.fun), 1e-300) if math.isfinite(best) else math.inf
        best = min(best, float(found.fun))
        runs.append(f"{found.nit} iterations and {descent.simulations - before} simulations")
        if restart and gained < _IMPROVED:
            break
        descent.progress(f"Nelder-Mead stopped after {runs[-1]}")
    why = f"its tolerance of {tolerance:g}" if found.success else f"its limit of {simulations} simulations"
    return x, f"Nelder-Mead stopped by {why} after {', then '.join(runs)}", bool(found.success)
