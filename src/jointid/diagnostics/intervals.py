"""Intervals of an estimate by profiles of the criterion.

The intervals in an estimate's table come from the slopes of the criterion at one point. A profile follows the criterion
itself, which matters where it is not a parabola, as for a stiffness that is barely identifiable. It starts from an
estimate and its record.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from typing import TypeAlias

from jointid.common.arrays import FloatArray
from jointid.common.errors import MethodError
from jointid.common.parallel import in_threads
from jointid.estimation.problems.simulated import ClosedLoopProblem, torque_problem
from jointid.estimation.result.estimate import IN_WINDOWS, Estimate, fingerprint
from jointid.records.record import Record
from jointid.simulation.controller_torque import compute_controller_torque
from jointid.uncertainty.covariance import Influence
from jointid.uncertainty.identifiability import Combination
from jointid.uncertainty.position_dependent_error import uncertainty
from jointid.uncertainty.profile import ProfileInterval, profile, profile_compliance

Profiles: TypeAlias = tuple[ProfileInterval, ...]
"""What `intervals` returns."""


def intervals(
    estimate: Estimate,
    record: Record,
    quantities: Sequence[str] | None = None,
) -> Profiles:
    """Return profiles of an estimate by DIDIM, each on the side of the transmission that the estimate is on.

    Args:
        estimate: of the record.
        record: it came from.
        quantities: to profile: names of free parameters, "compliance" for 1/K12, or sums and differences of parameters,
            "motor_viscous + load_viscous". None means the stiffness, or the inertia of a rigid joint; where that is
            fixed, the first free parameter.

    Raises:
        MethodError: the estimate is not by DIDIM or lacks a parameter, a quantity is unknown, or the record is
            another one.
    """
    problem, x = rebuild_problem(estimate, record)
    residual, J = problem.linearise(x)
    names = [p.name for p in problem.free]
    spread = uncertainty(Influence(J, residual), problem.cells(problem.simulate(x))).covariance
    asked = list(quantities) if quantities is not None else ["stiffness"] if "stiffness" in names else names[:1]
    if "compliance" in asked and "stiffness" not in names:
        raise MethodError("A compliance is that of a flexible joint whose stiffness is free; this joint has none.")
    wanted = [None if name == "compliance" else _parse_combination(problem, name) for name in asked]

    def follow(one: Combination | None) -> ProfileInterval:
        if one is None:
            return profile_compliance(problem, x, spread, problem.joint.unit)
        return profile(problem, x, one, spread)

    return tuple(in_threads(follow, wanted))


def rebuild_problem(estimate: Estimate, record: Record) -> tuple[ClosedLoopProblem, FloatArray]:
    """Return the closed-loop problem that an estimate solved, and its free parameters.

    Raises:
        MethodError: the estimate is not by DIDIM or lacks a value, or the record is another one.
    """
    loop = estimate.settings.loop
    if loop is None:
        method = estimate.settings.method.upper()
        raise MethodError(f"Only DIDIM simulates a loop that can be followed; received an estimate by {method}.")
    estimate.require_values()
    if "motor_position" in estimate.data.channels and not record.computed:  # its torque was computed from that
        record = compute_controller_torque(record, loop)
    record.require(("torque",), "The estimate")
    if record.torque is not None and (fingerprint(record.torque.values),) != estimate.data.fingerprints:
        other = f"The estimate is from {estimate.data.record}, and {record.name} has another torque: give its record."
        raise MethodError(other if estimate.data.windows is None else IN_WINDOWS)
    values = {p.name: p.value or 0.0 for p in estimate.rows}
    problem = torque_problem(record, loop, estimate.settings.filtering, estimate.settings.joint.parameters)
    problem = problem.freeing(*(name for name in values if name not in problem.units))
    problem = problem.keeping({p.name: values[p.name] for p in estimate.rows if not p.free})
    return problem, problem.vector(values)


def _parse_combination(problem: ClosedLoopProblem, quantity: str) -> Combination:
    """Return the combination of parameters in a text such as ``a + b - c``."""
    weights = weights_of(quantity)
    free = {p.name: p for p in problem.free}
    units = {problem.units[name] for name in weights.keys() & free.keys()}
    if not weights.keys() <= free.keys() or len(units) > 1:
        raise MethodError(
            f'"{quantity}" is no quantity of this estimate; name a free parameter ({", ".join(free)}), the compliance, '
            "or a sum or difference of parameters in one unit."
        )
    signed = [("- " if weight < 0 else "+ ") + free[name].symbol for name, weight in weights.items()]
    return Combination(quantity, " ".join(signed).removeprefix("+ "), units.pop(), weights)


def weights_of(quantity: str) -> dict[str, float]:
    """Return the sign of each parameter in a text such as ``a + b - c``, by name."""
    first, *others = re.split(r"\s([+-])\s", quantity)  # a joint's name may have a hyphen: head-pan
    signed = [("-" if first.strip().startswith("-") else "+", first.strip().removeprefix("-"))]
    signed += zip(others[::2], others[1::2], strict=True)
    return {name.strip(): -1.0 if sign == "-" else 1.0 for sign, name in signed}
