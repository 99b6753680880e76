"""Parameters of an estimate by axis, with formulas and significance.

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

_ROUGHLY = 0.5  # relative deviation, from which the interval of two holds 0


class Told(StrEnum):
    """How well a record tells a parameter."""

    TOLD = "told"
    ROUGHLY = "roughly"
    NOT = "not significant"
    REFUSED = "refused"
    FIXED = "fixed"


@dataclass(frozen=True, slots=True)
class AxisParameter:
    """One parameter of an estimate.

    Attributes:
        axis: place of its joint, or of the joint that carries its link.
        name, symbol: as the estimate calls it.
        value, std: None where it is refused.
        unit: SI, behind the gear.
        nominal: of a robot's initial model and file; None of a single joint.
        formula: the sum of standard parameters that it stands for; its own symbol where it stands for itself.
        known: whether the record tells it.
        at_least: bound of a stiffness that is refused.
    """

    axis: int
    name: str
    symbol: str
    value: float | None
    std: float | None
    unit: str
    nominal: float | None
    formula: str
    known: Told
    at_least: float | None = None


def parameters_by_axis(estimate: EstimateParts) -> tuple[AxisParameter, ...]:
    """Return the parameters of an estimate, from the first axis to the last."""
    part, found = estimate.robot, []
    rows = estimate.params.rows
    axes = {"": 0} if part is None else {name: k for k, name in enumerate(part.model.names)}
    nominals = [None] * len(rows) if part is None else part.nominal.tolist()
    formulas = [row.name for row in rows] if part is None else part.formulas
    for row, nominal, formula in zip(rows, nominals, formulas, strict=True):
        if not row.of_joint:
            continue
        known, std = Told.REFUSED, 0.0 if not row.free else row.stderr
        if not row.free:
            known = Told.FIXED
        elif row.value is not None and std is not None:
            share = std / abs(row.value) if row.value else math.inf
            known = Told.TOLD if share < KNOWN else Told.ROUGHLY if share < _ROUGHLY else Told.NOT
        found.append(
            AxisParameter(
                axes[row.axis], row.name, row.symbol, row.value, std, row.unit, nominal, formula, known, row.lower_bound
            )
        )
    return tuple(sorted(found, key=lambda one: one.axis))
