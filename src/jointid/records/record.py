"""A record: the signals a drive logged, in SI units, each with its sample time, timing and source.

Time is part of the data: a controller's torque is *held* between samples, an encoder is *sampled*, some drives
log the *average* over the period that ends at the sample. Reading one as another shifts it by half a period.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, fields, replace
from enum import StrEnum
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from jointid.common.arrays import FloatArray
from jointid.common.errors import RecordError
from jointid.records.time_base.uniformity import Resampled


class Timing(StrEnum):
    """Instants that a logged value stands for."""

    SAMPLED = "sampled"  # the value at the sample's instant
    HELD = "held"  # the value from this instant to the next
    AVERAGED = "averaged"  # the mean over the period that ends at this instant


class Tap(StrEnum):
    """Point of the drive at which the torque was logged."""

    COMMAND = "command"  # the controller's output, after its limit
    FILTERED = "filtered"  # after the drive's torque filters
    MEASURED = "measured"  # a measured current times the torque constant, with its own noise


class InjectionPoint(StrEnum):
    """Point at which a known signal is added to the controller's output."""

    BEFORE_LIMIT = "before_limit"
    AFTER_LIMIT = "after_limit"


@dataclass(frozen=True, slots=True, eq=False)
class Channel:
    """One logged signal.

    Attributes:
        values: shape (samples,), in the SI `unit`, finite, read-only.
        unit: SI unit of `values`: "m", "rad", "m/s", "rad/s", "N", "N m", or "A", "V" for a torque in drive units.
        sample_time: seconds between samples; this channel's own rate.
        timing: what a value says about the time around its sample.
        source: where the values came from, for reports.
    """

    values: FloatArray
    unit: str
    sample_time: float
    timing: Timing = Timing.SAMPLED
    source: str = ""

    def __post_init__(self) -> None:
        values = np.array(self.values, dtype=np.float64)
        if values.ndim != 1 or values.size == 0:
            raise RecordError(
                f"A channel holds one value per sample; received an array of shape {values.shape}: "
                "pass a non-empty one-dimensional array."
            )
        if not (np.isfinite(self.sample_time) and self.sample_time > 0):
            raise RecordError(f"A channel's sample time is a positive number of seconds; got {self.sample_time}.")
        values.flags.writeable = False
        object.__setattr__(self, "values", values)
        object.__setattr__(self, "timing", Timing(self.timing))

    def __len__(self) -> int:
        return self.values.size

    @property
    def duration(self) -> float:
        """Seconds covered, one sample time per sample."""
        return self.values.size * self.sample_time

    @property
    def time(self) -> FloatArray:
        """Instants of the samples, shape (samples,), starting at 0."""
        return np.asarray(np.arange(self.values.size) * self.sample_time, dtype=np.float64)


@dataclass(frozen=True, slots=True, eq=False)
class Injection:
    """A known signal added to the controller's output.

    Attributes:
        channel: the signal, in the torque's unit.
        at: before or after the controller's limit.
        in_torque: True if the logged torque already contains it (a signal added before the limit always is).
    """

    channel: Channel
    at: InjectionPoint = InjectionPoint.AFTER_LIMIT
    in_torque: bool = True

    def __post_init__(self) -> None:
        object.__setattr__(self, "at", InjectionPoint(self.at))
        if self.at is InjectionPoint.BEFORE_LIMIT and not self.in_torque:
            raise RecordError(
                "A signal injected before the limit is part of the controller's output, so the logged torque "
                "contains it; set in_torque = true, or at = after_limit."
            )


CHANNELS = ("torque", "reference", "reference_velocity", "motor_position", "load_position", "injected")
"""The channel names a record can have, in the order they are always listed."""


@dataclass(frozen=True, slots=True, eq=False)
class Record:
    """Signals logged in one run; a channel that was not logged is None.

    Attributes:
        torque: motor torque (force), in N m (N), or in A or V while the torque constant is unknown.
        tap: where in the drive the torque was logged.
        reference: commanded position, motor side.
        reference_velocity: commanded velocity, where the controller uses one of its own.
        motor_position: motor encoder.
        load_position: load encoder.
        injected: a known signal added to the controller's output.
        name: what reports call this record.
        other_axes: positions of other axes that were logged too and moved, by their columns; no joint's model reads
            them, and the coupling that they bring is not in it.
        begin: seconds from the first sample of the file to that of this record, which begins at its first refresh.
        resampled: how its samples were brought to a uniform clock, None where they were logged so.

    Raises:
        RecordError: channels at one rate have unequal lengths, or durations differ by more than a sample.
    """

    torque: Channel | None = None
    tap: Tap = Tap.COMMAND
    reference: Channel | None = None
    reference_velocity: Channel | None = None
    motor_position: Channel | None = None
    load_position: Channel | None = None
    injected: Injection | None = None
    name: str = "record"
    other_axes: Mapping[str, Channel] = field(default_factory=dict)
    begin: float = 0.0
    resampled: Resampled | None = None

    def __post_init__(self) -> None:
        object.__setattr__(self, "tap", Tap(self.tap))
        channels = dict(self.items())
        if not channels:
            raise RecordError("A record needs at least one channel; give the torque and the reference.")
        if self.tap is Tap.MEASURED and self.injected is not None and not self.injected.in_torque:
            raise RecordError(
                "A measured torque contains whatever was injected before it acts; set in_torque = true, or "
                "tap = command."
            )
        longest = max(channel.duration for channel in channels.values())
        slack = max(channel.sample_time for channel in channels.values())
        if any(longest - channel.duration >= slack * (1 - 1e-9) for channel in channels.values()):
            lengths = ", ".join(f"{n} {len(c)} samples of {c.sample_time:g} s" for n, c in channels.items())
            raise RecordError(f"The channels do not cover the same time ({lengths}); cut them to one length.")

    def items(self) -> Iterator[tuple[str, Channel]]:
        """Yield the name and the channel of each channel there is, in the order of `CHANNELS`."""
        for name in CHANNELS:
            value = getattr(self, name)
            if value is not None:
                yield name, value.channel if isinstance(value, Injection) else value

    @property
    def channels(self) -> tuple[str, ...]:
        """Names of the channels there are."""
        return tuple(name for name, _ in self.items())

    @property
    def duration(self) -> float:
        """Seconds covered by the channel that ends first."""
        return min(channel.duration for _, channel in self.items())

    def without(self, *names: str) -> Record:
        """Return this record with the named channels removed."""
        unknown = set(names) - set(CHANNELS)
        if unknown:
            raise RecordError(f"No channel is called {', '.join(sorted(unknown))}; there are {', '.join(CHANNELS)}.")
        changes: dict[str, Any] = dict.fromkeys(names)
        return replace(self, **changes)

    def require(self, names: tuple[str, ...], method: str) -> None:
        """Raise a `RecordError` that names every channel of `names` that is not there, and what is."""
        missing = [name for name in names if getattr(self, name) is None]
        if missing:
            raise RecordError(
                f"{method} needs {' and '.join(missing)}; this record has {', '.join(self.channels)}. "
                "DIDIM needs only torque and reference; IDIM needs torque and motor_position."
            )


def record_of(
    sample_time: float, *, unit: str, position_unit: str, name: str = "record", **values: ArrayLike
) -> Record:
    """Build a record from arrays that share one sample time: sampled positions, a torque held between samples."""
    velocity_unit = f"{position_unit}/s"
    units = dict.fromkeys(CHANNELS, position_unit) | {"torque": unit, "reference_velocity": velocity_unit}
    made = {
        key: Channel(
            np.asarray(array, dtype=np.float64),
            units[key],
            sample_time,
            Timing.HELD if key == "torque" else Timing.SAMPLED,
            "array",
        )
        for key, array in values.items()
    }
    allowed = {each.name for each in fields(Record)} - {"tap", "injected", "name", "other_axes", "begin", "resampled"}
    unknown = set(made) - allowed
    if unknown:
        raise RecordError(f"No channel is called {', '.join(sorted(unknown))}; there are {', '.join(sorted(allowed))}.")
    return Record(**made, name=name)  # type: ignore[arg-type]
