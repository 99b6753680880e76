"""Whether a record shows a joint's spring, or else its stiffness bound.

The end of a search always has a stiffness. The conditions for reporting it are listed in
docs/how-it-works.md.

Otherwise the record only bounds the stiffness, for each share of the load in the inertia, which is unknown,
too. A joint is then written by its whole inertia, that share, the free-free frequency of its mode and that mode's
damping ratio. The mode is held at one frequency after the other, and everything else is fitted anew. Fits within the
noise of the best are not excluded. A resonance falls between the frequencies of a grid, but the damping is free, and
near a resonance it grows until that grid point is a dip in the profile: from there, and from the end of the search,
the mode is freed and found. A mode is excluded only if the prediction of its last linearisation (`Fit.least`), too,
exceeds the noise, so that a fit that ended early makes a bound softer, never stiffer. No record distinguishes a mode
damped by more than a sixth from a rigid joint: bounds are for modes damped by less.

A random force in the loop (`force_in_loop`) changes the mean torque through the friction. Where that moves a
parameter of the rigid joint, its intervals are widened, and each bound is the softer one with and without that change.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, NamedTuple

import numpy as np

from jointid.common.arrays import FloatArray
from jointid.common.messages import Message, Progress
from jointid.common.parallel import in_threads
from jointid.common.parameters import Bounds, Parameter, Quantity
from jointid.estimation.descent import descend, with_linear_spring
from jointid.estimation.force_in_loop import simulate_mean, widen_for_force
from jointid.estimation.problems.simulated import ClosedLoopProblem
from jointid.estimation.result.estimate import Estimate, EstimatedParameter
from jointid.estimation.result.verdict import POOR_FIT, Check, Reason, StiffnessBound, Subject, check_of, springs_checks
from jointid.estimation.spring_search import DAMPED, FASTEST, LITTLE, crossover, damping_ratio, divide, frequency_of
from jointid.models.joints import of_whole, split_by_mode
from jointid.records.signals.filtering import Filtering
from jointid.simulation.plant import Numbers
from jointid.solvers.solve import LevenbergMarquardt, Solution, damped_step, solve
from jointid.uncertainty.covariance import INTERVAL, Influence, white
from jointid.uncertainty.identifiability import Identifiability, Known, find_separable, sums_of
from jointid.uncertainty.model_tests import flexible_against_rigid
from jointid.uncertainty.position_dependent_error import Uncertainty, uncertainty
from jointid.uncertainty.profile import Reparametrised

SHARES = (0.05, 0.1, 0.2, 0.33, 0.5)
"""Of the load in the inertia, for which a bound is given."""

MOST_DAMPED = 0.15
"""Damping ratio up to which bounds hold."""

# Times the cut-off, with each share of the load: the best counts, in every draw of the test as in the record. A mode
# rings for 1 / (4 pi damping) periods, so that a coarser grid misses the one that is there; the last is a compliance.
_TEST_MODES = (*(0.3 * 1.08**i for i in range(16)), 2.5)

_SHARE = 0.33  # of the load, to begin with
_HELD, _FREE, _NEAR, _SEEK = 2, 4, 1, 8  # evaluations of a fit: its mode held, free, near an end, beside a resonance
_SPRING = ("motor_inertia", "load_inertia", "stiffness", "damping")


# Whether the spring is shown


@dataclass(frozen=True, slots=True, eq=False)
class Visibility:
    """Whether a record shows a joint's spring, and results if refused.

    Attributes:
        checks: whether its stiffness is reported, or the reasons against it.
        rigid: values of the rigid joint on the same band; std: standard deviations of the determined ones.
        bounds: of the stiffness.
        notes: on the deviations of the rigid joint.
    """

    checks: tuple[Check, ...]
    rigid: Mapping[str, float] = field(default_factory=dict)
    std: Mapping[str, float] = field(default_factory=dict)
    bounds: tuple[StiffnessBound, ...] = ()
    notes: tuple[Message, ...] = ()

    @property
    def shown(self) -> bool:
        """Whether the stiffness is reported."""
        return all(check.passed for check in self.checks)

    def state(self, estimate: Estimate) -> Estimate:
        """Add the verdict to an estimate; a refused spring leaves sums only."""
        joint, rows = estimate.settings.joint, list[EstimatedParameter]()
        if self.shown:
            return replace(estimate, checks=(*estimate.checks, *self.checks))
        parted = ("motor_", "load_", *(p.name for law in joint.springs for p in law.parameters))
        for p in estimate.rows:
            own = p
            if p.free and p.name in self.std:  # of both joints: a spring that is not shown narrows no interval
                own = replace(p, value=self.rigid[p.name], stderr=self.std[p.name])
            elif p.free and (p.name.startswith(parted) or (p.of_joint and p.name in self.rigid)):
                own = replace(p, value=None, stderr=None)
            rows.append(own)
        both = sums_of([p for p in joint.parameters if p.name in estimate.free], {p.name: p.unit for p in rows})
        sums = [Known(s, self.rigid[s.quantity], self.std[s.quantity]) for s in both if s.quantity in self.std]
        said = "only the sums of both sides are determined, not their division"
        undivided = check_of(Subject.IDENTIFIABILITY, False, Reason.ONLY_SUMS, said)
        checks = (*estimate.checks, undivided, *self.checks)
        known, notes = Identifiability(tuple(sums), ()), (*estimate.notes, *map(str, self.notes))
        return replace(estimate, rows=tuple(rows), checks=checks, known=known, bounds=self.bounds, notes=notes)


def visible(
    problem: ClosedLoopProblem,
    x: FloatArray,
    J: FloatArray,
    known: Uncertainty,
    together: tuple[int, int],
    progress: Progress,
    shares: Sequence[float] = SHARES,
) -> Visibility:
    """Test whether a record shows the spring; else bound its stiffness.

    Args:
        problem: of the flexible joint, as it was solved.
        x: its free parameters.
        J: (rows, free) the derivatives of the torque there, filtered.
        known: uncertainty of x.
        together: number of starts that led to the estimate, and of all starts.
        progress: receives the steps.
        shares: of the load in the inertia, for which bounds are searched.
    """
    rigid, at = fit_rigid(problem, problem.values(x))
    (error, slopes), remains = rigid.linearise(at.x), problem.residual(x)
    where = rigid.cells(rigid.simulate(at.x))
    values, found = rigid.values(at.x), problem.values(x)
    linear, made, left = with_linear_spring(problem), None, float(remains @ remains)
    reasons = [*_doubts(problem, x, J, known, (left, float(error @ error)), together)]
    if not reasons:
        # Where every spring on the rigid joint makes the loop unstable, the one that was found is the one to test.
        springs = _springs(linear, values, error) or [(remains - error)[:, np.newaxis]]
        # So far from the rigid joint a linear step towards the spring finds nothing; what the fit itself gained counts.
        fitted = left if left < 0.5 * float(error @ error) else None
        test = flexible_against_rigid(error, slopes, springs, where, fitted)
        if test.code == "flexible" and test.values["gained"] < 0.3:  # it may be another one
            made = profile_modes(linear, values, found, thorough=True)
            std = dict(zip([p.name for p in problem.free], known.covariance.std.tolist(), strict=True))
            reasons = _other_spring(made, found["stiffness"], std.get("stiffness", 0.0))
        if test.code == "flexible" and not reasons:
            return Visibility(springs_checks((), str(test)))
        reasons = reasons or [str(test)]
    bounds = list[StiffnessBound]()
    if left <= (POOR_FIT * problem.size) ** 2:  # else no bound holds, nor a value of the rigid joint
        progress("the record does not show the spring; looking how soft it may be")
        bounds = bound_all(made or profile_modes(linear, values, found), shares)
    judged, moved = widen_for_force(uncertainty(Influence(slopes, error), where), rigid, at.x, -slopes)
    if bounds and moved is not None:
        change = simulate_mean(rigid, *moved) - rigid.torque(moved[0])
        forced = with_linear_spring(problem.with_log(measured=problem.log.measured - change[:, np.newaxis]))
        beside = bound_all(profile_modes(forced, rigid.values(moved[0]), found), shares)
        bounds = [min(pair, key=lambda one: one.stiffness or 0.0) for pair in zip(bounds, beside, strict=True)]
    checks = springs_checks([f"not identifiable from this record: {reasons[0]}", *reasons[1:]])
    told = slopes.any(axis=0) & find_separable(slopes) & (np.linalg.norm(error) <= POOR_FIT * rigid.size)
    stated = zip(rigid.free, judged.covariance.std, told, strict=True)
    std = {p.name: float(one) for p, one, seen in stated if seen}
    return Visibility(checks, values, std, tuple(bounds), judged.warnings)


def fit_rigid(problem: ClosedLoopProblem, values: Mapping[str, float]) -> tuple[ClosedLoopProblem, Solution]:
    """Rigid problem on the same band, and its solution."""
    joint = problem.joint.rigid
    rigid = problem.with_joint(joint, joint.parameters)
    start = {p.name: values[p.name] for p in problem.around}
    start |= {p.name: of_whole(p, values) for p in joint.parameters}
    return rigid, descend(rigid, rigid.vector(start), 1e-8)


def _doubts(
    problem: ClosedLoopProblem,
    x: FloatArray,
    J: FloatArray,
    known: Uncertainty,
    squares: tuple[float, float],
    together: tuple[int, int],
) -> Iterator[str]:
    """Yield reasons to refuse the spring; `squares` are with and without it."""
    # Whatever its inertia, a mass that its friction holds makes the same torque: where the search left it says nothing.
    idle = {p.name for p, column in zip(problem.free, J.T, strict=True) if not column.any()}
    for side in ("motor", "load"):
        if f"{side}_inertia" in idle:
            yield f"with the joint that was found the {side} never moves, so that no torque shows its inertia"
    left, without = squares
    if known.repeatable.significant and without - left < known.repeatable.share * left:
        yield "the spring explains less of what remains than repeats with the motion and no noise explains"
    for p, value, spread in zip(problem.free, x, known.covariance.std, strict=True):
        if p.quantity in (Quantity.INERTIA, Quantity.STIFFNESS) and value <= INTERVAL * spread:
            yield f"the interval of {p.name} contains 0"
    mode = frequency_of(problem.values(x))
    if mode > FASTEST / problem.axis.sample_time:
        yield f"the mode that was found, at {mode:.3g} Hz, is faster than a log of this rate can follow"
    if damping_ratio(problem.values(x)) > 1:
        yield "the mode that was found is damped so much that it does not swing"
    if together[1] > 1 and together[0] < 2:
        yield f"of {together[1]} starts no two led to the same flexible joint"


def _springs(problem: ClosedLoopProblem, rigid: Mapping[str, float], error: FloatArray) -> list[FloatArray]:
    """Effects of springs on the residual, (rows, 1) each, at several modes."""
    cutoff, divided = problem.filtering.cutoff or 0.0, divide(problem.parameters, rigid, 1.0)

    def residual_at(at: tuple[float, float]) -> FloatArray:
        values = divided | split_by_mode(rigid["inertia"], at[0], at[1] * cutoff)
        numbers = Numbers.of_joint(problem.joint, values)
        return problem.error(problem.runs_of(numbers, keep=False))

    tried = in_threads(residual_at, list(itertools.product((0.1, 0.33, 0.6), _TEST_MODES)))
    size = 10 * float(np.linalg.norm(problem.filter(problem.measured)))
    return [(one - error)[:, np.newaxis] for one in tried if np.linalg.norm(one) < size]  # the others are unstable


def _other_spring(made: ModeProfile, stiffness: float, std: float) -> list[str]:
    """Another admissible spring or rigid joint at 95 %, in a sentence."""
    limit = min(made.stiff.cost, *(end.cost for end in made.minima), math.inf) + 1.42 * made.threshold  # of both sides
    if made.stiff.least <= limit:  # also where it cannot be simulated, so that nothing is excluded
        return ["a joint that is nearly rigid explains the torque as well, within 95 %"]
    for end in made.minima:
        other = spring(end.at)["stiffness"]
        if end.least <= limit and abs(other - stiffness) > max(3.0 * std, 0.2 * stiffness):
            own = f"a spring of {other:.3g}, with its mode at {end.mode:.3g} Hz, explains the torque as well as the one"
            return [f"{own} of {stiffness:.3g} that was found, within 95 %"]
    return []


# How soft it may be


def describe(problem: ClosedLoopProblem, room: tuple[float, float], held: Mapping[str, float]) -> Reparametrised:
    """Reparametrise a flexible joint by inertia, damping ratio, load share and mode.

    Args:
        problem: of the flexible joint, inertias and spring free.
        room: bounds of a free mode, Hz.
        held: share, and mode in Hz, free-free, by name; those that are not free.
    """
    four = (
        Parameter("inertia", "ZZ", Quantity.INERTIA, lower=1e-300),
        Parameter("ratio", "zeta", Quantity.RATIO, lower=0.0, upper=MOST_DAMPED),
        Parameter("share", "s", Quantity.RATIO, lower=0.03, upper=0.9),  # shares of the load that are tried
        Parameter("mode", "f", Quantity.GAIN, lower=room[0], upper=room[1]),
    )
    others = [p for p in problem.free if p.name not in _SPRING]
    free = (*(p for p in four if p.name not in held), *others)

    def turn(x: Any) -> Any:
        described = {**held, **_by_name(free, x)}
        return problem.vector(described | spring(described))

    return Reparametrised(problem, free, turn)


def _by_name(free: Sequence[Parameter], x: Any) -> dict[str, Any]:
    return dict(zip((p.name for p in free), x.tolist(), strict=True))


def spring(described: Mapping[str, Any]) -> dict[str, Any]:
    """Inertias, stiffness and damping from inertia, share, mode and ratio."""
    return split_by_mode(*(described[name] for name in ("inertia", "share", "mode", "ratio")))


class Fit(NamedTuple):
    """The end of a fit.

    Attributes:
        at: inertia, ratio, share, mode and the others by name.
        cost: sum of squares. least: predicted by its last linearisation, if less.
    """

    at: Mapping[str, float]
    cost: float
    least: float

    @property
    def mode(self) -> float:
        """Hz, free-free."""
        return self.at["mode"]


@dataclass(slots=True, eq=False)
class ModeProfile:
    """Criterion over modes with everything else refitted, on a wider band.

    Attributes:
        problem: see `describe`. room: the modes between which it is made, Hz.
        threshold: admissible increase of the cost over the best; infinite if the stiff joint explains nothing.
        stiff: the joint that is nearly rigid.
        points: with the mode held, the stiffest first.
        minima: with it free, the best first.
    """

    problem: ClosedLoopProblem
    room: tuple[float, float]
    threshold: float = 0.0
    stiff: Fit = field(default=Fit({}, math.inf, math.inf))
    points: list[Fit] = field(default_factory=list)
    minima: list[Fit] = field(default_factory=list)

    def fit(self, start: Mapping[str, float], evaluations: int, **held: float) -> Fit:
        """Best joint near a start, with its share or mode held."""
        problem = describe(self.problem, self.room, held)
        bounds, x = Bounds.of(problem.free), np.array([start[p.name] for p in problem.free])
        end = solve(problem, LevenbergMarquardt(1e-4, evaluations), x)
        cost = least = float(end.residual @ end.residual)
        if end.jacobian.any():
            room, widths = bounds.shift_to(end.x), bounds.upper - bounds.lower
            step = damped_step(end.residual, end.jacobian, room, 1e-9, widths)  # what columns make alike is shared
            promised = end.residual + end.jacobian @ step
            least = min(cost, float(promised @ promised))
        return Fit({**held, **_by_name(problem.free, end.x)}, cost, least)


def profile_modes(
    problem: ClosedLoopProblem,
    rigid: Mapping[str, float],
    found: Mapping[str, float],
    *,
    thorough: bool = False,
) -> ModeProfile:
    """Profile over all modes, with free load share.

    Args:
        problem: of the flexible joint, as it was solved.
        rigid: every parameter of a rigid joint on the same band, and of its surroundings.
        found: every parameter of the flexible joint that the search ended on.
        thorough: whether a dip is also followed from another share and a small damping, as before a value is given.
    """
    sample_time, law, cutoff = problem.axis.sample_time, problem.axis.law, problem.filtering.cutoff
    assert cutoff is not None
    # Modes above the fitted band show on a wider one.
    band = Filtering(cutoff=max(0.15 / sample_time, cutoff)).resolve(sample_time, "flexible")
    low, high = min(0.5 * crossover(law, rigid["inertia"]), 3.0 * cutoff), 6.0 * cutoff
    start = divide(problem.parameters, rigid, 1.0)
    start |= {"inertia": rigid["inertia"], "ratio": DAMPED, "share": _SHARE, "mode": high}
    free = {p.name: replace(p, free=True) for p in problem.parameters if p.name in _SPRING}
    made = ModeProfile(problem.with_log(filtering=band).replace_parameters(free), (low, high))
    made.stiff = last = made.fit(start, _HELD, share=_SHARE, mode=high)
    whole = found["motor_inertia"] + found["load_inertia"]
    if made.stiff.cost > (LITTLE * made.problem.size) ** 2:  # there may be a mode far inside the bandwidth
        made.room = min(0.15 * crossover(law, max(rigid["inertia"], whole)), low), high
    made.threshold = _compute_cost_limit(made)
    for mode in np.geomspace(high, made.room[0], 10)[1:]:
        last = made.fit({**last.at, "ratio": max(last.at["ratio"], DAMPED)}, _HELD, mode=float(mode))
        made.points.append(last)
        if last.cost > 2 * made.stiff.cost:
            last = made.stiff
    least = [made.stiff.least, *(point.least for point in made.points), math.inf]
    near = made.stiff.least + made.threshold
    dips = [made.points[i - 1] for i in range(1, len(least) - 1) if least[i] < min(least[i - 1], least[i + 1], near)]
    ends = [made.fit(point.at, _FREE) for point in dips]
    for point in dips if thorough else ():
        ends.append(made.fit({**point.at, "ratio": DAMPED, "share": 0.4 if point.at["share"] < 0.25 else 0.1}, _SEEK))
    ratio = min(damping_ratio(found), MOST_DAMPED)
    own = {"inertia": whole, "ratio": ratio, "share": found["load_inertia"] / whole, "mode": frequency_of(found)}
    if made.room[0] < own["mode"] < high:
        ends.append(made.fit({**start, **found, **own}, _FREE))
    for end in sorted(ends, key=lambda end: end.cost):
        same = (abs(end.mode / one.mode - 1) + abs(end.at["share"] / one.at["share"] - 1) for one in made.minima)
        if not any(apart < 0.04 for apart in same):  # of a mode and a share: minima so near are one
            made.minima.append(end)
    return made


def _compute_cost_limit(made: ModeProfile) -> float:
    """Chi-square threshold on the cost, scaled for the residual's autocorrelation.

    It is the 90 % quantile for one degree of freedom: one in twenty passes it on one side.

    The ratio of the compliance's robust deviation to that of a white residual is taken with a stiff spring and the
    friction on the motor's side, where the load's friction has no further effect. If that joint explains nothing, as
    when its loop is unstable, or never moves, there is no such ratio, and nothing is excluded.
    """
    problem, high = made.problem, made.room[1]
    idle = [p for p in problem.free if p.name.startswith("load_") and p.name not in _SPRING]
    problem = problem.keeping({p.name: p.start or 0.0 for p in idle})
    stiff, softer = (describe(problem, made.room, {"share": _SHARE, "mode": mode}) for mode in (high, high / 1.2))
    x = np.array([made.stiff.at[p.name] for p in stiff.free])
    error, J = stiff.linearise(x)
    bent = problem.residual(softer.turn(x)) - error
    if not bent.any() or made.stiff.cost > np.sum(made.problem.filter(made.problem.measured) ** 2):
        return math.inf
    J = np.column_stack([np.delete(J, 1, axis=1), bent])
    ratio = float(Influence(J, error).robust().std[-1] / white(J, error).std[-1])
    return 2.706 * ratio**2 * float(error @ error) / (error.size - x.size)


def bound_stiffness(made: ModeProfile, share: float, floor: float) -> StiffnessBound:
    """Softest admissible spring at a load share.

    Args:
        made: the profile over modes, the load's share free; modes that it excludes are not tried again.
        share: of the load in the inertia.
        floor: Hz, of a mode that is excluded at a smaller share: of a larger one it moves more of the torque.
    """
    limit, own = made.stiff.cost + made.threshold, dict[float, Fit]()
    if made.minima and made.stiff.cost - made.minima[0].cost > 6.0 * made.threshold:  # beyond chance
        best = own[made.minima[0].mode] = made.fit({**made.minima[0].at, "share": share}, _FREE, share=share)
        limit = min(limit, best.cost + made.threshold)
    softest, rejected = made.stiff, made.room[0]
    for point in sorted((*made.points, *made.minima), key=lambda point: point.mode):
        tried, held = own.get(point.mode, point), {} if point in made.minima else {"mode": point.mode}
        excluded = bool(held) and point.mode <= floor
        if tried is point and point.least <= limit and not excluded:  # else it is excluded at any share
            tried = made.fit({**point.at, "share": share}, _HELD, share=share, **held)
        if tried.least <= limit and not excluded:
            softest = tried
            break
        rejected = max(rejected, tried.mode)
    if softest.mode <= rejected * (1 + 1e-6):  # of the softest mode that is tried
        return StiffnessBound(share, None, None)
    for _ in range(3):
        middle = math.sqrt(rejected * softest.mode)
        tried = made.fit(softest.at, _NEAR, share=share, mode=middle)
        if tried.least <= limit:
            softest = tried
        else:
            rejected = middle
    reduced = share * (1 - share) * made.stiff.at["inertia"]
    return StiffnessBound(share, reduced * (2 * math.pi * rejected) ** 2, rejected)


def bound_all(made: ModeProfile, shares: Sequence[float] = SHARES) -> list[StiffnessBound]:
    """Return the softest spring at each of some load shares."""
    found = list[StiffnessBound]()
    for share in sorted(shares):
        found.append(bound_stiffness(made, share, (found[-1].frequency if found else None) or 0.0))
    return found
