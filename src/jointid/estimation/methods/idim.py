"""IDIM: the inverse dynamic model regressed on measured positions, by the estimator of choice.

Torque and columns are those of `problems.inverse_model`; the estimators, ordinary or weighted least squares or
instruments from a simulated loop, those of `linear`.

**A robot** has base parameters and friction of all joints at once. Its rows share their instants, and their errors
differ in size by powers of ten from base to wrist: each joint's rows are divided by the size of its own error, again
until that settles [Gautier 1997, who takes it once]. Least squares without weights ("ols") lets the large joints decide
the wrist's parameters. Beside it stand the model's own masses, with friction fitted as the estimate's was: an opponent
without friction would be none.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import TYPE_CHECKING, TypeAlias

import numpy as np

from jointid.common.arrays import FloatArray
from jointid.common.errors import MethodError
from jointid.common.parameters import Parameter
from jointid.common.settings import add_settings_to_docstring, setting
from jointid.common.text import join
from jointid.estimation.methods.linear import Estimator, Rows, Solution, rows_of, solve_rows
from jointid.estimation.methods.registry import Method, Task
from jointid.estimation.problems.closed_loop import require_free
from jointid.estimation.problems.inverse_model import (
    ENCODER_OFFSET,
    SAID,
    MeasuredMotion,
    filter_motion,
    idim_channels,
    joint_columns,
    motion_of,
    through_window,
)
from jointid.estimation.result.build_result import build_estimate, build_robot_result, build_rows
from jointid.estimation.result.estimate import Estimate
from jointid.estimation.result.parts import Checks, EstimatedParameter, Params, Settings
from jointid.estimation.result.robot import IdentifiedRobot, Sums
from jointid.estimation.robots.regression import (
    Records,
    base_columns,
    base_names,
    each_log,
    motions_of_logs,
    relative_errors,
    require_slow_samples,
)
from jointid.models.controllers import Controller
from jointid.models.joints import ClosedLoop, Joint
from jointid.models.robots.base_parameters import BaseParameters, base_parameters
from jointid.models.robots.friction_terms import Friction, friction_terms, joint_with_friction, offset_indices
from jointid.models.robots.inertial import SYMBOLS
from jointid.models.robots.robot import Robot
from jointid.records.record import Record, Timing
from jointid.records.signals.filtering import Filtering, describe_noise_limit
from jointid.simulation.closed_loop import Initial, Outcome, simulate
from jointid.simulation.loop_input import prepare
from jointid.solvers.regression import conditioning

if TYPE_CHECKING:
    from jointid.simulation.robot_numbers import RobotNumbers
    from jointid.simulation.robots import RobotLoop

_VARIANTS = {
    "ols": "IDIM by ordinary least squares",
    "weighted": "IDIM by weighted least squares, each joint by the size of its error",
    "iv": "IDIM by instrumental variables from the simulated loop",
}
_SHOWN = 4.0  # deviations: a smaller difference of two encoders' zeros is none
_SLIGHT = 1e-3  # of the torque: a smaller force of that difference is none, as filters leave as much

Columns: TypeAlias = Callable[[FloatArray, FloatArray, FloatArray], FloatArray]
"""The columns, (samples, equations, parameters), of positions, velocities and accelerations, (samples, n) each."""

SimulatedMotion: TypeAlias = Callable[[FloatArray], FloatArray]
"""The raw positions, (samples, n), that a loop makes with the values of all parameters."""


@add_settings_to_docstring
@dataclass(frozen=True, slots=True)
class IDIM(Method):
    """Settings of IDIM."""

    name = "idim"
    title = "IDIM"
    default_for = Joint

    estimator: Estimator | None = setting(
        None,
        "ols, ordinary least squares; weighted, each joint of a robot by the size of its error; "
        "iv, instruments from the simulated loop, for which the controller is needed; without it ols for a joint, "
        "weighted for a robot",
    )

    @classmethod
    def describe(cls, model: str) -> str:
        """Return the method's name as used within a sentence."""
        return "IDIM of a flexible joint" if model == "flexible" else cls.title

    @classmethod
    def channels(cls, model: str, controller: Controller | None = None) -> tuple[str, ...]:
        """Return torque and motor position, and the load's where the joint is flexible."""
        return idim_channels(model)

    def identify(self, task: Task) -> Estimate:
        """Identify a joint from torque and motor position, and load position where it is flexible.

        The standard deviations are those of the regression, robust to autocorrelation. What repeats with the motion is
        not covered, nor, but by instruments, noise in the positions and disturbances that the loop carries into them.

        Raises:
            RecordError: a channel is missing or cannot be used.
            MethodError: the record does not determine the parameters, or instruments have no loop to come from.
        """
        record, joint, loop = task.record, task.joint, task.loop
        record.require(("torque",), "IDIM")
        assert record.torque is not None
        sample_time, estimator = record.torque.sample_time, self.estimator or "ols"
        delay = loop.controller.law(sample_time).delay if loop else 0.0
        motion = motion_of(record, delay, task.filtering, joint)
        filtering, by_loop = motion.filtering, None
        if estimator == "iv" and loop is not None:
            by_loop = [_simulate_joint(record, loop, motion, task.parameters)]

        def solve_with(zeros: bool) -> tuple[tuple[Parameter, ...], Regression]:
            parameters = (*task.parameters, *((ENCODER_OFFSET,) if zeros else ()))
            require_free(parameters)
            known = {p.name: p for p in parameters}
            columns_of = partial(joint_columns, joint, zeros=zeros)
            return parameters, regress([motion], columns_of, tuple(known), 1, estimator, known, by_loop)

        parameters, found = solve_with(joint.model == "flexible" and _zeros_differ(lambda: solve_with(True)[1]))
        rows, solved = found.rows, found.solution
        held, covariance = solved.held, solved.covariance
        parameters = tuple(p.fix(held[p.name]) if p.name in held else p for p in parameters)
        free = [i for i, p in enumerate(parameters) if p.free]
        std = {rows.names[i]: float(covariance.std[i]) for i in free}
        values = dict(zip(rows.names, map(float, solved.values), strict=True))
        own = [p.name for p in task.parameters]
        measured = motion.torque[:, 0]
        predicted = through_window(found.columns[0][:, :1], filtering)[:, 0] @ solved.values
        read = ["torque", *(loop.controller.channels if loop is not None and by_loop is not None else ())]
        read += [*idim_channels(joint.model)[1:], *(("injected",) if record.injected is not None else ())]
        noise = describe_noise_limit(filtering, motion.limit, sample_time, joint.model)
        made = build_estimate(
            [record],
            Params(
                build_rows(parameters, values, std, joint.unit, own, held=held),
                tuple(std),
                covariance.correlation[np.ix_(free, free)],
            ),
            (measured, predicted),
            float(np.linalg.norm(solved.residual) / np.linalg.norm(rows.Y)),
            solved.residual.size,
            (solved.stop, solved.converged),
            solved.simulations,
            Settings("idim", _VARIANTS[estimator], joint, None, filtering, delay),
            read,
            Checks(
                warnings=(*noise, *_warnings(record, motion)),
                tests=() if solved.test is None else (solved.test,),
            ),
        )
        return replace(made, fit=replace(made.fit, conditioning=conditioning(rows.W[:, free], solved.values[free])))


@dataclass(frozen=True, slots=True, eq=False)
class Regression:
    """A regression along measured motions and its solution.

    Attributes:
        columns: of each log, (samples, equations, parameters), raw.
        rows: of all parameters.
        solution: of these.
    """

    columns: list[FloatArray]
    rows: Rows
    solution: Solution


def regress(
    motions: Sequence[MeasuredMotion],
    columns_of: Columns,
    names: tuple[str, ...],
    driven: int,
    estimator: Estimator,
    known: Mapping[str, Parameter],
    simulated: Sequence[SimulatedMotion] | None = None,
) -> Regression:
    """Return the regression along the motions of one log or several.

    Args:
        motions: that were measured.
        columns_of: the parameters' columns.
        names: of the parameters.
        driven: how many equations, the first, have the torque of a motor.
        estimator: its name.
        known: values and bounds by name; see `solve_rows`.
        simulated: the motion of each log as its loop makes it, for instruments; rows at which a measured mass rests or
            turns round are left out of both.
    """
    columns = [columns_of(motion.q, motion.v, motion.a) for motion in motions]

    def instruments(values: FloatArray) -> FloatArray:
        each = []
        for motion, simulate_with in zip(motions, simulated or (), strict=True):
            size, positions = len(motion.q), simulate_with(values)[: len(motion.q)]
            whole = np.pad(positions, ((0, size - len(positions)), (0, 0)), "edge")
            each.append(columns_of(*filter_motion(whole, motion.sample_time, motion.filtering)))
        return rows_of(motions, each, names, driven).W

    rows = rows_of(motions, columns, names, driven)
    return Regression(columns, rows, solve_rows(rows, estimator, known, instruments if simulated else None))


def _require_simulated(outcome: Outcome) -> None:
    """Refuse instruments from a simulation that did not end."""
    if outcome is not Outcome.FINISHED:
        raise MethodError(
            f"The instruments of IV come from a simulation, but with these values {outcome.value}; check the "
            "controllers' gains, or use another estimator."
        )


# A joint


def _zeros_differ(solve_with_zeros: Callable[[], Regression]) -> bool:
    """Return True if a record shows that its two encoders count from different zeros."""
    try:
        found = solve_with_zeros()
    except MethodError:  # nothing tells it from the other forces
        return False
    at = found.rows.names.index(ENCODER_OFFSET.name)
    least = max(_SHOWN * found.solution.covariance.std[at], _SLIGHT * float(np.sqrt(np.mean(found.rows.Y**2))))
    return bool(abs(found.solution.values[at]) > least)


def _simulate_joint(
    record: Record, loop: ClosedLoop, motion: MeasuredMotion, parameters: Sequence[Parameter]
) -> SimulatedMotion:
    """Return the positions that a loop makes, of motor and load.

    The simulation starts at the measured position and velocity. Instruments need not be perfect: values outside their
    bounds are simulated at the bound.

    Raises:
        RecordError: the record lacks a channel the controller reads.
    """
    experiment, initial = prepare(loop, record), Initial(float(motion.q[0, 0]), float(motion.v[0, 0]))

    def run_loop(values: FloatArray) -> FloatArray:
        pairs = zip(parameters, values, strict=False)
        run = simulate(loop, experiment, {p.name: min(max(float(x), p.lower), p.upper) for p, x in pairs}, initial)
        _require_simulated(run.outcome)
        return np.column_stack([run.motor_position, *([] if run.load_position is None else [run.load_position])])

    return run_loop


def _warnings(record: Record, motion: MeasuredMotion) -> tuple[str, ...]:
    """Return sentences on rest, and on a timing that is not respected."""
    assert record.torque is not None
    found = []
    if motion.resting > SAID:
        found.append(
            f"the motor rests in {100 * motion.resting:.0f} % of the record, where friction takes what it must and the "
            "torque says nothing of it: these rows are left out"
        )
    if motion.filtering.timing == "as_sampled" and record.torque.timing is not Timing.SAMPLED:
        found.append(
            f"the torque is {record.torque.timing.value} but read as sampled, half a period early, as the published "
            'results were; timing = "respected" is right'
        )
    return tuple(found)


# A robot
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
        from jointid.simulation.robot_numbers import robot_with

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
    robot, estimator = model if isinstance(model, Robot) else model.robot, (settings or IDIM()).estimator or "weighted"
    base, logs, terms = base_parameters(robot), each_log(records), friction_terms(robot)
    motions = motions_of_logs(robot, logs, filtering or Filtering())
    limits, simulated = _select_motor_friction(robot, known or {}), None
    if estimator == "iv" and not isinstance(model, Robot):
        simulated = [simulate_robot(model, log, base) for log in logs]
    columns_of = partial(base_columns, robot, base)
    found = regress(motions, columns_of, base_names(robot, base), len(robot), estimator, limits, simulated)
    rows, solution, values = found.rows, found.solution, found.solution.values
    require_slow_samples(robot, rows, [name for name, one in limits.items() if not one.free])
    fixed = {*solution.held, *(name for name, one in limits.items() if not one.free)}
    nominal = _nominal(robot, base, rows)
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
    symbols, units = (*base.symbols, *(term.symbol for term in terms)), (*base.units, *(t.unit(robot) for t in terms))
    joints = [int(i) // 10 if i < 10 * len(robot) else int(i) - 10 * len(robot) for i in base.chosen]
    joints += [term.joint for term in terms]
    estimated = tuple(
        EstimatedParameter(
            name=name,
            symbol=symbol,
            unit=unit,
            value=float(value),
            stderr=None if name in fixed else float(std),
            free=name not in fixed,
            identifiable=True,
            at_bound=solution.held.get(name),
            axis=robot.names[joint],
        )
        for name, symbol, unit, joint, value, std in zip(
            rows.names, symbols, units, joints, values, solution.covariance.std, strict=True
        )
    )
    resolved, limit = motions[0].filtering, min(motion.limit for motion in motions)
    warnings = [*describe_noise_limit(resolved, limit, motions[0].sample_time, "rigid")]
    if soft := [joint.name for joint in robot.joints if joint.spring is not None]:
        warnings.append(
            f"The robot file has springs at {join(soft)}, and to IDIM every joint is rigid: that holds below a "
            "fifth of the modes; lower filtering.cutoff to it, or identify by didim or drive_side."
        )
    return build_robot_result(
        [record for log in logs for record in log],
        part,
        estimated,
        relative_errors(rows, values),
        (np.vstack([motion.torque for motion in motions]), np.vstack([one @ values for one in found.columns])),
        ("idim", _VARIANTS[estimator].replace("IDIM", "IDIM of a robot")),
        resolved,
        solution.residual.size,
        (solution.stop, solution.converged),
        solution.simulations,
        negative=[name for k, name in enumerate(robot.names) if drives(part, k)],
        warnings=tuple(warnings),
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


def simulate_robot(loop: RobotLoop, records: Sequence[Record], base: BaseParameters) -> SimulatedMotion:
    """Return the positions of the joints that a robot makes under its controllers.

    Args:
        loop: robot and controllers, at rest or in motion at the first sample; springs are not read.
        records: of each joint, with reference, torque and motor position.
        base: of the robot.

    Raises:
        RecordError: a record lacks a channel that its controller reads, or a clock does not divide the controllers'.
        MethodError: controllers or logs share no clock.
    """
    from jointid.simulation.robots import prepare_robot, run_robot, simulation_of

    rigid = loop.robot.rigid
    experiment, joints = prepare_robot(replace(loop, robot=rigid), records), np.linalg.inv(rigid.coupling).T

    def run_loop(values: FloatArray) -> FloatArray:
        run = run_robot(experiment, _numbers(rigid, base, values), keep=True)
        _require_simulated(run.outcome)
        return np.asarray(simulation_of(run).motor_position @ joints)

    return run_loop


def _numbers(robot: Robot, base: BaseParameters, values: FloatArray) -> RobotNumbers:
    """Return a robot with base parameters and friction, each base parameter in the first of its sum."""
    from jointid.simulation.robot_numbers import RobotNumbers

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
