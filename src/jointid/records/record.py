"""A record: logged signals in SI units.

A controller's torque is *held* between samples, an encoder is *sampled*, and some drives log the *average* over the
period that ends at the sample. Confusing them shifts the signal by half a period.
"""

from __future__ import annotations

import inspect
import re
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from enum import StrEnum
from functools import wraps
from typing import Any, TypeAlias, TypeVar, cast

import numpy as np

from jointid.common import units
from jointid.common.arrays import FloatArray
from jointid.common.errors import MethodError, RecordError
from jointid.common.text import pluralise
from jointid.common.transmission import Side, Transmission

_DECIMALS = 13  # most decimals of a period in seconds that is a finite decimal number
_Verb = TypeVar("_Verb", bound=Callable[..., Any])


Spans: TypeAlias = tuple[tuple[float, float], ...]
"""Time spans [begin, end), in order."""


class Timing(StrEnum):
    """Instants represented by a logged value."""

    SAMPLED = "sampled"  # the value at the sample's instant
    HELD = "held"  # the value from this instant to the next
    AVERAGED = "averaged"  # the mean over the period that ends at this instant


class Tap(StrEnum):
    """Point of the drive at which the torque was logged."""

    COMMAND = "command"  # the controller's output, after its filters and its limit
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
        timing: instants that a value represents.
        source: origin of the values, for reports.
        stated: whether the timing was stated, not a reader's default.
    """

    values: FloatArray
    unit: str
    sample_time: float
    timing: Timing = Timing.SAMPLED
    source: str = ""
    stated: bool = True

    def __post_init__(self) -> None:
        values = np.array(self.values, dtype=np.float64)
        if values.ndim != 1 or values.size == 0 or not 0 < self.sample_time < np.inf:
            raise RecordError(
                f"A channel has values in one dimension and a positive sample time [s]; got shape {values.shape} and "
                f"{self.sample_time}: correct that."
            )
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
        return instants(self.values.size, self.sample_time)


def instants(samples: int, period: float) -> FloatArray:
    """Return multiples of a period from 0, (samples,), rounded to its decimals."""
    decimals = next((n for n in range(_DECIMALS) if round(period, n) == period), None)
    found = np.arange(samples) * period
    return np.asarray(found if decimals is None else np.round(found, decimals), dtype=np.float64)


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


@dataclass(frozen=True, slots=True)
class Resampled:
    """Applied resampling.

    Attributes:
        sample_time: of the record, s.
        methods: by channel, "hold", "linear", "cubic", or "mean" for an averaged channel.
        largest, rms: deviation of the stamps from a uniform clock, in samples, for the worst time column.
        gaps: number of steps that skip samples.
    """

    sample_time: float
    methods: Mapping[str, str]
    largest: float
    rms: float
    gaps: int

    def __str__(self) -> str:
        how = ", ".join(f"{name} {method}" for name, method in self.methods.items())
        said = f"stamps off by up to {self.largest:.2g} samples, with {pluralise(self.gaps, 'gap')}"
        return f"to {1e3 * self.sample_time:g} ms ({how}); {said}"


CHANNELS = ("torque", "reference", "reference_velocity", "motor_position", "load_position", "injected")
"""The channel names a record can have, in the order they are always listed."""

TORQUES = ("torque", "injected")


@dataclass(frozen=True, slots=True, eq=False)
class Record:
    """Signals of one run; missing channels are None.

    Attributes:
        torque: motor torque (force), in N m (N), or in A or V while the torque constant is unknown.
        tap: where in the drive the torque was logged.
        reference: position setpoint, motor side.
        reference_velocity: velocity setpoint, if the controller uses a separate one.
        motor_position: motor encoder.
        load_position: load encoder.
        injected: a known signal added to the controller's output.
        name: of the record in reports.
        begin: seconds from the first sample of the file to that of this record, which begins at its first refresh.
        resampled: applied resampling; None if logged with a uniform clock.
        remarks: clauses on corrections and possible errors of the file.
        computed_by: the controller that computed the torque from the motor position; None for a logged torque.
        payload: of a robot, the ten inertial parameters of the last link's payload, which the model does not contain,
            in the frame of that link: m, mx, my, mz, Ixx, Ixy, Ixz, Iyy, Iyz, Izz; empty without payload. Only the
            last joint's record needs it.
        left_out: excluded time spans, by the log's own clock [s].
        zero: instant of that clock at which `begin` is 0 [s].

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
    begin: float = 0.0
    resampled: Resampled | None = None
    remarks: tuple[str, ...] = ()
    computed_by: Any = None  # a controller; records do not import controllers
    payload: tuple[float, ...] = ()
    left_out: Spans = ()
    zero: float = 0.0

    def __post_init__(self) -> None:
        object.__setattr__(self, "tap", Tap(self.tap))
        for name in CHANNELS:
            for said in _not_of(Record.__annotations__[name], getattr(self, name)):
                raise RecordError(f"{name} is {said}, and is no channel: give ji.Channel(values, unit, sample_time).")
        channels = dict(self.items())
        if not channels:
            raise RecordError("A record needs at least one channel; give the torque and the reference.")
        added = self.injected
        before = added is not None and added.at is InjectionPoint.BEFORE_LIMIT
        if added is not None and not added.in_torque and (before or self.tap is Tap.MEASURED):
            raise RecordError(
                "A measured torque, and one behind the limit, contains what was injected before it; set "
                "in_torque = true, or tap = command and at = after_limit."
            )
        longest = max(channel.duration for channel in channels.values())
        slack = max(channel.sample_time for channel in channels.values())
        if any(longest - channel.duration >= slack * (1 - 1e-9) for channel in channels.values()):
            lengths = ", ".join(f"{n} {len(c)} samples of {c.sample_time:g} s" for n, c in channels.items())
            raise RecordError(f"The channels do not cover the same time ({lengths}); cut them to one length.")

    def items(self) -> Iterator[tuple[str, Channel]]:
        """Yield name and channel, in the order of `CHANNELS`."""
        for name in CHANNELS:
            value = getattr(self, name)
            if value is not None:
                yield name, value.channel if name == "injected" else value

    @property
    def computed(self) -> bool:
        """True if the torque is computed from the motor position."""
        return self.computed_by is not None

    @property
    def channels(self) -> tuple[str, ...]:
        """Names of the present channels."""
        return tuple(name for name, _ in self.items())

    @property
    def duration(self) -> float:
        """Duration of the shortest channel [s]."""
        return min(channel.duration for _, channel in self.items())

    def counts(self, samples: int, period: float) -> FloatArray:
        """Return weights, (samples,): 0 for left-out samples, else 1."""
        at = self.on_clock(instants(samples, period))
        return np.ones(samples) - sum((at >= begin) & (at < end) for begin, end in self.left_out)

    def on_clock(self, seconds: FloatArray) -> FloatArray:
        """Convert seconds since the first sample to the log's own clock."""
        return self.zero + self.begin + seconds

    def without(self, *names: str) -> Record:
        """Return this record with the named channels removed."""
        if unknown := set(names) - set(CHANNELS):
            raise RecordError(f"No channel is called {', '.join(sorted(unknown))}; there are {', '.join(CHANNELS)}.")
        changes: dict[str, Any] = dict.fromkeys(names)
        return replace(self, **changes)

    def with_channels(self, channels: Mapping[str, Channel]) -> Record:
        """Replace channels by name."""
        changes: dict[str, Any] = dict(channels)
        if self.injected is not None and "injected" in changes:
            changes["injected"] = replace(self.injected, channel=changes["injected"])
        return replace(self, **changes)

    def require(self, names: tuple[str, ...], method: str) -> None:
        """Refuse a record that lacks channels."""
        if missing := [name for name in names if getattr(self, name) is None]:
            raise RecordError(
                f"{method} needs {' and '.join(missing)}; this record has {', '.join(self.channels)}. "
                "DIDIM needs only torque and reference; IDIM needs torque and motor_position."
            )


def takes_record(verb: _Verb) -> _Verb:
    """Refuse other things where a verb takes a record, by its annotations."""
    takes = {name: str(one.annotation) for name, one in inspect.signature(verb).parameters.items()}

    @wraps(verb)
    def checked(*args: Any, **given: Any) -> Any:
        values = dict(zip(takes, args, strict=False)) | given
        wrong = [f"{name}=" for name in CHANNELS if name in given.keys() - takes]
        for name in {"record", "motion"} & values.keys():
            wrong += _not_of(takes[name], values[name])
        if wrong:
            raise MethodError(
                f"{verb.__qualname__} takes a record; received {wrong[0]}: give ji.read(path, columns), a joint file's "
                "record(), or ji.Record(torque=ji.Channel(values, unit, sample_time), ...)."
            )
        return verb(*args, **given)

    return cast(_Verb, checked)


def _not_of(kind: str, given: Any) -> list[str]:
    """List the parts of an argument that its annotation excludes."""
    if type(given) in (list, tuple) and "Sequence" in kind:
        return [said for one in given for said in _not_of(kind.replace("Sequence", "", 1), one)]
    names = [one.__name__.removesuffix("Type") for one in type(given).__mro__]
    return [] if {*names} & {*re.findall(r"\w+", kind)} else [repr(given) if names[0] == "str" else names[0]]


def require_units(record: Record, kind: str, torque_unit: str | None) -> None:
    """Refuse a record with units that differ from the joint's.

    The torque's unit is `torque_unit`, or SI if None.
    """
    usual = {name: known_units(name, kind)[0] for name in CHANNELS}
    units_of = usual | dict.fromkeys(TORQUES if torque_unit else (), str(torque_unit))
    wrong = [f"{n} in {one.unit}, not {units_of[n]}" for n, one in record.items() if one.unit != units_of[n]]
    if wrong:
        raise RecordError(
            f"This {kind} joint does not fit the record, which has {'; '.join(wrong)}: correct the joint's kind, "
            "its torque's unit, or the units of the channels."
        )


def refer_channel(
    transmission: Transmission, name: str, channel: Channel, side: Side, *, back: bool = False
) -> Channel:
    """Refer a channel from its logged side to the joint's, or back."""
    position, kind = transmission.position(side), transmission.kind
    if back:
        position, kind = 1.0 / position, transmission.kind_of(side)
    factor = 1.0 / position if name in TORQUES else position
    of_drive = units.unit(channel.unit).dimension in ("current", "voltage")
    return replace(
        channel, values=channel.values * factor, unit=channel.unit if of_drive else known_units(name, kind)[0]
    )


def known_units(channel: str, kind: str) -> tuple[str, ...]:
    """Units allowed for a channel and kind of joint, SI first."""
    if channel in TORQUES:
        return units.units_of(*units.TORQUE_UNITS[kind])
    dimensions = units.VELOCITY_UNITS if channel == "reference_velocity" else units.POSITION_UNITS
    return units.units_of(*dimensions[kind])
