"""A robot identified by simulating it, by DIDIM or on the drive side, its joints rigid or flexible.

Beside it stands the nominal robot: the masses, rotors and springs of model and robot file, with the friction that was
found.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from jointid.common.arrays import FloatArray
from jointid.common.errors import MethodError
from jointid.common.messages import Progress, ignore_progress
from jointid.common.parameters import TORQUE_UNIT, Bounds, Parameter, unit_of
from jointid.common.text import join
from jointid.estimation.methods.didim import DIDIM
from jointid.estimation.methods.drive_side import DriveSideFit
from jointid.estimation.outputs import position_rms
from jointid.estimation.problems.inverse_model import Records, each_log, require_one_log
from jointid.estimation.problems.simulated import Simulated, pose_robot
from jointid.estimation.result.build_result import build_robot_result
from jointid.estimation.result.estimate import Estimate
from jointid.estimation.result.parts import EstimatedParameter, Sums
from jointid.estimation.result.verdict import SpringVerdict
from jointid.estimation.robots.didim import RobotFit, conclude, search_robot
from jointid.estimation.robots.numbers import (
    RobotParameters,
    begin_delays,
    robot_parameters,
    standard_index,
    with_delays,
)
from jointid.models.robots.inertial import UNITS
from jointid.models.robots.robot import Robot
from jointid.records.record import Record
from jointid.records.signals.filtering import Filtering
from jointid.simulation.drive_side import RobotDriveSide
from jointid.simulation.loop_input import RobotLoop
from jointid.simulation.plant import DELAY, LOAD_STATE, LOG_DELAY, Numbers, Place, robot_with
from jointid.simulation.simulate import motion_at
from jointid.uncertainty.covariance import Covariance

_TWO = 2.0  # standard deviations
_SIGNED = ("offset", "stribeck_force", "viscous_drift", "coulomb_drift", "cubic_stiffness", LOG_DELAY, *LOAD_STATE)
"""Names, without the side, of numbers that a robot may have below 0."""
_NEAR = 1e-6  # of a value or its deviation: how near to a bound is at it
_WITHOUT = (
    "no joint shows a spring in this record: leave the springs out of the robot file and identify it as rigid, or "
    "excite the modes. How friction and inertia are split between motors and links is not to be used"
)


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class IdentifiedRobot:
    """The robot-only content of an estimate: friction, rotors, springs and base parameters.

    Attributes:
        setup: the nominal robot at the start of the identification: alone, under its controllers, or along the
            motion of its motors. To IDIM all of its joints are rigid.
        parameters: of the search; the fixed ones follow them in `names`.
        names: (parameters,) in the order of all arrays.
        values: (parameters,) in SI units; that of a refused parameter is not to be used.
        covariance: of the values; 0 for a fixed parameter.
        nominal: (parameters,) of the nominal robot.
        nominal_errors: (n,) share of each joint's filtered torque that the nominal robot leaves, with friction as
            identified or fitted beside it; infinite where it cannot be simulated.
        formulas: (parameters,) the sums of standard parameters; the symbol of a parameter that is no sum.
        springs: a verdict for each flexible joint.
    """

    in_json = "nominal nominal_errors log_delay -setup -covariance -parameters"
    setup: Robot | RobotLoop | RobotDriveSide
    parameters: RobotParameters
    names: tuple[str, ...]
    values: FloatArray
    covariance: Covariance
    nominal: FloatArray
    nominal_errors: FloatArray
    formulas: tuple[str, ...]
    springs: tuple[SpringVerdict, ...] = ()

    @property
    def model(self) -> Robot:
        """The nominal robot."""
        return self.setup if isinstance(self.setup, Robot) else self.setup.robot

    @property
    def has_controllers(self) -> bool:
        """True if the robot was identified under its controllers."""
        return hasattr(self.setup, "controllers")

    def numbers(self) -> Numbers:
        """Return the robot that was identified, as it is simulated."""
        return self.parameters.numbers(self.values[: len(self.parameters.places)])

    @property
    def log_delay(self) -> float | None:
        """Seconds by which the log shows torques late; None where the method does not say."""
        return self.numbers().values[0].get(LOG_DELAY)

    @property
    def driving(self) -> tuple[str, ...]:
        """Joints whose friction is negative by more than two deviations, far from standstill or close to it."""
        found = []
        for joint in self.model.names:
            sums = [("viscous",), ("viscous_forwards",), ("viscous_backwards",), ("coulomb",)]
            weights = [
                np.isin(self.names, [f"{joint}.{number}" for number in numbers]).astype(np.float64)
                for numbers in (*sums, ("coulomb", "stribeck_force"))
            ]
            if any(float(one @ self.values) < -_TWO * self.covariance.std_of(one) for one in weights):
                found.append(joint)
        return tuple(found)

    @property
    def of_standard(self) -> FloatArray:
        """Weights in each parameter of the links' inertial parameters, then of the rotors, (parameters, 11 n)."""
        found = self.parameters.of_standard
        return np.pad(found, ((0, len(self.names) - len(found)), (0, 0)))

    def regressor(self, q: FloatArray, v: FloatArray, a: FloatArray) -> FloatArray:
        """Return the columns of the motors' torques in a motion without deflection, (samples, n, parameters).

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
        """Return the robot that was identified, for a simulation: the same torques.

        What is grouped stands in the parameter that is kept, so that its links need not be bodies.

        Raises:
            MethodError: a rotor's inertia, with what is grouped with it, was found negative.
        """
        return robot_with(self.model, self.numbers())

    def sums(self, prior: Robot) -> Sums:
        """Return the parameters as sums of the numbers of a robot of this tree, with springs at the same joints.

        Raises:
            MethodError: the record does not show a spring.
        """
        if hidden := [one.joint for one in self.springs if not one.shown]:
            raise MethodError(
                f"The record does not show the spring of {join(hidden)}, so it does not part motor from link there; "
                "leave this spring out of the robot file, or excite its mode."
            )
        parameters, numbers = self.parameters, Numbers.of(prior)
        size = len(parameters.places)
        base = parameters.base
        numbers = numbers.with_record(base).with_values(parameters.kept, [base[place] for place in parameters.kept])
        places = (*parameters.places, *parameters.dropped)
        both = np.hstack([np.eye(size), parameters.grouping])
        apart = [column for column, place in enumerate(places) if standard_index(place, len(prior)) is None]
        own = tuple(places[column] for column in apart)
        mine = self.numbers()
        about = np.array([(mine if c < len(both) else numbers)[place] for c, place in zip(apart, own, strict=True)])
        least = np.array([-np.inf if place.own in _SIGNED else 0.0 for place in own])
        motors = [Place(i, f"{joint.sides[0]}inertia") for i, joint in enumerate(numbers.joints)]

        def build_robot(inertials: FloatArray, rotors: FloatArray, others: FloatArray) -> Robot:
            there = replace(numbers, inertials=inertials).with_values([*own, *motors], [*others, *rotors])
            return robot_with(prior, there)

        covariance = replace(
            self.covariance, std=self.covariance.std[:size], correlation=self.covariance.correlation[:size, :size]
        )
        return Sums(self.values[:size], covariance, self.of_standard[:size], both[:, apart], about, least, build_robot)

    def parameters_of(self, robot: Robot) -> FloatArray | None:
        """Return the same parameters of a known robot; None where it has others."""
        if robot.flexible != self.model.flexible:
            return None
        return self.parameters.group_all(Numbers.of(robot))


def identify_simulated_robot(
    model: RobotLoop | RobotDriveSide,
    records: Records,
    settings: DIDIM | DriveSideFit | None = None,
    *,
    filtering: Filtering | None = None,
    known: Mapping[str, Parameter] | None = None,
    progress: Progress = ignore_progress,
) -> Estimate:
    """Identify a robot by DIDIM, or on the drive side; joints with a spring are flexible, all others rigid.

    Args:
        model: the robot under its controllers, or along the motion of its motors, with its nominal numbers.
        records: of each joint, of one log or of several: with torque and reference, positions are not read; or with
            torque and motor position behind the gear, references are not read.
        settings: of the method.
        filtering: of positions, torques and derivatives.
        known: values and bounds to keep, by name; see `apply_constraints`.
        progress: receives the steps.

    Raises:
        RecordError, MethodError: see `search_robot`.
    """
    fit = search_robot(model, records, filtering, settings, known=known, progress=progress)
    parameters = fit.parameters
    method = "drive_side", "drive side of a robot, from motor torques and motor positions"
    if isinstance(model, RobotLoop):
        parameters = begin_delays(parameters, model)
        model = at_estimate(model, parameters, fit.values)
        computed = any(record.computed for log in each_log(records) for record in log)
        method = "didim", f"DIDIM of a robot, from {'motor positions' if computed else 'torques'} and references alone"
    robot, logs = model.robot, each_log(records)
    problem = pose_robot(model, records, robot_parameters(robot), filtering)
    nominal = nominal_numbers(robot, parameters.numbers(fit.values))
    part = IdentifiedRobot(
        setup=model,
        names=(*fit.names, *(one.name for one in parameters.fixed)),
        values=np.array([*fit.values, *(one.start for one in parameters.fixed)], dtype=np.float64),
        covariance=fit.covariance.append_constants(len(parameters.fixed)),
        nominal=parameters.group_all(Numbers.of(robot)),
        nominal_errors=errors_of(problem, nominal),
        formulas=(*parameters.formulas(robot), *(one.symbol for one in parameters.fixed)),
        springs=fit.springs,
        parameters=parameters,
    )
    steps = f"after {fit.iterations} simulations"
    stop = f"settled {steps}"
    if not fit.converged:
        stop = f"did not settle {steps}: allow more by method.evaluations, or record longer and livelier motions"
    kind = "of springs, rotors and links" if fit.springs else "of rigid joints"
    result = build_robot_result(
        [record for log in logs for record in log],
        part,
        table_of_robot(part, parameters, _held_by_bounds(fit)),
        fit.relative_error,
        (problem.measured, problem.predict(fit.runs)),
        (method[0], f"{method[1]}, {kind}"),
        problem.filtering,
        problem.filtered_torque.size,
        (stop, fit.converged),
        fit.iterations,
        warnings=(_WITHOUT,) if fit.springs and not any(one.shown for one in fit.springs) else (),
    )
    if len(logs) > 1:
        return result
    (run,) = fit.runs
    result = replace(result, solved=replace(fit, problem=replace(problem, parameters=parameters)))
    if method[0] != "didim":
        return result
    simulated = motion_at(run, problem.log.experiment.clock.log_index).position[:, run.numbers.motors]
    return replace(result, fit=replace(result.fit, position_rms=position_rms(robot.names, logs[0], simulated)))


def at_estimate(loop: RobotLoop, parameters: RobotParameters, values: FloatArray) -> RobotLoop:
    """Return a loop with the delays of the torques that were identified."""
    found = zip(parameters.places, values[: len(parameters.places)], strict=True)
    return with_delays(loop, {place.axis: float(x) for place, x in found if place.name == DELAY})


def _held_by_bounds(fit: RobotFit) -> dict[str, float]:
    """Return the bounds of the parameters that they hold, by name; of springs there are verdicts."""
    free, near = fit.parameters.parameters, _NEAR * np.maximum(np.abs(fit.values), fit.covariance.std)
    bounds, x = Bounds.of(free), fit.values
    held = ((x <= bounds.lower + near) | (x >= bounds.upper - near)) & ~fit.parameters.logarithmic
    pairs = zip(free, x, held, strict=True)
    return {p.name: min(p.lower, p.upper, key=lambda b: abs(value - b)) for p, value, at in pairs if at}


def table_of_robot(
    part: IdentifiedRobot, parameters: RobotParameters, held: Mapping[str, float]
) -> tuple[EstimatedParameter, ...]:
    """Return the table of the parameters; of a spring that is not shown, a bound at most."""
    hidden, rows = [one for one in part.springs if not one.shown], list[EstimatedParameter]()
    refused: dict[str, float | None] = {f"{one.joint}.stiffness": float(one.at_least) for one in hidden}
    refused |= {f"{one.joint}.damping": None for one in hidden}
    described = describe_parameters(part.model, parameters)
    for (one, unit, axis, of_record), value, std in zip(described, part.values, part.covariance.std, strict=True):
        told = one.name not in refused
        rows.append(
            EstimatedParameter(
                one.name,
                one.symbol,
                unit,
                float(value) if told else None,
                float(std) if told and one.free else None,
                one.free,
                lower_bound=refused.get(one.name),
                of_joint=not of_record,
                at_bound=held.get(one.name),
                axis=axis,
            )
        )
    return tuple(rows)


def describe_parameters(robot: Robot, parameters: RobotParameters) -> Iterator[tuple[Parameter, str, str, bool]]:
    """Yield each parameter, the fixed ones last: with its unit, its joint's name, and whether it is of the record."""
    places = (*parameters.places, *parameters.kept)
    for one, place in zip((*parameters.parameters, *parameters.fixed), places, strict=True):
        of_log = place.name == LOG_DELAY
        kind = "revolute" if of_log else robot.links[place.axis].kind
        unit = UNITS[place.column] if place.of_link else unit_of(one.quantity, kind, TORQUE_UNIT[kind])
        yield one, unit, "" if of_log else robot.names[place.axis], place.of_record


def nominal_numbers(robot: Robot, found: Numbers) -> Numbers:
    """Return the nominal robot with the friction that was found: one without friction is no opponent.

    The delays of log and torques are not the robot's, and are as they were found, too.
    """
    numbers = Numbers.of(robot)
    values = []
    for joint, own, of in zip(numbers.joints, numbers.values, found.values, strict=True):
        kept = (f"{joint.sides[0]}inertia", *(p.name for law in joint.springs for p in law.parameters))
        values.append({**of, **{name: own[name] for name in kept}})
    return replace(numbers, values=tuple(values))


def solve_again(part: IdentifiedRobot, records: Sequence[Record], filtering: Filtering | None) -> RobotFit:
    """Return the fit of an identified robot to the records that it was identified from, without a search.

    Raises:
        RecordError, MethodError: as of the identification; or the robot cannot be simulated.
    """
    require_one_log(records)
    found = pose_robot(part.setup, records, part.parameters, filtering)
    problem = replace(found, parameters=part.parameters)  # with those of the record
    x = part.parameters.to_search_variables(part.values[: len(part.parameters.places)])
    runs = problem.run(x)
    return conclude(problem, x, runs, problem.slopes(runs, x), 0, True)


def errors_of(problem: Simulated, numbers: Numbers) -> FloatArray:
    """Return the residual share of each joint's torque, (n,); infinite if it cannot be simulated."""
    error = problem.error_of(numbers)
    return np.full(problem.sigma.size, np.inf) if error is None else problem.norms(error) / problem.sizes
