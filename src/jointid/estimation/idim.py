"""IDIM: the inverse dynamic model regressed on measured positions.

Butterworth low-pass forwards and backwards on the positions, derivatives, borders dropped, the same
low-pass-and-decimate on torque and every column, ordinary least squares by QR [P section III; EMPS report]. A rigid
joint needs the motor's position, a flexible one the load's too: both rows of (2) are then stacked.

Torque and columns are seen through one window (`signals.windowed_torque`), so that a held, averaged or delayed torque
is compared with the motion it made. The published pipeline reads it as sampled and differentiates twice centrally.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from jointid.common.errors import MethodError, RecordError
from jointid.data.record import Channel, FloatArray, Injection, InjectionPoint, Record, Tap, Timing
from jointid.data.signals import (
    Filtering,
    decimate,
    derivative,
    differences,
    lowpass,
    windowed,
    windowed_torque,
)
from jointid.estimation.estimate import Estimate, EstimatedParameter, fingerprint, poor_fit, relative_error
from jointid.estimation.regression import Fit, least_squares
from jointid.estimation.uncertainty import Covariance, sandwich, words
from jointid.model.joints import Joint, Motion, require_units
from jointid.model.parameters import Parameter


@dataclass(frozen=True, slots=True)
class IDIM:
    """Settings of IDIM; all there is to choose is the `Filtering`."""


def idim_channels(model: str) -> tuple[str, ...]:
    """Return the channels that IDIM of a rigid or a flexible joint reads."""
    return ("torque", "motor_position", *(("load_position",) if model == "flexible" else ()))


@dataclass(frozen=True, slots=True, eq=False)
class InverseModel:
    """The torque of one motion, and the columns whose sum with the parameters it is, raw.

    Attributes:
        torque: (equations, samples): of the motor, and for a flexible joint 0 for the load.
        columns: (equations, samples, parameters) all of the joint's.
        inside: the samples that the position filter's ends do not reach.
        motor: the motor's motion, filtered.
    """

    torque: FloatArray
    columns: FloatArray
    inside: slice
    motor: Motion

    def decimated(self, filtering: Filtering, sample_time: float, values: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return torque less that of `values` (rows,), and columns (rows, parameters), filtered; equations stacked."""
        torque = self.torque - self.columns @ values
        both = np.concatenate([torque[..., np.newaxis], self.columns], axis=2)[:, self.inside]
        seen = np.concatenate([decimate(equation, filtering, sample_time) for equation in both])
        return seen[:, 0], seen[:, 1:]


def inverse_model(
    joint: Joint,
    torque: Channel,
    positions: tuple[FloatArray, ...],
    filtering: Filtering,
    delay: float = 0.0,
) -> InverseModel:
    """Return torque and regressor of a measured or reconstructed motion.

    Args:
        joint: whose columns.
        torque: on the motor.
        positions: (samples,) each, raw, at the torque's rate: motor, and load for a flexible joint.
        filtering: resolved.
        delay: seconds from the logged torque to the torque that acts.
    """
    assert filtering.position_cutoff is not None
    sample_time, size = torque.sample_time, torque.values.size
    respected = filtering.timing == "respected"
    motions = []
    for position in positions:
        smooth = lowpass(position, filtering.position_cutoff, sample_time)
        if respected:
            velocity, acceleration = differences(smooth, sample_time)
        else:
            velocity = derivative(smooth, sample_time)
            acceleration = derivative(velocity, sample_time)
        motions.append(Motion(smooth, velocity, acceleration))
    columns = joint.regressor(*motions)
    acting = torque.values
    if respected:
        columns = windowed(columns.transpose(1, 0, 2)).transpose(1, 0, 2)
        acting = windowed_torque(torque, delay)
    rows = np.zeros((len(columns), size))
    rows[0] = acting
    return InverseModel(rows, columns, slice(filtering.borders[0], size - filtering.borders[1]), motions[0])


def regress(
    parameters: tuple[Parameter, ...], model: InverseModel, filtering: Filtering, sample_time: float
) -> tuple[Fit, Covariance]:
    """Fit the free parameters to a motion; the fixed ones' torque is taken off first."""
    free = [i for i, p in enumerate(parameters) if p.free]
    if not free:
        raise MethodError("Every parameter of the joint is fixed, so there is nothing to identify; free one of them.")
    kept = np.array([0.0 if p.free else p.start or 0.0 for p in parameters])
    Y, W = model.decimated(filtering, sample_time, kept)
    W = W[:, free]
    fit = least_squares(W, Y, tuple(parameters[i].name for i in free))
    return fit, sandwich(W, W, fit.residual, equations=len(model.torque))


def motor_torque(record: Record) -> Channel:
    """Return the torque on the motor: the log, with what was injected after the limit where the log lacks it."""
    assert record.torque is not None
    torque, added = record.torque, record.injected
    if not isinstance(added, Injection) or added.at is InjectionPoint.BEFORE_LIMIT or added.in_torque:
        return torque
    if added.channel.sample_time != torque.sample_time:
        raise RecordError(
            "IDIM adds the injected signal to the logged torque, so both need one sample time; "
            f"they have {added.channel.sample_time:g} s and {torque.sample_time:g} s."
        )
    size = min(len(torque), len(added.channel))
    whole = torque.values[:size] + added.channel.values[:size]
    return Channel(whole, torque.unit, torque.sample_time, torque.timing, torque.source)


def motion_of(record: Record, delay: float, filtering: Filtering, joint: Joint) -> InverseModel:
    """Return torque and regressor of a record with the positions a joint needs; `filtering` resolved.

    Raises:
        RecordError: a channel is missing, not sampled, or at another rate.
    """
    needed = idim_channels(joint.model)
    require_units(record, joint)
    record.require(needed, "IDIM of a flexible joint" if joint.model == "flexible" else "IDIM")
    torque = motor_torque(record)
    positions = []
    for name in needed[1:]:
        position: Channel = getattr(record, name)
        if position.timing is not Timing.SAMPLED:
            raise RecordError(f"IDIM needs a sampled {name}; this one is {position.timing.value}.")
        if abs(position.sample_time / torque.sample_time - 1.0) > 1e-9:
            raise RecordError(
                f"IDIM needs torque and {name} at one rate; they have sample times of {torque.sample_time:g} s "
                f"and {position.sample_time:g} s. DIDIM needs no position."
            )
        positions.append(position.values[: len(torque)])
    size = min(len(torque), *(len(position) for position in positions))
    cut = Channel(torque.values[:size], torque.unit, torque.sample_time, torque.timing, torque.source)
    late = _late(record, delay, torque.sample_time)
    return inverse_model(joint, cut, tuple(position[:size] for position in positions), filtering, late)


def _late(record: Record, delay: float, period: float) -> float:
    """Return how long after its stamp a logged torque begins to act, in seconds.

    A measured torque is the one that acts; behind a delay of a broken number of periods it began within the period
    before the sample that shows it, and an average over that period is stamped at its end.
    """
    if record.tap is not Tap.MEASURED:
        return delay
    fraction = delay / period % 1.0
    averaged = record.torque is not None and record.torque.timing is Timing.AVERAGED
    return 0.0 if averaged or min(fraction, 1 - fraction) < 1e-6 else (fraction - 1.0) * period


def identify_idim(
    record: Record, joint: Joint, parameters: tuple[Parameter, ...], filtering: Filtering, delay: float = 0.0
) -> Estimate:
    """Identify a joint from torque and motor position, and load position where it is flexible.

    Args:
        record: with the channels, at one rate.
        joint: rigid or flexible.
        parameters: of the joint; free ones are estimated.
        filtering: how the signals are filtered.
        delay: seconds from the logged torque to the torque that acts.

    The standard deviations are those of the regression, robust to autocorrelation; noise in the positions, and what
    repeats with the motion, is not covered.

    Raises:
        RecordError: a channel is missing or cannot be used.
        MethodError: the record does not determine the parameters.
    """
    record.require(("torque",), "IDIM")
    assert record.torque is not None
    sample_time = record.torque.sample_time
    filtering = filtering.resolved(sample_time, joint.model)
    model = motion_of(record, delay, filtering, joint)
    fit, covariance = regress(parameters, model, filtering, sample_time)
    found = iter(zip(fit.values, covariance.std, strict=True))
    rows: list[EstimatedParameter] = []
    for p in parameters:
        value, std = next(found) if p.free else (p.start or 0.0, None)
        spread = None if std is None else float(std)
        rows.append(EstimatedParameter(p.name, p.symbol, joint.unit(p), float(value), spread, p.free, p.free))
    measured, predicted = model.torque[0], model.columns[0] @ np.array([row.value for row in rows])
    return Estimate(
        method="idim",
        variant="IDIM by ordinary least squares",
        joint=joint,
        loop=None,
        parameters=tuple(rows),
        channels=(*idim_channels(joint.model), *(("injected",) if record.injected is not None else ())),
        record=record.name,
        sample_time=sample_time,
        torque_unit=record.torque.unit,
        measured=measured,
        predicted=predicted,
        borders=filtering.borders,
        relative_error=relative_error(measured, predicted, filtering.borders),
        filtered_error=fit.relative_error,
        rows=fit.residual.size,
        conditioning=fit.conditioning,
        initial=None,
        filtering=filtering,
        trace=(),
        simulations=0,
        stop="a linear regression has one step",
        converged=True,
        intervals=f"of the regression, {words(covariance)}",
        warnings=_warnings(record, filtering, fit),
        fingerprint=fingerprint(record.torque.values),
        delay=delay,
        correlation=covariance.correlation,
    )


def _warnings(record: Record, filtering: Filtering, fit: Fit) -> tuple[str, ...]:
    assert record.torque is not None
    found = list(filtering.warnings(record.torque.sample_time))
    if filtering.timing == "as_sampled" and record.torque.timing is not Timing.SAMPLED:
        found.append(
            f"the torque is {record.torque.timing.value} but read as sampled, half a period early, as the published "
            'results were; timing = "respected" is right'
        )
    return (*found, *poor_fit(fit.relative_error))
