"""The search for a flexible joint: from a grid of starts down to an end that more than one of them leads to.

Least squares explores the grid on a band as wide as the log, refines the best few until two end together, and goes on
from there. Nelder-Mead begins as the paper does, by halves (13) at a known frequency. Where no second start leads to an
end, it is begun again beside itself; and a motor that moves at the first sample is a search of its own.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace

import numpy as np

from jointid.common.arrays import FloatArray
from jointid.estimation.problems.closed_loop import Problem
from jointid.estimation.problems.nuisance_parameters import INITIAL_STATE
from jointid.estimation.result.estimate import Estimate
from jointid.estimation.search.descent import Descent, Refined, reason, refined
from jointid.estimation.search.exploration import FASTEST, WIDE, explored, frequencies_to_try, frequency_of, started
from jointid.records.signals.filtering import Filtering

_REFINED = 6  # starts that are refined at most, until two of them end together
_ROUGHLY, _FEW = 1e-5, 30  # tolerance and evaluations of a refinement that only has to show where it leads
_BESIDE = 3  # times an end that no second start led to is begun again beside itself
_TOGETHER = 1e-3  # of a frequency, and of what remains: ends closer than this are one
_REST = 1e-4  # of the torque: what remains of a record without noise, and is not compared
_MODES = 2.0  # the cut-off is that many free-free frequencies, or more
_MOVING = 9.0  # times the residual's variance: what a velocity at the first sample must explain to be believed


@dataclass(frozen=True, slots=True, eq=False)
class End:
    """Where a search ended, why, whether that is a good end, and how many of how many starts led there."""

    x: FloatArray
    stop: str
    converged: bool
    led: tuple[int, int] = (1, 1)


def by_least_squares(
    descent: Descent, filtering: Filtering, rigid: Estimate, frequency: float | None, tolerance: float
) -> End:
    """Explore, refine the best starts until two end together, and go down from there to the full tolerance.

    Where no cut-off is asked for, it follows the mode: the exploration sees the whole band of the log, a refinement
    twice the frequency it starts from.

    Args:
        descent: of the problem; it ends on the band of the mode that was found.
        filtering: as it was asked for.
        rigid: a rough rigid joint.
        frequency: free-free, Hz; a grid is tried when None.
        tolerance: of the parameters and the criterion.
    """
    problem = descent.problem
    wide = problem if filtering.cutoff else on_band(problem, filtering, math.inf)
    law, sample_time = problem.experiment.law, problem.experiment.sample_time
    frequencies = [frequency] if frequency else None
    frequencies = frequencies or frequencies_to_try(law, rigid.values["inertia"], sample_time)
    starts, used = explored(wide, rigid.values, frequencies, descent.progress)
    descent.simulations += used
    ends: list[tuple[float, float, FloatArray]] = []
    for start, values in starts[:_REFINED]:
        descent.problem = problem if filtering.cutoff else on_band(problem, filtering, start)
        x = refined(descent, descent.problem.vector(values), _ROUGHLY, _FEW).x
        descent.simulations += 1
        ends.append((float(np.linalg.norm(wide.residual(x))), frequency_of(problem.values(x)), x))
        cost, mode, _ = min(ends, key=lambda end: end[0])
        as_good = (1 + _TOGETHER) * cost + _REST * float(np.linalg.norm(wide.filtered(wide.measured)))
        together = sum(abs(f / mode - 1) < _TOGETHER and c < as_good for c, f, _ in ends)
        if together > 1:
            break
    _, mode, x = min(ends, key=lambda end: end[0])
    descent.problem = problem if filtering.cutoff else on_band(problem, filtering, mode)
    descent.size = float(np.linalg.norm(descent.problem.filtered(problem.measured)))
    found, tried = refined(descent, x, tolerance), len(ends)
    for _ in range(_BESIDE if together < 2 else 0):
        beside, tried = _from_beside(descent, found.x), tried + 1
        left, other = (float(np.linalg.norm(end.fun)) for end in (found, beside))
        if other < (1 - _TOGETHER) * left - _REST * descent.size:  # the way back led further down
            found, together = refined(descent, beside.x, tolerance), 1
            continue
        modes = [frequency_of(descent.problem.values(end.x)) for end in (found, beside)]
        back = abs(modes[1] / modes[0] - 1) < 10 * _TOGETHER
        together += back and other < (1 + _TOGETHER) * left + _REST * descent.size
        break
    stop, converged = reason(found.status, found.nfev, tolerance)
    return End(found.x, f"{stop}; {together} of {tried} starts led there", converged, (together, tried))


def _from_beside(descent: Descent, x: FloatArray) -> Refined:
    """Return where a start beside an end leads: softer, more damped, with more of the inertia on the load."""
    values = descent.problem.values(x)
    moved = 0.2 * values["load_inertia"] if values["load_inertia"] < values["motor_inertia"] else 0.0
    aside = {"stiffness": 0.8 * values["stiffness"], "load_inertia": values["load_inertia"] + moved}
    aside |= {"motor_inertia": values["motor_inertia"] - moved, "damping": 1.5 * values["damping"]}
    start, trace = descent.problem.vector(values | aside), list(descent.trace)
    end = refined(descent, start, _ROUGHLY, _FEW)
    descent.trace = trace  # the way back is no part of the way there
    return end


def on_band(problem: Problem, filtering: Filtering, mode: float) -> Problem:
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


def by_nelder_mead(
    descent: Descent, rigid: Estimate, frequency: float | None, down: Callable[[FloatArray], End]
) -> End:
    """Search as the paper did: from (13) at its frequency, or where that loop is unstable from the best start."""
    problem = descent.problem
    law, sample_time = problem.experiment.law, problem.experiment.sample_time
    values: Mapping[str, float] | None = None
    if frequency is not None:
        values = started(problem, rigid.values, frequency, 0.5)
        descent.simulations += 1
        if np.linalg.norm(problem.residual(problem.vector(values))) > descent.size:
            descent.progress("the halved inertia (13) makes an unstable loop here; starting from another load share")
            values = None
    if values is None:
        known = [frequency] if frequency else None
        tried = known or frequencies_to_try(law, rigid.values["inertia"], sample_time)
        starts, used = explored(problem, rigid.values, tried, descent.progress)
        descent.simulations += used
        values = starts[0][1]
    x = problem.vector(values)
    descent.scales = _scales(x)
    return down(x)


def or_moving(descent: Descent, end: End, rigid: Estimate, free: bool, down: Callable[[FloatArray], End]) -> End:
    """Return the better of two answers, the motor at rest at the first sample or moving: see `didim`.

    Args:
        descent: where the search ended; its problem is exchanged where the motor moves.
        end: of the search, with the motor at rest.
        rigid: a rough rigid joint, and how the motor moves with it.
        free: whether the state at the first sample is searched for, or kept as the rigid joint has it.
        down: a descent from a start.
    """
    resting = descent.problem
    error = descent.residual(end.x)
    values = resting.values(end.x) | {p.name: rigid[p.name].value or 0.0 for p in INITIAL_STATE}
    state = {p.name: replace(p, start=values[p.name], free=free) for p in INITIAL_STATE}
    descent.problem = replace(resting, parameters=tuple(state.get(p.name, p) for p in resting.parameters))
    start = descent.problem.vector(values)
    moving = replace(down(start), led=end.led)
    gained = float(error @ error) - float(np.sum(descent.residual(moving.x) ** 2))
    if gained > _MOVING * float(error @ error) / error.size:
        return moving
    descent.problem = resting
    return end


def _scales(x: FloatArray) -> FloatArray:
    """Return the size each parameter is searched on; a friction that came out at zero still needs one."""
    sizes = np.abs(x)
    return np.asarray(np.where(sizes > 0, sizes, np.max(sizes) * 1e-6))
