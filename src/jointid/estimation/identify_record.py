"""Identification from one record: the method is chosen, parameters beyond their bounds held, the record warned of."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from jointid.common.arrays import FloatArray
from jointid.common.errors import MethodError
from jointid.common.messages import Progress, silent
from jointid.common.parameters import Parameter, Quantity, adjusted
from jointid.estimation.methods.registry import Method, Task, default_method, method_of
from jointid.estimation.result.estimate import Estimate
from jointid.models.joints import ClosedLoop, Joint
from jointid.records.checks import EncoderLag, check_record, find_encoder_lag, find_record_warnings
from jointid.records.record import Record
from jointid.records.signals.filtering import Filtering, differentiate_twice, lowpass
from jointid.simulation.prescribed import DriveSide, OpenLoop
from jointid.uncertainty.residual_tests import coupling
from jointid.uncertainty.verdict import Subject, bounds_verdict


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
    bounds: dict[str, float] = {}
    beyond: list[str] = []
    simulations = 0
    while True:
        estimate = chosen.identify(Task(record, joint, loop, wanted, filtering or Filtering(), progress))
        simulations += estimate.fit.simulations
        p = _find_beyond(record, estimate, wanted)
        if p is None:
            break
        value = estimate.values[p.name]
        beyond.append(f"{p.name} is at its bound: without it, it would be {value:.4g} {joint.unit(p)}")
        progress(beyond[-1])
        bounds[p.name] = p.lower if value < p.lower else p.upper
        wanted = tuple(p.fixed(bounds[p.name]) if q.name == p.name else q for q in wanted)
    warnings = (*beyond, *estimate.checks.warnings, *record_warnings(record, estimate))
    return _held(estimate, bounds).amended(
        fit={"simulations": simulations},
        checks={"warnings": warnings, "encoder_lag": _encoder_lag(record, estimate)},
        data={"resampled": record.resampled},
    )


def _held(estimate: Estimate, bounds: Mapping[str, float]) -> Estimate:
    """Return an estimate that says which parameters were kept at their bounds while the others were identified."""
    rows = tuple(replace(p, at_bound=bounds[p.name]) if p.name in bounds else p for p in estimate.params)
    names = tuple(p.name for p in rows if p.at_bound is not None)
    verdicts = tuple(bounds_verdict(names) if v.subject is Subject.BOUNDS else v for v in estimate.checks.verdicts)
    return estimate.amended(params={"rows": rows}, checks={"verdicts": verdicts})


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
    if not method.any_law:
        joint.require_linear(f"{method.title} takes")
    if method.name == "drive_side":
        DriveSide(joint)  # which says what it does not take


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


# What an answer says of its record: what logging did to it, and other axes that moved, with how much follows them

_FEWEST = 4  # rows to a column of the regression


def _encoder_lag(record: Record, estimate: Estimate) -> EncoderLag | None:
    """Return the lag that hides the spring of an estimate from both encoders, if there is one."""
    both = {"motor_position", "load_position"} <= set(estimate.data.channels)
    return find_encoder_lag(record) if both else None


def record_warnings(record: Record, estimate: Estimate) -> tuple[str, ...]:
    """Return what a reader of an estimate must know of its record, one sentence each."""
    return (*find_record_warnings(record, estimate.data.channels), *coupling_warnings(record, estimate))


def coupling_warnings(record: Record, estimate: Estimate) -> tuple[str, ...]:
    """Return that other axes moved too, and how much of what the model leaves follows them; nothing without any.

    Inertia shared with another axis shows as its acceleration, gravity as its position. What an axis of few harmonics
    explains by chance is much, so it stands beside. A joint's own columns have taken their part already: a share that
    is small, or no more than by chance, does not say that there is no coupling.
    """
    if not record.other_axes:
        return ()
    said = (
        f"other axes moved too ({', '.join(record.other_axes)}), and their coupling (inertia, Coriolis, gravity) is "
        "not in the model of a single joint: the parameters are those of this motion and these poses"
    )
    motion = None if estimate.fit.compared == "position" else _residual_and_motion(record, estimate)
    if motion is None:
        return (said,)
    found = coupling(*motion)
    share = f"{100 * found.explained:.0f} % of what it leaves follows their accelerations and positions"
    chance = f"up to {100 * found.by_chance:.0f} % would by chance"
    return (f"{said}; {share}, {chance}{'' if found.seen else ', so this record cannot tell how much is theirs'}",)


def _residual_and_motion(record: Record, estimate: Estimate) -> tuple[FloatArray, FloatArray] | None:
    """Return what the model leaves, (rows,), and what the other axes did, (rows, columns); None of too few rows."""
    filtering, T = estimate.settings.filtering, estimate.data.sample_time
    residual = estimate.fit.measured - estimate.fit.predicted
    at = np.arange(residual.size) * T
    cutoff = filtering.position_cutoff
    assert cutoff is not None
    columns = []
    for channel in record.other_axes.values():
        position = lowpass(np.interp(at, channel.time, channel.values), cutoff, T)
        columns += [differentiate_twice(position, T)[1], position]
    first, last = estimate.fit.borders
    inside = slice(first, residual.size - last)
    both = np.column_stack([residual, *columns])[inside]
    rows = filtering.decimate(both, T)
    return (rows[:, 0], rows[:, 1:]) if len(rows) > _FEWEST * len(columns) else None
