"""The drive side of a joint: identification without a controller, along the motion that its motor made.

Torque and motor position are enough, without a load encoder. The motor's motion comes from the record, filtered, and is
prescribed; the load is simulated behind it (`simulation.drive_side`), and the torque this takes is compared with the
measured one, filtered alike. It is seen as the log saw it: late by ``log_delay``, where that is free. The delay acts on
the prediction; on the measurement it would let a fit shrink both sides to nothing. While the motor rests, its friction
takes what it must and the torque says nothing; these samples have no weight, on both sides alike and before the filter,
which would smear them. Nor have those about reversals of a rigid joint.

Bounded least squares with exact derivatives goes down from starts that need no guess: for each of a row of motor-locked
frequencies, at which the motor sees an anti-resonance, a frictionless load of one unit is simulated, and everything
else about the joint is then linear. The best few are refined.

A motor inside a closed loop answers to what disturbs it, so its measured motion is correlated with the error, and least
squares is biased: the intervals are widened for that (`Influence.widen_for_motion`).
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING

import numpy as np

from jointid.common.arrays import FloatArray
from jointid.common.errors import MethodError
from jointid.common.messages import Detail
from jointid.common.parallel import in_threads
from jointid.common.parameters import Parameter, Quantity
from jointid.common.settings import add_settings_to_docstring, declare, setting
from jointid.estimation.methods.registry import EVALUATIONS, FREQUENCIES, MODELS, OFFSETS, ROBOT, Method, Task
from jointid.estimation.problems.base import FAILED, LOG_DELAY, RecordProblem, log_delay
from jointid.estimation.problems.closed_loop import require_free
from jointid.estimation.problems.inverse_model import (
    SAID,
    MeasuredMotion,
    moving_weights,
    steady_weights,
    torque_and_positions,
)
from jointid.estimation.result.build_result import build_estimate, build_params, find_active_bounds
from jointid.estimation.result.estimate import Estimate
from jointid.estimation.result.parts import Checks, Settings
from jointid.models.joints import Joint, acts_on_whole
from jointid.records.record import Record
from jointid.records.signals.filtering import (
    Filtering,
    describe_noise_limit,
    differentiate,
    find_noise_limit,
    lowpass,
    window_torque,
)
from jointid.simulation.drive_side import (
    PARTS,
    DriveSide,
    DriveSideRun,
    prescribe,
)
from jointid.simulation.plant import LOAD_STATE, Numbers, Place
from jointid.simulation.simulate import Outcome
from jointid.solvers.bounded_least_squares import LevenbergMarquardt
from jointid.solvers.solve import Step, solve
from jointid.uncertainty.covariance import Influence

if TYPE_CHECKING:
    from jointid.estimation.problems.simulated import MotionLog

_LOAD_PARAMETERS = (
    Parameter(LOAD_STATE[0], "dq12(0)", Quantity.POSITION),
    Parameter(LOAD_STATE[1], "dv12(0)", Quantity.VELOCITY),
)

_GUESSES = 28  # motor-locked frequencies to try, evenly on a logarithmic scale ...
_LOWEST = 0.05  # ... from this share of the cut-off up to it
_DAMPING = 0.05  # of the load that is tried: as wide as the steps of the grid
_REFINED, _WORSE = 3, 3.0  # valleys of the grid that are refined, at most; and how much worse than the best


@dataclass(frozen=True, slots=True, eq=False)
class DriveSideProblem(RecordProblem):
    """The torque of one record along its own motor motion; the torque is through `filtering.window_torque`.

    Beside the joint's parameters there are those of `LOAD_STATE`, and ``log_delay``. The filter's borders are left out
    before it is applied.

    Attributes:
        joint: what is identified.
        log: the motion of its motor, prescribed, and the rows that are compared.
    """

    joint: Joint
    log: MotionLog

    @property
    def sample_time(self) -> float:
        """Of the measured signal, seconds."""
        return self.log.sample_time

    def filter(self, columns: FloatArray) -> FloatArray:
        """Return signals, (samples,) or (samples, columns), weighted, through the problem's own filter."""
        return self.log.decimate_joint(0, columns)

    def run(self, x: FloatArray) -> DriveSideRun:
        """Return the simulation itself, part by part."""
        return self.log.run(Numbers((self.joint,), (self.values(x),)))

    def predict(self, x: FloatArray) -> FloatArray:
        """Return the prediction of `measured`, (samples,)."""
        return self.log.predict(self.run(x))[:, 0]

    def residual(self, x: FloatArray) -> FloatArray:
        """Return the filtered, decimated error, (rows,); of a candidate that fails, something large."""
        return self._error(self.run(x))

    def linearise(self, x: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the residual, (rows,), and its derivatives by the free parameters, (rows, free)."""
        run = self.run(x)
        error = self._error(run)
        if run.outcome is not Outcome.FINISHED:
            return error, np.zeros((error.size, x.size))
        return error, -self.log.slopes(run, [Place(0, p.name) for p in self.free])

    def _error(self, run: DriveSideRun) -> FloatArray:
        if run.outcome is not Outcome.FINISHED:
            return FAILED * self.filter(self.measured)
        return self.filter(self.measured - self.log.predict(run)[:, 0])


def motion_problem(
    record: Record,
    setup: DriveSide,
    filtering: Filtering,
    parameters: tuple[Parameter, ...],
    delay: Parameter,
) -> DriveSideProblem:
    """Return the problem of reproducing a record's torque along its motor motion.

    Args:
        record: with torque and motor position at one rate, the position sampled.
        setup: the joint.
        filtering: of position and torque.
        parameters: of the joint.
        delay: the parameter ``log_delay``.

    Raises:
        RecordError: a channel is missing, or at another rate.
        MethodError: no parameter of the joint is free.
    """
    require_free(parameters)
    torque, (position,) = torque_and_positions(record, setup.joint, ("motor_position",), "Drive-side identification")
    sample_time = torque.sample_time
    limit = find_noise_limit([position], sample_time)
    filtering = filtering.resolve(sample_time, setup.joint.model, limit)
    assert filtering.position_cutoff is not None
    smooth = lowpass(position, filtering.position_cutoff, sample_time)[:, np.newaxis]
    prescribed = prescribe(smooth, sample_time, PARTS)
    rests = not moving_weights(prescribed.velocity[::PARTS, 0])[0]
    if rests:  # the rounding of an encoder would have its load begin where Coulomb friction drags it
        prescribed = prescribe(smooth, sample_time, PARTS, resting=True)
    velocity = prescribed.velocity[::PARTS]
    weights = moving_weights(velocity[:, 0])
    if setup.joint.model == "rigid":  # a spring smooths the jump of the load's acceleration at a reversal
        weights = steady_weights(velocity[:, 0], filtering.position_cutoff, sample_time)[1]
    motion = MeasuredMotion(
        smooth, velocity, differentiate(velocity, sample_time), window_torque(torque)[:, np.newaxis],
        weights[:, np.newaxis], sample_time, filtering, limit, position[:, np.newaxis],
        told=-math.inf,  # faint rows count, too
    )  # fmt: skip
    around = () if setup.joint.model == "rigid" else _LOAD_PARAMETERS
    # A load at rest rests where it was left.
    first = tuple(replace(p, free=bool(weights[0]), start=0.0) for p in around)
    from jointid.estimation.problems.simulated import MotionLog  # which loads kernels

    log = MotionLog(motion.torque, filtering, motion, prescribed, PARTS)
    return DriveSideProblem((*parameters, *first, delay), motion.torque[:, 0], filtering, setup.joint, log)


@add_settings_to_docstring
@dataclass(frozen=True, slots=True)
class DriveSideFit(Method):
    """Settings of the drive-side identification."""

    name = "drive_side"
    title = "the drive-side method"
    default_for = DriveSide

    log_delay: float | None = setting(
        None,
        "how much later than it acts the log shows the torque, negative for a command that comes first; without it "
        "estimated",
        unit="s",
    )
    frequency: float | None = setting(
        None,
        "motor-locked frequency of the start; without it the best of a grid",
        unit="Hz",
        above=0,
        systems=MODELS,
    )
    tolerance: float = setting(
        1e-8, "change of the criterion or the parameters to stop at, as a share", above=0, systems=MODELS
    )
    offsets: bool = setting(True, OFFSETS, systems=ROBOT)
    evaluations: int = setting(60, EVALUATIONS, at_least=1, systems=ROBOT)
    frequencies: Mapping[str, float] = field(
        default_factory=dict, hash=False, metadata=declare(FREQUENCIES, systems=ROBOT)
    )

    def identify(self, task: Task) -> Estimate:
        """Identify a joint from torque and motor position, whatever its controller.

        The position's cut-off should be five times the free-free
        frequency or more, the other one above it.

        Raises:
            RecordError: a channel is missing, or at another rate.
            MethodError: no start gives a joint with positive inertias.
        """
        record, setup = task.record, DriveSide(task.joint)
        record.require(setup.channels, "Drive-side identification")
        assert record.torque is not None
        delay = log_delay(self.log_delay, record.torque.sample_time, stated=record.torque.stated)
        problem = motion_problem(record, setup, task.filtering, task.parameters, delay)
        motion = problem.log.motion
        moving = moving_weights(motion.v[:, 0])[:, np.newaxis]
        if task.joint.model == "rigid" and _linear(problem, None)[0] == math.inf:
            # Of a light joint in noise the reversals may be all that tells of its inertia.
            problem = replace(problem, log=problem.log.with_rows(moving))
        starts, simulations = grid_starts(problem, self.frequency)
        numbers = itertools.count(1)

        def watch(step: Step) -> None:
            task.progress(Detail(f"iteration {next(numbers)}: residual {step.norm:.6g}"))

        found = solve(problem, LevenbergMarquardt(self.tolerance), np.array(starts), watch)
        x, J, error = found.x, found.jacobian, found.residual
        influence = Influence(J, error)
        covariance = influence.widen_for_motion(influence.widen_for_bands(influence.by_time()))
        # What moves nothing has no deviation, which is no deviation of 0; where nothing can be simulated, all of it.
        idle = np.asarray(~J.any(axis=0), dtype=np.bool_)
        covariance = replace(covariance, std=np.where(idle, np.nan, covariance.std))
        warnings = list(describe_noise_limit(problem.filtering, motion.limit, problem.sample_time, task.joint.model))
        if (resting := 1 - float(np.mean(moving))) > SAID:
            warnings.append(
                f"the motor rests in {100 * resting:.0f} % of the record, where its torque says nothing of it"
            )
        late = -problem.values(x)[LOG_DELAY.name]
        left = problem.residual(x)
        return build_estimate(
            [record],
            build_params(problem, x, covariance, find_active_bounds(problem.free, x, error, J)),
            (problem.measured, problem.predict(x)),
            problem.filtered_error(left),
            left.size,
            (found.message, found.converged),
            simulations + found.evaluations,
            Settings("drive_side", "drive-side by least squares", problem.joint, None, problem.filtering, late),
            ("torque", "motor_position"),
            Checks(warnings=tuple(warnings)),
        )


def grid_starts(problem: DriveSideProblem, frequency: float | None) -> tuple[list[FloatArray], int]:
    """Return the best few starts, and the simulations they took (see the module); of a rigid joint there is one.

    Args:
        problem: to be solved.
        frequency: motor-locked, Hz; None tries a row of them.

    Raises:
        MethodError: at none of them are all inertias positive.
    """
    cutoff = problem.filtering.cutoff
    assert cutoff is not None
    flexible = problem.joint.model == "flexible"
    grid = [frequency if flexible else None]
    if flexible and frequency is None:
        grid = [cutoff * _LOWEST ** (1 - i / (_GUESSES - 1)) for i in range(_GUESSES)]
    tried = in_threads(lambda one: _linear(problem, one), grid)
    costs = np.array([cost for cost, _ in tried])
    # A valley of the criterion is refined once; the ends of the row are no worse than values outside it.
    around = np.concatenate([[np.inf], costs, [np.inf]])
    valleys = [i for i in range(costs.size) if costs[i] < np.inf and around[i] >= costs[i] <= around[i + 2]]
    if not valleys:
        raise MethodError(
            "Torque and motor position give no joint with positive inertias: one of them has the wrong sign (turn "
            "record.channels.torque.sign round), or they do not belong together."
        )
    # One that explains much less of the torque than another will not overtake it.
    lowest = float(min(costs))
    best = sorted((i for i in valleys if costs[i] <= _WORSE * lowest), key=lambda i: float(costs[i]))[:_REFINED]
    given = {p.name: p.start for p in problem.parameters if p.start is not None}  # goes before what was found
    return [problem.vector(tried[i][1] | given) for i in best], len(grid)


def _linear(problem: DriveSideProblem, frequency: float | None) -> tuple[float, dict[str, float]]:
    """Return the residual norm and the parameters of a joint with that motor-locked frequency: one regression.

    The load is frictionless and weighs nothing in the simulation, so that its inertia multiplies one column; what it
    weighs is then a column, too, and a counterbalance is part of it. The log's delay is the factor of the measured
    torque's slope.
    """
    flexible = frequency is not None
    inertia, prefix = ("motor_inertia", "motor_") if flexible else ("inertia", "")
    friction = tuple(p.name for p in problem.joint.friction.parameters(prefix, ""))
    unit = {p.name: 0.0 for p in problem.parameters} | {inertia: 1.0}
    if frequency is not None:
        rate = 2 * math.pi * frequency
        unit |= {"load_inertia": 1.0, "stiffness": rate**2, "damping": 2 * _DAMPING * rate}
    forces = tuple(p.name for p in problem.joint.parameters if p.free and acts_on_whole(p.name))
    names = (inertia, *friction, *forces)
    sought = (replace(p, free=True) if p.name in names else p.fix(unit[p.name]) for p in problem.parameters)
    trial = replace(problem, parameters=tuple(sought))
    x = np.array([unit[p.name] for p in trial.free])
    error, J = trial.linearise(x)
    W = [-column for column in J.T]
    if flexible:
        W.append(trial.filter(problem.measured) - error + J[:, 0])  # the prediction, less the motor's inertia
    if any(p.name == LOG_DELAY.name and p.free for p in problem.parameters):
        W.append(-problem.filter(np.gradient(problem.measured, problem.sample_time)))
    columns = np.column_stack(W)
    Y = problem.filter(problem.measured)
    norms = np.maximum(np.linalg.norm(columns, axis=0), 1e-300)
    chi = np.linalg.lstsq(columns / norms, Y, rcond=1e-10)[0] / norms
    found = dict(zip((p.name for p in trial.free), map(float, chi), strict=False))
    if flexible:
        load = float(chi[len(trial.free)])
        found |= {name: load * unit[name] for name in ("load_inertia", "stiffness", "damping")}
        for name in friction:  # what the regression finds is that of both sides
            found[name] = 0.5 * max(found[name], 0.0)
            found[name.replace("motor_", "load_")] = found[name]
    positive = min(found[inertia], found.get("load_inertia", 1.0)) > 0
    return (float(np.linalg.norm(Y - columns @ chi)) if positive else math.inf), found
