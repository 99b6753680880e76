"""The search in closed loop: where it begins, the simulations it takes and the trace of its steps."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from jointid.common.arrays import FloatArray
from jointid.common.errors import MethodError
from jointid.common.messages import Progress
from jointid.estimation.problems.closed_loop import ClosedLoopProblem
from jointid.estimation.problems.inverse_model import InverseModel, inverse_model
from jointid.estimation.result.parts import Iteration
from jointid.models.controllers import POSITION, REFERENCE, SampledLaw, invert
from jointid.models.joints import RigidJoint
from jointid.records.record import Channel, Tap, Timing
from jointid.solvers.bounded_least_squares import TrustRegion
from jointid.solvers.gauss_newton import GaussNewton
from jointid.solvers.regression import solution as linear_solution
from jointid.solvers.solve import Counted, Solution, Solver, Step, Tally, solve
from jointid.uncertainty.position_dependent_error import uncertainty

_SETTLED = 5.0  # periods of the position filter's cut-off after which a fault is forgotten
_STEPS = 6  # enough for two parameters that act almost linearly on the torque
_SLOPE = 20  # samples the initial velocity is first read from: the search corrects it


def crossover(law: SampledLaw, inertia: float) -> float:
    """Return the frequency in Hz up to which the law asks for more torque per position than the inertia takes."""
    hertz = np.geomspace(1e-5, 0.5, 400) / law.period
    loop_gain = np.abs(law.feedback(hertz)) / (abs(inertia) * (2 * math.pi * hertz) ** 2)
    above = np.flatnonzero(loop_gain >= 1.0)
    return float(hertz[above[-1]] if above.size else hertz[0])


@dataclass(frozen=True, slots=True, eq=False)
class Start:
    """Where a search begins.

    Attributes:
        values: of every parameter, by name.
        nominal_inertia: the inertia at which the simulated controller's gains are the real ones, while they are
            scaled with the inertia; None when they need not be.
    """

    values: dict[str, float]
    nominal_inertia: float | None


def reconstructed_position(problem: ClosedLoopProblem) -> FloatArray:
    """Return the motor position the known controller must have seen to put out the logged torque, (samples,).

    ``position = reference - C^-1(torque)``: no guess is needed, and because the controller's gain is large the result
    is finer than most encoders. The law's memory of what was before the record is a guess, so the first samples,
    one more than the law has states, are not to be used.

    Raises:
        MethodError: the log does not show the output of every period once, or the law cannot be inverted.
    """
    experiment = problem.experiment
    law, inputs = experiment.law, experiment.inputs
    command = command_of(problem)
    if experiment.every > 1:  # the log shows some of the periods: between them the torque is taken as a straight line
        command = np.interp(np.arange(experiment.periods) / experiment.every, np.arange(command.size), command)
    element = law.tap if experiment.tap is Tap.COMMAND else law.output
    slope = (inputs[1, REFERENCE] - inputs[0, REFERENCE]) / law.period
    state = law.known_memory(inputs) + law.memory(POSITION, inputs[0, REFERENCE], slope)
    integral = law.integral()
    if integral is not None:
        there = inputs[0] + inputs[0, REFERENCE] * (np.arange(inputs.shape[1]) == POSITION)
        first = law.C[0, law.output] @ state + law.D[0, law.output] @ there
        state = state + integral * (command[0] - first)
    return invert(law, command, inputs, state, element)[:: experiment.every][: experiment.samples]


def command_of(problem: ClosedLoopProblem) -> FloatArray:
    """Return the controller's output as the log shows it, (samples,), without what is added behind its limit."""
    experiment = problem.experiment
    whole = np.all(experiment.lags == experiment.lags[0])
    averaged, measured = experiment.timing is Timing.AVERAGED, experiment.tap is Tap.MEASURED
    if (
        experiment.repeat > 1
        or ((averaged or measured) and experiment.every > 1)
        or (averaged and measured and not whole)
    ):
        raise MethodError(
            "The controller can be turned round only when the log shows the output of its periods, each once at most; "
            'choose start = "regular".'
        )
    # A measured torque shows an output when it acts, an averaged one when its period is over.
    late = int(averaged) + (int(experiment.lags[0]) if measured else 0)
    output = np.concatenate([problem.measured[late:], np.full(late, problem.measured[-1])])
    added = experiment.after_limit if measured else experiment.logged
    return np.asarray(output - added[:: experiment.every][: output.size])


def initial_state(problem: ClosedLoopProblem, position: FloatArray) -> dict[str, float]:
    """Return where a reconstructed motion begins: a line through its first usable samples."""
    law = problem.experiment.law
    skip, sample_time = law.order // problem.experiment.every + 1, problem.experiment.sample_time
    first = position[skip : skip + _SLOPE]
    slope, value = np.polyfit(np.arange(first.size) * sample_time, first, 1)
    return {"initial_position": float(value - slope * skip * sample_time), "initial_velocity": float(slope)}


def fit_initial_state(problem: ClosedLoopProblem) -> tuple[FloatArray, int]:
    """Return the initial state that fits best, position and velocity, and the simulations it took.

    A motor at rest and a moving one are two problems (see `didim`), so both are solved.
    """
    try:
        start = initial_state(problem, reconstructed_position(problem))
    except MethodError:  # a controller that cannot be inverted: start on the reference, at rest
        start = {"initial_position": float(problem.experiment.inputs[0, 0]), "initial_velocity": 0.0}
    problems = (problem.keeping({"initial_velocity": 0.0}), problem)
    solver = GaussNewton(tolerance=1e-9, step_tolerance=math.inf, iterations=_STEPS, halvings=0)
    ends = [(p, solve(p, solver, p.vector(start))) for p in problems]
    which, best = min(ends, key=lambda end: float(np.linalg.norm(end[1].residual)))
    return problem.vector(which.values(best.x)), sum(end.evaluations for _, end in ends)


def inversion_start(problem: ClosedLoopProblem) -> Start:
    """Return what IDIM finds on the reconstructed position: nearly what it finds on a measured one."""
    joint, position = _rigid(problem), reconstructed_position(problem)
    command = command_of(problem)
    acting = command + problem.experiment.after_limit[:: problem.experiment.every][: command.size]
    found = _regressed(problem, joint, acting, position, _unlimited(problem), problem.experiment.law.delay)
    return Start(_kept(problem, found | initial_state(problem, position)), None)


def regular_start(problem: ClosedLoopProblem, given: dict[str, float] | None = None) -> Start:
    """Return a regular inertia and no friction, or the given values, with the controller's gains to be scaled.

    The loop of an inertia that is `n` times too large, under gains that are `n` times too large, moves like the real
    one; regressing on its motion gives good values at once. The real loop's own inertia is first read off the
    reference, as if the axis tracked it perfectly.
    """
    experiment, joint = problem.experiment, _rigid(problem)
    periods = experiment.log_index // experiment.lengths.size
    reference = experiment.inputs[periods, REFERENCE]
    torque = problem.measured - experiment.logged[periods] + experiment.after_limit[periods]
    tracked = _regressed(problem, joint, torque, reference, np.ones(torque.size, dtype=np.bool_))
    known = next(p for p in problem.parameters if p.name == "inertia")
    nominal = abs(tracked["inertia"]) if known.free else float(known.start or 1.0)
    regular = {p.name: 0.0 for p in problem.parameters} | {"inertia": nominal}
    regular |= {"initial_position": float(reference[0]), "initial_velocity": 0.0}
    return Start(_kept(problem, regular | (given or {})), nominal)


def given_start(problem: ClosedLoopProblem) -> Start:
    """Return the starts the parameters carry; those without one begin as in `regular_start`."""
    given = {p.name: p.start for p in problem.parameters if p.start is not None}
    if given.get("inertia", 1.0) <= 0:
        raise MethodError(f"A start for the inertia must be positive; received {given['inertia']}.")
    return regular_start(problem, given)


def _unlimited(problem: ClosedLoopProblem) -> NDArray[np.bool_]:
    """Return where the law can be turned round: away from its limit, and from what the filter smears of it.

    Where nothing would be left, everything: a poor start is better than none.
    """
    experiment = problem.experiment
    output = np.abs(command_of(problem))
    cutoff = problem.filtering.position_cutoff
    assert cutoff is not None
    reach = experiment.law.order + round(_SETTLED / (cutoff * experiment.sample_time))
    at_limit = output >= experiment.law.limit * (1 - 1e-9)
    if not np.any(at_limit):
        return ~at_limit
    limited = np.convolve(at_limit, np.ones(2 * reach + 1))[reach : reach + at_limit.size] > 0.5
    return ~limited if np.mean(limited) < 0.5 else np.ones_like(limited)


def _regressed(
    problem: ClosedLoopProblem,
    joint: RigidJoint,
    torque: FloatArray,
    position: FloatArray,
    known: NDArray[np.bool_],
    delay: float = 0.0,
) -> dict[str, float]:
    """Return what IDIM finds where the position is known; elsewhere it is bridged, and both sides weigh nothing."""
    sample_time, instants = problem.experiment.sample_time, np.arange(torque.size)
    filtering = replace(problem.filtering, borders=(50, 50) if torque.size > 500 else (0, 0), timing="respected")
    held = Channel(torque, joint.force_unit, sample_time, Timing.HELD)
    if not np.all(known):
        position = np.interp(instants, instants[known], position[known])
    model = inverse_model(joint, held, (position,), filtering, delay)
    if not np.all(known):
        columns = model.columns * known[:, np.newaxis]
        model = InverseModel(model.torque * known, columns, model.inside, model.motor)
    parameters, free = problem.parameters[: len(joint.parameters)], problem.free_joint
    kept = np.array([0.0 if p.free else p.start or 0.0 for p in parameters])
    Y, W = model.decimated(filtering, sample_time, kept, compiled=True)
    names = tuple(p.name for p in free)
    found = linear_solution(W[:, [p.free for p in parameters]], Y, names)
    return dict(zip(names, map(float, found), strict=True))


def _kept(problem: ClosedLoopProblem, values: dict[str, float]) -> dict[str, float]:
    """Return the values with every fixed parameter at what it is fixed to."""
    return values | {p.name: p.start or 0.0 for p in problem.parameters if not p.free}


def _rigid(problem: ClosedLoopProblem) -> RigidJoint:
    if not isinstance(problem.loop.joint, RigidJoint):
        raise MethodError("This start is for a rigid joint; identify the joint as rigid first.")
    return problem.loop.joint


# The way from there

_CLEARLY = 25.0  # times the residual's variance: the first rows of a filter without a lag vary more than the others ...
_SURELY = 2.0  # ... and robust standard deviations of that velocity
MOVING = 9.0  # times the residual's variance: what a velocity at the first sample must explain to be believed


class Solved(NamedTuple):
    """A problem and where a solver ended on it."""

    problem: ClosedLoopProblem
    solution: Solution


def begins_moving(resting: Solved, moving: Solved, history: History) -> bool:
    """Whether the motor moves at the first sample: more of the torque is explained than by noise, and surely so.

    A residual is correlated as a rule, and a motor that slips before it sticks changes where it stands for the rest of
    the record: the gain alone would invent a motion. The velocity has to be more than two of its robust standard
    deviations, too.

    Args:
        resting: where the search ended with the motor at rest there.
        moving: where it ended with a velocity.
        history: counts the simulations.
    """
    before, after = (float(np.sum(end.solution.residual**2)) for end in (resting, moving))
    if before - after <= _CLEARLY * before / resting.solution.residual.size:
        return False
    problem, (x, J) = moving.problem, (moving.solution.x, -moving.solution.jacobian)
    names = [p.name for p in problem.free]
    if "initial_velocity" not in names:
        return True
    history.tally.evaluations += 1
    known = uncertainty(J, J, moving.solution.residual, problem.cells(problem.simulate(x)), names, problem.torque_unit)
    at = names.index("initial_velocity")
    return bool(abs(x[at]) > _SURELY * known.covariance.std[at])


class History:
    """Counts the simulations of a search, and notes its steps.

    A search solves several problems: one record on one band after the other, with the motor at rest or moving.
    """

    def __init__(self, progress: Progress) -> None:
        self.progress, self.tally, self.trace = progress, Tally(), list[Iteration]()
        self._last: Counted | None = None
        self._starts, self._best = 0, math.inf

    def counted(self, problem: ClosedLoopProblem) -> Counted:
        """Return the problem with its evaluations counted; what was linearised last is not evaluated again."""
        if self._last is None or self._last.problem is not problem:
            self._last = Counted(problem, self.tally)
        return self._last

    def solve(self, problem: ClosedLoopProblem, solver: Solver[Counted], start: FloatArray) -> Solved:
        """Solve a problem, and note the steps."""
        size = problem.size or 1.0
        self.begin()

        def watch(step: Step) -> None:
            last = None
            if self.trace:
                before = self.trace[-1]
                last = problem.vector(before.values), before.residual_norm
            number = self.note(problem, step.x, step.norm, last, np.where(step.x != 0.0, np.abs(step.x), 1.0))
            if number % 100 == 0 or number < 10:  # a simplex takes more than a thousand steps
                self.tell(number, step.norm / size)

        return Solved(problem, solve(self.counted(problem), solver, start, watch))

    def begin(self) -> None:
        """Note that what follows is another start: its error may be larger than the last one's."""
        self._starts += 1

    def tell(self, number: int, error: float) -> None:
        """Tell an iteration's torque error, as a share, and of another start the best so far beside a larger one."""
        which = f"start {self._starts}, " if self._starts > 1 else ""
        best = f" (best so far {100 * self._best:.4f} %)" if which and error > self._best else ""
        self._best = min(self._best, error)
        self.progress(f"{which}iteration {number}: torque error {100 * error:.4f} %{best}")

    def note(
        self,
        problem: ClosedLoopProblem,
        x: FloatArray,
        norm: float,
        before: tuple[FloatArray, float] | None,
        scales: FloatArray,
        gain_scale: float = 1.0,
    ) -> int:
        """Add a line to the trace, and return its number.

        Args:
            problem: that is being solved.
            x: (free,) where.
            norm: of the residual there.
            before: the same of the step before, if there was one.
            scales: what changes of the first parameters are measured against; those of the others do not count.
            gain_scale: see `Iteration`.
        """
        change = step = None
        if before is not None:
            change = abs(norm - before[1]) / before[1] if before[1] else 0.0
            step = float(np.max(np.abs(x - before[0])[: scales.size] / scales))
        number = len(self.trace)
        self.trace.append(Iteration(number, problem.values(x), norm, change, step, self.tally.evaluations, gain_scale))
        return number


def least_squares(problem: ClosedLoopProblem, tolerance: float) -> TrustRegion:
    """Return the solver of a closed loop: in units of the torque and of the start, the same in any units."""
    return TrustRegion(tolerance, size=problem.size)


def free_more(
    problem: ClosedLoopProblem, x: FloatArray, names: tuple[str, ...], tolerance: float, history: History
) -> Solved:
    """Go on by least squares with more of what surrounds the joint free.

    Args:
        problem: that was solved.
        x: (free,) where.
        names: of what is freed, see `surrounding`.
        tolerance: of the parameters and the criterion.
        history: of the search.

    Raises:
        MethodError: nothing around the joint has such a name, or one record cannot tell it.
    """
    if isinstance(names, str):
        raise MethodError(f'What is freed is a list of names; received "{names}": write free=("{names}",).')
    if "drive_gain" in names:
        raise MethodError(
            "One record cannot tell the drive_gain from the scale of the joint; free log_gain or a gain of the law, or "
            "identify from two records with a known mass between them."
        )
    wider = problem.freeing(*names)
    return history.solve(wider, least_squares(wider, tolerance), wider.vector(problem.values(x)))
