"""Identification from one record: the method is chosen, and parameters beyond their bounds are held there."""

from __future__ import annotations

from collections.abc import Mapping

from jointid.common.errors import MethodError
from jointid.common.progress import Progress, silent
from jointid.estimation.methods.cross_axis import record_warnings
from jointid.estimation.methods.registry import Method, default_method, method_of
from jointid.estimation.result.estimate import Estimate
from jointid.models.joints import Joint
from jointid.models.parameters import Parameter, Quantity, adjusted
from jointid.records.checks import check_record, find_record_warnings
from jointid.records.record import Record
from jointid.records.signals.filtering import Filtering
from jointid.simulation.drive_side import DriveSide
from jointid.simulation.loop_input import ClosedLoop
from jointid.simulation.open_loop import OpenLoop


def identify_record(
    record: Record,
    model: ClosedLoop | DriveSide | OpenLoop | Joint,
    method: Method | None = None,
    *,
    filtering: Filtering | None = None,
    parameters: Mapping[str, Parameter] | None = None,
    progress: Progress = silent,
) -> Estimate:
    """Return the estimate from one record; see `jointid.identify`.

    A parameter that comes out beyond its bounds is kept at the bound, with a warning, and the others identified anew.
    """
    loop = model if isinstance(model, ClosedLoop) else None
    joint = model.joint if isinstance(model, ClosedLoop | DriveSide | OpenLoop) else model
    chosen = method or default_method(model, joint.model)()
    wanted = adjusted(joint.parameters, parameters or {})
    check_record(record)
    _require_fit(chosen, joint, loop)
    bounds: list[str] = []
    simulations = 0
    while True:
        estimate = chosen.identify(record, joint, loop, wanted, filtering or Filtering(), progress)
        simulations += estimate.fit.simulations
        p = _find_beyond(record, estimate, wanted)
        if p is None:
            break
        value = estimate.values[p.name]
        bounds.append(f"{p.name} is at its bound: without it, it would be {value:.4g} {joint.unit(p)}")
        progress(bounds[-1])
        held = p.fixed(p.lower if value < p.lower else p.upper)
        wanted = tuple(held if q.name == p.name else q for q in wanted)
    warnings = (*bounds, *estimate.checks.warnings, *record_warnings(record, estimate))
    return estimate.amended(
        fit={"simulations": simulations}, checks={"warnings": warnings}, data={"resampled": record.resampled}
    )


def _require_fit(method: Method, joint: Joint, loop: ClosedLoop | None) -> None:
    """Refuse a method that is not for this joint, or needs a controller where none is known."""
    if method.needs_controller and loop is None:
        raise MethodError(
            f"{method.title} simulates the closed loop, so it needs the controller; give a ClosedLoop, or use IDIM "
            "with a motor_position."
        )
    if joint.model not in method.models:
        other = method_of(method.name, joint.model)
        remedy = other if joint.model in other.models else default_method(loop or joint, joint.model)
        raise MethodError(f"{type(method).__name__} is not for a {joint.model} joint; use {remedy.__name__}.")


def _find_beyond(record: Record, estimate: Estimate, wanted: tuple[Parameter, ...]) -> Parameter | None:
    """Return the free parameter that is farthest beyond its bounds, in its own deviations.

    Raises:
        MethodError: an inertia is not positive, for which no bound is a remedy.
    """
    values = estimate.values

    def excess(p: Parameter) -> float:
        value = values[p.name]
        return max(p.lower - value, value - p.upper) / (estimate[p.name].stderr or abs(value) or 1.0)

    found = [p for p in wanted if p.free and p.name in values]
    for p in found:
        if p.quantity is Quantity.INERTIA and values[p.name] <= 0:
            known = "".join(f"; {note}" for note in find_record_warnings(record, estimate.data.channels))
            raise MethodError(
                f"The record gives {p.name} = {values[p.name]:.4g}, which no joint has: the torque or the motion has "
                f"the wrong sign (set sign = -1), or they do not belong together{known}."
            )
    return max((p for p in found if not p.lower <= values[p.name] <= p.upper), key=excess, default=None)
