"""Drive profiles and units: column names in traces, factors to SI.

Each kind of drive has a profile, a TOML file in this folder. Names match regardless of case and punctuation:
"Torque actual value", "TorqueActualValue" and "Axis 1.torque_actual_value". A unit in brackets at the end overrides
the profile's.

A drive logs positions in counts, and torque as a share of a rated one (CiA 402: object 6077h, per mille of object
6076h) or as a current. The drive's parameters, not its log, give these numbers.
"""

from __future__ import annotations

import contextlib
import math
import re
import tomllib
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache
from importlib.resources import files
from typing import Any, TypeAlias

from jointid.common import units
from jointid.common.errors import RecordError
from jointid.common.parameters import POSITION_UNIT, TORQUE_UNIT
from jointid.common.settings import add_settings_to_docstring, check_settings, setting
from jointid.common.transmission import SIDES, Side, Transmission
from jointid.records.columns import Column, unit_fault
from jointid.records.record import CHANNELS, InjectionPoint, Tap, known_units

Spoken: TypeAlias = Mapping[tuple[str, ...], Sequence[str]]
"""Columns of a trace, by the words of their names."""

Place: TypeAlias = Mapping[str, int | str]
"""Values of the placeholders in column names for an axis of a trace."""

_FOLDER = files("jointid.records.drives")  # of the profiles
_COUNTS = {"prismatic": "counts_per_metre", "revolute": "counts_per_turn"}
_HUMP = re.compile(r"(?<=[a-z])(?=[A-Z])")
_WORD = re.compile(r"[a-z0-9]+")
_LISTED = 10  # columns that a message shows
_PREFIX = re.compile(r"\.|/(?=.*/)")  # end of a prefix
_BRACKETS = re.compile(r"\s*[\[(](?!\d+[\])])[^\[\]()]*[\])]\s*$")  # of a unit; "q[0]" is an element


@dataclass(frozen=True, slots=True)
class TraceSignal(Column):
    """A drive signal for a channel: a column with usual settings.

    Attributes:
        names: of its column, with placeholders {axis} (number from 1), {index} (from 0) and {joint} (name).
        axes: the axes that have it; None for all.
        fallback: whether to use it only if the trace has no other signal of its channel.
    """

    names: tuple[str, ...] = ()
    axes: tuple[int, ...] | None = None
    fallback: bool = False

    def names_on(self, place: Place) -> Iterator[str]:
        """Yield possible names at a place."""
        if self.axes is None or place.get("axis") in self.axes:
            for name in self.names:
                with contextlib.suppress(KeyError):
                    yield name.format(**place)

    def fill(self, column: Column, known: tuple[str, ...]) -> Column:
        """Complete a column's missing settings."""
        stated = column.unit is not None or column.gain != 1.0 or column.stated_unit(known) is not None
        return replace(
            column,
            unit=column.unit if stated else self.unit,  # a gain implies another unit
            timing=column.timing or self.timing,
            tap=column.tap or self.tap,
            at=self.at if column.at is InjectionPoint.AFTER_LIMIT else column.at,
        )


@dataclass(frozen=True, slots=True)
class Profile:
    """Signal names, units and sides in the traces of a drive.

    Attributes:
        sources: public documents, and the objects or parameters in them.
        assumed: assumptions that users have to compare with the drive's parameters.
        rated_torque: the drive parameter with the rated torque.
        counts: the drive parameter with the counts per turn.
        time: names of the time column other than "t" and "time".
        channels: the possible signals of each channel.
        law: controller law in the joint file's terms; empty if unknown.
    """

    name: str
    title: str
    sources: tuple[str, ...]
    assumed: tuple[str, ...]
    rated_torque: str
    counts: str
    channels: Mapping[str, tuple[TraceSignal, ...]]
    time: tuple[str, ...] = ()
    law: str = ""

    def find(self, channel: str, columns: Spoken, place: Place) -> dict[str, TraceSignal]:
        """Return possible columns of a channel with their signals; fallbacks last."""
        for fallback in (False, True):
            signals = [one for one in self.channels.get(channel, ()) if one.fallback is fallback]
            if found := {name: one for one in signals for name in _find_named(one.names_on(place), columns)}:
                return found
        return {}

    def column(
        self, channel: str, declared: Column | None, place: Place, kind: str, tap: Tap | None = None
    ) -> Column | None:
        """Return the column to write a channel to, declared or by profile."""
        column, signals = declared or Column(optional=True), list(self.channels.get(channel, ()))
        if column.column:
            signals = list(self.find(channel, index_columns([column.column]), place).values())
        signals.sort(key=lambda one: tap not in (None, one.tap or Tap.COMMAND))
        for signal in signals:
            for name in signal.names_on(place):
                return signal.fill(replace(column, column=column.column or name), known_units(channel, kind))
        return declared if column.column else None

    def time_column(self, columns: Iterable[str]) -> str | None:
        """The time column, if the trace has exactly one known name."""
        found = _find_named(self.time, index_columns(columns))
        return found[0] if len(found) == 1 else None

    def find_columns(
        self,
        declared: Mapping[str, Column],
        columns: Iterable[str],
        place: Place,
        kinds: Mapping[str, str],
        source: str,
    ) -> tuple[dict[str, Column], list[str]]:
        """Assign columns to channels; report missing and ambiguous ones."""
        made, faults, spoken = dict[str, Column](), list[str](), index_columns(columns)
        for channel in CHANNELS:
            column = declared.get(channel) or Column(optional=True)
            found = self.find(channel, index_columns([column.column]) if column.column else spoken, place)
            if column.column or len(found) == 1:
                column = column if column.column else replace(column, column=next(iter(found)))
                signal = found.get(column.column)
                made[channel] = column if signal is None else signal.fill(column, known_units(channel, kinds[channel]))
            elif found or not column.optional:
                faults.append(self._missing(source, spoken, channel, sorted(found)))
        return made, faults if made or faults else [self._missing(source, spoken, "any channel", [])]

    def _missing(self, source: str, columns: Spoken, channel: str, found: list[str]) -> str:
        """Describe a channel with no known column or several."""
        listed = found or list(dict.fromkeys(name for names in columns.values() for name in names))[:_LISTED]
        return (
            f'{source} has {"several columns" if found else "no column"} that profile "{self.name}" knows as '
            f"{channel}; it has {', '.join(map(repr, listed))}: name one, or give the axis or the joint of the drive."
        )


def place_of(axis: int | None = None, joint: str | None = None) -> Place:
    """Return the values of the placeholders in column names."""
    numbers: dict[str, int | str] = {} if axis is None else {"axis": axis, "index": axis - 1}
    return numbers if joint is None else {**numbers, "joint": joint}


def _find_named(names: Iterable[str], columns: Spoken) -> list[str]:
    """Return the columns with one of these names."""
    return list(dict.fromkeys(column for name in names for column in columns.get(_split_words(name), ())))


@cache
def profile_names() -> tuple[str, ...]:
    """Return the names of all profiles, sorted."""
    return tuple(sorted(file.name.removesuffix(".toml") for file in _FOLDER.iterdir() if file.name.endswith(".toml")))


@cache
def load_profile(name: str) -> Profile:
    """Load a profile by name.

    Raises:
        RecordError: the profile is unknown.
    """
    if name not in profile_names():
        raise RecordError(f'No drive profile is called "{name}"; there are {", ".join(profile_names())}.')
    raw = tomllib.loads((_FOLDER / f"{name}.toml").read_text(encoding="utf-8"))
    channels = {
        channel: tuple(TraceSignal(**_freeze(one)) for one in signals)
        for channel, signals in raw.pop("channels").items()
    }
    return Profile(name, channels=channels, **_freeze(raw))


def _freeze(raw: Mapping[str, Any]) -> dict[str, Any]:
    return {key: tuple(value) if type(value) is list else value for key, value in raw.items()}


def index_columns(columns: Iterable[str]) -> Spoken:
    """Index columns by the words of their names."""
    found: dict[tuple[str, ...], list[str]] = {}
    for column in columns:
        whole = {column, _BRACKETS.sub("", column)}
        # With and without prefix and unit; a path keeps its last two parts: a name below a joint is not complete.
        parts = (name[at:] for name in whole for at in (0, *(m.end() for m in _PREFIX.finditer(name))))
        for words in set(map(_split_words, parts)):
            found.setdefault(words, []).append(column)
    return found


@cache
def _split_words(name: str) -> tuple[str, ...]:
    return tuple(_WORD.findall(_HUMP.sub(" ", name).casefold()))


@add_settings_to_docstring
@dataclass(frozen=True, slots=True)
class Drive:
    """A drive's profile and the parameters behind its units.

    Raises:
        RecordError: the profile is unknown, a number is not positive and finite, or the axis is not a positive
            integer.
    """

    profile: str | None = setting(
        None,
        "profile of the drive: names, units, timing and tap of channels; what the file declares has precedence",
        accept=load_profile,
        choices=profile_names(),
    )
    axis: int | None = setting(
        None, "which axis, where a trace has several and the profile's names number them", at_least=1
    )
    joint: str | None = setting(None, "name of the axis, where a trace has several and the profile's names name them")
    rated_torque: float | None = setting(
        None, "reference of a torque in per cent or per mille", unit="N or N m", above=0
    )
    torque_constant: float | None = setting(None, "torque or force per ampere", unit="N/A or N m/A", above=0)
    torque_per_volt: float | None = setting(
        None, "torque or force per volt, of an amplifier", unit="N/V or N m/V", above=0
    )
    counts_per_turn: float | None = setting(None, "of a revolute joint's encoder", unit="counts", above=0)
    counts_per_metre: float | None = setting(None, "of a prismatic joint's encoder", unit="counts", above=0)
    load_counts_per_turn: float | None = setting(
        None,
        "of the load's encoder, load_position, if it differs; behind a gear it is needed, because "
        "counts_per_turn is the motor's",
        unit="counts",
        above=0,
    )
    load_counts_per_metre: float | None = setting(None, "likewise, of a linear encoder", unit="counts", above=0)

    def __post_init__(self) -> None:
        check_settings(self, RecordError)

    @property
    def place(self) -> Place:
        """Place of the axis in a trace."""
        return place_of(self.axis, self.joint)

    @property
    def traces(self) -> Profile | None:
        """The profile, if any."""
        return None if self.profile is None else load_profile(self.profile)

    def side(self, channel: str, column: Column | None) -> Side:
        """Transmission side of a channel: declared, by profile, or usual."""
        if column is not None and column.side is not None:
            return column.side
        signals = [] if self.traces is None else list(self.traces.channels.get(channel, ()))
        if self.traces is not None and column is not None and column.column:
            signals = list(self.traces.find(channel, index_columns([column.column]), self.place).values())
        usual: Side = "load" if channel == "load_position" else "motor"
        return signals[0].side or usual if signals else usual

    def resolve_unit(self, unit: units.Unit, kind: str, *, of_load: bool = False, geared: bool = False) -> units.Unit:
        """Return a unit with its factor to SI; other units are unchanged.

        Args:
            unit: of a channel.
            kind: of motion on the measured side.
            of_load: whether the load encoder measures it.
            geared: whether a gear separates it from the motor, so that the motor's counts do not apply.

        Raises:
            UnitError: a number is missing; the message is the end of a sentence.
        """
        number = {"current": self.torque_constant, "voltage": self.torque_per_volt}.get(unit.dimension)
        needed, known, turn = "", "", 2 * math.pi if kind == "revolute" else 1.0
        if unit.dimension == units.COUNTS:
            needed = f"load_{_COUNTS[kind]}" if of_load and geared else _COUNTS[kind]
            number = (getattr(self, f"load_{_COUNTS[kind]}") if of_load else None) or getattr(self, needed)
            known = "" if self.traces is None or kind == "prismatic" else self.traces.counts
        elif unit.dimension == units.SHARE:
            number, needed, known = self.rated_torque, "rated_torque", self.traces.rated_torque if self.traces else ""
        if number is None and needed:
            said = f" ({known})" if known else ""
            raise units.UnitError(f"which needs the {needed} of the drive{said}: give drive.{needed}, or another unit")
        if number is None:
            return unit
        if unit.dimension == units.COUNTS:
            return replace(units.unit(POSITION_UNIT[kind]), name=unit.name, factor=turn / number)
        return replace(units.unit(TORQUE_UNIT[kind]), name=unit.name, factor=unit.factor * number)


@dataclass(frozen=True, slots=True)
class Frame:
    """Side and unit of a joint's channels: drive, motion and transmission."""

    drive: Drive
    kind: str
    transmission: Transmission | None

    def kind_of(self, channel: str, column: Column | None) -> str:
        """Kind of motion on the side of a channel."""
        return self.kind if self.transmission is None else self.transmission.kind_of(self.drive.side(channel, column))

    def find_side(self, channel: str, column: Column) -> Column:
        """Assign a column to the load if only its motion has the unit."""
        if self.transmission is None or column.side is not None:
            return column
        motor, load = (known_units(channel, self.transmission.kind_of(side)) for side in SIDES)
        return replace(column, side="load") if column.stated_unit(load) in {*load} - {*motor} else column

    def unit_of(self, channel: str, columns: Mapping[str, Column]) -> units.Unit:
        """Return the unit of a channel's values with its factor to SI.

        Raises:
            UnitError: the unit does not fit, or a drive parameter is missing; the message is a predicate.
        """
        kind = self.kind_of(channel, columns[channel])
        known = known_units(channel, kind)
        of_torque = columns["torque"].stated_unit(known) if channel == "injected" and "torque" in columns else None
        usual = of_torque if of_torque in known else known[0]  # on another side it may be no unit here
        stated = columns[channel].stated_unit(known) or str(usual)
        of_load, ratio = channel == "load_position", 1.0 if self.transmission is None else self.transmission.ratio
        if stated not in known:
            said = unit_fault(stated, known)
            if ratio is not None and any(stated in known_units(channel, other) for other in units.POSITION_UNITS):
                said = f'is in "{stated}", and the joint is {kind}: correct its kind; a load that slides and a motor '
                said += 'that turns need kind "prismatic" and the lead of the transmission, as "10 mm" per turn'
            raise units.UnitError(said)
        try:
            return self.drive.resolve_unit(units.unit(stated), kind, of_load=of_load, geared=ratio not in (None, 1.0))
        except units.UnitError as error:
            raise units.UnitError(f'is in "{stated}", {error}') from None
