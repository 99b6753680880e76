"""A search: one problem, one trace, and the count of every simulation it took.

The search knows how to evaluate, to repeat a step until nothing changes, and when to turn back; which step that is,
a method tells it (`didim`).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import TypeAlias

import numpy as np

from jointid.common.arrays import FloatArray
from jointid.common.errors import MethodError
from jointid.common.progress import Progress
from jointid.estimation.problems.closed_loop import ClosedLoopProblem, initial_of
from jointid.estimation.result.estimate import Iteration
from jointid.simulation.closed_loop import Outcome, Simulation
from jointid.simulation.sensitivities import simulate_with_sensitivities

_ROUNDING = 1e-10  # of the torque: an error this small is rounding
_PATIENCE = 8  # iterations without a better one: an approximate Jacobian may well go round in circles
_HALVINGS = 8  # of a step that makes things worse


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
    def Z(self) -> FloatArray:  # noqa: N802
        """The instruments of DIDIM, (rows, free): W, and for what surrounds the joint its derivatives."""
        return np.hstack([self.W, self.J[:, self.W.shape[1] :]])


@dataclass(frozen=True, slots=True)
class Limits:
    """When a search has arrived.

    Attributes:
        change: of the residual's norm, a share of it.
        step: of every parameter, likewise.
        foreseen: whether the change that the next step would make is asked, which saves making it, or that of the last.
    """

    change: float
    step: float
    foreseen: bool = False


@dataclass(frozen=True, slots=True, eq=False)
class End:
    """Where a search ended, why in a sentence, and whether that is a good end.

    `reproduced` says that the torque is met to rounding: no other answer can be better.
    """

    state: State
    stop: str
    converged: bool
    reproduced: bool = False


Step: TypeAlias = Callable[[State], FloatArray]
"""From an iterate to the next parameters."""


class Search:
    """Evaluates candidates of a problem and keeps the trace; `problem` may be exchanged for a related one."""

    def __init__(self, problem: ClosedLoopProblem, progress: Progress) -> None:
        self.problem, self.progress = problem, progress
        self.trace: list[Iteration] = []
        self.simulations = 0
        self.size = float(np.linalg.norm(problem.filtered(problem.measured)))

    def evaluate(self, x: FloatArray, gain_scale: float = 1.0) -> State:
        """Simulate one candidate with its derivatives, with the controller's gains scaled."""
        problem = self.problem
        values, names = problem.values(x), [p.name for p in problem.free]
        experiment = problem.experiment if gain_scale == 1.0 else problem.experiment.scaled(gain_scale)
        simulation, J = simulate_with_sensitivities(problem.loop, experiment, values, names, initial_of(values))
        self.simulations += 1
        W = problem.regressor(simulation)
        error, W_seen, J_seen = problem.seen(simulation, W, J)
        return State(x, simulation, error, W_seen, J_seen, problem.scales(x, W_seen, self.size), gain_scale)

    def note(self, state: State, before: State | None) -> Iteration:
        """Add a line to the trace."""
        change = step = None
        if before is not None:
            change = abs(state.norm - before.norm) / before.norm if before.norm else 0.0
            step = float(np.max(np.abs(state.x - before.x)[: state.scales.size] / state.scales))
        values, number = self.problem.values(state.x), len(self.trace)
        line = Iteration(number, values, state.norm, change, step, self.simulations, state.gain_scale)
        self.trace.append(line)
        self.progress(f"iteration {number}: torque error {100 * state.norm / self.size:.4f} %")
        return line

    def advance(self, state: State, x: FloatArray, worst: float) -> State:
        """Take a step to `x`, halved while it cannot be simulated or the error grows beyond `worst` times the last."""
        after = self.evaluate(x)
        for _ in range(_HALVINGS):
            if after.simulation.outcome is Outcome.FINISHED and after.norm <= worst * state.norm:
                break
            after = self.evaluate(0.5 * (after.x + state.x))
        return after

    def _reproduced(self, state: State) -> bool:
        """Whether the torque is met to rounding: there is nothing left that a step could follow."""
        return state.norm <= _ROUNDING * self.size

    def repeat(self, state: State, step: Step, limits: Limits, most: int, worst: float) -> End:
        """Repeat a step until nothing changes, at most so often; where it does not end well, return the best iterate.

        Raises:
            MethodError: the loop cannot be simulated.
        """
        best, since = state, 0
        for _ in range(most):
            require_simulated(state)
            if self._reproduced(state):
                break
            x = step(state)
            if limits.foreseen and (stop := _arrived(*_foreseen(state, x), limits)):
                return End(state, stop, converged=True)
            after = self.advance(state, x, worst)
            line = self.note(after, state)
            state = after
            best, since = (state, 0) if state.norm < best.norm else (best, since + 1)
            if not self._reproduced(state) and (stop := _arrived(line.change, line.step, limits)):
                return End(state, stop, converged=True)
            if since >= _PATIENCE:
                break
        require_simulated(best)
        if self._reproduced(best):
            return End(best, "the torque is reproduced to rounding", converged=True, reproduced=True)
        last = self.trace[-1]
        return End(
            best,
            f"not converged: after {last.number} iterations the residual still changes by "
            f"{100 * (last.change or 0.0):.2g} % and a parameter by {100 * (last.step or 0.0):.2g} %",
            converged=False,
        )


def _foreseen(state: State, x: FloatArray) -> tuple[float, float]:
    """Return the relative changes of the residual's norm and of the parameters that a step to `x` would make."""
    step = x - state.x
    norm = float(np.linalg.norm(state.error - state.J @ step))
    return abs(norm - state.norm) / state.norm, float(np.max(np.abs(step[: state.scales.size]) / state.scales))


def _arrived(change: float | None, step: float | None, limits: Limits) -> str | None:
    """Return why a search ends where it changes so little; None where it goes on."""
    if change is None or step is None or change > limits.change or step > limits.step:
        return None
    changed = "would change" if limits.foreseen else "changed"
    return (
        f"converged: the residual {changed} by {100 * change:.1g} % (limit {100 * limits.change:g} %) "
        f"and no parameter by more than {100 * step:.1g} % (limit {100 * limits.step:g} %)"
    )


def require_simulated(state: State) -> None:
    """Raise a `MethodError` if the loop could not be simulated to the end."""
    outcome = state.simulation.outcome
    if outcome is not Outcome.FINISHED:
        raise MethodError(
            f"DIDIM cannot go on, because {outcome.value} ({100 * state.simulation.finished:.0f} % of the record was "
            "simulated); check the sign and the unit of torque and reference and the controller's gains, or choose "
            'start = "regular".'
        )
