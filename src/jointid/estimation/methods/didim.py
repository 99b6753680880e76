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

from jointid.common.arrays import FloatArray
from jointid.common.errors import MethodError
from jointid.common.progress import Progress, silent
from jointid.common.settings import check_settings, documented, setting
from jointid.common.text import number
from jointid.estimation.methods.registry import Method
from jointid.estimation.problems.closed_loop import ClosedLoopProblem, torque_problem
from jointid.estimation.result.build_estimate import build_closed_loop_estimate
from jointid.estimation.result.estimate import Estimate
from jointid.estimation.search.history import History, free_more
from jointid.estimation.search.search import End, Search, State, Step, require_simulated
from jointid.estimation.search.starts import Start, given_start, inversion_start, regular_start
from jointid.models.controllers import REFERENCE, Controller
from jointid.models.joints import Joint
from jointid.models.parameters import Parameter
from jointid.records.record import Record
from jointid.records.signals.filtering import Filtering
from jointid.simulation.loop_input import ClosedLoop
from jointid.solvers.gauss_newton import GaussNewton
from jointid.solvers.regression import solution as linear_solution
from jointid.uncertainty.position_dependent_error import Uncertainty, uncertainty

_MOVING = 9.0  # times the residual's variance: what a velocity at the first sample must explain to be believed
_NEAR = 1e-3  # of residual and parameters: with a change so small it may show whether the motor rested ...
_SURE = 1e-2  # ... if the residual's norm differs by more than this share, which is as far as it can still go
_AWAY = 1e100  # a derivative so large is of a loop that runs away
_WORSE = 2.0  # times the residual: with an approximate Jacobian, a little worse is no reason to turn back


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
    free: tuple[str, ...] = setting(
        (),
        "what surrounds the joint and is identified with it, by least squares from where DIDIM ends, from what is "
        'declared: a number of the law such as "kp", "delay" or "torque_filters.0.frequency", or "log_gain", '
        '"log_delay"',
    )

    def __post_init__(self) -> None:
        check_settings(self)

    @classmethod
    def paper(cls) -> DIDIM:
        """Return the settings of the paper: form (11), regular start, stop at 2.5 % or after 10 iterations."""
        return cls("paper", "regular", 1, 0.025, 0.025, 10, "reference")

    @classmethod
    def channels(cls, model: str, controller: Controller | None = None) -> tuple[str, ...]:
        """Return torque, and what the controller reads."""
        del model
        return ("torque", *(("reference",) if controller is None else controller.channels))

    @classmethod
    def compared(cls, model: str) -> tuple[tuple[str, Method], ...]:
        """Return the one run of DIDIM in a comparison."""
        del model
        return (("DIDIM", cls()),)

    def identify(
        self,
        record: Record,
        joint: Joint,
        loop: ClosedLoop | None,
        parameters: tuple[Parameter, ...],
        filtering: Filtering,
        progress: Progress,
    ) -> Estimate:
        """Identify a rigid joint; see `identify_didim`."""
        del joint
        assert loop is not None
        return identify_didim(record, loop, parameters, filtering, self, progress)


@dataclass(frozen=True, slots=True)
class _Steps:
    """The steps of DIDIM on a problem, as functions of an iterate."""

    problem: ClosedLoopProblem
    form: str

    def regressor(self, state: State) -> FloatArray:
        """The step of the paper: the regressor stands for the Jacobian, in either form."""
        both = self._residual(state, state.Z)
        if self.form == "residual":
            return both
        after = self.inverse_model(state)
        known = state.W.shape[1]
        after[known:] = both[known:]  # the initial state has no inverse model: it takes the residual form
        return after

    def newton(self, state: State) -> FloatArray:
        """The step towards where the first one ends, with the output sensitivities: from nearby ten times as good."""
        if self.form == "paper":
            return self.regressor(state)
        Z = state.Z / np.linalg.norm(state.Z, axis=0)
        return np.asarray(state.x + np.linalg.lstsq(Z.T @ state.J, Z.T @ state.error)[0])

    def exact(self, state: State) -> FloatArray:
        """The Gauss-Newton step with the output sensitivities."""
        return self._residual(state, state.J)

    def inverse_model(self, state: State) -> FloatArray:
        """Form (11): solve ``tau = W chi`` for the joint; what surrounds it stays."""
        problem = self.problem
        kept = problem.filtered(problem.measured - problem.fixed_torque(state.simulation))
        chi = linear_solution(state.W, kept, tuple(p.name for p in problem.free_joint))
        return np.concatenate([chi, state.x[chi.size :]])

    def _residual(self, state: State, J: FloatArray) -> FloatArray:
        problem = self.problem
        names = tuple(p.name for p in problem.free)
        if not np.max(np.abs(J)) < _AWAY:
            told = problem.values(state.x)
            joint = ", ".join(f"{p.name} {number(told[p.name], 3)} {problem.units[p.name]}" for p in problem.free_joint)
            raise MethodError(
                f"With the joint that torque and motion give ({joint}) the declared loop is not stable, and the real "
                "one was; check the gain and unit of the torque channel, and the gains of the controller."
            )
        return np.asarray(state.x + linear_solution(J, state.error, names))


def _begun(search: Search, problem: ClosedLoopProblem, settings: DIDIM, start: Start) -> tuple[State, int]:
    """Return where a search stands after its iterations on scaled gains, and how many these were."""
    steps = _Steps(problem, settings.form)
    nominal = start.nominal_inertia
    scaled = settings.scaled_iterations if nominal else 0

    def scale(x: FloatArray) -> float:
        return problem.values(x)["inertia"] / nominal if nominal else 1.0

    x = problem.vector(start.values)
    state = search.evaluate(problem, x, scale(x) if scaled else 1.0)
    search.note(problem, state, None)
    for count in range(1, scaled + 1):
        require_simulated(state)
        x = steps.inverse_model(state)
        after = search.evaluate(problem, x, scale(x) if count < scaled else 1.0)
        search.note(problem, after, state)
        state = after
    return state, scaled


def _solve(
    search: Search, problem: ClosedLoopProblem, settings: DIDIM, state: State, step: Step, solver: GaussNewton
) -> End:
    """Repeat a step on the true gains until nothing changes, and where it does not lead there the exact one."""
    end = search.repeat(problem, state, step, solver)
    if end.converged or settings.form == "paper":
        return end
    # Where the torque stands at its limit, or the loop is slow, the regressor is no approximation of the Jacobian.
    search.progress("the regressor does not lead there; going on with the output sensitivities")
    exact = replace(solver, iterations=settings.iterations, worst=1.0 + settings.tolerance)
    return search.repeat(problem, end.state, _Steps(problem, settings.form).exact, exact)


def _searched(problem: ClosedLoopProblem, search: Search, settings: DIDIM, start: Start) -> End:
    """Search from a start, the motor at rest at the first sample, or moving where that is better."""
    free, residual = settings.initial_state == "free", settings.form == "residual"
    rest = _at_rest(problem, settings)
    step = _Steps(rest, settings.form).regressor
    state, scaled = _begun(search, rest, settings, start)
    most = max(settings.iterations - scaled, 1)
    solver = GaussNewton(settings.tolerance, settings.step_tolerance, most, foreseen=free and residual, worst=_WORSE)
    if not free:
        return _solve(search, rest, settings, state, step, solver)
    near = replace(solver, tolerance=max(solver.tolerance, _NEAR), step_tolerance=max(solver.step_tolerance, _NEAR))
    begun = len(search.trace)
    resting = _solve(search, rest, settings, state, step, near)
    if resting.reproduced:
        return resting
    left = replace(solver, iterations=max(most - (len(search.trace) - begun), 1))
    moving = _moving(problem, rest, search, settings, resting.state, start, solver)
    rough = resting.converged and near != solver
    if rough and not (moving and _explains(moving, (1.0 - _SURE) * resting.state.norm)):
        resting = _solve(search, rest, settings, resting.state, step, left)
    return moving if moving and _explains(moving, resting.state.norm) else resting


def _explains(moving: End, rest: float) -> bool:
    """Whether a motor that moves leaves so much less than the norm that is left at rest that it is to be believed."""
    return rest**2 - moving.state.norm**2 > _MOVING * rest**2 / moving.state.error.size


def _known(problem: ClosedLoopProblem, state: State) -> Uncertainty:
    """Return what is known of the free parameters (see the module)."""
    names = [p.name for p in problem.free]
    return uncertainty(state.Z, state.J, state.error, problem.cells(state.simulation), names, problem.torque_unit)


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
    search = Search(problem.size, progress)
    end = _searched(problem, search, settings, start)
    if settings.free:
        end, known = _with_free(search, end, settings)
    else:
        known = _known(end.problem, end.state)
    state = end.state
    found = build_closed_loop_estimate(
        record, end.problem, state.x, state.simulation, (end.stop, end.converged), known, state.J
    )
    form = "the paper's form (11)" if settings.form == "paper" else "residual form"
    return found.amended(
        settings={"variant": f"DIDIM in {form} from {'an' if began == 'inversion' else 'a'} {began} start"},
        fit={"trace": tuple(search.trace), "simulations": search.simulations},
    )


def _with_free(search: Search, end: End, settings: DIDIM) -> tuple[End, Uncertainty]:
    """Go on by least squares with more of what surrounds the joint free; what is known is that of least squares."""
    history, state = History(search.progress), end.state
    solved = free_more(end.problem, state.x, settings.free, settings.tolerance, history)
    problem, solution = solved.problem, solved.solution
    search.simulations += history.tally.evaluations + 1
    error, slopes = history.counted(problem).linearised(solution.x)
    run, names = problem.simulate(solution.x), [p.name for p in problem.free]
    known = uncertainty(slopes, slopes, error, problem.cells(run), names, problem.torque_unit)
    W = slopes[:, : end.state.W.shape[1]]
    after = State(solution.x, run, error, W, slopes, state.scales)
    return End(problem, after, solution.message, solution.converged), known


def _at_rest(problem: ClosedLoopProblem, settings: DIDIM) -> ClosedLoopProblem:
    """Return the problem with the motor at rest at the first sample."""
    known = {"initial_velocity": 0.0}
    if settings.initial_state == "reference":
        known["initial_position"] = float(problem.experiment.inputs[0, REFERENCE])
    return problem.keeping(known)


def _moving(
    problem: ClosedLoopProblem,
    rest: ClosedLoopProblem,
    search: Search,
    settings: DIDIM,
    resting: State,
    start: Start,
    solver: GaussNewton,
) -> End | None:
    """Return the answer for a motor that moves at the first sample; None where the loop cannot be simulated so.

    Friction makes them two problems: a motor that slips a little before it sticks is not near one that stands, so
    no search gets from one to the other.
    """
    velocity = {"initial_velocity": start.values["initial_velocity"]}
    solver = replace(solver, iterations=settings.iterations)
    try:
        state = search.evaluate(problem, problem.vector(rest.values(resting.x) | velocity))
        search.note(problem, state, None)
        return _solve(search, problem, settings, state, _Steps(problem, settings.form).newton, solver)
    except MethodError:  # a wrong guess of the velocity may make the loop impossible to simulate
        search.progress("the motor cannot have been moving at the first sample")
        return None
