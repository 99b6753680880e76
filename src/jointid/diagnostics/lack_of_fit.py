"""Intervals of an estimate whose model lacks something: as wide as what it lacks can move each parameter."""

from __future__ import annotations

import math

import numpy as np

from jointid.common.arrays import FloatArray, column_norms
from jointid.diagnostics.faults.findings import LoopCheck
from jointid.diagnostics.unmodelled_motion import PredictedResidual
from jointid.estimation.problems.closed_loop import ClosedLoopProblem
from jointid.estimation.result.assemble import Widening


def widen_for_faults(check: LoopCheck) -> list[Widening]:
    """Return how far parameters move where the joint has the faults that a check found; none without any.

    Faults of loop and log widen nothing: they are corrected, or not.
    """
    found = [one for one in check.findings if one.test.fault.mechanical]
    moved: dict[str, float] = {}
    for finding in found:
        for name, change in finding.changes.items():
            moved[name] = math.hypot(moved.get(name, 0.0), change.by)
    return [Widening(moved, "what the joint has and its model has not")] if found else []


def widen_for_rest(problem: ClosedLoopProblem, x: FloatArray, rest: PredictedResidual) -> Widening:
    """Return how far a residual that follows the motion can move each parameter.

    A part of the torque as large as the one that is seen, but of the shape that moves a parameter most, moves it by the
    norm of that part times its deviation under a noise of one (the inequality of Cauchy and Schwarz). What is seen is
    what no parameter has made up for; what they have made up for is taken to be as large.

    Args:
        problem: solved, with the faults that were found corrected.
        x: (free,) its parameters.
        rest: see `predict_residual`.
    """
    # The whole way that it can move a parameter is two deviations.
    moved = worst_shift(problem, x, 0.5 * rest.share * problem.size)
    return Widening(moved, "a part of the torque that follows the motion and is not in the model")


def worst_shift(problem: ClosedLoopProblem, x: FloatArray, size: float) -> dict[str, float]:
    """Return by how much a part of the filtered torque of a norm can move each free parameter at most, by name."""
    slopes = problem.linearise(x)[1]
    sizes = column_norms(slopes)  # of parameters in units of their own
    # Rows of the pseudo-inverse: their norms are the deviations under a noise of one, and never the root of a rounding.
    spread = np.linalg.norm(np.linalg.pinv(slopes / sizes, rcond=1e-8), axis=1) / sizes
    return {p.name: size * float(by) for p, by in zip(problem.free, spread, strict=True)}
