"""Profiles of drives: by which names a trace's columns are found, and what they hold; one TOML file each in `drives/`.

Names are compared by their words, whatever their case and punctuation: "Torque actual value", "TorqueActualValue" and
"Axis 1.torque_actual_value" are one. A unit in brackets at the end is no part of a name, and wins over the profile's.
"""

from __future__ import annotations

import re
import tomllib
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, replace
from functools import cache
from importlib.resources import files
from importlib.resources.abc import Traversable
from typing import Any

from jointid.common.errors import RecordError
from jointid.models.transmission import Side, usual_side
from jointid.records.columns import Column, known_units
from jointid.records.record import CHANNELS, Tap, Timing

_HUMP = re.compile(r"(?<=[a-z])(?=[A-Z])")
_WORD = re.compile(r"[a-z0-9]+")
_LISTED = 10  # columns that a message shows
_BRACKETS = re.compile(r"\s*[\[(][^\[\]()]*[\])]\s*$")


@dataclass(frozen=True, slots=True)
class TraceSignal:
    """One signal of a drive that a channel can be.

    Attributes:
        names: of its column; {axis} stands for the number of the axis, {index} for one less.
        unit: of its values; None where the column's name says it, or SI.
        side: of a transmission on which it is measured; None where it is the usual one.
        timing, tap: see `Column`.
        axes: that have it; None where all have.
    """

    names: tuple[str, ...]
    unit: str | None = None
    side: Side | None = None
    timing: Timing | None = None
    tap: Tap | None = None
    axes: tuple[int, ...] | None = None

    def names_on(self, axis: int | None) -> Iterator[str]:
        """Yield the names it can have on that axis."""
        if self.axes is not None and axis not in self.axes:
            return
        for name in self.names:
            if axis is not None:
                yield name.format(axis=axis, index=axis - 1)
            elif "{" not in name:
                yield name

    def fill(self, column: Column, known: tuple[str, ...]) -> Column:
        """Return a column with what it does not say itself."""
        unit = column.unit
        if unit is None and column.gain == 1.0 and column.stated_unit(known) is None:  # a gain leads to another unit
            unit = self.unit
        return replace(column, unit=unit, timing=column.timing or self.timing, tap=column.tap or self.tap)


@dataclass(frozen=True, slots=True)
class Profile:
    """Signal names, units and sides in the traces of one kind of drive.

    Attributes:
        name: that a joint file gives.
        title: in words.
        sources: public documents, and the objects or parameters in them.
        assumed: what a user has to compare with the drive's parameters.
        rated_torque: which of the drive's numbers a share of the rated torque is a share of.
        counts: which of its numbers the counts of a turn are.
        time: names of the time column beside "t" and "time".
        channels: the signals that each channel can be.
    """

    name: str
    title: str
    sources: tuple[str, ...]
    assumed: tuple[str, ...]
    rated_torque: str
    counts: str
    channels: Mapping[str, tuple[TraceSignal, ...]]
    time: tuple[str, ...] = ()

    def signals(self, channel: str, column: str, axis: int | None) -> list[TraceSignal]:
        """Return the signals of a channel that a column of that name can be."""
        spoken = _name_words(column)
        return [
            s for s in self.channels.get(channel, ()) if any(_split_words(name) in spoken for name in s.names_on(axis))
        ]

    def side(self, channel: str, column: str, axis: int | None) -> Side | None:
        """Return the side of a transmission on which a channel is measured, by its column or before that is known."""
        signals = self.signals(channel, column, axis) if column else list(self.channels.get(channel, ()))
        return signals[0].side if signals else None

    def column(
        self, channel: str, declared: Column | None, axis: int | None, kind: str, tap: Tap | None = None
    ) -> Column | None:
        """Return a column that would be found as a channel: the one declared, or the first of the names there are.

        Args:
            channel: of the record.
            declared: what is said of it, which need not be its name.
            axis: of the trace.
            kind: of the side of the joint it is measured on.
            tap: where a torque was logged, if that is to tell one signal from another.
        """
        signals = self.channels.get(channel, ())
        if declared is not None and declared.column:
            signals = tuple(self.signals(channel, declared.column, axis))
        elif tap is not None:
            signals = tuple(s for s in signals if (s.tap or Tap.COMMAND) is tap) or signals
        named = [(signal, name) for signal in signals for name in signal.names_on(axis)]
        if not named:
            return declared if declared is not None and declared.column else None
        signal, name = named[0]
        column = declared if declared is not None else Column(optional=True)
        return signal.fill(replace(column, column=column.column or name), known_units(channel, kind))

    def time_column(self, columns: Iterable[str]) -> str | None:
        """Return the time column, where the profile has a name for it and a trace this one column."""
        wanted = [_split_words(name) for name in self.time]
        found = [column for column in columns if any(words in wanted for words in _name_words(column))]
        return found[0] if len(found) == 1 else None

    def find_columns(
        self,
        declared: Mapping[str, Column],
        columns: Iterable[str],
        axis: int | None,
        kinds: Mapping[str, str],
        source: str,
    ) -> tuple[dict[str, Column], list[str]]:
        """Return the column of each channel, and a fault for each that is missing or in doubt.

        Args:
            declared: what is said of the channels; what is not is the profile's.
            columns: names of the columns there are.
            axis: of the trace.
            kinds: by channel, of the side of the joint it is measured on.
            source: what the faults call the trace.
        """
        columns, made, faults = tuple(columns), {}, list[str]()
        for channel in CHANNELS:
            column, known = declared.get(channel), known_units(channel, kinds[channel])
            if column is None or not column.column:
                names = [name for name in columns if self.signals(channel, name, axis)]
                if len(names) > 1:
                    faults.append(_ambiguity_fault(source, channel, names, self.name))
                elif column is not None and not column.optional and not names:
                    faults.append(self._missing_fault(source, channel, axis))
                if len(names) != 1:
                    continue
                column = replace(column or Column(optional=True), column=names[0])
            signals = self.signals(channel, column.column, axis)
            made[channel] = signals[0].fill(column, known) if signals else column
        return made, faults if made or faults else [self._no_column_fault(source, columns, axis)]

    def _no_column_fault(self, source: str, columns: tuple[str, ...], axis: int | None) -> str:
        listed = ", ".join(f'"{name}"' for name in columns[:_LISTED]) + (", ..." if len(columns) > _LISTED else "")
        numbered = any("{" in name for signals in self.channels.values() for s in signals for name in s.names)
        without, remedy = "", "another profile"
        if axis is None and numbered:
            without, remedy = " without the number of the axis", "the axis of the drive"
        return (
            f'{source} has no column that profile "{self.name}" knows{without} (it has {listed}); give {remedy}, or '
            "name the columns."
        )

    def _missing_fault(self, source: str, channel: str, axis: int | None) -> str:
        signals = self.channels.get(channel, ())
        if axis is None and any("{" in name for signal in signals for name in signal.names):
            return (
                f'{source} has no {channel} that profile "{self.name}" knows without the number of the axis; give the '
                f"drive's axis, or the {channel}'s column."
            )
        names = ", ".join(f'"{next(signal.names_on(axis), signal.names[0])}"' for signal in signals) or "none"
        return f'{source} has no column that profile "{self.name}" knows as {channel} ({names}); give its column.'


@cache
def profile_names() -> tuple[str, ...]:
    """Return the names of all profiles, sorted."""
    return tuple(sorted(entry.name.removesuffix(".toml") for entry in _profile_files() if entry.name.endswith(".toml")))


@cache
def load_profile(name: str) -> Profile:
    """Return the profile of that name.

    Raises:
        RecordError: there is none.
    """
    if name not in profile_names():
        raise RecordError(f'No drive profile is called "{name}"; there are {", ".join(profile_names())}.')
    (entry,) = (entry for entry in _profile_files() if entry.name == f"{name}.toml")
    raw = tomllib.loads(entry.read_text(encoding="utf-8"))
    channels = {channel: tuple(map(_parse_signal, signals)) for channel, signals in raw.pop("channels").items()}
    lists: dict[str, Any] = {key: tuple(raw.pop(key)) for key in ("sources", "assumed", "time") if key in raw}
    return Profile(name=name, channels=channels, **lists, **raw)


def _profile_files() -> Iterator[Traversable]:
    return files("jointid.records.drives").iterdir()


def _parse_signal(raw: dict[str, Any]) -> TraceSignal:
    return TraceSignal(
        names=tuple(raw["names"]),
        unit=raw.get("unit"),
        side=raw.get("side"),
        timing=Timing(raw["timing"]) if "timing" in raw else None,
        tap=Tap(raw["tap"]) if "tap" in raw else None,
        axes=tuple(raw["axes"]) if "axes" in raw else None,
    )


def _split_words(name: str) -> tuple[str, ...]:
    return tuple(_WORD.findall(_HUMP.sub(" ", name).casefold()))


def _name_words(column: str) -> set[tuple[str, ...]]:
    """Return the words of a column's name, with and without what stands before a dot and in brackets at its end."""
    whole = {column, _BRACKETS.sub("", column)}
    return {_split_words(name[at:]) for name in whole for at in (0, *(m.end() for m in re.finditer(r"\.", name)))}


def _ambiguity_fault(source: str, channel: str, names: list[str], profile: str) -> str:
    quoted = " and ".join(f'"{name}"' for name in names)
    return (
        f'{source} has {quoted}, and profile "{profile}" knows each as {channel}; name the one that is meant as the '
        f"{channel}'s column."
    )


def find_side(channel: str, column: Column | None, profile: Profile | None, axis: int | None) -> Side:
    """Return the side of a transmission on which a channel is: as declared, by the profile, or the usual one."""
    if column is not None and column.side is not None:
        return column.side
    found = None if profile is None else profile.side(channel, column.column if column else "", axis)
    return found or usual_side(channel)
