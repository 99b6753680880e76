"""DIDIM of a robot with flexible joints: rotors, springs, friction on both sides and the links, from torques alone.

A robot of rigid joints is identified first. It fixes sums: of both sides' friction, of rotor and link. These are
split, what it says of each by how well it knows it. Each spring is begun at a frequency, given or the best of a row
of them that all joints go through together; where that leads nowhere, from one frequency of all. The torque error of
all joints is then made least by Levenberg and Marquardt's steps with derivatives by variation
(`solvers.bounded_least_squares`), rotors' inertias and stiffnesses on a logarithmic scale. The joints weigh by their
errors, which are estimated again until they settle, a few times at most: a search may leave a wrong minimum after the
joint that led it there weighs less.

Whether a record shows a spring is asked of each joint alone, by its compliance c = 1/K, in which a rigid joint is not
at infinity but at 0: it is shown where c is more than four of its standard deviations above 0, with the spring not at
the stiffest that is looked for. Otherwise the stiffness is refused, and ``1 / (c + 2 std)`` is its bound from below.

Valid for springs that are linear and tie each rotor to its own link, and rotors that turn fast against the links: their
gyroscopic torques are left out [Spong 1987].
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np

from jointid.common.arrays import FloatArray, column_norms
from jointid.common.errors import MethodError
from jointid.common.messages import Progress, no_choice
from jointid.common.parallel import threads
from jointid.common.parameters import Parameter
from jointid.estimation.robots.didim import RobotFit, conclude, identify_rigid_robot, joint_sizes
from jointid.estimation.robots.numbers import RobotParameters, robot_parameters
from jointid.estimation.robots.problem import RobotProblem, robot_problem
from jointid.models.robots.robot import Robot
from jointid.records.record import Record
from jointid.records.signals.filtering import Filtering
from jointid.simulation.closed_loop import in_threads
from jointid.simulation.robot_numbers import NumberOf, NumberPlace, RobotNumbers
from jointid.simulation.robots import RobotLoop, RobotOutcome
from jointid.solvers.bounded_least_squares import LevenbergMarquardt
from jointid.solvers.solve import Counted, Solution, Status, Step, solve
from jointid.uncertainty.covariance import white

SLOW = Filtering(cutoff=4.0)
"""Below the modes, where a robot is as good as rigid."""

_NEAR = 0.2  # standard deviations: a change of the rigid robot's parameters that is none where springs are to follow
_POSES = 40  # along the references, over which inertias are averaged
_SHARE = 0.5  # of the inertia about a joint, at most, that its rotor begins with
_ROOM = 0.6  # of what the rotors can take before the links' mass matrix is not positive
_SPREADS = (1.0, 0.3, 0.1, 0.03, 0.01)  # of the inertia about a joint: how far its rotor may be from what is wanted
_LIGHTEST = 0.05  # of the inertia about a joint: a rotor that a search begins with
_DAMPING = 0.03  # of critical, of the springs a search begins with
_MODES = tuple(5.0 * 1.5**i for i in range(6))  # Hz: 5 to 38, the row in which a frequency is looked for
_STIFF = 0.07  # of the sampling frequency: where a joint is as good as rigid, and still takes one step a period
_SOFTEST = 1e-3  # of the sampling frequency: the lowest mode that is looked for
_STIFFEST = 0.15  # of the sampling frequency: the highest mode that is looked for
_REACH = math.log(3.0)  # of a step: a stiffness or a rotor's inertia to at most so many times what it was
_DAMPED = 5.0  # of a step: a spring's damping by at most so many times what it begins with
_TURNS, _SETTLED = 4, 0.4  # searches with new sizes of the joints' errors, and their change that asks for no other
_COMMON = 11.25, 16.875, 25.3125  # Hz of all springs, where the first search leads nowhere
_TRIED = 6  # evaluations from each of them
_POOR = 0.1  # of a joint's filtered torque: an error that is more than noise
_FIRST = 12  # evaluations, after which springs are looked for in what was found: with springs most searches are over
_SHOWN = 4.0  # standard deviations by which a compliance is told from 0
_TWO = 2.0  # of them: the bound of one that is not
_OFF = 1e-3  # of the stiffest, on a logarithmic scale: a spring that is not at its bound
_EXACT = 1e-6  # of the torques: an error that the simulation itself may have


class _Aim(NamedTuple):
    """How far a search goes: its tolerance, and what a step is to promise, shares of the criterion."""

    tolerance: float
    worth: float


_ROUGH, _CLOSE = _Aim(3e-2, 1e-2), _Aim(1e-3, 1e-4)
"""With the first sizes of the joints' errors, and with better ones."""

_FINE = 3e-5  # tolerance at last
_LAST = 0.1  # of the sum of squares in units of the noise, a step's worth there: all parameters move by 0.3 deviations


@dataclass(frozen=True, slots=True)
class SpringVerdict:
    """Whether the records show the spring of a joint.

    Attributes:
        joint: its name.
        shown: whether they do.
        stiffness: N m/rad or N/m; None where it is refused. deviation: of it, one standard deviation.
        at_least: the stiffness that it has at least, two standard deviations of its compliance away.
        unit: of these, N m/rad or N/m.
    """

    joint: str
    shown: bool
    stiffness: float | None
    deviation: float | None
    at_least: float
    unit: str = "N m/rad"

    def __str__(self) -> str:
        if self.stiffness is None or self.deviation is None:
            least = f"{self.at_least:.3g} {self.unit}"
            return f"{self.joint}: the records do not show a spring; its stiffness is at least {least}"
        return f"{self.joint}: stiffness {self.stiffness:.5g} +- {_TWO * self.deviation:.2g} {self.unit}"


@dataclass(frozen=True, slots=True, eq=False)
class FlexibleRobotFit:
    """What was identified of a robot with flexible joints.

    Attributes:
        fit: all parameters; of a spring that is refused, and of its joint's two sides, no interval is to be believed.
        springs: a verdict for each flexible joint.
        rigid: the robot of rigid joints that the search began from.
        evaluations: simulations with derivatives. message: how the search ended.
    """

    fit: RobotFit
    springs: tuple[SpringVerdict, ...]
    rigid: RobotFit
    evaluations: int
    message: str


def identify_flexible_robot(
    loop: RobotLoop,
    records: Sequence[Record],
    filtering: Filtering | None = None,
    *,
    frequencies: Mapping[str, float] | None = None,
    offsets: bool = True,
    evaluations: int = 60,
    progress: Progress = lambda _: None,
) -> FlexibleRobotFit:
    """Identify a robot, of which some joints are flexible, from torques and references; positions are not read.

    Args:
        loop: the robot, whose joints with a spring are flexible, and its controllers. Of the robot's numbers only the
            links' places and gravity are read.
        records: one for each joint, with torque and reference, of one log; to show a spring the motion must excite its
            mode, as a multisine on top of it does.
        filtering: that torques and derivatives go through alike; its cut-off above the modes.
        frequencies: Hz, of the mode of rotor against link of each flexible joint with the others stiff, where the
            search is to begin; None looks for it between 5 and 38 Hz.
        offsets: whether each motor has a constant torque that is identified, too.
        evaluations: simulations with derivatives, at most, of each search; there are three to eleven.
        progress: is told the steps.

    Raises:
        RecordError: a record lacks torque or reference, or has the wrong clock or unit.
        MethodError: no joint has a spring, a frequency is missing, the log is too slow to look for one, nothing can be
            simulated at the start, or a robot of rigid joints explains the torques better.
    """
    robot = loop.robot
    require_springs(robot, frequencies)
    parameters = robot_parameters(robot, offsets=offsets, logarithmic=True)
    problem = robot_problem(loop, records, parameters, filtering)
    if frequencies is None:
        _row(problem.sample_time)
    require_frequencies(frequencies, problem.sample_time)
    rigid = identify_rigid_robot(loop, records, SLOW, offsets=offsets, settled=_NEAR, progress=progress)
    return search_springs(
        problem, robot, rigid, lambda start: frequencies or start.search(progress), evaluations, progress
    )


def require_springs(robot: Robot, frequencies: Mapping[str, float] | None) -> None:
    """Raise MethodError if no joint has a spring, or a frequency is missing, or is of no flexible joint."""
    flexible = _springs(robot)
    if not flexible:
        raise MethodError(
            "No joint of this robot has a spring; give one a JointSpring, [joints.spring] of a robot file, or identify "
            "it as rigid, by idim or didim."
        )
    if frequencies is not None and (missing := sorted(set(flexible) - set(frequencies))):
        raise MethodError(
            f"A frequency is needed for each flexible joint; {', '.join(missing)} has none: give one in Hz, or none "
            "at all to have them looked for."
        )
    for name in frequencies or ():
        if name not in flexible:
            raise MethodError(f"A name in frequencies{no_choice(name, flexible)}")


def require_frequencies(frequencies: Mapping[str, float] | None, sample_time: float) -> None:
    """Raise MethodError if a frequency is none that is looked for in such a log."""
    highest = _STIFFEST / sample_time
    for name, hertz in (frequencies or {}).items():
        if not 0.0 < hertz <= highest:
            raise MethodError(
                f"The frequency of {name} is {hertz:g} Hz; expected one above 0 and up to {highest:g} Hz, of which a "
                "record of this sample time shows something: correct it, or give none at all to have them looked for."
            )


def _springs(robot: Robot) -> list[str]:
    """Return the names of the flexible joints."""
    return [joint.name for joint in robot.joints if joint.spring is not None]


def search_springs(
    problem: RobotProblem[Any],
    robot: Robot,
    rigid: RobotFit,
    look: Callable[[StartOfSprings], Mapping[str, float]],
    evaluations: int,
    progress: Progress,
) -> FlexibleRobotFit:
    """Return the flexible robot that leaves the least torque error, searched from the rigid one.

    Args:
        problem: of the flexible robot.
        robot: that is identified.
        rigid: what was found of it with stiff joints, below the modes.
        look: for the frequencies of the flexible joints at which the search is to begin, Hz, in the robot split.
        evaluations: at most, of each search.
        progress: is told the steps.

    Raises:
        MethodError: nothing can be simulated at the start, or a robot of rigid joints explains the torques better.
    """
    flexible = _springs(robot)
    problem = problem.weighted(joint_sizes(problem, problem.error(rigid.run), rigid.values.size, _least(problem)))
    start = StartOfSprings.of(problem.roughly(), rigid, robot.names)
    hertz = look(start)
    problem = _bounded(problem, start)
    rough = problem.roughly()
    errors = problem.error(rigid.run)
    without = float(np.linalg.norm(errors * problem.weights(errors.size)))
    end = _begin(rough, start, hertz, without, evaluations, progress)
    if end.solution.status is Status.NOT_EVALUABLE:
        raise MethodError(
            f"The robot cannot be simulated where its search begins: {rough.run(end.solution.x).outcome.value}. Give "
            "other frequencies, or a record in which all joints move more."
        )
    stiff = not end.solution.converged and end.norm > without
    if stiff:
        # No better than without springs: a robot that has none, or whose modes are high, is found from stiff ones.
        before = end.made
        end = _search(rough, start.begin(start.all_at(start.stiff)), _ROUGH, min(_FIRST, evaluations), progress)
        end = replace(end, made=before + end.made)
    kinds = dict(zip(robot.names, (link.kind for link in robot.links), strict=True))
    units = {name: "N/m" if kinds[name] == "prismatic" else "N m/rad" for name in flexible}
    # A search without springs to find goes on for minutes along what the record does not tell.
    if (not end.may_show or (stiff and end.norm > without)) and (seen := end.of(problem).fit()) is not None:
        found = (_judge(seen, problem, name, units[name]) for name in flexible)
        springs = tuple(replace(one, shown=False, stiffness=None, deviation=None) for one in found)
        return FlexibleRobotFit(seen, springs, rigid, seen.iterations, "no joint shows a spring")
    end = _search(end.reweighted(), end, _CLOSE, evaluations, progress).of(problem)
    for _ in range(_TURNS):
        weighed = end.reweighted()
        end = _search(weighed, end, _Aim(_FINE, _LAST / end.solution.residual.size), evaluations, progress)
        change = np.log(end.reweighted().sigma / weighed.sigma)
        if not end.solution.converged or np.all(np.abs(change) < _SETTLED):
            break
    fit = end.fit()
    if fit is None:
        raise MethodError(
            f"The search led to where the robot cannot be simulated: {problem.run(end.solution.x).outcome.value}. Give "
            "other frequencies, or leave out springs of joints that are stiff."
        )
    before, after = (np.linalg.norm(problem.by_joint(problem.error(one.run)), axis=1) for one in (rigid, fit))
    if np.all(after >= before):
        raise MethodError(
            "A robot of rigid joints explains the torque of every joint better than the one that the search of springs "
            "ended at; leave the springs out of the robot file, or excite their modes by a multisine."
        )
    springs = tuple(_judge(fit, problem, name, units[name]) for name in flexible)
    return FlexibleRobotFit(fit, springs, rigid, fit.iterations, end.solution.message)


@dataclass(frozen=True, slots=True, eq=False)
class _End:
    """Where searches have led, one after the other.

    Attributes:
        problem: as the last of them weighed it. solution: of that. made: evaluations of all.
        reach: see `_Start`.
        run: at the end, where the last search has made it. finer: whether the problem simulates finer than the search
            did, so that what is known of the end is only nearly so.
    """

    problem: RobotProblem[Any]
    solution: Solution
    made: int
    reach: FloatArray
    run: Any = None
    finer: bool = False

    def of(self, problem: RobotProblem[Any]) -> _End:
        """Return the end as one of a problem that is simulated finer."""
        finer = problem.roughly() is not problem
        return replace(self, problem=problem.weighted(self.problem.sigma), run=None, finer=finer)

    def linearised(self) -> tuple[FloatArray, FloatArray]:
        """Return the error, (rows,), and its derivatives, (rows, free), not weighted."""
        weights = self.problem.weights(self.solution.residual.size)
        return self.solution.residual / weights, self.solution.jacobian / weights[:, np.newaxis]

    def reweighted(self) -> RobotProblem[Any]:
        """Return the problem with the sizes of the errors that are left."""
        error, slopes = self.linearised()
        return self.problem.weighted(joint_sizes(self.problem, error, slopes.shape[1], _least(self.problem)))

    @property
    def converged(self) -> bool:
        """Whether the search settled, or left no more than the simulation itself may err."""
        error, _ = self.linearised()
        left = np.linalg.norm(self.problem.by_joint(error), axis=1)
        return self.solution.converged or bool(np.all(left <= _least(self.problem)))

    @property
    def norm(self) -> float:
        """Of the weighted error that is left."""
        return float(np.linalg.norm(self.solution.residual))

    @property
    def may_show(self) -> bool:
        """Whether a longer search may find a spring: of one its compliance is above two deviations, off its end."""
        x, known = self.solution.x, white(self.solution.jacobian, self.solution.residual)
        return any(
            parameter.symbol == "stiffness" and 0.0 < std < 1.0 / _TWO and value < parameter.upper - _OFF
            for parameter, std, value in zip(self.problem.free, known.std, x, strict=True)
        )

    @property
    def is_poor(self) -> bool:
        """Whether much of a joint's torque is left."""
        error, _ = self.linearised()
        left, seen = (self.problem.by_joint(rows) for rows in (error, self.problem.decimated(self.problem.measured)))
        return bool(np.any(np.linalg.norm(left, axis=1) > _POOR * np.linalg.norm(seen, axis=1)))

    def fit(self) -> RobotFit | None:
        """Return the fit; None where the robot cannot be simulated there."""
        x = self.solution.x
        run = self.run or self.problem.run(x)
        if run.outcome is not RobotOutcome.FINISHED:
            return None
        J = -self.linearised()[1]
        return conclude(self.problem, x, run, J, J, self.made, self.converged, _least(self.problem))


def _least(problem: RobotProblem[Any]) -> float:
    """Return the norm of an error that no joint's is smaller than."""
    seen = problem.by_joint(problem.decimated(problem.measured))
    return _EXACT * float(np.max(np.linalg.norm(seen, axis=1)))


@dataclass(frozen=True, slots=True, eq=False)
class _Start:
    """Where a search begins.

    Attributes:
        x: (parameters,) what is searched.
        reach: (parameters,) how far one step may move each: rotors, springs and their damping not too far.
    """

    x: FloatArray
    reach: FloatArray

    @classmethod
    def of(cls, parameters: RobotParameters, values: FloatArray) -> _Start:
        """Return a start at values of all parameters."""
        damping = np.array([place.of is NumberOf.SPRING and place.column == 1 for place in parameters.places])
        reach = np.where(parameters.logarithmic, _REACH, np.where(damping, _DAMPED * values, np.inf))
        return cls(parameters.searched(values), reach)


def _begin(
    problem: RobotProblem[Any],
    start: StartOfSprings,
    hertz: Mapping[str, float],
    without: float,
    evaluations: int,
    progress: Progress,
) -> _End:
    """Return where the first search leads, from these frequencies, Hz, and from others where it is not over soon.

    Or where much of a joint's torque is left; but not where it is more than the robot of rigid joints left, `without`:
    such a robot may have no springs. A robot split into wrong rotors may look best on wrong frequencies, and
    the search then creeps. Of 200 random robots four did, and all came down from one frequency of all springs.
    """
    first = min(_FIRST, evaluations)
    best = _search(problem, start.begin(start.values(hertz)), _ROUGH, first, progress)
    if (best.solution.converged and not best.is_poor) or best.norm > without:
        return best
    made, chosen = best.made, None
    for frequency in (f for f in _COMMON if f < _STIFF / problem.sample_time):
        begun = start.begin(start.all_at(frequency))
        other = _search(problem, begun, _ROUGH, min(_TRIED, evaluations), progress)
        made += other.made
        if other.norm < best.norm:
            best, chosen = other, begun
    if chosen is not None and not best.solution.converged:
        # From its start once more: a search that goes on from an end begins with long steps, and may leave the way.
        best = _search(problem, chosen, _ROUGH, first, progress)
        made += best.made
    return replace(best, made=made)


def _search(problem: RobotProblem[Any], start: _Start | _End, aim: _Aim, evaluations: int, progress: Progress) -> _End:
    """Return where a search of the least torque error ends, from a start or from where another ended."""

    def watch(step: Step) -> None:
        progress(f"{step.evaluations} simulations: weighted torque error {step.norm:.6g}")

    kept = _LowestRun(problem)
    counted, made, x = Counted(kept), 0, start.solution.x if isinstance(start, _End) else start.x
    if isinstance(start, _End):
        made = start.made
        if not start.finer:
            error, slopes = start.linearised()
            weights = problem.weights(error.size)
            counted.remember(x, error * weights, slopes * weights[:, np.newaxis])
    solver = LevenbergMarquardt(aim.tolerance, evaluations, start.reach, aim.worth)
    found = solve(counted, solver, x, watch)
    return _End(problem, found, made + found.evaluations, start.reach, kept.run_at(found.x))


class _LowestRun:
    """A problem that keeps the run of the least error: where a search ends it was simulated already."""

    def __init__(self, problem: RobotProblem[Any]) -> None:
        self.problem, self.free = problem, problem.free
        self._norm, self._x, self._run = math.inf, np.empty(0), None

    def residual(self, x: FloatArray) -> FloatArray:
        """Return the weighted residual, (rows,)."""
        return self.problem.residual(x)

    def linearised(self, x: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the weighted residual, (rows,), and its derivatives, (rows, free)."""
        run, error, J = self.problem.linearised_run(x)
        norm = float(np.linalg.norm(error))
        if norm < self._norm:
            self._norm, self._x, self._run = norm, x.copy(), run
        return error, J

    def run_at(self, x: FloatArray) -> Any:
        """Return the run at a point, None if it is not the one that was kept."""
        return self._run if np.array_equal(x, self._x) else None


@dataclass(frozen=True, slots=True, eq=False)
class StartOfSprings:
    """The rigid robot split into rotors, springs and links.

    Attributes:
        problem: of the flexible robot. names: of its joints.
        split: (parameters,) all but the springs.
        rotors, links: (n,) inertias of the rotors, and of the links about the joints.
        costs: (n,) norms of the joints' weighted errors on stiff springs.
    """

    problem: RobotProblem[Any]
    names: tuple[str, ...]
    split: FloatArray
    rotors: FloatArray
    links: FloatArray
    costs: FloatArray

    @classmethod
    def of(cls, problem: RobotProblem[Any], rigid: RobotFit, names: tuple[str, ...]) -> StartOfSprings:
        """Split a rigid robot: friction in halves, rotors as large as the links' mass matrix lets them be.

        Of the rotors that the rigid robot tells apart from their links some it hardly knows, and with these as they are
        the links' mass matrix may not be positive. So what is taken for granted of the rotors is more and more, until
        the robot can be simulated on stiff springs.
        """
        numbers = problem.parameters.base
        whole = rigid.parameters.numbers(rigid.values)
        poses = problem.poses
        masses = np.array([_mass_matrix(problem, whole, pose) for pose in poses[:: max(len(poses) // _POSES, 1)]])
        if not np.min(np.linalg.eigvalsh(masses)) > 0.0:
            raise MethodError(
                "The robot of rigid joints that the search of springs begins with has a mass matrix that is not "
                "positive in a pose of the record, so the record hardly tells the masses; move all joints faster, and "
                "differently from each other, or longer."
            )
        about = np.mean(np.diagonal(masses, axis1=1, axis2=2), axis=0)
        # Of a matrix M that is positive M - diag(r) is, too, for r up to this share of what each joint feels alone.
        alone = np.min(1.0 / np.diagonal(np.linalg.inv(masses), axis1=1, axis2=2), axis=0)
        root = 1.0 / np.sqrt(np.outer(alone, alone))
        taken = min(float(np.linalg.eigvalsh(M * root)[0]) for M in masses)
        wanted = np.where(numbers.flexible, np.minimum(_SHARE * about, _ROOM * taken * alone), 0.0)

        def split(spread: float) -> tuple[StartOfSprings, bool]:
            values, rotors = _split(problem.parameters, rigid, numbers, wanted, spread * about, _LIGHTEST * about)
            costs = np.full(about.size, np.inf)
            start = cls(problem, names, values, rotors, np.maximum(about - rotors, _LIGHTEST * about), costs)
            run = problem.run(problem.parameters.searched(start.all_at(start.stiff)), keep=False)
            if run.outcome is not RobotOutcome.FINISHED:
                return start, False
            error = problem.error(run)
            return replace(start, costs=start._norms(error * problem.weights(error.size))), True

        for first in range(0, len(_SPREADS), threads()):
            for start, runs in in_threads(split, _SPREADS[first : first + threads()]):
                if runs:
                    return start
        return start

    def _norms(self, weighted: FloatArray) -> FloatArray:
        """Return the norms of the joints' errors, (n,)."""
        return np.asarray(np.linalg.norm(self.problem.by_joint(weighted), axis=1))

    @property
    def stiff(self) -> float:
        """The frequency at which a flexible joint is as good as rigid, Hz."""
        return _STIFF / self.problem.sample_time

    def all_at(self, frequency: float) -> FloatArray:
        """Return all parameters with one frequency of all springs."""
        return self.values(dict.fromkeys(self.names, frequency))

    def begin(self, values: FloatArray) -> _Start:
        """Return the start of a search at values of all parameters."""
        return _Start.of(self.problem.parameters, values)

    def values(self, hertz: Mapping[str, float]) -> FloatArray:
        """Return all parameters with springs of these frequencies, (parameters,)."""
        values = self.split.copy()
        for c, place in enumerate(self.problem.parameters.places):
            if place.of is NumberOf.SPRING:
                inertia = self.rotors[place.row] * self.links[place.row] / (self.rotors + self.links)[place.row]
                w = 2.0 * math.pi * hertz[self.names[place.row]]
                values[c] = inertia * w * w if place.column == 0 else 2.0 * _DAMPING * inertia * w
        return values

    def search(self, progress: Progress) -> dict[str, float]:
        """Return a frequency for each flexible joint: of a row that with which its own torque is explained best.

        All joints have the same frequency in a run: what one's spring does to the torques of others is small beside
        what it does to its own, and a run for each joint and frequency would take as many times as long. Where a stiff
        joint would explain its torque better than any of the row, its mode may be above them all: whether it is begun
        at the best or at the highest is decided by the torques of all joints.
        """
        row = _row(self.problem.sample_time)

        def costs(values: FloatArray) -> FloatArray:
            return self._norms(self.problem.residual(self.problem.parameters.searched(values)))

        flexible = np.flatnonzero(self.problem.parameters.base.flexible)
        own = np.array(in_threads(costs, [self.all_at(f) for f in row]))[:, flexible]
        lowest = np.argmin(own, axis=0)
        higher = np.where(np.min(own, axis=0) < self.costs[flexible], lowest, len(row) - 1)
        ways = [{self.names[i]: row[k] for i, k in zip(flexible, way, strict=True)} for way in (lowest, higher)]
        ways = ways[:1] if ways[0] == ways[1] else ways
        whole = [float(np.linalg.norm(one)) for one in in_threads(costs, [self.values(way) for way in ways])]
        best = ways[int(np.argmin(whole))]
        for name, f in best.items():
            progress(f"{name}: its mode is looked for from {f:.3g} Hz")
        return best


def _row(sample_time: float) -> list[float]:
    """Return the frequencies at which modes are looked for, Hz."""
    row = [f for f in _MODES if f < _STIFF / sample_time]
    if not row:
        raise MethodError(
            f"Modes are looked for from {_MODES[0]:g} Hz on, which records of {sample_time:g} s a sample do not show; "
            "log faster, or leave the springs out."
        )
    return row


def _mass_matrix(problem: RobotProblem[Any], numbers: RobotNumbers, pose: FloatArray) -> FloatArray:
    """Return that of a robot of rigid joints, rotors included, (n, n)."""
    from jointid.models.robots.equations import ROOM, equations_of_motion

    still, room = np.zeros(pose.size), np.empty((pose.size, ROOM))
    M = np.empty((pose.size, pose.size))
    equations_of_motion(*problem.tree, numbers.inertials, pose, still, still, room, M, np.empty(pose.size))
    return M + np.diag(numbers.masses[: pose.size, 0])


def _split(
    parameters: RobotParameters,
    rigid: RobotFit,
    numbers: RobotNumbers,
    wanted: FloatArray,
    spread: FloatArray,
    lightest: FloatArray,
) -> tuple[FloatArray, FloatArray]:
    """Return the parameters that move as the rigid robot does with stiff springs, and their rotors, (n,).

    Least squares of what the rigid robot's parameters say, each as well as it is known, and of the wanted rotors.

    Args:
        parameters: of the flexible robot.
        rigid: what was found of the rigid one.
        numbers: of the flexible robot.
        wanted: (n,) rotors.
        spread: (n,) of these.
        lightest: (n,) rotors that are not gone below.
    """
    rotors = wanted.copy()
    known = dict(zip(rigid.parameters.places, rigid.values, strict=True))
    joint_of = {int(row): j for j, row in enumerate(numbers.rotors)}
    values = np.zeros(len(parameters.places))
    shared = []  # inertias, and constant torques, as which a weight may act
    for c, place in enumerate(parameters.places):
        if place.of is NumberOf.LINK or (place.of is NumberOf.MASS and place.column in (0, 3)):
            shared.append(c)
        elif place.of is NumberOf.MASS:
            joint = joint_of.get(place.row, place.row)
            both = 0.5 if numbers.flexible[joint] else 1.0
            found_of = [known.get(NumberPlace(NumberOf.MASS, joint, column), 0.0) for column in range(7)]
            # The link's own friction is the same in both directions.
            same = found_of[1] + 0.5 * (found_of[4] + found_of[5])
            share = 1.0 if place.column == 6 else both  # what rises towards standstill is the motor's
            values[c] = share * (same if place.column == 1 else found_of[place.column])
    # What each of these is of the rigid robot's: itself if that has it, or else as it groups it.
    kept, dropped = list(rigid.parameters.places), list(rigid.parameters.dropped)
    weights = np.zeros((len(kept), len(shared)))
    began = np.zeros(len(shared))
    for i, c in enumerate(shared):
        place = parameters.places[c]
        if place.of is NumberOf.MASS:
            began[i] = wanted[joint_of[place.row]] if place.column == 0 else 0.0
            place = NumberPlace(NumberOf.MASS, joint_of[place.row], place.column)
        if place in kept:
            weights[kept.index(place), i] = 1.0
        else:
            weights[:, i] = rigid.parameters.grouping[:, dropped.index(place)]
    felt = np.any(weights != 0.0, axis=1)
    # What is known of them while the others are free: the end of a triangle that has these last.
    last = np.column_stack([rigid.information[:, ~felt], rigid.information[:, felt]])
    before = int(np.sum(~felt))
    whiten = np.asarray(np.linalg.qr(last, mode="r"))[before:, before:]
    places = [parameters.places[c] for c in shared]
    mine = [i for i, place in enumerate(places) if place.of is NumberOf.MASS and place.column == 0]
    near = np.zeros((len(mine), len(shared)))
    near[np.arange(len(mine)), mine] = [1.0 / spread[joint_of[places[i].row]] for i in mine]
    left = rigid.values[felt] - weights[felt] @ began
    rows = np.vstack([whiten @ weights[felt], near])
    norms = column_norms(rows)
    target = np.concatenate([whiten @ left, np.zeros(len(mine))])
    found = began + np.linalg.lstsq(rows / norms, target, rcond=None)[0] / norms
    for i, c in enumerate(shared):
        place = parameters.places[c]
        values[c] = found[i]
        if i in mine and numbers.flexible[joint_of[place.row]]:
            j = joint_of[place.row]
            values[c] = rotors[j] = max(float(found[i]), float(lightest[j]))
    return values, rotors


def _bounded(problem: RobotProblem[Any], start: StartOfSprings) -> RobotProblem[Any]:
    """Return the problem with each spring between the softest and the stiffest that are looked for."""
    inertias = start.rotors * start.links / (start.rotors + start.links)
    lowest, highest = (2.0 * math.pi * share / problem.sample_time for share in (_SOFTEST, _STIFFEST))

    def within(place: NumberPlace, parameter: Parameter) -> Parameter:
        if parameter.symbol != "stiffness":
            return parameter
        ends = [math.log(inertias[place.row] * w * w) for w in (lowest, highest)]
        return replace(parameter, lower=ends[0], upper=ends[1])

    free = tuple(within(place, one) for place, one in zip(problem.parameters.places, problem.free, strict=True))
    return replace(problem, parameters=replace(problem.parameters, parameters=free))


def _judge(fit: RobotFit, problem: RobotProblem[Any], joint: str, unit: str) -> SpringVerdict:
    """Return whether the records show a joint's spring."""
    stiffness, deviation = fit.value(f"{joint}.stiffness")
    compliance, spread = 1.0 / stiffness, deviation / stiffness**2
    bound = problem.free[fit.names.index(f"{joint}.stiffness")].upper
    shown = compliance > _SHOWN * spread and math.log(stiffness) < bound - _OFF
    at_least = 1.0 / (compliance + _TWO * spread)
    return SpringVerdict(joint, shown, stiffness if shown else None, deviation if shown else None, at_least, unit)
