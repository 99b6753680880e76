"""The search for a flexible joint: what is tried, in order.

1. A rough rigid joint, identified below the resonance: its values are divided between the sides.
2. A grid of flexible joints, a simulation each, on a band as wide as the log. What a drive is known by before anything
   is identified is its loop: it crosses over where the torque it asks for a deviation is the torque the inertia needs
   to follow. A mode that mattered to whoever tuned the loop lies not far from there, so the grid of free-free
   frequencies is measured by the crossover. Half of it is an unstable loop, and the rest has local minima.
3. Rough descents from the best few, at frequencies apart, until two end together.
4. The end with its Coulomb friction divided otherwise. How much of it is the motor's decides which side stands still
   first at every reversal, so the criterion has valleys along it, and several starts find the same wrong one.
5. A descent to the full tolerance. Where no second start led to the end, it is first repeated from a start nearby.
6. The same with the motor moving at the first sample.
7. Where 10 % of the torque or more are left, the same from joints of other inertias, shares and modes.

The drive side has no loop: its grid is measured by the cut-off, and it ends with step 5.
"""

import contextlib
import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import product
from operator import attrgetter
from typing import Any, NamedTuple

import numpy as np

from jointid.common.arrays import FloatArray, column_norms
from jointid.common.errors import MethodError
from jointid.common.messages import Detail
from jointid.common.parallel import in_threads
from jointid.common.parameters import ADDED, Bounds, Parameter, Quantity
from jointid.common.transmission import SIDES
from jointid.estimation.descent import ROUGH, History, Solved, is_significant, least_squares, search_rigid_joint
from jointid.estimation.methods.registry import Task
from jointid.estimation.parameters import INITIAL, INITIAL_STATE
from jointid.estimation.problems.closed_loop import ClosedLoopProblem, torque_problem
from jointid.estimation.starts.rigid_joint import first_state, reconstructed_position, regular_start, rigid_starts
from jointid.models.controllers import REFERENCE, SampledLaw
from jointid.models.joints import ClosedLoop, FlexibleJoint, acts_on_whole, split_by_mode
from jointid.records.record import Record
from jointid.records.signals.filtering import Filtering

FASTEST = 0.22
"""Of the sampling frequency: a mode faster than about a fifth is not followed by the log."""

NOTHING = 0.5
"""Of the torque: an end that leaves so much is no answer."""

_ROUGH = 1e-3  # tolerance of the rough rigid joint: a start needs no more
_RIGID_CUTOFF = 0.005  # of the sampling frequency: the paper's 5 Hz at 1 kHz
_SWINGS = 30.0  # periods of the rigid start's cut-off in a record: in fewer there is too little to tell a joint from
_RIGID_BELOW = 0.28  # of the crossover frequency; both are the paper's for its axis
_LOWERED, _LOWER = 2, 4.0  # how often, and times how much lower a cut-off is tried where no rigid joint is found

_LOWEST, _HIGHEST = 0.5, 12.0  # times the crossover: the modes that are searched
_RATIO = 1.25  # of neighbouring frequencies of the grid
_HALF, _SHARES = 0.5, (0.25, 0.75)  # of the load in the inertia: first the halves of (13), then at the best frequencies
_FAR_BELOW, _FAR_ABOVE, _WIDE_COUNT = 0.2, 4.0, 10  # times the crossover: the modes of the wide grid
_INERTIAS = (0.4, 0.7, 1.0, 1.5, 2.5, 5.0, 10.0, 20.0)  # of that grid, times the rigid joint's
_WIDE_SHARES = (0.15, 0.5, 0.85)  # of the load in them
_LITTLE = 0.1  # of the torque: an end that leaves more may be a false minimum
_NARROWED = 3  # frequencies at which other shares are tried
_UNSTABLE = 10.0  # times the torque: what a loop that is as good as unstable leaves

_WIDE = 0.4  # of the sampling frequency: the widest band whose edge a filter can still make
_MODES = 2.0  # the cut-off is that many free-free frequencies, or more
_REFINED = 6  # starts that are refined at most, until two of them end together
_BESIDE = 3  # restarts near an end that no second start led to
# Ends closer than this in frequency, and in what remains, are one: along a flat valley a descent ends no nearer to the
# bottom, and what several ends are good for is to show that no other valley is deeper.
_TOGETHER, _AS_GOOD = 1e-2, 3e-3
_BETTER = 1e-3  # of what remains: so much less is further down
_DIVISIONS = tuple(np.linspace(0.05, 0.95, 13))  # of the Coulomb friction, the motor's part: valleys are a tenth wide
_IDLE = 1e-8  # of the largest singular value: smaller ones are those of parameters that change nothing
_MOVES = 0.05  # of the reference's largest speed: at more the motor moves at the first sample
_REST = 1e-4  # of the torque: what remains of a record without noise, and is not compared

_cost = attrgetter("cost")


class Candidate(NamedTuple):
    """A joint: its cost, infinite where the loop is as good as unstable; its free-free frequency, Hz; its values."""

    cost: float
    frequency: float
    values: dict[str, float]


# Under a controller


def search_flexible_joint(
    problem: ClosedLoopProblem,
    task: Task,
    frequency: float | None,
    tolerance: float,
    history: History,
) -> Solved:
    """Return the least torque error of a flexible joint, see the module.

    Args:
        problem: of the joint with linear laws.
        task: that it is a part of.
        frequency: free-free, Hz; a grid is tried when None.
        tolerance: of the parameters and the criterion.
        history: of the search.

    Raises:
        MethodError: the loop cannot be simulated at any start, or no joint explains the torque.
    """
    rough = None
    try:
        rough = rough_rigid_joint(task, history)
        rigid = {p.name: rough.values[p.name] for p in rough.problem.joint.parameters}
    except MethodError as error:  # a mode inside the bandwidth makes the joint look like no rigid one at any frequency
        history.progress(Detail(error, "starting from a joint that follows its reference"))
        rigid = _follow_reference(task)
    resting, moving = SpringSearch(problem, task.filtering, tolerance, history), _find_motion(problem, rough)

    def search_about(joint: Mapping[str, float], widely: bool) -> Solved:
        law, sample_time = problem.axis.law, problem.sample_time
        row = [frequency] if frequency else frequencies_to_try(law, joint["inertia"], sample_time)
        if widely:
            middle = crossover(law, joint["inertia"])
            row = list(np.geomspace(_FAR_BELOW * middle, min(_FAR_ABOVE * middle, FASTEST / sample_time), _WIDE_COUNT))
        found = resting.refine(resting.explore(joint, row, widely=widely))
        if moving is None:
            return found
        # From an end at rest no descent leads to one that moves.
        started = problem.replace_parameters({p.name: replace(p, start=moving[p.name]) for p in INITIAL_STATE})
        other = replace(resting, problem=started)
        end = other.refine(other.explore(joint, row, widely=widely))
        return end if is_significant(found, end, history) else found

    ends, failures = list[tuple[float, Solved]](), list[MethodError]()
    for follows, widely in ((False, False),) if frequency else ((False, False), (False, True), (True, True)):
        try:
            found = search_about(_follow_reference(task) if follows else rigid, widely)
        except MethodError as error:
            failures.append(error)
            continue
        left = history.count_evaluations(found.problem).residual(found.x)
        ends.append((float(np.linalg.norm(left)) / found.problem.size, found))
        if ends[-1][0] <= _LITTLE:
            break
    if not ends:
        raise failures[0]
    share, found = min(ends, key=lambda end: end[0])
    if rough is None and share > NOTHING:
        raise MethodError(
            "No joint, rigid or flexible, explains half of this torque; check the sign and the unit of torque and "
            "reference, and the controller's gains and delay."
        )
    return found


def _find_motion(problem: ClosedLoopProblem, rough: Solved | None) -> dict[str, float] | None:
    """Return the state of a motor that may move at the first sample; None of one that rests."""
    if rough is not None and any(p.name == "initial_velocity" for p in rough.problem.free):
        return rough.values
    steps = np.diff(problem.axis.inputs[:, REFERENCE])
    if abs(steps[0]) > _MOVES * np.max(np.abs(steps)):
        with contextlib.suppress(MethodError):  # a controller that cannot be turned round tells no motion
            return first_state(problem, reconstructed_position(problem))
    return None


def rough_rigid_joint(task: Task, history: History) -> Solved:
    """Return a rough search for a joint as rigid, below its resonance.

    Its cut-off is 0.5 % of the sampling frequency, or less for a loop that is slow for its log.
    """
    record, rigid, found = task.record, _rigid_loop(task), None

    def search(edge: float) -> Solved:
        history.progress(f"identifying the joint as rigid, below {edge:.3g} Hz")
        problem = torque_problem(record, rigid, Filtering(cutoff=edge), rigid.joint.parameters)
        return search_rigid_joint(problem, rigid_starts(problem, history.progress), _ROUGH, history)

    edge = rigid_cutoff(record)
    for _ in range(_LOWERED):  # a mode below the cut-off may make the joint look like none at all
        with contextlib.suppress(MethodError):
            found = search(edge)
            break
        edge /= _LOWER
    found = found or search(edge)
    slow = max(_RIGID_BELOW * crossover(found.problem.axis.law, found.values["inertia"]), _least_cutoff(record))
    return search(slow) if slow < 0.7 * edge else found


def rigid_cutoff(record: Record) -> float:
    """Return the cut-off, Hz, below which a flexible joint is first identified as rigid."""
    assert record.torque is not None
    return max(_RIGID_CUTOFF / record.torque.sample_time, _least_cutoff(record))


def _least_cutoff(record: Record) -> float:
    assert record.torque is not None
    return _SWINGS / (record.torque.values.size * record.torque.sample_time)


def _rigid_loop(task: Task) -> ClosedLoop:
    """Return the loop of a task with its joint taken for rigid, with linear laws."""
    assert task.loop is not None
    joint = task.loop.joint
    return replace(task.loop, joint=joint.rigid if isinstance(joint, FlexibleJoint) else joint.linear)


def _follow_reference(task: Task) -> dict[str, float]:
    """Return the values of a rigid joint without friction that follows its reference."""
    loop, filtering = _rigid_loop(task), Filtering(cutoff=rigid_cutoff(task.record))
    problem = torque_problem(task.record, loop, filtering, loop.joint.parameters)
    values = regular_start(problem.keeping({p.name: 0.0 for p in loop.joint.parameters if p.name != "inertia"}))
    return {p.name: values[p.name] for p in loop.joint.parameters}


def crossover(law: SampledLaw, inertia: float) -> float:
    """Return the frequency in Hz up to which the law asks for more torque per position than the inertia takes."""
    hertz = np.geomspace(1e-5, 0.5, 400) / law.period
    loop_gain = np.abs(law.feedback(hertz)) / (abs(inertia) * (2 * math.pi * hertz) ** 2)
    above = np.flatnonzero(loop_gain >= 1.0)
    return float(hertz[above[-1]] if above.size else hertz[0])


def frequencies_to_try(law: SampledLaw, inertia: float, sample_time: float) -> list[float]:
    """Return free-free frequencies in Hz, from below the crossover to where a log cannot follow, slow ones first."""
    middle = crossover(law, inertia)
    return row_of_frequencies(_LOWEST * middle, min(_HIGHEST * middle, FASTEST / sample_time))


def row_of_frequencies(low: float, high: float) -> list[float]:
    """Return the frequencies of a grid, Hz, slow ones first."""
    count = max(math.ceil(math.log(max(high / low, 1.0)) / math.log(_RATIO)) + 1, 2)
    return [float(f) for f in np.geomspace(min(low, high), high, count)]


def on_band(problem: ClosedLoopProblem, filtering: Filtering, mode: float) -> ClosedLoopProblem:
    """Return the problem filtered for a mode at that frequency: the default cut-off, or twice the mode.

    What seems to be a mode too fast for the log is none, and no reason to look at more than by default.
    """
    sample_time = problem.sample_time
    if FASTEST / sample_time < mode < math.inf:
        mode = 0.0
    default = Filtering().resolve(sample_time, "flexible").cutoff
    assert default is not None
    cutoff = min(max(default, _MODES * mode), _WIDE / sample_time)
    return problem.with_log(filtering=replace(filtering, cutoff=cutoff).resolve(sample_time, "flexible"))


# Under a controller, or along a motion


@dataclass(frozen=True, slots=True, eq=False)
class SpringSearch:
    """The search among flexible joints, from a rigid one.

    Where no filter's cut-off is asked for, it follows the mode: the exploration sees the whole band of the log, a rough
    descent twice the frequency it starts from; the last descent is on the band of the mode that was found.

    Attributes:
        problem: of the joint, under its controller or along the motion of its motor.
        filtering: that is asked for.
        tolerance: of the parameters and the criterion.
        history: of the search.
    """

    problem: Any
    filtering: Filtering
    tolerance: float
    history: History

    def _on_band(self, mode: float) -> Any:
        """Return the problem with the given cut-off, or else with one suited to a mode frequency."""
        return self.problem if self.filtering.cutoff else on_band(self.problem, self.filtering, mode)

    def explore(self, rigid: Mapping[str, float], row: Sequence[float], *, widely: bool = False) -> list[Candidate]:
        """Judge a row of frequencies with the values of a rigid joint; return the candidates, best first.

        A mode inside the bandwidth makes the rigid joint another one: `widely` tries other inertias and shares, too.

        Raises:
            MethodError: no start can be simulated.
        """
        problem, inertia = self._on_band(math.inf), rigid["inertia"]
        every = product(_INERTIAS, _WIDE_SHARES, row) if widely else product((1.0,), (_HALF,), row)
        joints = (({**rigid, "inertia": times * inertia}, f, share) for times, share, f in every)
        grid = self._judge((f, start_with_mode(problem, one, f, share)) for one, f, share in joints)
        if not widely:
            best = [one.frequency for one in sorted(grid, key=_cost)[:_NARROWED]]
            grid += self._judge((f, start_with_mode(problem, rigid, f, s)) for f in best for s in _SHARES)
            if len(row) > 1:  # at frequencies apart: a start beside another leads nowhere new
                grid = [min((one for one in grid if one.frequency == f), key=_cost) for f in row]
        found = [one for one in sorted(grid, key=_cost) if one.cost < math.inf]
        if not found:
            raise MethodError(
                "No start could be simulated: every flexible joint tried makes this loop unstable; check the "
                "controller's gains, its delay and the unit of the torque."
            )
        self.history.progress(f"searching from a mode near {found[0].frequency:.3g} Hz, the best of {len(grid)}")
        given = {p.name: p.start for p in problem.free if p.start is not None and p.name not in INITIAL}
        if given and not widely:  # starts that come with the parameters are tried first, and no reason to try no others
            own = found[0].values | given
            found = [Candidate(0.0, frequency_of(own), own), *found]
        return found

    def _judge(self, starts: Iterable[tuple[float, dict[str, float]]]) -> list[Candidate]:
        """Simulate starts, free-free frequency and values, in threads, and return them with their costs."""
        problem, tried = self._on_band(math.inf), list(starts)
        most = _UNSTABLE * problem.size

        def judge(start: tuple[float, dict[str, float]]) -> Candidate:
            cost = float(np.linalg.norm(problem.residual(problem.vector(start[1]))))
            return Candidate(cost if cost < most else math.inf, *start)

        self.history.tally.evaluations += len(tried)
        return in_threads(judge, tried)

    def refine(self, candidates: Sequence[Candidate]) -> Solved:
        """Descend from candidates until two ends agree, look beside the best, and go on to the full tolerance."""
        wide, history = self._on_band(math.inf), self.history
        ends, together = list[tuple[float, float, FloatArray]](), 0
        for candidate in candidates[:_REFINED]:
            on = self._on_band(candidate.frequency)
            x = history.solve(on, ROUGH, on.vector(candidate.values)).x
            history.tally.evaluations += 1
            ends.append((float(np.linalg.norm(wide.residual(x))), frequency_of(on.values(x)), x))
            cost, mode, x = min(ends, key=lambda end: end[0])
            together = sum(_agree(end[:2], (cost, mode), wide.size) for end in ends)
            if together > 1:
                break
        on, tried = self._on_band(mode), len(ends)
        divided = divide_coulomb_friction(on, x, history) if together > 1 else None
        if divided is not None:
            x, together = divided, 1
        found = history.solve(on, ROUGH if together < 2 else least_squares(self.tolerance), x)
        # An end that no second start leads to is refused, as is a mode too fast for the log: neither is worth a step.
        followed = frequency_of(found.values) <= FASTEST / on.sample_time
        for _ in range(_BESIDE if together < 2 and followed else 0):
            beside, tried = history.solve(on, ROUGH, _beside(found)), tried + 1
            if beside.norm < (1 - _BETTER) * found.norm - _REST * on.size:  # the way back led further down
                found = history.solve(on, ROUGH, beside.x)
                continue
            one, other = ((end.norm, frequency_of(end.values)) for end in (beside, found))
            if _agree(one, other, on.size):
                found, together = history.finish(found, self.tolerance), 2
            break
        message = f"{found.solution.message}; {together} of {tried} starts led there"
        return found._replace(solution=replace(found.solution, message=message, starts=(together, tried)))


def start_with_mode(problem: Any, rigid: Mapping[str, float], frequency: float, share: float) -> dict[str, float]:
    """Return the start (13) for the free parameters, with the fixed ones as they are."""
    fixed = {p.name: p.start or 0.0 for p in problem.parameters if not p.free or p.name in INITIAL}
    return divide(problem.parameters, rigid, _HALF) | split_by_mode(rigid["inertia"], share, frequency) | fixed


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


def _agree(end: tuple[float, float], best: tuple[float, float], size: float) -> bool:
    """Test whether two ends, cost and frequency, are one; `size` is the norm of the torque."""
    (cost, frequency), (least, mode) = end, best
    return abs(frequency - mode) <= _TOGETHER * mode and cost < (1 + _AS_GOOD) * least + _REST * size


def divide_coulomb_friction(problem: Any, x: FloatArray, history: History) -> FloatArray | None:
    """Divide an end's Coulomb friction otherwise between motor and load; None where none is better."""
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
    tried += in_threads(lambda i: _step_once(problem, tried[i]), sorted(range(1, len(tried)), key=left.__getitem__)[:2])
    left += [float(np.linalg.norm(problem.residual(at))) for at in tried[-2:]]
    history.tally.evaluations += len(tried) + 2
    best = int(np.argmin(left))
    if not left[best] < (1 - _BETTER) * left[0] - _REST * problem.size:
        return None
    history.progress(Detail("with the Coulomb friction divided otherwise the model explains more"))
    return tried[best]


def _step_once(problem: Any, x: FloatArray) -> FloatArray:
    """Return a Gauss-Newton step from a point, within the bounds: a valley's two sides may have a bottom each."""
    error, slopes = problem.linearise(x)
    if not np.all(np.isfinite(slopes)):  # a loop that runs away
        return x
    sizes = column_norms(slopes)
    step = np.linalg.lstsq(slopes / sizes, -error, rcond=_IDLE)[0] / sizes
    return Bounds.of(problem.free).clip(x + step)


def _beside(found: Solved) -> FloatArray:
    """Return a start beside an end: softer, more damped, with more of the inertia on the load."""
    values = found.values
    moved = 0.2 * values["load_inertia"] if values["load_inertia"] < values["motor_inertia"] else 0.0
    aside = {"stiffness": 0.8 * values["stiffness"], "load_inertia": values["load_inertia"] + moved}
    aside |= {"motor_inertia": values["motor_inertia"] - moved, "damping": 1.5 * values["damping"]}
    return np.asarray(found.problem.vector(values | aside))
