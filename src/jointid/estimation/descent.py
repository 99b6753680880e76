"""Descents to the least torque error: one run of the solver each, counted and reported."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np

from jointid.common.arrays import FloatArray
from jointid.common.errors import MethodError
from jointid.common.messages import Detail, Progress
from jointid.common.parameters import Bounds, Quantity
from jointid.common.text import number
from jointid.estimation.problems.closed_loop import ClosedLoopProblem, beginning_position
from jointid.models.controllers import REFERENCE
from jointid.simulation.start import wound_up
from jointid.solvers.bounded_least_squares import LevenbergMarquardt
from jointid.solvers.solve import Counted, Solution, Status, Step, Tally, solve
from jointid.uncertainty.covariance import Influence
from jointid.uncertainty.position_dependent_error import uncertainty

_WORTH = 1e-2  # of the tolerance: a step of a closed loop that promises less is not made


def least_squares(tolerance: float, evaluations: int = 200) -> LevenbergMarquardt:
    """Return the solver of a closed loop."""
    return LevenbergMarquardt(tolerance, evaluations, worth=_WORTH * tolerance)


ROUGH = least_squares(1e-5, 30)
"""The solver of a rough descent."""

_CLEARLY = 25.0  # times the residual's variance: the first rows of a filter without a lag vary more than the others ...
_FIRST, _OUT = 10, 5.0  # rows; times the median size, which one in a hundred of ten rows of noise exceeds
_SURELY = 2.0  # ... and robust standard deviations of that velocity


class Solved(NamedTuple):
    """The end of a descent.

    Attributes:
        problem: the problem that was solved.
        solution: where the solver ended.
    """

    problem: ClosedLoopProblem
    solution: Solution

    @property
    def x(self) -> FloatArray:
        """The free parameters, (free,)."""
        return self.solution.x

    @property
    def values(self) -> dict[str, float]:
        """All parameters by name."""
        return self.problem.values(self.solution.x)

    @property
    def norm(self) -> float:
        """Norm of the residual."""
        return float(np.linalg.norm(self.solution.residual))

    def with_starts(self, starts: tuple[int, int]) -> Solved:
        """Return the end with another count of the starts that led there, and of all."""
        return self._replace(solution=replace(self.solution, starts=starts))


class History:
    """The simulations of a search that solves several problems, one after the other."""

    def __init__(self, progress: Progress) -> None:
        self.progress, self.tally = progress, Tally()
        self._last: Counted | None = None
        self._starts, self._best = 0, math.inf

    def count_evaluations(self, problem: Any) -> Counted:
        """Return the problem with counted evaluations; it remembers the last point that was linearised."""
        if self._last is None or self._last.problem is not problem:
            self._last = Counted(problem, self.tally)
        return self._last

    def solve(self, problem: ClosedLoopProblem, solver: LevenbergMarquardt, start: FloatArray) -> Solved:
        """Descend from a start, and report the steps."""
        return Solved(problem, self.report(problem, solver, start))

    def report(self, problem: Any, solver: LevenbergMarquardt, start: FloatArray) -> Solution:
        """Return the end of a descent of a joint or a robot, and report the steps."""
        size = problem.size or 1.0
        self._starts += 1

        def watch(step: Step) -> None:
            error = step.norm / size
            which = f"start {self._starts}, " if self._starts > 1 else ""
            best = f" (best so far {100 * self._best:.4f} %)" if which and error > self._best else ""
            self._best = min(self._best, error)
            self.progress(Detail(f"{which}torque error {100 * error:.4f} %{best}"))

        return solve(self.count_evaluations(problem), solver, start, watch)

    def finish(self, rough: Solved, tolerance: float) -> Solved:
        """Descend from the end of a rough descent to the full tolerance."""
        return self.solve(rough.problem, least_squares(tolerance), rough.x)


def descend(problem: ClosedLoopProblem, start: FloatArray, tolerance: float) -> Solution:
    """Descend by least squares, neither reported nor counted."""
    return solve(problem, least_squares(tolerance), start)


def free_more(solved: Solved, names: tuple[str, ...], tolerance: float, history: History) -> Solved:
    """Go on by least squares with more of the joint's surroundings free, see `surrounding`.

    Raises:
        MethodError: nothing around the joint has such a name, or one record cannot tell it.
    """
    if isinstance(names, str):
        raise MethodError(f'What is freed is a list of names; received "{names}": write free=("{names}",).')
    if "drive_gain" in names:
        raise MethodError(
            "One record cannot tell the drive_gain from the scale of the joint; free log_gain or a gain of the law, or "
            "identify from two records with a known mass between them."
        )
    wider = solved.problem.freeing(*names)
    return history.solve(wider, least_squares(tolerance), wider.vector(solved.values))


def begins_badly(solved: Solved) -> bool:
    """Test whether the first rows of a residual stand out of the others."""
    size = np.abs(solved.solution.residual)
    return bool(np.max(size[:_FIRST]) > _OUT * np.median(size))


def or_moving(
    resting: Solved, problem: ClosedLoopProblem, values: Mapping[str, float], tolerance: float, history: History
) -> Solved:
    """Descend with the motor moving at the first sample, and return the better of both answers.

    Friction makes them two problems: a motor that slips a little before it sticks is not near one that stands, so no
    descent leads from one to the other. The torque that was held before the first sample, for the delay of the drive,
    is not in the log; it pushes a motor that moves, and is then a part of that velocity.

    Args:
        resting: the end with the motor at rest.
        problem: the same with the motor moving.
        values: where its descent begins.
        tolerance: of the descent.
        history: of the search.
    """
    moving = history.solve(problem, least_squares(tolerance), problem.vector(values))
    if not is_significant(resting, moving, history):
        return resting
    return moving.with_starts(resting.solution.starts)


def is_significant(resting: Solved, moving: Solved, history: History) -> bool:
    """Test whether a first velocity explains more torque than noise, and is above two robust standard deviations.

    A residual is correlated as a rule, and a motor that slips before it sticks changes where it stands for the rest of
    the record: the gain alone would invent a motion.
    """
    before, after = resting.norm**2, moving.norm**2
    if before - after <= _CLEARLY * before / resting.solution.residual.size:
        return False
    problem, (x, J) = moving.problem, (moving.x, -moving.solution.jacobian)
    names = [p.name for p in problem.free]
    if "initial_velocity" not in names:
        return True
    history.tally.evaluations += 1
    known = uncertainty(Influence(J, moving.solution.residual), problem.cells(problem.simulate(x)))
    at = names.index("initial_velocity")
    return bool(abs(x[at]) > _SURELY * known.covariance.std[at])


# Of a rigid joint

RESTING = {"initial_velocity": 0.0}
"""What is known of the first sample of a motor at rest."""

_ROUNDING = 1e-10  # of the torque: an error this small is rounding
_BETTER = 1e-6  # of the residual: by as much a later end has to be better than an earlier one
_EXPLAINS = 0.5  # of the torque: what an end may leave whose start led to no joint
_ASIDE = 0.25  # of the reference's largest speed: a motor may move while its reference rests


def search_rigid_joint(
    problem: ClosedLoopProblem,
    starts: Sequence[Mapping[str, float]],
    tolerance: float,
    history: History,
    *,
    freed: bool = False,
) -> Solved:
    """Descend from each start to the least torque error, and return the best end.

    Args:
        problem: of a rigid joint with linear laws.
        starts: the likeliest first.
        tolerance: of the criterion and the parameters.
        history: of the search.
        freed: whether more is freed from the end, in whose place a motion at the first sample could stand.

    Raises:
        MethodError: the loop cannot be simulated at any start, and the sentence says why at the first.
    """
    resting, ends, failures = problem.keeping(RESTING), list[Solved](), list[MethodError]()
    solver = least_squares(tolerance)
    for count, start in enumerate(starts):
        try:
            started = first_positions(resting, start, history)
        except MethodError as error:
            failures.append(error)
            continue
        ends += [history.solve(resting, solver, x) for x in started[: 1 if count else None]]
    if failures and not any(end.norm < _EXPLAINS * problem.size for end in ends):
        raise failures[0]
    best = ends[0]
    for end in ends[1:]:
        best = end if end.norm < (1.0 - _BETTER) * best.norm else best
    rounding = _ROUNDING * problem.size
    if best.norm > rounding:
        # Of a motor at rest the derivative by its velocity is 0: no search leaves it. Where the motor moves, the
        # end at rest may have another friction, and where the law is off, the start another state.
        moving = next((one for one in starts if one["initial_velocity"] != 0.0), best.values)
        velocity = moving["initial_velocity"]
        near = [moving] if wound_up(problem.axis, velocity) else []
        for there in (*near, best.values | {"initial_velocity": velocity}):
            best = or_moving(best, problem, there, tolerance, history)
        steps = np.diff(problem.axis.inputs[:, REFERENCE])
        aside = _ASIDE * float(np.max(np.abs(steps))) / problem.axis.law.period
        # A law that is off looks like a motion; what is free of it is found from rest.
        for velocity in (aside, -aside) if begins_badly(best) and not freed else ():
            home = beginning_position(problem, velocity)
            there = best.values | {"initial_velocity": velocity, "initial_position": home}
            best = or_moving(best, problem, there, tolerance, history)
    if best.norm <= rounding:
        exact = replace(best.solution, status=Status.EXACT, message="the torque is reproduced to rounding")
        best = best._replace(solution=exact)
    return best


def first_positions(problem: ClosedLoopProblem, start: Mapping[str, float], history: History) -> list[FloatArray]:
    """Return a start with the motor where the start or the torque has it, the likelier first.

    Friction that begins too small lets a motor slip that stood: then nothing tells where it stood.

    Raises:
        MethodError: the loop cannot be simulated there, or runs away.
    """
    # A regression keeps no bounds; an inertia of the wrong sign is that of a torque of the wrong sign.
    x, inertias = problem.vector(start), [p.quantity is Quantity.INERTIA for p in problem.free]
    x = np.where(inertias, x, Bounds.of(problem.free).clip(x))
    there, counted = problem.values(x), history.count_evaluations(problem)
    homes = dict.fromkeys((there["initial_position"], beginning_position(problem)))
    started = [problem.vector(there | {"initial_position": home}) for home in homes]
    started.sort(key=lambda one: float(np.linalg.norm(counted.residual(one))))
    if not np.any(counted.linearise(started[0])[1]):
        raise unstable(problem, started[0])
    return started


def unstable(problem: ClosedLoopProblem, x: FloatArray) -> MethodError:
    """Return the refusal of a loop that runs away."""
    stated = problem.values(x)
    joint = ", ".join(f"{p.name} {number(stated[p.name], 3)} {problem.units[p.name]}" for p in problem.free_joint)
    return MethodError(
        f"With the joint that torque and motion give ({joint}) the declared loop is not stable, and the real one was; "
        "check the sign, gain and unit of the torque channel, and the gains of the controller."
    )
