"""Search of springs: starts of joints and robots, and of flexible joints.

For a joint these are tried, in order:

1. A rough rigid joint, identified below the resonance: its values are divided between the sides.
2. A grid of flexible joints, a simulation each, on a band as wide as the log. Before any identification the loop is
   known: it crosses over where its torque per deviation equals the torque that the inertia needs to follow. A mode
   that affected the tuning lies not far from there, so the grid of free-free frequencies is scaled by the crossover.
3. Rough descents from the best few, at frequencies apart, until two end together; which explain little are given up.
   No step leads to a mode that is too fast for the log, or too much damped, to be an answer.
4. The best solution with its Coulomb friction divided differently, or partly replaced by a constant force. The motor's
   share decides which side stops first at every reversal, so the criterion has several minima over it, and several
   starts find the same wrong one.
5. A descent to the full tolerance. Where no second start found this solution, it is first repeated from nearby.
   The drive side ends here; it has no loop, and its grid is measured by the cut-off.
6. The same with the motor moving at the first sample.
7. If 10 % is unexplained, one start alone led to the end, or its mode is too fast: other inertias and friction.

A robot of rigid joints determines sums: of both sides' friction, of rotor and link. These are split, weighted by their
accuracy, and each spring is given a frequency of rotor against link. The rest is the search of `robots.didim`.
"""

from __future__ import annotations

import contextlib
import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import product
from operator import attrgetter, itemgetter
from typing import TYPE_CHECKING, TypeAlias

import numpy as np

from jointid.common.arrays import FloatArray, column_norms
from jointid.common.errors import MethodError
from jointid.common.messages import Detail
from jointid.common.parallel import in_threads
from jointid.common.parameters import ADDED, Bounds, Parameter, Quantity
from jointid.common.transmission import SIDES
from jointid.estimation.descent import NOTHING, ROUGH, ROUGHLY, History, Solved, is_significant, search_rigid_joint
from jointid.estimation.methods import Task
from jointid.estimation.parameters import INITIAL_STATE, Parameters, mass_matrix_at
from jointid.estimation.problems.simulated import ClosedLoopProblem, Simulated, outcome_of, torque_problem
from jointid.estimation.rigid_starts import (
    first_state,
    reconstructed_position,
    regular_start,
    require_work,
    rigid_starts,
    start_with_friction,
)
from jointid.models.controllers import REFERENCE, SampledLaw
from jointid.models.joints import FlexibleJoint, acts_on_whole, split_by_mode, spring_at
from jointid.records.record import Record
from jointid.records.signals.filtering import Filtering
from jointid.simulation.plant import Place
from jointid.simulation.simulate import Outcome
from jointid.simulation.start import INITIAL
from jointid.solvers.solve import LevenbergMarquardt, solve

if TYPE_CHECKING:
    from jointid.estimation.robots.didim import RobotFit

FASTEST = 0.22  # of the sampling frequency: a mode faster than about a fifth is not followed by the log
STIFFEST = 0.15  # of the sampling frequency: the highest mode of a robot that is searched
LITTLE = 0.1  # of the torque: an end that leaves more may be a false minimum
DAMPED = 0.03  # of critical: springs that a search begins with

_RIGID_CUTOFF = 0.005  # of the sampling frequency: the paper's 5 Hz at 1 kHz
_SWINGS = 30.0  # periods of the rigid start's cut-off in a record: fewer do not determine a joint
_FASTEST_LOOP = 0.25  # of the controller's frequency: at a lighter joint, which crosses over faster, the loop chatters
_RIGID_BELOW = 0.28  # of the crossover frequency; both are the paper's for its axis
_LOWERED, _LOWER = 2, 4.0  # how often, and times how much lower a cut-off is tried where no rigid joint is found

# Times the crossover, the lowest and the highest mode of a grid, and the most between two neighbours.
_MODES, _WIDE_MODES = (0.5, 12.0, 1.25), (0.2, 4.0, 1.4)
_SHARES, _WIDE_SHARES = (0.25, 0.5, 0.75), (0.15, 0.5, 0.85)  # of the load in the inertia
_INERTIAS = (0.02, 0.05, 0.1, 0.2, 0.4, 0.7, 1.0, 1.5, 2.5, 5.0, 10.0, 20.0, 40.0)  # times the rigid joint's
_UNSTABLE = 10.0  # times the torque: what a loop that is as good as unstable leaves

_WIDE = 0.4  # of the sampling frequency: the widest band whose edge a filter can still make
_BAND = 2.0  # the cut-off is that many free-free frequencies, or more
_REFINED, _BESIDE = 6, 3  # starts refined at most, until two end together; restarts near an end of one start alone
# Ends closer than this in frequency, and in what remains, are one: along a flat valley a descent ends no nearer to the
# bottom, and what several ends are good for is to show that no other valley is deeper.
_TOGETHER, _AS_GOOD = 1e-2, 3e-3
_BETTER, _REST = 1e-3, 1e-4  # of what remains: so much less is further down; of the torque: too little to compare
_DIVISIONS = tuple(np.linspace(0.05, 0.95, 13))  # of the Coulomb friction, the motor's part: valleys are a tenth wide
_EXCHANGED = (-0.2, -0.1, -0.05, 0.05, 0.1, 0.2)  # of the Coulomb friction, with the constant force
_FOLLOWED = 10.0  # rad per sample of mode and damping: at more there is no answer, and a simulation takes long
_MOVES = 0.05  # of the reference's largest speed: at more the motor moves at the first sample

# Of a robot
_POSES = 40  # along the references, over which inertias are averaged
_ROTOR = 0.5  # of the inertia about a joint, at most, that its rotor begins with
_ROOM = 0.6  # of what the rotors can take before the links' mass matrix is not positive
_SPREADS = (1.0, 0.3, 0.1, 0.03, 0.01)  # of the inertia about a joint: how far its rotor may be from what is wanted
_LIGHTEST = 0.05  # of the inertia about a joint: a rotor that a search begins with
_HERTZ = tuple(5.0 * 1.5**i for i in range(6))  # Hz: 5 to 38, the grid in which a frequency is searched
_STIFF = 0.07  # of the sampling frequency: where a joint is as good as rigid, and still takes one step a period
_SOFTEST = 1e-3  # of the sampling frequency: the lowest mode that is searched


Rows: TypeAlias = Sequence[tuple[Mapping[str, float], Sequence[float]]]  # rigid joints, each with frequencies, Hz

# Under a controller


def search_flexible_joint(problem: ClosedLoopProblem, task: Task, frequency: float | None, history: History) -> Solved:
    """Search a flexible joint from a frequency, Hz, or from a grid.

    Raises:
        MethodError: the loop cannot be simulated at any start, or no joint explains the torque.
    """
    rough, slow = None, _rigid_problem(task, rigid_cutoff(task.record))
    try:
        rough = rough_rigid_joint(task, history)
        rigid = {p.name: rough.values[p.name] for p in slow.joint.parameters}
    except MethodError as error:  # a mode inside the bandwidth makes the joint look like no rigid one at any frequency
        require_work(problem)
        history.progress(Detail(error, "starting from a joint that follows its reference"))
        rigid = regular_start(slow.keeping({p.name: 0.0 for p in slow.joint.parameters if p.name != "inertia"}))
    motion = _find_motion(problem, rough)

    def search(widely: bool) -> Solved:
        law, period, poor = problem.axis.law, problem.sample_time, min([NOTHING, *(left for left, _ in ends)])
        bases = [start_with_friction(slow, history.progress), *[rigid] * bool(rough)] if widely else [rigid]
        scaled = product(bases, _INERTIAS if widely else (1.0,))
        each = [{**base, "inertia": times * base["inertia"]} for base, times in scaled]
        tried = (frequencies_to_try(law, one["inertia"], period, widely) for one in each)
        rows = [(each[0], [frequency])] if frequency else [*zip(each, tried, strict=True)]
        found = search_spring(problem, rows, task.filtering, history, poor)
        if motion is None:
            return found
        # From an end at rest no descent leads to one that moves.
        moving = problem.replace_parameters({p.name: replace(p, start=motion[p.name]) for p in INITIAL_STATE})
        end = search_spring(moving, rows, task.filtering, history, poor)
        return end if is_significant(found, end) else found

    ends, failures = list[tuple[float, Solved]](), list[MethodError]()
    for widely in (False, True)[: 1 if frequency else 2]:
        try:
            found = search(widely)
        except MethodError as error:
            failures.append(error)
            continue
        ends.append((found.norm / found.problem.size, found))
        fast = frequency_of(found.values) > FASTEST / found.problem.sample_time
        if ends[-1][0] <= LITTLE and found.solution.starts[0] > 1 and not fast:
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
    """State of a motor that may initially move; None for rest."""
    if rough is not None and any(p.name == "initial_velocity" for p in rough.problem.free):
        return rough.values
    steps = np.diff(problem.axis.inputs[:, REFERENCE])
    if abs(steps[0]) > _MOVES * np.max(np.abs(steps)):
        with contextlib.suppress(MethodError):  # a controller without an inverse gives no motion
            return first_state(problem, reconstructed_position(problem))
    return None


def rough_rigid_joint(task: Task, history: History) -> Solved:
    """Return a rough search for a joint as rigid, below its resonance.

    Its cut-off is 0.5 % of the sampling frequency, or less for a loop that is slow for its log.
    """
    found, rough, edge = None, replace(history, tolerance=ROUGHLY), rigid_cutoff(task.record)

    def search(edge: float) -> Solved:
        history.progress(f"identifying the joint as rigid, below {edge:.3g} Hz")
        problem = _rigid_problem(task, edge)
        end = search_rigid_joint(problem, rigid_starts(problem, history.progress), rough)
        if end.values["inertia"] <= problem.free_joint[0].lower:
            raise MethodError(f"Below {edge:.3g} Hz no rigid joint that its loop can hold explains the torque.")
        return end

    for _ in range(_LOWERED):  # a mode below the cut-off may make the joint look like none at all
        with contextlib.suppress(MethodError):
            found = search(edge)
            break
        edge /= _LOWER
    found = found or search(edge)
    slow = rigid_cutoff(task.record, _RIGID_BELOW * crossover(found.problem.axis.law, found.values["inertia"]))
    return search(slow) if slow < 0.7 * edge else found


def rigid_cutoff(record: Record, wanted: float | None = None, least: float = _SWINGS) -> float:
    """Cut-off, Hz, for identifying a flexible joint as rigid, or as wanted; of `least` periods in the record."""
    assert record.torque is not None
    period = record.torque.sample_time
    return max(wanted or _RIGID_CUTOFF / period, least / (record.torque.values.size * period))


def _rigid_problem(task: Task, cutoff: float) -> ClosedLoopProblem:
    """Problem of a task with a rigid joint and linear laws."""
    assert task.loop is not None
    joint = task.loop.joint
    joint = (joint.rigid if joint.springs else joint).linear
    problem = torque_problem(task.record, replace(task.loop, joint=joint), Filtering(cutoff=cutoff), joint.parameters)
    law, at = problem.axis.law, _FASTEST_LOOP / problem.axis.law.period
    least = float(np.abs(law.feedback(np.array([at])))[0]) / (2 * math.pi * at) ** 2
    return problem.replace_parameters({"inertia": replace(joint.parameters[0], lower=least)})


def crossover(law: SampledLaw, inertia: float) -> float:
    """Crossover, Hz: the highest frequency of loop gain 1 on the inertia."""
    hertz = np.geomspace(1e-5, 0.5, 400) / law.period
    loop_gain = np.abs(law.feedback(hertz)) / (abs(inertia) * (2 * math.pi * hertz) ** 2)
    above = np.flatnonzero(loop_gain >= 1.0)
    return float(hertz[above[-1]] if above.size else hertz[0])


def frequencies_to_try(law: SampledLaw, inertia: float, sample_time: float, widely: bool = False) -> list[float]:
    """Free-free frequencies, Hz, from below the crossover to the log's limit, rising."""
    middle, (low, high, ratio) = crossover(law, inertia), _WIDE_MODES if widely else _MODES
    return row_of_frequencies(low * middle, min(high * middle, FASTEST / sample_time), ratio)


def row_of_frequencies(low: float, high: float, ratio: float = 1.25) -> list[float]:
    """Rising frequencies, Hz, with at most this ratio between neighbours."""
    count = max(math.ceil(math.log(max(high / low, 1.0)) / math.log(ratio)) + 1, 2)
    return [float(f) for f in np.geomspace(min(low, high), high, count)]


def on_band(problem: ClosedLoopProblem, filtering: Filtering, mode: float) -> ClosedLoopProblem:
    """Filter the problem for a mode: default cut-off, or twice the mode.

    A mode too fast for the log is disregarded, and the default holds. A requested cut-off stays.
    """
    if filtering.cutoff:
        return problem
    sample_time = problem.sample_time
    if FASTEST / sample_time < mode < math.inf:
        mode = 0.0
    default = Filtering().resolve(sample_time, "flexible").cutoff
    assert default is not None
    cutoff = min(max(default, _BAND * mode), _WIDE / sample_time)
    return problem.with_log(filtering=replace(filtering, cutoff=cutoff).resolve(sample_time, "flexible"))


# Under a controller, or along a motion


def search_spring(
    problem: ClosedLoopProblem, rows: Rows, filtering: Filtering, history: History, poor: float = NOTHING
) -> Solved:
    """Best flexible joint from a grid of starts, see the module.

    If no filter's cut-off is requested, it follows the mode: the exploration sees the whole band of the log, a rough
    descent twice the frequency it starts from; the last descent is on the band of the identified mode.

    Args:
        problem: of the joint, under its controller or along the motion of its motor.
        rows: values of rigid joints, each with free-free frequencies to start from, Hz.
        filtering: as requested.
        history: of the search.
        poor: of the torque: an end that leaves more is not followed.

    Raises:
        MethodError: no start can be simulated.
    """
    wide, ends, together = on_band(problem, filtering, math.inf), list[tuple[float, float, FloatArray]](), 0
    rough, history = replace(ROUGH, poor=poor * wide.size), replace(history, admits=partial(is_followed, wide))
    for values in _explore(wide, rows, history)[:_REFINED]:
        on = on_band(problem, filtering, frequency_of(values))
        x = history.solve(on, on.vector(values), rough).x
        ends.append((float(np.linalg.norm(wide.residual(x))), _mode_of(on.values(x), on.sample_time), x))
        cost, mode, x = min(ends, key=itemgetter(0))
        together = sum(_agree(end[:2], (cost, mode), wide.size) for end in ends)
        if together > 1:
            break
    on, tried = on_band(problem, filtering, mode), len(ends)
    if together > 1 and (divided := divide_coulomb_friction(on, x, history)) is not None:
        x, together = divided, 1
    found = history.solve(on, x, rough if together < 2 else None)
    # An end that no second start leads to is refused, as is a mode too fast, or too much damped: none is worth a step.
    followed = _mode_of(found.values, on.sample_time) <= FASTEST / on.sample_time and found.norm < poor * on.size
    while followed and together < 2 and tried < len(ends) + _BESIDE:
        values = found.values  # softer, more damped, with a heavier load
        moved = 0.2 * values["load_inertia"] if values["load_inertia"] < values["motor_inertia"] else 0.0
        aside = {"stiffness": 0.8 * values["stiffness"], "load_inertia": values["load_inertia"] + moved}
        aside |= {"motor_inertia": values["motor_inertia"] - moved, "damping": 1.5 * values["damping"]}
        beside, tried = history.solve(on, on.vector(values | aside), rough), tried + 1
        if beside.norm < (1 - _BETTER) * found.norm - _REST * on.size:  # the way back led further down
            found = history.solve(on, beside.x, rough)
            continue
        one, other = ((end.norm, frequency_of(end.values)) for end in (beside, found))
        together = 1 + _agree(one, other, on.size)
        break
    found = history.solve(on, found.x) if together > 1 and tried > len(ends) else found
    message = f"{found.solution.message}; {together} of {tried} starts led there"
    return found._replace(solution=replace(found.solution, message=message, starts=(together, tried)))


def is_followed(problem: ClosedLoopProblem, x: FloatArray) -> bool:
    """Test whether a log can follow a candidate's mode and damping."""
    values = problem.values(x)
    ease = sum(1.0 / max(values[f"{side}_inertia"], 1e-300) for side in SIDES)
    fastest = math.sqrt(max(values["stiffness"], 0.0) * ease) + values["damping"] * ease
    return fastest * problem.sample_time <= _FOLLOWED


def _explore(problem: ClosedLoopProblem, rows: Rows, history: History) -> list[dict[str, float]]:
    """Best starts by frequency, or by rigid joint, best first."""
    shares = _WIDE_SHARES if len(rows) > 1 else _SHARES
    each = [(i, f, share) for i, (_, row) in enumerate(rows) for f, share in product(row, shares)]
    by = 0 if len(rows) > 1 else 1 if len(each) > len(shares) else None
    starts = [start_with_mode(problem, rows[i][0], f, share) for i, f, share in each]
    costs = in_threads(lambda start: float(np.linalg.norm(problem.residual(problem.vector(start)))), starts)
    history.counted.evaluations += len(starts)
    found = dict[object, dict[str, float]]()
    for i in np.argsort(costs):
        if costs[i] < _UNSTABLE * problem.size:  # a start beside another leads nowhere new
            found.setdefault(i if by is None else each[i][by], starts[i])
    if not found:
        raise MethodError(
            "No start could be simulated: every flexible joint tried makes this loop unstable; check the "
            "controller's gains, its delay and the unit of the torque."
        )
    best = list(found.values())
    history.progress(f"searching from a mode near {frequency_of(best[0]):.3g} Hz, the best of {len(starts)}")
    given = {p.name: p.start for p in problem.free if p.start is not None and p.name not in INITIAL}
    # Starts that come with the parameters are tried first, and no reason to try no others.
    return [best[0] | given, *best] if given and len(rows) == 1 else best


def start_with_mode(
    problem: ClosedLoopProblem, rigid: Mapping[str, float], frequency: float, share: float
) -> dict[str, float]:
    """Start (13) for the free parameters, with fixed ones as they are."""
    fixed = {p.name: p.start or 0.0 for p in problem.parameters if not p.free or p.name in INITIAL}
    return divide(problem.parameters, rigid, 0.5) | split_by_mode(rigid["inertia"], share, frequency) | fixed


def divide(parameters: Iterable[Parameter], rigid: Mapping[str, float], on_motor: float) -> dict[str, float]:
    """Divide a rigid joint's values between the sides of a flexible one.

    Args:
        parameters: of the flexible joint, and of its surroundings.
        rigid: values by name.
        on_motor: the motor's share of the sums of both sides.
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


def damping_ratio(values: Mapping[str, float]) -> float:
    """Damping ratio of a flexible joint's mode; 0 without a spring."""
    motor, load = values["motor_inertia"], values["load_inertia"]
    size = 2 * math.sqrt(values["stiffness"] * motor * load / (motor + load))
    return values["damping"] / size if size > 0 else 0.0


def _mode_of(values: Mapping[str, float], sample_time: float) -> float:
    """Free-free frequency, Hz; one too fast for the log if overdamped."""
    return frequency_of(values) if damping_ratio(values) <= 1.0 else 1.0 / sample_time


def _agree(end: tuple[float, float], best: tuple[float, float], size: float) -> bool:
    """Test whether two ends agree in cost and frequency; `size` of torque."""
    (cost, frequency), (least, mode) = end, best
    return abs(frequency - mode) <= _TOGETHER * mode and cost < (1 + _AS_GOOD) * least + _REST * size


def divide_coulomb_friction(problem: ClosedLoopProblem, x: FloatArray, history: History) -> FloatArray | None:
    """Divide Coulomb friction otherwise between motor and load; None if not better."""
    values, forces = problem.values(x), {p.name for p in problem.free if p.quantity is Quantity.FORCE}
    sides = [(f"motor{name[4:]}", name) for name in forces if name.startswith("load_") and f"motor{name[4:]}" in forces]
    if not sides:
        return None
    tried, wholes = [], [(motor, load, values[motor] + values[load]) for motor, load in sides]
    for share in _DIVISIONS:
        moved = {motor: share * whole for motor, _, whole in wholes}
        moved |= {load: (1 - share) * whole for _, load, whole in wholes}
        tried.append(problem.vector(values | moved))
    # Where the motor often rests, a constant force is hardly distinguished from the friction that holds the load.
    for (_, load, whole), part, sign in product(wholes, _EXCHANGED, (-1.0, 1.0) if "offset" in forces else ()):
        moved = {load: values[load] + part * whole, "offset": values["offset"] + sign * part * whole}
        tried.append(problem.vector(values | moved))
    here, *left = in_threads(lambda at: float(np.linalg.norm(problem.residual(at))), [x, *tried])
    nearest = [tried[i] for i in np.argsort(left)[:2]]  # a valley's two sides may have a bottom each
    few = LevenbergMarquardt(evaluations=2, admits=history.admits)
    ends = in_threads(lambda at: Solved(problem, solve(problem, few, at)), nearest)
    best = min(ends, key=attrgetter("norm"))
    if not best.norm < (1 - _BETTER) * here - _REST * problem.size:
        return None
    history.progress(Detail("with the Coulomb friction divided otherwise the model explains more"))
    return best.x


# Of a robot


@dataclass(frozen=True, slots=True, eq=False)
class SplitRobot:
    """A rigid robot split into rotors, springs and links.

    Attributes:
        problem: of the flexible robot.
        split: (parameters,) all but the springs.
        reduced: (n,) inertias that swing on the springs of free joints.
        left: (n,) weighted errors of the joints' torques on stiff springs.
    """

    problem: Simulated
    split: FloatArray
    reduced: FloatArray
    left: FloatArray

    @classmethod
    def of(cls, problem: Simulated, rigid: RobotFit) -> SplitRobot:
        """Split a rigid robot: halved friction, rotors as large as possible.

        It minimises the squared deviations from the rigid robot's parameters, weighted by their accuracy, and from the
        wanted rotors. Some rotors are poorly determined, and with them the links' mass matrix may not be positive. So
        the weight of the wanted rotors increases until the robot can be simulated on stiff springs.
        """
        numbers = problem.parameters.base
        whole = rigid.parameters.numbers(rigid.values)
        poses = np.vstack([log.poses for log in problem.logs])
        tree, bodies, few = problem.log.tree, whole.inertials, poses[:: max(len(poses) // _POSES, 1)]
        masses = np.array([mass_matrix_at(tree, bodies, pose) for pose in few])
        masses += np.diag([own["inertia"] for own in whole.values])
        if not np.min(np.linalg.eigvalsh(masses)) > 0.0:
            raise MethodError(
                "The robot of rigid joints that the search of springs begins with has a mass matrix that is not "
                "positive in a pose of the record, so the record hardly shows the masses; move all joints faster, and "
                "differently from each other, or longer."
            )
        about = np.mean(np.diagonal(masses, axis1=1, axis2=2), axis=0)
        # Of a matrix M that is positive M - diag(r) is, too, for r up to this share of what each joint feels alone.
        alone = np.min(1.0 / np.diagonal(np.linalg.inv(masses), axis1=1, axis2=2), axis=0)
        root = 1.0 / np.sqrt(np.outer(alone, alone))
        taken = min(float(np.linalg.eigvalsh(M * root)[0]) for M in masses)
        wanted = np.where(numbers.flexible, np.minimum(_ROTOR * about, _ROOM * taken * alone), 0.0)

        parameters, unit = problem.parameters, np.eye(len(problem.free))
        zero = _stiffen(np.zeros(len(unit)), parameters, rigid)
        felt = np.column_stack([_stiffen(one, parameters, rigid) - zero for one in unit])
        # The information still holds what is known of a sum of two unknown parameters; the covariance has lost it.
        known = np.linalg.qr(rigid.problem.weigh(rigid.slopes), mode="r")
        own = [c for c, p in enumerate(parameters.places) if p.own == "inertia"]
        joints = np.array([parameters.places[c].axis for c in own], dtype=np.int64)
        began, lower = np.zeros(len(unit)), Bounds.of(problem.free).lower.copy()  # a friction is not negative
        began[own], lower[own] = wanted[joints], np.where(numbers.flexible, _LIGHTEST * about, -math.inf)[joints]
        target = np.concatenate([known @ (rigid.values[: len(known)] - zero - felt @ began), np.zeros(len(own))])
        for spread in _SPREADS:
            rows = np.vstack([known @ felt, unit[own] / (spread * about[joints])[:, np.newaxis]])
            norms = column_norms(rows)
            values = np.maximum(began + np.linalg.lstsq(rows / norms, target, rcond=None)[0] / norms, lower)
            rotors = wanted.copy()
            rotors[joints] = values[own]
            links = np.maximum(about - rotors, _LIGHTEST * about)
            start = cls(problem, parameters.fill(values), rotors * links / (rotors + links), np.zeros(0))
            runs = problem.run(parameters.to_search_variables(start.values(start.stiff)), keep=False)
            if outcome_of(runs) is Outcome.FINISHED:
                break
        return replace(start, left=problem.norms(problem.weigh(problem.error(runs))))

    @property
    def stiff(self) -> float:
        """Frequency at which a flexible joint is nearly rigid, Hz."""
        return _STIFF / self.problem.sample_time

    def values(self, hertz: FloatArray | float) -> FloatArray:
        """All parameters, (parameters,), for spring frequencies, (n,) or one for all."""
        values, each = self.split.copy(), np.broadcast_to(hertz, self.reduced.shape)
        for c, place in enumerate(self.problem.parameters.places):
            if place.name in ("stiffness", "damping"):
                values[c] = spring_at(each[place.axis], self.reduced[place.axis], DAMPED)[place.name]
        return values

    def search(self) -> FloatArray:
        """Best frequency for each joint's own torque, (n,), from a row.

        All joints have the same frequency in a run: a joint's spring has little effect on the torques of others. A
        joint without a spring has 0. Where a stiff spring explains most, the highest of the row is taken: from a soft
        one no descent leads to a mode above it.
        """
        problem = self.problem
        row = [f for f in _HERTZ if f < self.stiff]
        if not row:
            raise MethodError(
                f"Modes are searched from {_HERTZ[0]:g} Hz on, which records of {problem.sample_time:g} s a sample do "
                "not show; log faster, or leave the springs out."
            )

        def costs(frequency: float) -> FloatArray:
            return problem.norms(problem.residual(problem.parameters.to_search_variables(self.values(frequency))))

        best = np.argmin([*in_threads(costs, row), self.left], axis=0)
        return np.where(problem.parameters.base.flexible, np.take([*row, row[-1]], best), 0.0)

    def bound(self, problem: Simulated) -> Simulated:
        """Return the problem with bounds on each spring."""
        lowest, highest = (share / problem.sample_time for share in (_SOFTEST, STIFFEST))

        def within(place: Place, parameter: Parameter) -> Parameter:
            if parameter.quantity is not Quantity.STIFFNESS:
                return parameter
            softest, stiffest = (spring_at(f, self.reduced[place.axis])["stiffness"] for f in (lowest, highest))
            return replace(parameter, lower=math.log(softest), upper=math.log(stiffest))

        own = problem.parameters
        bounded = tuple(within(place, one) for place, one in zip(own.places, own.parameters, strict=True))
        return replace(problem, parameters=replace(own, parameters=bounded))


def _stiffen(values: FloatArray, parameters: Parameters, rigid: RobotFit) -> FloatArray:
    """Rigid robot's parameters, (free,), from a flexible one with stiff springs."""
    found, base, each = parameters.numbers(parameters.fill(values)), rigid.parameters.base, list[dict[str, float]]()
    for own, like in zip(found.values, base.values, strict=True):
        both = {name: sum(own.get(f"{side}{name}", 0.0) for side in ("", "motor_", "load_")) for name in like}
        link = own.get("load_viscous", 0.0)  # the link's own friction is the same in both directions
        each.append(both | {name: both[name] + link for name in both if name.startswith("viscous_")})
    return rigid.parameters.group(replace(base, values=tuple(each), inertials=found.inertials))[: len(rigid.x)]
