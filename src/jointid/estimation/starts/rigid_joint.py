"""Starts for a rigid joint: regressions on a motion that the record implies, without a simulation."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from jointid.common.arrays import FloatArray
from jointid.common.errors import MethodError
from jointid.common.messages import Detail, Progress
from jointid.estimation.methods.idim import solve_rows
from jointid.estimation.problems.closed_loop import ClosedLoopProblem
from jointid.estimation.problems.inverse_model import inverse_of_joint, motion_along, steady_weights
from jointid.estimation.starts.inverse_controller import (
    first_state,
    invertible_samples,
    reconstructed_position,
    torque_behind_limit,
)
from jointid.models.controllers import REFERENCE
from jointid.records.record import Channel, Timing
from jointid.solvers.bounded_least_squares import LevenbergMarquardt
from jointid.solvers.solve import solve

_EVALUATIONS = 10  # enough for two parameters that act almost linearly on the torque
_MOST = 0.5  # of the samples


def rigid_starts(problem: ClosedLoopProblem, progress: Progress) -> list[dict[str, float]]:
    """Return a start from the inverse of the controller, and one of a regular inertia.

    Raises:
        MethodError: there is none.
    """
    found, failures = list[dict[str, float]](), list[MethodError]()
    for make in (inversion_start, regular_start):
        try:
            found.append(make(problem))
        except MethodError as error:
            failures.append(error)
    if not found:
        raise failures[0]
    if failures:
        progress(Detail(failures[0], "starting from a regular inertia"))
    return found


def inversion_start(problem: ClosedLoopProblem) -> dict[str, float]:
    """Return a start by IDIM on the reconstructed position."""
    position = reconstructed_position(problem)
    acting, known = torque_behind_limit(problem), invertible_samples(problem)
    found = _regress(problem, acting, position, known, problem.axis.law.delay)
    return _apply_fixed_values(problem, found | first_state(problem, position))


def regular_start(problem: ClosedLoopProblem) -> dict[str, float]:
    """Return a regular inertia, read off the reference as if the axis tracked it perfectly, and no friction."""
    experiment = problem.axis
    periods = experiment.clock.log_index // experiment.clock.lengths.size
    reference = experiment.inputs[periods, REFERENCE]
    torque = problem.measured - experiment.logged[periods] + experiment.after_limit[periods]
    tracked = _regress(problem, torque, reference, np.ones(torque.size, dtype=np.bool_))
    known = next(p for p in problem.parameters if p.name == "inertia")
    nominal = abs(tracked["inertia"]) if known.free else float(known.start or 1.0)
    regular = {p.name: 0.0 for p in problem.parameters} | {"inertia": nominal}
    regular |= {"initial_position": float(reference[0]), "initial_velocity": 0.0}
    return _apply_fixed_values(problem, regular)


def fit_initial_state(problem: ClosedLoopProblem) -> tuple[FloatArray, int]:
    """Return the best initial position and velocity, and the number of simulations.

    A motor at rest and a moving one are two problems (see `descent.or_moving`), so both are solved.
    """
    try:
        start = first_state(problem, reconstructed_position(problem))
    except MethodError:  # a controller that cannot be inverted: start on the reference, at rest
        start = {"initial_position": float(problem.axis.inputs[0, 0]), "initial_velocity": 0.0}
    problems = (problem.keeping({"initial_velocity": 0.0}), problem)
    solver = LevenbergMarquardt(tolerance=1e-9, evaluations=_EVALUATIONS)
    ends = [(p, solve(p, solver, p.vector(start))) for p in problems]
    which, best = min(ends, key=lambda end: float(np.linalg.norm(end[1].residual)))
    return problem.vector(which.values(best.x)), sum(end.evaluations for _, end in ends)


def _regress(
    problem: ClosedLoopProblem,
    torque: FloatArray,
    position: FloatArray,
    known: NDArray[np.bool_],
    delay: float = 0.0,
) -> dict[str, float]:
    """Estimate the parameters by IDIM on the samples of known position.

    Elsewhere the position is interpolated, and torque and columns are set to zero.
    """
    joint = problem.joint
    sample_time, instants = problem.axis.sample_time, np.arange(torque.size)
    filtering = replace(problem.filtering, borders=(50, 50) if torque.size > 500 else (0, 0), timing="respected")
    held = Channel(torque, joint.force_unit, sample_time, Timing.HELD)
    if not np.all(known):
        position = np.interp(instants, instants[known], position[known])
    motion = motion_along([held], position[:, np.newaxis], filtering, [delay])
    assert filtering.position_cutoff is not None
    # What sticks takes any torque below Coulomb's, which a regression would read as less friction.
    weights = known * steady_weights(motion.v[:, 0], filtering.position_cutoff, sample_time)[1]
    if np.sum(weights) < _MOST * np.sum(known):  # what is left tells less than what friction at rest bends
        weights = known.astype(np.float64)
    rows = inverse_of_joint(joint).rows([replace(motion, moving=weights[:, np.newaxis])])
    found = solve_rows(rows, "ols", {p.name: p for p in problem.parameters if not p.free})
    return dict(zip(rows.names, map(float, found.values), strict=True))


def _apply_fixed_values(problem: ClosedLoopProblem, values: Mapping[str, float]) -> dict[str, float]:
    """Set every fixed parameter to its fixed value."""
    return {**values, **{p.name: p.start or 0.0 for p in problem.parameters if not p.free}}
