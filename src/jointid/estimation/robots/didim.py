"""DIDIM of a robot of rigid joints: all parameters from the motors' torques and the commanded references alone.

The robot is simulated under its controllers at the current parameters, and the regressor W of the simulated motion
gives the next change of the parameters, by least squares over the joints' filtered errors, each divided by its size::

    tau - tau_sim = W dx

in the residual form of M. Gautier, A. Janot and P.-O. Vandanjon (A new closed-loop output error method for parameter
identification of robot dynamics, IEEE Transactions on Control Systems Technology 21, 2013). The measurement's noise
does not reach W, which so acts as instruments for the derivatives J of the torques; the covariance is theirs, robust to
autocorrelation (`uncertainty.covariance`), with J by variation.

The search begins at what the inverse model finds on a motion that the records imply (`starts.rigid_robot`). The column
of Coulomb friction is that of the direction of sliding, but of the velocity's sign where it is now 0 or less: a mass
without it never rests, and a fixed point with a negative one would stay. Viscous and Coulomb friction are not let below
0.

Friction that is not linear in its parameters is searched from there (`laws`).

Valid for rigid joints, or below about a fifth of the first resonance; the robot at rest at the first sample, or moving
as its references do.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

from jointid.common.errors import MethodError
from jointid.common.messages import Progress
from jointid.common.parameters import Parameter
from jointid.estimation.robots.fit import NEAR, SETTLED, RobotFit, fixed_point
from jointid.estimation.robots.laws import search_laws
from jointid.estimation.robots.numbers import apply_constraints, robot_parameters
from jointid.estimation.robots.problem import RobotLoopProblem, add_problems, robot_problem
from jointid.estimation.robots.regression import Records, each_log
from jointid.estimation.starts.rigid_robot import rigid_robot_start
from jointid.models.robots.robot import Robot
from jointid.records.signals.filtering import Filtering
from jointid.simulation.robots import RobotLoop, RobotOutcome


def identify_rigid_robot(
    loop: RobotLoop,
    records: Records,
    filtering: Filtering | None = None,
    *,
    offsets: bool = True,
    iterations: int = 30,
    evaluations: int = 60,
    settled: float = SETTLED,
    known: Mapping[str, Parameter] | None = None,
    progress: Progress = lambda _: None,
) -> RobotFit:
    """Identify a robot of rigid joints from torques and references; positions in the records are not read.

    Args:
        loop: the robot, of which the links' places and gravity are read, but no inertial number nor spring, and its
            controllers.
        records: one for each joint, with torque and reference, of one log; or those of several logs.
        filtering: that torques and columns go through alike.
        offsets: whether each motor has a constant torque that is identified, too.
        iterations: at most.
        evaluations: simulations with derivatives, at most, of each descent to laws that are not linear.
        settled: the largest change of a parameter that ends them, standard deviations.
        known: values and bounds to keep, by name; see `apply_constraints`.
        progress: receives each iteration.

    Raises:
        RecordError: a record lacks torque or reference, or has the wrong clock or unit.
        MethodError: the records do not determine the parameters, or nothing can be simulated at the start.
    """
    known, logs, robot = known or {}, each_log(records), loop.robot.rigid

    def pose(of: Robot) -> list[RobotLoopProblem]:
        parameters = apply_constraints(robot_parameters(of, offsets=offsets), known)
        return [robot_problem(replace(loop, robot=of), log, parameters, filtering) for log in logs]

    parts = pose(robot.linear)
    x, run = rigid_robot_start(parts[0], replace(loop, robot=robot.linear), logs[0])
    settled = settled if robot.linear.joints == robot.joints else NEAR
    if len(parts) == 1:
        fit = fixed_point(parts[0], x, run, iterations, progress, settled)
    else:
        problem = add_problems(parts)
        runs = problem.run(x)
        if runs.outcome is not RobotOutcome.FINISHED:
            raise MethodError(
                "The robot cannot be simulated along all logs from the start that the first gives: "
                f"{runs.outcome.value}. Name a livelier record first."
            )
        fit = fixed_point(problem, x, runs, iterations, progress, settled)
    return search_laws(robot, fit, lambda of: add_problems(pose(of)), known, evaluations, progress)
