"""Drives whose reference is filled in or averaged between the log and the law, in ways that nobody declared.

The drives are those of `studies.healthy` with a log of 1 ms and a controller that is two to ten times faster. Their
mechanics are simulated by the other hand of `studies.mechanics`. Their setpoints become a reference here, too: held, by
lines, by Hermite's cubics, or by a running mean.
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
from jointid.diagnostics.find_causes import explain_failure
from jointid.records.record import Channel, Timing
from jointid.simulation.loop_input import prepare
from studies.healthy import Drive, drive
from studies.mechanics import simulate

LOG = 1e-3  # s
_COARSE = 4  # samples of the log in a coarse setpoint
_HELD, _CUBIC = ("held_reference", "the reference is held"), ("cubic_reference", "by cubics")
_LATE, _MEAN = ("reference_delay", "the reference"), ("averaged_reference", "the drive averages the reference")
RIGHT: dict[str, tuple[str, str] | None] = {  # fault and words that come first; None where the default is right
    "hold": _HELD, "linear": None, "cubic": _CUBIC, "average": _MEAN,
    "coarse hold": None, "coarse linear": _LATE, "coarse cubic": _LATE, "coarse average": _MEAN,
}  # fmt: skip


@dataclass(frozen=True)
class Logged:
    """A record of a drive as its user declares it, what it averages over, in s, and what its law should declare."""

    record: ji.Record
    axis: Drive
    average: float


def logged(seed: int, kind: str, longest: float = 4.0) -> Logged | None:
    """Return a drive whose reference is filled in a way; None where its loop is not stable.

    A coarse setpoint is refreshed every 4 ms, and the log of 1 ms repeats it. A drive that interpolates it is one
    setpoint late, by cubics two. Running means are over 6 to 20 ms.
    """
    axis = drive(seed, longest)
    rng = np.random.default_rng([seed, 23])
    record, about = axis.record, axis.about
    assert record.torque is not None and record.reference is not None
    every = round(LOG / about["period"])
    shown = record.reference.values[::every]
    times = int(rng.choice([2, 4, 10]))
    fine = LOG / times
    setpoint, way = _COARSE if kind.startswith("coarse") else 1, kind.rsplit(maxsplit=1)[-1]
    points = shown[::setpoint]
    shown = np.repeat(points, setpoint)[: shown.size]
    late = {"linear": 1, "cubic": 2}.get(way, 0) if setpoint > 1 else 0
    filled = _fill(points, way, times * setpoint, late)[: times * shown.size]
    average = round(rng.uniform(6, 20)) * LOG if way == "average" else 0.0
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
    after = prepare(loop, inside).after_limit
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
    return Logged(given, replace(axis, loop=loop, record=given), average)


def _fill(points: FloatArray, way: str, times: int, late: int) -> FloatArray:
    """Return setpoints filled in, `times` values each, so many setpoints late."""
    if way in ("hold", "average"):
        return np.repeat(points, times)
    begun = np.concatenate([np.full(late, points[0]), points, points[-1:]])
    at, where = np.arange(begun.size, dtype=np.float64), np.arange(times * points.size) / times
    if way == "linear":
        return np.asarray(np.interp(where, at, begun))
    return np.asarray(CubicHermiteSpline(at, begun, np.gradient(begun))(where))


@dataclass(frozen=True)
class Said:
    """What was said of a drive: deviations of its values, what is trusted, and what is named."""

    seed: int
    kind: str
    about: dict[str, Any]
    average: float
    error: str
    answer: str
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
        """Whether the reference's way is named first, or nothing where it is the default, or all values hold."""
        right = RIGHT[self.kind]
        if not self.named and not self.error:
            return right is None or (self.relied and all(abs(z) <= 3 for z in self.z.values()))
        return right is not None and (right[0] in self.named[:1] or right[1] in self.error.partition(":")[0])

    @property
    def relied(self) -> bool:
        """Whether the answer says that it may be relied on."""
        return self.trust.startswith("reliable")


def judge(seed: int, kind: str, longest: float = 4.0) -> Said | None:
    """Identify a drive whose reference is filled in a way that is not declared; None where there is none."""
    made = logged(seed, kind, longest)
    if made is None:
        return None
    axis, about = made.axis, made.axis.about
    try:
        found = ji.identify(made.record, axis.loop)
    except JointidError as error:  # with its cause, as the command line has it
        said = explain_failure(error, made.record, axis.loop)
        return Said(seed, kind, about, made.average, str(said), "", "", {}, ())
    rows = {row.name: row for row in found.params.rows if row.name in axis.truth}
    z = {
        name: (row.value - axis.truth[name]) / row.deviation
        for name, row in rows.items()
        if row.value is not None and row.deviation
    }
    reasons = [one for verdict in found.checks.verdicts if str(verdict.subject) == "loop" for one in verdict.reasons]
    named = []
    for values in (reason.values for reason in reasons):
        causes: Any = values.get("causes", [])
        named += [str(values.get("suspect", values.get("law", ""))), *(str(one["cause"]) for one in causes)]
    trust = found.answer.trust
    doubted: Any = trust.values.get("parameters", ())
    named = [name for name in named if name]
    return Said(
        seed, kind, about, made.average, "", str(found.answer), str(trust.code), z, tuple(named), tuple(doubted)
    )
