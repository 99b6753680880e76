"""How soft a spring may be that a record does not show: the profile of the criterion over modes and load shares.

A joint is written by its whole inertia, the load's share of it, the free-free frequency of its mode and that mode's
damping ratio. The mode is held at one frequency after the other, from what is nearly rigid to below the loop's
crossover, and everything else is fitted anew: inertia, damping, the friction of both sides, offset, first state, and
the share where it is not held, too. What is within the noise of the best is not excluded.

A resonance is narrow, and falls between the frequencies of a grid. But the damping is free, and on a grid point beside
a resonance it grows until that one is seen as a dip in the profile; from there, and from where the search ended, the
mode is let go and found.

A fit takes two or three simulations, for what it may change is nearly linear in the torque. A mode is excluded only
where what its last linearisation promises (`Fit.least`), too, exceeds the noise. It is less than what is reached, so
that a fit that ended early makes a bound softer, never stiffer.

No record distinguishes a mode damped by more than a sixth from a rigid joint: bounds are for modes damped by less.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from jointid.common.arrays import FloatArray
from jointid.common.parameters import ADDED, Bounds, Parameter, Quantity
from jointid.estimation.problems.closed_loop import ClosedLoopProblem
from jointid.estimation.starts.flexible_joint import crossover, frequency_of
from jointid.models.joints import acts_on_whole
from jointid.records.signals.filtering import Filtering
from jointid.solvers.bounded_least_squares import LevenbergMarquardt, damped_step
from jointid.solvers.solve import solve
from jointid.uncertainty.covariance import robust, white
from jointid.uncertainty.verdict import StiffnessBound

SHARES = (0.05, 0.1, 0.2, 0.33, 0.5)
"""Of the load in the inertia, for which a bound is given."""

MOST_DAMPED = 0.15
"""Damping ratio up to which bounds hold."""

_BAND = 0.15  # of the sampling frequency, in which a bound is searched: modes above the fitted band show there
_SOFTEST, _STIFFEST = 0.5, 6.0  # modes that are tried, times the crossover of the loop and the fitted band
_STEPS = 10  # between them
_HALVINGS = 3  # of the last step
_DAMPED, _SHARE = 0.03, 0.33  # of a mode, and of the load, to begin with
_SMALL, _LARGE, _BETWEEN = 0.1, 0.4, 0.25  # shares of the load to begin with beside a dip, whatever it has
_SMALLEST, _LARGEST = 0.03, 0.9  # shares of the load that are tried
_QUANTILE = 2.706  # of chi-square with one degree of freedom, at 90 %: one side of it is passed by one in twenty
_HELD, _FREE, _NEAR = 2, 4, 1  # evaluations of a fit: its mode held, or free, or near where another one ended
_CHANCE = 6.0  # thresholds: what the best of many modes gains on a rigid joint in noise alone
_EDGE = 1e-6  # of the softest mode that is tried
_SEEK = 8  # evaluations of a fit that begins beside a resonance
_ALIKE = 0.04  # of a mode and a share: minima so near are one
_TOLERANCE = 1e-4  # of a fit
_ROUNDING = 1e-9  # damping of a step, in columns of norm 1: what several columns make alike is shared
_SPRING = ("motor_inertia", "load_inertia", "stiffness", "damping")


@dataclass(frozen=True, slots=True, eq=False)
class SpringProblem:
    """A flexible problem by inertia, share, mode and damping ratio, of which share and mode may be held.

    Attributes:
        problem: of the flexible joint, every parameter free.
        names: of what is fitted beside the four: what was free of friction, offset and first state.
        share: of the load in the inertia, held; free where it is None.
        mode: Hz, free-free, held; free where it is None.
        room: the modes a free one stays between, Hz.
    """

    problem: ClosedLoopProblem
    names: tuple[str, ...]
    share: float | None
    mode: float | None
    room: tuple[float, float]

    @property
    def free(self) -> tuple[Parameter, ...]:
        """The whole inertia, the damping ratio, what is free of share and mode, then the others."""
        found = [
            Parameter("inertia", "ZZ", Quantity.INERTIA, lower=1e-300),
            Parameter("ratio", "zeta", Quantity.RATIO, lower=0.0, upper=MOST_DAMPED),
        ]
        if self.share is None:
            found.append(Parameter("share", "s", Quantity.RATIO, lower=_SMALLEST, upper=_LARGEST))
        if self.mode is None:
            found.append(Parameter("mode", "f", Quantity.GAIN, lower=self.room[0], upper=self.room[1]))
        own = {p.name: p for p in self.problem.parameters}
        return (*found, *(own[name] for name in self.names))

    def values_by_name(self, x: FloatArray) -> dict[str, float]:
        """Return inertia, ratio, share, mode and the others by name."""
        held = {"share": self.share, "mode": self.mode}
        known = {name: value for name, value in held.items() if value is not None}
        return known | dict(zip((p.name for p in self.free), map(float, x), strict=True))

    def residual(self, x: FloatArray) -> FloatArray:
        """Return the residual, (rows,)."""
        return self.problem.residual(self.problem.vector(self._values(x)))

    def linearise(self, x: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the residual, (rows,), and its derivatives, (rows, free)."""
        error, J = self.problem.linearise(self.problem.vector(self._values(x)))
        if not np.isfinite(np.vdot(J, J)):
            # The derivatives of a diverging loop overflow when they are squared; there is no way down from it.
            return error, np.zeros((error.size, len(self.free)))
        by = {p.name: J[:, i] for i, p in enumerate(self.problem.free)}
        slopes = spring_slopes(self.values_by_name(x))
        columns = [
            sum(slopes[p.name][name] * by[name] for name in _SPRING) if p.name in slopes else by[p.name]
            for p in self.free
        ]
        return error, np.column_stack(columns)

    def _values(self, x: FloatArray) -> dict[str, float]:
        fixed = {p.name: p.start or 0.0 for p in self.problem.parameters}
        described = self.values_by_name(x)
        return fixed | {name: described[name] for name in self.names} | spring(described)


def spring(described: Mapping[str, float]) -> dict[str, float]:
    """Return both inertias, stiffness and damping of a joint described by inertia, share, mode and ratio."""
    whole, share, ratio = described["inertia"], described["share"], described["ratio"]
    reduced, rate = share * (1 - share) * whole, 2 * math.pi * described["mode"]
    values = ((1 - share) * whole, share * whole, reduced * rate**2, 2 * ratio * reduced * rate)
    return dict(zip(_SPRING, values, strict=True))


def spring_slopes(described: Mapping[str, float]) -> dict[str, dict[str, float]]:
    """Return the derivatives of both inertias, stiffness and damping by inertia, ratio, share and mode."""
    whole, share, mode = described["inertia"], described["share"], described["mode"]
    rate, ratio = 2 * math.pi * mode, described["ratio"]
    reduced, bend = share * (1 - share) * whole, (1 - 2 * share) * whole
    by = {
        "inertia": tuple(spring({**described, "inertia": 1.0}).values()),  # all four are in proportion to it
        "ratio": (0.0, 0.0, 0.0, 2 * reduced * rate),
        "share": (-whole, whole, bend * rate**2, 2 * ratio * bend * rate),
        "mode": (0.0, 0.0, 2 * reduced * rate**2 / mode, 2 * ratio * reduced * rate / mode),
    }
    return {name: dict(zip(_SPRING, slopes, strict=True)) for name, slopes in by.items()}


@dataclass(frozen=True, slots=True, eq=False)
class Fit:
    """The end of a fit.

    Attributes:
        at: inertia, ratio, share, mode and the others by name.
        cost: sum of squares. least: what its last linearisation promises, if that is less.
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
    """The criterion over modes, with everything else fitted anew, on a band that shows modes above the fitted one, too.

    Attributes:
        problem: every parameter free. names: see `SpringProblem`. room: the modes between which it is made, Hz.
        rigid: where all of it begins: a rigid joint, by inertia, ratio, share, mode and the others.
        threshold: how much worse than the best a joint may be; infinite where the stiff joint explains nothing.
        stiff: the joint that is nearly rigid.
        points: with the mode held, the stiffest first.
        minima: with it free, the best first.
        simulations: so far.
    """

    problem: ClosedLoopProblem
    names: tuple[str, ...]
    room: tuple[float, float]
    rigid: dict[str, float]
    threshold: float = 0.0
    stiff: Fit = field(default=Fit({}, math.inf, math.inf))
    points: list[Fit] = field(default_factory=list)
    minima: list[Fit] = field(default_factory=list)
    simulations: int = 0

    def fit(self, start: Mapping[str, float], share: float | None, mode: float | None, evaluations: int) -> Fit:
        """Return the best joint near a start, with its share or its mode held where they are not None."""
        held = SpringProblem(self.problem, self.names, share, mode, self.room)
        bounds = Bounds.of(held.free)
        end = solve(held, LevenbergMarquardt(_TOLERANCE, evaluations), np.array([start[p.name] for p in held.free]))
        self.simulations += end.evaluations
        cost = float(end.residual @ end.residual)
        if not end.jacobian.any():
            return Fit(held.values_by_name(end.x), cost, cost)
        step = damped_step(end.residual, end.jacobian, bounds.shift_to(end.x), _ROUNDING, bounds.upper - bounds.lower)
        promised = end.residual + end.jacobian @ step
        return Fit(held.values_by_name(end.x), cost, min(cost, float(promised @ promised)))


def profile_modes(
    problem: ClosedLoopProblem, rigid: Mapping[str, float], found: Mapping[str, float], *, thorough: bool
) -> ModeProfile:
    """Return the profile over all modes, the load's share free.

    Args:
        problem: of the flexible joint, as it was solved.
        rigid: every parameter of a rigid joint on the same band, and of what surrounds it.
        found: every parameter of the flexible joint that the search ended on.
        thorough: whether a dip is also followed from another share and a small damping, as before a value is given.
    """
    sample_time, law, cutoff = problem.experiment.sample_time, problem.experiment.law, problem.filtering.cutoff
    assert cutoff is not None
    band = Filtering(cutoff=max(_BAND / sample_time, cutoff)).resolve(sample_time, "flexible")
    high = _STIFFEST * cutoff
    low = min(_SOFTEST * crossover(law, rigid["inertia"]), 0.5 * high)
    names = tuple(p.name for p in problem.free if p.name not in _SPRING)
    start = friction_on_motor(problem.parameters, rigid)
    start |= {"inertia": rigid["inertia"], "ratio": _DAMPED, "share": _SHARE, "mode": high}
    wide = replace(problem, filtering=band).all_free()
    made = ModeProfile(wide, names, (low, high), start)
    made.stiff = made.fit(start, _SHARE, high, _HELD)
    made.threshold = _compute_cost_limit(made)
    last = made.stiff
    for mode in np.geomspace(high, low, _STEPS)[1:]:
        last = made.fit({**last.at, "ratio": max(last.at["ratio"], _DAMPED)}, None, float(mode), _HELD)
        made.points.append(last)
        if last.cost > 2 * made.stiff.cost:
            last = made.stiff
    least = [made.stiff.least, *(point.least for point in made.points), math.inf]
    near = made.stiff.least + made.threshold
    dips = [made.points[i - 1] for i in range(1, len(least) - 1) if least[i] < min(least[i - 1], least[i + 1], near)]
    ends = [made.fit(point.at, None, None, _FREE) for point in dips]
    for point in dips if thorough else ():
        beside = {**point.at, "ratio": _DAMPED, "share": _LARGE if point.at["share"] < _BETWEEN else _SMALL}
        ends.append(made.fit(beside, None, None, _SEEK))
    whole = found["motor_inertia"] + found["load_inertia"]
    ratio = min(damping_ratio(found), MOST_DAMPED)
    own = {"inertia": whole, "ratio": ratio, "share": found["load_inertia"] / whole, "mode": frequency_of(found)}
    if low < own["mode"] < high:
        ends.append(made.fit(start | {n: found[n] for n in names} | own, None, None, _FREE))
    for end in sorted(ends, key=lambda end: end.cost):
        same = (abs(end.mode / one.mode - 1) + abs(end.at["share"] / one.at["share"] - 1) for one in made.minima)
        if not any(apart < _ALIKE for apart in same):
            made.minima.append(end)
    return made


def damping_ratio(values: Mapping[str, float]) -> float:
    """Return the damping ratio of a flexible joint's mode; 0 of a joint without a spring."""
    motor, load = values["motor_inertia"], values["load_inertia"]
    size = 2 * math.sqrt(values["stiffness"] * motor * load / (motor + load))
    return values["damping"] / size if size > 0 else 0.0


def friction_on_motor(parameters: Sequence[Parameter], rigid: Mapping[str, float]) -> dict[str, float]:
    """Return values of a flexible joint's parameters from those of a rigid one, all friction on the motor's side.

    A speed or a displacement that a friction depends on is that of both sides.
    """
    values = {}
    for p in parameters:
        of_motor = p.name.startswith("motor_") or p.quantity not in ADDED or acts_on_whole(p.name.removeprefix("load_"))
        whole = p.name.removeprefix("motor_").removeprefix("load_") if of_motor else p.name
        values[p.name] = rigid.get(p.name, rigid.get(whole, 0.0))
    return values


def _compute_cost_limit(made: ModeProfile) -> float:
    """Return the chi-square threshold on the cost, scaled for the autocorrelation of the residual.

    The ratio of the compliance's robust deviation to that of a white residual is taken where the spring is stiff, and
    its friction on the motor's side: there the load's does nothing else. Where that joint explains nothing, as when its
    loop is unstable, there is no such ratio, and nothing is excluded.
    """
    if made.stiff.cost > np.sum(made.problem.filter(made.problem.measured) ** 2):
        return math.inf
    names = tuple(name for name in made.names if not name.startswith("load_"))
    x = np.array([made.stiff.at[name] for name in ("inertia", "ratio", *names)])
    stiff = SpringProblem(made.problem, names, _SHARE, made.room[1], made.room)
    error, J = stiff.linearise(x)
    bent = replace(stiff, mode=made.room[1] / 1.2).residual(x) - error
    made.simulations += 2
    J = np.column_stack([np.delete(J, 1, axis=1), bent])
    ratio = float(robust(J, J, error).std[-1] / white(J, error).std[-1])
    return _QUANTILE * ratio**2 * float(error @ error) / (error.size - x.size)


def bound_stiffness(made: ModeProfile, share: float, floor: float) -> StiffnessBound:
    """Return the softest spring at a load share.

    Args:
        made: the profile over modes, the load's share free: what it excludes is not tried again.
        share: of the load in the inertia.
        floor: Hz, of a mode that is excluded at a smaller share: of a larger one it moves more of the torque.
    """
    limit, own = made.stiff.cost + made.threshold, {}
    if made.minima and made.stiff.cost - made.minima[0].cost > _CHANCE * made.threshold:
        best = own[made.minima[0].mode] = made.fit({**made.minima[0].at, "share": share}, share, None, _FREE)
        limit = min(limit, best.cost + made.threshold)
    softest, rejected = made.stiff, made.room[0]
    for point in sorted((*made.points, *made.minima), key=lambda point: point.mode):
        tried = point
        held = None if point in made.minima else point.mode
        if held and held <= floor:
            rejected = max(rejected, held)
            continue
        if point.least <= limit:  # else it is excluded at any share
            start = {**point.at, "share": share}
            tried = made.fit(start, share, held, _HELD)
        tried = own.get(point.mode, tried)  # it is within its own limit
        if tried.least <= limit:
            softest = tried
            break
        rejected = max(rejected, tried.mode)
    if softest.mode <= rejected * (1 + _EDGE):
        return StiffnessBound(share, None, None)
    for _ in range(_HALVINGS):
        middle = math.sqrt(rejected * softest.mode)
        tried = made.fit(softest.at, share, middle, _NEAR)
        if tried.least <= limit:
            softest = tried
        else:
            rejected = middle
    reduced = share * (1 - share) * made.stiff.at["inertia"]
    return StiffnessBound(share, reduced * (2 * math.pi * rejected) ** 2, rejected)


def bound_all(made: ModeProfile, shares: Sequence[float] = SHARES) -> tuple[StiffnessBound, ...]:
    """Return the softest spring at each of some load shares."""
    found: list[StiffnessBound] = []
    for share in sorted(shares):
        found.append(bound_stiffness(made, share, (found[-1].frequency if found else None) or 0.0))
    return tuple(found)
