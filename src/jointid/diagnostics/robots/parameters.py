"""The parameters of a robot's estimate, each with the joint that it belongs to, what it stands for, and a verdict.

A parameter is told by a record where its deviation is below a tenth of it, roughly where it is below itself, and else
not told from 0. A stiffness that is refused has its bound; what was fixed was not asked of the record.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from enum import StrEnum

import numpy as np

from jointid.estimation.robots.idim import KNOWN, RobotEstimate
from jointid.estimation.robots.torque_estimate import RobotTorqueEstimate
from jointid.models.robots.friction_terms import friction_terms
from jointid.simulation.robot_numbers import NumberOf, RobotNumbers

_ROUGHLY = 1.0  # relative deviation


class Told(StrEnum):
    """How well a record tells a parameter."""

    TOLD = "told"
    ROUGHLY = "roughly"
    NOT = "not told from 0"
    REFUSED = "refused"
    FIXED = "fixed"


@dataclass(frozen=True, slots=True)
class ParameterOfJoint:
    """One parameter of a robot's estimate.

    Attributes:
        joint: place of its joint, or of the joint that carries its link.
        name: as the estimate calls it.
        value, std: None where it is refused.
        unit: SI, behind the gear.
        nominal: of the model and file that was begun with.
        formula: the sum of standard parameters that it stands for; its own name where it stands for itself.
        known: whether the record tells it.
        at_least: bound of a stiffness that is refused.
    """

    joint: int
    name: str
    value: float | None
    std: float | None
    unit: str
    nominal: float
    formula: str
    known: Told
    at_least: float | None = None


def parameters_by_joint(estimate: RobotEstimate | RobotTorqueEstimate) -> tuple[ParameterOfJoint, ...]:
    """Return the robot's parameters of an estimate, from the first joint to the last."""
    if isinstance(estimate, RobotEstimate):
        joints, nominal, formulas = _of_inverse_model(estimate)
    else:
        joints, nominal, formulas = _of_simulation(estimate)
    fixed = estimate.settings.fixed if isinstance(estimate, RobotEstimate) else {}
    found, of_record = [], set[str]()
    if isinstance(estimate, RobotTorqueEstimate):
        parameters = estimate.fit.parameters
        pairs = zip(parameters.names, parameters.places, strict=True)
        of_record = {name for name, place in pairs if place.is_of_record}
    for (name, row), joint, before, formula in zip(estimate.rows.items(), joints, nominal, formulas, strict=True):
        if name in of_record:
            continue
        value, std, least = row["value"], row["std"], row.get("at_least")
        number = value if isinstance(value, float) else None
        spread = std if isinstance(std, float) else None
        bound = least if isinstance(least, float) else None
        known = Told.REFUSED
        if name in fixed:
            known = Told.FIXED
        elif number is not None and spread is not None:
            share = spread / abs(number) if number else math.inf
            known = Told.TOLD if share < KNOWN else Told.ROUGHLY if share < _ROUGHLY else Told.NOT
        found.append(ParameterOfJoint(joint, name, number, spread, str(row["unit"]), before, formula, known, bound))
    return tuple(sorted(found, key=lambda one: one.joint))


def _of_inverse_model(estimate: RobotEstimate) -> tuple[list[int], list[float], list[str]]:
    n = len(estimate.robot)
    joints = [int(i) // 10 if i < 10 * n else int(i) - 10 * n for i in estimate.base.chosen]
    joints += [term.joint for term in friction_terms(estimate.robot)]
    formulas = [str(row["formula"]) for row in estimate.rows.values()]
    return joints, [float(one) for one in estimate.nominal], formulas


def _of_simulation(estimate: RobotTorqueEstimate) -> tuple[list[int], list[float], list[str]]:
    parameters = estimate.fit.parameters
    rotors = parameters.base.rotors
    joints = []
    for place in parameters.places:
        own = np.flatnonzero(rotors == place.row) if place.of is NumberOf.MASS else np.zeros(0)
        joints.append(int(own[0]) if own.size else place.row)
    nominal = parameters.group(RobotNumbers.of(estimate.robot))
    return joints, [float(one) for one in nominal], list(parameters.formulas(estimate.robot))
