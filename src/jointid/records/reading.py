"""Read a record from a file: clock and channels in SI, with all faults at once."""

from __future__ import annotations

import os
import re
from collections.abc import Collection, Iterator, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from jointid.common import units
from jointid.common.errors import RecordError
from jointid.common.text import pluralise
from jointid.common.transmission import Transmission
from jointid.records.checks import scale_faults
from jointid.records.clock import (
    CLOCK_TOLERANCE,
    Clock,
    Clocks,
    Cut,
    beginning_faults,
    cut_table,
    find_clock,
    is_same_rate,
    own_clocks,
    seconds_of,
)
from jointid.records.columns import (
    Column,
    Wrap,
    fill_forward,
    find_rows_with_number,
    find_wrap,
    finite_faults,
    known_units,
    unit_fault,
    unit_of_column,
    unwrap,
    wrap_faults,
)
from jointid.records.drives import Drive, index_columns
from jointid.records.formats import Table, read_table
from jointid.records.record import CHANNELS, Channel, Injection, Record, Tap, Timing, refer_channel
from jointid.records.resampling import Resampling, Stamped, align_updates, judge_jitter, resample_together

_MOVES = 0.01  # of this axis's travel: an axis that moves less is held
_POSITIONS = ("motor_position", "load_position", "reference")
_SAME_GAIN = 0.01  # relative
_TURNS_ON = 1.5  # wraps from which on a motor that travels so far turns on where its reference wraps
_NUMBER = re.compile(r"\d+")


def read(
    path: str | os.PathLike[str],
    columns: Mapping[str, str | Column] | None = None,
    *,
    drive: Drive | None = None,
    time: str | None = None,
    time_unit: str | None = None,
    sample_time: float | None = None,
    kind: str = "revolute",
    transmission: Transmission | None = None,
    name: str | None = None,
    clock_tolerance: float = CLOCK_TOLERANCE,
    resample: Resampling | None = None,
    start: float | None = None,
    stop: float | None = None,
    part: int | None = None,
    **options: object,
) -> Record:
    """Read a record from a file, and report all faults at once.

    The clock is `sample_time`, or the time column: named by `time`, or the only one called t or time (as "Time [ms]").
    Channels of different rates end at their last number; otherwise an early end is a fault. A jump of the
    clock is a fault unless `resample` or `part` is given. Where stamps jitter, a position tells whether samples follow
    them. The file's own unit applies where neither `columns` nor the column's name states one.

    Args:
        path: the file; its suffix selects the format.
        columns: channel of `CHANNELS` -> column name or `Column`. A drive's profile finds those left out.
        drive: factors for counts, shares of rated torque and ampere, and the profile of the traces.
        time: name of the time column.
        time_unit: unit of the time column; None takes the one in its name, or else s.
        sample_time: time between samples [s]; it must agree with `time`.
        kind: "revolute" (rad, rad/s, N m unless a column says otherwise) or "prismatic" (m, m/s, N).
        transmission: between motor and load; it sets both kinds and refers every channel to its `side`.
        name: of the record in reports; None takes the file's name without suffix.
        clock_tolerance: largest jitter of the time stamps that is not remarked on, as a share of the sample time.
        start: first instant to read, in seconds of the log's own clock.
        stop: last one.
        part: which part between jumps of the clock to read, counted from 1; 0 takes the longest.
        resample: rules for a uniform clock; every channel then needs stamps.
        options: of the format's reader; see `jointid.records.formats.check_options`.

    Raises:
        RecordError: the file cannot be read, or contradicts its declaration; `faults` has a sentence for each fault.
    """
    reader = RecordReader(
        columns or {},
        drive or Drive(),
        time,
        time_unit,
        sample_time,
        kind,
        transmission,
        name,
        clock_tolerance,
        resample,
        Cut(start, stop, part),
    )
    return reader.build_record(read_table(path, **options), Path(path).stem)


@dataclass(frozen=True, slots=True)
class RecordReader:
    """Settings that turn a table into a record; see `read`.

    Attributes:
        gains: of the declared controller, by its keys: what columns of gains are held against.
    """

    columns: Mapping[str, str | Column]
    drive: Drive
    time: str | None = None
    time_unit: str | None = None
    sample_time: float | None = None
    kind: str = "revolute"
    transmission: Transmission | None = None
    name: str | None = None
    clock_tolerance: float = CLOCK_TOLERANCE
    resample: Resampling | None = None
    cut: Cut = field(default_factory=Cut)
    gains: Mapping[str, float] = field(default_factory=dict)

    def __post_init__(self) -> None:
        unknown = [channel for channel in self.columns if channel not in CHANNELS]
        if unknown:
            raise RecordError(f"No channel is called {', '.join(unknown)}; there are {', '.join(CHANNELS)}.")
        if self.kind not in units.POSITION_UNITS:
            raise RecordError(f'A joint is "prismatic" or "revolute"; got {self.kind!r}.')

    def build_record(self, table: Table, name: str) -> Record:
        """Build the record that a table holds."""
        columns = self.columns
        wanted = {n: Column(c) if isinstance(c := columns[n], str) else c for n in CHANNELS if n in columns}
        if any(column.sample_time or column.time for column in wanted.values()):
            table = _cut_tails(table)
        table, repeated = self._cut(table)
        source = _Columns(table, self.kind, self.transmission, self.drive, [])
        found = source.apply_file_units(wanted, source.find_columns(source.apply_profile(wanted)))
        source, rows = source.fill_rows(found, resampled=self.resample is not None)
        rates = {n: found[n].sample_time or found[n].update_time for n in rows}
        found |= {n: replace(found[n], sample_time=None, update_time=None) for n in rows}
        found, remarks = source.find_wraps(found)
        clocks = self._clocks(table, found, source.faults)
        if self.resample is None:
            remarks.extend(source.name_rates(found, clocks, rows, rates))
        source.faults.extend(source.gain_faults(self.gains))
        read_in = {channel: source.build_channel(channel, found, clocks) for channel in found}
        if self.resample is None:
            source.faults.extend(
                beginning_faults(
                    {n: clocks.clock_of(c) for n, c in found.items()}, self.clock_tolerance, cuts=bool(clocks.columns)
                )
            )
        if source.faults:
            raise RecordError(source.faults)
        logged = source.align_turns({n: c for n, c in read_in.items() if c is not None}, found)
        others = source.find_other_positions(found, clocks)
        done, resample = None, self.resample
        used = {n: clock for n, c in found.items() if (clock := clocks.clock_of(c)).jitter}
        if resample is None and used:
            resample, uniform, said = judge_jitter({n: c for n, c in logged.items() if n not in rows}, used)
            clocks = clocks.straighten(uniform)
            remarks.append(said)
        if resample is None:
            updates = {n: column.update_time for n, column in found.items()}
            channels, begin = align_updates({**logged, **others}, updates, rows)
        else:
            stamped = _add_stamps(logged, others, found, clocks, rows)
            channels, begin, done = resample_together(stamped, resample)
        apart = {n: channels.pop(n) for n in others}
        record = replace(
            _build_record(channels, found, self.name or name),
            other_axes=apart,
            begin=begin + self._late(table, clocks, found),
            resampled=done,
            remarks=(*repeated, *remarks),
        )
        faults = scale_faults(record)
        if faults:
            raise RecordError(faults)
        return record

    def _cut(self, table: Table) -> tuple[Table, list[str]]:
        stamped = self.resample is None and (self.time is not None or self.sample_time is None)
        return cut_table(table, self._find_time(table), self.time_unit, self.sample_time, self.cut, repaired=stamped)

    def _find_time(self, table: Table) -> str | None:
        """Name of the time column, if it is stated or the drive's profile knows it."""
        if self.time is None and self.sample_time is None and self.drive.traces is not None:
            return self.drive.traces.time_column(table.columns)
        return self.time

    def _late(self, table: Table, clocks: Clocks, found: Mapping[str, Column]) -> float:
        """Seconds from the first sample of a table to that of these channels, for columns with several clocks."""
        used = [stamps[0] for c in found.values() if (stamps := clocks.clock_of(c).stamps) is not None]
        every = [table.columns[n][0] * seconds_of(table, n, self.time_unit) for n in set(clocks.columns.values())]
        late = float(min(used) - min(every)) if used and every else 0.0
        return late if late > 0.0 else 0.0

    def _clocks(self, table: Table, found: Mapping[str, Column], faults: list[str]) -> Clocks:
        time = self._find_time(table)
        # A sample time that is given alone is all that counts, unless a channel names its own column.
        stated = {} if time is None and self.sample_time is not None else own_clocks(table, self.time)
        clocks = {c.time or stated.get(c.column) for c in found.values() if c.sample_time is None}
        tolerance = None if self.resample else self.clock_tolerance
        common = Clock(self.sample_time)
        if time is not None or None in clocks:
            common, wrong = find_clock(table, time, self.time_unit, self.sample_time, tolerance)
            faults.extend(wrong)
        own = {}
        for name in sorted(filter(None, clocks)):
            own[name], wrong = find_clock(table, name, self.time_unit, None, tolerance)
            faults.extend(wrong)
        return Clocks(common, own, stated)


@dataclass(frozen=True, slots=True)
class _Columns:
    """Table columns for channels; faults are collected."""

    table: Table
    kind: str
    transmission: Transmission | None
    drive: Drive
    faults: list[str]

    def apply_profile(self, wanted: Mapping[str, Column]) -> Mapping[str, Column]:
        """Complete the columns from the drive's profile."""
        profile = self.drive.traces
        if profile is not None:
            kinds = {channel: self.kind_of(channel, wanted.get(channel)) for channel in CHANNELS}
            found, faults = profile.find_columns(wanted, self.table.columns, self.drive.place, kinds, self.table.source)
            self.faults.extend(faults)
            self.faults.extend(self.undeclared_current_faults(wanted, found, f'profile "{profile.name}"'))
            return found
        unnamed = [channel for channel, column in wanted.items() if not column.column]
        if unnamed:
            self.faults.append(f"{' and '.join(unnamed)} has no column; name it, or give the drive a profile.")
        return {channel: column for channel, column in wanted.items() if column.column}

    def apply_file_units(self, wanted: Mapping[str, Column], found: Mapping[str, Column]) -> dict[str, Column]:
        """Apply the file's units where none is declared."""
        made = dict(found)
        for channel, column in found.items():
            declared = replace(wanted.get(channel, column), column=column.column)
            unit = units.normalise_unit(self.table.units.get(column.column, ""))
            known = known_units(channel, self.kind_of(channel, column))
            if unit and declared.gain == 1 and declared.stated_unit(known) is None and unit != column.unit:
                made[channel] = replace(column, unit=unit)
                torque = {channel: made[channel]}
                self.faults.extend(
                    self.undeclared_current_faults(wanted, torque, "the file") if channel == "torque" else []
                )
        return made

    def undeclared_current_faults(
        self, wanted: Mapping[str, Column], found: Mapping[str, Column], said: str
    ) -> list[str]:
        """Faults of a current that serves as torque without declaration.

        Results in A have to be requested.
        """
        torque = found.get("torque")
        if torque is None or torque.unit != "A" or self.drive.torque_constant is not None:
            return []
        if "torque" in wanted and wanted["torque"].unit == "A":
            return []
        return [
            f'torque (column "{torque.column}") is in A by {said}; give the drive\'s '
            f'torque_constant, or unit = "A" with the column to identify per ampere.'
        ]

    def find_columns(self, wanted: Mapping[str, Column]) -> dict[str, Column]:
        """Return the existing columns; a missing required one is a fault."""
        missing = {n: column for n, column in wanted.items() if column.column not in self.table.columns}
        needed = [f'"{column.column}" (for {n})' for n, column in missing.items() if not column.optional]
        if needed:
            listed = self.table.list_columns()
            why = self.table.explain_missing(column.column for column in missing.values() if not column.optional)
            self.faults.append(f"{self.table.source} has no column {' and no '.join(needed)}{why}; it has {listed}.")
        return {n: column for n, column in wanted.items() if n not in missing}

    def gain_faults(self, declared: Mapping[str, float]) -> Iterator[str]:
        """Yield gains of the log that vary, or differ from the declared ones."""
        profile = self.drive.traces
        if profile is None or not declared:
            return
        columns = profile.gain_columns(index_columns(self.table.columns), self.drive.place)
        for name, gain in columns.items():
            values = self.table.columns[name][np.isfinite(self.table.columns[name])]
            if gain.key not in declared or not values.size:
                continue
            low, high, said = float(values.min()), float(values.max()), f'{gain.name} (column "{name}")'
            if high - low > _SAME_GAIN * abs(high):
                yield (
                    f"{said} varies from {low:g} to {high:g}, and the controller has one {gain.key}, "
                    f"{declared[gain.key]:g}; read a part in which it is constant, by record.start and record.stop."
                )
            elif abs(high - declared[gain.key]) > _SAME_GAIN * max(abs(high), abs(declared[gain.key])):
                yield (
                    f"{said} is {high:g} in the record, and controller.{gain.key} is {declared[gain.key]:g}; "
                    "correct the wrong one."
                )

    def fill_rows(
        self, found: Mapping[str, Column], *, resampled: bool
    ) -> tuple[_Columns, dict[str, NDArray[np.bool_]]]:
        """Fill the empty rows of channels that are logged more seldom than others; return the rows with a number."""
        sought = {n: find_rows_with_number(self.table.columns[c.column], resampled=resampled) for n, c in found.items()}
        rows = {n: filled for n, filled in sought.items() if filled is not None}
        whole = {found[n].column: fill_forward(self.table.columns[found[n].column], rows[n]) for n in rows}
        return replace(self, table=replace(self.table, columns={**self.table.columns, **whole})), rows

    def name_rates(
        self,
        found: Mapping[str, Column],
        clocks: Clocks,
        rows: Mapping[str, NDArray[np.bool_]],
        rates: Mapping[str, float | None],
    ) -> Iterator[str]:
        """Yield remarks on channels with a number in some rows alone; another rate that is stated is a fault."""
        for name, filled in rows.items():
            first, second = np.flatnonzero(filled)[:2]
            period, stated = (second - first) * (clocks.clock_of(found[name]).sample_time or np.nan), rates[name]
            said = f'{name} (column "{found[name].column}") has a number in one row of {second - first}'
            if stated is not None and not is_same_rate(period, stated):
                self.faults.append(
                    f"{said}, every {period:g} s, and is stated to have one every {stated:g} s; correct its "
                    "sample_time or update_time, or leave it out."
                )
            yield f"{said}: it is read as a channel with a sample every {period:g} s"

    def kind_of(self, channel: str, column: Column | None) -> str:
        """Kind of motion on the side of a channel."""
        if self.transmission is None:
            return self.kind
        return self.transmission.kind_of(self.drive.side(channel, column))

    def resolve_unit(
        self, what: str, name: str, known: tuple[str, ...], kind: str, *, of_load: bool
    ) -> units.Unit | None:
        """Resolve a unit; one not among `known` is a fault."""
        if name in known:
            try:
                geared = self.transmission is not None and self.transmission.geared
                return self.drive.resolve_unit(units.unit(name), kind, of_load=of_load, geared=geared)
            except units.UnitError as error:
                self.faults.append(f'{what} is in "{name}", {error}.')
                return None
        self.faults.append(unit_fault(what, name, known))
        return None

    def build_channel(self, name: str, found: Mapping[str, Column], clocks: Clocks) -> Channel | None:
        """Build a channel in SI; None if its unit or rate is at fault."""
        column = found[name]
        what, values = f'{name} (column "{column.column}")', self.table.columns[column.column]
        clock = clocks.clock_of(column)
        period, stamps = clock.sample_time, clock.stamps
        if stamps is None:
            stamps = None if period is None else Channel(values, "", period).time
        elif stamps.size != values.size:
            lengths = f"{values.size} samples, the time {stamps.size}"
            self.faults.append(f"{what} has {lengths}; name columns of one length.")
            stamps = None
        remedy = "mend them, or cut the record there"
        if stamps is not None and np.isnan(values).any():
            remedy += ", or give resample, which takes every channel at the rows in which it has a number"
        faults = [*finite_faults(what, values, stamps, remedy), *column.misplaced_faults(name)]
        if column.wrap is not None and not faults:
            faults = wrap_faults(what, values, column.wrap)
            values = unwrap(values, column.wrap)
        self.faults.extend(faults)

        gear, kind = self.transmission, self.kind_of(name, column)
        if gear is None and column.side is not None:
            self.faults.append(
                f'{what} has side = "{column.side}", but no transmission is given; give it, or leave side out.'
            )
        stated = unit_of_column(name, found, kind)
        unit = self.resolve_unit(what, stated, known_units(name, kind), kind, of_load=name == "load_position")
        if unit is None or period is None:
            return None
        held = name in ("torque", "injected")
        channel = Channel(
            values * (column.sign * column.gain * unit.factor),
            unit.si,
            period,
            column.timing or (Timing.HELD if held else Timing.SAMPLED),
            f"{self.table.source}: {column.column}",
            stated=column.timing is not None or not held,
        )
        if gear is None:
            return channel
        return refer_channel(gear, name, channel, self.drive.side(name, column))

    def find_wraps(self, found: Mapping[str, Column]) -> tuple[dict[str, Column], list[str]]:
        """Set the wrap of positions that jump as at one; return the columns, and what is to be said of them.

        A measured position cannot go by its range in one sample. A reference can, as a saw tooth: it wraps where a
        measured one does, or turns on, or where none is logged and the jump is a known wrap.
        """
        jumps, made, remarks = dict[str, Wrap](), dict(found), list[str]()
        for name in _POSITIONS:
            if name in found and found[name].wrap is None and (factor := self.factor_of(name, found, own=True)):
                values = self.table.columns[found[name].column]
                wrap = find_wrap(values, abs(2 * np.pi / factor)) if values.size else None
                jumps |= {} if wrap is None else {name: wrap}
        motor = self.table.columns[found["motor_position"].column] if "motor_position" in found else None
        for name, wrap in jumps.items():
            jump = f'{name} (column "{found[name].column}") jumps {pluralise(wrap.count, "time")} by '
            jump += f"{wrap.size:.10g} against its motion, first after sample {wrap.first}"
            certain = wrap.clear
            if name == "reference" and motor is not None:
                scale = abs(self.factor_of("motor_position", found) / self.factor_of(name, found))
                if "motor_position" not in jumps and np.ptp(motor) * scale < _TURNS_ON * wrap.size:
                    continue  # a saw tooth, which the motor follows
            elif name == "reference":
                certain = certain and wrap.known
            if certain:
                made[name] = replace(found[name], wrap=wrap.size)
                remarks.append(f"{jump}: it wraps, and is unwrapped as with wrap = {wrap.size:.10g}")
            else:
                remarks.append(f"{jump}: if it wraps, give its channel wrap = {wrap.size:.10g}")
        return made, remarks

    def factor_of(self, name: str, found: Mapping[str, Column], *, own: bool = False) -> float:
        """SI units, on the joint's side or the column's own, to one of a position's; 0 if its unit is at fault."""
        column, kind = found[name], self.kind_of(name, found[name])
        known, load = known_units(name, kind), name == "load_position"
        unit = replace(self, faults=[]).resolve_unit(name, unit_of_column(name, found, kind), known, kind, of_load=load)
        gear = self.transmission
        side = 1.0 if gear is None or own else gear.position(self.drive.side(name, column))
        return 0.0 if unit is None else column.sign * column.gain * unit.factor * side

    def align_turns(self, logged: Mapping[str, Channel], found: Mapping[str, Column]) -> dict[str, Channel]:
        """Bring a motor position that was unwrapped to the turn of its reference."""
        made = dict(logged)
        motor, reference = made.get("motor_position"), made.get("reference")
        if motor is not None and reference is not None and (wrap := found["motor_position"].wrap) is not None:
            turn = abs(wrap * self.factor_of("motor_position", found))
            apart = float(np.median(np.interp(motor.time, reference.time, reference.values) - motor.values))
            if apart := turn * round(apart / turn):
                made["motor_position"] = replace(motor, values=motor.values + apart)
        return made

    def find_other_positions(self, found: Mapping[str, Column], clocks: Clocks) -> dict[str, Channel]:
        """Positions of other moving axes, by column, if readable."""
        position = _own_position(found)
        own = position and replace(self, faults=[]).build_channel(position, found, clocks)
        made: dict[str, Channel] = {}
        if not (position and own):
            return made
        # A profile knows the side of this axis's column, and nothing of the others'.
        side = self.drive.side(position, found[position])
        alike = replace(found[position], side=None if self.transmission is None else side)
        for name in find_other_axes({channel: column.column for channel, column in found.items()}, self.table.columns):
            apart = replace(self, faults=[])
            other = apart.build_channel(position, {**found, position: replace(alike, column=name)}, clocks)
            if other and not apart.faults and np.ptp(other.values) > _MOVES * np.ptp(own.values):
                made[name] = other
        return made


def _cut_tails(table: Table) -> Table:
    """Cut each column after its last number, if it has one in every row until then."""
    cut = {}
    for name, values in table.columns.items():
        filled = np.flatnonzero(~np.isnan(values))
        cut[name] = values[: filled.size] if filled.size and filled[-1] + 1 == filled.size else values
    return replace(table, columns=cut)


def _add_stamps(
    logged: Mapping[str, Channel],
    others: Mapping[str, Channel],
    found: Mapping[str, Column],
    clocks: Clocks,
    rows: Mapping[str, NDArray[np.bool_]],
) -> dict[str, Stamped]:
    """Attach instants to channels, of the rows in which they have a number; refuse missing stamps or refreshes."""
    faults = []
    made = {}
    position = _own_position(found)
    for name, channel in {**logged, **others}.items():
        column = found[name] if name in found else replace(found[position], column=name)
        clock = clocks.clock_of(column)
        if column.update_time is not None:
            faults.append(f"{name} has an update_time, and is to be resampled; leave one of the two out.")
        elif clock.stamps is None:
            faults.append(f"{name} has no time stamps to be resampled by; name its time column, or leave resample out.")
        elif (filled := rows.get(name)) is None:
            made[name] = Stamped(channel, clock.stamps, clock.column)
        else:
            own = replace(channel, values=channel.values[filled])
            made[name] = Stamped(own, clock.stamps[filled], f"{clock.column}, {column.column}")
    if faults:
        raise RecordError(faults)
    return made


def _build_record(channels: Mapping[str, Channel], found: Mapping[str, Column], name: str) -> Record:
    torque, injected = channels.get("torque"), channels.get("injected")
    if torque is not None and injected is not None and torque.unit != injected.unit:
        raise RecordError(
            f"The torque is in {torque.unit}, the injected signal in {injected.unit}; give both in one unit."
        )
    return Record(
        torque=torque,
        tap=Tap.COMMAND if torque is None else found["torque"].tap or Tap.COMMAND,
        reference=channels.get("reference"),
        reference_velocity=channels.get("reference_velocity"),
        motor_position=channels.get("motor_position"),
        load_position=channels.get("load_position"),
        injected=None if injected is None else Injection(injected, found["injected"].at, found["injected"].in_torque),
        name=name,
    )


def _own_position(channels: Collection[str]) -> str:
    """Column that distinguishes this axis, or an empty name."""
    return next((channel for channel in ("motor_position", "reference") if channel in channels), "")


def find_other_axes(channels: Mapping[str, str], names: Collection[str]) -> tuple[str, ...]:
    """Position columns of other axes, in the log's order.

    The axis number appears in several names: `pos[2]` and `torque[2]` beside `pos[0]` and `torque[0]`. A single
    numbered name is no evidence. `channels` has the columns of this joint, `names` all column names.
    """
    numbered = {channel: dict(_axis_numbers(column, names)) for channel, column in channels.items()}
    position = _own_position(channels)
    if not position:
        return ()
    for number, others in numbered[position].items():
        alike = [channel for channel, found in numbered.items() if number in found]
        if len({numbered[channel][number] for channel in alike}) > 1:
            return tuple(name for name in names if name in others and name not in channels.values())
    return ()


def _axis_numbers(column: str, names: Collection[str]) -> Iterator[tuple[int, frozenset[str]]]:
    """Yield each varying number in a column name, with the related columns."""
    for match in _NUMBER.finditer(column):
        alike = re.compile(re.escape(column[: match.start()]) + r"\d+" + re.escape(column[match.end() :]))
        others = frozenset(name for name in names if name != column and alike.fullmatch(name))
        if others:
            yield int(match[0]), others
