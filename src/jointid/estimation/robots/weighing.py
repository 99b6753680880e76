"""A payload weighed two ways, beside each other: by both records at once, and by the difference of two estimates.

From torques and references alone both ways come from an estimate of each record by DIDIM, behind springs also from
torques and motor positions, on the drive side.

Both ways read the same records, so that they agree says that the robot was the same in both: its friction and its own
links. Where they differ by more than three deviations of the difference alone, one of these has changed.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from jointid.common.arrays import FloatArray
from jointid.common.document import Document, Documented, Paragraph, Table
from jointid.common.errors import MethodError
from jointid.common.messages import Progress, ignore_progress
from jointid.common.text import interval, join
from jointid.estimation.robots.idim import KNOWN, RobotIDIM, identify_robot
from jointid.estimation.robots.numbers import robot_parameters
from jointid.estimation.robots.payload import (
    Payload,
    identify_payload,
    payload_columns,
    payload_difference,
    payload_of_torques,
    require_told,
)
from jointid.estimation.robots.torque_estimate import (
    RobotDIDIM,
    RobotDriveSideFit,
    RobotTorqueEstimate,
    identify_robot_drive_side,
    identify_robot_from_torques,
)
from jointid.models.robots.inertial import is_consistent
from jointid.models.robots.robot import Robot
from jointid.records.record import Record
from jointid.records.signals.filtering import Filtering
from jointid.simulation.robot_drive_side import RobotDriveSide
from jointid.simulation.robots import RobotLoop

_ROWS = (
    *(("mass", "kg"), ("centre x", "m"), ("centre y", "m"), ("centre z", "m")),
    *((f"inertia {axes}", "kg m2") for axes in ("xx", "yy", "zz", "xy", "xz", "yz")),
)
_TWO = 2.0  # standard deviations of an interval
_FAR = 3.0  # deviations between the two ways, of ten numbers the largest


@dataclass(frozen=True, slots=True, eq=False)
class WeighedPayload(Documented):
    """A payload by both records at once, and by the difference of an estimate of each.

    Attributes:
        payload: by both records at once, which is the answer; on the drive side by the difference, too.
        difference: by two estimates.
    """

    payload: Payload
    difference: Payload

    @property
    def link(self) -> str:
        """The link that carries it, in whose frame it is."""
        return self.payload.link

    @property
    def rows(self) -> Mapping[str, Mapping[str, float | str]]:
        """Value, deviation, unit and verdict of each number, and the same by difference."""
        values, std = self.payload.properties
        others, spread = self.difference.properties
        found: dict[str, Mapping[str, float | str]] = {}
        for k, (name, unit) in enumerate(_ROWS):
            found[name] = {
                "value": float(values[k]), "std": float(std[k]), "unit": unit,
                "verdict": _verdict(name, float(values[k]), float(std[k])),
                "by_difference": float(others[k]), "by_difference_std": float(spread[k]),
            }  # fmt: skip
        return found

    @property
    def apart(self) -> FloatArray:
        """How far the two ways are apart, in deviations of the difference, (10,)."""
        (values, _), (others, spread) = self.payload.properties, self.difference.properties
        return np.asarray((values - others) / np.maximum(spread, 1e-300))

    @property
    def agrees(self) -> bool:
        """True if both ways say the same."""
        return bool(np.max(np.abs(self.apart)) <= _FAR)

    @property
    def possible(self) -> bool:
        """True if a body can have the ten parameters as they were found."""
        return is_consistent(self.payload.inertial)

    def document(self, *, details: bool = False) -> Document:
        """Return the verdict first, then each number both ways; there are no further details."""
        del details
        rows = self.rows
        lines = [
            (
                name,
                interval(float(row["value"]), _TWO * float(row["std"])),
                str(row["unit"]),
                str(row["verdict"]),
                interval(float(row["by_difference"]), _TWO * float(row["by_difference_std"])),
            )
            for name, row in rows.items()
        ]
        mass = rows["mass"]
        said = f"The payload weighs {interval(float(mass['value']), _TWO * float(mass['std']))} kg, 2 sigma."
        if self.payload is self.difference:
            said += " It is the difference of two estimates, each with its own friction."
        elif self.agrees:
            said += " The difference of two estimates says the same."
        else:
            far = [name for name, one in zip(rows, self.apart, strict=True) if abs(one) > _FAR]
            said += (
                f" The difference of two estimates, each with its own friction, says otherwise of {join(far)}: "
                "something beside the payload changed between the records, as friction does that warms up. Believe the "
                "difference."
            )
        if not self.possible:
            said += " No body has just these numbers; those that are not known may be far off."
        header = ("", "both records, 2 sigma", "unit", "verdict", "by difference, 2 sigma")
        return Document(
            f"Payload on {self.link}, in its frame",
            (
                Paragraph(said, lead=True, tone="good" if self.agrees else "bad"),
                Table(header, tuple(lines), "inertia at the centre, along the axes of the frame", (0, 1, 2, 3)),
            ),
        )


def _verdict(name: str, value: float, std: float) -> str:
    """Return whether a number is known; a centre that is at 0 may be known, too, so there is only its interval."""
    if name.startswith("centre"):
        return f"within {1e3 * _TWO * std:.2g} mm"
    if std <= KNOWN * abs(value):
        return "known"
    return "roughly known" if _TWO * std < abs(value) else "not told from 0"


def weigh_payload(
    robot: Robot,
    empty: Sequence[Record],
    loaded: Sequence[Record],
    settings: RobotIDIM | None = None,
    *,
    filtering: Filtering | None = None,
) -> WeighedPayload:
    """Return what the last link carries in the second record and not in the first, found both ways.

    Args:
        robot: its geometry, gravity and coupling.
        empty: the record of each joint without the payload.
        loaded: the record of each joint with it; another motion will do.
        settings: of the regressions.
        filtering: of positions and rows.

    Raises:
        MethodError: a record does not determine the robot, the payload's mass comes out negative, or the estimator is
            "iv".
        RecordError: as of `identify_robot`.
    """
    both = identify_payload(robot, empty, loaded, settings, filtering=filtering)
    # What is fixed is the empty robot's: with the payload it is another number.
    free = replace(settings or RobotIDIM(), fixed={})
    one, other = (identify_robot(robot, records, free, filtering=filtering) for records in (empty, loaded))
    return WeighedPayload(both, payload_difference(one, other))


def weigh_payload_from_torques(
    setup: RobotLoop | RobotDriveSide,
    empty: Sequence[Record],
    loaded: Sequence[Record],
    settings: RobotDIDIM | RobotDriveSideFit | None = None,
    filtering: Filtering | None = None,
    progress: Progress = ignore_progress,
) -> WeighedPayload:
    """Return what the last link carries in the second record, by two estimates from simulations, found both ways.

    Args:
        setup: the robot, rigid or flexible, and its controllers, whose gains are the same with the payload; or a
            flexible one, `RobotDriveSide`, whatever its controllers are.
        empty: of each joint, with torque and reference, or motor position, without the payload.
        loaded: the same with it; another motion will do.
        settings: of DIDIM, or of the drive side.
        filtering: of torques and derivatives.
        progress: is told the steps.

    Raises:
        MethodError: the robot does not tell all of a payload; an estimate does not settle, or does not show a spring;
            or the mass comes out negative.
        RecordError: as of `identify_robot_from_torques` and `identify_robot_drive_side`.
    """
    offsets = (settings or RobotDIDIM()).offsets
    require_told(payload_columns(robot_parameters(setup.robot, offsets=offsets)))

    def identify(records: Sequence[Record], said: str) -> RobotTorqueEstimate:
        def told(text: str) -> None:
            progress(f"{said}: {text}")

        if isinstance(setup, RobotLoop):
            if isinstance(settings, RobotDriveSideFit):
                raise MethodError(
                    "RobotDriveSideFit is of the drive side, and a loop is weighed by DIDIM; give RobotDIDIM."
                )
            return identify_robot_from_torques(setup, records, settings, filtering=filtering, progress=told)
        if isinstance(settings, RobotDIDIM):
            raise MethodError(
                "RobotDIDIM is of a robot under its controllers; on the drive side give RobotDriveSideFit."
            )
        return identify_robot_drive_side(setup.robot, records, settings, filtering=filtering, progress=told)

    one, other = identify(empty, "without the payload"), identify(loaded, "with it")
    difference = payload_of_torques(one, other, same_friction=False)
    if isinstance(setup, RobotDriveSide):
        # With one friction for both the centre came out 0.8 % short in seven of seven draws of noise.
        return WeighedPayload(difference, difference)
    return WeighedPayload(payload_of_torques(one, other, same_friction=True), difference)
