"""DIDIM: direct and inverse dynamic identification models, from torque and reference only.

**A rigid joint.** The closed loop is simulated at the current parameters, and the torque error is made least, with the
output sensitivities J = d tau_sim / d chi, from several starts: one answer, whatever the start.

By name there is what the paper does instead [P section IV.A]: the inverse dynamic regressor W is evaluated on the
simulated motion, and least squares on the torque gives the next parameters, until nothing changes. The paper's form
(11) solves ``tau = W chi``, which does not hold while an axis rests: friction then takes what it must, not Fc. The
residual form ``tau - tau_sim = W dchi`` has the truth as its fixed point wherever the axis rests. Both read W on the
simulation, which the noise of the record cannot reach, so W acts as a set of instruments for J, and the covariance is
that of an instrumental-variable estimator (`uncertainty`). On an axis that rests for a part of the record, with forces
in its loop, such a fixed point can depend on the start, and take ten times the simulations.

Where the model leaves something out, the least torque error and the fixed point lie further apart than the deviations
of either; the interval of the first is then widened to hold both (`uncertainty_of_least_error`).

**What is tried, in order.** The starts: what IDIM finds on the motion that the controller must have seen, and a regular
inertia (`starts.rigid_joint`). From each a descent with the motor at rest at the first sample, and the best end once
more with it moving; or, where a form is named, the steps of the regressor from the first start, and descents where they
lead to no joint. From there, with nonlinear laws, a descent from each of their starts; and one with more of the
surroundings free.

**A flexible joint.** The load is not controlled, so the regressor on the simulated motion is no approximation of the
Jacobian [P section IV.B]; what is left is the criterion itself, ``J = ||Y - Ys||^2`` of the filtered, decimated torque.
Two ways down:

- least squares with the output sensitivities, by SciPy's bounded trust region;
- Nelder-Mead by the rules of MATLAB's ``fminsearch``, as the paper did, restarted because it stops early.

Both begin as the paper does, with a rigid identification at low frequency. Its values are divided between the sides,
by halves in the paper (13), and the stiffness follows from a known or guessed frequency: ``K12 = mu (2 pi f)^2`` with
``mu = ZZ1 ZZ2 / (ZZ1 + ZZ2)``. Where the frequency is not known, a grid of frequencies and load shares is simulated,
and the best few are refined: half of such a grid is unstable for a fast loop, and the rest has local minima.

**A robot** is searched for by `estimation.robots`.
"""

from __future__ import annotations

import contextlib
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Literal

import numpy as np

from jointid.common.arrays import FloatArray
from jointid.common.errors import MethodError
from jointid.common.messages import Detail, Suspicion, ignore_progress
from jointid.common.parameters import Bounds, Parameter, Quantity
from jointid.common.settings import add_settings_to_docstring, declare, setting
from jointid.estimation.descent import History, Solved, begins_badly, free_more, glancing, least_squares, or_moving
from jointid.estimation.methods.force_in_loop import (
    allow_for_force,
    instruments,
    uncertainty_of_least_error,
    widened_for_force,
)
from jointid.estimation.methods.registry import (
    EVALUATIONS,
    FREQUENCIES,
    MODELS,
    OFFSETS,
    ROBOT,
    SURROUNDINGS,
    Method,
    Task,
)
from jointid.estimation.methods.regressor_steps import REPRODUCED, RegressorSteps, describe_unstable
from jointid.estimation.methods.stiffness_search import NOTHING, StiffnessSearch, search_by_simplex
from jointid.estimation.outputs import check_outputs
from jointid.estimation.problems.base import DELAY, DELAYS, INITIAL_STATE
from jointid.estimation.problems.closed_loop import ClosedLoopProblem, beginning_position, torque_problem
from jointid.estimation.result.assemble import FitResult
from jointid.estimation.result.build_result import build_closed_loop_result
from jointid.estimation.result.stiffness_identifiability import visible
from jointid.estimation.starts.nonlinear_laws import from_linear_laws, with_linear_laws
from jointid.estimation.starts.rigid_joint import Start, rigid_starts
from jointid.models.controllers import REFERENCE, numbers_of, with_numbers
from jointid.models.joints import ClosedLoop
from jointid.records.record import Record
from jointid.simulation.closed_loop import wound_up
from jointid.solvers.nelder_mead import NelderMead
from jointid.solvers.regression import refuse_idle
from jointid.solvers.solve import Status
from jointid.uncertainty.covariance import Covariance
from jointid.uncertainty.position_dependent_error import uncertainty

_ROUNDING = 1e-10  # of the torque: an error this small is rounding
_BETTER = 1e-6  # of the residual: by as much a later end has to be better than an earlier one
_EXPLAINS = 0.5  # of the torque: what an end may leave whose start led to no joint
_ASIDE = 0.25  # of the reference's largest speed: a motor may move while its reference rests
_LEAST = "by least squares"
_LEAST_ERROR = 'set method.form = "least-squares"'
_LEAST_SQUARES = 'set method.minimiser = "least-squares"'
_TOLERANCES = {"rigid": 1e-7, "flexible": 1e-8}
_SIMPLEX_TOLERANCE = 1e-4  # that of fminsearch
_RIGID, _FLEXIBLE = ("rigid",), ("flexible",)


@add_settings_to_docstring
@dataclass(frozen=True, slots=True)
class DIDIM(Method):
    """Settings of DIDIM; some are of a rigid or a flexible joint, or of a robot, alone."""

    name = "didim"
    title = "DIDIM"
    default_for = ClosedLoop
    needs_controller = True
    any_law = True

    form: Literal["least-squares", "residual", "paper"] = setting(
        "least-squares",
        "what is searched for: the least torque error (least-squares), or the fixed point of steps by the regressor, "
        "which solve for the change of the parameters (residual) or, as (11) in the paper, for the parameters (paper)",
        systems=_RIGID,
    )
    start: Literal["inversion", "regular", "given"] = setting(
        "inversion",
        "where the search begins: the controller turned round, a regular inertia without friction, or the starts of "
        "the parameters",
        systems=_RIGID,
    )
    # Scaling at every iteration would bias the result where the bandwidth it assumes is not the real one.
    scaled_iterations: int = setting(
        2,
        "first iterations in which the simulated gains follow the inertia, from a regular or a given start",
        at_least=0,
        systems=_RIGID,
    )
    tolerance: float | None = setting(
        None,
        "change of the criterion, and of a flexible joint's parameters, to stop at, as a share; without it 1e-7 for a "
        "rigid joint, 1e-8 for a flexible one, and 1e-4 with Nelder-Mead",
        above=0,
        systems=MODELS,
    )
    step_tolerance: float = setting(
        1e-7, "change of every parameter to stop at, too, as a share of itself", above=0, systems=_RIGID
    )
    iterations: int = setting(30, "iterations at most", at_least=1, systems=("rigid", "robot"))
    initial_state: Literal["free", "reference"] = setting(
        "free",
        "whether position and velocity at the first sample are estimated, or those of the reference at rest",
        systems=_RIGID,
    )
    minimiser: Literal["least-squares", "nelder-mead"] = setting(
        "least-squares",
        "least squares with the output sensitivities, or the paper's simplex by MATLAB's fminsearch",
        systems=_FLEXIBLE,
    )
    frequency: float | None = setting(
        None,
        "free-free frequency from which the stiffness starts, with the inertia halved; without it the best of a "
        "grid, a simulation each",
        unit="Hz",
        above=0,
        systems=_FLEXIBLE,
    )
    rigid_cutoff: float | None = setting(
        None,
        "cut-off of the rigid identification that gives the start; without it 0.5 % of the sampling frequency",
        unit="Hz",
        above=0,
        systems=_FLEXIBLE,
    )
    simulations: int = setting(6000, "simulations of one descent of Nelder-Mead at most", at_least=1, systems=_FLEXIBLE)
    restarts: int = setting(
        3,
        "restarts of Nelder-Mead at most, each from where the last one stopped; it ends when one gains nothing",
        at_least=0,
        systems=_FLEXIBLE,
    )
    statistics: Literal["sensitivities", "inverse-model"] = setting(
        "sensitivities",
        "whether the standard deviations are those of the output sensitivities, or the paper's of the inverse model, "
        "far too small",
        systems=_FLEXIBLE,
    )
    free: tuple[str, ...] = setting((), SURROUNDINGS)
    outputs: tuple[str, ...] = setting(
        (),
        'what the simulation reproduces: ["torque"], or ["motor_position"] seen through the controller; without it the '
        "torque where it is logged, else the motor position",
        accept=check_outputs,
    )
    offsets: bool = setting(True, OFFSETS, systems=ROBOT)
    evaluations: int = setting(60, EVALUATIONS, at_least=1, systems=ROBOT)
    frequencies: Mapping[str, float] = field(
        default_factory=dict, hash=False, metadata=declare(FREQUENCIES, systems=ROBOT)
    )
    near: bool = field(default=False, repr=False, compare=False)
    """Whether a free delay is known to be near the declared one: no setting, but what the checks found."""

    @classmethod
    def paper(cls, model: str = "rigid", frequency: float | None = 30.0) -> DIDIM:
        """Return the settings of the paper.

        Args:
            model: "rigid": form (11), regular start, stop at 2.5 % or after 10 iterations; "flexible": Nelder-Mead with
                the tolerance of ``fminsearch``, its statistics.
            frequency: of a flexible joint, Hz; the paper measured 30 Hz with its output blocked.
        """
        if model == "rigid":
            return cls("paper", "regular", 1, 0.025, 0.025, 10, "reference")
        return cls(
            minimiser="nelder-mead", frequency=frequency, tolerance=_SIMPLEX_TOLERANCE, restarts=1,
            statistics="inverse-model",
        )  # fmt: skip

    @property
    def tells_of_its_loop(self) -> bool:
        """True by least squares: the paper's search need not end there, and its loop would be blamed for that."""
        return self.minimiser == "least-squares"

    def stopping_tolerance(self, model: str) -> float:
        """Return the tolerance that the search stops at: its own, or the default of the joint's model."""
        return self.tolerance or (_TOLERANCES[model] if self.minimiser == "least-squares" else _SIMPLEX_TOLERANCE)

    @property
    def _tolerance(self) -> float:
        return self.stopping_tolerance("rigid")

    def identify(self, task: Task) -> FitResult:
        """Identify a joint from torque and reference; a motor position in the record is not read.

        The filter goes over torque and columns alike. The mode of a flexible joint must lie below the cut-off. With a
        cut-off well below the bandwidth of a rigid joint's loop, the regressor is the Jacobian; above it convergence
        slows down.

        Raises:
            RecordError: a channel is missing.
            MethodError: the record does not determine the parameters, or the loop cannot be simulated at any start.
        """
        return self._identify_rigid(task) if task.joint.model == "rigid" else self._identify_flexible(task)

    def _near_delay(self, task: Task, history: History) -> tuple[Task, list[Start]]:
        """Return the task at the best of several delays, and a start, where the delay is free and none is declared.

        A wrong delay turns the phase of a mode and of the loop, which other joints explain as well: a rough search
        begins at each of a row of delays, and the best end decides.
        """
        loop = task.loop
        assert loop is not None
        if self.near or DELAY not in self.free or numbers_of(loop.controller).get(DELAY) != 0.0:
            return task, []
        ends = list[Solved]()
        for late in DELAYS:
            under = replace(task, loop=replace(loop, controller=with_numbers(loop.controller, {DELAY: late})))
            history.progress(Detail(f"looking for the delay near {1e3 * late:g} ms"))
            with contextlib.suppress(MethodError):  # no joint is stable with it
                ends.append(self._glance(under, history))
        if not ends:
            return task, []
        values = min(ends, key=lambda end: end.norm).values
        law = with_numbers(loop.controller, {DELAY: values[DELAY]})
        return replace(task, loop=replace(loop, controller=law)), [Start(values, None)]

    def _glance(self, task: Task, history: History) -> Solved:
        """Return the end of a rough search with the delay free, from the one that the task declares."""
        assert task.loop is not None
        flexible = task.joint.model == "flexible"
        around = _at_rest(task.record, self) if flexible else INITIAL_STATE
        problem = with_linear_laws(torque_problem(task.record, task.loop, task.filtering, task.parameters, around))
        if flexible:
            own = replace(task, loop=problem.loop, joint=problem.joint)
            cutoffs = self.frequency, self.rigid_cutoff
            return StiffnessSearch(problem, own, *cutoffs, self._tolerance, history).glance(DELAY)
        resting = problem.keeping(self._first_sample(problem))
        wider, ends = resting.freeing(DELAY), list[Solved]()
        for start in rigid_starts(problem, self.start, ignore_progress).values():
            with contextlib.suppress(MethodError):
                x = self._first_positions(resting, start, history)[0]
                ends.append(history.solve(wider, glancing(wider), wider.vector(resting.values(x))))
        if not ends:
            raise MethodError(describe_unstable(resting, resting.vector({})))
        return min(ends, key=lambda end: end.norm)

    def _declared(self, solved: Solved, task: Task) -> Solved:
        """Return an end under the delay that was declared; the free one stays what it is."""
        problem, loop = solved.problem, task.loop
        assert loop is not None
        if problem.loop.controller == loop.controller:
            return solved
        law = problem.experiment.law_of(loop.controller)
        loop = replace(problem.loop, controller=loop.controller)
        return solved._replace(problem=replace(problem, loop=loop, experiment=problem.experiment.with_law(law)))

    def solve(self, task: Task, history: History) -> Solved:
        """Search for the least torque error from all starts; nonlinear laws from the end with linear ones."""
        return (
            self._solve_rigid(task, history) if task.joint.model == "rigid" else self._solve_flexible(task, history)[0]
        )

    def _identify_rigid(self, task: Task) -> FitResult:
        history, given = History(task.progress), task
        task, near = self._near_delay(task, history)
        assert task.loop is not None
        declared = torque_problem(task.record, task.loop, task.filtering, task.parameters)
        problem = with_linear_laws(declared)
        if problem is not declared and self.form != "least-squares":
            declared.joint.require_linear("A fixed point of a regressor takes", _LEAST_ERROR)
            declared.joint.require_no_ripple("A fixed point of a regressor takes", _LEAST_ERROR)
        starts = rigid_starts(problem, self.start, task.progress)
        solved, how = self._search(problem, [*near, *starts.values()], history)
        if problem is not declared:
            solved = history.finish(solved, self._tolerance)
            solved = from_linear_laws(declared, solved, self._tolerance, history)
        if self.free:
            aside = history if problem is not declared else History(task.progress)  # which keeps the trace of the steps
            solved = self._declared(free_more(solved, self.free, self._tolerance, aside), given)
            history.tally.evaluations += aside.tally.evaluations if aside is not history else 0
        problem, x, end = solved.problem, solved.x, solved.solution
        run, error, J = solved.run or problem.simulate(x), end.residual, -end.jacobian
        history.tally.evaluations += solved.run is None
        names = [p.name for p in problem.free]
        refuse_idle(J[:, : len(problem.free_joint)], tuple(names[: len(problem.free_joint)]))
        if self.free or how == _LEAST:
            known = uncertainty_of_least_error(problem, x, run, error, J, history)
        else:
            Z = instruments(problem, run, J)
            known = uncertainty(Z, J, error, problem.cells(run), names, problem.torque_unit)
        began = next(iter(starts))
        variant = f"DIDIM {how} from {'an' if began == 'inversion' else 'a'} {began} start"
        return build_closed_loop_result(
            task.record, problem, x, run, (end.message, end.converged), known, J, variant, history.trace,
            history.tally.evaluations,
        )  # fmt: skip

    def _solve_rigid(self, task: Task, history: History) -> Solved:
        assert task.loop is not None
        declared = torque_problem(task.record, task.loop, task.filtering, task.parameters)
        problem = with_linear_laws(declared)
        starts = rigid_starts(problem, self.start, task.progress)
        solved = history.finish(self._descend(problem, list(starts.values()), history), self._tolerance)
        return solved if problem is declared else from_linear_laws(declared, solved, self._tolerance, history)

    def _search(self, problem: ClosedLoopProblem, starts: list[Start], history: History) -> tuple[Solved, str]:
        """Search as the form asks, and return the end and how it was found.

        On a short record, or with a model that lacks much, steps by the regressor may lead to an inertia or a friction
        that no joint has; least squares keeps within bounds.
        """
        if self.form == "least-squares":
            return self._descend(problem, starts, history), _LEAST
        try:
            steps = self._steps(problem, history)
            end = steps.fixed_point(problem, self._first_sample(problem), starts[0])
        except MethodError as error:
            if self.form == "paper":
                raise
            history.progress(Suspicion("searching by least squares", error))
            try:
                return self._descend(problem, starts, history), _LEAST
            except MethodError:
                raise error from None
        return end, "in the paper's form (11)" if self.form == "paper" else "in residual form"

    def _descend(self, problem: ClosedLoopProblem, starts: list[Start], history: History) -> Solved:
        """Descend from each start to the least torque error, and return the best end.

        Raises:
            MethodError: the loop cannot be simulated at any start, and the sentence says why at the first.
        """
        resting, ends, failures = problem.keeping(self._first_sample(problem)), list[Solved](), list[MethodError]()
        solver = least_squares(resting, self._tolerance)
        for count, start in enumerate(starts):
            try:
                started = self._first_positions(resting, start, history)
            except MethodError as error:
                failures.append(error)
                continue
            ends += [history.solve(resting, solver, x) for x in started[: 1 if count else None]]
        if not ends:  # steps on scaled gains may lead to no joint where the start itself is one
            for start in starts:
                with contextlib.suppress(MethodError):
                    first = self._first_positions(resting, start, history, scaled=False)[0]
                    ends.append(history.solve(resting, solver, first))
            if not any(end.norm < _EXPLAINS * problem.size for end in ends):
                raise failures[0]
        best = ends[0]
        for end in ends[1:]:
            best = end if end.norm < (1.0 - _BETTER) * best.norm else best
        size = problem.size
        if self.initial_state == "free" and best.norm > _ROUNDING * size:
            # Of a motor at rest the derivative by its velocity is 0: no search leaves it. Where the motor moves, the
            # end at rest may have another friction, and where the law is off, the start another state.
            moving = next((one.values for one in starts if one.values["initial_velocity"] != 0.0), best.values)
            velocity = moving["initial_velocity"]
            near = [moving] if wound_up(problem.experiment, velocity) else []
            for there in (*near, best.values | {"initial_velocity": velocity}):
                best = or_moving(best, problem, there, solver, history)
            steps = np.diff(problem.experiment.inputs[:, REFERENCE])
            aside = _ASIDE * float(np.max(np.abs(steps))) / problem.experiment.law.period
            # A law that is off looks like a motion; what is free of it is found from rest.
            for velocity in (aside, -aside) if begins_badly(best) and not self.free else ():
                home = beginning_position(problem, velocity)
                there = best.values | {"initial_velocity": velocity, "initial_position": home}
                best = or_moving(best, problem, there, solver, history)
        if best.norm <= _ROUNDING * size:
            best = best._replace(solution=replace(best.solution, status=Status.EXACT, message=REPRODUCED))
        return best

    def _first_sample(self, problem: ClosedLoopProblem) -> dict[str, float]:
        """Return the fixed initial state of a motor at rest."""
        if self.initial_state == "free":
            return {"initial_velocity": 0.0}
        return {"initial_velocity": 0.0, "initial_position": float(problem.experiment.inputs[0, REFERENCE])}

    def _first_positions(
        self, problem: ClosedLoopProblem, start: Start, history: History, *, scaled: bool = True
    ) -> list[FloatArray]:
        """Return a start with the motor where the start or the torque has it, the likelier first.

        Friction that begins too small lets a motor slip that stood: then nothing tells where it stood.

        Raises:
            MethodError: the loop cannot be simulated there, or runs away.
        """
        # A regression keeps no bounds; an inertia of the wrong sign is that of a torque of the wrong sign.
        x, inertias = problem.vector(start.values), [p.quantity is Quantity.INERTIA for p in problem.free]
        x = np.where(inertias, x, Bounds.of(problem.free).clip(x))
        steps = self._steps(problem, history)
        if scaled and start.nominal_inertia and self.scaled_iterations:
            x = steps.scale_gains(problem, start)[0].x
        there, counted = problem.values(x), history.count_evaluations(problem)
        homes = dict.fromkeys((there["initial_position"], beginning_position(problem)))
        started = [problem.vector(there | {"initial_position": home}) for home in homes]
        started.sort(key=lambda one: float(np.linalg.norm(counted.residual(one))))
        if not np.any(counted.linearise(started[0])[1]):
            steps.evaluate(problem, started[0]).require_full_simulation()
            raise MethodError(describe_unstable(problem, started[0]))
        return started

    def _steps(self, problem: ClosedLoopProblem, history: History) -> RegressorSteps:
        """Return the steps by the regressor that these settings ask for."""
        tolerances = self._tolerance, self.step_tolerance
        return RegressorSteps(self.form, *tolerances, self.iterations, self.scaled_iterations, problem.size, history)

    def _identify_flexible(self, task: Task) -> FitResult:
        record, progress = task.record, task.progress
        history = History(progress)
        solved, simulations = self._solve_flexible(self._near_delay(task, history)[0], history)
        starts = solved.solution.starts
        if self.free:
            solved = free_more(solved, self.free, self.stopping_tolerance("flexible"), history)
            solved = self._declared(solved, task)
        problem, x = solved.problem, solved.solution.x
        error, J = history.count_evaluations(problem).linearise(x)
        run = problem.simulate(x)
        history.tally.evaluations += 1
        stop, converged = solved.solution.message, solved.solution.converged
        if np.linalg.norm(error) > NOTHING * problem.size:
            stop = f"no answer: the search ended where the model explains little of the torque ({stop})"
            converged = False
        names = [p.name for p in problem.free]
        known = uncertainty(J, J, error, problem.cells(run), names, problem.torque_unit)
        paper = self.minimiser == "nelder-mead"
        how = "Nelder-Mead" if paper else "least squares"
        spring = covariance = None
        if self.statistics == "inverse-model":
            covariance = inverse_model_covariance(problem, x, error)
            history.tally.evaluations += 1
        else:
            spring = visible(problem, x, J, known, starts, progress)
            history.tally.evaluations += spring.simulations
            if spring.shown:  # what is refused has no interval to widen; `visible` widens the rest
                force = allow_for_force(problem, x, -J, known.covariance.std, history)
                known = widened_for_force(known, problem, x, force)
        variant = f"DIDIM by {how} {'from the pseudo-regular start' if paper else 'from a grid of starts'}"
        return build_closed_loop_result(
            record, problem, x, run, (stop, converged), known, J, variant, history.trace,
            history.tally.evaluations + simulations, spring=spring, paper=covariance,
        )  # fmt: skip

    def _solve_flexible(self, task: Task, history: History) -> tuple[Solved, int]:
        """Search, and return the end and the number of simulations of the rigid joints it began with."""
        loop, tolerance = task.loop, self.stopping_tolerance("flexible")
        assert loop is not None
        problem = torque_problem(task.record, loop, task.filtering, task.parameters, _at_rest(task.record, self))
        problem = problem if loop.joint.gravity is None else _hanging(problem)
        if self.minimiser == "nelder-mead":
            loop.joint.require_linear("Nelder-Mead takes", _LEAST_SQUARES)
            loop.joint.require_no_ripple("Nelder-Mead takes", _LEAST_SQUARES)
            solver = NelderMead(tolerance, self.simulations, self.restarts)
            return search_by_simplex(problem, task, self.frequency, self.rigid_cutoff, solver, history)
        linear = with_linear_laws(problem)
        own = replace(task, loop=linear.loop, joint=linear.joint)
        search = StiffnessSearch(linear, own, self.frequency, self.rigid_cutoff, tolerance, history)
        solved, simulations = search.search()
        if linear is not problem:
            if DELAY in self.free:  # a gap is found where torque and motion are in time alone
                solved = free_more(solved, (DELAY,), tolerance, history)
            solved = from_linear_laws(problem, solved, tolerance, history)
        return solved, simulations


def _at_rest(record: Record, settings: DIDIM) -> tuple[Parameter, ...]:
    """Return the initial state at rest: on the reference for Nelder-Mead, which should search no more than it must.

    Where a rigid model of a flexible joint puts the motor is no guide: it is off by more than its deviations say.
    """
    record.require(("reference",), "DIDIM")
    assert record.reference is not None
    position, velocity = INITIAL_STATE
    home = float(record.reference.values[0])
    known = position.fix(home) if settings.minimiser == "nelder-mead" else replace(position, start=home)
    return known, velocity.fix(0.0)


def _hanging(problem: ClosedLoopProblem) -> ClosedLoopProblem:
    """Return the problem with the motor, at the first sample, where its load makes it hang."""
    home = beginning_position(problem)
    return problem.replace_parameters(
        {p.name: replace(p, start=home) for p in problem.parameters if p.name == "initial_position"}
    )


def inverse_model_covariance(problem: ClosedLoopProblem, x: FloatArray, error: FloatArray) -> Covariance:
    """Return the paper's covariance of the joint's free parameters, ``s^2 (W' W)^-1`` with W on the simulated motion.

    It is that of a regression on W, which is not what torque-only identification solves: for a flexible joint the
    output sensitivities are not W, and Fv1, Fv2 come out many times surer than they are.
    """
    run = problem.simulate(x)
    columns = problem.loop.joint.regressor(run.motor, run.load)
    names = [p.name for p in problem.loop.joint.parameters]
    free = [names.index(p.name) for p in problem.free_joint]
    W = np.concatenate([problem.filter(equation[:, free]) for equation in columns])
    variance = float(error @ error) / (len(W) - W.shape[1])  # the paper's r counts the rows of both equations
    norms = np.linalg.norm(W, axis=0)
    inverse = np.linalg.inv((W / norms).T @ (W / norms))
    roots = np.sqrt(np.diag(inverse))
    return Covariance(np.sqrt(variance) * roots / norms, inverse / np.outer(roots, roots), 0)
