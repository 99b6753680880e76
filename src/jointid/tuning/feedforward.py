"""Feed-forward from an estimate: what the reference alone says the torque should be, in a controller's own units.

With the whole joint's inertia J, viscous friction Fv, Coulomb friction Fc and constant force c, g the controller's
torque per unit and r the ratio of a transmission between the joint and the law::

    acceleration J / (g r^2),   viscous Fv / (g r^2),   coulomb Fc / (g |r|),   constant c / (g r)

are what takes the reference's acceleration, velocity and direction, as the law sees them, to its output. It is the
torque of a rigid joint that follows its reference: good below about a fifth of the first resonance.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from jointid.common import units
from jointid.common.transmission import Transmission
from jointid.estimation.result.estimate import Estimate
from jointid.models.controllers import ServoController
from jointid.models.friction import PARTS
from jointid.models.parameters import Quantity, unit_of

_ROWS: tuple[tuple[str, str, Quantity, int], ...] = (
    ("inertia", "acceleration_feedforward", Quantity.INERTIA, 2),
    ("viscous", "viscous_feedforward", Quantity.VISCOUS, 2),
    ("coulomb", "coulomb_feedforward", Quantity.FORCE, 1),
    ("constant", "constant_feedforward", Quantity.FORCE, 1),
)
_PER_COUNT = {"inertia": "/(counts/s2)", "viscous": "/(counts/s)", "coulomb": "", "constant": ""}


@dataclass(frozen=True, slots=True)
class LumpedParameter:
    """A weighted sum of parameters, both sides of a joint together.

    Attributes:
        formula: in symbols. value: in SI on the joint's side. std: None where nothing of it was free.
    """

    formula: str
    value: float
    std: float | None


def lumped_parameters(estimate: Estimate) -> dict[str, LumpedParameter]:
    """Return inertia, viscous and Coulomb friction and the constant force of the whole joint, by those names.

    Of friction that differs with the direction viscous and Coulomb friction are the means of both directions, and half
    the difference of the Coulomb forces belongs to the constant.
    """
    sides = ("motor_", "load_") if estimate.settings.joint.model == "flexible" else ("",)
    law = estimate.settings.joint.friction
    friction: dict[str, dict[str, float]] = {
        part: {n: w for side in sides for n, w in law.mean(part, side).items()} for part in PARTS
    }
    constant: dict[str, float] = {n: w for side in sides for n, w in law.constant(side).items()}
    names = {p.name for p in estimate.params}
    constant |= {name: 1.0 for name in ("offset", "gravity_constant") if name in names}
    wanted = {"inertia": {f"{side}inertia": 1.0 for side in sides}, **friction, "constant": constant}
    return {name: _total(estimate, weights) for name, weights in wanted.items()}


@dataclass(frozen=True, slots=True)
class FeedForward:
    """One feed-forward.

    Attributes:
        key: its name in a joint file's [controller].
        formula: from the estimate, in symbols.
        value, std: in SI, on the joint's side; unit: of these. std is None where nothing of it was free.
        before: what the controller has, in controller units. after, after_std: what is proposed, in the same.
        drive: in per mille of the rated torque, and per count of the encoder; None where they are not known.
        drive_unit: of that.
    """

    key: str
    formula: str
    value: float
    std: float | None
    unit: str
    before: float
    after: float
    after_std: float | None
    drive: float | None = None
    drive_unit: str = ""


def feedforward(
    estimate: Estimate,
    controller: ServoController,
    whole: Mapping[str, LumpedParameter],
    drive: units.DriveUnits | None = None,
) -> tuple[FeedForward, ...]:
    """Return the feed-forwards of an estimate.

    Args:
        estimate: of the joint.
        controller: whose units are meant, as the joint sees it.
        whole: see `lumped_parameters`.
        drive: with the rated torque, and the encoder's counts, if they are known.
    """
    found = []
    for name, key, quantity, power in _ROWS:
        total = whole[name]
        ratio = controller.ratio if name == "constant" else abs(controller.ratio)
        per = 1.0 / (controller.gain * ratio**power)
        in_drive, unit = _in_drive(name, total.value, estimate, drive)
        found.append(
            FeedForward(
                key, total.formula, total.value, total.std,
                unit_of(quantity, estimate.settings.joint.kind, estimate.data.torque_unit),
                float(getattr(controller, key, 0.0)), per * total.value,
                None if total.std is None else abs(per) * total.std, in_drive, unit,
            )
        )  # fmt: skip
    return tuple(found)


def _in_drive(name: str, value: float, estimate: Estimate, drive: units.DriveUnits | None) -> tuple[float | None, str]:
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


def _total(estimate: Estimate, weights: Mapping[str, float]) -> LumpedParameter:
    if not weights:  # the law has no such friction
        return LumpedParameter("0", 0.0, None)
    formula = _formula(estimate, weights)
    if estimate.checks.bounds:
        return _of_sums(estimate, weights, formula)
    value = sum(weight * estimate.values[name] for name, weight in weights.items())
    spread = {name: weight * std for name, weight in weights.items() if (std := estimate[name].stderr)}
    if not spread:
        return LumpedParameter(formula, value, None)
    sizes, correlation = np.array(list(spread.values())), estimate.params.correlation_of(list(spread))
    return LumpedParameter(formula, value, math.sqrt(max(float(sizes @ correlation @ sizes), 0.0)))


def _of_sums(estimate: Estimate, weights: Mapping[str, float], formula: str) -> LumpedParameter:
    """Return a sum where only those of both sides are told; what their errors have in common is not kept: no less."""
    assert estimate.checks.known is not None
    value, std = 0.0, 0.0
    for known in estimate.checks.known.physical:
        weight = weights.get(next(iter(known.combination.weights)))
        if weight is not None:
            value, std = value + weight * known.value, std + abs(weight) * known.std
    for name, weight in weights.items():
        if name in estimate.values:  # what both sides have in common, and what was fixed
            value, std = value + weight * estimate.values[name], std + abs(weight) * (estimate[name].stderr or 0.0)
    return LumpedParameter(formula, value, std or None)


def _formula(estimate: Estimate, weights: Mapping[str, float]) -> str:
    """Return the sum in symbols, with a mean written as one."""
    kept = {name: w for name, w in weights.items() if estimate[name].free or estimate.values.get(name)} or weights
    halves = all(abs(w) == 0.5 for w in kept.values())
    terms = [
        ("- " if w < 0 else "+ ") + ("" if halves or abs(w) == 1 else f"{abs(w):g} ") + estimate[name].symbol
        for name, w in kept.items()
    ]
    joined = " ".join(terms).removeprefix("+ ")
    return f"({joined})/2" if halves else joined
