"""What is known of a least torque error, of one record as of each of several.

Beside noise (`uncertainty`): what a random force in the loop moves (`force_in_loop`), and, of a rigid joint, how far
the fixed point of its regressor lies away where noise does not explain that (`second_solution`).
"""

from __future__ import annotations

import numpy as np

from jointid.common.arrays import FloatArray
from jointid.estimation.methods.force_in_loop import widened_for_force
from jointid.estimation.methods.search import History
from jointid.estimation.problems.base import EVEN, filter_rows
from jointid.estimation.problems.closed_loop import ClosedLoopProblem
from jointid.estimation.result.build_result import find_at_bound
from jointid.models.joints import RigidJoint
from jointid.simulation.closed_loop import Simulation
from jointid.uncertainty.position_dependent_error import Uncertainty, uncertainty
from jointid.uncertainty.second_solution import widened_to_second


def known_of_least_error(
    problem: ClosedLoopProblem,
    x: FloatArray,
    run: Simulation,
    residual: FloatArray,
    J: FloatArray,
    history: History,
    taps: FloatArray = EVEN,
) -> Uncertainty:
    """Return what is known of the free parameters where least squares ended.

    Args:
        problem: that was solved.
        x: (free,) where.
        run: of the loop there.
        residual: (rows,) filtered, and through the taps.
        J: (rows, free) the derivatives of the simulated torque, filtered, and through the taps.
        history: counts the simulations.
        taps: of the filter that the rows of the criterion went through.
    """
    names = [p.name for p in problem.free]
    known = uncertainty(J, J, residual, problem.cells(run), names, problem.torque_unit)
    known = widened_for_force(known, problem, x, J, history, taps)
    if not isinstance(problem.joint, RigidJoint) or not problem.joint.friction.linear:  # no regressor is linear then
        return known
    W = filter_rows(taps, problem.filtered(problem.regressor(run)))
    Z = np.hstack([W, J[:, W.shape[1] :]])
    held = find_at_bound(problem.free, x, residual, J)
    return widened_to_second(known, Z, J, residual, np.array([name not in held for name in names]))
