"""Identification from one record: choice of the method, bounds of parameters, warnings of the record."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

from jointid.common.errors import MethodError
from jointid.common.messages import Progress, ignore_progress
from jointid.common.parameters import Parameter, Quantity, adjust_parameters
from jointid.estimation.methods.registry import Method, Task, default_method
from jointid.estimation.record_warnings import record_warnings
from jointid.estimation.result.assemble import FitResult
from jointid.models.joints import ClosedLoop, Joint
from jointid.records.checks import check_record, find_encoder_lag, find_record_warnings
from jointid.records.record import Record
from jointid.records.signals.filtering import Filtering
from jointid.simulation.prescribed import DriveSide


def identify_record(
    record: Record,
    model: ClosedLoop | DriveSide | Joint,
    method: Method | None = None,
    *,
    filtering: Filtering | None = None,
    parameters: Mapping[str, Parameter] | None = None,
    progress: Progress = ignore_progress,
) -> FitResult:
    """Return the fit of a joint to one record; see `jointid.identify`.

    A parameter outside its bounds is fixed at the bound, with a warning, and the others are identified again.
    """
    loop = model if isinstance(model, ClosedLoop) else None
    joint = model.joint if isinstance(model, ClosedLoop | DriveSide) else model
    chosen = method or default_method(model)()
    wanted = adjust_parameters(joint.parameters, parameters or {})
    check_record(record)
    _require_fit(chosen, joint, loop)
    bounds: dict[str, float] = {}
    excess: list[str] = []
    earlier = 0
    while True:
        fit = chosen.identify(Task(record, joint, loop, wanted, filtering or Filtering(), progress))
        p = _find_beyond(record, fit, wanted)
        if p is None:
            break
        earlier += fit.simulations
        value = fit.values[p.name]
        excess.append(f"{p.name} is at its bound: without it, it would be {value:.4g} {joint.unit(p)}")
        progress(excess[-1])
        bounds[p.name] = p.lower if value < p.lower else p.upper
        wanted = tuple(p.fix(bounds[p.name]) if q.name == p.name else q for q in wanted)
    both_encoders = {"motor_position", "load_position"} <= set(fit.data.channels)
    return replace(
        fit,
        record=record,
        at_bounds=bounds,
        before=tuple(excess),
        after=record_warnings(record, fit),
        encoder_lag=find_encoder_lag(record) if both_encoders else None,
        earlier=earlier,
    )


def _require_fit(method: Method, joint: Joint, loop: ClosedLoop | None) -> None:
    """Refuse a method that does not fit the joint or lacks its controller."""
    if method.needs_controller and loop is None:
        raise MethodError(
            f"{method.title} simulates the closed loop, so it needs the controller; give a ClosedLoop, or use IDIM "
            "with a motor_position."
        )
    method.require_settings_of(joint.model)
    if not method.any_law:
        joint.require_linear(f"{method.title} takes")
    if method.name == "drive_side":
        DriveSide(joint)  # which says what it does not take


def _find_beyond(record: Record, fit: FitResult, wanted: tuple[Parameter, ...]) -> Parameter | None:
    """Return the free parameter that violates its bounds most, in standard deviations.

    Raises:
        MethodError: an inertia is not positive, for which no bound is a remedy.
    """
    values = fit.values

    def excess(p: Parameter) -> float:
        value = values[p.name]
        return max(p.lower - value, value - p.upper) / (fit[p.name].stderr or abs(value) or 1.0)

    found = [p for p in wanted if p.free and p.name in values]
    for p in found:
        if p.quantity is Quantity.INERTIA and values[p.name] <= 0:
            known = "".join(f"; {note}" for note in find_record_warnings(record, fit.data.channels))
            raise MethodError(
                f"The record gives {p.name} = {values[p.name]:.4g}, which no joint has: the torque or the motion has "
                f"the wrong sign (set record.channels.torque.sign = -1), or they do not belong together{known}."
            )
    return max((p for p in found if not p.lower <= values[p.name] <= p.upper), key=excess, default=None)
