"""The search for a rigid joint: down to the least torque error, or step by step to the fixed point of a regressor.

**The least torque error.** From several starts, by bounded least squares with the output sensitivities, the motor at
rest at the first sample; the best end is the answer, whatever the start. Friction makes a motor that moves when the log
begins another problem: one that slips a little before it sticks is not near one that stands, so no search gets from one
to the other. It is solved from the best end, and believed where it explains more of the torque than noise could, and
where the velocity it begins with is more than two of its robust standard deviations. The torque that was held before
the first sample, for the delay of the drive, is not in the log; it pushes a motor that moves, and is then a part of
that velocity.

**The fixed point.** Steps that a regressor on the simulated motion gives, in the place of the derivatives: the paper's
form (11), and the residual form. Where the regressor is no approximation of the derivatives (a torque at its limit, a
slow loop, an axis that sticks) the fixed point is not where the torque error is least.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, TypeAlias

import numpy as np

from jointid.common.arrays import FloatArray, column_norms
from jointid.common.errors import MethodError
from jointid.common.text import number
from jointid.estimation.methods.search import MOVING, History, Solved, Start, begins_moving, free_more, least_squares
from jointid.estimation.methods.search_in_pieces import from_linear_laws
from jointid.estimation.problems.closed_loop import ClosedLoopProblem, beginning_position, initial_of
from jointid.models.controllers import REFERENCE
from jointid.simulation.closed_loop import Outcome, Simulation
from jointid.simulation.sensitivities import simulate_with_sensitivities
from jointid.solvers.gauss_newton import GaussNewton
from jointid.solvers.regression import refuse_idle
from jointid.solvers.regression import solution as linear_solution
from jointid.solvers.solve import Status
from jointid.uncertainty.position_dependent_error import Uncertainty, uncertainty

if TYPE_CHECKING:
    from jointid.estimation.methods.didim import DIDIM

_NEAR = 1e-3  # of residual and parameters: with a change so small it may show whether the motor rested ...
_SURE = 1e-2  # ... if the residual's norm differs by more than this share, which is as far as it can still go
_ROUNDING = 1e-10  # of the torque: an error this small is rounding
_BETTER = 1e-6  # of the residual: by as much a later end has to be better than an earlier one
_REPRODUCED = "the torque is reproduced to rounding"
_WORSE = 2.0  # times the residual: with an approximate Jacobian, a little worse is no reason to turn back

_Step: TypeAlias = Callable[["State"], FloatArray]


@dataclass(frozen=True, slots=True, eq=False)
class State:
    """One iterate.

    Attributes:
        problem: that is solved.
        x: the free parameters.
        simulation: of the loop with them.
        residual: filtered torque error, (rows,).
        W: (rows, free of the joint) the inverse-dynamic regressor on the simulation, filtered.
        J: (rows, free) the derivatives of the simulated torque, filtered.
        scales: (free of the joint,) what their changes are measured against.
        gain_scale: factor on the simulated controller's gains.
        norm: of the residual.
    """

    problem: ClosedLoopProblem
    x: FloatArray
    simulation: Simulation
    residual: FloatArray
    W: FloatArray
    J: FloatArray
    scales: FloatArray
    gain_scale: float = 1.0
    norm: float = field(init=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "norm", float(np.linalg.norm(self.residual)))

    @property
    def jacobian(self) -> FloatArray:
        """The derivatives of the residual, (rows, free)."""
        return -self.J

    @property
    def evaluable(self) -> bool:
        """Whether the loop could be simulated to the end."""
        return self.simulation.outcome is Outcome.FINISHED

    @property
    def Z(self) -> FloatArray:  # noqa: N802
        """The instruments of DIDIM, (rows, free): W, and for what surrounds the joint its derivatives."""
        return np.hstack([self.W, self.J[:, self.W.shape[1] :]])


@dataclass(frozen=True, slots=True, eq=False)
class End:
    """Where a search ended, why in a sentence, and whether that is a good end.

    `reproduced` says that the torque is met to rounding: no other answer can be better.
    """

    state: State
    stop: str
    converged: bool
    reproduced: bool = False


class RigidSearch:
    """The search for a rigid joint; it counts its simulations and notes its steps.

    Args:
        settings: of DIDIM.
        size: norm of the filtered torque.
        history: of its simulations and steps.
    """

    def __init__(self, settings: DIDIM, size: float, history: History) -> None:
        self.settings, self.size, self.history = settings, size, history

    def least_torque_error(self, problem: ClosedLoopProblem, starts: Sequence[Start]) -> End:
        """Search from each start for the least torque error, and return the best end.

        Raises:
            MethodError: the loop cannot be simulated at any start, and the sentence says why at the first; or the
                motion that was found excites a parameter of the joint nowhere.
        """
        resting, ends, failures = problem.keeping(self._beginning(problem)), list[Solved](), list[MethodError]()
        for count, start in enumerate(starts):
            try:
                begun = self._begun(resting, start)
            except MethodError as error:
                failures.append(error)
                continue
            for x in begun[: 1 if count else None]:
                ends.append(self.history.solve(resting, least_squares(resting, self.settings.tolerance), x))
        if not ends:
            raise failures[0]
        best = ends[0]
        for end in ends[1:]:
            best = end if _left(end) < (1.0 - _BETTER) * _left(best) else best
        if self.settings.initial_state == "free" and _left(best) > _ROUNDING * self.size:
            best = self._or_moving(problem, best, starts)
        state, ended = self._evaluate(best.problem, best.solution.x), best.solution
        names = tuple(p.name for p in best.problem.free_joint)
        refuse_idle(state.J[:, : len(names)], names)
        if state.norm <= _ROUNDING * self.size:
            return End(state, _REPRODUCED, converged=True, reproduced=True)
        return End(state, ended.message, ended.converged)

    def _beginning(self, problem: ClosedLoopProblem) -> dict[str, float]:
        """Return what is known of the first sample while the motor is taken to be at rest there."""
        if self.settings.initial_state == "free":
            return {"initial_velocity": 0.0}
        return {"initial_velocity": 0.0, "initial_position": float(problem.experiment.inputs[0, REFERENCE])}

    def _begun(self, problem: ClosedLoopProblem, start: Start) -> list[FloatArray]:
        """Return where descents from a start begin, the likelier first: the motor where the start or the torque has it.

        Friction that begins too small lets a motor slip that stood: then nothing tells where it stood.

        Raises:
            MethodError: the loop cannot be simulated there, or runs away.
        """
        x = problem.vector(start.values)
        if start.nominal_inertia and self.settings.scaled_iterations:
            x = self._begin(problem, start)[0].x
        there, counted = problem.values(x), self.history.counted(problem)
        homes = dict.fromkeys((there["initial_position"], beginning_position(problem)))
        begun = [problem.vector(there | {"initial_position": home}) for home in homes]
        begun.sort(key=lambda one: float(np.linalg.norm(counted.residual(one))))
        if not np.any(counted.linearise(begun[0])[1]):
            _require_simulated(self._evaluate(problem, begun[0]))
            raise MethodError(_unstable(problem, begun[0]))
        return begun

    def _or_moving(self, problem: ClosedLoopProblem, resting: Solved, starts: Sequence[Start]) -> Solved:
        """Return the better of two answers, the motor at rest at the first sample or moving (see the module)."""
        values = resting.problem.values(resting.solution.x)
        # Of a motor at rest the derivative by its velocity is 0: no search leaves it.
        velocities = (start.values["initial_velocity"] for start in starts)
        values["initial_velocity"] = next((one for one in velocities if one != 0.0), 0.0)
        solver = least_squares(problem, self.settings.tolerance)
        moving = self.history.solve(problem, solver, problem.vector(values))
        return moving if begins_moving(resting, moving, self.history) else resting

    def fixed_point(self, problem: ClosedLoopProblem, start: Start) -> End:
        """Search for the fixed point of the regressor, the motor at rest at the first sample, or moving if better."""
        settings, trace = self.settings, self.history.trace
        known = self._beginning(problem)
        state, scaled = self._begin(problem.keeping(known), start)
        free, most = settings.initial_state == "free", max(settings.iterations - scaled, 1)
        foreseen = free and settings.form == "residual"
        solver = GaussNewton(
            settings.tolerance, settings.step_tolerance, most, foreseen=foreseen, worst=_WORSE, size=self.size
        )
        if not free:
            return self._solve(state, self._regressor_step, solver)
        near = replace(solver, tolerance=max(solver.tolerance, _NEAR), step_tolerance=max(solver.step_tolerance, _NEAR))
        begun = len(trace)
        resting = self._solve(state, self._regressor_step, near)
        if resting.reproduced:
            return resting
        left = replace(solver, iterations=max(most - (len(trace) - begun), 1))
        moving = self._moving(problem, resting.state, start, replace(solver, iterations=settings.iterations))
        rough = resting.converged and near != solver
        if rough and not (moving and _explains(moving, (1.0 - _SURE) * resting.state.norm)):
            resting = self._solve(resting.state, self._regressor_step, left)
        return moving if moving and _explains(moving, resting.state.norm) else resting

    def go_on(self, problem: ClosedLoopProblem, end: End, free: tuple[str, ...]) -> End:
        """Go on with laws in pieces from where linear ones ended, and with more of what surrounds the joint free."""
        tolerance, history, there = self.settings.tolerance, self.history, end.state
        solution = history.solve(there.problem, least_squares(there.problem, tolerance), there.x)
        solved = from_linear_laws(problem, solution, tolerance, history)
        if free:
            solved = free_more(solved.problem, solved.solution.x, free, tolerance, history)
        problem, x = solved.problem, solved.solution.x
        error, slopes = history.counted(problem).linearise(x)
        names = tuple(p.name for p in problem.free_joint)
        refuse_idle(slopes[:, : len(names)], names)
        after = State(problem, x, problem.simulate(x), error, slopes, slopes, np.ones(len(names)))
        history.tally.evaluations += 1
        return End(after, solved.solution.message, solved.solution.converged)

    def with_free(self, end: End) -> End:
        """Go on by least squares with more of what surrounds the joint free."""
        state, settings, history = end.state, self.settings, History(self.history.progress)
        problem, solution = free_more(state.problem, state.x, settings.free, settings.tolerance, history)
        error, slopes = history.counted(problem).linearise(solution.x)
        run, W = problem.simulate(solution.x), slopes[:, : state.W.shape[1]]
        self.history.tally.evaluations += history.tally.evaluations + 1
        after = State(problem, solution.x, run, error, W, slopes, state.scales)
        return End(after, solution.message, solution.converged)

    def _evaluate(self, problem: ClosedLoopProblem, x: FloatArray, gain_scale: float = 1.0) -> State:
        """Simulate one candidate with its derivatives, with the controller's gains scaled."""
        values, names = problem.values(x), [p.name for p in problem.free]
        experiment = problem.experiment if gain_scale == 1.0 else problem.experiment.scale(gain_scale)
        simulation, J = simulate_with_sensitivities(problem.loop, experiment, values, names, initial_of(values))
        self.history.tally.evaluations += 1
        error, W_seen, J_seen = problem.seen(simulation, problem.regressor(simulation), J)
        scales = problem.scales(x, W_seen, self.size)
        return State(problem, x, simulation, error, W_seen, J_seen, scales, gain_scale)

    def _note(self, state: State, before: State | None) -> None:
        last = None if before is None else (before.x, before.norm)
        number = self.history.note(state.problem, state.x, state.norm, last, state.scales, state.gain_scale)
        self.history.tell(number, state.norm / self.size)

    def _begin(self, problem: ClosedLoopProblem, start: Start) -> tuple[State, int]:
        """Return where the search stands after its iterations on scaled gains, and how many these were."""
        nominal = start.nominal_inertia
        scaled = self.settings.scaled_iterations if nominal else 0

        def scale(x: FloatArray) -> float:
            return problem.values(x)["inertia"] / nominal if nominal else 1.0

        x = problem.vector(start.values)
        state = self._evaluate(problem, x, scale(x) if scaled else 1.0)
        self.history.begin()
        self._note(state, None)
        for count in range(1, scaled + 1):
            _require_simulated(state)
            x = self._inverse_model(state)
            after = self._evaluate(problem, x, scale(x) if count < scaled else 1.0)
            self._note(after, state)
            state = after
        return state, scaled

    def _solve(self, state: State, step: _Step, solver: GaussNewton) -> End:
        """Repeat a step on the true gains until nothing changes, and where it does not lead there the exact one."""
        end = self._repeat(state, step, solver)
        if end.converged or self.settings.form == "paper":
            return end
        # Where the torque stands at its limit, or the loop is slow, the regressor is no approximation of the Jacobian.
        self.history.progress("the regressor does not lead there; going on with the output sensitivities")
        exact = replace(solver, iterations=self.settings.iterations, worst=1.0 + self.settings.tolerance)
        return self._repeat(end.state, lambda at: self._residual_step(at, at.J), exact)

    def _repeat(self, state: State, step: _Step, solver: GaussNewton) -> End:
        """Repeat a step until nothing changes; where it does not end well, return the best iterate.

        Raises:
            MethodError: the loop cannot be simulated.
        """
        end = solver.iterate(lambda x: self._evaluate(state.problem, x), state, step, self._note)
        _require_simulated(end.at)
        if end.status is Status.EXACT:
            return End(end.at, _REPRODUCED, converged=True, reproduced=True)
        if end.status.converged:
            return End(end.at, solver.explain(end), converged=True)
        last = self.history.trace[-1]
        stop = (
            f"not converged: after {last.number} iterations the residual still changes by "
            f"{100 * (last.change or 0.0):.2g} % and a parameter by {100 * (last.step or 0.0):.2g} %"
        )
        return End(end.at, stop, converged=False)

    def _moving(self, problem: ClosedLoopProblem, resting: State, start: Start, solver: GaussNewton) -> End | None:
        """Return the answer for a motor that moves at the first sample; None where the loop cannot be simulated so.

        Friction makes them two problems: a motor that slips a little before it sticks is not near one that stands, so
        no search gets from one to the other.
        """
        velocity = {"initial_velocity": start.values["initial_velocity"]}
        try:
            state = self._evaluate(problem, problem.vector(resting.problem.values(resting.x) | velocity))
            self.history.begin()
            self._note(state, None)
            return self._solve(state, self._newton_step, solver)
        except MethodError:  # a wrong guess of the velocity may make the loop impossible to simulate
            self.history.progress("the motor cannot have been moving at the first sample")
            return None

    def _regressor_step(self, state: State) -> FloatArray:
        """The step of the paper: the regressor stands for the Jacobian, in either form."""
        both = self._residual_step(state, state.Z)
        if self.settings.form == "residual":
            return both
        after = self._inverse_model(state)
        known = state.W.shape[1]
        after[known:] = both[known:]  # the initial state has no inverse model: it takes the residual form
        return after

    def _newton_step(self, state: State) -> FloatArray:
        """The step towards where the first one ends, with the output sensitivities: from nearby ten times as good."""
        if self.settings.form == "paper":
            return self._regressor_step(state)
        Z = state.Z / column_norms(state.Z)
        return np.asarray(state.x + np.linalg.lstsq(Z.T @ state.J, Z.T @ state.residual)[0])

    def _residual_step(self, state: State, J: FloatArray) -> FloatArray:
        """The Gauss-Newton step with derivatives of the torque, or what stands for them."""
        problem = state.problem
        if not np.any(state.J):  # of a loop that runs away
            raise MethodError(_unstable(problem, state.x))
        return np.asarray(state.x + linear_solution(J, state.residual, tuple(p.name for p in problem.free)))

    def _inverse_model(self, state: State) -> FloatArray:
        """Form (11): solve ``tau = W chi`` for the joint; what surrounds it stays."""
        problem = state.problem
        kept = problem.filtered(problem.measured - problem.fixed_torque(state.simulation))
        chi = linear_solution(state.W, kept, tuple(p.name for p in problem.free_joint))
        return np.concatenate([chi, state.x[chi.size :]])


def _left(solved: Solved) -> float:
    """Return the norm of what a descent left."""
    return float(np.linalg.norm(solved.solution.residual))


def _unstable(problem: ClosedLoopProblem, x: FloatArray) -> str:
    """Return the sentence on a loop that runs away."""
    told = problem.values(x)
    joint = ", ".join(f"{p.name} {number(told[p.name], 3)} {problem.units[p.name]}" for p in problem.free_joint)
    return (
        f"With the joint that torque and motion give ({joint}) the declared loop is not stable, and the real one was; "
        "check the gain and unit of the torque channel, and the gains of the controller."
    )


def _require_simulated(state: State) -> None:
    """Raise a `MethodError` if the loop could not be simulated to the end."""
    if not state.evaluable:
        raise MethodError(
            f"DIDIM cannot go on, because {state.simulation.outcome.value} ({100 * state.simulation.finished:.0f} % of "
            "the record was simulated); check the sign and the unit of torque and reference and the controller's "
            'gains, or choose start = "regular".'
        )


def _explains(moving: End, rest: float) -> bool:
    """Whether a motor that moves leaves so much less than the norm that is left at rest that it is to be believed."""
    return rest**2 - moving.state.norm**2 > MOVING * rest**2 / moving.state.residual.size


def known_of_fixed_point(state: State) -> Uncertainty:
    """Return what is known of the free parameters, solved with the regressor as instruments."""
    problem, names = state.problem, [p.name for p in state.problem.free]
    return uncertainty(state.Z, state.J, state.residual, problem.cells(state.simulation), names, problem.torque_unit)
