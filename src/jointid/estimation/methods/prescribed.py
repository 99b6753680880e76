"""Identification without a controller, along a prescribed motion: the drive side.

Torque and motor position are enough, without a load encoder.
The motor's motion is prescribed, the load is simulated behind it, and the torque this takes is compared with the
measured one, filtered alike (`prescribed`). Bounded least squares with exact derivatives goes down from starts that
need no guess: for each of a row of motor-locked frequencies, at which the motor sees an anti-resonance, a frictionless
load of one unit is simulated, and everything else about the joint is then linear. The best few are refined.

A motor inside a closed loop answers to what disturbs it, so its measured motion is correlated with the error, and least
squares is biased: the intervals are widened for that (`with_measured_motion`).
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from jointid.common.arrays import FloatArray
from jointid.common.errors import MethodError
from jointid.common.messages import Detail, Progress
from jointid.common.parallel import in_threads
from jointid.common.parameters import Parameter
from jointid.common.settings import add_settings_to_docstring, declare, setting
from jointid.estimation.methods.registry import EVALUATIONS, FREQUENCIES, MODELS, OFFSETS, ROBOT, Method, Task
from jointid.estimation.problems.base import LOG_DELAY, log_delay
from jointid.estimation.problems.inverse_model import noise_limit_of
from jointid.estimation.problems.prescribed import CURRENT_LAG, DriveSideProblem, motion_problem, weights_of
from jointid.estimation.problems.rest import SAID
from jointid.estimation.result.assemble import FitResult
from jointid.estimation.result.build_result import build_prescribed_result
from jointid.models.joints import acts_on_whole
from jointid.records.signals.position_noise import describe_noise_limit
from jointid.simulation.prescribed import DriveSide
from jointid.solvers.bounded_least_squares import LevenbergMarquardt
from jointid.solvers.solve import Step, Watch, solve
from jointid.uncertainty.covariance import sandwich, with_bands, with_measured_motion

_GUESSES = 28  # motor-locked frequencies to try, evenly on a logarithmic scale ...
_LOWEST = 0.05  # ... from this share of the cut-off up to it
_DAMPING = 0.05  # of the load that is tried: as wide as the steps of the grid
_REFINED, _WORSE = 3, 3.0  # valleys of the grid that are refined, at most; and how much worse than the best


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
    current_lag: float | None = setting(
        0.0,
        "time constant between the log and the torque beside that delay: of the current loop behind a command, or of "
        "the filter before a measured torque",
        unit="s",
        at_least=0,
        none="estimated",
        systems=MODELS,
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

    def surroundings(self, sample_time: float, *, stated: bool = True) -> tuple[Parameter, ...]:
        """Return the parameters of the log, free where they are to be estimated; see `log_delay`."""
        delay = log_delay(self.log_delay, sample_time, stated=stated)
        lag = replace(CURRENT_LAG, free=True, start=0.3 * sample_time, lower=1e-3 * sample_time, upper=delay.upper)
        return delay, lag if self.current_lag is None else CURRENT_LAG.fix(self.current_lag)

    def identify(self, task: Task) -> FitResult:
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
        around = self.surroundings(record.torque.sample_time, stated=record.torque.stated)
        problem = motion_problem(record, setup, task.filtering, task.parameters, around)
        if task.joint.model == "rigid" and _linear(problem, None)[0] == math.inf:
            # Of a light joint in noise the reversals may be all that tells of its inertia.
            problem = replace(problem, weights=weights_of(problem.motion))
        starts, simulations = grid_starts(problem, self)
        solution = solve(problem, LevenbergMarquardt(self.tolerance), np.array(starts), _report_steps(task.progress))
        J, error = solution.jacobian, solution.residual
        covariance = with_measured_motion(with_bands(sandwich(J, J, error), J, J, error), J, J, error)
        resting = 1 - float(np.mean(weights_of(problem.motion)))
        rest = f"the motor rests in {100 * resting:.0f} % of the record, where its torque says nothing of it"
        limit = noise_limit_of(record, task.joint, ("motor_position",))
        noise = describe_noise_limit(problem.filtering, limit, problem.sample_time, task.joint.model)
        used = simulations + solution.evaluations
        warnings = (*noise, *((rest,) if resting > SAID else ()))
        return build_prescribed_result(record, problem, solution, covariance, used, warnings)


def grid_starts(problem: DriveSideProblem, settings: DriveSideFit) -> tuple[list[FloatArray], int]:
    """Return the best few starts, and the simulations they took (see the module)."""
    if problem.joint.model == "rigid":
        cost, found = _linear(problem, None)
        if cost == math.inf:
            raise MethodError(
                f"Torque and motor position give inertia = {found['inertia']:.4g}, which no joint has: one of them has "
                "the wrong sign (set record.channels.torque.sign = -1), or they do not belong together."
            )
        return [_vector(problem, found)], 1
    cutoff = problem.filtering.cutoff
    assert cutoff is not None
    grid = [settings.frequency or 0.0]
    if settings.frequency is None:
        grid = [cutoff * _LOWEST ** (1 - i / (_GUESSES - 1)) for i in range(_GUESSES)]
    tried = in_threads(lambda frequency: _linear(problem, frequency), grid)
    costs = np.array([cost for cost, _ in tried])
    # A valley of the criterion is refined once; the ends of the row are no worse than values outside it.
    around = np.concatenate([[np.inf], costs, [np.inf]])
    valleys = [i for i in range(costs.size) if costs[i] < np.inf and around[i] >= costs[i] <= around[i + 2]]
    if not valleys:
        raise MethodError(
            "At no motor-locked frequency below the cut-off do torque and motor position give a joint with positive "
            "inertias: one of them has the wrong sign (set record.channels.torque.sign = -1), or they do not belong "
            "together."
        )
    # One that explains much less of the torque than another will not overtake it.
    lowest = float(min(costs))
    best = sorted((i for i in valleys if costs[i] <= _WORSE * lowest), key=lambda i: float(costs[i]))[:_REFINED]
    return [_vector(problem, tried[i][1]) for i in best], len(grid)


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


def _vector(problem: DriveSideProblem, found: Mapping[str, float]) -> FloatArray:
    """Return a start: what the user gives goes before what was found."""
    given = {p.name: p.start for p in problem.parameters if p.start is not None}
    return problem.vector({**found, **given})


def _report_steps(progress: Progress) -> Watch:
    """Return a listener that reports the residual of every step."""
    numbers = itertools.count(1)

    def watch(step: Step) -> None:
        progress(Detail(f"iteration {next(numbers)}: residual {step.norm:.6g}"))

    return watch
