"""The search for a flexible joint's stiffness: what is tried, in order.

1. A rough rigid joint, identified below the resonance: its values are divided between the sides.
2. A grid of flexible joints, a simulation each, on a band as wide as the log (`starts.flexible_joint`).
3. Rough descents from the best few, at frequencies apart, until two end together.
4. The end with its Coulomb friction divided otherwise. How much of it is the motor's decides which side stands still
   first at every reversal, so the criterion has valleys along it, and several starts find the same wrong one.
5. A descent to the full tolerance. Where no second start led to the end, it is first repeated from a start nearby.
6. The same with the motor moving at the first sample.
7. All of it again with other inertias, where the end explains little of the torque.
"""

from __future__ import annotations

import contextlib
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import TypeAlias

import numpy as np

from jointid.common.arrays import FloatArray, column_norms
from jointid.common.errors import MethodError
from jointid.common.messages import Detail
from jointid.common.parallel import in_threads
from jointid.common.parameters import Bounds, Quantity
from jointid.estimation.descent import (
    ROUGH,
    History,
    Solved,
    is_significant,
    least_squares,
    search_rigid_joint,
)
from jointid.estimation.methods.registry import Task
from jointid.estimation.problems.base import INITIAL_STATE
from jointid.estimation.problems.closed_loop import ClosedLoopProblem, torque_problem
from jointid.estimation.starts.flexible_joint import (
    FASTEST,
    Candidate,
    crossover,
    explore,
    explore_widely,
    frequency_of,
)
from jointid.estimation.starts.inverse_controller import first_state, reconstructed_position
from jointid.estimation.starts.rigid_joint import regular_start, rigid_starts
from jointid.models.controllers import REFERENCE
from jointid.models.joints import ClosedLoop, FlexibleJoint
from jointid.records.record import Record
from jointid.records.signals.filtering import Filtering
from jointid.solvers.solve import Solution, solve

Grid: TypeAlias = Callable[..., list[Candidate]]

_ROUGH = 1e-3  # tolerance of the rough rigid joint: a start needs no more
_RIGID_CUTOFF = 0.005  # of the sampling frequency: the paper's 5 Hz at 1 kHz

_WIDE = 0.4  # of the sampling frequency: the widest band whose edge a filter can still make
_SWINGS = 30.0  # periods of the rigid start's cut-off in a record: in fewer there is too little to tell a joint from
_RIGID_BELOW = 0.28  # of the crossover frequency; both are the paper's for its axis
_LOWERED, _LOWER = 2, 4.0  # how often, and times how much lower a cut-off is tried where no rigid joint is found
NOTHING = 0.5  # of the torque: an end that leaves so much is no answer
_LITTLE = 0.1  # of the torque: an end that leaves so much may be a false minimum
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
_MODES = 2.0  # the cut-off is that many free-free frequencies, or more


@dataclass(frozen=True, slots=True, eq=False)
class StiffnessSearch:
    """The search by least squares, see the module.

    Where no filter's cut-off is asked for, it follows the mode: the exploration sees the whole band of the log, a rough
    descent twice the frequency it starts from; the last descent is on the band of the mode that was found.

    Attributes:
        problem: of a joint with linear laws. task: that it is a part of.
        frequency: free-free, Hz; a grid is tried when None.
        cutoff: of the rough rigid joint, Hz; chosen when None.
        tolerance: of the parameters and the criterion.
        history: of the search.
    """

    problem: ClosedLoopProblem
    task: Task
    frequency: float | None
    cutoff: float | None
    tolerance: float
    history: History

    def search(self) -> Solved:
        """Return the end.

        Raises:
            MethodError: the loop cannot be simulated at any start, or no joint explains the torque.
        """
        tell, moving = self.history.progress, None
        rigid, solved = self._rigid(self.history)
        if solved is not None and any(p.name == "initial_velocity" for p in solved.problem.free):
            moving = solved.values
        steps = np.diff(self.problem.axis.inputs[:, REFERENCE])
        if moving is None and abs(steps[0]) > _MOVES * np.max(np.abs(steps)):
            with contextlib.suppress(MethodError):  # a controller that cannot be turned round tells no motion
                moving = first_state(self.problem, reconstructed_position(self.problem))
        ends, failures = list[tuple[float, Solved]](), list[MethodError]()
        # Where the rigid joint is far off, last of all about the one that follows its reference.
        grids: list[tuple[Grid, dict[str, float] | None]] = [(partial(explore, frequency=self.frequency), rigid)]
        grids += [(explore_widely, rigid), (explore_widely, None)] if self.frequency is None else []
        for grid, about in grids:
            try:
                found = self._or_moving(partial(grid, rigid=about or self._following()), moving)
            except MethodError as error:
                failures.append(error)
                continue
            left = self.history.count_evaluations(found.problem).residual(found.x)
            ends.append((float(np.linalg.norm(left)) / found.problem.size, found))
            if ends[-1][0] <= _LITTLE:
                break
            tell("the search ended where the model explains little")
        if not ends:
            raise failures[0]
        share, best = min(ends, key=lambda end: end[0])
        if solved is None and share > NOTHING:
            raise MethodError(
                "No joint, rigid or flexible, explains half of this torque; check the sign and the unit of torque and "
                "reference, and the controller's gains and delay."
            )
        return best

    def _rigid(self, history: History) -> tuple[dict[str, float], Solved | None]:
        """Return the values of a rough rigid joint, and its end; of one that follows its reference where it has none.

        A mode inside the loop's bandwidth makes the joint look like no rigid one at any frequency.
        """
        try:
            solved = rough_rigid_joint(self.task, self.cutoff, history)
        except MethodError as error:
            history.progress(Detail(error, "starting from a joint that follows its reference"))
            return self._following(), None
        return {p.name: solved.values[p.name] for p in solved.problem.joint.parameters}, solved

    def _following(self) -> dict[str, float]:
        """Return the values of a rigid joint without friction that follows its reference."""
        loop, filtering = _rigid_loop(self.task), Filtering(cutoff=rigid_cutoff(self.task.record))
        problem = torque_problem(self.task.record, loop, filtering, loop.joint.parameters)
        frictionless = {p.name: 0.0 for p in loop.joint.parameters if p.name != "inertia"}
        values = regular_start(problem.keeping(frictionless))
        return {p.name: values[p.name] for p in loop.joint.parameters}

    def _or_moving(self, grid: Grid, state: Mapping[str, float] | None) -> Solved:
        """Search with the motor at rest at the first sample, and moving where it may; an end at rest is not near."""
        found = self._refine(grid(self._on_band(math.inf), self.history))
        if state is None:
            return found
        started = {p.name: replace(p, start=state[p.name]) for p in INITIAL_STATE}
        other = replace(self, problem=self.problem.replace_parameters(started))
        moving = other._refine(grid(other._on_band(math.inf), self.history))
        return moving if is_significant(found, moving, self.history) else found

    def _refine(self, candidates: Sequence[Candidate]) -> Solved:
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
        followed = frequency_of(found.values) <= FASTEST / on.axis.sample_time
        for _ in range(_BESIDE if together < 2 and followed else 0):
            beside, tried = _from_beside(found, history), tried + 1
            left, other = found.norm, float(np.linalg.norm(beside.residual))
            if other < (1 - _BETTER) * left - _REST * on.size:  # the way back led further down
                found = history.solve(on, ROUGH, beside.x)
                continue
            if _agree((other, frequency_of(on.values(beside.x))), (left, frequency_of(found.values)), on.size):
                found, together = history.finish(found, self.tolerance), 2
            break
        message = f"{found.solution.message}; {together} of {tried} starts led there"
        return found._replace(solution=replace(found.solution, message=message, starts=(together, tried)))

    def _on_band(self, mode: float) -> ClosedLoopProblem:
        """Return the problem with the given cut-off, or else with one suited to a mode frequency."""
        return self.problem if self.task.filtering.cutoff else on_band(self.problem, self.task.filtering, mode)


def rough_rigid_joint(task: Task, cutoff: float | None, history: History) -> Solved:
    """Return a rough search for a joint as rigid, below its resonance; its steps are no part of the history.

    Its cut-off, Hz, where None: 0.5 % of the sampling frequency, or less for a loop that is slow for its log.
    """
    record, rigid, found = task.record, _rigid_loop(task), None

    def search(edge: float) -> Solved:
        history.progress(f"identifying the joint as rigid, below {edge:.3g} Hz")
        problem = torque_problem(record, rigid, Filtering(cutoff=edge), rigid.joint.parameters)
        aside = History(history.progress)
        aside.tally = history.tally
        return search_rigid_joint(problem, rigid_starts(problem, history.progress), _ROUGH, aside)

    edge = cutoff or rigid_cutoff(record)
    for _ in () if cutoff else range(_LOWERED):  # a mode below the cut-off may make the joint look like none at all
        with contextlib.suppress(MethodError):
            found = search(edge)
            break
        edge /= _LOWER
    found = found or search(edge)
    slow = max(_RIGID_BELOW * crossover(found.problem.axis.law, found.values["inertia"]), _least_cutoff(record))
    return search(slow) if cutoff is None and slow < 0.7 * edge else found


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


def on_band(problem: ClosedLoopProblem, filtering: Filtering, mode: float) -> ClosedLoopProblem:
    """Return the problem filtered for a mode at that frequency: the default cut-off, or twice the mode.

    What seems to be a mode too fast for the log is none, and no reason to look at more than by default.
    """
    sample_time = problem.axis.sample_time
    if FASTEST / sample_time < mode < math.inf:
        mode = 0.0
    default = Filtering().resolve(sample_time, "flexible").cutoff
    assert default is not None
    cutoff = min(max(default, _MODES * mode), _WIDE / sample_time)
    return replace(problem, filtering=replace(filtering, cutoff=cutoff).resolve(sample_time, "flexible"))


def _agree(end: tuple[float, float], best: tuple[float, float], size: float) -> bool:
    """Test whether two ends, cost and frequency, are one; `size` is the norm of the torque."""
    (cost, frequency), (least, mode) = end, best
    return abs(frequency - mode) <= _TOGETHER * mode and cost < (1 + _AS_GOOD) * least + _REST * size


def divide_coulomb_friction(problem: ClosedLoopProblem, x: FloatArray, history: History) -> FloatArray | None:
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


def _step_once(problem: ClosedLoopProblem, x: FloatArray) -> FloatArray:
    """Return a Gauss-Newton step from a point, within the bounds: a valley's two sides may have a bottom each."""
    error, slopes = problem.linearise(x)
    if not np.all(np.isfinite(slopes)):  # a loop that runs away
        return x
    sizes = column_norms(slopes)
    step = np.linalg.lstsq(slopes / sizes, -error, rcond=_IDLE)[0] / sizes
    return Bounds.of(problem.free).clip(x + step)


def _from_beside(found: Solved, history: History) -> Solution:
    """Descend from beside an end: softer, more damped, with more of the inertia on the load."""
    problem, values = found.problem, found.values
    moved = 0.2 * values["load_inertia"] if values["load_inertia"] < values["motor_inertia"] else 0.0
    aside = {"stiffness": 0.8 * values["stiffness"], "load_inertia": values["load_inertia"] + moved}
    aside |= {"motor_inertia": values["motor_inertia"] - moved, "damping": 1.5 * values["damping"]}
    return solve(history.count_evaluations(problem), ROUGH, problem.vector(values | aside))
