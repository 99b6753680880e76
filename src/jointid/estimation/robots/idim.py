"""IDIM of a robot: base parameters and friction of all joints at once, from motor positions and torques.

The rows of all joints share their instants, and their errors differ in size by powers of ten from base to wrist: each
joint's rows are divided by the size of its own error, again until that settles [Gautier 1997, who takes it once].
Least squares without weights ("ols") lets the large joints decide the wrist's parameters.

Noise of the positions pulls least squares towards 0. Instruments ("iv") are free of it: the columns on the motion that
the robot makes under its controllers with the values found last, until these settle [Janot, Vandanjon and Gautier
2014]. It goes through the filters as the measured motion does.

Beside it stand the model's own masses, with friction fitted as the estimate's was: an opponent without friction would
be none.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from jointid.common.arrays import FloatArray
from jointid.common.errors import MethodError
from jointid.common.parameters import Parameter
from jointid.common.text import join
from jointid.estimation.methods.idim import IDIM
from jointid.estimation.methods.linear import Instruments, Rows, instruments_of, not_simulated, solve_rows
from jointid.estimation.problems.inverse_model import MeasuredMotion
from jointid.estimation.result.build_result import build_robot_result
from jointid.estimation.result.estimate import Estimate
from jointid.estimation.result.parts import EstimatedParameter
from jointid.estimation.result.robot import IdentifiedRobot, Sums
from jointid.estimation.robots.regression import (
    Records,
    base_columns,
    base_rows,
    each_log,
    join_rows,
    motions_of_logs,
    relative_errors,
    require_slow_samples,
)
from jointid.models.robots.base_parameters import BaseParameters, base_parameters
from jointid.models.robots.friction_terms import Friction, friction_terms, joint_with_friction, offset_indices
from jointid.models.robots.inertial import SYMBOLS
from jointid.models.robots.robot import Robot
from jointid.records.record import Record
from jointid.records.signals.filtering import Filtering
from jointid.records.signals.position_noise import describe_noise_limit
from jointid.simulation.closed_loop import Outcome
from jointid.simulation.robot_numbers import RobotNumbers, robot_with
from jointid.simulation.robots import RobotLoop, prepare_robot, run_robot, simulation_of

_WORDS = {
    "ols": "ordinary least squares",
    "weighted": "least squares, each joint by the size of its error",
    "iv": "instruments from simulations of the closed loop, each joint by the size of its error",
}


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class InverseModelRobot(IdentifiedRobot):
    """Base parameters of a robot, then the numbers of the motors' friction, by IDIM.

    Attributes:
        base: the base parameters of its tree.
    """

    base: BaseParameters

    def sums(self, prior: Robot) -> Sums:
        """Return base parameters and friction as sums of the numbers of a robot of this tree."""
        terms, size = friction_terms(prior), len(self.base)
        friction = self.values[size:]
        of_others = np.vstack([np.zeros((size, friction.size)), np.eye(friction.size)])
        least = np.array([-np.inf if term.number is Friction.OFFSET else 0.0 for term in terms])

        def build_robot(inertials: FloatArray, rotors: FloatArray, others: FloatArray) -> Robot:
            joints = []
            for k, joint in enumerate(prior.joints):
                own = {term.number: float(x) for term, x in zip(terms, others, strict=True) if term.joint == k}
                # To IDIM a joint is rigid: what it finds is the friction of both sides.
                joints.append(replace(joint_with_friction(joint.rigid, own), rotor_inertia=float(rotors[k])))
            return replace(prior.with_inertials(inertials), joints=tuple(joints))

        return Sums(self.values, self.covariance, self.of_standard, of_others, friction, least, build_robot)

    @property
    def of_standard(self) -> FloatArray:
        """Weights in each parameter of the links' inertial parameters, then of the rotors, (parameters, 11 n)."""
        found = np.zeros((self.values.size, 11 * len(self.model)))
        found[: len(self.base)] = self.base.grouping
        found[len(self.base) + np.array(offset_indices(self.model))] = self.base.offsets
        return found

    def regressor(self, q: FloatArray, v: FloatArray, a: FloatArray) -> FloatArray:
        """Return the columns of the motors' torques, (samples, n, parameters)."""
        return base_columns(self.model, self.base, q, v, a)

    def robot(self) -> Robot:
        """Return the robot that was identified, of rigid joints: what is grouped stands in the first of its sum."""
        return robot_with(self.model.rigid, _numbers(self.model.rigid, self.base, self.values))

    def parameters_of(self, robot: Robot) -> FloatArray | None:
        """Return the same parameters of a known robot; None of one with springs, which IDIM does not know."""
        return None if any(robot.flexible) else self.base.with_friction(robot)


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
    settings, robot = settings or IDIM(), model if isinstance(model, Robot) else model.robot
    base, logs = base_parameters(robot), each_log(records)
    motions = motions_of_logs(robot, logs, filtering or Filtering())
    columns = [base_columns(robot, base, motion.q, motion.v, motion.a) for motion in motions]
    each = [base_rows(robot, base, *one) for one in zip(motions, columns, strict=True)]
    rows = replace(
        each[0], Y=join_rows([one.Y for one in each], len(robot)), W=join_rows([one.W for one in each], len(robot))
    )
    limits, estimator = _select_motor_friction(robot, known or {}), settings.estimator or "weighted"
    require_slow_samples(robot, rows, [name for name, one in limits.items() if not one.free])
    by_loop = None
    if estimator == "iv" and not isinstance(model, Robot):
        by_loop = _instruments(model, logs, base, motions)
    solution = solve_rows(rows, estimator, limits, by_loop)
    held = solution.held
    fixed = {*held, *(name for name, one in limits.items() if not one.free)}
    nominal, values = _nominal(robot, base, rows), solution.values
    terms = friction_terms(robot)
    symbols = (*base.symbols, *(term.symbol for term in terms))
    part = InverseModelRobot(
        setup=model,
        names=rows.names,
        values=values,
        covariance=solution.covariance,
        nominal=nominal,
        nominal_errors=relative_errors(rows, nominal),
        formulas=(*base.formulas, *friction_formulas(robot, base)),
        base=base,
    )
    joints = [int(i) // 10 if i < 10 * len(robot) else int(i) - 10 * len(robot) for i in base.chosen]
    joints += [term.joint for term in terms]
    units = (*base.units, *(term.unit(robot) for term in terms))
    named = zip(rows.names, symbols, units, joints, values, solution.covariance.std, strict=True)
    wrong = [name for k, name in enumerate(robot.names) if drives(part, k)]
    soft = [joint.name for joint in robot.joints if joint.spring is not None]
    return build_robot_result(
        [record for log in logs for record in log],
        part,
        tuple(
            EstimatedParameter(
                name=name,
                symbol=symbol,
                unit=unit,
                value=float(value),
                stderr=None if name in fixed else float(std),
                free=name not in fixed,
                identifiable=True,
                at_bound=held.get(name),
                axis=robot.names[joint],
            )
            for name, symbol, unit, joint, value, std in named
        ),
        relative_errors(rows, values),
        (np.vstack([motion.torque for motion in motions]), np.vstack([one @ values for one in columns])),
        ("idim", f"IDIM of a robot, {_WORDS[estimator]}"),
        motions[0].filtering,
        solution.residual.size,
        (solution.stop, solution.converged),
        solution.simulations,
        negative=wrong,
        warnings=(
            *describe_noise_limit(
                motions[0].filtering, min(motion.limit for motion in motions), motions[0].sample_time, "rigid"
            ),
            *(
                (
                    f"The robot file has springs at {join(soft)}, and to IDIM every joint is rigid: that holds below a "
                    "fifth of the modes; lower filtering.cutoff to it, or identify by didim or drive_side.",
                )
                if soft
                else ()
            ),
        ),
    )


def friction_formulas(robot: Robot, base: BaseParameters) -> tuple[str, ...]:
    """Return the sums that the numbers of the motors' friction stand for: an offset may have weights in it."""
    friction = [term.symbol for term in friction_terms(robot)]
    for place, formula in zip(offset_indices(robot), base.offset_formulas, strict=True):
        friction[place] = formula
    return tuple(friction)


def drives(part: InverseModelRobot, joint: int) -> bool:
    """Return True if a motor's friction is negative by more than two deviations, far from standstill or close to it."""
    terms, size = friction_terms(part.model), len(part.base)
    own = {term.number: size + i for i, term in enumerate(terms) if term.joint == joint}
    sums = [[place] for number, place in own.items() if number not in (Friction.OFFSET, Friction.RISE)]
    sums += [[own[Friction.COULOMB], own[Friction.RISE]]] if Friction.RISE in own else []
    weights = [np.isin(np.arange(part.values.size), places).astype(np.float64) for places in sums]
    return any(float(one @ part.values) < -2 * part.covariance.std_of(one) for one in weights)


def _select_motor_friction(robot: Robot, known: Mapping[str, Parameter]) -> dict[str, Parameter]:
    """Return the values and bounds of the motors' friction.

    Raises:
        MethodError: one is of a link's friction, which IDIM adds to the motor's.
    """
    names = {term.name(robot) for term in friction_terms(robot)}
    for name in known:
        if name not in names and (".link_viscous" in name or ".link_coulomb" in name):
            raise MethodError(
                f"{name} is of the link's side, and to IDIM a joint is rigid, with the friction of both sides: leave "
                "it out."
            )
    # A spring's numbers, and a speed below which friction rises, are none of its parameters.
    return {name: parameter for name, parameter in known.items() if name in names}


def _instruments(
    loop: RobotLoop, logs: Sequence[Sequence[Record]], base: BaseParameters, motions: Sequence[MeasuredMotion]
) -> Instruments:
    """Return the instruments of all logs."""
    each = [robot_instruments(loop, log, base, motion) for log, motion in zip(logs, motions, strict=True)]
    return lambda values: join_rows([columns(values) for columns in each], len(loop.robot))


def _nominal(robot: Robot, base: BaseParameters, rows: Rows) -> FloatArray:
    """Return the base parameters of the model's own masses, and the friction that fits best beside them."""
    own, found = base.of(robot), []
    left, W = rows.by_equation(rows.Y - rows.W[:, : len(base)] @ own), rows.W[:, len(base) :]
    columns = W.reshape(rows.equations, -1, W.shape[1])
    whose = np.array([term.joint for term in friction_terms(robot)])
    for k, (error, seen) in enumerate(zip(left, columns, strict=True)):
        found.append(np.linalg.lstsq(seen[:, whose == k], error, rcond=None)[0])
    return np.concatenate([own, *found])


_COLUMNS = {
    Friction.VISCOUS: 1,
    Friction.COULOMB: 2,
    Friction.OFFSET: 3,
    Friction.FORWARDS: 4,
    Friction.BACKWARDS: 5,
    Friction.RISE: 6,
}
"""Of `RobotNumbers.masses`."""


def robot_instruments(
    loop: RobotLoop, records: Sequence[Record], base: BaseParameters, motion: MeasuredMotion
) -> Instruments:
    """Return a function from the parameters to the columns on the simulated motion.

    Args:
        loop: robot and controllers, at rest or in motion at the first sample; springs are not read.
        records: of each joint, with reference, torque and motor position.
        base: of the robot.
        motion: that was measured; rows at which its motors rest or turn round are left out of both.

    Raises:
        RecordError: a record lacks a channel that its controller reads, or a clock does not divide the controllers'.
        MethodError: controllers or logs share no clock.
    """
    rigid = loop.robot.rigid
    experiment, joints = prepare_robot(replace(loop, robot=rigid), records), np.linalg.inv(rigid.coupling).T

    def run_loop(values: FloatArray) -> FloatArray:
        run = run_robot(experiment, _numbers(rigid, base, values), keep=True)
        if run.outcome is not Outcome.FINISHED:
            raise not_simulated(run.outcome.value)
        return simulation_of(run).motor_position

    return instruments_of(motion, run_loop, lambda *moved: base_columns(rigid, base, *(one @ joints for one in moved)))


def _numbers(robot: Robot, base: BaseParameters, values: FloatArray) -> RobotNumbers:
    """Return a robot with base parameters and friction, each base parameter in the first of its sum."""
    n = len(robot)
    standard = np.zeros((len(SYMBOLS) + 1) * n)
    standard[base.chosen] = values[: len(base)]
    links, rotors = standard[:-n].reshape(n, -1), standard[-n:]
    numbers = RobotNumbers.of(robot)
    masses = np.zeros_like(numbers.masses)
    masses[:, 0], masses[:, 7] = rotors, numbers.masses[:, 7]
    for term, value in zip(friction_terms(robot), values[len(base) :], strict=True):
        # Instruments need not be perfect.
        masses[term.joint, _COLUMNS[term.number]] = value if term.number is Friction.OFFSET else max(value, 0.0)
    return replace(numbers, inertials=links, masses=masses)
