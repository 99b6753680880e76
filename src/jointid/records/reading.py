"""Read a record from a file: columns are selected, taken to SI and brought to one clock; all faults at once."""

from __future__ import annotations

import math
import os
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from jointid.common import units
from jointid.common.arrays import FloatArray
from jointid.common.errors import RecordError
from jointid.common.text import pluralise
from jointid.common.transmission import Transmission
from jointid.records.checks import scale_faults
from jointid.records.clock import (
    CLOCK_TOLERANCE,
    Clock,
    Cut,
    cut_table,
    find_clock,
    is_same_rate,
    own_clocks,
    seconds_of,
)
from jointid.records.columns import Column, find_wrap, finite_faults, known_units, unwrap, wrap_faults
from jointid.records.drives import Drive, Frame, index_columns
from jointid.records.formats import Table, read_table
from jointid.records.record import CHANNELS, Channel, Injection, Record, Tap, Timing, refer_channel
from jointid.records.resampling import Resampling, Signal, bring_together, find_filled_rows, find_refreshes

_POSITIONS = ("motor_position", "load_position", "reference")
_SAME_GAIN = 0.01  # relative
_TURNS_ON = 1.5  # wraps from which on a motor that travels so far turns on where its reference wraps


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
    them. Clocks that begin apart, and channels without a common instant, are resampled to the fastest, with a remark.
    The file's own unit applies where neither `columns` nor the column's name states one.

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
        resample: rules for a uniform clock.
        options: of the format's reader; see `jointid.records.formats.TextOptions`.

    Raises:
        RecordError: the file cannot be read, or contradicts its declaration; `faults` has a sentence for each fault.
    """
    cut = Cut(start, stop, part)
    reader = RecordReader(
        columns or {}, drive or Drive(), time, time_unit, sample_time, kind, transmission, name, clock_tolerance,
        resample, cut,
    )  # fmt: skip
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
        if unknown := [channel for channel in self.columns if channel not in CHANNELS]:
            raise RecordError(f"No channel is called {', '.join(unknown)}; there are {', '.join(CHANNELS)}.")
        if self.kind not in units.POSITION_UNITS:
            raise RecordError(f'A joint is "prismatic" or "revolute"; got {self.kind!r}.')

    def build_record(self, table: Table, name: str) -> Record:
        """Build the record that a table holds."""
        given = self.columns
        wanted = {n: Column(c) if isinstance(c := given[n], str) else c for n in CHANNELS if n in given}
        if any(column.sample_time or column.time for column in wanted.values()):
            table = _cut_tails(table)
        time = self.time
        if time is None and self.sample_time is None and self.drive.traces is not None:
            time = self.drive.traces.time_column(table.columns)
        stamped = self.resample is None and (self.time is not None or self.sample_time is None)
        table, repeated = cut_table(table, time, self.time_unit, self.sample_time, self.cut, repaired=stamped)
        # A sample time that is given alone is all that counts, unless a channel names its own column.
        stated = {} if time is None and self.sample_time is not None else own_clocks(table, self.time)
        steps = _Steps(self, table)
        columns = steps.select(wanted)
        logged = steps.unwrap(steps.log(columns, time, stated))
        signals = steps.convert(logged)
        if faults := [*steps.faults, *self._gain_faults(table)]:
            raise RecordError(faults)
        channels, begin, done, said = bring_together(signals, self.resample, self.clock_tolerance)
        # The file begins with the first row of its clocks, which no channel may use.
        first = min((float(one.clock.stamps[0]) for one in signals.values()), default=0.0)
        every = [float(table.columns[one][0]) * seconds_of(table, one, self.time_unit) for one in set(stated.values())]
        origin = min([*every, *(one.clock.first for one in signals.values())], default=first)
        record = replace(
            _build_record(channels, columns, self.name or name),
            begin=begin + (first - origin),
            resampled=done,
            remarks=(*repeated, *steps.remarks, *said),
        )
        if faults := scale_faults(record):
            raise RecordError(faults)
        return record

    def _gain_faults(self, table: Table) -> Iterator[str]:
        """Yield gains of the log that are not the declared ones."""
        profile = self.drive.traces
        if profile is None or not self.gains:
            return
        for name, gain in profile.gain_columns(index_columns(table.columns), self.drive.place).items():
            values = table.columns[name][np.isfinite(table.columns[name])]
            if gain.key not in self.gains or not values.size:
                continue
            low, high, declared = float(values.min()), float(values.max()), self.gains[gain.key]
            if max(abs(low - declared), abs(high - declared)) > _SAME_GAIN * max(abs(high), abs(declared)):
                yield (
                    f'{gain.name} (column "{name}") goes from {low:g} to {high:g} in the record, and '
                    f"controller.{gain.key} is {declared:g}; correct it, or cut the record by start and stop."
                )


@dataclass(frozen=True, slots=True, eq=False)
class _Logged:
    """Numbers of a channel as the file has them.

    Attributes:
        values: (samples,), at the rows in which there is a new one.
        clock: of these rows; None if it is at fault.
        unit: of the values; None if it is at fault.
        picked: whether these are some of the clock's rows.
        wrap: at which the values were unwrapped; 0 if not.
    """

    column: Column
    values: FloatArray
    clock: Clock | None
    unit: units.Unit | None
    picked: bool = False
    wrap: float = 0.0

    @property
    def factor(self) -> float:
        """Factor from the unit of the values to SI; 0 if the unit is at fault."""
        return 0.0 if self.unit is None else self.column.sign * self.column.gain * self.unit.factor


class _Steps:
    """Steps from a table to signals, with the faults and remarks on the way."""

    def __init__(self, reader: RecordReader, table: Table) -> None:
        self.reader, self.table, self.drive = reader, table, reader.drive
        self.frame = Frame(reader.drive, reader.kind, reader.transmission)
        self.faults, self.remarks = list[str](), list[str]()

    @contextmanager
    def _collecting(self) -> Iterator[None]:
        try:
            yield
        except RecordError as error:
            self.faults += error.faults

    def select(self, wanted: Mapping[str, Column]) -> dict[str, Column]:
        """Return the columns as declared, else by the drive's profile, else in the units of the file."""
        profile, table, said = self.drive.traces, self.table, ""
        found = {channel: column for channel, column in wanted.items() if column.column}
        if profile is not None:
            kinds = {channel: self.frame.kind_of(channel, wanted.get(channel)) for channel in CHANNELS}
            found, faults = profile.find_columns(wanted, table.columns, self.drive.place, kinds, table.source)
            self.faults += faults
            said = f'profile "{profile.name}"'
        elif unnamed := [channel for channel in wanted if channel not in found]:
            self.faults.append(f"{' and '.join(unnamed)} has no column; name it, or give the drive a profile.")
        for channel, column in found.items():
            declared = replace(wanted.get(channel, column), column=column.column)
            unit = units.normalise_unit(table.units.get(column.column, ""))
            known = known_units(channel, self.frame.kind_of(channel, column))
            if unit and declared.gain == 1 and declared.stated_unit(known) is None and unit != column.unit:
                found[channel] = replace(column, unit=unit)
                said = "the file" if channel == "torque" else said
        torque, asked = found.get("torque"), wanted.get("torque", Column()).unit == "A"
        if torque is not None and torque.unit == "A" and self.drive.torque_constant is None and not asked:
            self.faults.append(
                f'torque (column "{torque.column}") is in A by {said}; give the drive\'s '
                f'torque_constant, or unit = "A" with the column to identify per ampere.'
            )
        missing = {n: column for n, column in found.items() if column.column not in table.columns}
        if needed := {n: column.column for n, column in missing.items() if not column.optional}:
            listed = " and no ".join(f'"{column}" (for {n})' for n, column in needed.items())
            why = table.explain_missing(needed.values())
            self.faults.append(f"{table.source} has no column {listed}{why}; it has {table.list_columns()}.")
        return {n: column for n, column in found.items() if n not in missing}

    def log(self, columns: Mapping[str, Column], time: str | None, stated: Mapping[str, str]) -> dict[str, _Logged]:
        """Return the numbers of the channels with their stamps.

        Args:
            columns: of the channels.
            time: name of the record's time column, if known.
            stated: time columns of columns that have their own.
        """
        reader = self.reader
        resampled = reader.resample is not None
        rows = {n: find_filled_rows(self.table.columns[c.column], resampled=resampled) for n, c in columns.items()}
        times = {n: c.time or stated.get(c.column) for n, c in columns.items()}
        used = {times[n] for n, c in columns.items() if c.sample_time is None or rows[n] is not None}
        clocks = dict[str | None, Clock | None]()
        for one in sorted(used if time is None else used | {None}, key=str):
            clocks[one] = None
            named, period = (time, reader.sample_time) if one is None else (one, None)
            with self._collecting():
                tolerance = None if resampled else reader.clock_tolerance
                clocks[one] = find_clock(self.table, named, reader.time_unit, period, tolerance)
        made, common = dict[str, _Logged](), clocks.get(None)
        for name, column in columns.items():
            clock = clocks.get(times[name])
            if column.sample_time is not None and rows[name] is None:  # it begins with the record
                clock = Clock(column.sample_time, first=0.0 if common is None else common.first)
            made[name] = self._log_channel(name, columns, clock, rows[name])
        return made

    def _log_channel(
        self, name: str, columns: Mapping[str, Column], clock: Clock | None, rows: NDArray[np.bool_] | None
    ) -> _Logged:
        column, unit = columns[name], None
        values, what = self.table.columns[column.column], f'{name} (column "{column.column}")'
        size = None if clock is None or not clock.column else clock.stamps.size
        if size not in (None, values.size):
            self.faults.append(f"{what} has {values.size} samples, the time {size}; name columns of one length.")
            clock = None
        clock = None if clock is None else clock.over(values.size)
        if rows is not None:
            self._judge_rate(what, column, clock, rows)
        else:
            stamps = None if clock is None else clock.stamps
            self.faults += finite_faults(what, values, stamps, sparse=self.reader.resample is None)
            if column.update_time is not None and clock is not None and np.isfinite(values).all():
                with self._collecting():
                    rows = find_refreshes(what, values, clock.sample_time, column.update_time)
        if rows is not None:
            values, clock = values[rows], None if clock is None else clock.pick(rows)
        self.faults += column.misplaced_faults(name)
        if self.reader.transmission is None and column.side is not None:
            self.faults.append(
                f'{what} has side = "{column.side}", but no transmission is given; give it, or leave side out.'
            )
        try:
            unit = self.frame.unit_of(name, columns)
        except units.UnitError as error:
            self.faults.append(f"{what} {error}.")
        return _Logged(column, values, clock, unit, rows is not None)

    def _judge_rate(self, what: str, column: Column, clock: Clock | None, rows: NDArray[np.bool_]) -> None:
        """Remark on a channel with a number in some rows alone; another rate that is stated is a fault."""
        if clock is None or self.reader.resample is not None:
            return
        first, second = np.flatnonzero(rows)[:2]
        period, stated = (second - first) * clock.sample_time, column.sample_time or column.update_time
        said = f"{what} has a number in one row of {second - first}"
        if stated is not None and not is_same_rate(period, stated):
            self.faults.append(f"{said}, every {period:g} s, and is stated to have one every {stated:g} s; correct it.")
        self.remarks.append(f"{said}: it is read as a channel with a sample every {period:g} s")

    def unwrap(self, logged: Mapping[str, _Logged]) -> dict[str, _Logged]:
        """Unwrap positions whose wrap is declared or found; the motor's then begins in the turn of its reference."""
        made, wraps = dict(logged), {n: one.column.wrap for n, one in logged.items() if one.column.wrap is not None}
        for name, wrap in (wraps | self._find_wraps(logged)).items():
            one = logged[name]
            if np.isfinite(one.values).all():
                self.faults += wrap_faults(f'{name} (column "{one.column.column}")', one.values, wrap)
                made[name] = replace(one, values=unwrap(one.values, wrap), wrap=wrap)
        motor, reference = made.get("motor_position"), made.get("reference")
        if motor is None or not motor.wrap or reference is None or motor.clock is None or reference.clock is None:
            return made
        scale = self._on_joint("reference", reference) / (self._on_joint("motor_position", motor) or math.inf)
        there = np.interp(motor.clock.stamps, reference.clock.stamps, reference.values * scale)
        turns = np.median(there - motor.values) / motor.wrap
        made["motor_position"] = replace(motor, values=motor.values + motor.wrap * np.round(turns))
        return made

    def _find_wraps(self, logged: Mapping[str, _Logged]) -> dict[str, float]:
        """Return the wraps of positions that jump as at one, and say so.

        A measured position cannot go by its range in one sample. A reference can, as a saw tooth: it wraps where a
        measured one does, or turns on, or where none is logged and the jump is a known wrap.
        """
        open_ones = {n: logged[n] for n in _POSITIONS if n in logged and logged[n].column.wrap is None}
        found = {n: find_wrap(one.values, abs(2 * np.pi / one.factor)) for n, one in open_ones.items() if one.factor}
        jumps, made = {n: wrap for n, wrap in found.items() if wrap is not None}, dict[str, float]()
        motor = logged.get("motor_position")
        for name, wrap in jumps.items():
            certain = wrap.clear and (name != "reference" or motor is not None or wrap.known)
            if name == "reference" and motor is not None and "motor_position" not in jumps:
                scale = self._on_joint("motor_position", motor) / self._on_joint(name, logged[name])
                if np.ptp(motor.values) * abs(scale) < _TURNS_ON * wrap.size:
                    continue  # a saw tooth, which the motor follows
            said = f'{name} (column "{logged[name].column.column}") jumps {pluralise(wrap.count, "time")} by '
            said += f"{wrap.size:.10g} against its motion, first after sample {wrap.first}"
            made |= {name: wrap.size} if certain else {}
            does = "it wraps, and is unwrapped as with" if certain else "if it wraps, give its channel"
            self.remarks.append(f"{said}: {does} wrap = {wrap.size:.10g}")
        return made

    def _on_joint(self, name: str, one: _Logged) -> float:
        """SI units of a position on the joint's side to one of the column's."""
        gear = self.reader.transmission
        return one.factor if gear is None else one.factor * gear.position(self.drive.side(name, one.column))

    def convert(self, logged: Mapping[str, _Logged]) -> dict[str, Signal]:
        """Return the signals in SI on the joint's side; without those whose unit or clock is at fault."""
        made, gear = dict[str, Signal](), self.reader.transmission
        for name, one in logged.items():
            column, held = one.column, name in ("torque", "injected")
            if one.unit is None or one.clock is None:
                continue
            channel = Channel(
                one.values * one.factor,
                one.unit.si,
                one.clock.sample_time,
                column.timing or (Timing.HELD if held else Timing.SAMPLED),
                f"{self.table.source}: {column.column}",
                stated=column.timing is not None or not held,
            )
            if gear is not None:
                channel = refer_channel(gear, name, channel, self.drive.side(name, column))
            made[name] = Signal(channel, one.clock, one.picked)
        return made


def _cut_tails(table: Table) -> Table:
    """Cut each column after its last number, if it has one in every row until then."""
    cut = {}
    for name, values in table.columns.items():
        filled = np.flatnonzero(~np.isnan(values))
        cut[name] = values[: filled.size] if filled.size and filled[-1] + 1 == filled.size else values
    return replace(table, columns=cut)


def _build_record(channels: Mapping[str, Channel], found: Mapping[str, Column], name: str) -> Record:
    torque, injected = channels.get("torque"), channels.get("injected")
    if torque is not None and injected is not None and torque.unit != injected.unit:
        raise RecordError(
            f"The torque is in {torque.unit}, the injected signal in {injected.unit}; give both in one unit."
        )
    given: dict[str, Any] = dict(channels)
    if torque is not None:
        given["tap"] = found["torque"].tap or Tap.COMMAND
    if injected is not None:
        given["injected"] = Injection(injected, found["injected"].at, found["injected"].in_torque)
    return Record(**given, name=name)
