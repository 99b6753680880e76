"""Forces in the loop of random flexible drives, identified from measured motion: whether intervals hold the truth."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from scipy.signal import lfilter

from jointid.common.errors import JointidError
from jointid.diagnostics.identify import identify
from jointid.estimation.methods.drive_side import DriveSideFit
from jointid.estimation.methods.idim import IDIM
from jointid.estimation.result.estimate import Estimate
from jointid.models.joints import FlexibleJoint
from jointid.records.record import Record
from jointid.simulation.synthesis import simulated_record
from tests.plants import Case, prismatic

ASKED = ("motor_inertia", "stiffness", "load_inertia")
_ENCODER = 1e-7  # of the travel: the encoders' steps
_SAMPLES = 12_000  # of a record, at most
_LOG = 0.002  # of the torque: white noise on the log


@dataclass(frozen=True, slots=True)
class ForceRun:
    """How one drive went.

    Attributes:
        z: error over deviation of each value that was asked for, by name; empty where there is none.
        relied: whether the answer says that it may be relied on, or only what to be careful of.
    """

    z: dict[str, float]
    relied: bool = True

    def within(self, name: str) -> bool | None:
        """Return whether a value is within 2 sigma; None where there is none, or it is said not to be relied on."""
        return abs(self.z[name]) <= 2 if self.relied and name in self.z else None


def make_record(seed: int) -> tuple[Case, Record]:
    """Return a drive and its record under a force of 0.5 to 5 % of the torque."""
    case, rng = prismatic(seed), np.random.default_rng([seed, 9])
    clean = case.clean
    assert clean.reference is not None
    assert clean.torque is not None
    assert clean.injected is not None
    size, period = float(np.std(clean.torque.values)), clean.reference.sample_time
    share = float(np.exp(rng.uniform(np.log(0.005), np.log(0.05))))
    reference, known = (one.values[:_SAMPLES] for one in (clean.reference, clean.injected.channel))
    known = known * (seed % 4 > 1)  # half of them without pulses
    force = rng.standard_normal(reference.size)
    if seed % 2:  # coloured, with a corner below or above the mode
        corner = case.mode * float(np.exp(rng.uniform(np.log(0.2), np.log(3.0))))
        force = lfilter([1.0], [1.0, -np.exp(-2 * np.pi * corner * period)], force)
    record = simulated_record(
        case.loop,
        reference,
        case.truth,
        sample_time=period,
        injected=known,
        disturbance=share * size / float(np.std(force)) * force,
        torque_noise=_LOG * size * rng.standard_normal(force.size),
        encoder_step=_ENCODER * float(np.ptp(reference)),
    )
    return case, record


def judge(seed: int, method: Literal["drive_side", "idim"]) -> ForceRun:
    """Identify a drive from measured motion: its drive side or by IDIM."""
    case, record = make_record(seed)
    joint = case.loop.joint
    assert isinstance(joint, FlexibleJoint)
    record = replace(record, reference=None, injected=None)
    try:
        found = identify(record, joint, IDIM() if method == "idim" else DriveSideFit())
    except JointidError:
        return ForceRun({})
    return ForceRun(_errors(found, case), found.answer.trust.code != "not_reliable_yet")


def _errors(found: Estimate, case: Case) -> dict[str, float]:
    rows = [found[name] for name in ASKED]
    return {
        row.name: (row.value - case.truth[row.name]) / row.deviation
        for row in rows
        if row.value is not None and row.deviation
    }
