"""Effect of a jittering clock on the twin's parameters, with each remedy.

A log that is late by a random share of the sample time, noise-free otherwise: either each *sample* is taken late, at
the instant that its stamp says, or the samples are uniform and only the *stamps* are late.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Literal

import numpy as np

from jointid.common.arrays import FloatArray
from jointid.common.text import align, number
from jointid.diagnostics.identify import identify
from jointid.estimation.methods.didim import DIDIM
from jointid.estimation.methods.idim import IDIM
from jointid.models.joints import ClosedLoop, FlexibleJoint
from jointid.paper.twin import CONTROLLERS, DURATION, SAMPLE_TIME, TABLE_2
from jointid.records.columns import Column
from jointid.records.formats import Table, write_table
from jointid.records.reading import read
from jointid.records.record import Record, Timing
from jointid.records.resampling import Resampling
from jointid.records.signals.filtering import Filtering
from jointid.simulation.excitation import pulses, trapezoids
from jointid.simulation.synthesis import simulated_record
from studies.seeds import judge_seeds

Late = Literal["samples", "stamps"]
_FINE = 20  # instants of the truth in a sample time
_SHOWN = ("motor_inertia", "stiffness", "load_inertia")

REMEDIES: dict[str, Resampling | None] = {
    "taken as uniform": None,
    "linear": Resampling(SAMPLE_TIME, "linear"),
    "cubic": Resampling(SAMPLE_TIME, "cubic"),
    "cubic, reference held": Resampling(SAMPLE_TIME, "cubic"),
}
"""Remedies, by name."""


@dataclass(frozen=True, slots=True)
class Jittered:
    """One log and what came of it: errors of the parameters, by name, as shares of the truth.

    Attributes:
        late: what is late.
        share: of the sample time, by which it is late at most.
        remedy: one of `REMEDIES`.
        didim, idim: errors of DIDIM from torque and reference, and of IDIM from torque and both encoders.
    """

    late: Late
    share: float
    remedy: str
    didim: dict[str, float]
    idim: dict[str, float]


@dataclass(frozen=True, slots=True)
class Jitter:
    """All logs; printed, a table of errors in per cent."""

    runs: tuple[Jittered, ...]

    def __str__(self) -> str:
        """Return the table."""
        header = (
            "late",
            "by up to, %",
            "remedy",
            *(f"{m} {s}" for m in ("DIDIM", "IDIM") for s in ("ZZ1", "K12", "ZZ2")),
        )
        rows = [
            (
                run.late,
                f"{100 * run.share:g}",
                run.remedy,
                *(number(100 * found[name], 2) for found in (run.didim, run.idim) for name in _SHOWN),
            )
            for run in self.runs
        ]
        return align(header, rows, (False, True, False, *[True] * 6))


def jitter(shares: Sequence[float] = (0.0, 0.05, 0.3), seed: int = 1, out: Path | None = None) -> Jitter:
    """Identify loop L19 of the twin, logged late by up to each of these shares of the sample time."""
    settings = [
        {"late": late, "share": share, "remedy": remedy}
        for late, share, remedy in itertools.product(("samples", "stamps"), shares, REMEDIES)
        if share or (late, remedy) == ("samples", "taken as uniform")  # else all the same
    ]
    return Jitter(tuple(Jittered(**run) for run in judge_seeds("studies.jitter:judge", [seed], *settings, out=out)))


def judge(seed: int, late: Late, share: float, remedy: str) -> Jittered:
    """Identify one log that is late."""
    delay = share * np.random.default_rng(seed).random(round(DURATION / SAMPLE_TIME) - 1)
    return _judged(_logged(_truth(), delay, late, remedy), late, share, remedy)


@cache
def _truth() -> Record:
    """Return the axis as it moved, each channel `_FINE` times in a sample time."""
    loop = ClosedLoop(FlexibleJoint("prismatic"), replace(CONTROLLERS["L19"], period=SAMPLE_TIME))
    reference = trapezoids((0.042, 0.083, 0.125), 0.83, 0.2, SAMPLE_TIME, duration=DURATION)
    known = pulses(reference.size, SAMPLE_TIME, height=150.0, width=0.02, every=0.4, seed=0)
    held = [np.repeat(signal, _FINE) for signal in (reference, known)]
    return simulated_record(loop, held[0], dict(TABLE_2), sample_time=SAMPLE_TIME / _FINE, injected=held[1])


def _logged(truth: Record, delay: FloatArray, late: Late, remedy: str) -> Record:
    """Return the record as it is read from a file whose samples, or whose stamps, are late by shares of a sample."""
    number = np.arange(delay.size)
    stamps = number + delay
    channels = dict(truth.items())
    instants = stamps if late == "samples" else number.astype(np.float64)
    columns = {"t": stamps * SAMPLE_TIME}
    for name, channel in channels.items():
        columns[name] = (
            np.interp(instants * _FINE, np.arange(len(channel)), channel.values)
            if name.endswith("position")
            else channel.values[np.floor(instants * _FINE + 1e-9).astype(int)]
        )
    wanted: dict[str, str | Column] = {name: name for name in channels}
    if remedy.endswith("held"):
        wanted["reference"] = Column("reference", timing=Timing.HELD)
    how = REMEDIES[remedy]
    sample_time = SAMPLE_TIME if how is None else None
    with TemporaryDirectory() as folder:
        path = Path(folder) / "log.npy"
        write_table(path, Table(columns))
        return read(path, wanted, resample=how, name="twin", sample_time=sample_time, kind="prismatic")


def _judged(record: Record, late: Late, share: float, remedy: str) -> Jittered:
    loop = ClosedLoop(FlexibleJoint("prismatic"), CONTROLLERS["L19"])
    search = DIDIM(frequency=30.0)
    without = record.without("motor_position", "load_position")
    didim = identify(without, loop, search, filtering=Filtering(cutoff=60.0), checks=False)
    idim = identify(record, loop, IDIM(), checks=False)
    off = [{name: float(found[name].value or 0.0) / TABLE_2[name] - 1 for name in _SHOWN} for found in (didim, idim)]
    return Jittered(late, share, remedy, *off)
