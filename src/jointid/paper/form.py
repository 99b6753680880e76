"""The paper's way to a flexible joint: a simplex from (13), and the deviations of an inverse model."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from jointid import ClosedLoop, Estimate, Filtering, Record
from jointid.common.arrays import FloatArray
from jointid.estimation.problems.base import INITIAL_STATE
from jointid.estimation.problems.closed_loop import ClosedLoopProblem, torque_problem
from jointid.estimation.starts.flexible_joint import start_with_mode

_FREQUENCY = 30.0  # Hz, which the paper measured with the output blocked
_TOLERANCE = 1e-4  # that of MATLAB's fminsearch


def by_simplex(record: Record, loop: ClosedLoop, rigid: Estimate, best: Estimate) -> Estimate:
    """Return the estimate by Nelder-Mead from a rigid one, restarted once, in place of the best by least squares."""
    from scipy.optimize import minimize

    assert record.reference is not None
    position, velocity = INITIAL_STATE
    resting = position.fix(float(record.reference.values[0])), velocity.fix(0.0)
    problem = torque_problem(record, loop, Filtering(), loop.joint.parameters, resting)
    x = problem.vector(start_with_mode(problem, rigid.values, _FREQUENCY, 0.5))
    sizes = np.where(x != 0, np.abs(x), 1e-6 * np.max(np.abs(x)))

    def criterion(at: FloatArray) -> float:
        return float(np.linalg.norm(problem.residual(at * sizes)) / problem.size) ** 2

    runs = []
    for _ in range(2):
        options = {"xatol": _TOLERANCE, "fatol": _TOLERANCE**2, "maxfev": 6000, "maxiter": 6000}
        found = minimize(criterion, x / sizes, method="Nelder-Mead", options=options)  # type: ignore[call-overload]
        x = found.x * sizes
        runs.append(found)
    stop = ", then ".join(f"{run.nit} iterations and {run.nfev} simulations" for run in runs)
    values = problem.values(x)
    std = dict(zip((p.name for p in problem.free), inverse_model_deviations(problem, x), strict=True))
    rows = tuple(replace(p, value=values[p.name], stderr=std.get(p.name)) for p in best.params.rows)
    fit = replace(
        best.fit, filtered_error=problem.filtered_error(problem.residual(x)),
        simulations=sum(run.nfev for run in runs), stop=f"Nelder-Mead stopped after {stop}",
    )  # fmt: skip
    return replace(best, params=replace(best.params, rows=rows), fit=fit)


def inverse_model_deviations(problem: ClosedLoopProblem, x: FloatArray) -> FloatArray:
    """Return the paper's deviations of the joint's parameters, the roots of ``s^2 (W' W)^-1`` on the simulated motion.

    They are those of a regression on W, which is not what torque-only identification solves: for a flexible joint the
    output sensitivities are not W, and Fv1, Fv2 come out many times surer than they are.
    """
    run, error = problem.simulate(x), problem.residual(x)
    W = np.concatenate([problem.filter(equation) for equation in problem.joint.regressor(run.motor, run.load)])
    variance = float(error @ error) / (len(W) - W.shape[1])  # the paper's r counts the rows of both equations
    norms = np.linalg.norm(W, axis=0)
    return np.asarray(np.sqrt(variance * np.diag(np.linalg.inv((W / norms).T @ (W / norms)))) / norms)
