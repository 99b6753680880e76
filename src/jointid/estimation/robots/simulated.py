"""A robot identified by simulation, by DIDIM or on the drive side.

The nominal robot serves for comparison: masses, rotors and springs of model and robot file, with the identified
friction.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import chain

from jointid.common.arrays import FloatArray
from jointid.common.messages import Progress
from jointid.common.parameters import Parameter, find_active_bounds
from jointid.estimation.descent import Solved
from jointid.estimation.methods import Method
from jointid.estimation.parameters import Parameters, begin_delays, with_delays
from jointid.estimation.problems.inverse_model import Records, require_one_log
from jointid.estimation.problems.simulated import Simulated, pose_robot
from jointid.estimation.result.estimate import Estimate, EstimatedParameter, Settings, build_estimate
from jointid.estimation.robots.didim import RobotFit, conclude, search_robot
from jointid.models.robots.robot import Robot, RobotLoop
from jointid.records.record import Record
from jointid.records.signals.filtering import Filtering
from jointid.simulation.plant import DELAY, LOG_DELAY, OF_RECORD, Numbers, robot_with
from jointid.solvers.solve import LevenbergMarquardt, solve

_WITHOUT = (
    "no joint shows a spring in this record: leave the springs out of the robot file and identify it as rigid, or "
    "excite the modes. How friction and inertia are split between motors and links is not to be used"
)


@dataclass(frozen=True, slots=True, eq=False)
class IdentifiedRobot:
    """An identified robot, for simulation.

    Attributes:
        setup: the nominal robot at the start of the identification: alone, under its controllers, or along the
            motion of its motors. To IDIM all of its joints are rigid.
        parameters: of the search.
        values: (parameters,) in the order of `names`, in SI units; that of a refused parameter is invalid.
    """

    setup: Robot | RobotLoop
    parameters: Parameters
    values: FloatArray

    @property
    def model(self) -> Robot:
        """The nominal robot."""
        return self.setup.robot

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the parameters, the fixed ones last."""
        return self.parameters.names

    def numbers(self) -> Numbers:
        """Numbers of the identified robot, for simulation."""
        return self.parameters.numbers(self.values)

    def regressor(self, q: FloatArray, v: FloatArray, a: FloatArray) -> FloatArray:
        """Columns of motor torques without deflection, (samples, n, parameters).

        Args:
            q: (samples, n) positions of the joints, rad or m.
            v: (samples, n) their velocities.
            a: (samples, n) their accelerations.

        Raises:
            MethodError: a friction is not linear in its parameters.
        """
        self.model.require_linear("A regressor takes", "simulate the robot")
        return self.parameters.columns(self.model, q, v, a, self.numbers())

    def robot(self) -> Robot:
        """The identified robot, for simulations with the same torques.

        Grouped parameters are in the one that is kept, so that its links need not be bodies.

        Raises:
            MethodError: a rotor's inertia, with what is grouped with it, was found negative.
        """
        return robot_with(self.model, self.numbers())

    def parameters_of(self, robot: Robot) -> FloatArray:
        """The same parameters of a known robot, whose flexible joints are the same."""
        return self.parameters.group(Numbers.of(robot))


def identify_simulated_robot(
    method: Method, model: Robot | RobotLoop, logs: Sequence[Sequence[Record]], filtering: Filtering,
    known: Mapping[str, Parameter], progress: Progress,
) -> Estimate:  # fmt: skip
    """Identify a robot by DIDIM or drive side, beside `model`'s nominal values.

    Args:
        method: DIDIM or the drive side, with its settings.
        model: the robot under its controllers, or along the motion of its motors, with its nominal numbers.
        logs: of each joint a record: with torque and reference, positions are not read; or with torque and motor
            position behind the gear, references are not read.
        filtering: of torques, columns and derivatives, with a cut-off above the modes; measured positions have five
            times that cut-off.
        known: values and bounds to keep, by name; see `apply_constraints`.
        progress: receives the steps.

    Raises:
        RecordError, MethodError: see `search_robot`.
    """
    fit, records = search_robot(model, logs, filtering, method, known=known, progress=progress), [*chain(*logs)]
    parameters, robot, variant = fit.parameters, model.robot, "drive side of a robot, from motor torques and positions"
    if isinstance(model, RobotLoop):
        parameters = begin_delays(parameters, model)
        model = at_estimate(model, parameters, fit.values)
        read = "motor positions" if any(record.computed for record in records) else "torques"
        variant = f"DIDIM of a robot, from {read} and references alone"
    part, fixed = IdentifiedRobot(model, parameters, fit.values), len(fit.values) - len(fit.x)
    problem = _pose_again(part, logs, filtering)
    numbers = part.numbers()
    late = numbers.values[0].get(LOG_DELAY)
    steps = f"after {fit.iterations} simulations"
    stop = f"settled {steps}"
    if not fit.converged:
        stop = f"did not settle {steps}: allow more by method.evaluations, or record longer and livelier motions"
    kind = "of springs, rotors and links" if fit.springs else "of rigid joints"
    held = find_active_bounds(parameters.free, fit.values[: len(fit.x)], fit.problem.error(fit.runs), fit.slopes)
    verdicts = {p.name for p, scaled in zip(parameters.parameters, parameters.logarithmic, strict=True) if scaled}
    held = {name: bound for name, bound in held.items() if name not in verdicts}
    hidden = {name: least for name, least in fit.springs.items() if least is not None}
    std, nominal = fit.covariance.append_constants(fixed).std, parameters.group(Numbers.of(robot))
    result = build_estimate(
        records, rows_of_robot(part, std, held, hidden, nominal), fit.covariance.correlation,
        (problem.measured, problem.predict(fit.runs)), fit.relative_error, problem.filtered_torque.size,
        (stop, fit.converged), fit.iterations,
        Settings(method.name, f"{variant}, {kind}", robot, None, problem.filtering, log_delay=late),
        robot=part, nominal=problem.left_by(nominal_numbers(robot, numbers)),
        warnings=(_WITHOUT,) if fit.springs and len(hidden) == len(fit.springs) else (),
    )  # fmt: skip
    return result if len(logs) > 1 else replace(result, solved=replace(fit, problem=problem))


def at_estimate(loop: RobotLoop, parameters: Parameters, values: FloatArray) -> RobotLoop:
    """Return a loop with the delays of the torques that were identified."""
    found = zip(parameters.places, values, strict=True)
    return with_delays(loop, {place.axis: float(x) for place, x in found if place.name == DELAY})


def rows_of_robot(
    part: IdentifiedRobot, std: FloatArray, held: Mapping[str, float], hidden: Mapping[str, float], nominal: FloatArray
) -> tuple[EstimatedParameter, ...]:
    """Rows of the parameters; a hidden spring has at most a bound.

    Standard deviations and `nominal` values are (parameters,); `held` has the active bounds by name, `hidden` lower
    bounds of stiffnesses by joint.
    """
    refused: dict[str, float | None] = {f"{joint}.stiffness": least for joint, least in hidden.items()}
    refused |= {f"{joint}.damping": None for joint in hidden}
    robot, parameters, rows = part.model, part.parameters, list[EstimatedParameter]()
    described = zip(parameters.parameters, parameters.places, parameters.units(robot), strict=True)
    found = zip(part.values, std, parameters.formulas(robot), nominal.tolist(), strict=True)
    for (p, place, unit), (value, spread, formula, given) in zip(described, found, strict=True):
        told, axis = p.name not in refused, "" if place.name == LOG_DELAY else robot.names[place.axis]
        row = EstimatedParameter(
            p.name, p.symbol, unit, float(value) if told else None, float(spread) if told and p.free else None, p.free,
            refused.get(p.name), place.name not in OF_RECORD, held.get(p.name), nominal=given, axis=axis,
            formula=formula,
        )  # fmt: skip
        rows.append(row)
    return tuple(rows)


def nominal_numbers(robot: Robot, found: Numbers) -> Numbers:
    """The nominal robot with the identified friction, for a fair comparison.

    The delays of log and torques are not the robot's, and keep their identified values, too.
    """
    numbers = Numbers.of(robot)
    values = []
    for joint, own, of in zip(numbers.joints, numbers.values, found.values, strict=True):
        kept = (f"{joint.sides[0]}inertia", *(p.name for law in joint.springs for p in law.parameters))
        values.append({**of, **{name: own[name] for name in kept}})
    return replace(numbers, values=tuple(values))


def _pose_again(part: IdentifiedRobot, records: Records, filtering: Filtering | None) -> Simulated:
    """Problem of an identified robot, whose parameters include those of the records."""
    return replace(pose_robot(part.setup, records, part.parameters, filtering), parameters=part.parameters)


def solve_again(part: IdentifiedRobot, records: Sequence[Record], filtering: Filtering | None) -> RobotFit:
    """Fit of an identified robot to its own records, without a search.

    Raises:
        RecordError, MethodError: as of the identification; or the robot cannot be simulated.
    """
    require_one_log(records)
    problem, x = _pose_again(part, records, filtering), part.parameters.to_search_variables(part.values)
    return conclude(Solved(problem, solve(problem, LevenbergMarquardt(evaluations=1), x)), 0)
