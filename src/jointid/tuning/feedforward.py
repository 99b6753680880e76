"""Feed-forward from an estimate: what the reference alone says the torque should be, in a controller's own units.

With the whole joint's inertia J, viscous friction Fv, Coulomb friction Fc and constant force c, g the controller's
torque per unit and r the ratio of a transmission between the joint and the law::

    acceleration J / (g r^2),   viscous Fv / (g r^2),   coulomb Fc / (g |r|),   constant c / (g r)

are what takes the reference's acceleration, velocity and direction, as the law sees them, to its output. It is the
torque of a rigid joint that follows its reference: good below about a fifth of the first resonance.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from jointid.common import units
from jointid.common.transmission import Transmission
from jointid.estimation.result.estimate import Estimate
from jointid.models.controllers import ServoController
from jointid.models.parameters import Quantity, unit_of
from jointid.records.drives.drive import Drive
from jointid.tuning.lumped import LumpedParameter

_ROWS: tuple[tuple[str, str, Quantity, str, int], ...] = (
    ("inertia", "acceleration_feedforward", Quantity.INERTIA, "J / (g r^2)", 2),
    ("viscous", "viscous_feedforward", Quantity.VISCOUS, "Fv / (g r^2)", 2),
    ("coulomb", "coulomb_feedforward", Quantity.FORCE, "Fc / (g |r|)", 1),
    ("constant", "constant_feedforward", Quantity.FORCE, "c / (g r)", 1),
)
_PER_COUNT = {"inertia": "/(counts/s2)", "viscous": "/(counts/s)", "coulomb": "", "constant": ""}


@dataclass(frozen=True, slots=True)
class FeedForward:
    """One feed-forward.

    Attributes:
        key: its name in a joint file's [controller].
        formula: from the estimate, in symbols. rule: that takes it to controller units.
        value, std: in SI, on the joint's side; unit: of these. std is None where nothing of it was free.
        before: what the controller has, in controller units. after, after_std: what is proposed, in the same.
        drive: in per mille of the rated torque, and per count of the encoder; None where they are not known.
        drive_unit: of that.
    """

    key: str
    formula: str
    rule: str
    value: float
    std: float | None
    unit: str
    before: float
    after: float
    after_std: float | None
    drive: float | None = None
    drive_unit: str = ""


def feedforward(
    estimate: Estimate, controller: ServoController, whole: Mapping[str, LumpedParameter], drive: Drive | None = None
) -> tuple[FeedForward, ...]:
    """Return the feed-forwards of an estimate.

    Args:
        estimate: of the joint.
        controller: whose units are meant, as the joint sees it.
        whole: see `lumped_parameters`.
        drive: with the rated torque, and the encoder's counts, if they are known.
    """
    found = []
    for name, key, quantity, rule, power in _ROWS:
        total = whole[name]
        ratio = controller.ratio if name == "constant" else abs(controller.ratio)
        per = 1.0 / (controller.gain * ratio**power)
        in_drive, unit = _in_drive(name, total.value, estimate, drive)
        found.append(
            FeedForward(
                key, total.formula, rule, total.value, total.std,
                unit_of(quantity, estimate.settings.joint.kind, estimate.data.torque_unit),
                float(getattr(controller, key, 0.0)), per * total.value,
                None if total.std is None else abs(per) * total.std, in_drive, unit,
            )
        )  # fmt: skip
    return tuple(found)


def _in_drive(name: str, value: float, estimate: Estimate, drive: Drive | None) -> tuple[float | None, str]:
    """Return a feed-forward in the drive's own units on the motor's side, and their name."""
    joint = estimate.settings.joint
    if drive is None or estimate.data.torque_unit not in ("N", "N m"):
        return None, ""
    gear: Transmission | None = joint.transmission
    kind = joint.kind if gear is None else gear.motor
    torque = 1.0 if gear is None else gear.torque("motor")
    try:
        share = drive.resolve_unit(units.unit("permille"), kind).factor
        per_count = 1.0 if name in ("coulomb", "constant") else drive.resolve_unit(units.unit("counts"), kind).factor
    except units.UnitError:  # the drive's numbers are not all known
        return None, ""
    if name in ("inertia", "viscous"):
        return value * per_count / (torque**2 * share), f"per mille{_PER_COUNT[name]}"
    return value / ((abs(torque) if name == "coulomb" else torque) * share), "per mille"
