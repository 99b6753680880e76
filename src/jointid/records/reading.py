"""Read a record from a file: clock and channels in SI, with all faults at once."""

from __future__ import annotations

import os
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from jointid.common import units
from jointid.common.arrays import FloatArray
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
    unwrap,
    wrap_faults,
)
from jointid.records.drives import Drive, Frame, index_columns
from jointid.records.formats import Table, read_table
from jointid.records.record import CHANNELS, Channel, Injection, Record, Tap, Timing, refer_channel
from jointid.records.resampling import (
    Resampling,
    Stamped,
    align_updates,
    find_refreshes,
    judge_jitter,
    resample_together,
)

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
        options: of the format's reader; see `jointid.records.formats.TextOptions`.

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
        time = self._find_time(table)
        stamped = self.resample is None and (self.time is not None or self.sample_time is None)
        table, repeated = cut_table(table, time, self.time_unit, self.sample_time, self.cut, repaired=stamped)
        signals = _Signals(self, table, wanted)
        clocks = self._find_clocks(table, time, signals.columns, signals.faults)
        signals.name_rates(clocks)
        signals.faults.extend(self._gain_faults(table))
        logged = signals.build_channels(clocks)
        used = {n: clocks.clock_of(c) for n, c in signals.columns.items()}
        if self.resample is None:
            signals.faults.extend(beginning_faults(used, self.clock_tolerance, cuts=bool(clocks.columns)))
        if signals.faults:
            raise RecordError(signals.faults)
        logged = signals.align_turns(logged)
        done, resample, remarks = None, self.resample, signals.remarks
        if resample is None and (jittered := {n: clock for n, clock in used.items() if clock.jitter}):
            resample, uniform, said = judge_jitter({n: c for n, c in logged.items() if n not in signals.rows}, jittered)
            clocks = clocks.straighten(uniform)
            remarks.append(said)
        if resample is None:
            channels, begin = align_updates(logged, signals.rows)
        else:
            channels, begin, done = resample_together(signals.add_stamps(logged, clocks), resample)
        first = [stamps[0] for clock in used.values() if (stamps := clock.stamps) is not None]
        every = [table.columns[n][0] * seconds_of(table, n, self.time_unit) for n in set(clocks.columns.values())]
        late = max(float(min(first) - min(every)), 0.0) if first and every else 0.0
        record = replace(
            _build_record(channels, signals.columns, self.name or name),
            begin=begin + late,
            resampled=done,
            remarks=(*repeated, *remarks),
        )
        if faults := scale_faults(record):
            raise RecordError(faults)
        return record

    def _find_time(self, table: Table) -> str | None:
        """Name of the time column, if it is stated or the drive's profile knows it."""
        if self.time is None and self.sample_time is None and self.drive.traces is not None:
            return self.drive.traces.time_column(table.columns)
        return self.time

    def _find_clocks(self, table: Table, time: str | None, columns: Mapping[str, Column], faults: list[str]) -> Clocks:
        # A sample time that is given alone is all that counts, unless a channel names its own column.
        stated = {} if time is None and self.sample_time is not None else own_clocks(table, self.time)
        clocks = {c.time or stated.get(c.column) for c in columns.values() if c.sample_time is None}
        tolerance = None if self.resample else self.clock_tolerance
        common, own = Clock(), dict[str, Clock]()
        with _collect(faults):
            if time is None and None not in clocks:
                common = Clock(self.sample_time)
            else:
                common = find_clock(table, time, self.time_unit, self.sample_time, tolerance)
            for name in sorted(filter(None, clocks)):
                own[name] = find_clock(table, name, self.time_unit, None, tolerance)
        return Clocks(common, own, stated)

    def _gain_faults(self, table: Table) -> Iterator[str]:
        """Yield gains of the log that vary, or differ from the declared ones."""
        profile, declared = self.drive.traces, self.gains
        if profile is None or not declared:
            return
        for name, gain in profile.gain_columns(index_columns(table.columns), self.drive.place).items():
            values = table.columns[name][np.isfinite(table.columns[name])]
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


@contextmanager
def _collect(faults: list[str]) -> Iterator[None]:
    """Add the faults of an error to those that are found already."""
    try:
        yield
    except RecordError as error:
        faults.extend(error.faults)


class _Signals:
    """Columns of the channels, with their faults and corrections.

    Attributes:
        columns: of the channels, with their units and wraps.
        values: of the channels, (samples,), as the file has them; empty rows of slower ones are filled.
        rows: of the channels that are logged more seldom, the rows with a number, (samples,).
        rates: that were stated of these.
    """

    def __init__(self, reader: RecordReader, table: Table, wanted: Mapping[str, Column]) -> None:
        self.table, self.drive, self.transmission = table, reader.drive, reader.transmission
        self.frame = Frame(reader.drive, reader.kind, reader.transmission)
        self.faults, self.remarks = list[str](), list[str]()
        found = self._select(wanted)
        self.values = {n: table.columns[column.column] for n, column in found.items()}
        resampled = reader.resample is not None
        filled = {n: find_rows_with_number(values, resampled=resampled) for n, values in self.values.items()}
        self.rows = {n: rows for n, rows in filled.items() if rows is not None}
        self.values |= {n: fill_forward(self.values[n], rows) for n, rows in self.rows.items()}
        self.rates = {} if resampled else {n: found[n].sample_time or found[n].update_time for n in self.rows}
        self.columns = found | {n: replace(found[n], sample_time=None, update_time=None) for n in self.rows}
        self._find_wraps()

    def _select(self, wanted: Mapping[str, Column]) -> dict[str, Column]:
        """Return the columns as declared, else by the drive's profile, else in the units of the file."""
        profile, table, said = self.drive.traces, self.table, ""
        found = {channel: column for channel, column in wanted.items() if column.column}
        if profile is not None:
            kinds = {channel: self.frame.kind_of(channel, wanted.get(channel)) for channel in CHANNELS}
            found, faults = profile.find_columns(wanted, table.columns, self.drive.place, kinds, table.source)
            self.faults.extend(faults)
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
        needed = {n: column.column for n, column in missing.items() if not column.optional}
        if needed:
            listed = " and no ".join(f'"{column}" (for {n})' for n, column in needed.items())
            why = table.explain_missing(needed.values())
            self.faults.append(f"{table.source} has no column {listed}{why}; it has {table.list_columns()}.")
        return {n: column for n, column in found.items() if n not in missing}

    def name_rates(self, clocks: Clocks) -> None:
        """Remark on channels with a number in some rows alone; another rate that is stated is a fault."""
        for name, stated in self.rates.items():
            first, second = np.flatnonzero(self.rows[name])[:2]
            period = (second - first) * (clocks.clock_of(self.columns[name]).sample_time or np.nan)
            said = f'{name} (column "{self.columns[name].column}") has a number in one row of {second - first}'
            if stated is not None and not is_same_rate(period, stated):
                self.faults.append(
                    f"{said}, every {period:g} s, and is stated to have one every {stated:g} s; correct its "
                    "sample_time or update_time, or leave it out."
                )
            self.remarks.append(f"{said}: it is read as a channel with a sample every {period:g} s")

    def build_channels(self, clocks: Clocks) -> dict[str, Channel]:
        """Return the channels in SI; without those whose unit or rate is at fault."""
        made = dict[str, Channel]()
        for name, column in self.columns.items():
            channel = self._build_channel(name, self.columns, self.values[name], clocks, self.faults)
            made |= {} if channel is None else {name: channel}
            if channel is not None and column.update_time is not None:
                with _collect(self.faults):
                    self.rows[name] = find_refreshes(f"{name} ({channel.source})", channel, column.update_time)
        return made

    def _build_channel(
        self, name: str, columns: Mapping[str, Column], values: FloatArray, clocks: Clocks, faults: list[str]
    ) -> Channel | None:
        column = columns[name]
        what, clock = f'{name} (column "{column.column}")', clocks.clock_of(column)
        period, stamps = clock.sample_time, clock.stamps
        if stamps is None:
            stamps = None if period is None else Channel(values, "", period).time
        elif stamps.size != values.size:
            faults.append(f"{what} has {values.size} samples, the time {stamps.size}; name columns of one length.")
            stamps = None
        remedy = "mend them, or cut the record there"
        if stamps is not None and np.isnan(values).any():
            remedy += ", or give resample, which takes every channel at the rows in which it has a number"
        wrong = [*finite_faults(what, values, stamps, remedy), *column.misplaced_faults(name)]
        if column.wrap is not None and not wrong:
            wrong = wrap_faults(what, values, column.wrap)
            values = unwrap(values, column.wrap)
        if self.transmission is None and column.side is not None:
            wrong.append(
                f'{what} has side = "{column.side}", but no transmission is given; give it, or leave side out.'
            )
        faults.extend(wrong)
        try:
            unit = self.frame.unit_of(name, columns)
        except units.UnitError as error:
            faults.append(f"{what} {error}.")
            return None
        if period is None:
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
        gear = self.transmission
        return channel if gear is None else refer_channel(gear, name, channel, self.drive.side(name, column))

    def _find_wraps(self) -> None:
        """Set the wrap of positions that jump as at one, and say so.

        A measured position cannot go by its range in one sample. A reference can, as a saw tooth: it wraps where a
        measured one does, or turns on, or where none is logged and the jump is a known wrap.
        """
        jumps, motor = dict[str, Wrap](), self.values.get("motor_position")
        for name in _POSITIONS:
            if name in self.columns and self.columns[name].wrap is None and (factor := self._factor_of(name, own=True)):
                wrap = find_wrap(self.values[name], abs(2 * np.pi / factor)) if self.values[name].size else None
                jumps |= {} if wrap is None else {name: wrap}
        for name, wrap in jumps.items():
            certain = wrap.clear
            if name == "reference" and motor is not None:
                scale = abs(self._factor_of("motor_position") / self._factor_of(name))
                if "motor_position" not in jumps and np.ptp(motor) * scale < _TURNS_ON * wrap.size:
                    continue  # a saw tooth, which the motor follows
            elif name == "reference":
                certain = certain and wrap.known
            jump = f'{name} (column "{self.columns[name].column}") jumps {pluralise(wrap.count, "time")} by '
            jump += f"{wrap.size:.10g} against its motion, first after sample {wrap.first}"
            if certain:
                self.columns[name] = replace(self.columns[name], wrap=wrap.size)
                self.remarks.append(f"{jump}: it wraps, and is unwrapped as with wrap = {wrap.size:.10g}")
            else:
                self.remarks.append(f"{jump}: if it wraps, give its channel wrap = {wrap.size:.10g}")

    def _factor_of(self, name: str, *, own: bool = False) -> float:
        """SI units, on the joint's side or the column's own, to one of a position's; 0 if its unit is at fault."""
        column, gear = self.columns[name], self.transmission
        try:
            factor = column.sign * column.gain * self.frame.unit_of(name, self.columns).factor
        except units.UnitError:
            return 0.0
        return factor if gear is None or own else factor * gear.position(self.drive.side(name, column))

    def align_turns(self, logged: Mapping[str, Channel]) -> dict[str, Channel]:
        """Bring a motor position that was unwrapped to the turn of its reference."""
        made = dict(logged)
        motor, reference = made.get("motor_position"), made.get("reference")
        if motor is not None and reference is not None and (wrap := self.columns["motor_position"].wrap) is not None:
            turn = abs(wrap * self._factor_of("motor_position"))
            apart = float(np.median(np.interp(motor.time, reference.time, reference.values) - motor.values))
            if apart := turn * round(apart / turn):
                made["motor_position"] = replace(motor, values=motor.values + apart)
        return made

    def add_stamps(self, channels: Mapping[str, Channel], clocks: Clocks) -> dict[str, Stamped]:
        """Attach instants to channels, of the rows in which they have a number; refuse missing stamps."""
        faults, made = list[str](), dict[str, Stamped]()
        for name, channel in channels.items():
            column = self.columns[name]
            clock = clocks.clock_of(column)
            if clock.stamps is None:
                faults.append(
                    f"{name} has no time stamps to be resampled by; name its time column, or leave resample out."
                )
            elif (filled := self.rows.get(name)) is None:
                made[name] = Stamped(channel, clock.stamps, clock.column)
            else:
                own = replace(channel, values=channel.values[filled])
                made[name] = Stamped(own, clock.stamps[filled], f"{clock.column}, {column.column}")
        if faults:
            raise RecordError(faults)
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
