"""Parameters of a robot's estimate by joint, with formulas and significance.

A record determines a parameter if its deviation is below a tenth of it, roughly if it is below the value itself. Else
the parameter is not distinguished from 0. A refused stiffness has its bound. A fixed parameter is not estimated from
the record.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from enum import StrEnum

from jointid.estimation.result.parts import EstimateParts
from jointid.estimation.result.robot import KNOWN

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
        name, symbol: as the estimate calls it.
        value, std: None where it is refused.
        unit: SI, behind the gear.
        nominal: of the initial model and file.
        formula: the sum of standard parameters that it stands for; its own symbol where it stands for itself.
        known: whether the record tells it.
        at_least: bound of a stiffness that is refused.
    """

    joint: int
    name: str
    symbol: str
    value: float | None
    std: float | None
    unit: str
    nominal: float
    formula: str
    known: Told
    at_least: float | None = None


def parameters_by_joint(estimate: EstimateParts) -> tuple[ParameterOfJoint, ...]:
    """Return the robot's parameters of an estimate, from the first joint to the last."""
    part, found = estimate.require_robot(), []
    joints = {name: k for k, name in enumerate(part.model.names)}
    for row, nominal, formula in zip(estimate.params.rows, part.nominal, part.formulas, strict=True):
        if not row.of_joint:
            continue
        known, std = Told.REFUSED, 0.0 if not row.free else row.stderr
        if not row.free:
            known = Told.FIXED
        elif row.value is not None and std is not None:
            share = std / abs(row.value) if row.value else math.inf
            known = Told.TOLD if share < KNOWN else Told.ROUGHLY if share < _ROUGHLY else Told.NOT
        found.append(
            ParameterOfJoint(
                joints[row.axis],
                row.name,
                row.symbol,
                row.value,
                std,
                row.unit,
                float(nominal),
                formula,
                known,
                row.lower_bound,
            )
        )
    return tuple(sorted(found, key=lambda one: one.joint))
