"""DIDIM: direct and inverse dynamic identification models, from torque and reference only.

**A rigid joint.** The closed loop is simulated at the current parameters, and the torque error is made least, with the
output sensitivities J = d tau_sim / d chi, from several starts, with the same answer. The starts are IDIM's estimate on
the motion that the inverted controller gives, and a regular inertia (`rigid_starts`). From each
a descent begins with the motor at rest at the first sample, and from the best end one with it moving
(`estimation.descent`).

The paper steps to a fixed point instead, where least squares on the inverse dynamic regressor W of the simulated
motion changes nothing any more [P section IV.A]. With a model error, the least torque error and that fixed point may
differ by more than the deviations of either; the interval is then widened to hold both (`widened_to_second`).

**A flexible joint.** The load is not controlled, so the regressor on the simulated motion is no approximation of the
Jacobian [P section IV.B]; the criterion itself is minimised, ``J = ||Y - Ys||^2`` of the filtered, decimated torque,
by the same descents (`spring_search`).

Nonlinear laws begin at the end with linear ones, and so does a search with more of the surroundings free. **A robot**
is searched for by `estimation.robots`.
"""

import contextlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from jointid.common.errors import MethodError
from jointid.common.parameters import find_active_bounds
from jointid.common.settings import add_settings_to_docstring, setting
from jointid.common.text import join
from jointid.estimation.descent import (
    NOTHING,
    ROUGHLY,
    History,
    Solved,
    free_more,
    from_linear_laws,
    search_rigid_joint,
)
from jointid.estimation.force_in_loop import widen_for_force
from jointid.estimation.methods import EVALUATIONS, FREQUENCIES, MODELS, OFFSETS, Method, Task
from jointid.estimation.parameters import DELAYS, INITIAL_STATE
from jointid.estimation.problems.simulated import ClosedLoopProblem, beginning_position, require_free, torque_problem
from jointid.estimation.result.estimate import Estimate, Settings, build_estimate, rows_of_problem, warn_of_limit
from jointid.estimation.result.springs import visible
from jointid.estimation.result.verdict import residual_checks
from jointid.estimation.rigid_starts import rigid_starts
from jointid.estimation.robots.simulated import identify_simulated_robot
from jointid.estimation.spring_search import rough_rigid_joint, search_flexible_joint
from jointid.models.controllers import REFERENCE, numbers_of, with_numbers
from jointid.models.joints import ClosedLoop
from jointid.models.robots.robot import RobotLoop
from jointid.simulation.plant import DELAY
from jointid.solvers.solve import refuse_idle
from jointid.uncertainty.covariance import Influence
from jointid.uncertainty.identifiability import identifiability
from jointid.uncertainty.model_tests import whiteness, widened_to_second
from jointid.uncertainty.position_dependent_error import uncertainty

_OUTPUTS = ("torque", "motor_position")


def _check_outputs(outputs: Sequence[str]) -> None:
    if not set(outputs) <= set(_OUTPUTS) or len(outputs) > 1:
        raise MethodError(
            f"DIDIM reproduces one output, {' or '.join(_OUTPUTS)}; received {join(list(outputs))}: leave outputs out "
            "to take the torque where it is logged."
        )


@add_settings_to_docstring
@dataclass(frozen=True, slots=True)
class DIDIM(Method):
    """Settings of DIDIM; some apply only to rigid, flexible or robot systems."""

    name = "didim"
    title = "DIDIM"
    default_for = ClosedLoop, RobotLoop
    robots = (RobotLoop,)
    simulates = "loop"

    tolerance: float = setting(
        1e-8, "change of the criterion, and of the parameters, to stop at, as a share", above=0, systems=MODELS
    )
    frequency: float | None = setting(
        None,
        "free-free frequency from which the search of the stiffness starts, with the inertia halved; by default the "
        "best of a grid, with one simulation each",
        unit="Hz",
        above=0,
        systems=("flexible",),
    )
    free: tuple[str, ...] = setting(
        (),
        "what surrounds the joint and is identified with it, by least squares from where DIDIM ends, from what is "
        'declared: a number of the law such as "position_gain", "delay" or "torque_filters.0.frequency", or '
        '"log_gain", "log_delay". For a robot only delays: "delay" for all joints, "elbow.delay" for one',
    )
    outputs: tuple[str, ...] = setting(
        (),
        'signal that is fitted: ["torque"], or ["motor_position"] seen through the controller; by default the torque '
        "if it is logged, else the motor position",
        accept=_check_outputs,
    )
    offsets: bool = OFFSETS
    evaluations: int = EVALUATIONS
    frequencies: Mapping[str, float] = FREQUENCIES

    def identify(self, task: Task) -> Estimate:
        """Identify a joint from torque and reference; a motor position is unused.

        The filter goes over torque and columns alike. The mode of a flexible joint must lie below the cut-off.

        Raises:
            RecordError: a channel is missing.
            MethodError: the record does not determine the parameters, or the loop cannot be simulated at any start.
        """
        history = History(task.progress, self.tolerance)
        solved, loop = self.solve(self._near_delay(task, history), history), task.loop
        starts = solved.solution.starts
        if self.free:
            solved = free_more(solved, self.free, history)
            if loop is not None and solved.problem.loop.controller != loop.controller:  # a free delay stays what it is
                solved = solved._replace(problem=solved.problem.under(loop.controller))
        problem, x = solved.problem, solved.x
        error, J = solved.solution.residual, solved.solution.jacobian
        run, end = problem.simulate(x), (solved.solution.message, solved.solution.status.converged)
        if task.joint.model == "rigid":
            joint = problem.free_joint
            refuse_idle(J[:, : len(joint)], tuple(p.name for p in joint))
        elif np.linalg.norm(error) > NOTHING * problem.size:
            end = f"no answer: the search ended where the model explains little of the torque ({end[0]})", False
        known = uncertainty(Influence(J, error), problem.cells(run))
        flexible = task.joint.model == "flexible"
        spring = visible(problem, x, J, known, starts, history.progress) if flexible else None
        if spring is None or spring.shown:  # what is refused has no interval to widen; `visible` widens the rest
            known, _ = widen_for_force(known, problem, x, -J)
        if not flexible and problem.joint.friction.linear:  # else no regressor is linear
            columns, held = problem.joint.regressor(run.motor)[0], find_active_bounds(problem.free, x, error, J)
            Z = problem.filter(columns[:, [p.free for p in problem.own]])
            Z = np.hstack([Z, -J[:, Z.shape[1] :]])
            known = widened_to_second(known, Z, -J, error, np.array([p.name not in held for p in problem.free]))
        filtering = problem.filtering
        assert filtering.cutoff is not None
        white = whiteness(error, problem.sample_time * problem.step, filtering.cutoff)
        delay = problem.values(x).get("delay", problem.axis.law.delay)
        made = build_estimate(
            [task.record],
            rows_of_problem(problem, x, known.covariance, error, J),
            known.covariance.correlation,
            (problem.measured, run.torque),
            problem.filtered_error(error),
            error.size,
            end,
            history.counted.evaluations,
            Settings(self.name, "DIDIM by least squares", problem.joint, problem.loop_at(x), filtering, delay),
            checks=residual_checks(white, known.repeatable),
            known=identifiability(problem.free, problem.units, x, J, known.covariance),
            warnings=warn_of_limit(run.at_limit),
            notes=tuple(map(str, known.warnings)),
            problem=problem,
            x=x,
            shifts=known.shifts,
        )
        return made if spring is None else spring.state(made)

    identify_robot = identify_simulated_robot

    def solve(self, task: Task, history: History) -> Solved:
        """Search for the least torque error from all starts, linear laws first."""
        model, problem = task.joint.model, _pose(task)
        linear = problem if problem.joint == problem.joint.linear else problem.with_joint(problem.joint.linear)
        require_free(linear.free_joint)
        if model == "flexible":
            solved = search_flexible_joint(linear, task, self.frequency, history)
        else:
            starts = rigid_starts(linear, task.progress)
            solved = search_rigid_joint(linear, starts, history, freed=bool(self.free))
        if linear is problem:
            return solved
        if DELAY in self.free and model == "flexible":  # a gap is found where torque and motion are in time
            solved = free_more(solved, (DELAY,), history)
        return from_linear_laws(problem, solved, history)

    def _near_delay(self, task: Task, history: History) -> Task:
        """Set the delay near its best value, if free and not declared.

        A wrong delay changes the phase of a mode and of the loop, which other joints explain as well. A rigid joint is
        therefore searched below resonance from several delays, and the best end decides.
        """
        loop = task.loop
        if loop is None or DELAY not in self.free or numbers_of(loop.controller).get(DELAY) != 0.0:
            return task
        ends = dict[float, float]()
        for late in DELAYS:
            law = with_numbers(loop.controller, {DELAY: late})
            with contextlib.suppress(MethodError):  # no joint is stable with it
                rough = rough_rigid_joint(replace(task, loop=replace(loop, controller=law)), history)
                end = free_more(rough, (DELAY,), replace(history, tolerance=ROUGHLY))
                ends[end.values[DELAY]] = end.norm / end.problem.size
        law = with_numbers(loop.controller, {DELAY: min(ends, key=lambda late: ends[late], default=0.0)})
        return replace(task, loop=replace(loop, controller=law))


def _pose(task: Task) -> ClosedLoopProblem:
    """Pose the problem; a flexible joint begins at rest in balance.

    The motor position of a rigid model is no guide for a flexible joint: its error exceeds its deviations.
    """
    assert task.loop is not None
    problem = torque_problem(task.record, task.loop, task.filtering, task.parameters)
    if task.joint.model == "rigid":
        return problem
    home = float(problem.axis.inputs[0, REFERENCE]) if task.joint.gravity is None else beginning_position(problem)
    position, velocity = INITIAL_STATE
    rest = {position.name: replace(position, start=home), velocity.name: velocity.fix(0.0)}
    return problem.replace_parameters(rest)
