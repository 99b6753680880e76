"""Collect the results that a report on one estimate presents; a report computes nothing itself.

A part that does not exist for an estimate (profiles without a simulated loop, a response without a stiffness) is left
out, with the reason. Two parts are computed here: the spectra of the torque, measured, predicted and their difference;
and the frequency response of the joint, from the motor's torque to the velocities of its two sides. That is of the
linear part (`models.linear`), moving forwards; its band is that of the estimate's covariance to first order, of the
logarithm of the response, so that it never passes 0.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from jointid.common.arrays import FloatArray
from jointid.common.errors import JointidError, MethodError, RecordError
from jointid.common.messages import Progress, follow, ignore_progress
from jointid.common.parameters import POSITION_UNIT
from jointid.diagnostics.diagnosis import Diagnosis
from jointid.diagnostics.intervals import Intervals, intervals
from jointid.diagnostics.validation import Validation, validate
from jointid.estimation.result.estimate import Estimate
from jointid.models.linear import OUTPUTS, ComplexArray, frequency_response
from jointid.records.record import Channel, Record
from jointid.uncertainty.profile import ProfileInterval

_PARTS = 8  # of the record, each as long as a window of the spectra; windows overlap by half
_LONGEST = 8192  # samples of a window: a finer resolution adds nothing for a joint
_SHORTEST = 64
_LINES = 400  # of the response
_LOWEST = 0.1  # Hz
_ABOVE = 3.0  # times the fastest of the three frequencies, at least
_STEP = 1e-6  # of a parameter, or of its deviation where it is 0


@dataclass(frozen=True, slots=True, eq=False)
class Spectra:
    """One-sided amplitude spectral densities, averaged over windows (Welch 1967).

    Attributes:
        frequency: (lines,) Hz, 0 left out.
        measured, predicted, error: (lines,) in the signal's unit per square root of Hz.
    """

    frequency: FloatArray
    measured: FloatArray
    predicted: FloatArray
    error: FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class Curve:
    """One response with its band.

    Attributes:
        side: "motor" or "load".
        magnitude: (lines,) of the velocity per torque.
        low, high: (lines,) 2 standard deviations about it.
        phase: (lines,) degrees.
    """

    side: str
    magnitude: FloatArray
    low: FloatArray
    high: FloatArray
    phase: FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class FrequencyResponse:
    """Frequency response of an identified joint.

    Attributes:
        frequency: (lines,) Hz.
        curves: of the motor, and for a flexible joint of the load.
        unit: of the magnitude.
        modes: Hz by name, of a flexible joint; see `FlexibleJoint.frequencies`.
    """

    frequency: FloatArray
    curves: tuple[Curve, ...]
    unit: str
    modes: Mapping[str, float]


@dataclass(frozen=True, slots=True, eq=False)
class ReportData:
    """An estimate and the results of its diagnostics.

    Attributes:
        estimate: what is reported.
        diagnosis: of loop, log and residual; None where there is none.
        validation: the direct test of a joint; None where there is none, as the next one.
        response: of the joint.
        channels: of the record, by name.
        profiles: of single quantities.
        checks: of the same estimate on other records.
        absent: reason why a part is missing, by its name, in a sentence.
    """

    estimate: Estimate
    diagnosis: Diagnosis | None
    validation: Validation | None = None
    response: FrequencyResponse | None = None
    channels: Mapping[str, Channel] = field(default_factory=dict)
    profiles: tuple[ProfileInterval, ...] = ()
    checks: tuple[Validation, ...] = ()
    absent: Mapping[str, str] = field(default_factory=dict)


def collect_report_data(
    estimate: Estimate,
    record: Record,
    checks: Sequence[Validation] = (),
    *,
    profiles: Sequence[str] | None = None,
    progress: Progress = ignore_progress,
) -> ReportData:
    """Collect the results that a report on an estimate presents; see `Report.of`."""
    flexible = any(p.name == "stiffness" and p.free for p in estimate.params.rows)
    asked = (["stiffness", "compliance"] if flexible else []) if profiles is None else profiles
    parts: dict[str, Callable[[], Any]] = {
        "validation": lambda: validate(estimate, record),
        "response": lambda: compute_response(estimate),
        "profiles": lambda: intervals(estimate, record, asked, progress=progress),
    }
    found, absent = dict.fromkeys(parts), dict[str, str]()
    for name, compute in follow(parts.items(), progress, "collecting the report", len(parts), "parts"):
        try:
            found[name] = compute()
        except JointidError as error:
            absent[name] = str(error)
    check, followed = estimate.checks.diagnosis, found.pop("profiles") or Intervals(())
    return ReportData(
        estimate, check if isinstance(check, Diagnosis) else None, **found, channels=dict(record.items()),
        profiles=followed.profiles, checks=tuple(checks), absent=absent,
    )  # fmt: skip


def estimate_spectra(measured: FloatArray, predicted: FloatArray, sample_time: float) -> Spectra:
    """Return the spectra of a measured and a predicted signal, and of their difference.

    Args:
        measured: (samples,).
        predicted: (samples,) at the same instants.
        sample_time: seconds.

    Raises:
        RecordError: the signals are too short for a spectrum, or are not of one length.
    """
    from scipy.signal import welch

    if measured.shape != predicted.shape or measured.size < 2 * _SHORTEST:
        raise RecordError(
            f"Spectra need two signals of one length, {2 * _SHORTEST} samples or more; received {measured.size} and "
            f"{predicted.size}: use a longer record."
        )
    wanted = min(max(measured.size // _PARTS, _SHORTEST), _LONGEST)
    window = 1 << (wanted.bit_length() - 1)
    densities = []
    for signal in (measured, predicted, measured - predicted):
        frequency, power = welch(signal, 1.0 / sample_time, nperseg=window, detrend="constant")
        densities.append(np.sqrt(power[1:]))
    measured_, predicted_, error = densities
    return Spectra(frequency[1:], measured_, predicted_, error)


def compute_response(estimate: Estimate) -> FrequencyResponse:
    """Return the frequency response of an estimate, with the band of its covariance.

    Raises:
        MethodError: a parameter of the joint is not identifiable.
    """
    joint, values = estimate.settings.joint, estimate.values
    missing = [p.symbol for p in joint.parameters if p.name not in values]
    if missing:
        raise MethodError(f"A frequency response needs every parameter, and {', '.join(missing)} is not identifiable.")
    flexible = joint.model == "flexible"
    modes = estimate.frequencies
    highest = max(0.5 / estimate.data.sample_time, _ABOVE * max(modes.values(), default=0.0))
    grid = np.geomspace(_LOWEST, highest, _LINES)
    frequency = np.unique(np.concatenate([grid, [f for f in modes.values() if f > _LOWEST]]))
    free = [p for p in estimate.params.rows if p.free and p.of_joint and p.stderr is not None and p.name in values]
    std = np.array([p.stderr for p in free], dtype=np.float64)
    covariance = np.outer(std, std) * estimate.params.correlation_of([p.name for p in free])
    outputs = OUTPUTS[1 : len(OUTPUTS) if flexible else 2 : 2]  # the velocities of the motor and of a flexible load

    def respond(values: Mapping[str, float]) -> list[ComplexArray]:
        return [frequency_response(joint, values, frequency, output) for output in outputs]

    at = respond(values)
    slopes = []
    for p in free:
        step = _STEP * (abs(p.value or 0.0) or p.stderr or 1.0)
        moved = respond(values | {p.name: values[p.name] + step})
        slopes.append([np.log(after / before).real / step for after, before in zip(moved, at, strict=True)])
    curves = []
    for i, (side, H) in enumerate(zip(("motor", "load"), at, strict=False)):
        J = np.array([slope[i] for slope in slopes]).reshape(len(free), frequency.size)
        spread = np.sqrt(np.maximum(np.einsum("pf,pq,qf->f", J, covariance, J), 0.0))
        size, factor = np.abs(H), np.exp(np.minimum(2 * spread, 50.0))
        curves.append(Curve(side, size, size / factor, size * factor, np.degrees(np.unwrap(np.angle(H)))))
    torque_unit = f"({own})" if " " in (own := estimate.data.torque_unit) else own
    unit = f"({POSITION_UNIT[joint.kind]}/s)/{torque_unit}"
    return FrequencyResponse(frequency, tuple(curves), unit, modes)
