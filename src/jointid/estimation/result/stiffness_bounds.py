"""How soft the spring of a joint may be, where a record does not show it.

Low frequencies bound ZZ2^2/K12, and a mode in the band would ring, so the bound is a function of the load's share of
the inertia, which is not known either. For one such share joints from soft to stiff are tried, with inertia, friction
and offset fitted anew, until one is as good as the best but for what the noise allows. The bounds are for a lightly
damped mode (a heavily damped one would look rigid, too) and for friction on the motor's side: friction on the load's,
behind a spring, only lags at reversals, as real friction does without any spring.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from jointid.common.arrays import FloatArray
from jointid.estimation.problems.closed_loop import ClosedLoopProblem
from jointid.estimation.search.flexible_search import crossover
from jointid.models.joints import split_by_mode
from jointid.models.parameters import Parameter, Quantity
from jointid.records.signals.filtering import Filtering
from jointid.solvers.solve import Bounds, solve
from jointid.solvers.trust_region import TrustRegion
from jointid.uncertainty.covariance import robust, white
from jointid.uncertainty.verdict import StiffnessBound

_BAND = 0.15  # of the sampling frequency, in which a bound is looked for: modes above the fitted band show there
_SOFTEST, _STIFFEST = 0.5, 6.0  # modes that are tried, times the crossover of the loop and the fitted band
_STEPS = 10  # between them
_HALVINGS = 3  # of the last step
_SOLVER = TrustRegion(1e-4, evaluations=6, cost_tolerance=1e-5, eager=False)
_QUANTILE = 2.706  # of chi-square with one degree of freedom, at 90 %: one side of it is passed by one in twenty


@dataclass(frozen=True, slots=True, eq=False)
class _AtMode:
    """A flexible problem with its load share and its mode held, lightly damped, its friction on the motor's side.

    Free are the whole inertia, and what is free beside inertias, spring, damper and the load's friction.
    """

    problem: ClosedLoopProblem
    share: float
    mode: float

    @property
    def free(self) -> tuple[Parameter, ...]:
        """The whole inertia, then the others."""
        whole = Parameter("inertia", "ZZ", Quantity.INERTIA, lower=1e-300)
        return whole, *(p for p in self.problem.free if not _is_held(p))

    @property
    def freed(self) -> ClosedLoopProblem:
        """The problem with everything free, so that every derivative is there."""
        return self.problem.all_free()

    def values(self, x: FloatArray) -> dict[str, float]:
        """Return every parameter of the flexible problem."""
        values = {p.name: (p.start or 0.0) if not p.free else 0.0 for p in self.problem.parameters}
        values |= dict(zip((p.name for p in self.free[1:]), map(float, x[1:]), strict=True))
        return values | self._inertial(float(x[0]))

    def _inertial(self, whole: float) -> dict[str, float]:
        """Return what is proportional to the whole inertia."""
        return split_by_mode(whole, self.share, self.mode)

    def residual(self, x: FloatArray) -> FloatArray:
        """Return the residual, (rows,)."""
        problem = self.freed
        return problem.residual(problem.vector(self.values(x)))

    def linearised(self, x: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the residual, (rows,), and its derivatives, (rows, free)."""
        problem = self.freed
        error, J = problem.linearised(problem.vector(self.values(x)))
        if not np.isfinite(np.vdot(J, J)):
            # The derivatives of a diverging loop overflow when they are squared; there is no way down from it.
            return error, np.zeros((error.size, len(self.free)))
        by = {p.name: J[:, i] for i, p in enumerate(problem.free)}
        whole = sum(share * by[name] for name, share in self._inertial(1.0).items())
        return error, np.column_stack([whole, *(by[p.name] for p in self.free[1:])])


def _is_held(p: Parameter) -> bool:
    return p.name.startswith("load_") or p.name in ("motor_inertia", "stiffness", "damping")


@dataclass(frozen=True, slots=True, eq=False)
class _End:
    """Where a fit with a held mode ended."""

    x: FloatArray
    cost: float
    evaluations: int


def _held(held: _AtMode, start: FloatArray) -> _End:
    """Return the best joint with its mode and share held; of an unstable loop, a cost beyond all others."""
    bounds = Bounds.of(held.free)
    inside = np.clip(start, bounds.lower + 1e-6 * np.abs(start), bounds.upper - 1e-6 * np.abs(start))
    end = solve(held, _SOLVER, inside)
    return _End(end.x, float(end.residual @ end.residual), end.evaluations)


def bounded(
    problem: ClosedLoopProblem, rigid: Mapping[str, float], share: float, found: float
) -> tuple[StiffnessBound, int]:
    """Return the softest spring at a load share, and the simulations it took to find.

    The mode that a search found, though refused, is tried beside the others: between two of them it would be missed,
    and a bound above it stated.

    Args:
        problem: of the flexible joint, as it was solved.
        rigid: every parameter of a rigid joint on the same band, and of what surrounds it.
        share: of the load in the inertia.
        found: Hz, free-free, of the mode that was found.
    """
    sample_time, law, cutoff = problem.experiment.sample_time, problem.experiment.law, problem.filtering.cutoff
    assert cutoff is not None
    band = Filtering(cutoff=max(_BAND / sample_time, cutoff)).resolved(sample_time, "flexible")
    wide = replace(problem, filtering=band)
    high = _STIFFEST * cutoff
    low = min(_SOFTEST * crossover(law, rigid["inertia"]), 0.5 * high)
    modes = sorted({*map(float, np.geomspace(low, high, _STEPS)), *([found] if low < found < high else [])})
    stiff = _AtMode(wide, share, high)
    named = {f"motor_{name}": value for name, value in rigid.items()} | dict(rigid)
    ends: dict[float, _End] = {}
    x = np.array([named[p.name] for p in stiff.free])
    for mode in reversed(modes):  # from what is nearly rigid, each from the last
        ends[mode] = _held(_AtMode(wide, share, mode), x)
        x = ends[mode].x if ends[mode].cost < 2 * ends[high].cost else ends[high].x
    limit = min(end.cost for end in ends.values()) + _threshold(stiff, ends[high].x)
    runs = sum(end.evaluations for end in ends.values()) + 2
    softest = next(mode for mode in modes if ends[mode].cost <= limit)
    if softest == low:
        return StiffnessBound(share, None, None), runs
    rejected = modes[modes.index(softest) - 1]
    x = ends[softest].x
    for _ in range(_HALVINGS):
        middle = math.sqrt(rejected * softest)
        end = _held(_AtMode(wide, share, middle), x)
        runs += end.evaluations
        rejected, softest = (rejected, middle) if end.cost <= limit else (middle, softest)
    reduced = share * (1 - share) * rigid["inertia"]
    return StiffnessBound(share, reduced * (2 * math.pi * rejected) ** 2, rejected), runs


def _threshold(stiff: _AtMode, x: FloatArray) -> float:
    """Return how much worse than the best a joint may be: chi-square, times what autocorrelation makes of it.

    The ratio of the compliance's robust deviation to that of a white residual is taken where the spring is stiff.
    """
    error, J = stiff.linearised(x)
    stiffer = _AtMode(stiff.problem, stiff.share, 1.2 * stiff.mode)
    J = np.column_stack([J, stiffer.residual(x) - error])
    ratio = float(robust(J, J, error).std[-1] / white(J, error).std[-1])
    return _QUANTILE * ratio**2 * float(error @ error) / (error.size - x.size)
