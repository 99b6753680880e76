"""Drives whose reference is filled in or averaged between the log and the law, in ways that nobody declared.

The drives are those of `studies.healthy` with a log of 1 ms and a controller that is two to ten times faster. Their
mechanics are simulated by the other hand of `studies.mechanics`. Their setpoints become a reference here, too: held, by
Hermite's cubics, or by a running mean.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy.interpolate import CubicHermiteSpline
from scipy.signal import lfilter

import jointid as ji
from jointid.common.arrays import FloatArray
from jointid.common.errors import JointidError
from jointid.diagnostics.explain import explain_failure
from jointid.records.record import Channel, Timing
from jointid.simulation.loop_input import prepare
from studies.healthy import Drive, drive
from studies.mechanics import simulate

LOG = 1e-3  # s
RIGHT = {  # fault and words that come first
    "hold": ("held_reference", "the reference is held"),
    "cubic": ("cubic_reference", "by cubics"),
    "average": ("averaged_reference", "the drive averages the reference"),
}


@dataclass(frozen=True)
class Logged:
    """A record of a drive as its user declares it, and what its law should declare."""

    record: ji.Record
    axis: Drive


def logged(seed: int, kind: str, longest: float = 4.0) -> Logged | None:
    """Return a drive whose reference is filled in a way; None where its loop is not stable.

    Running means are over 6 to 20 ms.
    """
    axis = drive(seed, longest)
    rng = np.random.default_rng([seed, 23])
    record, about = axis.record, axis.about
    assert record.torque is not None and record.reference is not None
    every = round(LOG / about["period"])
    shown = record.reference.values[::every]
    times = int(rng.choice([2, 4, 10]))
    fine = LOG / times
    filled = _interpolate(shown, times) if kind == "cubic" else np.repeat(shown, times)
    average = round(rng.uniform(6, 20)) * LOG if kind == "average" else 0.0
    if average:
        width = round(average / fine)
        begun = np.concatenate([np.full(width - 1, filled[0]), filled])
        filled = np.convolve(begun, np.full(width, 1 / width), "valid")
    law: Any = replace(axis.loop.controller, period=fine, delay=float(rng.choice([0, 1])) * fine)  # type: ignore[type-var]
    loop = replace(axis.loop, controller=law)
    injected = record.injected
    if injected is not None:
        channel = replace(injected.channel, values=injected.channel.values[::every], sample_time=LOG)
        injected = replace(injected, channel=channel)
    unit = record.reference.unit
    torque = Channel(np.zeros(filled.size), record.torque.unit, fine, Timing.HELD)
    inside = replace(record, torque=torque, reference=Channel(filled, unit, fine, Timing.SAMPLED), injected=injected)
    plant = Drive(inside, loop, axis.truth, about)
    after = prepare(loop, inside).axis.after_limit
    clean, _, _ = simulate(plant, axis.truth, after)
    scale = float(np.std(clean))
    noise = rng.standard_normal(shown.size)
    if about["noise"] == "coloured force":
        noise = lfilter([1.0], [1.0, -np.exp(-LOG * 2 * np.pi * rng.uniform(2, 30))], noise)
    noise *= about["size"] * scale / noise.std()
    on_log = about["noise"] == "log"
    out, experiment, _ = simulate(plant, axis.truth, after + (0.0 if on_log else np.repeat(noise, times)))
    seen = (out + experiment.shown)[::times] + (noise if on_log else 0.0)
    if not np.all(np.isfinite(seen)) or np.abs(seen).max() > 10 * np.abs(clean).max():
        return None
    given = replace(
        inside,
        torque=replace(torque, values=seen, sample_time=LOG),
        reference=Channel(shown, unit, LOG, Timing.SAMPLED),
    )
    return Logged(given, replace(axis, loop=loop, record=given))


def _interpolate(points: FloatArray, times: int) -> FloatArray:
    """Return setpoints with `times` values each on Hermite's cubics."""
    ends = np.concatenate([points, points[-1:]])
    at, where = np.arange(ends.size, dtype=np.float64), np.arange(times * points.size) / times
    return np.asarray(CubicHermiteSpline(at, ends, np.gradient(ends))(where))


@dataclass(frozen=True)
class Said:
    """What was said of a drive: deviations of its values, what is trusted, and what is named."""

    kind: str
    error: str
    trust: str
    z: dict[str, float]
    named: tuple[str, ...]
    doubted: tuple[str, ...] = ()  # parameters that an answer excepts

    @property
    def silent(self) -> bool:
        """A value more than 3 deviations off that may be relied on."""
        return self.relied and any(abs(z) > 3 for name, z in self.z.items() if name not in self.doubted)

    @property
    def right(self) -> bool:
        """Whether the reference's way is named first, or all values hold."""
        if not self.named and not self.error:
            return self.relied and all(abs(z) <= 3 for z in self.z.values())
        code, words = RIGHT[self.kind]
        return code in self.named[:1] or words in self.error.partition(":")[0]

    @property
    def relied(self) -> bool:
        """Whether the answer says that it may be relied on."""
        return self.trust.startswith("reliable")


def judge(seed: int, kind: str, longest: float = 4.0) -> Said | None:
    """Identify a drive whose reference is filled in a way that is not declared; None where there is none."""
    made = logged(seed, kind, longest)
    if made is None:
        return None
    axis = made.axis
    try:
        found = ji.identify(made.record, axis.loop)
    except JointidError as error:  # with its cause, as the command line has it
        said = explain_failure(error, made.record, axis.loop, print)
        return Said(kind, str(said), "", {}, ())
    rows = {row.name: row for row in found.rows if row.name in axis.truth}
    z = {
        name: (row.value - axis.truth[name]) / row.deviation
        for name, row in rows.items()
        if row.value is not None and row.deviation
    }
    reasons = [one for one in found.checks if one.name == "loop"]
    named = []
    for values in (reason.values for reason in reasons):
        causes: Any = values.get("causes", [])
        named += [str(values.get("suspect", values.get("law", ""))), *(str(one["cause"]) for one in causes)]
    trust = found.answer.trust
    doubted: Any = trust.values.get("parameters", ())
    named = [name for name in named if name]
    return Said(kind, "", str(trust.code), z, tuple(named), tuple(doubted))
