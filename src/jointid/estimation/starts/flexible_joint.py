"""Starts for a flexible joint: a grid of stiffnesses and load shares, judged by one simulation each.

What a drive is known by before anything is identified is its loop: it crosses over where the torque it asks for a
deviation is the torque the inertia needs to follow. A mode of the joint that mattered to whoever tuned the loop lies
not far from there, whatever the joint's size and the rate of the log. So the grid of free-free frequencies is measured
by the crossover frequency. Half of it is an unstable loop, and the rest has local minima.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Mapping, Sequence
from operator import attrgetter
from typing import NamedTuple

import numpy as np

from jointid.common.errors import MethodError
from jointid.common.parallel import in_threads
from jointid.common.parameters import ADDED, Parameter, Quantity
from jointid.common.transmission import SIDES
from jointid.estimation.descent import History
from jointid.estimation.problems.base import INITIAL
from jointid.estimation.problems.closed_loop import ClosedLoopProblem
from jointid.models.controllers import SampledLaw
from jointid.models.joints import FlexibleJoint, acts_on_whole, split_by_mode

FASTEST = 0.22  # of the sampling frequency: a mode faster than about a fifth is not followed by the log

_LOWEST, _HIGHEST = 0.5, 12.0  # times the crossover: the modes that are searched
_RATIO = 1.25  # of neighbouring frequencies of the grid
_HALF, _SHARES = 0.5, (0.25, 0.75)  # of the load in the inertia: first the halves of (13), then at the best frequencies
_NARROWED = 3  # frequencies at which other shares are tried
_FAR_BELOW, _FAR_ABOVE, _WIDE_COUNT = 0.2, 4.0, 10  # times the crossover: the modes of the wide grid
_INERTIAS = (0.4, 0.7, 1.0, 1.5, 2.5, 5.0, 10.0, 20.0)  # of that grid, times the rigid joint's
_WIDE_SHARES = (0.15, 0.5, 0.85)  # of the load in them


_cost = attrgetter("cost")


class Candidate(NamedTuple):
    """A start: its cost, infinite where the loop is as good as unstable; its free-free frequency, Hz; its values."""

    cost: float
    frequency: float
    values: dict[str, float]


def crossover(law: SampledLaw, inertia: float) -> float:
    """Return the frequency in Hz up to which the law asks for more torque per position than the inertia takes."""
    hertz = np.geomspace(1e-5, 0.5, 400) / law.period
    loop_gain = np.abs(law.feedback(hertz)) / (abs(inertia) * (2 * math.pi * hertz) ** 2)
    above = np.flatnonzero(loop_gain >= 1.0)
    return float(hertz[above[-1]] if above.size else hertz[0])


def frequencies_to_try(law: SampledLaw, inertia: float, sample_time: float) -> list[float]:
    """Return free-free frequencies in Hz, from below the crossover to where a log cannot follow, slow ones first."""
    middle = crossover(law, inertia)
    low, high = _LOWEST * middle, min(_HIGHEST * middle, FASTEST / sample_time)
    count = max(math.ceil(math.log(max(high / low, 1.0)) / math.log(_RATIO)) + 1, 2)
    return [float(f) for f in np.geomspace(min(low, high), high, count)]


def explore(
    problem: ClosedLoopProblem, history: History, rigid: Mapping[str, float], frequency: float | None
) -> list[Candidate]:
    """Judge a row of frequencies; return the candidates, best first.

    Args:
        problem: of the flexible joint, on a wide band.
        history: of the search.
        rigid: values of a rigid joint.
        frequency: the only one to try, Hz.

    Raises:
        MethodError: no start can be simulated.
    """
    law, sample_time = problem.axis.law, problem.axis.sample_time
    row = [frequency] if frequency else frequencies_to_try(law, rigid["inertia"], sample_time)
    grid = _judge(problem, [(f, start_with_mode(problem, rigid, f, _HALF)) for f in row], history)
    best = [one.frequency for one in sorted(grid, key=_cost)[:_NARROWED]]
    grid += _judge(problem, [(f, start_with_mode(problem, rigid, f, s)) for f in best for s in _SHARES], history)
    if not frequency:  # at frequencies apart: a start beside another leads nowhere new
        grid = [min((one for one in grid if one.frequency == f), key=_cost) for f in row]
    found = _stable(grid)
    history.progress(f"searching from a mode near {found[0].frequency:.3g} Hz, the best of {len(row)} that were tried")
    given = {p.name: p.start for p in problem.free if p.start is not None and p.name not in INITIAL}
    if given:  # starts that come with the parameters are tried first, and are no reason to try no others
        own = _inside(problem, found[0].values | given)
        found = [Candidate(0.0, frequency_of(own), own), *found]
    return found


def explore_widely(problem: ClosedLoopProblem, history: History, rigid: Mapping[str, float]) -> list[Candidate]:
    """Judge a grid that trusts neither the rigid joint's inertia nor the loop's bandwidth; return it, best first.

    A mode inside the bandwidth makes the rigid joint another than the sum of both sides: so the inertia is tried, too,
    with loads from small to nearly all of it, and modes from far below the crossover.

    Raises:
        MethodError: no start can be simulated.
    """
    middle, fastest = crossover(problem.axis.law, rigid["inertia"]), FASTEST / problem.axis.sample_time
    row = np.geomspace(_FAR_BELOW * middle, min(_FAR_ABOVE * middle, fastest), _WIDE_COUNT)
    grid = [
        (frequency, start_with_mode(problem, {**rigid, "inertia": times * rigid["inertia"]}, frequency, share))
        for times, share, frequency in itertools.product(_INERTIAS, _WIDE_SHARES, map(float, row))
    ]
    history.progress(f"trying {len(grid)} flexible joints of other inertias")
    return _stable(_judge(problem, grid, history))


def _stable(candidates: Sequence[Candidate]) -> list[Candidate]:
    """Return the candidates that could be simulated, best first.

    Raises:
        MethodError: there is none.
    """
    found = sorted((one for one in candidates if one.cost < math.inf), key=_cost)
    if not found:
        raise MethodError(
            "No start could be simulated: every flexible joint tried makes this loop unstable; check the controller's "
            "gains, its delay and the unit of the torque."
        )
    return found


def start_with_mode(
    problem: ClosedLoopProblem, rigid: Mapping[str, float], frequency: float, share: float
) -> dict[str, float]:
    """Return the start (13) for the free parameters, within their bounds, with the fixed ones as they are."""
    fixed = {p.name: p.start or 0.0 for p in problem.parameters if not p.free or p.name in INITIAL}
    divided = divide(problem.parameters, rigid, _HALF) | split_by_mode(rigid["inertia"], share, frequency)
    return _inside(problem, divided | fixed)


def divide(parameters: Sequence[Parameter], rigid: Mapping[str, float], on_motor: float) -> dict[str, float]:
    """Return values of a flexible joint's parameters from those of a rigid one, frictions divided between the sides.

    A speed or a displacement that a friction depends on is that of both sides.

    Args:
        parameters: of the flexible joint, and of what surrounds it.
        rigid: values by name.
        on_motor: share of what both sides have together that is the motor's.
    """
    values = {}
    for p in parameters:
        side, _, name = p.name.partition("_")
        share = on_motor if side == "motor" else 1.0 - on_motor
        if p.name in rigid or side not in SIDES or name not in rigid:
            values[p.name] = rigid.get(p.name, p.start or 0.0)
        else:
            values[p.name] = rigid[name] * (share if p.quantity in ADDED and not acts_on_whole(name) else 1.0)
    return values


def frequency_of(values: Mapping[str, float]) -> float:
    """Return the free-free frequency of a joint's values, Hz."""
    return FlexibleJoint.frequencies(values)["free_free"]


def _inside(problem: ClosedLoopProblem, values: Mapping[str, float]) -> dict[str, float]:
    """Return the values a little inside their bounds, by a thousandth of their size or of what would be one."""
    found = dict(values)
    force = float(np.std(problem.measured))
    rate = 2 * math.pi * frequency_of(values)
    inertia = values["motor_inertia"] + values["load_inertia"]
    typical = {Quantity.FORCE: force, Quantity.VISCOUS: inertia * rate, Quantity.STIFFNESS: inertia * rate**2}
    for p in problem.free:
        inside = 1e-3 * (abs(values[p.name]) or typical.get(p.quantity, inertia))
        low = p.lower + inside if math.isfinite(p.lower) else p.lower
        found[p.name] = min(max(values[p.name], low), max(p.upper - inside, p.lower))
    return found


def _judge(
    problem: ClosedLoopProblem, starts: Sequence[tuple[float, dict[str, float]]], history: History
) -> list[Candidate]:
    """Simulate starts, free-free frequency and values, in threads, and return them with their costs."""
    most = 10 * problem.size

    def judge(start: tuple[float, dict[str, float]]) -> Candidate:
        cost = float(np.linalg.norm(problem.residual(problem.vector(start[1]))))
        return Candidate(cost if cost < most else math.inf, *start)

    history.tally.evaluations += len(starts)
    return in_threads(judge, starts)
