"""The search for a rigid joint: the least torque error, from several starts."""

from __future__ import annotations

import contextlib
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from jointid.common.arrays import FloatArray
from jointid.common.errors import MethodError
from jointid.common.parameters import Bounds, Quantity
from jointid.common.text import number
from jointid.estimation.descent import History, Solved, begins_badly, least_squares, or_moving
from jointid.estimation.problems.closed_loop import ClosedLoopProblem, beginning_position, initial_of
from jointid.estimation.starts.rigid_joint import Start
from jointid.models.controllers import REFERENCE
from jointid.simulation.closed_loop import Outcome, simulate, wound_up
from jointid.solvers.regression import least_squares as linear_least_squares
from jointid.solvers.solve import Status

RESTING = {"initial_velocity": 0.0}
"""What is known of the first sample of a motor at rest."""

_ROUNDING = 1e-10  # of the torque: an error this small is rounding
_BETTER = 1e-6  # of the residual: by as much a later end has to be better than an earlier one
_EXPLAINS = 0.5  # of the torque: what an end may leave whose start led to no joint
_ASIDE = 0.25  # of the reference's largest speed: a motor may move while its reference rests
_SCALED = 2  # steps on loops whose gains follow the inertia; more would assume the bandwidth that was asked for


def search_rigid_joint(
    problem: ClosedLoopProblem, starts: Sequence[Start], tolerance: float, history: History, *, freed: bool = False
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
    if not ends:  # steps on scaled gains may lead to no joint where the start itself is one
        for start in starts:
            with contextlib.suppress(MethodError):
                first = first_positions(resting, start._replace(nominal_inertia=None), history)[0]
                ends.append(history.solve(resting, solver, first))
        if not any(end.norm < _EXPLAINS * problem.size for end in ends):
            raise failures[0]
    best = ends[0]
    for end in ends[1:]:
        best = end if end.norm < (1.0 - _BETTER) * best.norm else best
    rounding = _ROUNDING * problem.size
    if best.norm > rounding:
        # Of a motor at rest the derivative by its velocity is 0: no search leaves it. Where the motor moves, the
        # end at rest may have another friction, and where the law is off, the start another state.
        moving = next((one.values for one in starts if one.values["initial_velocity"] != 0.0), best.values)
        velocity = moving["initial_velocity"]
        near = [moving] if wound_up(problem.experiment, velocity) else []
        for there in (*near, best.values | {"initial_velocity": velocity}):
            best = or_moving(best, problem, there, tolerance, history)
        steps = np.diff(problem.experiment.inputs[:, REFERENCE])
        aside = _ASIDE * float(np.max(np.abs(steps))) / problem.experiment.law.period
        # A law that is off looks like a motion; what is free of it is found from rest.
        for velocity in (aside, -aside) if begins_badly(best) and not freed else ():
            home = beginning_position(problem, velocity)
            there = best.values | {"initial_velocity": velocity, "initial_position": home}
            best = or_moving(best, problem, there, tolerance, history)
    if best.norm <= rounding:
        exact = replace(best.solution, status=Status.EXACT, message="the torque is reproduced to rounding")
        best = best._replace(solution=exact)
    return best


def first_positions(problem: ClosedLoopProblem, start: Start, history: History) -> list[FloatArray]:
    """Return a start with the motor where the start or the torque has it, the likelier first.

    Friction that begins too small lets a motor slip that stood: then nothing tells where it stood.

    Raises:
        MethodError: the loop cannot be simulated there, or runs away.
    """
    # A regression keeps no bounds; an inertia of the wrong sign is that of a torque of the wrong sign.
    x, inertias = problem.vector(start.values), [p.quantity is Quantity.INERTIA for p in problem.free]
    x = np.where(inertias, x, Bounds.of(problem.free).clip(x))
    if start.nominal_inertia is not None:
        x = _scale_gains(problem, x, start.nominal_inertia, history)
    there, counted = problem.values(x), history.count_evaluations(problem)
    homes = dict.fromkeys((there["initial_position"], beginning_position(problem)))
    started = [problem.vector(there | {"initial_position": home}) for home in homes]
    started.sort(key=lambda one: float(np.linalg.norm(counted.residual(one))))
    if not np.any(counted.linearise(started[0])[1]):
        raise unstable(problem, started[0])
    return started


def _scale_gains(problem: ClosedLoopProblem, x: FloatArray, nominal: float, history: History) -> FloatArray:
    """Return parameters after steps of the inverse model along loops whose gains follow the inertia.

    Raises:
        MethodError: such a loop cannot be simulated.
    """
    names = tuple(p.name for p in problem.free_joint)
    for _ in range(_SCALED):
        values = problem.values(x)
        experiment = problem.experiment.scale(values["inertia"] / nominal)
        run = simulate(problem.loop, experiment, values, initial_of(values))
        history.tally.evaluations += 1
        if run.outcome is not Outcome.FINISHED:
            raise unstable(problem, x)
        torque = problem.filter(problem.measured - problem.fixed_torque(run))
        x = np.concatenate(
            [linear_least_squares(problem.filter(problem.regressor(run)), torque, names), x[len(names) :]]
        )
    return x


def unstable(problem: ClosedLoopProblem, x: FloatArray) -> MethodError:
    """Return the refusal of a loop that runs away."""
    stated = problem.values(x)
    joint = ", ".join(f"{p.name} {number(stated[p.name], 3)} {problem.units[p.name]}" for p in problem.free_joint)
    return MethodError(
        f"With the joint that torque and motion give ({joint}) the declared loop is not stable, and the real one was; "
        "check the sign, gain and unit of the torque channel, and the gains of the controller."
    )
