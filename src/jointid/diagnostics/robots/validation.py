"""Validation of a robot's estimate on another record, with the nominal robot for comparison.

An estimate is worth having if it predicts that record better. Three models are compared: the estimate; bodies near the
nominal ones that fit it (`consistent`); and the nominal masses, rotors and springs, with friction fitted to the
estimate's record. By IDIM the inverse models are compared, otherwise simulations.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from jointid.common.arrays import FloatArray
from jointid.common.document import Document, Documented, Paragraph
from jointid.common.errors import MethodError
from jointid.estimation.result.estimate import Estimate, fingerprint
from jointid.estimation.result.robot_summary import errors_table
from jointid.estimation.robots.consistent import can_be_near, consistent_robot
from jointid.estimation.robots.idim import InverseModelRobot
from jointid.estimation.robots.regression import base_rows, motion_of_robot, relative_errors
from jointid.estimation.robots.simulated import SimulatedRobot, nominal_numbers, simulated_errors
from jointid.models.robots.robot import Robot
from jointid.records.record import Record
from jointid.simulation.robot_numbers import RobotNumbers
from jointid.simulation.robots import RobotLoop

_ALIKE = 0.02  # of an error: two models whose errors differ by less are as good as each other


@dataclass(frozen=True, slots=True, eq=False)
class RobotValidation(Documented):
    """Shares of another record's torque that an estimate, bodies near the nominal ones and the nominal robot leave.

    Attributes:
        robot: whose joints they are.
        joint_errors: (n,) what the estimate leaves of each joint's filtered torque, as a share.
        nominal_errors: (n,) what the nominal masses leave, with friction fitted to the estimate's record.
        body_errors: (n,) what bodies near the nominal ones leave, which fit the estimate; None where the model has no
            bodies to be near, or the record does not show a spring.
        settled: whether the search for the estimate had.
    """

    robot: Robot
    joint_errors: FloatArray
    nominal_errors: FloatArray
    body_errors: FloatArray | None = None
    settled: bool = True

    @property
    def better(self) -> bool:
        """True if the estimate predicts better than the nominal model over all joints."""
        return _rms(self.joint_errors) < _rms(self.nominal_errors)

    @property
    def bodies_better(self) -> bool:
        """True if the bodies near the nominal ones predict better than these over all joints."""
        return self.body_errors is not None and _rms(self.body_errors) < _rms(self.nominal_errors)

    def to_document(self, *, details: bool = False) -> Document:
        """Return the verdict first, then the errors joint by joint; there are no further details."""
        del details
        mine, nominal = _format_rms(self.joint_errors), _format_rms(self.nominal_errors)
        columns = {"estimate": self.joint_errors}
        if self.robot.has_masses:
            columns["nominal"] = self.nominal_errors
        if not self.robot.has_masses:
            said = f"The estimate leaves {mine} of this record; the model says no masses to compare it with."
        elif not np.all(np.isfinite(self.nominal_errors)):
            said = (
                f"The estimate leaves {mine} of this record; the nominal model cannot be compared, since it is "
                "unstable under these controllers: give each joint's rotor_inertia, behind its gear."
            )
        elif abs(_rms(self.joint_errors) - _rms(self.nominal_errors)) < _ALIKE * _rms(self.nominal_errors):
            said = f"The estimate predicts this record as well as the nominal model: {mine} and {nominal}."
        elif self.better:
            said = f"The estimate predicts this record better than the nominal model: {mine} against {nominal}."
        else:
            said = (
                f"The estimate predicts this record worse than the nominal model, {mine} against {nominal}: do not use "
                "it in its place."
            )
        if not self.settled:
            said += " Its search did not settle: do not rely on it."
        if self.body_errors is not None:
            columns["bodies"] = self.body_errors
            than = "better" if self.bodies_better else "worse"
            said += (
                f" Bodies near the nominal ones that fit the estimate predict {than} than these: "
                f"{_format_rms(self.body_errors)}."
            )
        least = min(_rms(self.joint_errors), np.inf if self.body_errors is None else _rms(self.body_errors))
        useful = self.settled and least < (1.0 + _ALIKE) * _rms(self.nominal_errors)
        return Document(
            f"{self.robot.name}: torque on a record that the estimate has not seen",
            (
                Paragraph(said, lead=True, tone="good" if useful else "bad"),
                errors_table(self.robot, columns, "of that record"),
            ),
        )


def validate_robot(estimate: Estimate, records: Sequence[Record]) -> RobotValidation:
    """Compare an estimate, the nominal robot and bodies near it with another record; see `jointid.validate`."""
    part, filtering = estimate.require_robot(), estimate.settings.filtering
    robot = part.model
    _require_another_record(estimate, records)
    if isinstance(part, InverseModelRobot):
        rows = base_rows(robot, part.base, motion_of_robot(robot, records, filtering))
        mine, nominal = (relative_errors(rows, values) for values in (part.values, part.nominal))
        bodies = None
        if can_be_near(robot):
            bodies = relative_errors(rows, part.base.with_friction(consistent_robot(estimate).robot))
        return RobotValidation(robot, mine, nominal, bodies)
    assert isinstance(part, SimulatedRobot)
    setup, found = part.setup, part.numbers()
    mine, nominal = (
        simulated_errors(setup, records, filtering, numbers) for numbers in (found, nominal_numbers(robot, found))
    )
    if not np.all(np.isfinite(mine)):
        what = "references" if isinstance(setup, RobotLoop) else "motor positions"
        raise MethodError(f"The robot that was identified cannot be simulated along this record; check its {what}.")
    bodies = None
    if can_be_near(robot) and all(spring.shown for spring in part.springs):
        near = replace(RobotNumbers.of(consistent_robot(estimate).robot), log=found.log)
        bodies = simulated_errors(setup, records, filtering, near)
    return RobotValidation(robot, mine, nominal, bodies, settled=estimate.fit.converged)


def _require_another_record(estimate: Estimate, records: Sequence[Record]) -> None:
    """Raise a `MethodError` if the torques are those of a log that the estimate is from."""
    torques = [record.torque.values for record in records if isinstance(record, Record) and record.torque is not None]
    if torques and fingerprint(np.concatenate(torques)) in estimate.data.fingerprints:
        raise MethodError(
            "This record is the one that the estimate is from, or a copy of it; expected one that it has not seen, "
            "since any estimate predicts its own: give another."
        )


def _rms(errors: FloatArray) -> float:
    return float(np.sqrt(np.mean(errors**2)))


def _format_rms(errors: FloatArray) -> str:
    """Return the root mean square over the joints, each by the size of its own torque."""
    return f"{100 * _rms(errors):.3g} %"
