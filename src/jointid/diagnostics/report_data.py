"""Collect the results that a report on one estimate presents; a report computes nothing itself.

A part that does not exist for an estimate (profiles without a simulated loop, a response without a stiffness) is left
out, with the reason. Two parts are computed here: the spectra of the torque, measured, predicted and their difference;
and the frequency response of the joint, from the motor's torque to the velocities of its two sides. That is of the
linear part (`models.linear`), moving forwards.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from jointid.common.arrays import FloatArray
from jointid.common.errors import JointidError, RecordError
from jointid.common.messages import Progress, ignore_progress
from jointid.common.parameters import POSITION_UNIT
from jointid.diagnostics.diagnose import Diagnosis
from jointid.diagnostics.intervals import intervals
from jointid.diagnostics.validation import Validation, validate
from jointid.estimation.result.estimate import Estimate
from jointid.models.linear import OUTPUTS, frequency_response
from jointid.records.record import Channel, Record
from jointid.uncertainty.profile import ProfileInterval

_PARTS = 8  # of the record, each as long as a window of the spectra; windows overlap by half
_LONGEST = 8192  # samples of a window: a finer resolution adds nothing for a joint
_SHORTEST = 64
_LINES = 400  # of the response
_LOWEST = 0.1  # Hz
_ABOVE = 3.0  # times the fastest of the three frequencies, at least


@dataclass(frozen=True, slots=True, eq=False)
class FrequencyResponse:
    """Frequency response of an identified joint.

    Attributes:
        frequency: (lines,) Hz.
        sides: whose velocity it is: of the motor, and for a flexible joint of the load.
        magnitude: (sides, lines) of the velocity per torque.
        phase: (sides, lines) degrees.
        unit: of the magnitude.
        modes: Hz by name, of a flexible joint; see `FlexibleJoint.frequencies`.
    """

    frequency: FloatArray
    sides: tuple[str, ...]
    magnitude: FloatArray
    phase: FloatArray
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
    flexible = any(p.name == "stiffness" and p.free for p in estimate.rows)
    asked = (["stiffness", "compliance"] if flexible else []) if profiles is None else profiles
    found, absent = dict[str, Any](), dict[str, str]()
    parts: dict[str, Callable[[], Any]] = {
        "validation": lambda: validate(estimate, record),
        "response": lambda: compute_response(estimate),
        "profiles": lambda: intervals(estimate, record, asked, progress=progress),
    }
    for name, compute in parts.items():
        progress(f"collecting the report: {name}")
        try:
            found[name] = compute()
        except JointidError as error:
            absent[name] = str(error)
    check = estimate.diagnosis
    return ReportData(
        estimate, check if isinstance(check, Diagnosis) else None, **found, channels=dict(record.items()),
        checks=tuple(checks), absent=absent,
    )  # fmt: skip


def estimate_spectra(measured: FloatArray, predicted: FloatArray, sample_time: float) -> tuple[FloatArray, ...]:
    """Return frequencies, Hz, and the spectra there of a measured and a predicted signal, and of their difference.

    These are one-sided amplitude spectral densities, averaged over windows (Welch 1967), (lines,) in the signal's unit
    per square root of Hz.

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
    signals = np.stack([measured, predicted, measured - predicted])
    frequency, power = welch(signals, 1.0 / sample_time, nperseg=window, detrend="constant")
    return frequency[1:], *np.sqrt(power[:, 1:])  # 0 left out


def compute_response(estimate: Estimate) -> FrequencyResponse:
    """Return the frequency response of an estimate.

    Raises:
        MethodError: a parameter of the joint is not identifiable.
    """
    joint, values, modes = estimate.settings.joint, estimate.require_values(), estimate.frequencies
    highest = max(0.5 / estimate.data.sample_time, _ABOVE * max(modes.values(), default=0.0))
    grid = np.geomspace(_LOWEST, highest, _LINES)
    frequency = np.unique(np.concatenate([grid, [f for f in modes.values() if f > _LOWEST]]))
    sides = ("motor", "load")[: 2 if joint.model == "flexible" else 1]
    outputs = OUTPUTS[1 : 2 * len(sides) : 2]  # the velocities
    found = np.stack([frequency_response(joint, values, frequency, output) for output in outputs])
    phase = np.degrees(np.unwrap(np.angle(found), axis=1))
    torque_unit = f"({own})" if " " in (own := estimate.data.torque_unit) else own
    unit = f"({POSITION_UNIT[joint.kind]}/s)/{torque_unit}"
    return FrequencyResponse(frequency, sides, np.abs(found), phase, unit, modes)
