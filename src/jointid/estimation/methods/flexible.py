"""DIDIM for flexible joints: the criterion (9) minimised over all the parameters of (2), from torque and reference.

The load is not controlled, so the regressor on the simulated motion is no approximation of the Jacobian [P section
IV.B]; what is left is the criterion itself, ``J = ||Y - Ys||^2`` of the filtered, decimated torque. Two ways down:

- least squares with the output sensitivities, by SciPy's bounded trust region;
- Nelder-Mead by the rules of MATLAB's ``fminsearch``, as the paper did, restarted because it stops early.

Both begin as the paper does, with a rigid identification at low frequency. Its values are divided between the sides,
by halves in the paper (13), and the stiffness follows from a known or guessed frequency: ``K12 = mu (2 pi f)^2`` with
``mu = ZZ1 ZZ2 / (ZZ1 + ZZ2)``. Where the frequency is not known, a grid of frequencies and load shares is simulated,
and the best few are refined: half of such a grid is unstable for a fast loop, and the rest has local minima.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from jointid.common.arrays import FloatArray
from jointid.common.parameters import Parameter
from jointid.common.settings import add_settings_to_docstring, setting
from jointid.estimation.descent import History, Solved, free_more
from jointid.estimation.methods.force_in_loop import widened_for_force
from jointid.estimation.methods.registry import SURROUNDINGS, Method, Task
from jointid.estimation.methods.stiffness_search import StiffnessSearch, search_by_simplex
from jointid.estimation.problems.base import INITIAL_STATE
from jointid.estimation.problems.closed_loop import ClosedLoopProblem, beginning_position, torque_problem
from jointid.estimation.result.assemble import FitResult
from jointid.estimation.result.build_result import build_closed_loop_result
from jointid.estimation.result.stiffness_identifiability import visible
from jointid.estimation.starts.nonlinear_laws import from_linear_laws, with_linear_laws
from jointid.models.joints import ClosedLoop
from jointid.records.record import Record
from jointid.solvers.nelder_mead import NelderMead
from jointid.uncertainty.covariance import Covariance
from jointid.uncertainty.position_dependent_error import uncertainty

_LEAST_SQUARES = 'set method.minimiser = "least-squares"'
_TOLERANCE, _SIMPLEX_TOLERANCE = 1e-8, 1e-4  # the latter is that of fminsearch
_NOTHING = 0.5  # of the torque: an end that leaves so much is no answer


@add_settings_to_docstring
@dataclass(frozen=True, slots=True)
class FlexibleDIDIM(Method):
    """Settings of DIDIM for a flexible joint."""

    name = "didim"
    title = "DIDIM"
    models = ("flexible",)
    default_for = ClosedLoop
    needs_controller = True
    any_law = True

    minimiser: Literal["least-squares", "nelder-mead"] = setting(
        "least-squares", "least squares with the output sensitivities, or the paper's simplex by MATLAB's fminsearch"
    )
    frequency: float | None = setting(
        None,
        "free-free frequency from which the stiffness starts, with the inertia halved; without it the best of a "
        "grid, a simulation each",
        unit="Hz",
        above=0,
    )
    rigid_cutoff: float | None = setting(
        None,
        "cut-off of the rigid identification that gives the start; without it 0.5 % of the sampling frequency",
        unit="Hz",
        above=0,
    )
    tolerance: float | None = setting(
        None,
        "change of the criterion or the parameters to stop at, as a share; without it 1e-8, and 1e-4 with Nelder-Mead",
        above=0,
    )
    simulations: int = setting(6000, "simulations of one descent of Nelder-Mead at most", at_least=1)
    restarts: int = setting(
        3,
        "restarts of Nelder-Mead at most, each from where the last one stopped; it ends when one gains nothing",
        at_least=0,
    )
    statistics: Literal["sensitivities", "inverse-model"] = setting(
        "sensitivities",
        "whether the standard deviations are those of the output sensitivities, or the paper's of the inverse model, "
        "far too small",
    )
    free: tuple[str, ...] = setting((), SURROUNDINGS)

    @classmethod
    def paper(cls, frequency: float | None = 30.0) -> FlexibleDIDIM:
        """Return the settings of the paper: Nelder-Mead with the tolerance of ``fminsearch``, its statistics.

        The frequency is the 30 Hz the paper measured with its output blocked.
        """
        return cls("nelder-mead", frequency, None, 1e-4, 6000, 1, "inverse-model")

    @property
    def tells_of_its_loop(self) -> bool:
        """True by least squares: the paper's search need not end there, and its loop would be blamed for that."""
        return self.minimiser == "least-squares"

    def identify(self, task: Task) -> FitResult:
        """Identify a flexible joint from torque and reference; its mode must lie below the cut-off.

        Raises:
            RecordError: a channel is missing.
            MethodError: the loop cannot be simulated at any start.
        """
        record, progress = task.record, task.progress
        history = History(progress)
        solved, simulations = self.solve(task, history)
        starts = solved.solution.starts
        if self.free:
            solved = free_more(solved, self.free, stopping_tolerance(self), history)
        problem, x = solved.problem, solved.solution.x
        error, J = history.counted(problem).linearise(x)
        run = problem.simulate(x)
        history.tally.evaluations += 1
        stop, converged = solved.solution.message, solved.solution.converged
        if np.linalg.norm(error) > _NOTHING * problem.size:
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
            if spring.shown:  # what is refused has no interval to widen
                known = widened_for_force(known, problem, x, J, history)
        variant = f"DIDIM by {how} {'from the pseudo-regular start' if paper else 'from a grid of starts'}"
        return build_closed_loop_result(
            record, problem, x, run, (stop, converged), known, J, variant, history.trace,
            history.tally.evaluations + simulations, spring=spring, paper=covariance,
        )  # fmt: skip

    def solve(self, task: Task, history: History) -> tuple[Solved, int]:
        """Search, and return the end and the number of simulations of the rigid joints it began with.

        Nonlinear laws are looked for from the end with linear ones.
        """
        loop, tolerance = task.loop, stopping_tolerance(self)
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
            solved = from_linear_laws(problem, solved, tolerance, history)
        return solved, simulations


def stopping_tolerance(settings: FlexibleDIDIM) -> float:
    """Return the tolerance that settings stop at: their own, or their minimiser's."""
    return settings.tolerance or (_TOLERANCE if settings.minimiser == "least-squares" else _SIMPLEX_TOLERANCE)


def _at_rest(record: Record, settings: FlexibleDIDIM) -> tuple[Parameter, ...]:
    """Return the initial state at rest: on the reference for Nelder-Mead, which should search no more than it must.

    Where a rigid model of a flexible joint puts the motor is no guide: it is off by more than its deviations say.
    """
    assert record.reference is not None
    position, velocity = INITIAL_STATE
    home = float(record.reference.values[0])
    known = position.fixed(home) if settings.minimiser == "nelder-mead" else replace(position, start=home)
    return known, velocity.fixed(0.0)


def _hanging(problem: ClosedLoopProblem) -> ClosedLoopProblem:
    """Return the problem with the motor, at the first sample, where its load makes it hang."""
    home = beginning_position(problem)
    return problem.changed({p.name: replace(p, start=home) for p in problem.parameters if p.name == "initial_position"})


def inverse_model_covariance(problem: ClosedLoopProblem, x: FloatArray, error: FloatArray) -> Covariance:
    """Return the paper's covariance of the joint's free parameters, ``s^2 (W' W)^-1`` with W on the simulated motion.

    It is that of a regression on W, which is not what torque-only identification solves: for a flexible joint the
    output sensitivities are not W, and Fv1, Fv2 come out many times surer than they are.
    """
    run = problem.simulate(x)
    columns = problem.loop.joint.regressor(run.motor, run.load)
    names = [p.name for p in problem.loop.joint.parameters]
    free = [names.index(p.name) for p in problem.free_joint]
    W = np.concatenate([problem.filtered(equation[:, free]) for equation in columns])
    variance = float(error @ error) / (len(W) - W.shape[1])  # the paper's r counts the rows of both equations
    norms = np.linalg.norm(W, axis=0)
    inverse = np.linalg.inv((W / norms).T @ (W / norms))
    roots = np.sqrt(np.diag(inverse))
    return Covariance(np.sqrt(variance) * roots / norms, inverse / np.outer(roots, roots), 0)
