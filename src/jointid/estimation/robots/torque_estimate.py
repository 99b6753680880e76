"""A robot identified by simulating it, as an answer: by DIDIM or on the drive side, its joints rigid or flexible.

It is held against another record as it was identified, by simulating the robot under its controllers or along its
motors' motion, and beside the robot that one had before: the masses, rotors and springs of model and robot file, with
the friction that was found.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from jointid.common.arrays import FloatArray
from jointid.common.document import Document, Documented, Facts, Paragraph, Table
from jointid.common.errors import MethodError
from jointid.common.messages import Progress, ignore_progress
from jointid.common.parameters import TORQUE_UNIT, unit_of
from jointid.common.text import interval, join, number
from jointid.common.units import Kind
from jointid.estimation.methods.didim import DIDIM
from jointid.estimation.methods.prescribed import DriveSideFit
from jointid.estimation.robots.consistent import Sums
from jointid.estimation.robots.didim import RobotFit, identify_rigid_robot
from jointid.estimation.robots.drive_side import RobotDriveSideProblem, drive_side_problem, identify_flexible_drive_side
from jointid.estimation.robots.flexible import SpringVerdict, identify_flexible_robot
from jointid.estimation.robots.idim import KNOWN, errors_table, much_left
from jointid.estimation.robots.numbers import RobotParameters, robot_parameters
from jointid.estimation.robots.problem import RobotLoopProblem, robot_problem
from jointid.models.robots.inertial import SYMBOLS, UNITS
from jointid.models.robots.robot import Robot
from jointid.records.record import Record
from jointid.records.signals.filtering import Filtering
from jointid.simulation.robot_drive_side import RobotDriveSide
from jointid.simulation.robot_numbers import NumberOf, RobotNumbers, robot_with, with_values
from jointid.simulation.robots import RobotLoop

_WITHOUT = (
    "No joint shows a spring in this record: leave the springs out of the robot file and identify it as rigid, or "
    "excite the modes. How friction and inertia are split between motors and links below is not to be used."
)
_TWO = 2.0  # standard deviations of an interval
_TOLD = 0.5  # relative deviation: the interval of a parameter that is known worse holds 0
_UNSETTLED = (
    "The search did not settle: do not rely on what is below. Allow more by method.{}, or record longer and livelier "
    "motions."
)


@dataclass(frozen=True, slots=True, eq=False)
class RobotTorqueEstimate(Documented):
    """A robot's friction, rotors, springs and base parameters, from torques and references, or motor positions.

    Attributes:
        closing: the robot that was begun with, under its controllers or along its motors' motion.
        fit: parameters, their covariance, and what is left of each joint's torque.
        nominal_errors: (n,) what the robot that was begun with leaves, simulated; infinite where it cannot be.
        springs: a verdict for each flexible joint.
        settings: of the method.
        filtering: resolved.
    """

    closing: RobotLoop | RobotDriveSide
    fit: RobotFit
    nominal_errors: FloatArray
    springs: tuple[SpringVerdict, ...]
    settings: DIDIM | DriveSideFit
    filtering: Filtering

    @property
    def robot(self) -> Robot:
        """The robot that was begun with."""
        return self.closing.robot

    @property
    def joint_errors(self) -> FloatArray:
        """What is left of each joint's filtered torque, (n,), as a share."""
        return self.fit.relative_error

    @property
    def params(self) -> Mapping[str, float]:
        """The values by their names; without the springs that are refused."""
        values, refused = zip(self.fit.names, self.fit.values, strict=True), self._refused
        return {name: float(value) for name, value in values if name not in refused}

    @property
    def rows(self) -> Mapping[str, Mapping[str, float | str | None]]:
        """Value, deviation and unit of each parameter, by its name; of a spring that is refused a bound at most."""
        found: dict[str, Mapping[str, float | str | None]] = {}
        units, refused = parameter_units(self.robot, self.fit.parameters), self._refused
        for name, value, std in zip(self.fit.names, self.fit.values, self.fit.covariance.std, strict=True):
            unit = units[name]
            if name in refused:
                found[name] = {"value": None, "std": None, "unit": unit, "at_least": refused[name]}
            else:
                found[name] = {"value": float(value), "std": float(std), "unit": unit, "at_least": None}
        return found

    @property
    def _refused(self) -> dict[str, float | None]:
        """Bound of each parameter that is refused, by its name; the damping of a spring that is not shown has none."""
        joints = [one for one in self.springs if not one.shown]
        bounds: dict[str, float | None] = {f"{one.joint}.stiffness": float(one.at_least) for one in joints}
        return bounds | {f"{one.joint}.damping": None for one in joints}

    @property
    def _no_spring(self) -> bool:
        """Whether springs were looked for, and none was found."""
        return bool(self.springs) and not any(one.shown for one in self.springs)

    @property
    def _poor(self) -> str:
        """Sentence on joints of whose torque too much is left; "" where there is none."""
        much = much_left(self.robot, self.joint_errors)
        said = (
            "the model does not hold there, or the search ended in a wrong place. Do not rely on the intervals below; "
            "jointid diagnose says what is left."
        )
        return f"{much}: {said}" if much else ""

    @property
    def _known(self) -> str:
        """How many of the robot's parameters are known to a tenth, of how many."""
        names, places = self.fit.names, self.fit.parameters.places
        each = zip(names, places, self.fit.values, self.fit.covariance.std, strict=True)
        mine = [(n, value, std) for n, place, value, std in each if not place.is_of_record]
        known = sum(bool(std < KNOWN * abs(value)) for n, value, std in mine if n not in self._refused)
        return f"{known} of {len(mine)} parameters are known to a tenth, 1 sigma"

    def numbers(self) -> RobotNumbers:
        """Return the robot that was identified, as it is simulated."""
        return self.fit.parameters.numbers(self.fit.values)

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
        n, parameters, numbers = len(prior), self.fit.parameters, RobotNumbers.of(prior)
        numbers = replace(numbers, beside=parameters.base.beside, log=parameters.base.log)
        places = (*parameters.places, *parameters.dropped)
        both = np.hstack([np.eye(len(parameters.places)), parameters.grouping])
        of_standard, apart = np.zeros((len(both), 11 * n)), list[int]()
        for column, place in enumerate(places):
            if place.of is NumberOf.LINK:
                of_standard[:, 10 * place.row + place.column] = both[:, column]
            elif place.of is NumberOf.MASS and place.column == 0:
                of_standard[:, 10 * n + int(np.flatnonzero(numbers.rotors == place.row)[0])] = both[:, column]
            else:
                apart.append(column)
        own = tuple(places[column] for column in apart)
        about = np.array(
            [place.read(self.numbers() if c < len(both) else numbers) for c, place in zip(apart, own, strict=True)]
        )
        least = np.array([0.0 if place.is_positive else -np.inf for place in own])

        def made(inertials: FloatArray, rotors: FloatArray, others: FloatArray) -> Robot:
            there = with_values(replace(numbers, inertials=inertials), own, others)
            there.masses[there.rotors, 0] = rotors
            return robot_with(prior, there)

        return Sums(self.fit.values, self.fit.covariance, of_standard, both[:, apart], about, least, made)

    def to_document(self, *, details: bool = False) -> Document:
        """Return the springs first, then what is left of each joint's torque, and the parameters.

        Args:
            details: whether those that this record does not tell from 0 stand there too, and what sums they are.
        """
        kind = "of springs, rotors and links" if self.springs else "of rigid joints"
        how = "DIDIM of a robot, from torques and references alone"
        if isinstance(self.closing, RobotDriveSide):
            how = "drive side of a robot, from motor torques and motor positions"
        settled = "settled" if self.fit.converged else "did not settle: do not rely on it"
        facts = (
            ("method", f"{how}, {kind}"),
            ("search", f"{settled} after {self.fit.iterations} {'simulations' if self.springs else 'iterations'}"),
        )
        rows, units, refused = [], parameter_units(self.robot, self.fit.parameters), self._refused
        for name, value, std in zip(self.fit.names, self.fit.values, self.fit.covariance.std, strict=True):
            share = std / max(abs(value), 1e-300)
            if name in refused:
                if (least := refused[name]) is not None:
                    rows.append((name, f"at least {number(least, 3)}", units[name], ""))
            elif details or share < _TOLD:
                shown = interval(float(value), _TWO * float(std))
                rows.append((name, shown, units[name], f"{100 * share:.2g}"))
        hidden = len(self.fit.names) - len(rows)
        caption = self._known
        caption += f"; {hidden} more are not told from 0 by this record" if hidden else ""
        good, longer = self.fit.converged and not self._poor, "evaluations" if self.springs else "iterations"
        sums = [
            (name, sum_of)
            for name, sum_of in zip(self.fit.names, self.fit.parameters.formulas(self.robot), strict=True)
            if sum_of != name
        ]
        of_sums = (Table(("parameter", "is"), tuple(sums), "sums that torques tell", (0, 1)),) if sums else ()
        if sums and not details:
            caption += f"; {len(sums)} of all are sums, as rotor and link: --details"
        return Document(
            f"{self.robot.name}: {len(self.fit.names)} parameters of {len(self.robot)} joints",
            (
                *((Paragraph(_WITHOUT, lead=True, tone="bad"),) if self._no_spring else ()),
                *(
                    (Paragraph(_UNSETTLED.format(longer), lead=True, tone="bad"),)
                    if not (self.fit.converged or self._no_spring)
                    else ()
                ),
                *((Paragraph(self._poor, lead=True, tone="bad"),) if self._poor else ()),
                *(
                    Paragraph(f"{one}.", lead=True, tone="good" if one.shown and good else "open")
                    for one in self.springs
                ),
                Facts(facts),
                errors_table(
                    self.robot,
                    {"estimate": self.joint_errors, "nominal": self.nominal_errors},
                    "of the record it was identified from",
                ),
                Table(("parameter", "value, 2 sigma", "unit", "sigma, %"), tuple(rows), caption, (0, 1, 2)),
                *(of_sums if details else ()),
            ),
        )


def parameter_units(robot: Robot, parameters: RobotParameters) -> dict[str, str]:
    """Return the unit of each parameter by its name."""
    kinds: dict[str, Kind] = {joint.name: link.kind for joint, link in zip(robot.joints, robot.links, strict=True)}
    found = {}
    for one in parameters.parameters:
        if one.symbol in SYMBOLS:
            found[one.name] = UNITS[SYMBOLS.index(one.symbol)]
        else:
            kind = kinds.get(one.name.rpartition(".")[0], "revolute")  # the log's delay is no joint's
            found[one.name] = unit_of(one.quantity, kind, TORQUE_UNIT[kind])
    return found


def identify_robot_from_torques(
    loop: RobotLoop,
    records: Sequence[Record],
    settings: DIDIM | None = None,
    *,
    filtering: Filtering | None = None,
    progress: Progress = ignore_progress,
) -> RobotTorqueEstimate:
    """Identify a robot by DIDIM; joints with a spring are flexible, all others rigid.

    Args:
        loop: the robot and its controllers. Its own numbers are what the answer is held beside.
        records: of each joint, with torque and reference, of one log; positions are not read.
        settings: of the method.
        filtering: of torques and derivatives.
        progress: is told the steps.

    Raises:
        RecordError, MethodError: see `identify_rigid_robot` and `identify_flexible_robot`.
    """
    settings = settings or DIDIM()
    springs: tuple[SpringVerdict, ...] = ()
    if any(loop.robot.flexible):
        found = identify_flexible_robot(
            loop, records, filtering, frequencies=settings.frequencies or None, offsets=settings.offsets,
            evaluations=settings.evaluations, progress=progress,
        )  # fmt: skip
        fit, springs = found.fit, found.springs
    else:
        fit = identify_rigid_robot(
            loop, records, filtering, offsets=settings.offsets, iterations=settings.iterations, progress=progress
        )
    return _held_beside_nominal(loop, records, fit, springs, settings, filtering)


def identify_robot_drive_side(
    robot: Robot,
    records: Sequence[Record],
    settings: DriveSideFit | None = None,
    *,
    filtering: Filtering | None = None,
    progress: Progress = ignore_progress,
) -> RobotTorqueEstimate:
    """Identify a robot with flexible joints from motor torques and motor positions, whatever its controllers are.

    Args:
        robot: whose joints with a spring are flexible. Its own numbers are what the answer is held beside.
        records: of each joint, with torque and motor position behind the gear, on one clock; references are not read.
        settings: of the method.
        filtering: of positions and torques.
        progress: is told the steps.

    Raises:
        RecordError, MethodError: see `identify_flexible_drive_side`.
    """
    settings = settings or DriveSideFit()
    found = identify_flexible_drive_side(
        robot, records, filtering, frequencies=settings.frequencies or None, offsets=settings.offsets,
        evaluations=settings.evaluations, delay=settings.log_delay, progress=progress,
    )  # fmt: skip
    return _held_beside_nominal(RobotDriveSide(robot), records, found.fit, found.springs, settings, filtering)


def _held_beside_nominal(
    setup: RobotLoop | RobotDriveSide,
    records: Sequence[Record],
    fit: RobotFit,
    springs: tuple[SpringVerdict, ...],
    settings: DIDIM | DriveSideFit,
    filtering: Filtering | None,
) -> RobotTorqueEstimate:
    nominal = nominal_numbers(setup.robot, fit.parameters.numbers(fit.values))
    errors, resolved = simulated_errors(setup, records, filtering, nominal)
    return RobotTorqueEstimate(setup, fit, errors, springs, settings, resolved)


def nominal_numbers(robot: Robot, found: RobotNumbers) -> RobotNumbers:
    """Return the robot that one had before, with the friction that was found: one without friction is no opponent.

    The log's delay is not the robot's, and is as it was found, too.
    """
    numbers = RobotNumbers.of(robot)
    masses = numbers.masses.copy()
    masses[:, 1:] = found.masses[:, 1:]
    return replace(numbers, masses=masses, log=found.log)


def simulated_errors(
    setup: RobotLoop | RobotDriveSide, records: Sequence[Record], filtering: Filtering | None, numbers: RobotNumbers
) -> tuple[FloatArray, Filtering]:
    """Return what a robot leaves of each joint's filtered torque, (n,), infinite if it cannot be simulated."""
    problem = problem_of(setup, records, robot_parameters(setup.robot), filtering)
    error = problem.error_of(numbers)
    if error is None:
        return np.full(len(setup.robot), np.inf), problem.filtering
    left, whole = (problem.by_joint(rows) for rows in (error, problem.decimated(problem.measured)))
    return np.linalg.norm(left, axis=1) / np.linalg.norm(whole, axis=1), problem.filtering


def problem_of(
    setup: RobotLoop | RobotDriveSide,
    records: Sequence[Record],
    parameters: RobotParameters,
    filtering: Filtering | None = None,
) -> RobotLoopProblem | RobotDriveSideProblem:
    """Return the problem of reproducing a robot's torques, under its controllers or along its motors' motion."""
    if isinstance(setup, RobotLoop):
        return robot_problem(setup, records, parameters, filtering)
    return drive_side_problem(setup.robot, records, parameters, filtering)
