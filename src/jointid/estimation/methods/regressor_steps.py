"""Steps by a regressor on the simulated motion, repeated to their fixed point.

They are the paper's form (11), and the residual form.

The regressor stands for the derivatives. Where it is no approximation of them (a torque at its limit, a slow loop, an
axis that sticks) the fixed point is not where the torque error is least.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from typing import TypeAlias

import numpy as np

from jointid.common.arrays import FloatArray, column_norms
from jointid.common.errors import MethodError
from jointid.common.messages import Detail
from jointid.common.text import number
from jointid.estimation.descent import History, Solved
from jointid.estimation.problems.closed_loop import ClosedLoopProblem, initial_of
from jointid.estimation.starts.rigid_joint import Start
from jointid.simulation.closed_loop import Outcome, Simulation
from jointid.simulation.sensitivities import simulate_with_sensitivities
from jointid.solvers.gauss_newton import GaussNewton
from jointid.solvers.regression import solution as linear_solution
from jointid.solvers.solve import Solution, Status

REPRODUCED = "the torque is reproduced to rounding"
"""How a search ends that no other can be better than."""

_NEAR = 1e-3  # of residual and parameters: with a change so small it may show whether the motor rested ...
_SURE = 1e-2  # ... if the residual's norm differs by more than this share, which is as far as it can still go
_MOVING = 9.0  # times the residual's variance: what a velocity at the first sample must explain to be believed
_WORSE = 2.0  # times the residual: with an approximate Jacobian, a little worse is no reason to turn back


@dataclass(frozen=True, slots=True, eq=False)
class State:
    """One iterate.

    Attributes:
        problem, x: the problem and its free parameters.
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

    def require_full_simulation(self) -> None:
        """Raise a `MethodError` if the loop could not be simulated to the end."""
        if not self.evaluable:
            run = self.simulation
            raise MethodError(
                f"DIDIM cannot go on, because {run.outcome.value} ({100 * run.finished:.0f} % of the record was "
                "simulated); check the sign and the unit of torque and reference and the controller's gains, or "
                'choose start = "regular".'
            )


@dataclass(frozen=True, slots=True, eq=False)
class _End:
    """The end of the steps, with its reason."""

    state: State
    status: Status
    stop: str

    def explains(self, rest: float) -> bool:
        """Test whether motion of the motor reduces the residual norm significantly below `rest`."""
        return rest**2 - self.state.norm**2 > _MOVING * rest**2 / self.state.residual.size

    def to_solution(self, history: History) -> Solved:
        """Convert to the end of a descent."""
        at = self.state
        solution = Solution(at.x, at.residual, at.jacobian, self.status, self.stop, (), history.tally.evaluations)
        return Solved(at.problem, solution, at.simulation)


_Step: TypeAlias = Callable[[State], FloatArray]


@dataclass(frozen=True, slots=True, eq=False)
class RegressorSteps:
    """The settings of the steps, see `DIDIM`, and the history of their search.

    Attributes:
        form: "residual", or "paper" for (11).
        tolerance, step_tolerance, iterations, scaled_iterations: see `DIDIM`.
        size: norm of the filtered torque.
        history: of the search.
    """

    form: str
    tolerance: float
    step_tolerance: float
    iterations: int
    scaled_iterations: int
    size: float
    history: History

    def fixed_point(self, problem: ClosedLoopProblem, first: Mapping[str, float], start: Start) -> Solved:
        """Search from a start with the motor at rest at the first sample, or moving if that explains more.

        Args:
            problem: of a rigid joint with linear laws.
            first: what is known of the first sample while the motor rests there; of all of it, no motion is tried.
            start: of the search.

        Raises:
            MethodError: the loop cannot be simulated, or the steps lead to no joint.
        """
        state, scaled = self.scale_gains(problem.keeping(first), start)
        free, most = "initial_position" not in first, max(self.iterations - scaled, 1)
        foreseen = free and self.form == "residual"
        solver = GaussNewton(self.tolerance, self.step_tolerance, most, foreseen=foreseen, worst=_WORSE, size=self.size)
        if not free:
            return self._solve(state, self._regressor_step, solver).to_solution(self.history)
        near = replace(solver, tolerance=max(solver.tolerance, _NEAR), step_tolerance=max(solver.step_tolerance, _NEAR))
        started = len(self.history.trace)
        end = self._solve(state, self._regressor_step, near)
        if end.status is not Status.EXACT:
            left = replace(solver, iterations=max(most - (len(self.history.trace) - started), 1))
            moving = self._moving(problem, end.state, start, replace(solver, iterations=self.iterations))
            sure = moving is not None and moving.explains((1.0 - _SURE) * end.state.norm)
            if end.status.converged and near != solver and not sure:
                end = self._solve(end.state, self._regressor_step, left)
            end = moving if moving is not None and moving.explains(end.state.norm) else end
        return end.to_solution(self.history)

    def scale_gains(self, problem: ClosedLoopProblem, start: Start) -> tuple[State, int]:
        """Return the state after the iterations on scaled gains, and how many these were."""
        nominal = start.nominal_inertia
        scaled = self.scaled_iterations if nominal else 0

        def scale(x: FloatArray) -> float:
            return problem.values(x)["inertia"] / nominal if nominal else 1.0

        x = problem.vector(start.values)
        state = self.evaluate(problem, x, scale(x) if scaled else 1.0)
        self.history.begin()
        self._note(state, None)
        for count in range(1, scaled + 1):
            state.require_full_simulation()
            x = self._inverse_model(state)
            after = self.evaluate(problem, x, scale(x) if count < scaled else 1.0)
            self._note(after, state)
            state = after
        return state, scaled

    def evaluate(self, problem: ClosedLoopProblem, x: FloatArray, gain_scale: float = 1.0) -> State:
        """Simulate a candidate with its derivatives, with the controller's gains scaled."""
        values, names = problem.values(x), [p.name for p in problem.free]
        experiment = problem.experiment if gain_scale == 1.0 else problem.experiment.scale(gain_scale)
        simulation, J = simulate_with_sensitivities(problem.loop, experiment, values, names, initial_of(values))
        self.history.tally.evaluations += 1
        error, W_seen, J_seen = problem.filter_error(simulation, problem.regressor(simulation), J)
        scales = problem.scales(x, W_seen, self.size)
        return State(problem, x, simulation, error, W_seen, J_seen, scales, gain_scale)

    def _note(self, state: State, before: State | None) -> None:
        last = None if before is None else (before.x, before.norm)
        number = self.history.note(state.problem, state.x, state.norm, last, state.scales, state.gain_scale)
        self.history.tell(number, state.norm / self.size)

    def _solve(self, state: State, step: _Step, solver: GaussNewton) -> _End:
        """Repeat a step until nothing changes, and where it does not lead there the exact one."""
        end = self._repeat(state, step, solver)
        if end.status.converged or self.form == "paper":
            return end
        # Where the torque stands at its limit, or the loop is slow, the regressor is no approximation of the Jacobian.
        self.history.progress(Detail("the regressor does not lead there; going on with the output sensitivities"))
        exact = replace(solver, iterations=self.iterations, worst=1.0 + self.tolerance)
        return self._repeat(end.state, lambda at: self._residual_step(at, at.J), exact)

    def _repeat(self, state: State, step: _Step, solver: GaussNewton) -> _End:
        """Repeat a step until nothing changes; where it does not end well, return the best iterate.

        Raises:
            MethodError: the loop cannot be simulated.
        """
        end = solver.iterate(lambda x: self.evaluate(state.problem, x), state, step, self._note)
        end.at.require_full_simulation()
        if end.status is Status.EXACT:
            return _End(end.at, end.status, REPRODUCED)
        if end.status.converged:
            return _End(end.at, end.status, solver.explain(end))
        last = self.history.trace[-1]
        stop = (
            f"not converged: after {last.number} iterations the residual still changes by "
            f"{100 * (last.change or 0.0):.2g} % and a parameter by {100 * (last.step or 0.0):.2g} %"
        )
        return _End(end.at, end.status, stop)

    def _moving(self, problem: ClosedLoopProblem, resting: State, start: Start, solver: GaussNewton) -> _End | None:
        """Search with the motor moving at the first sample; None where the loop cannot be simulated so."""
        velocity = {"initial_velocity": start.values["initial_velocity"]}
        try:
            state = self.evaluate(problem, problem.vector(resting.problem.values(resting.x) | velocity))
            self.history.begin()
            self._note(state, None)
            return self._solve(state, self._newton_step, solver)
        except MethodError:  # a wrong guess of the velocity may make the loop impossible to simulate
            self.history.progress(Detail("the motor cannot have been moving at the first sample"))
            return None

    def _regressor_step(self, state: State) -> FloatArray:
        """The step of the paper: the regressor stands for the Jacobian, in either form."""
        both = self._residual_step(state, state.Z)
        if self.form == "residual":
            return both
        after = self._inverse_model(state)
        known = state.W.shape[1]
        after[known:] = both[known:]  # the initial state has no inverse model: it takes the residual form
        return after

    def _newton_step(self, state: State) -> FloatArray:
        """The step towards where the first one ends, with the output sensitivities: from nearby ten times as good."""
        if self.form == "paper":
            return self._regressor_step(state)
        Z = state.Z / column_norms(state.Z)
        return np.asarray(state.x + np.linalg.lstsq(Z.T @ state.J, Z.T @ state.residual)[0])

    def _residual_step(self, state: State, J: FloatArray) -> FloatArray:
        """The Gauss-Newton step with derivatives of the torque, or what stands for them."""
        if not np.any(state.J):  # of a loop that runs away
            raise MethodError(describe_unstable(state.problem, state.x))
        return np.asarray(state.x + linear_solution(J, state.residual, tuple(p.name for p in state.problem.free)))

    def _inverse_model(self, state: State) -> FloatArray:
        """Form (11): solve ``tau = W chi`` for the joint; what surrounds it stays."""
        problem = state.problem
        kept = problem.filter(problem.measured - problem.fixed_torque(state.simulation))
        chi = linear_solution(state.W, kept, tuple(p.name for p in problem.free_joint))
        return np.concatenate([chi, state.x[chi.size :]])


def describe_unstable(problem: ClosedLoopProblem, x: FloatArray) -> str:
    """Return the sentence on a loop that runs away."""
    stated = problem.values(x)
    joint = ", ".join(f"{p.name} {number(stated[p.name], 3)} {problem.units[p.name]}" for p in problem.free_joint)
    return (
        f"With the joint that torque and motion give ({joint}) the declared loop is not stable, and the real one was; "
        "check the gain and unit of the torque channel, and the gains of the controller."
    )
