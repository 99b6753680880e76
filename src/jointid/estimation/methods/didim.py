"""DIDIM for rigid joints: direct and inverse dynamic identification models, from torque and reference only.

The closed loop is simulated at the current parameters; the inverse dynamic regressor is evaluated on the simulated
motion; least squares on the torque gives the next parameters; until nothing changes [P section IV.A].

The paper's form (11) solves ``tau = W chi``, which does not hold while an axis rests: friction then takes what it
must, not Fc. The residual form ``tau - tau_sim = W dchi`` has the truth as its fixed point wherever the axis rests,
and is the default. Both read W on the simulation, which the noise of the record cannot reach, so W acts as a set
of instruments for the output sensitivities J = d tau_sim / d chi, and the covariance is that of an
instrumental-variable estimator (`uncertainty`).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import Literal, TypeAlias

import numpy as np

from jointid.common.arrays import FloatArray
from jointid.common.errors import MethodError
from jointid.common.settings import documented, setting
from jointid.common.text import number
from jointid.estimation.methods.registry import SURROUNDINGS, Method, Task
from jointid.estimation.problems.closed_loop import ClosedLoopProblem, initial_of, torque_problem
from jointid.estimation.result.build_estimate import build_closed_loop_estimate
from jointid.estimation.result.estimate import Estimate
from jointid.estimation.search.history import MOVING, History, free_more
from jointid.estimation.search.starts import Start, given_start, inversion_start, regular_start
from jointid.models.controllers import REFERENCE
from jointid.simulation.closed_loop import Outcome, Simulation
from jointid.simulation.loop_input import ClosedLoop
from jointid.simulation.sensitivities import simulate_with_sensitivities
from jointid.solvers.gauss_newton import GaussNewton
from jointid.solvers.regression import solution as linear_solution
from jointid.solvers.solve import Status
from jointid.uncertainty.position_dependent_error import Uncertainty, uncertainty

_NEAR = 1e-3  # of residual and parameters: with a change so small it may show whether the motor rested ...
_SURE = 1e-2  # ... if the residual's norm differs by more than this share, which is as far as it can still go
_AWAY = 1e100  # a derivative so large is of a loop that runs away
_WORSE = 2.0  # times the residual: with an approximate Jacobian, a little worse is no reason to turn back

_Step: TypeAlias = Callable[["_State"], FloatArray]


@documented
@dataclass(frozen=True, slots=True)
class DIDIM(Method):
    """Settings of DIDIM."""

    name = "didim"
    title = "DIDIM"
    models = ("rigid",)
    default_for = ClosedLoop
    needs_controller = True

    form: Literal["residual", "paper"] = setting(
        "residual",
        "whether a step solves for the change of the parameters or, as (11) in the paper, for the parameters",
    )
    start: Literal["inversion", "regular", "given"] = setting(
        "inversion",
        "where the search begins: the controller turned round, a regular inertia without friction, or the starts of "
        "the parameters",
    )
    # Scaling at every iteration would bias the result where the bandwidth it assumes is not the real one.
    scaled_iterations: int = setting(
        2,
        "first iterations in which the simulated gains follow the inertia, from a regular or a given start",
        at_least=0,
    )
    tolerance: float = setting(1e-7, "change of the residual's norm to stop at, as a share", above=0)
    step_tolerance: float = setting(1e-7, "change of every parameter to stop at, too, as a share of itself", above=0)
    iterations: int = setting(30, "iterations at most", at_least=1)
    initial_state: Literal["free", "reference"] = setting(
        "free", "whether position and velocity at the first sample are estimated, or those of the reference at rest"
    )
    free: tuple[str, ...] = setting((), SURROUNDINGS)

    @classmethod
    def paper(cls) -> DIDIM:
        """Return the settings of the paper: form (11), regular start, stop at 2.5 % or after 10 iterations."""
        return cls("paper", "regular", 1, 0.025, 0.025, 10, "reference")

    def identify(self, task: Task) -> Estimate:
        """Identify a rigid joint from torque and reference; a motor position in the record is not read.

        The filter goes over torque and columns alike. With a cut-off well below the loop's bandwidth, the regressor is
        the Jacobian; above it convergence slows down.

        Raises:
            RecordError: a channel is missing.
            MethodError: the joint is flexible, the record does not determine the parameters, or the loop cannot be
                simulated at the start.
        """
        assert task.loop is not None
        problem = torque_problem(task.record, task.loop, task.filtering, task.parameters)
        choose = {"inversion": inversion_start, "regular": regular_start, "given": given_start}
        try:
            start, began = choose[self.start](problem), self.start
        except MethodError as error:
            if self.start != "inversion":
                raise
            task.progress(f"from a regular start instead: {error}")
            start, began = regular_start(problem), "regular"
        search = _Search(self, problem.size, History(task.progress))
        end = search.from_start(problem, start)
        if self.free:
            end, known = search.with_free(end)
        else:
            known = _known(end.state, end.state.Z)
        state = end.state
        found = build_closed_loop_estimate(
            task.record, state.problem, state.x, state.simulation, (end.stop, end.converged), known, state.J
        )
        form = "the paper's form (11)" if self.form == "paper" else "residual form"
        return found.amended(
            settings={"variant": f"DIDIM in {form} from {'an' if began == 'inversion' else 'a'} {began} start"},
            fit={"trace": tuple(search.history.trace), "simulations": search.history.tally.evaluations},
        )


@dataclass(frozen=True, slots=True, eq=False)
class _State:
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
class _End:
    """Where a search ended, why in a sentence, and whether that is a good end.

    `reproduced` says that the torque is met to rounding: no other answer can be better.
    """

    state: _State
    stop: str
    converged: bool
    reproduced: bool = False


class _Search:
    """The search for a rigid joint: evaluates candidates, knows the steps, and decides on rest or motion at the start.

    Args:
        settings: of DIDIM.
        size: norm of the filtered torque.
        history: of its simulations and steps.
    """

    def __init__(self, settings: DIDIM, size: float, history: History) -> None:
        self.settings, self.size, self.history = settings, size, history

    def from_start(self, problem: ClosedLoopProblem, start: Start) -> _End:
        """Search from a start, the motor at rest at the first sample, or moving where that is better."""
        settings, trace = self.settings, self.history.trace
        known = {"initial_velocity": 0.0}
        if settings.initial_state == "reference":
            known["initial_position"] = float(problem.experiment.inputs[0, REFERENCE])
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

    def with_free(self, end: _End) -> tuple[_End, Uncertainty]:
        """Go on by least squares with more of what surrounds the joint free; what is known is that of least squares."""
        state, settings, history = end.state, self.settings, History(self.history.progress)
        problem, solution = free_more(state.problem, state.x, settings.free, settings.tolerance, history)
        error, slopes = history.counted(problem).linearised(solution.x)
        run, W = problem.simulate(solution.x), slopes[:, : state.W.shape[1]]
        self.history.tally.evaluations += history.tally.evaluations + 1
        after = _State(problem, solution.x, run, error, W, slopes, state.scales)
        return _End(after, solution.message, solution.converged), _known(after, slopes)

    def _evaluate(self, problem: ClosedLoopProblem, x: FloatArray, gain_scale: float = 1.0) -> _State:
        """Simulate one candidate with its derivatives, with the controller's gains scaled."""
        values, names = problem.values(x), [p.name for p in problem.free]
        experiment = problem.experiment if gain_scale == 1.0 else problem.experiment.scaled(gain_scale)
        simulation, J = simulate_with_sensitivities(problem.loop, experiment, values, names, initial_of(values))
        self.history.tally.evaluations += 1
        error, W_seen, J_seen = problem.seen(simulation, problem.regressor(simulation), J)
        scales = problem.scales(x, W_seen, self.size)
        return _State(problem, x, simulation, error, W_seen, J_seen, scales, gain_scale)

    def _note(self, state: _State, before: _State | None) -> None:
        last = None if before is None else (before.x, before.norm)
        number = self.history.note(state.problem, state.x, state.norm, last, state.scales, state.gain_scale)
        self.history.progress(f"iteration {number}: torque error {100 * state.norm / self.size:.4f} %")

    def _begin(self, problem: ClosedLoopProblem, start: Start) -> tuple[_State, int]:
        """Return where the search stands after its iterations on scaled gains, and how many these were."""
        nominal = start.nominal_inertia
        scaled = self.settings.scaled_iterations if nominal else 0

        def scale(x: FloatArray) -> float:
            return problem.values(x)["inertia"] / nominal if nominal else 1.0

        x = problem.vector(start.values)
        state = self._evaluate(problem, x, scale(x) if scaled else 1.0)
        self._note(state, None)
        for count in range(1, scaled + 1):
            _require_simulated(state)
            x = self._inverse_model(state)
            after = self._evaluate(problem, x, scale(x) if count < scaled else 1.0)
            self._note(after, state)
            state = after
        return state, scaled

    def _solve(self, state: _State, step: _Step, solver: GaussNewton) -> _End:
        """Repeat a step on the true gains until nothing changes, and where it does not lead there the exact one."""
        end = self._repeat(state, step, solver)
        if end.converged or self.settings.form == "paper":
            return end
        # Where the torque stands at its limit, or the loop is slow, the regressor is no approximation of the Jacobian.
        self.history.progress("the regressor does not lead there; going on with the output sensitivities")
        exact = replace(solver, iterations=self.settings.iterations, worst=1.0 + self.settings.tolerance)
        return self._repeat(end.state, lambda at: self._residual_step(at, at.J), exact)

    def _repeat(self, state: _State, step: _Step, solver: GaussNewton) -> _End:
        """Repeat a step until nothing changes; where it does not end well, return the best iterate.

        Raises:
            MethodError: the loop cannot be simulated.
        """
        end = solver.iterate(lambda x: self._evaluate(state.problem, x), state, step, self._note)
        _require_simulated(end.at)
        if end.status is Status.EXACT:
            return _End(end.at, "the torque is reproduced to rounding", converged=True, reproduced=True)
        if end.status.converged:
            return _End(end.at, solver.explain(end), converged=True)
        last = self.history.trace[-1]
        stop = (
            f"not converged: after {last.number} iterations the residual still changes by "
            f"{100 * (last.change or 0.0):.2g} % and a parameter by {100 * (last.step or 0.0):.2g} %"
        )
        return _End(end.at, stop, converged=False)

    def _moving(self, problem: ClosedLoopProblem, resting: _State, start: Start, solver: GaussNewton) -> _End | None:
        """Return the answer for a motor that moves at the first sample; None where the loop cannot be simulated so.

        Friction makes them two problems: a motor that slips a little before it sticks is not near one that stands, so
        no search gets from one to the other.
        """
        velocity = {"initial_velocity": start.values["initial_velocity"]}
        try:
            state = self._evaluate(problem, problem.vector(resting.problem.values(resting.x) | velocity))
            self._note(state, None)
            return self._solve(state, self._newton_step, solver)
        except MethodError:  # a wrong guess of the velocity may make the loop impossible to simulate
            self.history.progress("the motor cannot have been moving at the first sample")
            return None

    def _regressor_step(self, state: _State) -> FloatArray:
        """The step of the paper: the regressor stands for the Jacobian, in either form."""
        both = self._residual_step(state, state.Z)
        if self.settings.form == "residual":
            return both
        after = self._inverse_model(state)
        known = state.W.shape[1]
        after[known:] = both[known:]  # the initial state has no inverse model: it takes the residual form
        return after

    def _newton_step(self, state: _State) -> FloatArray:
        """The step towards where the first one ends, with the output sensitivities: from nearby ten times as good."""
        if self.settings.form == "paper":
            return self._regressor_step(state)
        Z = state.Z / np.linalg.norm(state.Z, axis=0)
        return np.asarray(state.x + np.linalg.lstsq(Z.T @ state.J, Z.T @ state.residual)[0])

    def _residual_step(self, state: _State, J: FloatArray) -> FloatArray:
        """The Gauss-Newton step with derivatives of the torque, or what stands for them."""
        problem = state.problem
        if not np.max(np.abs(J)) < _AWAY:
            told = problem.values(state.x)
            joint = ", ".join(f"{p.name} {number(told[p.name], 3)} {problem.units[p.name]}" for p in problem.free_joint)
            raise MethodError(
                f"With the joint that torque and motion give ({joint}) the declared loop is not stable, and the real "
                "one was; check the gain and unit of the torque channel, and the gains of the controller."
            )
        return np.asarray(state.x + linear_solution(J, state.residual, tuple(p.name for p in problem.free)))

    def _inverse_model(self, state: _State) -> FloatArray:
        """Form (11): solve ``tau = W chi`` for the joint; what surrounds it stays."""
        problem = state.problem
        kept = problem.filtered(problem.measured - problem.fixed_torque(state.simulation))
        chi = linear_solution(state.W, kept, tuple(p.name for p in problem.free_joint))
        return np.concatenate([chi, state.x[chi.size :]])


def _require_simulated(state: _State) -> None:
    """Raise a `MethodError` if the loop could not be simulated to the end."""
    if not state.evaluable:
        raise MethodError(
            f"DIDIM cannot go on, because {state.simulation.outcome.value} ({100 * state.simulation.finished:.0f} % of "
            "the record was simulated); check the sign and the unit of torque and reference and the controller's "
            'gains, or choose start = "regular".'
        )


def _explains(moving: _End, rest: float) -> bool:
    """Whether a motor that moves leaves so much less than the norm that is left at rest that it is to be believed."""
    return rest**2 - moving.state.norm**2 > MOVING * rest**2 / moving.state.residual.size


def _known(state: _State, Z: FloatArray) -> Uncertainty:
    """Return what is known of the free parameters, solved with Z as instruments."""
    problem, names = state.problem, [p.name for p in state.problem.free]
    return uncertainty(Z, state.J, state.residual, problem.cells(state.simulation), names, problem.torque_unit)
