"""DIDIM for rigid joints: direct and inverse dynamic identification models, from torque and reference only.

The closed loop is simulated at the current parameters, and the torque error is made least, with the output
sensitivities J = d tau_sim / d chi, from several starts: one answer, whatever the start.

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
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from jointid.common.arrays import FloatArray
from jointid.common.errors import MethodError
from jointid.common.settings import add_settings_to_docstring, setting
from jointid.estimation.descent import History, Solved, free_more, least_squares, or_moving
from jointid.estimation.methods.force_in_loop import instruments, uncertainty_of_least_error
from jointid.estimation.methods.registry import SURROUNDINGS, Method, Task
from jointid.estimation.methods.regressor_steps import REPRODUCED, RegressorSteps, describe_unstable
from jointid.estimation.problems.closed_loop import ClosedLoopProblem, beginning_position, torque_problem
from jointid.estimation.result.assemble import FitResult
from jointid.estimation.result.build_result import build_closed_loop_result
from jointid.estimation.starts.nonlinear_laws import from_linear_laws, with_linear_laws
from jointid.estimation.starts.rigid_joint import Start, rigid_starts
from jointid.models.controllers import REFERENCE
from jointid.models.joints import ClosedLoop
from jointid.solvers.regression import refuse_idle
from jointid.solvers.solve import Status
from jointid.uncertainty.position_dependent_error import uncertainty

_ROUNDING = 1e-10  # of the torque: an error this small is rounding
_BETTER = 1e-6  # of the residual: by as much a later end has to be better than an earlier one
_LEAST = "by least squares"
_LEAST_ERROR = 'set method.form = "least-squares"'


@add_settings_to_docstring
@dataclass(frozen=True, slots=True)
class DIDIM(Method):
    """Settings of DIDIM."""

    name = "didim"
    title = "DIDIM"
    models = ("rigid",)
    default_for = ClosedLoop
    needs_controller = True
    any_law = True

    form: Literal["least-squares", "residual", "paper"] = setting(
        "least-squares",
        "what is searched for: the least torque error (least-squares), or the fixed point of steps by the regressor, "
        "which solve for the change of the parameters (residual) or, as (11) in the paper, for the parameters (paper)",
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

    def identify(self, task: Task) -> FitResult:
        """Identify a rigid joint from torque and reference; a motor position in the record is not read.

        The filter goes over torque and columns alike. With a cut-off well below the loop's bandwidth, the regressor is
        the Jacobian; above it convergence slows down.

        Raises:
            RecordError: a channel is missing.
            MethodError: the joint is flexible, the record does not determine the parameters, or the loop cannot be
                simulated at the start.
        """
        assert task.loop is not None
        declared = torque_problem(task.record, task.loop, task.filtering, task.parameters)
        problem = with_linear_laws(declared)
        if problem is not declared and self.form != "least-squares":
            declared.joint.require_linear("A fixed point of a regressor takes", _LEAST_ERROR)
            declared.joint.require_no_ripple("A fixed point of a regressor takes", _LEAST_ERROR)
        history = History(task.progress)
        starts = rigid_starts(problem, self.start, task.progress)
        solved, how = self._search(problem, list(starts.values()), history)
        if problem is not declared:
            solved = history.finish(solved, self.tolerance)
            solved = from_linear_laws(declared, solved, self.tolerance, history)
        if self.free:
            aside = history if problem is not declared else History(task.progress)  # which keeps the trace of the steps
            solved = free_more(solved, self.free, self.tolerance, aside)
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

    def solve(self, task: Task, history: History) -> Solved:
        """Search for the least torque error from all starts; nonlinear laws from the end with linear ones."""
        assert task.loop is not None
        declared = torque_problem(task.record, task.loop, task.filtering, task.parameters)
        problem = with_linear_laws(declared)
        starts = rigid_starts(problem, self.start, task.progress)
        solved = history.finish(self._descend(problem, list(starts.values()), history), self.tolerance)
        return solved if problem is declared else from_linear_laws(declared, solved, self.tolerance, history)

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
            history.progress(f"by least squares instead: {error}")
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
        solver = least_squares(resting, self.tolerance)
        for count, start in enumerate(starts):
            try:
                started = self._first_positions(resting, start, history)
            except MethodError as error:
                failures.append(error)
                continue
            ends += [history.solve(resting, solver, x) for x in started[: 1 if count else None]]
        if not ends:
            raise failures[0]
        best = ends[0]
        for end in ends[1:]:
            best = end if end.norm < (1.0 - _BETTER) * best.norm else best
        size = problem.size
        if self.initial_state == "free" and best.norm > _ROUNDING * size:
            # Of a motor at rest the derivative by its velocity is 0: no search leaves it.
            velocity = next((v for one in starts if (v := one.values["initial_velocity"]) != 0.0), 0.0)
            best = or_moving(best, problem, {**best.values, "initial_velocity": velocity}, solver, history)
        if best.norm <= _ROUNDING * size:
            best = best._replace(solution=replace(best.solution, status=Status.EXACT, message=REPRODUCED))
        return best

    def _first_sample(self, problem: ClosedLoopProblem) -> dict[str, float]:
        """Return what is known of the first sample while the motor is taken to be at rest there."""
        if self.initial_state == "free":
            return {"initial_velocity": 0.0}
        return {"initial_velocity": 0.0, "initial_position": float(problem.experiment.inputs[0, REFERENCE])}

    def _first_positions(self, problem: ClosedLoopProblem, start: Start, history: History) -> list[FloatArray]:
        """Return a start with the motor where the start or the torque has it, the likelier first.

        Friction that begins too small lets a motor slip that stood: then nothing tells where it stood.

        Raises:
            MethodError: the loop cannot be simulated there, or runs away.
        """
        x, steps = problem.vector(start.values), self._steps(problem, history)
        if start.nominal_inertia and self.scaled_iterations:
            x = steps.scale_gains(problem, start)[0].x
        there, counted = problem.values(x), history.counted(problem)
        homes = dict.fromkeys((there["initial_position"], beginning_position(problem)))
        started = [problem.vector(there | {"initial_position": home}) for home in homes]
        started.sort(key=lambda one: float(np.linalg.norm(counted.residual(one))))
        if not np.any(counted.linearise(started[0])[1]):
            steps.evaluate(problem, started[0]).require_simulated()
            raise MethodError(describe_unstable(problem, started[0]))
        return started

    def _steps(self, problem: ClosedLoopProblem, history: History) -> RegressorSteps:
        """Return the steps by the regressor that these settings ask for."""
        tolerances = self.tolerance, self.step_tolerance
        return RegressorSteps(self.form, *tolerances, self.iterations, self.scaled_iterations, problem.size, history)
