"""A search from torque alone for a rigid joint: its iterates, its trace, and the count of every simulation it took.

The search evaluates candidates; `GaussNewton` repeats a step until nothing changes; which step that is, a method tells
(`didim`).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import TypeAlias

import numpy as np

from jointid.common.arrays import FloatArray
from jointid.common.errors import MethodError
from jointid.common.progress import Progress
from jointid.estimation.problems.closed_loop import ClosedLoopProblem, initial_of
from jointid.estimation.result.parts import Iteration
from jointid.simulation.closed_loop import Outcome, Simulation
from jointid.simulation.sensitivities import simulate_with_sensitivities
from jointid.solvers.gauss_newton import GaussNewton
from jointid.solvers.solution import Status


@dataclass(frozen=True, slots=True, eq=False)
class State:
    """One iterate.

    Attributes:
        x: the free parameters.
        simulation: of the loop with them.
        error: filtered torque error, (rows,).
        W: (rows, free of the joint) the inverse-dynamic regressor on the simulation, filtered.
        J: (rows, free) the derivatives of the simulated torque, filtered.
        scales: (free of the joint,) what their changes are measured against.
        gain_scale: factor on the simulated controller's gains.
        norm: of the error.
    """

    x: FloatArray
    simulation: Simulation
    error: FloatArray
    W: FloatArray
    J: FloatArray
    scales: FloatArray
    gain_scale: float = 1.0
    norm: float = field(init=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "norm", float(np.linalg.norm(self.error)))

    @property
    def residual(self) -> FloatArray:
        """The filtered torque error, (rows,)."""
        return self.error

    @property
    def jacobian(self) -> FloatArray:
        """The derivatives of the error, (rows, free)."""
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

    problem: ClosedLoopProblem
    state: State
    stop: str
    converged: bool
    reproduced: bool = False


Step: TypeAlias = Callable[[State], FloatArray]
"""From an iterate to the next parameters."""


class Search:
    """Evaluates candidates of related problems, counts the simulations and keeps the trace.

    Attributes:
        size: norm of the filtered torque.
        progress: is told the iterations.
    """

    def __init__(self, size: float, progress: Progress) -> None:
        self.size, self.progress = size, progress
        self.trace: list[Iteration] = []
        self.simulations = 0

    def evaluate(self, problem: ClosedLoopProblem, x: FloatArray, gain_scale: float = 1.0) -> State:
        """Simulate one candidate with its derivatives, with the controller's gains scaled."""
        values, names = problem.values(x), [p.name for p in problem.free]
        experiment = problem.experiment if gain_scale == 1.0 else problem.experiment.scaled(gain_scale)
        simulation, J = simulate_with_sensitivities(problem.loop, experiment, values, names, initial_of(values))
        self.simulations += 1
        W = problem.regressor(simulation)
        error, W_seen, J_seen = problem.seen(simulation, W, J)
        return State(x, simulation, error, W_seen, J_seen, problem.scales(x, W_seen, self.size), gain_scale)

    def note(self, problem: ClosedLoopProblem, state: State, before: State | None) -> None:
        """Add a line to the trace."""
        change = step = None
        if before is not None:
            change = abs(state.norm - before.norm) / before.norm if before.norm else 0.0
            step = float(np.max(np.abs(state.x - before.x)[: state.scales.size] / state.scales))
        values, number = problem.values(state.x), len(self.trace)
        self.trace.append(Iteration(number, values, state.norm, change, step, self.simulations, state.gain_scale))
        self.progress(f"iteration {number}: torque error {100 * state.norm / self.size:.4f} %")

    def repeat(self, problem: ClosedLoopProblem, state: State, step: Step, solver: GaussNewton) -> End:
        """Repeat a step until nothing changes; where it does not end well, return the best iterate.

        Raises:
            MethodError: the loop cannot be simulated.
        """
        solver = replace(solver, size=self.size)

        def evaluate(x: FloatArray) -> State:
            return self.evaluate(problem, x)

        def note(after: State, before: State) -> None:
            self.note(problem, after, before)

        end = solver.iterate(evaluate, state, step, note)
        require_simulated(end.at)
        if end.status is Status.EXACT:
            return End(problem, end.at, "the torque is reproduced to rounding", converged=True, reproduced=True)
        if end.status.converged:
            return End(problem, end.at, solver.explain(end), converged=True)
        last = self.trace[-1]
        stop = (
            f"not converged: after {last.number} iterations the residual still changes by "
            f"{100 * (last.change or 0.0):.2g} % and a parameter by {100 * (last.step or 0.0):.2g} %"
        )
        return End(problem, end.at, stop, converged=False)


def require_simulated(state: State) -> None:
    """Raise a `MethodError` if the loop could not be simulated to the end."""
    outcome = state.simulation.outcome
    if outcome is not Outcome.FINISHED:
        raise MethodError(
            f"DIDIM cannot go on, because {outcome.value} ({100 * state.simulation.finished:.0f} % of the record was "
            "simulated); check the sign and the unit of torque and reference and the controller's gains, or choose "
            'start = "regular".'
        )
