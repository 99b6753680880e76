"""IDIM: the inverse dynamic model regressed on measured positions.

Butterworth low-pass forwards and backwards on the position, central differences twice, borders dropped, the same
low-pass-and-decimate on torque and every column, ordinary least squares by QR [P section III; EMPS report].
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from jointid.common.errors import MethodError, RecordError
from jointid.data.record import FloatArray, Injection, InjectionPoint, Record, Tap, Timing
from jointid.data.signals import Filtering, centred, decimate, derivative, lowpass
from jointid.estimation.estimate import Estimate, EstimatedParameter, fingerprint, relative_error
from jointid.estimation.regression import Fit, least_squares
from jointid.model.joints import Joint, RigidJoint
from jointid.model.parameters import Parameter


@dataclass(frozen=True, slots=True)
class IDIM:
    """Settings of IDIM; all there is to choose is the `Filtering`."""

    name = "idim"
    channels = ("torque", "motor_position")


@dataclass(frozen=True, slots=True, eq=False)
class InverseModel:
    """The torque of one motion, and the columns whose sum with the parameters it is, raw.

    Attributes:
        torque: (samples,) at the positions' instants.
        columns: (samples, parameters) all of the joint's.
        inside: the samples that the position filter's ends do not reach.
    """

    torque: FloatArray
    columns: FloatArray
    inside: slice


def inverse_model(
    joint: RigidJoint, torque: FloatArray, position: FloatArray, filtering: Filtering, sample_time: float
) -> InverseModel:
    """Return torque and regressor of a measured or reconstructed motion.

    Args:
        joint: whose columns.
        torque: (samples,) at the positions' instants (see `signals.centred`).
        position: (samples,) motor side, raw.
        filtering: resolved.
        sample_time: of both, seconds.
    """
    assert filtering.position_cutoff is not None
    smooth = lowpass(position, filtering.position_cutoff, sample_time)
    velocity = derivative(smooth, sample_time)
    columns = joint.regressor(velocity, derivative(velocity, sample_time))
    inside = slice(filtering.borders[0], torque.size - filtering.borders[1])
    return InverseModel(torque, columns, inside)


def regress(
    joint: RigidJoint,
    parameters: tuple[Parameter, ...],
    model: InverseModel,
    filtering: Filtering,
    sample_time: float,
) -> Fit:
    """Fit the free parameters to a motion; the fixed ones' torque is taken off first."""
    free = [i for i, p in enumerate(parameters) if p.free]
    if not free:
        raise MethodError("Every parameter of the joint is fixed, so there is nothing to identify; free one of them.")
    torque, columns = model.torque[model.inside], model.columns[model.inside]
    kept = columns @ np.array([0.0 if p.free else p.start or 0.0 for p in parameters])
    both = decimate(np.column_stack([torque - kept, columns[:, free]]), filtering, sample_time)
    return least_squares(both[:, 1:], both[:, 0], tuple(parameters[i].name for i in free))


def motor_torque(record: Record, delay: float, timing: str) -> FloatArray:
    """Return the torque that acted on the motor at the positions' instants, (samples,).

    What was injected after the limit and is not in the log is added; a log ahead of the motor is delayed.
    """
    assert record.torque is not None
    delay = 0.0 if record.tap is Tap.MEASURED else delay
    as_sampled = timing == "as_sampled"
    torque = record.torque.values if as_sampled else centred(record.torque, delay)
    missing = record.injected
    if isinstance(missing, Injection) and missing.at is InjectionPoint.AFTER_LIMIT and not missing.in_torque:
        if missing.channel.sample_time != record.torque.sample_time:
            raise RecordError(
                "IDIM adds the injected signal to the logged torque, so both need one sample time; "
                f"they have {missing.channel.sample_time:g} s and {record.torque.sample_time:g} s."
            )
        torque = torque + (missing.channel.values if as_sampled else centred(missing.channel, delay))
    return torque


def motion_of(record: Record, delay: float, filtering: Filtering, joint: RigidJoint) -> InverseModel:
    """Return torque and regressor of a record with a motor position; `filtering` resolved.

    Raises:
        RecordError: a channel is missing, not sampled, or at another rate.
    """
    record.require(IDIM.channels, "IDIM")
    assert record.torque is not None
    assert record.motor_position is not None
    position, torque = record.motor_position, record.torque
    if position.timing is not Timing.SAMPLED:
        raise RecordError(f"IDIM needs a sampled motor_position; this one is {position.timing.value}.")
    if abs(position.sample_time / torque.sample_time - 1.0) > 1e-9:
        raise RecordError(
            f"IDIM needs torque and motor_position at one rate; they have sample times of {torque.sample_time:g} s "
            f"and {position.sample_time:g} s. DIDIM needs no motor_position."
        )
    acting = motor_torque(record, delay, filtering.timing)
    return inverse_model(joint, acting, position.values, filtering, torque.sample_time)


def identify_idim(
    record: Record, joint: Joint, parameters: tuple[Parameter, ...], filtering: Filtering, delay: float = 0.0
) -> Estimate:
    """Identify a rigid joint from torque and motor position.

    Args:
        record: with torque and motor_position, at one rate.
        joint: rigid.
        parameters: of the joint; free ones are estimated.
        filtering: how the signals are filtered.
        delay: seconds from the logged torque to the torque that acts.

    The standard deviations are those of the regression, for a white residual; on real records they are too small.

    Raises:
        RecordError: a channel is missing or cannot be used.
        MethodError: the joint is flexible, or the record does not determine the parameters.
    """
    if not isinstance(joint, RigidJoint):
        raise MethodError(
            "IDIM of a flexible joint is not part of this version; identify it as rigid, with a cut-off below a "
            "fifth of its first mode."
        )
    record.require(IDIM.channels, "IDIM")
    assert record.torque is not None
    sample_time = record.torque.sample_time
    filtering = filtering.resolved(sample_time)
    model = motion_of(record, delay, filtering, joint)
    fit = regress(joint, parameters, model, filtering, sample_time)
    found = iter(zip(fit.values, fit.std, strict=True))
    rows: list[EstimatedParameter] = []
    for p in parameters:
        value, std = next(found) if p.free else (p.start or 0.0, None)
        spread = None if std is None else float(std)
        rows.append(EstimatedParameter(p.name, p.symbol, joint.unit(p), float(value), spread, p.free, p.free))
    predicted = model.columns @ np.array([row.value for row in rows])
    used = ("torque", "motor_position", *(("injected",) if record.injected is not None else ()))
    return Estimate(
        method="idim",
        variant="IDIM by ordinary least squares",
        joint=joint,
        loop=None,
        parameters=tuple(rows),
        channels=used,
        record=record.name,
        sample_time=sample_time,
        torque_unit=record.torque.unit,
        measured=model.torque,
        predicted=predicted,
        borders=filtering.borders,
        relative_error=relative_error(model.torque, predicted, filtering.borders),
        filtered_error=fit.relative_error,
        rows=fit.residual.size,
        conditioning=fit.conditioning,
        initial=None,
        filtering=filtering,
        trace=(),
        simulations=0,
        stop="a linear regression has one step",
        converged=True,
        intervals="of the regression, for a white residual; a real one repeats with position, and they are too small",
        warnings=_warnings(record, filtering),
        fingerprint=fingerprint(record.torque.values),
        delay=delay,
    )


def _warnings(record: Record, filtering: Filtering) -> tuple[str, ...]:
    assert record.torque is not None
    if filtering.timing == "as_sampled" and record.torque.timing is not Timing.SAMPLED:
        return (
            f"the torque is {record.torque.timing.value} but read as sampled, half a period early, as the published "
            'results were; timing = "respected" is right',
        )
    return ()
