"""IDIM of a robot: base parameters and friction of all joints at once, by the estimators of one joint.

Rows share their instants, and their errors differ in size by powers of ten from base to wrist: each joint's rows are
divided by the size of its own error, again until that settles [Gautier 1997, who takes it once]. Least squares without
weights ("ols") lets the large joints decide the wrist's parameters. Beside it stand the model's own masses, with
friction fitted as the estimate's was: an opponent without friction would be none.
"""

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from jointid.common.arrays import FloatArray
from jointid.common.errors import MethodError
from jointid.common.parameters import Parameter
from jointid.common.text import join
from jointid.estimation.methods.idim import IDIM, VARIANTS, regress, simulate_motion, torques_along
from jointid.estimation.parameters import RobotParameters, robot_parameters
from jointid.estimation.problems.inverse_model import Records, Rows, each_log, inverse_of_robot
from jointid.estimation.result.estimate import Estimate, Settings, build_estimate
from jointid.estimation.robots.simulated import IdentifiedRobot, rows_of_robot
from jointid.models.robots.robot import Robot, RobotLoop
from jointid.records.signals.filtering import Filtering, describe_noise_limit
from jointid.simulation.plant import Numbers


def identify_robot(
    model: Robot | RobotLoop,
    records: Records,
    settings: IDIM | None = None,
    *,
    filtering: Filtering | None = None,
    known: Mapping[str, Parameter] | None = None,
) -> Estimate:
    """Identify a robot's base parameters and friction from motor positions and torques of all joints.

    Args:
        model: its geometry, gravity and coupling are taken as known; its masses are only what is compared with. With
            its controllers for the estimator "iv", which simulates them from the records' references and what is
            injected; at the first sample at rest, or in motion where the loop says so.
        records: of each joint, with torque and motor position behind the gear, on one clock; or those of several logs.
        settings: of the method.
        filtering: of positions and rows.
        known: values and bounds of friction to keep, by name as "joint1.viscous"; a value outside its
            bounds is fixed at the bound.

    Raises:
        MethodError: the record does not determine all base parameters; the sentence names those involved. Or "iv" has
            no loop, or cannot simulate it.
        RecordError: a channel is missing, or the joints' records have not one clock.

    Valid for joints that are rigid in the band of the filter: below about a fifth of the first resonance.
    """
    robot, estimator = model if isinstance(model, Robot) else model.robot, (settings or IDIM()).estimator or "weighted"
    robot.require_linear("IDIM of a robot takes", 'identify the robot by "didim"')
    if of_links := [name for name in known or {} if ".link_" in name]:
        raise MethodError(
            f"{join(of_links)} is of the link's side, and to IDIM a joint is rigid, with the friction of both sides: "
            "leave it out."
        )
    soft = [joint.name for joint in robot.joints if joint.spring is not None]
    robot, logs = robot.rigid, each_log(records)
    setup = robot if isinstance(model, Robot) else replace(model, robot=robot)
    parameters, simulated = robot_parameters(robot, whole=False), None
    inverse = inverse_of_robot(robot, parameters)
    motions = inverse.measure_logs(logs, filtering or Filtering())
    common = motions[0].filtering
    if estimator == "iv" and isinstance(setup, RobotLoop):
        simulated = [simulate_motion(setup, log, parameters.parameters, parameters.numbers) for log in logs]
    limits = {name: one for name, one in (known or {}).items() if name in parameters.names}
    fixed = {name for name, one in limits.items() if not one.free}
    solution = regress(inverse, motions, estimator, limits, simulated)
    rows, values = solution.rows, solution.values
    fixed |= solution.held.keys()
    stated = zip(parameters.parameters, map(float, values), strict=True)
    parameters = replace(parameters, parameters=tuple(p.fix(x) if p.name in fixed else p for p, x in stated))
    nominal = _nominal(robot, parameters, rows)
    part = IdentifiedRobot(setup, parameters, values)
    warnings = [*solution.said]
    warnings += describe_noise_limit(common, min(one.limit for one in motions), motions[0].sample_time, "rigid")
    if soft:
        warnings.append(
            f"The robot file has springs at {join(soft)}, and to IDIM every joint is rigid: that holds below a "
            "fifth of the modes; lower filtering.cutoff to it, or identify by didim or drive_side."
        )
    variant = VARIANTS[estimator].replace("IDIM", "IDIM of a robot")
    table = rows_of_robot(part, solution.covariance.std, nominal, solution.held)
    free = [i for i, row in enumerate(table) if row.free]
    return build_estimate(
        [record for log in logs for record in log],
        table,
        solution.covariance.correlation[np.ix_(free, free)],
        torques_along(inverse, motions, solution),
        rows.relative_errors(values),
        solution.residual.size,
        (solution.stop, solution.converged),
        solution.simulations,
        Settings("idim", variant, robot, None, common, timing=solution.timing),
        robot=part,
        nominal=rows.relative_errors(nominal),
        warnings=warnings,
    )


def _nominal(robot: Robot, parameters: RobotParameters, rows: Rows) -> FloatArray:
    """Return the base parameters of the model's own masses, and the friction that fits best beside them."""
    found, masses = parameters.group(Numbers.of(robot)), parameters.inertial
    left = rows.Y - rows.W[:, masses] @ found[masses]
    found[~masses] = np.linalg.lstsq(rows.W[:, ~masses], left, rcond=None)[0]
    return found
