"""Open-loop identification: the logged torque is prescribed, and the motor's position is compared.

Nothing holds the motor, so every small force that the model lacks drifts away as the double integral of itself: what a
position says slower than ``highpass`` is not of the joint, and is taken off both sides by one filter. Unlike the
drive-side criterion this one needs no derivative of a position, and noise of the encoder does not bias it; but it takes
the logged torque for exact, and a loop around the drive makes it as endogenous.

It begins where the drive-side identification of the same record ends (`drive_side`).
"""

from __future__ import annotations

from dataclasses import dataclass, replace

from jointid.common.progress import Progress, silent
from jointid.common.settings import check_settings, documented, setting
from jointid.estimation.methods.drive_side import DriveSideFit, covariance_of, identify_drive_side, reported
from jointid.estimation.methods.registry import Method
from jointid.estimation.problems.closed_loop import initial_of
from jointid.estimation.problems.open_loop import OpenLoopProblem, position_problem
from jointid.estimation.result.build_estimate import build_prescribed_estimate
from jointid.estimation.result.estimate import Estimate
from jointid.models.controllers import Controller
from jointid.models.joints import Joint
from jointid.models.parameters import Parameter
from jointid.records.record import Record
from jointid.records.signals.filtering import Filtering
from jointid.simulation.drive_side import DriveSide
from jointid.simulation.loop_input import ClosedLoop
from jointid.simulation.open_loop import OpenLoop
from jointid.solvers.levenberg_marquardt import LevenbergMarquardt
from jointid.solvers.solution import Solution
from jointid.solvers.solve import solve


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
    drift = f"positions slower than {problem.highpass:g} Hz are drift in open loop, and were not compared"
    found = build_prescribed_estimate(
        record,
        problem,
        solution.x,
        solution,
        covariance_of(solution),
        ("torque", "motor_position"),
        ("open_loop", "open loop by least squares"),
        before=(drift,),
    )
    return found.amended(fit={"initial": initial_of(problem.values(solution.x))})
