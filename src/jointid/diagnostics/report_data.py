"""Collect the results that a report on one estimate presents; a report computes nothing itself.

A part that does not exist for an estimate (profiles without a simulated loop, a response without a stiffness) is left
out, with the reason.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Literal, TypeAlias, TypeVar

import numpy as np

from jointid.common.arrays import FloatArray
from jointid.common.errors import JointidError
from jointid.common.progress import Progress, silent
from jointid.diagnostics.check_loop import add_loop_check
from jointid.diagnostics.intervals import intervals
from jointid.diagnostics.loop_check import LoopCheck
from jointid.diagnostics.response import FrequencyResponse, compute_response
from jointid.diagnostics.spectra import Spectra, estimate_spectra
from jointid.diagnostics.stiffness_test_design import StiffnessTestDesign, design_stiffness_test
from jointid.diagnostics.validation import Validation, validate
from jointid.estimation.result.estimate import Estimate
from jointid.models.joints import Motion
from jointid.records.record import Channel, Record
from jointid.records.signals.filtering import differentiate, lowpass
from jointid.uncertainty.profile import Profile
from jointid.uncertainty.verdict import Subject

MotionSource: TypeAlias = Literal["simulated", "measured", "commanded"]
_Part = TypeVar("_Part")


@dataclass(frozen=True, slots=True)
class ChannelSummary:
    """One channel of a record: its name, unit, seconds between samples, number of samples, timing and source."""

    name: str
    unit: str
    sample_time: float
    samples: int
    timing: str
    source: str


@dataclass(frozen=True, slots=True, eq=False)
class ReportData:
    """An estimate and the results of its diagnostics.

    Attributes:
        estimate: with the verdict of its loop check.
        channels: of the record.
        motion: of the motor, at the samples of the estimate's `measured`; None where the record has no position.
        motion_source: of that motion.
        validation: the direct test; None where there is none, as the next ones.
        loop: check of loop and log.
        spectra: of measured, predicted and error.
        response: of the joint.
        profiles: of single quantities.
        stiffness_test: test that would identify the stiffness, where it is not identifiable.
        checks: of the same estimate on other records.
        absent: reason why a part is missing, by its name, in a sentence.
    """

    estimate: Estimate
    channels: tuple[ChannelSummary, ...]
    motion: Motion | None
    motion_source: MotionSource
    validation: Validation | None
    loop: LoopCheck | None
    spectra: Spectra | None
    response: FrequencyResponse | None
    profiles: tuple[Profile, ...]
    stiffness_test: StiffnessTestDesign | None
    checks: tuple[Validation, ...]
    absent: dict[str, str]


def collect_report_data(
    estimate: Estimate,
    record: Record,
    checks: Sequence[Validation] = (),
    *,
    profiles: Sequence[str] | None = None,
    loop: bool = True,
    progress: Progress = silent,
) -> ReportData:
    """Collect the results that a report on an estimate presents.

    Args:
        estimate: of the record.
        record: that it was identified from.
        checks: validations of it on other records.
        profiles: quantities to profile, as `intervals` takes them; every free parameter of the joint, and the
            compliance of a flexible one, when None.
        loop: True to check loop and log; a search that does not end at a least-squares minimum, as the paper's, would
            itself appear as a fault.
        progress: called with each step.
    """
    absent: dict[str, str] = {}

    def attempt(name: str, step: str, compute: Callable[[], _Part]) -> _Part | None:
        progress(step)
        try:
            return compute()
        except JointidError as error:
            absent[name] = str(error)
            return None

    check = None
    if loop:
        progress("checking loop and log")
        others = [v for v in estimate.checks.verdicts if v.subject is not Subject.LOOP]  # it is said once
        estimate, check = add_loop_check(estimate.amended(checks={"verdicts": tuple(others)}), record)
    validation = attempt("validation", "simulating the direct test", lambda: validate(estimate, record))
    motion, motion_source = _find_motion(estimate, record, validation)
    found = compute_spectra(estimate)
    response = attempt("response", "computing the frequency response", lambda: compute_response(estimate))
    wanted = _list_profiles(estimate) if profiles is None else tuple(profiles)
    followed = attempt(
        "profiles", "profiling the criterion", lambda: intervals(estimate, record, wanted, progress=progress)
    )
    stiffness_test = None
    if estimate.checks.bounds:
        stiffness_test = attempt(
            "revealing",
            "designing a test that identifies the stiffness",
            lambda: design_stiffness_test(estimate, record),
        )
    return ReportData(
        estimate=estimate,
        channels=tuple(map(_summarise_channel, *zip(*record.items(), strict=True))),
        motion=motion,
        motion_source=motion_source,
        validation=validation,
        loop=check,
        spectra=found,
        response=response,
        profiles=() if followed is None else followed.profiles,
        stiffness_test=stiffness_test,
        checks=tuple(checks),
        absent=absent,
    )


def compute_spectra(estimate: Estimate) -> Spectra | None:
    """Return the spectra of an estimate's signals, the borders left out; None where they are too short."""
    inside = slice(estimate.fit.borders[0], estimate.fit.measured.size - estimate.fit.borders[1])
    try:
        return estimate_spectra(
            estimate.fit.measured[inside], estimate.fit.predicted[inside], estimate.data.sample_time
        )
    except JointidError:
        return None


def _list_profiles(estimate: Estimate) -> tuple[str, ...]:
    free = tuple(p.name for p in estimate.params if p.of_joint and p.free)
    return (*free, "compliance") if "stiffness" in free else free


def _summarise_channel(name: str, channel: Channel) -> ChannelSummary:
    return ChannelSummary(name, channel.unit, channel.sample_time, len(channel), channel.timing.value, channel.source)


def _find_motion(
    estimate: Estimate, record: Record, validation: Validation | None
) -> tuple[Motion | None, MotionSource]:
    """Return the motor's motion at the samples of the torque, and its source."""
    size = estimate.fit.measured.size
    if validation is not None and validation.motor.position.size >= size:
        motor = validation.motor
        source: MotionSource = "simulated" if validation.method == "didim" else "measured"
        return Motion(motor.position[:size], motor.velocity[:size], motor.acceleration[:size]), source
    channel = record.motor_position or record.reference
    if channel is None:
        return None, "measured"
    return _differentiate_position(
        channel, estimate, size
    ), "measured" if record.motor_position is not None else "commanded"


def _differentiate_position(channel: Channel, estimate: Estimate, size: int) -> Motion:
    """Return the motion of a logged position at the samples of the torque."""
    period, cutoff = estimate.data.sample_time, estimate.settings.filtering.position_cutoff
    position: FloatArray = np.interp(period * np.arange(size), channel.time, channel.values)
    if cutoff is not None and cutoff < 0.5 / period:
        position = lowpass(position, cutoff, period)
    velocity = differentiate(position, period)
    return Motion(position, velocity, differentiate(velocity, period))
