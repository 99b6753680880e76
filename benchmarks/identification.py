"""Whole identifications: the paper's axis from torque alone, from the same random starts, by three kinds of search.

The axis is its digital twin under the loop of the public benchmark, with 8 % of the torque unexplained. Every parameter
starts within a factor of three of the truth, at random. All searches see the same filtered torque error; they stop by
their own rules, as they are used.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import replace

import numpy as np
from scipy.optimize import least_squares

from benchmarks.peers.mujoco_sysid import with_toolbox
from benchmarks.problem import Array
from benchmarks.results import Rigid, Solver, spread
from benchmarks.searching import Search, summed, timed
from benchmarks.startup import HERE, emps
from jointid.config import load
from jointid.diagnostics.identify import identify
from jointid.estimation.descent import least_squares as least_squares_of
from jointid.estimation.methods.didim import DIDIM
from jointid.estimation.problems.base import INITIAL_STATE
from jointid.estimation.problems.closed_loop import ClosedLoopProblem, torque_problem
from jointid.paper.twin import Twin, twin
from jointid.records.signals.filtering import Filtering
from jointid.solvers.nelder_mead import NelderMead
from jointid.solvers.solve import Counted, solve

STARTS = 100
FACTOR = 3.0
"""That a start may be off, either way."""

FILTERING = Filtering(cutoff=60.0)
"""Twice the resonance, as in the paper."""

_PAPER = DIDIM.paper("flexible")
_EVALUATIONS = 60  # of least squares, derivatives by differences not counted; what `refined` allows itself

_TIMES = 3  # that the verb is run: there is no start to vary
_RIGID_TIMES = 21  # that it is for a rigid joint


def problem_of(axis: Twin) -> ClosedLoopProblem:
    """Return the problem: nine parameters free, the motor at rest on its reference at the first sample."""
    assert axis.record.reference is not None
    position, velocity = INITIAL_STATE
    rest = (position.fix(float(axis.record.reference.values[0])), velocity.fix(0.0))
    return torque_problem(axis.record, axis.loop, FILTERING, axis.loop.joint.parameters, rest)


def starts_of(problem: ClosedLoopProblem, truth: dict[str, float], count: int) -> Array:
    """Return the starts, (count, free)."""
    exponents = np.random.default_rng(0).uniform(-1.0, 1.0, (count, len(problem.free)))
    return np.asarray(problem.vector(truth) * FACTOR**exponents)


def exact(problem: ClosedLoopProblem, start: Array) -> tuple[Array, int]:
    """Least squares with exact derivatives; a simulation with them counts as one."""
    end = solve(problem, least_squares_of(problem, DIDIM().stopping_tolerance("flexible")), start)
    return end.x, end.evaluations


def differences(problem: ClosedLoopProblem, start: Array) -> tuple[Array, int]:
    """SciPy's least squares as most use it: the same bounds, scaling and tolerance, derivatives by differences."""
    counted, tolerance, size = Counted(problem), DIDIM().stopping_tolerance("flexible"), problem.size
    unit = np.abs(start)
    lower, upper = (np.array([getattr(p, side) for p in problem.free]) / unit for side in ("lower", "upper"))

    def residual(y: Array) -> Array:
        return counted.residual(y * unit) / size

    end = least_squares(
        residual, start / unit, "2-point", (lower, upper), x_scale="jac",
        xtol=tolerance, ftol=tolerance, gtol=None, max_nfev=_EVALUATIONS,
    )  # fmt: skip
    return np.asarray(end.x * unit), counted.evaluations


def simplex(problem: ClosedLoopProblem, start: Array) -> tuple[Array, int]:
    """Nelder and Mead by the rules of ``fminsearch``, with the paper's settings and its one restart."""
    simplex = NelderMead(_PAPER.stopping_tolerance("flexible"), _PAPER.simulations, _PAPER.restarts, size=problem.size)
    end = solve(problem, simplex, start)
    return end.x, end.evaluations


SEARCHES: dict[str, Search] = {
    "least squares, exact derivatives": exact,
    "least squares, differences": differences,
    "Nelder-Mead": simplex,
}


def identified(starts: int, say: Callable[[str], None]) -> tuple[Solver, ...]:
    """Run every search from every start, in turn; then the verb itself, and MuJoCo's toolbox."""
    axis = twin("L19")
    problem = problem_of(axis)
    found: dict[str, list[tuple[float, int, float]]] = {title: [] for title in SEARCHES}
    random, begun = np.random.default_rng(0), starts_of(problem, axis.truth, starts)
    for search in SEARCHES.values():  # what is compiled once
        search(replace(problem, measured=problem.torque(begun[0])), begun[0])
    for number, start in enumerate(begun):
        for title in random.permutation(list(SEARCHES)):
            found[title].append(timed(SEARCHES[title], problem, start))
        if number % 10 == 9:
            say(f"  {number + 1} of {starts} starts")
    best = min(left for runs in found.values() for _, _, left in runs)
    solvers = tuple(summed(title, runs, best) for title, runs in found.items())
    say("  MuJoCo's toolbox")
    return (*solvers, _verb(axis, best), with_toolbox(axis, problem, begun, best))


def _verb(axis: Twin, best: float) -> Solver:
    """Return what `identify` does without any start: its rough rigid joint, its grid, its verdicts included."""
    runs = []
    for _ in range(_TIMES):
        begin = time.perf_counter()
        estimate = identify(axis.record, axis.loop, filtering=FILTERING, checks=False)
        runs.append((time.perf_counter() - begin, estimate.fit.simulations, estimate.fit.filtered_error))
    return summed("`identify`, which needs no start", runs, best, "with its exploration, intervals and verdicts")


def rigid(times: int = _RIGID_TIMES) -> Rigid | None:
    """Return what `identify` does with the public record as its joint file has it; None where the record is not.

    The first run, which compiles, is not counted.
    """
    if (path := emps()) is None:
        return None
    file = load(HERE.parent / "examples" / "emps" / "joint.toml")
    record = file.record(path)
    assert file.loop is not None
    seconds = []
    for _ in range(times + 1):
        begin = time.perf_counter()
        estimate = identify(
            record, file.loop, file.method, filtering=file.filtering, parameters=file.parameters, checks=False
        )
        seconds.append(time.perf_counter() - begin)
    return Rigid(estimate.fit.measured.size, spread(seconds[1:]), estimate.fit.simulations, estimate.fit.filtered_error)
