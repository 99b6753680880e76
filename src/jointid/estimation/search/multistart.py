"""The search for a flexible joint: from a grid of starts down to an end that more than one of them leads to.

Least squares explores the grid on a band as wide as the log, refines the best few until two end together, and goes on
from there. Nelder-Mead begins as the paper does, by halves (13) at a known frequency. Where no second start leads to an
end, it is begun again beside itself; and a motor that moves at the first sample is a search of its own.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from jointid.common.arrays import FloatArray
from jointid.estimation.problems.closed_loop import ClosedLoopProblem
from jointid.estimation.problems.nuisance_parameters import INITIAL_STATE
from jointid.estimation.result.estimate import Estimate
from jointid.estimation.search.exploration import FASTEST, WIDE, explored, frequencies_to_try, frequency_of, started
from jointid.estimation.search.history import History, Solved, least_squares
from jointid.records.signals.filtering import Filtering
from jointid.solvers.problem import Counted
from jointid.solvers.solution import Solution
from jointid.solvers.solve import Solver, solve

_REFINED = 6  # starts that are refined at most, until two of them end together
_ROUGHLY, _FEW = 1e-5, 30  # tolerance and evaluations of a refinement that only has to show where it leads
_BESIDE = 3  # times an end that no second start led to is begun again beside itself
_TOGETHER = 1e-3  # of a frequency, and of what remains: ends closer than this are one
_REST = 1e-4  # of the torque: what remains of a record without noise, and is not compared
_MODES = 2.0  # the cut-off is that many free-free frequencies, or more
_MOVING = 9.0  # times the residual's variance: what a velocity at the first sample must explain to be believed


def by_least_squares(
    problem: ClosedLoopProblem,
    filtering: Filtering,
    rigid: Estimate,
    frequency: float | None,
    tolerance: float,
    history: History,
) -> Solved:
    """Explore, refine the best starts until two end together, and go down from there to the full tolerance.

    Where no cut-off is asked for, it follows the mode: the exploration sees the whole band of the log, a refinement
    twice the frequency it starts from; the problem that is solved in the end is on the band of the mode that was found.

    Args:
        problem: what is solved.
        filtering: as it was asked for.
        rigid: a rough rigid joint.
        frequency: free-free, Hz; a grid is tried when None.
        tolerance: of the parameters and the criterion.
        history: of the search.
    """

    def band(mode: float) -> ClosedLoopProblem:
        return problem if filtering.cutoff else on_band(problem, filtering, mode)

    wide = band(math.inf)
    starts = _explored(wide, rigid, frequency, history)
    rough = replace(least_squares(problem, _ROUGHLY), evaluations=_FEW)
    ends: list[tuple[float, float, FloatArray]] = []
    for start, values in starts[:_REFINED]:
        on = band(start)
        x = history.solve(on, rough, on.vector(values)).solution.x
        history.tally.evaluations += 1
        ends.append((float(np.linalg.norm(wide.residual(x))), frequency_of(problem.values(x)), x))
        cost, mode, _ = min(ends, key=lambda end: end[0])
        as_good = (1 + _TOGETHER) * cost + _REST * wide.size
        together = sum(abs(f / mode - 1) < _TOGETHER and c < as_good for c, f, _ in ends)
        if together > 1:
            break
    _, mode, x = min(ends, key=lambda end: end[0])
    on, tried = band(mode), len(ends)
    solver = least_squares(on, tolerance)
    found = history.solve(on, solver, x)
    for _ in range(_BESIDE if together < 2 else 0):
        beside, tried = _from_beside(found, history), tried + 1
        left, other = (float(np.linalg.norm(end.residual)) for end in (found.solution, beside))
        if other < (1 - _TOGETHER) * left - _REST * on.size:  # the way back led further down
            found, together = history.solve(on, solver, beside.x), 1
            continue
        modes = [frequency_of(on.values(end.x)) for end in (found.solution, beside)]
        back = abs(modes[1] / modes[0] - 1) < 10 * _TOGETHER
        together += back and other < (1 + _TOGETHER) * left + _REST * on.size
        break
    message = f"{found.solution.message}; {together} of {tried} starts led there"
    return Solved(on, replace(found.solution, message=message, starts=(together, tried)))


def _from_beside(found: Solved, history: History) -> Solution:
    """Return where a start beside an end leads: softer, more damped, with more of the inertia on the load."""
    problem = found.problem
    values = problem.values(found.solution.x)
    moved = 0.2 * values["load_inertia"] if values["load_inertia"] < values["motor_inertia"] else 0.0
    aside = {"stiffness": 0.8 * values["stiffness"], "load_inertia": values["load_inertia"] + moved}
    aside |= {"motor_inertia": values["motor_inertia"] - moved, "damping": 1.5 * values["damping"]}
    rough = replace(least_squares(problem, _ROUGHLY), evaluations=_FEW)
    # The way back is no part of the way there, and is not noted.
    return solve(history.counted(problem), rough, problem.vector(values | aside))


def _explored(
    problem: ClosedLoopProblem, rigid: Estimate, frequency: float | None, history: History
) -> list[tuple[float, dict[str, float]]]:
    """Return starts as (free-free frequency, values), best first: of a grid, or at the frequency that is known."""
    law, sample_time = problem.experiment.law, problem.experiment.sample_time
    tried = [frequency] if frequency else frequencies_to_try(law, rigid.values["inertia"], sample_time)
    starts, used = explored(problem, rigid.values, tried, history.progress)
    history.tally.evaluations += used
    return starts


def on_band(problem: ClosedLoopProblem, filtering: Filtering, mode: float) -> ClosedLoopProblem:
    """Return the problem filtered for a mode at that frequency: the default cut-off, or twice the mode.

    What seems to be a mode too fast for the log is none, and no reason to look at more than by default.
    """
    sample_time = problem.experiment.sample_time
    if FASTEST / sample_time < mode < math.inf:
        mode = 0.0
    default = Filtering().resolved(sample_time, "flexible").cutoff
    assert default is not None
    cutoff = min(max(default, _MODES * mode), WIDE / sample_time)
    return replace(problem, filtering=replace(filtering, cutoff=cutoff).resolved(sample_time, "flexible"))


def simplex_start(problem: ClosedLoopProblem, rigid: Estimate, frequency: float | None, history: History) -> FloatArray:
    """Return where the paper starts: (13) at its frequency, or where that loop is unstable the best of a grid."""
    if frequency is not None:
        start = problem.vector(started(problem, rigid.values, frequency, 0.5))
        if np.linalg.norm(history.counted(problem).residual(start)) <= problem.size:
            return start
        history.progress("the halved inertia (13) makes an unstable loop here; starting from another load share")
    return problem.vector(_explored(problem, rigid, frequency, history)[0][1])


def or_moving(resting: Solved, rigid: Estimate, free: bool, solver: Solver[Counted], history: History) -> Solved:
    """Return the better of two answers, the motor at rest at the first sample or moving: see `didim`.

    Args:
        resting: where the search ended, with the motor at rest.
        rigid: a rough rigid joint, and how the motor moves with it.
        free: whether the state at the first sample is searched for, or kept as the rigid joint has it.
        solver: of a descent.
        history: of the search.
    """
    problem, x = resting.problem, resting.solution.x
    error = history.counted(problem).residual(x)
    values = problem.values(x) | {p.name: rigid[p.name].value or 0.0 for p in INITIAL_STATE}
    state = {p.name: replace(p, start=values[p.name], free=free) for p in INITIAL_STATE}
    begun = problem.changed(state)
    moving = history.solve(begun, solver, begun.vector(values))
    left = history.counted(begun).residual(moving.solution.x)
    gained = float(error @ error) - float(left @ left)
    if gained > _MOVING * float(error @ error) / error.size:
        return Solved(begun, replace(moving.solution, starts=resting.solution.starts))
    return resting
