"""The search for a flexible joint: a rough rigid joint, a grid of starts, and down to an end that several lead to.

What a drive is known by before anything is identified is its loop: it crosses over where the torque it asks for a
deviation is the torque the inertia needs to follow. A mode of the joint that mattered to whoever tuned the loop lies
not far from there, whatever the joint's size and the rate of the log. So everything is measured by the crossover
frequency: the cut-off of the rigid identification, and the grid of free-free frequencies that is tried.

Half of the grid is an unstable loop, and the rest has local minima: each grid point is simulated once, on a band as
wide as the log. Least squares refines the best few, at frequencies apart, until two end together, and goes on from
there. How much of the Coulomb friction is the motor's decides which side stands still first at every reversal, so the
criterion has valleys along it, and several starts find the same wrong one: it is looked along once, with all else as it
was found, and where another division explains more the way goes down from there. Nelder-Mead begins as the paper does,
by halves (13) at a known frequency. Where no second start leads to an end, it is begun again beside itself; and a motor
that moves at the first sample is a search of its own.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from jointid.common.arrays import FloatArray
from jointid.common.errors import MethodError
from jointid.common.messages import Progress, Work
from jointid.common.parameters import Quantity
from jointid.estimation.methods.didim import DIDIM
from jointid.estimation.methods.inverted_starts import inverted_starts
from jointid.estimation.methods.registry import Task
from jointid.estimation.methods.search import History, Solved, begins_moving, crossover, least_squares, regular_start
from jointid.estimation.problems.base import INITIAL, INITIAL_STATE
from jointid.estimation.problems.closed_loop import ClosedLoopProblem, torque_problem
from jointid.estimation.result.assemble import FitResult
from jointid.models.controllers import SampledLaw
from jointid.models.joints import ClosedLoop, FlexibleJoint, acts_on_whole
from jointid.records.record import Record
from jointid.records.signals.filtering import Filtering
from jointid.simulation.closed_loop import in_threads
from jointid.solvers.solve import Counted, Solution, Solver, solve

RIGID_CUTOFF = 0.005  # of the sampling frequency: the paper's 5 Hz at 1 kHz
FASTEST = 0.22  # of the sampling frequency: a mode faster than about a fifth is not followed by the log
WIDE = 0.4  # of the sampling frequency: the widest band whose edge a filter can still make

_SWINGS = 30.0  # periods of the rigid start's cut-off in a record: in fewer there is too little to tell a joint from
_RIGID_BELOW = 0.28  # of the crossover frequency; both are the paper's for its axis
_LOWEST, _HIGHEST = 0.5, 12.0  # times the crossover: the modes that are looked for
_LOWER = (4.0, 4.0)  # times lower cut-offs are tried where a rigid joint cannot be identified
_RATIO = 1.25  # of neighbouring frequencies of the grid
_HALF, _SHARES = 0.5, (0.25, 0.75)  # of the load in the inertia: first the halves of (13), then at the best frequencies
_FAR_BELOW, _FAR_ABOVE = 0.2, 4.0  # times the crossover: the modes of the wide grid
_INERTIAS = (0.4, 0.7, 1.0, 1.5, 2.5)  # of that grid, times the rigid joint's
_WIDE_SHARES = (0.15, 0.5, 0.85)  # of the load in them
_NARROWED = 3  # frequencies at which other shares are tried
_ROUGH = DIDIM("residual", tolerance=1e-3, step_tolerance=1e-2, iterations=6)  # a start needs no more
_DAMPING = 0.02  # of a flexible mode, to begin with (ours: the paper gives none)

_REFINED = 6  # starts that are refined at most, until two of them end together
_ROUGHLY, _FEW = 1e-5, 30  # tolerance and evaluations of a refinement that only has to show where it leads
_BESIDE = 3  # times an end that no second start led to is begun again beside itself
# Ends closer than this in frequency, and in what remains, are one: along a flat valley a descent ends no nearer to the
# bottom, and what several ends are good for is to show that no other valley is deeper.
_TOGETHER, _AS_GOOD = 1e-2, 3e-3
_BETTER = 1e-3  # of what remains: so much less is further down
_DIVISIONS = tuple(np.linspace(0.05, 0.95, 13))  # of the Coulomb friction, the motor's part: valleys are a tenth wide
_REST = 1e-4  # of the torque: what remains of a record without noise, and is not compared
_MODES = 2.0  # the cut-off is that many free-free frequencies, or more


def rigid_estimate(record: Record, loop: ClosedLoop, cutoff: float | None, progress: Progress) -> FitResult:
    """Return a rough identification of a flexible joint as rigid, below its resonance.

    Args:
        record: as for the flexible joint.
        loop: of the flexible joint.
        cutoff: Hz; where None, 0.5 % of the sampling frequency, or less for a loop that is slow for its log.
        progress: is told.
    """
    assert isinstance(loop.joint, FlexibleJoint)
    record.require(loop.channels, "DIDIM")
    assert record.torque is not None
    sample_time = record.torque.sample_time
    joint = loop.joint.rigid
    rigid = ClosedLoop(joint, loop.controller)

    def identified(edge: float) -> FitResult:
        progress(f"identifying the joint as rigid, below {edge:.3g} Hz")
        return _ROUGH.identify(Task(record, joint, rigid, joint.parameters, Filtering(cutoff=edge), progress))

    least = _SWINGS / (record.torque.values.size * sample_time)
    edge = cutoff or max(RIGID_CUTOFF / sample_time, least)
    found = None
    for lower in () if cutoff else _LOWER:  # a mode below the cut-off may make the joint look like none at all
        try:
            found = identified(edge)
            break
        except MethodError as error:
            progress(f"not below {edge:.3g} Hz: {error}")
            edge /= lower
    found = found or identified(edge)
    law = loop.controller.law(sample_time)
    slow = max(_RIGID_BELOW * crossover(law, found.values["inertia"]), least)
    if cutoff is None and slow < 0.7 * edge:
        return replace(identified(slow), earlier=found.simulations)
    return found


def following_joint(record: Record, loop: ClosedLoop) -> dict[str, float]:
    """Return the rigid joint that the torque would tell if the motor moved as the reference asks, its friction 0.

    Where noise moves the axis as much as its reference does, what the controller must have seen tells no joint at all.
    """
    assert isinstance(loop.joint, FlexibleJoint) and record.torque is not None
    joint = loop.joint.rigid
    filtering = Filtering(cutoff=RIGID_CUTOFF / record.torque.sample_time)
    rigid = torque_problem(record, ClosedLoop(joint, loop.controller), filtering, joint.parameters)
    return regular_start(rigid).values


def frequencies_to_try(law: SampledLaw, inertia: float, sample_time: float) -> list[float]:
    """Return free-free frequencies in Hz, from below the crossover to where a log cannot follow, slow ones first."""
    middle = crossover(law, inertia)
    low, high = _LOWEST * middle, min(_HIGHEST * middle, FASTEST / sample_time)
    count = max(math.ceil(math.log(max(high / low, 1.0)) / math.log(_RATIO)) + 1, 2)
    return [float(f) for f in np.geomspace(min(low, high), high, count)]


def explored(
    problem: ClosedLoopProblem,
    rigid: Mapping[str, float],
    frequencies: Sequence[float],
    others: Sequence[dict[str, float]],
    progress: Progress,
) -> tuple[list[tuple[float, dict[str, float]]], int]:
    """Return starts as (free-free frequency, values), best first, and the simulations it took.

    Args:
        problem: of the flexible joint, on a wide band.
        rigid: values of a rigid estimate; not read without frequencies.
        frequencies: to try, Hz.
        others: starts beside those, every parameter by name.
        progress: is told.

    Raises:
        MethodError: no start can be simulated.
    """
    grid = [(f, _HALF) for f in frequencies]
    count = len(grid) + min(len(grid), _NARROWED) * len(_SHARES) + len(others)
    work = Work(progress, "trying flexible joints", count, "joints")

    def tried(points: list[tuple[float, float]]) -> dict[tuple[float, float], float]:
        return dict(zip(points, _costs(problem, [started(problem, rigid, *at) for at in points], work), strict=True))

    costs = tried(grid)
    best = sorted(grid, key=lambda at: costs[at])[:_NARROWED]
    costs |= tried([(f, share) for f, _ in best for share in _SHARES])
    beside = [_inside(problem, values) for values in others]
    found = [
        (cost, frequency_of(start), start) for cost, start in zip(_costs(problem, beside, work), beside, strict=True)
    ]
    if not min([*costs.values(), *(cost for cost, *_ in found)], default=math.inf) < math.inf:
        raise MethodError(
            "No start could be simulated: every flexible joint tried makes this loop unstable; check the controller's "
            "gains, its delay and the unit of the torque."
        )
    # At frequencies apart, or where only one is tried at load shares apart: a start beside another leads nowhere new.
    apart = [min((at for at in costs if at[0] == f), key=lambda at: costs[at]) for f in frequencies]
    points = [(costs[at], at[0], started(problem, rigid, *at)) for at in (apart if len(frequencies) > 1 else costs)]
    ways = [sorted(way, key=lambda one: one[0]) for way in (points, found)]
    ways.sort(key=lambda way: way[0][0] if way else math.inf)
    # Of both ways in turn: where one of them is misled the other is not.
    turns = [one for pair in itertools.zip_longest(*ways) for one in pair if one is not None]
    progress(f"tried {count} flexible joints; the best has its mode near {turns[0][1]:.3g} Hz")
    starts = [(frequency, start) for cost, frequency, start in turns if cost < math.inf]
    given = {p.name: p.start for p in problem.free if p.start is not None and p.name not in INITIAL}
    if not given:
        return starts, count
    # Starts that come with the parameters are tried first, and are no reason to try no others.
    own = _inside(problem, starts[0][1] | given)
    usable = min(_cost(problem, own), math.inf) < math.inf
    return [(frequency_of(own), own)] * usable + starts, count + 1


def started(problem: ClosedLoopProblem, rigid: Mapping[str, float], frequency: float, share: float) -> dict[str, float]:
    """Return the start (13) for the free parameters, within their bounds, with the fixed ones as they are."""
    fixed = {p.name: p.start or 0.0 for p in problem.parameters if not p.free}
    state = {p.name: p.start or 0.0 for p in problem.parameters if p.name in INITIAL}
    nothing = {p.name: p.start or 0.0 for p in problem.parameters}
    return _inside(problem, nothing | pseudo_regular(rigid, frequency, share) | state | fixed)


def pseudo_regular(rigid: Mapping[str, float], frequency: float, share: float = 0.5) -> dict[str, float]:
    """Return the start (13): the rigid values divided between the sides, the spring from the frequency.

    Args:
        rigid: values of a rigid estimate of the joint.
        frequency: free-free, Hz.
        share: of the load in the inertia; the frictions are halved.
    """
    start = {}
    for name, value in rigid.items():
        if acts_on_whole(name):
            start[name] = value
        else:
            start |= {f"{side}_{name}": 0.5 * value for side in ("motor", "load")}
    whole = rigid["inertia"]
    start |= {"motor_inertia": (1 - share) * whole, "load_inertia": share * whole}
    reduced, rate = share * (1 - share) * whole, 2 * math.pi * frequency
    return start | {"stiffness": reduced * rate**2, "damping": 2 * _DAMPING * reduced * rate}


def frequency_of(values: Mapping[str, float]) -> float:
    """Return the free-free frequency of a joint's values, Hz."""
    return FlexibleJoint.frequencies(values)["free_free"]


def _inside(problem: ClosedLoopProblem, values: dict[str, float]) -> dict[str, float]:
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


def _cost(problem: ClosedLoopProblem, values: Mapping[str, float]) -> float:
    """Return the norm of the error; infinite where the loop is as good as unstable."""
    cost = float(np.linalg.norm(problem.residual(problem.vector(values))))
    return cost if cost < 10 * np.linalg.norm(problem.filtered(problem.measured)) else math.inf


def _costs(problem: ClosedLoopProblem, starts: Sequence[Mapping[str, float]], work: Work) -> list[float]:
    def cost(start: Mapping[str, float]) -> float:
        found = _cost(problem, start)
        work.add()
        return found

    return in_threads(cost, starts)


def by_least_squares(
    problem: ClosedLoopProblem,
    filtering: Filtering,
    rigid: Mapping[str, float] | None,
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
        rigid: values of a rough rigid joint; None where the record shows none.
        frequency: free-free, Hz; a grid is tried when None.
        tolerance: of the parameters and the criterion.
        history: of the search.
    """
    wide = _on_band_of(problem, filtering, math.inf)
    return _from_starts(problem, filtering, _explored(wide, rigid, frequency, history), tolerance, history)


def from_wide_grid(
    problem: ClosedLoopProblem, filtering: Filtering, rigid: Mapping[str, float], tolerance: float, history: History
) -> Solved:
    """Return where the search ends from a grid that trusts neither the rigid joint's inertia nor the loop's bandwidth.

    A mode inside the bandwidth makes the rigid joint another than the sum of both sides: so the inertia is tried, too,
    with loads from small to nearly all of it, and modes from far below the crossover.

    Raises:
        MethodError: no start can be simulated.
    """
    wide = _on_band_of(problem, filtering, math.inf)
    middle = crossover(wide.experiment.law, rigid["inertia"])
    frequencies = np.geomspace(_FAR_BELOW * middle, min(_FAR_ABOVE * middle, FASTEST / wide.experiment.sample_time), 10)
    grid = list(itertools.product(_INERTIAS, _WIDE_SHARES, map(float, frequencies)))
    starts = [
        started(wide, {**rigid, "inertia": times * rigid["inertia"]}, frequency, share)
        for times, share, frequency in grid
    ]
    history.progress(f"trying {len(grid)} flexible joints of other inertias")
    costs = _costs(wide, starts, Work(history.progress, "trying flexible joints", len(grid), "joints"))
    history.tally.evaluations += len(grid)
    best = [i for i in np.argsort(costs, kind="stable") if costs[i] < math.inf][:_REFINED]
    if not best:
        raise MethodError("No start could be simulated: every flexible joint tried makes this loop unstable.")
    return _from_starts(problem, filtering, [(grid[i][2], starts[i]) for i in best], tolerance, history)


def _on_band_of(problem: ClosedLoopProblem, filtering: Filtering, mode: float) -> ClosedLoopProblem:
    """Return the problem on the cut-off that is asked for, or on one for a mode at that frequency."""
    return problem if filtering.cutoff else on_band(problem, filtering, mode)


def _from_starts(
    problem: ClosedLoopProblem,
    filtering: Filtering,
    starts: Sequence[tuple[float, dict[str, float]]],
    tolerance: float,
    history: History,
) -> Solved:
    """Refine starts, (free-free frequency, values), until two end together, and go down from there."""
    wide = _on_band_of(problem, filtering, math.inf)
    rough = replace(least_squares(problem, _ROUGHLY), evaluations=_FEW)
    ends: list[tuple[float, float, FloatArray]] = []
    for start, values in starts[:_REFINED]:
        on = _on_band_of(problem, filtering, start)
        x = history.solve(on, rough, on.vector(values)).solution.x
        history.tally.evaluations += 1
        ends.append((float(np.linalg.norm(wide.residual(x))), frequency_of(problem.values(x)), x))
        cost, mode, _ = min(ends, key=lambda end: end[0])
        as_good = (1 + _AS_GOOD) * cost + _REST * wide.size
        together = sum(abs(f / mode - 1) < _TOGETHER and c < as_good for c, f, _ in ends)
        if together > 1:
            break
    _, mode, x = min(ends, key=lambda end: end[0])
    on, tried = _on_band_of(problem, filtering, mode), len(ends)
    divided = divided_otherwise(on, x, history) if together > 1 else None
    if divided is not None:
        x, together = divided, 1
    solver = least_squares(on, tolerance)
    found = history.solve(on, rough if together < 2 else solver, x)
    # An end that no second start leads to is refused, as is a mode too fast for the log: neither is worth another step.
    reach = FASTEST / on.experiment.sample_time
    for _ in range(_BESIDE if together < 2 and frequency_of(on.values(found.solution.x)) <= reach else 0):
        beside, tried = _from_beside(found, history), tried + 1
        left, other = (float(np.linalg.norm(end.residual)) for end in (found.solution, beside))
        if other < (1 - _BETTER) * left - _REST * on.size:  # the way back led further down
            found = history.solve(on, rough, beside.x)
            continue
        modes = [frequency_of(on.values(end.x)) for end in (found.solution, beside)]
        back = abs(modes[1] / modes[0] - 1) < _TOGETHER
        if back and other < (1 + _AS_GOOD) * left + _REST * on.size:
            found, together = history.solve(on, solver, found.solution.x), 2
        break
    message = f"{found.solution.message}; {together} of {tried} starts led there"
    return Solved(on, replace(found.solution, message=message, starts=(together, tried)))


def divided_otherwise(problem: ClosedLoopProblem, x: FloatArray, history: History) -> FloatArray | None:
    """Return an end with its Coulomb friction divided otherwise between motor and load; None where none is better."""
    values, own = problem.values(x), {p.name for p in problem.free}
    sides = [
        (p.name, load)
        for p in problem.free
        if p.quantity is Quantity.FORCE and p.name != (load := p.name.replace("motor_", "load_", 1)) and load in own
    ]
    if not sides:
        return None
    tried = [x]
    for share in _DIVISIONS:
        wholes = {motor: (values[motor] + values[load], load) for motor, load in sides}
        moved = {motor: share * whole for motor, (whole, _) in wholes.items()}
        moved |= {load: (1 - share) * whole for whole, load in wholes.values()}
        tried.append(problem.vector(values | moved))
    left = in_threads(lambda at: float(np.linalg.norm(problem.residual(at))), tried)
    history.tally.evaluations += len(tried)
    best = int(np.argmin(left))
    if not left[best] < (1 - _BETTER) * left[0] - _REST * problem.size:
        return None
    history.progress(
        f"with {100 * _DIVISIONS[best - 1]:.0f} % of the Coulomb friction on the motor the model explains more"
    )
    return tried[best]


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
    problem: ClosedLoopProblem, rigid: Mapping[str, float] | None, frequency: float | None, history: History
) -> list[tuple[float, dict[str, float]]]:
    """Return starts as (free-free frequency, values), best first: of a grid, or at the frequency that is known."""
    law, sample_time = problem.experiment.law, problem.experiment.sample_time
    if rigid is None:
        tried = []
    else:
        tried = [frequency] if frequency else frequencies_to_try(law, rigid["inertia"], sample_time)
    others = [] if frequency and rigid is not None else inverted_starts(problem)
    starts, used = explored(problem, rigid or {}, tried, others, history.progress)
    history.tally.evaluations += used
    return starts


def on_band(problem: ClosedLoopProblem, filtering: Filtering, mode: float) -> ClosedLoopProblem:
    """Return the problem filtered for a mode at that frequency: the default cut-off, or twice the mode.

    What seems to be a mode too fast for the log is none, and no reason to look at more than by default.
    """
    sample_time = problem.experiment.sample_time
    if FASTEST / sample_time < mode < math.inf:
        mode = 0.0
    default = Filtering().resolve(sample_time, "flexible").cutoff
    assert default is not None
    cutoff = min(max(default, _MODES * mode), WIDE / sample_time)
    return replace(problem, filtering=replace(filtering, cutoff=cutoff).resolve(sample_time, "flexible"))


def simplex_start(
    problem: ClosedLoopProblem, rigid: FitResult, frequency: float | None, history: History
) -> FloatArray:
    """Return where the paper starts: (13) at its frequency, or where that loop is unstable the best of a grid."""
    if frequency is not None:
        start = problem.vector(started(problem, rigid.values, frequency, 0.5))
        if np.linalg.norm(history.counted(problem).residual(start)) <= problem.size:
            return start
        history.progress("the halved inertia (13) makes an unstable loop here; starting from another load share")
    return problem.vector(_explored(problem, rigid.values, frequency, history)[0][1])


def or_moving(resting: Solved, rigid: FitResult, free: bool, solver: Solver[Counted], history: History) -> Solved:
    """Return the better of two answers, the motor at rest at the first sample or moving: see `rigid_search`.

    Args:
        resting: where the search ended, with the motor at rest.
        rigid: a rough rigid joint, and how the motor moves with it.
        free: whether the state at the first sample is searched for, or kept as the rigid joint has it.
        solver: of a descent.
        history: of the search.
    """
    problem, x = resting.problem, resting.solution.x
    values = problem.values(x) | {p.name: rigid[p.name].value or 0.0 for p in INITIAL_STATE}
    state = {p.name: replace(p, start=values[p.name], free=free) for p in INITIAL_STATE}
    begun = problem.changed(state)
    moving = history.solve(begun, solver, begun.vector(values))
    if begins_moving(resting, moving, history):
        return Solved(begun, replace(moving.solution, starts=resting.solution.starts))
    return resting
