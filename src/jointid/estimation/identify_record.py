"""Identification from one record: choice of the method, bounds of parameters, warnings of the record."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

from jointid.common.errors import MethodError
from jointid.common.messages import Progress, ignore_progress
from jointid.common.parameters import Parameter, Quantity
from jointid.estimation.methods.registry import Method, Task, default_method
from jointid.estimation.problems.base import adjust_parameters
from jointid.estimation.result.estimate import Estimate
from jointid.models.joints import ClosedLoop, Joint
from jointid.records.checks import check_record, find_encoder_lag, find_record_warnings
from jointid.records.record import Record
from jointid.records.signals.filtering import Filtering
from jointid.simulation.drive_side import DriveSide


def identify_record(
    record: Record,
    model: ClosedLoop | DriveSide | Joint,
    method: Method | None = None,
    filtering: Filtering | None = None,
    parameters: Mapping[str, Parameter] | None = None,
    progress: Progress = ignore_progress,
) -> Estimate:
    """Return the fit of a joint to one record; see `jointid.identify`.

    Raises:
        MethodError: the method does not fit the model, or an inertia is not positive.
    """
    loop = model if isinstance(model, ClosedLoop) else None
    joint = model.joint if isinstance(model, ClosedLoop | DriveSide) else model
    chosen = method or default_method(model)()
    wanted = adjust_parameters(joint.parameters, parameters or {})
    check_record(record)
    _require_fit(chosen, joint, loop)
    fit = chosen.identify(Task(record, joint, loop, wanted, filtering or Filtering(), progress))
    said = find_record_warnings(record, fit.data.channels)
    for p in wanted:
        if p.quantity is Quantity.INERTIA and p.free and fit.values.get(p.name, 1.0) <= 0:
            raise MethodError(
                f"The record gives {p.name} = {fit.values[p.name]:.4g}, which no joint has: the torque or the motion "
                "has the wrong sign (turn record.channels.torque.sign round), or they do not belong together"
                f"{''.join(f'; {note}' for note in said)}."
            )
    if {"motor_position", "load_position"} <= set(fit.data.channels):
        fit = replace(fit, checks=replace(fit.checks, encoder_lag=find_encoder_lag(record)))
    return replace(fit, record=record).warn(*said)


def _require_fit(method: Method, joint: Joint, loop: ClosedLoop | None) -> None:
    """Refuse a method that does not fit the joint or lacks its controller."""
    if method.needs_controller and loop is None:
        raise MethodError(
            f"{method.title} simulates the closed loop, so it needs the controller; give a ClosedLoop, or use IDIM "
            "with a motor_position."
        )
    method.require_settings_of(joint.model)
    if not method.needs_controller:
        joint.require_linear(f"{method.title} takes")
    if method.name == "drive_side":
        DriveSide(joint)  # which says what it does not take
