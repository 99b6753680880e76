"""IDIM of a robot: base parameters and friction of all joints at once, from motor positions and torques.

The rows of all joints share their instants, and their errors differ in size by powers of ten from base to wrist: each
joint's rows are divided by the size of its own error, again until that settles [Gautier 1997, who takes it once].
Least squares without weights ("ols") lets the large joints decide the wrist's parameters.

Noise of the positions pulls least squares towards 0. Instruments ("iv") are free of it: the columns on the motion that
the robot makes under its controllers with the values found last, until these settle (`instruments`).

Beside it stand the model's own masses, with friction fitted as the estimate's was: an opponent without friction would
be none.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from jointid.common.arrays import FloatArray
from jointid.common.document import Document, Documented, Facts, Heading, Listing, Paragraph, Table
from jointid.common.errors import MethodError
from jointid.common.messages import no_choice
from jointid.common.text import interval, join, number
from jointid.estimation.methods.idim import IDIM
from jointid.estimation.methods.linear import (
    Instruments,
    Rows,
    Solution,
    by_instruments,
    ordinary,
    robust,
    weighted,
)
from jointid.estimation.robots.consistent import Sums
from jointid.estimation.robots.instruments import robot_instruments
from jointid.estimation.robots.regression import (
    base_rows,
    motion_of_robot,
    relative_errors,
    require_reached,
)
from jointid.models.robots.base_parameters import BaseParameters, base_parameters
from jointid.models.robots.friction_terms import Friction, friction_terms, joint_with_friction, offset_indices
from jointid.models.robots.robot import Robot
from jointid.records.record import Record
from jointid.records.signals.filtering import Filtering
from jointid.simulation.robots import RobotLoop
from jointid.uncertainty.covariance import Covariance

KNOWN = 0.1
"""Relative deviation: a parameter that is known better is told by the record."""

_LEFT = 0.1  # of a joint's filtered torque: beyond, the model does not hold

_WORDS = {
    "ols": "ordinary least squares",
    "weighted": "least squares, each joint by the size of its error",
    "robust": "robust least squares (Tukey's bisquare), each joint by the size of its error",
    "iv": "instruments from simulations of the closed loop, each joint by the size of its error",
}


def solve_rows(settings: IDIM, rows: Rows, instruments: Instruments | None = None) -> Solution:
    """Return the solution of all parameters, the fixed ones' deviations 0; one joint has nothing to weigh.

    Args:
        settings: of the method.
        rows: of all parameters.
        instruments: from `robot_instruments`, of "iv" alone.

    Raises:
        MethodError: a fixed parameter is none, or the rows do not determine the others.
    """
    for name in settings.fixed:
        if name not in rows.names:
            raise MethodError(f"A name in fixed{no_choice(name, rows.names)}")
    kept = np.array([settings.fixed.get(name, 0.0) for name in rows.names])
    free = [i for i, name in enumerate(rows.names) if name not in settings.fixed]
    if not free:
        raise MethodError("All parameters are fixed, so there is nothing to identify; leave some of them out.")
    left = replace(rows, Y=rows.Y - rows.W @ kept, W=rows.W[:, free], names=tuple(rows.names[i] for i in free))
    if settings.estimator == "iv":
        if instruments is None:
            raise MethodError(
                'The estimator "iv" simulates the robot under its controllers; expected a controller of each joint '
                'in the loop: give one, or use "weighted".'
            )
        solution = by_instruments(left, instruments, kept, free)
    elif settings.estimator == "robust":
        solution = robust(left)
    else:
        solution = ordinary(left) if settings.estimator == "ols" or rows.equations == 1 else weighted(left)
    return with_fixed(solution, kept, free) if settings.fixed else solution


def with_fixed(solution: Solution, kept: FloatArray, free: Sequence[int]) -> Solution:
    """Return a solution of the free parameters as one of all, the others at what they are kept at, without deviation.

    Args:
        solution: of the free parameters.
        kept: (parameters,) values of the fixed ones.
        free: which are free.
    """
    values, std, correlation = kept.copy(), np.zeros(kept.size), np.eye(kept.size)
    values[list(free)], std[list(free)] = solution.fit.values, solution.covariance.std
    correlation[np.ix_(free, free)] = solution.covariance.correlation
    covariance = replace(solution.covariance, std=std, correlation=correlation)
    return replace(solution, fit=replace(solution.fit, values=values), covariance=covariance)


@dataclass(frozen=True, slots=True, eq=False)
class RobotEstimate(Documented):
    """Base parameters and friction of a robot, identified.

    Attributes:
        robot: the model that was begun with.
        base: its base parameters.
        names: (parameters,) symbols of the base parameters, then of the numbers of the motors' friction.
        values: (parameters,) in SI units.
        covariance: of the values, robust to autocorrelation.
        joint_errors: (n,) what is left of each joint's filtered torque, as a share.
        nominal: (parameters,) the model's own masses and rotors, and friction fitted beside them.
        nominal_errors: (n,) what these leave.
        settings: of the method.
        filtering: resolved.
        converged: whether the values settled, where simulations give the instruments.
    """

    robot: Robot
    base: BaseParameters
    names: tuple[str, ...]
    values: FloatArray
    covariance: Covariance
    joint_errors: FloatArray
    nominal: FloatArray
    nominal_errors: FloatArray
    settings: IDIM
    filtering: Filtering
    converged: bool = True

    @property
    def params(self) -> Mapping[str, float]:
        """The values by their symbols."""
        return dict(zip(self.names, map(float, self.values), strict=True))

    @property
    def relative_deviations(self) -> FloatArray:
        """Standard deviations as shares of the values, (parameters,)."""
        return np.asarray(self.covariance.std / np.maximum(np.abs(self.values), 1e-300))

    @property
    def told(self) -> tuple[str, ...]:
        """Symbols of the parameters that this record tells: known to a tenth of themselves, and not fixed."""
        shares = zip(self.names, self.relative_deviations, strict=True)
        return tuple(name for name, share in shares if share < KNOWN and name not in self.settings.fixed)

    @property
    def rows(self) -> Mapping[str, Mapping[str, object]]:
        """Value, deviation, unit, nominal value and sum of each parameter, by its symbol."""
        formulas = self._formulas
        columns = (self.values.tolist(), self.covariance.std.tolist(), self._units, self.nominal.tolist(), formulas)
        keys = ("value", "std", "unit", "nominal", "formula")
        return {name: dict(zip(keys, row, strict=True)) for name, *row in zip(self.names, *columns, strict=True)}

    @property
    def objections(self) -> tuple[str, ...]:
        """Sentences on what no robot can be, friction that drives by more than two deviations, and on no settling."""
        unsettled = () if self.converged else ("The values by instruments did not settle: do not rely on them.",)
        joints = [name for k, name in enumerate(self.robot.names) if self._drives(k)]
        if not joints:
            return unsettled
        return (
            *unsettled,
            f"The friction of {', '.join(joints)} comes out negative, as no robot's is: check the signs of torque, "
            "motor position and gear.",
        )

    @property
    def cautions(self) -> tuple[str, ...]:
        """Sentences on springs that the model has and IDIM has not, and on torque that is left."""
        found = []
        soft = [joint.name for joint in self.robot.joints if joint.spring is not None]
        if soft:
            found.append(
                f"The robot file has springs at {join(soft)}, and to IDIM every joint is rigid: that holds below a "
                "fifth of the modes; lower filtering.cutoff to it, or identify by didim or drive_side."
            )
        if much := much_left(self.robot, self.joint_errors):
            found.append(f"{much}: the model does not hold there, as where a joint bends. jointid diagnose says more.")
        return tuple(found)

    def sums(self, prior: Robot) -> Sums:
        """Return base parameters and friction as sums of the numbers of a robot of this tree."""
        n, terms, size = len(prior), friction_terms(prior), len(self.base)
        friction = self.values[size:]
        of_standard = np.zeros((self.values.size, 11 * n))
        of_standard[:size] = self.base.grouping
        of_standard[size + np.array(offset_indices(prior))] = self.base.offsets
        of_others = np.vstack([np.zeros((size, friction.size)), np.eye(friction.size)])
        least = np.array([-np.inf if term.number is Friction.OFFSET else 0.0 for term in terms])

        def made(inertials: FloatArray, rotors: FloatArray, others: FloatArray) -> Robot:
            joints = []
            for k, joint in enumerate(prior.joints):
                own = {term.number: float(x) for term, x in zip(terms, others, strict=True) if term.joint == k}
                # To IDIM a joint is rigid: what it finds is the friction of both sides.
                joints.append(replace(joint_with_friction(joint, own), rotor_inertia=float(rotors[k]), spring=None))
            return replace(prior.with_inertials(inertials), joints=tuple(joints))

        return Sums(self.values, self.covariance, of_standard, of_others, friction, least, made)

    def to_document(self, *, details: bool = False) -> Document:
        """Return what is left of each joint's torque, and the parameters.

        Args:
            details: whether those that this record does not tell from 0 stand there too, and the sums behind all.
        """
        units = self._units
        shares = self.relative_deviations
        shown = [i for i in range(len(self.names)) if details or shares[i] < 1.0]
        rows = tuple(
            (
                self.names[i],
                interval(float(self.values[i]), 2 * float(self.covariance.std[i])),
                units[i],
                "fixed" if self.names[i] in self.settings.fixed else f"{100 * shares[i]:.2g}",
                number(float(self.nominal[i]), 4),
            )
            for i in shown
        )
        errors = {"estimate": self.joint_errors}
        if self.robot.has_masses:
            errors["nominal"] = self.nominal_errors
        sums = tuple(f"{a} is {b}" for a, b in zip(self.names, self._formulas, strict=True) if a != b)
        hidden = len(self.names) - len(shown)
        left_out = f"; {hidden} more are not told from 0 by this record" if hidden else ""
        asked = len(self.names) - len(self.settings.fixed)
        caption = f"{len(self.told)} of {asked} parameters are known to a tenth, 1 sigma{left_out}"
        return Document(
            f"{self.robot.name}: {len(self.base)} base parameters of {len(self.robot)} joints",
            (
                *(Paragraph(one, lead=True, tone="bad") for one in (*self.objections, *self.cautions)),
                Facts((("method", f"IDIM of a robot, {_WORDS[self.settings.estimator or 'weighted']}"),)),
                errors_table(self.robot, errors, "of the record it was identified from"),
                Table(("parameter", "value, 2 sigma", "unit", "sigma, %", "nominal"), rows, caption, (0, 1, 2)),
                *((Heading("Sums that the parameters stand for"), Listing(sums)) if details else ()),
            ),
        )

    @property
    def _formulas(self) -> tuple[str, ...]:
        friction = list(self.names[len(self.base) :])
        for place, formula in zip(offset_indices(self.robot), self.base.offset_formulas, strict=True):
            friction[place] = formula
        return (*self.base.formulas, *friction)

    @property
    def _units(self) -> tuple[str, ...]:
        return (*self.base.units, *(term.unit(self.robot) for term in friction_terms(self.robot)))

    def _drives(self, joint: int) -> bool:
        """Whether a motor's friction drives it by more than two deviations: far from standstill, or close to it."""
        terms, size = friction_terms(self.robot), len(self.base)
        own = {term.number: size + i for i, term in enumerate(terms) if term.joint == joint}
        sums = [[place] for number, place in own.items() if number not in (Friction.OFFSET, Friction.RISE)]
        sums += [[own[Friction.COULOMB], own[Friction.RISE]]] if Friction.RISE in own else []
        weights = [np.isin(np.arange(self.values.size), places).astype(np.float64) for places in sums]
        return any(float(one @ self.values) < -2 * self.covariance.std_of(one) for one in weights)


def identify_robot(
    robot: Robot,
    records: Sequence[Record],
    settings: IDIM | None = None,
    *,
    filtering: Filtering | None = None,
    loop: RobotLoop | None = None,
) -> RobotEstimate:
    """Identify a robot's base parameters and friction from motor positions and torques of all joints.

    Args:
        robot: its geometry, gravity and coupling are taken as known; its masses are only what is compared with.
        records: of each joint, with torque and motor position behind the gear, on one clock.
        settings: of the method.
        filtering: of positions and rows.
        loop: the robot under its controllers, which the estimator "iv" simulates from the records' references and what
            is injected; at the first sample at rest, or in motion where the loop says so.

    Raises:
        MethodError: the record does not determine all base parameters; the sentence names those involved. Or "iv" has
            no loop, or cannot simulate it.
        RecordError: a channel is missing, or the joints' records have not one clock.

    Valid for joints that are rigid in the band of the filter: below about a fifth of the first resonance.
    """
    settings = settings or IDIM()
    base = base_parameters(robot)
    motion = motion_of_robot(robot, records, filtering or Filtering())
    rows = base_rows(robot, base, motion)
    require_reached(robot, rows, settings.fixed)
    by_loop = robot_instruments(loop, records, base, motion) if loop and settings.estimator == "iv" else None
    solution = solve_rows(settings, rows, by_loop)
    nominal = _nominal(robot, base, rows)
    values = solution.fit.values
    return RobotEstimate(
        robot, base, rows.names, values, solution.covariance, relative_errors(rows, values), nominal,
        relative_errors(rows, nominal), settings, motion.filtering, solution.converged,
    )  # fmt: skip


def _nominal(robot: Robot, base: BaseParameters, rows: Rows) -> FloatArray:
    """Return the base parameters of the model's own masses, and the friction that fits best beside them."""
    own, found = base.of(robot), []
    left, W = rows.by_equation(rows.Y - rows.W[:, : len(base)] @ own), rows.W[:, len(base) :]
    columns = W.reshape(rows.equations, -1, W.shape[1])
    whose = np.array([term.joint for term in friction_terms(robot)])
    for k, (error, seen) in enumerate(zip(left, columns, strict=True)):
        found.append(np.linalg.lstsq(seen[:, whose == k], error, rcond=None)[0])
    return np.concatenate([own, *found])


def much_left(robot: Robot, errors: FloatArray) -> str:
    """Return the beginning of a sentence on joints of whose torque too much is left; "" where there is none.

    Args:
        robot: whose joints they are.
        errors: (n,) what is left of each joint's torque, as a share.
    """
    bad = [name for name, left in zip(robot.names, errors, strict=True) if left > _LEFT]
    return f"More than a tenth of the torque of {join(bad)} is left" if bad else ""


def errors_table(robot: Robot, columns: Mapping[str, FloatArray], of_what: str) -> Table:
    """Return what is left of each joint's torque as a table, a column for each model, in per cent.

    Raises:
        MethodError: a joint has no torque to explain.
    """
    for errors in columns.values():
        if np.any(np.isnan(errors)):
            raise MethodError("A joint's torque is 0 throughout; expected a torque of every motor: check the channels.")
    rows = tuple(
        (name, *(f"{100 * errors[k]:.3g}" if np.isfinite(errors[k]) else "runs away" for errors in columns.values()))
        for k, name in enumerate(robot.names)
    )
    header = ("joint", *(f"{name}, %" for name in columns))
    return Table(header, rows, f"filtered torque that is left, {of_what}")
