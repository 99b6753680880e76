"""Open-loop identification: the logged torque is prescribed, and the motor's position is compared.

Nothing holds the motor, so every small force that the model lacks drifts away as the double integral of itself: what a
position says slower than ``highpass`` is not of the joint, and is taken off both sides by one filter. Unlike the
drive-side criterion this one needs no derivative of a position, and noise of the encoder does not bias it; but it takes
the logged torque for exact, and a loop around the drive makes it as endogenous.

It begins where the drive-side identification of the same record ends (`drive_side`).
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from jointid.common.progress import Progress, silent
from jointid.common.settings import check_settings, documented, setting
from jointid.estimation.methods.drive_side import (
    DriveSideFit,
    covariance_of,
    identify_drive_side,
    reported,
    trace_of,
    unsure,
    warnings_of,
)
from jointid.estimation.methods.registry import Method
from jointid.estimation.problems.nuisance_parameters import LOG_DELAY
from jointid.estimation.problems.open_loop import OpenLoopProblem, position_problem
from jointid.estimation.result.estimate import (
    Checks,
    Data,
    Estimate,
    Fit,
    Settings,
    fingerprint,
    poor_fit,
    relative_error,
)
from jointid.estimation.result.params import EstimatedParameter, Params
from jointid.models.controllers import Controller
from jointid.models.joints import Joint
from jointid.models.parameters import Parameter
from jointid.records.record import Record
from jointid.records.signals.filtering import Filtering
from jointid.simulation.closed_loop import Initial
from jointid.simulation.drive_side import DriveSide
from jointid.simulation.loop_input import ClosedLoop
from jointid.simulation.open_loop import OpenLoop
from jointid.solvers.levenberg_marquardt import LevenbergMarquardt
from jointid.solvers.solution import Solution
from jointid.solvers.solve import solve
from jointid.uncertainty.bands import band_words
from jointid.uncertainty.covariance import words


@documented
@dataclass(frozen=True, slots=True)
class OpenLoopFit(Method):
    """Settings of the open-loop identification."""

    name = "open_loop"
    title = "the open-loop method"
    default_for = OpenLoop

    log_delay: float | None = setting(
        None,
        "how much later than it acts the log shows the torque, negative for a command that comes first; without it "
        "estimated",
        unit="s",
    )
    highpass: float | None = setting(
        None,
        "frequency below which the position is drift, and not compared; without it 3 % of the cut-off",
        unit="Hz",
        above=0,
    )
    frequency: float | None = setting(
        None, "motor-locked frequency of the start; without it the best of a grid", unit="Hz", above=0
    )
    tolerance: float = setting(1e-8, "change of the criterion or the parameters to stop at, as a share", above=0)

    def __post_init__(self) -> None:
        check_settings(self)

    @classmethod
    def called(cls, model: str) -> str:
        """Return what a sentence on its needs calls it."""
        del model
        return "the open loop method"

    @classmethod
    def channels(cls, model: str, controller: Controller | None = None) -> tuple[str, ...]:
        """Return torque and motor position."""
        del model, controller
        return "torque", "motor_position"

    def identify(
        self,
        record: Record,
        joint: Joint,
        loop: ClosedLoop | None,
        parameters: tuple[Parameter, ...],
        filtering: Filtering,
        progress: Progress,
    ) -> Estimate:
        """Identify a joint in open loop; see `identify_open_loop`."""
        del loop
        return identify_open_loop(record, OpenLoop(joint), parameters, filtering, self, progress)


def identify_open_loop(
    record: Record,
    closing: OpenLoop,
    parameters: tuple[Parameter, ...],
    filtering: Filtering,
    settings: OpenLoopFit | None = None,
    progress: Progress = silent,
) -> Estimate:
    """Identify a joint from the torque that drives it in open loop, and the motor position that follows.

    Args:
        record: with torque and motor position at one rate.
        closing: the joint.
        parameters: of the joint; a start of its own replaces that of the method.
        filtering: of the compared positions; its borders should outlast the transient of a load that was not in
            steady motion at the first sample.
        settings: see `OpenLoopFit`.
        progress: is told the iterations.

    Raises:
        RecordError: a channel is missing, or at another rate.
        MethodError: no start gives a joint with positive inertias.
    """
    settings = settings or OpenLoopFit()
    problem = position_problem(record, closing, filtering, parameters, settings.log_delay, settings.highpass)
    progress("identifying the drive side for a start")
    begin = DriveSideFit(settings.log_delay, 0.0, settings.frequency, "never")
    first = identify_drive_side(record, DriveSide(closing.joint), parameters, filtering, begin, progress)
    found = {p.name: p.value for p in first.params if p.value is not None}
    given = {p.name: p.start for p in problem.parameters if p.start is not None}
    start, solver = problem.vector({**found, **given}), LevenbergMarquardt(settings.tolerance)
    solution = solve(problem, solver, start, reported(progress))
    return _answer(record, problem, replace(solution, evaluations=solution.evaluations + first.fit.simulations))


def _answer(record: Record, problem: OpenLoopProblem, solution: Solution) -> Estimate:
    assert record.torque is not None
    covariance, x = covariance_of(solution), solution.x
    values, predicted = problem.values(x), problem.predicted(x)
    spread = dict(zip((p.name for p in problem.free), map(float, covariance.std), strict=True))
    own, lost = {p.name for p in problem.joint.parameters}, unsure(values, spread)
    rows = tuple(
        EstimatedParameter(
            p.name, p.symbol, problem.joint.unit(p), values[p.name], spread.get(p.name), p.free,
            p.free and p.name not in lost, of_joint=p.name in own,
        )
        for p in problem.parameters
    )  # fmt: skip
    borders = problem.filtering.borders
    filtered_error = float(np.linalg.norm(solution.residual) / np.linalg.norm(problem.filtered(problem.measured)))
    drift = f"positions slower than {problem.highpass:g} Hz are drift in open loop, and were not compared"
    return Estimate(
        params=Params(
            rows,
            tuple(p.name for p in problem.free),
            covariance.correlation,
            f"from the sensitivities of the position: {words(covariance)}; {band_words()}",
        ),
        fit=Fit(
            measured=problem.measured,
            predicted=predicted,
            borders=borders,
            relative_error=relative_error(problem.measured, predicted, borders),
            filtered_error=filtered_error,
            rows=solution.residual.size,
            conditioning=None,
            initial=Initial(values["initial_position"], values["initial_velocity"]),
            trace=trace_of(problem, solution),
            simulations=solution.evaluations,
            stop=solution.message,
            converged=solution.converged,
            compared="position",
        ),
        checks=Checks(
            warnings=(drift, *warnings_of(problem, x, covariance, lost, solution), *poor_fit(filtered_error))
        ),
        data=Data(
            channels=("torque", "motor_position"),
            record=record.name,
            sample_time=problem.sample_time,
            torque_unit=record.torque.unit,
            fingerprint=fingerprint(record.torque.values),
        ),
        settings=Settings(
            method="open_loop",
            variant="open loop by least squares",
            joint=problem.joint,
            loop=None,
            filtering=problem.filtering,
            delay=-values[LOG_DELAY.name],
        ),
    )
