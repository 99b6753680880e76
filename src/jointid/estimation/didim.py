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

from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from jointid.common.errors import MethodError
from jointid.common.progress import Progress, silent
from jointid.data.record import FloatArray, Record
from jointid.data.signals import Filtering
from jointid.estimation.answer import answer
from jointid.estimation.descent import Descent, with_free
from jointid.estimation.estimate import Estimate
from jointid.estimation.problem import Problem, torque_problem
from jointid.estimation.regression import least_squares
from jointid.estimation.search import End, Search, State, require_simulated
from jointid.estimation.starts import Start, given_start, inversion_start, regular_start
from jointid.inference.repeatable import Uncertainty, uncertainty
from jointid.model.controllers import REFERENCE
from jointid.model.parameters import Parameter
from jointid.simulation.experiment import ClosedLoop

_MOVING = 9.0  # times the residual's variance: what a velocity at the first sample must explain to be believed
_WORSE = 2.0  # times the residual: with an approximate Jacobian, a little worse is no reason to turn back


@dataclass(frozen=True, slots=True)
class DIDIM:
    """Settings of DIDIM.

    Attributes:
        form: "residual" (see the module), or "paper": (11) as printed.
        start: "inversion" of the controller; "regular": a regular inertia, no friction; "given": the starts of the
            parameters.
        scaled_iterations: for how many first iterations the simulated controller's gains are scaled with the
            inertia, from a regular or a given start. Scaling at every iteration would bias the result where the
            bandwidth it assumes is not the real one, so it always ends on the true gains.
        tolerance: stop when the residual norm changes by at most this share ...
        step_tolerance: ... and no parameter by more than this share of itself.
        iterations: at most.
        initial_state: "free" estimates where the motor is at the first sample, and whether it is at rest there or
            how fast it moves; "reference" puts it on the reference, at rest.
        free: what surrounds the joint and is identified with it, by least squares from where DIDIM ends: "kp", "kv",
            "delay", ...; see `surroundings`.
    """

    form: Literal["residual", "paper"] = "residual"
    start: Literal["inversion", "regular", "given"] = "inversion"
    scaled_iterations: int = 2
    tolerance: float = 1e-7
    step_tolerance: float = 1e-7
    iterations: int = 30
    initial_state: Literal["free", "reference"] = "free"
    free: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        choices = {
            "form": (self.form, ("residual", "paper")),
            "start": (self.start, ("inversion", "regular", "given")),
            "initial_state": (self.initial_state, ("free", "reference")),
        }
        for name, (value, allowed) in choices.items():
            if value not in allowed:
                raise MethodError(f'DIDIM\'s {name} is one of {", ".join(allowed)}; received "{value}".')
        if self.iterations < 1 or self.scaled_iterations < 0 or min(self.tolerance, self.step_tolerance) <= 0:
            raise MethodError(
                "DIDIM needs at least 1 iteration, 0 or more scaled iterations, and positive tolerances; received "
                f"{self.iterations}, {self.scaled_iterations}, {self.tolerance} and {self.step_tolerance}."
            )

    @classmethod
    def paper(cls) -> DIDIM:
        """Return the settings of the paper: form (11), regular start, stop at 2.5 % or after 10 iterations."""
        return cls("paper", "regular", 1, 0.025, 0.025, 10, "reference")


@dataclass(frozen=True, slots=True)
class _Steps:
    """The steps of DIDIM on a search, as functions of an iterate."""

    search: Search
    form: str

    def regressor(self, state: State) -> FloatArray:
        """The step of the paper: the regressor stands for the Jacobian, in either form."""
        problem = self.search.problem
        W = problem.regressor(state.simulation)
        surrounding = np.zeros((len(W), 0))
        if W.shape[1] < state.x.size:
            surrounding = self.search.sensitivities(state)[:, W.shape[1] :]
        if self.form == "residual":
            return self._residual(state, np.hstack([W, surrounding]))
        after = self.inverse_model(state)
        if surrounding.shape[1]:  # the initial state has no inverse model: it takes the residual form
            both = self._residual(state, np.hstack([W, surrounding]))
            after[W.shape[1] :] = both[W.shape[1] :]
        return after

    def exact(self, state: State) -> FloatArray:
        """The Gauss-Newton step with the output sensitivities."""
        return self._residual(state, self.search.sensitivities(state))

    def inverse_model(self, state: State) -> FloatArray:
        """Form (11): solve ``tau = W chi`` for the joint; what surrounds it stays."""
        problem = self.search.problem
        W = problem.regressor(state.simulation)
        kept = problem.measured - problem.fixed_torque(state.simulation)
        both = problem.filtered(np.column_stack([kept, W]))
        chi = least_squares(both[:, 1:], both[:, 0], tuple(p.name for p in problem.free_joint)).values
        return np.concatenate([chi, state.x[chi.size :]])

    def _residual(self, state: State, J: FloatArray) -> FloatArray:
        problem = self.search.problem
        names = tuple(p.name for p in problem.free)
        return np.asarray(state.x + least_squares(problem.filtered(J), state.error, names).values)


def _solve(search: Search, settings: DIDIM, start: Start) -> End:
    """Search from a start: first on scaled gains where it asks for it, then on the true ones."""
    steps = _Steps(search, settings.form)
    nominal = start.nominal_inertia
    scaled = settings.scaled_iterations if nominal else 0

    def scale(x: FloatArray) -> float:
        return search.problem.values(x)["inertia"] / nominal if nominal else 1.0

    x = search.problem.vector(start.values)
    state = search.evaluate(x, scale(x) if scaled else 1.0)
    search.note(state, None)
    for number in range(1, scaled + 1):
        require_simulated(state)
        x = steps.inverse_model(state)
        after = search.evaluate(x, scale(x) if number < scaled else 1.0)
        search.note(after, state)
        state = after
    end = search.repeat(state, steps.regressor, max(settings.iterations - scaled, 1), _WORSE)
    if end.converged or settings.form == "paper":
        return end
    # Where the torque stands at its limit, or the loop is slow, the regressor is no approximation of the Jacobian.
    search.progress("the regressor does not lead there; going on with the output sensitivities")
    return search.repeat(end.state, steps.exact, settings.iterations, 1.0 + settings.tolerance)


def _known(search: Search, state: State) -> tuple[Uncertainty, FloatArray]:
    """Return what is known of the free parameters (see the module), and the output sensitivities, filtered."""
    problem = search.problem
    W = problem.regressor(state.simulation)
    J = search.sensitivities(state)
    Z, J = problem.filtered(np.hstack([W, J[:, W.shape[1] :]])), problem.filtered(J)
    names = [p.name for p in problem.free]
    return uncertainty(Z, J, state.error, problem.cells(state.simulation), names, problem.torque_unit), J


def identify_didim(
    record: Record,
    loop: ClosedLoop,
    parameters: tuple[Parameter, ...],
    filtering: Filtering,
    settings: DIDIM | None = None,
    progress: Progress = silent,
) -> Estimate:
    """Identify a rigid joint from torque and reference; a motor position in the record is not read.

    Args:
        record: with the torque and what the controller reads.
        loop: rigid joint and controller.
        parameters: of the joint; free ones are estimated.
        filtering: cut-off and decimation of torque and columns alike. Well below the loop's bandwidth, the
            regressor is the Jacobian; above it convergence slows down.
        settings: see `DIDIM`.
        progress: told each iteration.

    Raises:
        RecordError: a channel is missing.
        MethodError: the joint is flexible, the record does not determine the parameters, or the loop cannot be
            simulated at the start.
    """
    settings = settings or DIDIM()
    problem = torque_problem(record, loop, filtering, parameters)
    choose = {"inversion": inversion_start, "regular": regular_start, "given": given_start}
    try:
        start, began = choose[settings.start](problem), settings.start
    except MethodError as error:
        if settings.start != "inversion":
            raise
        progress(f"from a regular start instead: {error}")
        start, began = regular_start(problem), "regular"
    search = Search(_at_rest(problem, settings), settings.tolerance, settings.step_tolerance, progress)
    end = _solve(search, settings, start)
    if settings.initial_state == "free" and not end.reproduced:
        end = _or_moving(problem, search, settings, end, start)
    if settings.free:
        end, known, J = _with_free(search, end, settings)
    else:
        known, J = _known(search, end.state)
    found = answer(record, search.problem, end.state.x, end.state.simulation, (end.stop, end.converged), known, J)
    form = "the paper's form (11)" if settings.form == "paper" else "residual form"
    return replace(
        found,
        variant=f"DIDIM in {form} from {'an' if began == 'inversion' else 'a'} {began} start",
        trace=tuple(search.trace),
        simulations=search.simulations,
    )


def _with_free(search: Search, end: End, settings: DIDIM) -> tuple[End, Uncertainty, FloatArray]:
    """Go on by least squares with more of what surrounds the joint free; what is known is that of least squares."""
    descent = Descent(search.problem, search.progress)
    x, stop, converged = with_free(descent, end.state.x, settings.free, settings.tolerance)
    search.problem = problem = descent.problem
    search.simulations += descent.simulations + 1
    error, slopes = descent.linearised(x)
    state = State(x, problem.simulate(x), error, 1.0)
    names = [p.name for p in problem.free]
    known = uncertainty(slopes, slopes, error, problem.cells(state.simulation), names, problem.torque_unit)
    return End(state, stop, converged), known, slopes


def _at_rest(problem: Problem, settings: DIDIM) -> Problem:
    """Return the problem with the motor at rest at the first sample."""
    known = {"initial_velocity": 0.0}
    if settings.initial_state == "reference":
        known["initial_position"] = float(problem.experiment.inputs[0, REFERENCE])
    kept = tuple(p.fixed(known[p.name]) if p.name in known else p for p in problem.parameters)
    return replace(problem, parameters=kept)


def _or_moving(problem: Problem, search: Search, settings: DIDIM, resting: End, start: Start) -> End:
    """Return the better of two answers: the motor at rest at the first sample, or moving.

    Friction makes them two problems: a motor that slips a little before it sticks is not near one that stands, so
    no search gets from one to the other.
    """
    at_rest = search.problem
    velocity = {"initial_velocity": start.values["initial_velocity"]}
    search.problem = problem
    try:
        moving = _solve(search, settings, Start(at_rest.values(resting.state.x) | velocity, None))
        gained = resting.state.norm**2 - moving.state.norm**2
        if gained > _MOVING * resting.state.norm**2 / resting.state.error.size:
            return moving
    except MethodError:  # a wrong guess of the velocity may make the loop impossible to simulate
        search.progress("the motor cannot have been moving at the first sample")
    search.problem = at_rest
    return resting
