"""All that a report says of one estimate, collected: nothing after it computes anything.

What cannot be had of an estimate (profiles without a simulated loop, a response without a stiffness) is not there, and
a sentence says why.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Literal, TypeAlias, TypeVar

import numpy as np

from jointid.common.arrays import FloatArray
from jointid.common.errors import JointidError
from jointid.common.progress import Progress, silent
from jointid.diagnostics.check_loop import looked_at
from jointid.diagnostics.intervals import intervals
from jointid.diagnostics.loop_check import LoopCheck
from jointid.diagnostics.response import FrequencyResponse, response_of
from jointid.diagnostics.spectra import Spectra, spectra
from jointid.diagnostics.stiffness_test_design import Revealing, revealing
from jointid.diagnostics.validation import Validation, validate
from jointid.estimation.result.estimate import Estimate
from jointid.models.joints import Motion
from jointid.records.record import Channel, Record
from jointid.records.signals.filtering import differentiate, lowpass
from jointid.uncertainty.profile import Profile
from jointid.uncertainty.verdict import Subject

Seen: TypeAlias = Literal["simulated", "measured", "commanded"]
_Part = TypeVar("_Part")


@dataclass(frozen=True, slots=True)
class ChannelSummary:
    """One channel of a record as a report tells it: its name, unit, seconds between samples, samples, and source."""

    name: str
    unit: str
    sample_time: float
    samples: int
    timing: str
    source: str


@dataclass(frozen=True, slots=True, eq=False)
class Dossier:
    """An estimate, and what its record says of it.

    Attributes:
        estimate: with the verdict on its loop.
        channels: of the record.
        motion: of the motor, at the samples of the estimate's `measured`; None where the record has no position.
        seen: where that motion comes from.
        validation: the direct test; None where there is none, as the next ones.
        loop: whether loop and log are as declared.
        spectra: of measured, predicted and error.
        response: of the joint.
        profiles: of single quantities.
        revealing: which test would show a refused stiffness.
        checks: of the same estimate on other records.
        absent: why a part is not there, by its name, in a sentence.
    """

    estimate: Estimate
    channels: tuple[ChannelSummary, ...]
    motion: Motion | None
    seen: Seen
    validation: Validation | None
    loop: LoopCheck | None
    spectra: Spectra | None
    response: FrequencyResponse | None
    profiles: tuple[Profile, ...]
    revealing: Revealing | None
    checks: tuple[Validation, ...]
    absent: dict[str, str]


def dossier(
    estimate: Estimate,
    record: Record,
    checks: Sequence[Validation] = (),
    *,
    profiles: Sequence[str] | None = None,
    loop: bool = True,
    progress: Progress = silent,
) -> Dossier:
    """Collect what is to be told of an estimate.

    Args:
        estimate: of the record.
        record: that it was identified from.
        checks: validations of it on other records.
        profiles: quantities to profile, as `intervals` takes them; every free parameter of the joint, and the
            compliance of a flexible one, when None.
        loop: whether loop and log are to be checked; a search that does not end at a least-squares minimum, as the
            paper's, would be found guilty of it.
        progress: is told each step.
    """
    absent: dict[str, str] = {}

    def part(name: str, saying: str, made: Callable[[], _Part]) -> _Part | None:
        progress(saying)
        try:
            return made()
        except JointidError as error:
            absent[name] = str(error)
            return None

    check = None
    if loop:
        progress("checking loop and log")
        said = [v for v in estimate.checks.verdicts if v.subject is not Subject.LOOP]  # it is said once
        estimate, check = looked_at(estimate.amended(checks={"verdicts": tuple(said)}), record)
    validation = part("validation", "simulating the direct test", lambda: validate(estimate, record))
    motion, seen = _motion(estimate, record, validation)
    found = spectra_of(estimate)
    response = part("response", "computing the frequency response", lambda: response_of(estimate))
    wanted = _profiled(estimate) if profiles is None else tuple(profiles)
    followed = part(
        "profiles", "following the criterion", lambda: intervals(estimate, record, wanted, progress=progress)
    )
    shown = None
    if estimate.checks.bounds:
        shown = part("revealing", "looking for what would tell more", lambda: revealing(estimate, record))
    return Dossier(
        estimate=estimate,
        channels=tuple(map(_summary, *zip(*record.items(), strict=True))),
        motion=motion,
        seen=seen,
        validation=validation,
        loop=check,
        spectra=found,
        response=response,
        profiles=() if followed is None else followed.profiles,
        revealing=shown,
        checks=tuple(checks),
        absent=absent,
    )


def spectra_of(estimate: Estimate) -> Spectra | None:
    """Return the spectra of an estimate's signals, the borders left out; None where they are too short."""
    inside = slice(estimate.fit.borders[0], estimate.fit.measured.size - estimate.fit.borders[1])
    try:
        return spectra(estimate.fit.measured[inside], estimate.fit.predicted[inside], estimate.data.sample_time)
    except JointidError:
        return None


def _profiled(estimate: Estimate) -> tuple[str, ...]:
    free = tuple(p.name for p in estimate.params if p.of_joint and p.free)
    return (*free, "compliance") if "stiffness" in free else free


def _summary(name: str, channel: Channel) -> ChannelSummary:
    return ChannelSummary(name, channel.unit, channel.sample_time, len(channel), channel.timing.value, channel.source)


def _motion(estimate: Estimate, record: Record, validation: Validation | None) -> tuple[Motion | None, Seen]:
    """Return the motor's motion at the samples of the torque, and where it comes from."""
    size = estimate.fit.measured.size
    if validation is not None and validation.motor.position.size >= size:
        motor = validation.motor
        seen: Seen = "simulated" if validation.method == "didim" else "measured"
        return Motion(motor.position[:size], motor.velocity[:size], motor.acceleration[:size]), seen
    channel = record.motor_position or record.reference
    if channel is None:
        return None, "measured"
    return _from(channel, estimate, size), "measured" if record.motor_position is not None else "commanded"


def _from(channel: Channel, estimate: Estimate, size: int) -> Motion:
    """Return the motion of a logged position at the samples of the torque."""
    period, cutoff = estimate.data.sample_time, estimate.settings.filtering.position_cutoff
    position: FloatArray = np.interp(period * np.arange(size), channel.time, channel.values)
    if cutoff is not None and cutoff < 0.5 / period:
        position = lowpass(position, cutoff, period)
    velocity = differentiate(position, period)
    return Motion(position, velocity, differentiate(velocity, period))
