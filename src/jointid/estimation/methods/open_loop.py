"""Open-loop identification: the logged torque is prescribed, and the motor's position is compared.

Nothing holds the motor, so every small force that the model lacks drifts away as the double integral of itself: what a
position says slower than ``highpass`` is not of the joint, and is taken off both sides by one filter. Unlike the
drive-side criterion this one needs no derivative of a position, and noise of the encoder does not bias it; but it takes
the logged torque for exact, and a loop around the drive makes it as endogenous.

It begins where the drive-side identification of the same record ends (`drive_side`).
"""

from __future__ import annotations

from dataclasses import dataclass, replace

from jointid.common.settings import documented, setting
from jointid.estimation.methods.drive_side import DriveSideFit, covariance_of, reported
from jointid.estimation.methods.registry import Method, Task
from jointid.estimation.problems.closed_loop import initial_of
from jointid.estimation.problems.prescribed import position_problem
from jointid.estimation.result.build_estimate import build_prescribed_estimate
from jointid.estimation.result.estimate import Estimate
from jointid.simulation.open_loop import OpenLoop
from jointid.solvers.levenberg_marquardt import LevenbergMarquardt
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

    def identify(self, task: Task) -> Estimate:
        """Identify a joint from the torque that drives it in open loop, and the motor position that follows.

        The filter's borders should outlast the transient of a load that was not in steady motion at the first sample.

        Raises:
            RecordError: a channel is missing, or at another rate.
            MethodError: no start gives a joint with positive inertias.
        """
        closing = OpenLoop(task.joint)
        problem = position_problem(task.record, closing, task.filtering, task.parameters, self.log_delay, self.highpass)
        task.progress("identifying the drive side for a start")
        first = DriveSideFit(self.log_delay, 0.0, self.frequency, "never").identify(task)
        found = {p.name: p.value for p in first.params if p.value is not None}
        given = {p.name: p.start for p in problem.parameters if p.start is not None}
        start, solver = problem.vector({**found, **given}), LevenbergMarquardt(self.tolerance)
        solution = solve(problem, solver, start, reported(task.progress))
        drift = f"positions slower than {problem.highpass:g} Hz are drift in open loop, and were not compared"
        estimate = build_prescribed_estimate(
            task.record,
            problem,
            solution.x,
            replace(solution, evaluations=solution.evaluations + first.fit.simulations),
            covariance_of(solution),
            ("torque", "motor_position"),
            ("open_loop", "open loop by least squares"),
            before=(drift,),
        )
        return estimate.amended(fit={"initial": initial_of(problem.values(solution.x))})
