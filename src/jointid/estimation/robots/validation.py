"""An estimate of a robot on a motion that it has not seen, beside the model that one had before.

A model is worth having if it predicts such a motion better. Three are compared: the estimate, which its own record may
have led astray; bodies near the model's that fit it (`consistent`); and the model's own masses, with friction fitted to
the estimate's record.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from jointid.common.arrays import FloatArray
from jointid.common.document import Document, Documented, Paragraph
from jointid.common.errors import MethodError
from jointid.estimation.robots.consistent import can_be_near, consistent_robot
from jointid.estimation.robots.idim import RobotEstimate, errors_table
from jointid.estimation.robots.regression import base_rows, motion_of_robot, relative_errors
from jointid.models.robots.robot import Robot
from jointid.records.record import Record

_ALIKE = 0.02  # of an error: two models whose errors differ by less are as good as each other
_SAME = 1e-9  # relative: errors of two records never agree so closely


@dataclass(frozen=True, slots=True, eq=False)
class RobotValidation(Documented):
    """What an estimate, bodies that fit it and the nominal model leave of another record's torque.

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

    def document(self, *, details: bool = False) -> Document:
        """Return the verdict first, then the errors joint by joint; there are no further details."""
        del details
        mine, nominal = _percent(self.joint_errors), _percent(self.nominal_errors)
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
                f"{_percent(self.body_errors)}."
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


def validate_robot(estimate: RobotEstimate, records: Sequence[Record]) -> RobotValidation:
    """Hold an estimate's torque against another record, beside the nominal model's.

    Args:
        estimate: from another record.
        records: of each joint, as `identify_robot` takes them.

    Raises:
        MethodError: the record is the estimate's own.
        RecordError: as of `identify_robot`.
    """
    motion = motion_of_robot(estimate.robot, records, estimate.filtering)
    rows = base_rows(estimate.robot, estimate.base, motion)
    mine = relative_errors(rows, estimate.values)
    require_unseen(mine, estimate.joint_errors)
    bodies = None
    if can_be_near(estimate.robot):
        bodies = relative_errors(rows, estimate.base.with_friction(consistent_robot(estimate).robot))
    return RobotValidation(estimate.robot, mine, relative_errors(rows, estimate.nominal), bodies)


def require_unseen(errors: FloatArray, own: FloatArray) -> None:
    """Raise a `MethodError` if an estimate leaves of a record to the last digits what it leaves of its own.

    Args:
        errors: (n,) that it leaves of the record.
        own: (n,) that it leaves of the one that it is from.
    """
    if np.allclose(errors, own, rtol=_SAME, atol=0.0):
        raise MethodError(
            "This record is the one that the estimate is from, or a copy of it; expected one that it has not seen, "
            "since any estimate predicts its own: give another."
        )


def _rms(errors: FloatArray) -> float:
    return float(np.sqrt(np.mean(errors**2)))


def _percent(errors: FloatArray) -> str:
    """Return the root mean square over the joints, each by the size of its own torque."""
    return f"{100 * _rms(errors):.3g} %"
