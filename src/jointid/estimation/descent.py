"""Descents to the least torque error, each one run of the solver.

A rigid joint is searched from each of its starts, with the motor at rest at the first sample, then moving. Nonlinear
spring and friction laws are searched from the end with linear ones: the linear spring and the friction of one line that
fit best lie between the pieces, so that everything else about the joint is nearly right there. The beginnings of the
pieces are unknown, and the criterion has several minima over them: every start of the laws is followed for a few steps,
and the best to the end.
"""

from __future__ import annotations

from collections import ChainMap
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import product
from typing import Any, NamedTuple

import numpy as np

from jointid.common.arrays import FloatArray
from jointid.common.errors import MethodError
from jointid.common.messages import Detail, Progress
from jointid.common.parameters import Bounds, Quantity
from jointid.common.text import number, pluralise
from jointid.estimation.parameters import Parameters
from jointid.estimation.problems.simulated import ClosedLoopProblem, beginning_position
from jointid.models.controllers import REFERENCE
from jointid.models.friction import PARTS, MotionSize
from jointid.models.joints import Joint
from jointid.models.springs import Spring
from jointid.simulation.simulate import Run, motion_at
from jointid.simulation.start import wound_up
from jointid.solvers.solve import Counted, LevenbergMarquardt, Solution, Status, solve
from jointid.uncertainty.covariance import INTERVAL, Influence
from jointid.uncertainty.position_dependent_error import uncertainty

_WORTH = 1e-2  # of the tolerance: a step of a closed loop that promises less is not made


def least_squares(tolerance: float, evaluations: int = 200) -> LevenbergMarquardt:
    """Return the solver of a closed loop."""
    return LevenbergMarquardt(tolerance, evaluations, worth=_WORTH * tolerance)


ROUGH = least_squares(1e-5, 30)  # the solver of a rough descent

NOTHING = 0.5
"""Of the torque: an end that leaves so much is no answer."""

ROUGHLY = 1e-3
"""Tolerance of a rigid joint that is a start."""

_CLEARLY = 25.0  # times the residual's variance: the first rows of a filter without a lag vary more than the others
_FIRST, _OUT = 10, 5.0  # rows; times the median size, which one in a hundred of ten rows of noise exceeds


class Solved(NamedTuple):
    """The end of a descent.

    Attributes:
        problem: the problem that was solved, of a joint or a robot.
        solution: where the solver ended.
    """

    problem: Any
    solution: Solution

    @property
    def x(self) -> FloatArray:
        """The solution, (free,)."""
        return self.solution.x

    @property
    def values(self) -> dict[str, float]:
        """All parameters of a joint by name."""
        found: dict[str, float] = self.problem.values(self.solution.x)
        return found

    @property
    def norm(self) -> float:
        """Norm of the residual."""
        return float(np.linalg.norm(self.solution.residual))


@dataclass(slots=True)
class History:
    """Count of a search's simulations over several problems, one after another.

    Attributes:
        progress: receives each step.
        tolerance: of the parameters and the criterion, that the search ends with.
        evaluations, admits: of a descent, at most; and whether its steps may lead to a point.
        counted: the problem that is solved, with the evaluations of all.
    """

    progress: Progress
    tolerance: float = 1e-8
    evaluations: int = 200
    admits: Callable[[FloatArray], bool] = lambda _: True
    counted: Counted = field(default_factory=Counted)

    def solve(self, problem: Any, start: FloatArray, solver: LevenbergMarquardt | None = None) -> Solved:
        """Descend from a start, by default to the tolerance, and report steps."""
        solver = replace(solver or least_squares(self.tolerance, self.evaluations), admits=self.admits)
        self.counted.problem = problem
        size = problem.size or 1.0

        def watch(norm: float) -> None:
            self.progress(Detail(f"torque error {100 * norm / size:.4f} %"))

        return Solved(problem, solve(self.counted, solver, start, watch))

    def search(self, problem: Any, starts: Iterable[FloatArray], solver: LevenbergMarquardt | None = None) -> Solved:
        """Descend from each start; return the first end of least error."""
        best, *others = (self.solve(problem, x, solver) for x in starts)
        for end in others:
            best = end if end.norm < (1.0 - _BETTER) * best.norm else best
        return best


def descend(problem: ClosedLoopProblem, start: FloatArray, tolerance: float) -> Solution:
    """Descend by least squares, neither reported nor counted."""
    return solve(problem, least_squares(tolerance), start)


def free_more(solved: Solved, names: tuple[str, ...], history: History) -> Solved:
    """Continue least squares with more surroundings of the joint free, see `surrounding`.

    Raises:
        MethodError: nothing around the joint has such a name, or one record does not determine it.
    """
    if "drive_gain" in names:
        raise MethodError(
            "One record does not separate drive_gain from the joint's scale; free log_gain or a gain of the law, or "
            "identify from two records with a known mass between them."
        )
    wider = solved.problem.freeing(*names)
    return history.solve(wider, wider.vector(solved.values))


def is_significant(resting: Solved, moving: Solved) -> bool:
    """Test whether an initial velocity significantly lowers the torque error.

    It must also exceed two robust standard deviations. A residual is usually correlated, and a motor that slips before
    it sticks has another position for the rest of the record: the gain alone would suggest a motion.
    """
    before, after = resting.norm**2, moving.norm**2
    if before - after <= _CLEARLY * before / resting.solution.residual.size:
        return False
    problem, (x, J) = moving.problem, (moving.x, -moving.solution.jacobian)
    names = [p.name for p in problem.free]
    if "initial_velocity" not in names:
        return True
    known = uncertainty(Influence(J, moving.solution.residual), problem.cells(problem.simulate(x)))
    at = names.index("initial_velocity")
    return bool(abs(x[at]) > INTERVAL * known.covariance.std[at])


# Of a rigid joint

_ROUNDING = 1e-10  # of the torque: an error this small is rounding
_BETTER = 1e-6  # of the residual: by as much a later end has to be better than an earlier one
_ASIDE = 0.25  # of the reference's largest speed: a motor may move while its reference rests


def search_rigid_joint(
    problem: ClosedLoopProblem, starts: Sequence[Mapping[str, float]], history: History, *, freed: bool = False
) -> Solved:
    """Descend from each start, and return the end of least torque error.

    Args:
        problem: of a rigid joint with linear laws.
        starts: the likeliest first.
        history: of the search.
        freed: whether more is freed from the end, which an initial motion could replace.

    Raises:
        MethodError: the loop cannot be simulated at any start, and the sentence says why at the first.
    """
    resting, failures = problem.keeping({"initial_velocity": 0.0}), list[MethodError]()

    def begin() -> Iterator[FloatArray]:
        for count, start in enumerate(starts):
            try:
                yield from first_positions(resting, start, history)[: 1 if count else None]
            except MethodError as error:
                failures.append(error)
        if len(failures) == len(starts):
            raise failures[0]

    best = history.search(resting, begin())
    if failures and not best.norm < NOTHING * problem.size:
        raise failures[0]
    rounding = _ROUNDING * problem.size

    def guess_motions() -> Iterator[Mapping[str, float]]:
        start = next((one for one in starts if one["initial_velocity"] != 0.0), best.values)
        velocity = start["initial_velocity"]
        if wound_up(problem.axis, velocity):
            yield start
        yield {"initial_velocity": velocity}
        sizes = np.abs(best.solution.residual)
        # A law that is off looks like a motion; what is free of it is found from rest.
        if not freed and np.max(sizes[:_FIRST]) > _OUT * np.median(sizes):
            steps = np.diff(problem.axis.inputs[:, REFERENCE])
            aside = _ASIDE * float(np.max(np.abs(steps))) / problem.axis.law.period
            for one in (aside, -aside):
                yield {"initial_velocity": one, "initial_position": beginning_position(problem, one)}

    # Friction makes them two problems: a motor that slips a little before it sticks is not near one that stands, so no
    # descent leads from one to the other, and of a motor at rest the derivative by its velocity is 0. The torque that
    # was held before the first sample, for the delay of the drive, is not in the log; it pushes a motor that moves, and
    # is then a part of that velocity. Where the motor moves, the end at rest may have another friction, and where the
    # law is off, the start another state.
    # A step that gains less than a tenth of one row's noise does not decide whether a motion is significant.
    near = replace(history, tolerance=max(0.1 / best.solution.residual.size, history.tolerance))
    for there in guess_motions() if best.norm > rounding else ():
        moved = near.solve(problem, problem.vector({**best.values, **there}))
        best = history.solve(problem, moved.x) if is_significant(best, moved) else best
    if best.norm <= rounding:
        exact = replace(best.solution, status=Status.EXACT, message="the torque is reproduced to rounding")
        best = best._replace(solution=exact)
    return best


def first_positions(problem: ClosedLoopProblem, start: Mapping[str, float], history: History) -> list[FloatArray]:
    """Starts with the motor at given or torque-derived positions, likelier first.

    Too small an initial friction lets a resting motor slip, and its position is lost.

    Raises:
        MethodError: the loop cannot be simulated there, or runs away.
    """
    # A regression keeps no bounds; an inertia of the wrong sign is that of a torque of the wrong sign.
    x, inertias = problem.vector(start), [p.quantity is Quantity.INERTIA for p in problem.free]
    x = np.where(np.logical_and(inertias, x < 0.0), x, Bounds.of(problem.free).clip(x))
    there, counted = problem.values(x), history.counted
    homes = dict.fromkeys((there["initial_position"], beginning_position(problem)))
    started = [problem.vector(there | {"initial_position": home}) for home in homes]
    started.sort(key=lambda one: float(np.linalg.norm(problem.residual(one))))
    counted.problem, counted.evaluations = problem, counted.evaluations + len(started)
    if not np.any(counted.linearise(started[0])[1]):
        stated = problem.values(started[0])
        joint = ", ".join(f"{p.name} {number(stated[p.name], 3)} {problem.units[p.name]}" for p in problem.free_joint)
        raise MethodError(
            f"With the joint that torque and motion give ({joint}) the declared loop is not stable, and the real one "
            "was; check the sign, gain and unit of the torque channel, and the gains of the controller."
        )
    return started


# Laws that are not linear

_STARTS = 16  # of a search, at most; steps of seven share no factor with the two, three or four starts of a term


def with_linear_spring(problem: ClosedLoopProblem) -> ClosedLoopProblem:
    """The same joint's problem with a linear spring."""
    joint: Any = problem.joint
    return problem if joint.spring.linear else problem.with_joint(replace(joint, spring=Spring()))


def from_linear_laws(problem: ClosedLoopProblem, found: Solved, history: History) -> Solved:
    """Search for nonlinear laws from the solution with linear laws or spring."""
    joint, linear = problem.joint, found.problem
    every = Parameters.of_joint(joint, (*problem.own, *linear.around))  # the motor may begin moving there
    problem = replace(problem.with_log(filtering=linear.filtering), parameters=every)
    (run,) = linear.run(found.x)
    starts = law_starts(joint, linear.joint, found.values, run, 0, {p.name: p.start for p in problem.own})
    history.progress(f"looking for laws that are not linear, from {pluralise(len(starts), 'start')}")
    end = history.solve(problem, history.search(problem, map(problem.vector, starts), ROUGH).x)
    if not end.solution.status.converged:  # along a flat valley a second descent has its damping anew
        end = history.solve(problem, end.x)
    return end._replace(solution=replace(end.solution, starts=found.solution.starts))


def law_starts(
    joint: Joint, linear: Joint, values: Mapping[str, float], run: Run, axis: int, given: Mapping[str, float | None]
) -> list[dict[str, float]]:
    """Starts of a search of a joint's laws, with all parameters' values.

    Args:
        joint: with nonlinear laws.
        linear: the same with the identified laws.
        values: of its parameters.
        run: with the linear laws.
        axis: of the joint there.
        given: stated starts, None for others.
    """
    springs: list[dict[str, float]] = [{}]
    frictions: list[dict[str, float]] = [{}]
    clock, sides = run.experiment.clock, run.numbers.rows[axis]
    positions, velocities = (moved[:, sides] for moved in motion_at(run, clock.log_index)[:2])
    if joint.springs != linear.springs:
        (law,) = joint.springs
        windup = float(np.max(np.abs(positions[:, 0] - positions[:, 1])))
        if not (values["stiffness"] > 0.0 and windup > 0.0):
            raise MethodError(
                f"A {law.name} spring is searched from a linear one, and the record shows none; identify "
                'the joint with spring = "linear", or as rigid.'
            )
        springs = list(law.starts(values, windup))
    if joint.friction != linear.friction:
        by_side = []
        for prefix, position, velocity in zip(joint.sides, positions.T, velocities.T, strict=True):
            lines = (joint.friction.mean(part, prefix) for part in PARTS)
            viscous, coulomb = (sum(by * values[name] for name, by in line.items()) for line in lines)
            speed, travel = float(np.max(np.abs(velocity))), float(np.ptp(position))
            size = MotionSize(speed, travel, clock.sample_time * clock.samples, viscous, coulomb)
            by_side.append(joint.friction.starts(size, prefix))
        frictions = [dict(ChainMap(*both)) for both in zip(*by_side, strict=True)]
    still = {} if joint.ripple is None else dict.fromkeys((p.name for p in joint.ripple.parameters), 0.0)
    stated = {name: start for name, start in given.items() if start is not None}
    each = [{**still, **values, **spring, **own, **stated} for spring, own in product(springs, frictions)]
    return [each[7 * k % len(each)] for k in range(_STARTS)] if len(each) > _STARTS else each
