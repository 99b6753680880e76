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
of either; the interval of the first is then widened to hold both (`methods.least_error`).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from jointid.common.errors import MethodError
from jointid.common.messages import Progress
from jointid.common.settings import documented, setting
from jointid.estimation.methods.least_error import known_of_least_error
from jointid.estimation.methods.registry import SURROUNDINGS, Method, Task
from jointid.estimation.methods.rigid_search import End, RigidSearch, known_of_fixed_point
from jointid.estimation.methods.search import (
    History,
    Solved,
    Start,
    given_start,
    inversion_start,
    least_squares,
    regular_start,
)
from jointid.estimation.methods.search_in_pieces import from_linear_laws, with_linear_laws
from jointid.estimation.problems.closed_loop import ClosedLoopProblem, torque_problem
from jointid.estimation.result.assemble import FitResult
from jointid.estimation.result.build_result import build_closed_loop_result
from jointid.models.joints import ClosedLoop

_LEAST = "by least squares"
_LEAST_ERROR = 'set method.form = "least-squares"'


@documented
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
        search = RigidSearch(self, problem.size, History(task.progress))
        began, starts = self._starts(problem, task.progress)
        end, how = self._searched(search, problem, starts)
        end = search.with_free(end) if self.free and problem is declared else end
        if problem is not declared:
            end = search.go_on(declared, end, self.free)
        state = end.state
        if self.free or how == _LEAST:
            known = known_of_least_error(
                state.problem, state.x, state.simulation, state.residual, state.J, search.history
            )
        else:
            known = known_of_fixed_point(state)
        variant = f"DIDIM {how} from {'an' if began == 'inversion' else 'a'} {began} start"
        return build_closed_loop_result(
            task.record, state.problem, state.x, state.simulation, (end.stop, end.converged), known, state.J, variant,
            search.history.trace, search.history.tally.evaluations,
        )  # fmt: skip

    def solve(self, task: Task, history: History) -> Solved:
        """Return where the least torque error is, from any start.

        Laws in pieces are looked for from where linear ones ended.
        """
        assert task.loop is not None
        declared = torque_problem(task.record, task.loop, task.filtering, task.parameters)
        problem = with_linear_laws(declared)
        search = RigidSearch(self, problem.size, history)
        _, starts = self._starts(problem, task.progress)
        state = search.least_torque_error(problem, starts).state
        found = history.solve(state.problem, least_squares(state.problem, self.tolerance), state.x)
        return found if problem is declared else from_linear_laws(declared, found, self.tolerance, history)

    def _searched(self, search: RigidSearch, problem: ClosedLoopProblem, starts: list[Start]) -> tuple[End, str]:
        """Return where the search ended, and how it went.

        On a short record, or with a model that lacks much, steps by the regressor may lead to an inertia or a friction
        that no joint has; least squares keeps within bounds.
        """
        if self.form == "least-squares":
            return search.least_torque_error(problem, starts), _LEAST
        try:
            end = search.fixed_point(problem, starts[0])
        except MethodError as error:
            if self.form == "paper":
                raise
            search.history.progress(f"by least squares instead: {error}")
            try:
                return search.least_torque_error(problem, starts), _LEAST
            except MethodError:
                raise error from None
        return end, "in the paper's form (11)" if self.form == "paper" else "in residual form"

    def _starts(self, problem: ClosedLoopProblem, progress: Progress) -> tuple[str, list[Start]]:
        """Return the name of the first start, and the starts: the one asked for, then the others that can be had.

        The least torque error is the same from wherever it is found, so all are tried; a fixed point is of one start.
        """
        makers = {"given": given_start} if self.start == "given" else {}
        makers |= {"regular": regular_start} if self.start == "regular" else {}
        makers |= {"inversion": inversion_start, "regular": regular_start}
        found, failures = dict[str, Start](), list[MethodError]()
        for name, make in makers.items():
            try:
                found[name] = make(problem)
            except MethodError as error:
                failures.append(error)
        if not found or (self.start not in found and self.start != "inversion"):
            raise failures[0]
        if self.start not in found:
            progress(f"from a regular start instead: {failures[0]}")
        return next(iter(found)), list(found.values())
