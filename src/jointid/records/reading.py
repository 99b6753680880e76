"""Read a record from a file: columns, clocks, wraps, units, alignment.

Each step reports all of its faults at once.
"""

from __future__ import annotations

import os
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from jointid.common import units
from jointid.common.arrays import FloatArray
from jointid.common.errors import RecordError
from jointid.common.text import join, pluralise
from jointid.common.transmission import Transmission
from jointid.records.checks import scale_faults
from jointid.records.clock import Clock, Cut, find_stamps, fit_clock, is_same_rate
from jointid.records.columns import POSITIONS, Column, as_columns, find_wrap, finite_faults, restore_sign, unwrap
from jointid.records.drives import Drive, Frame
from jointid.records.formats import Table, read_table
from jointid.records.record import (
    CHANNELS,
    TORQUES,
    Channel,
    Injection,
    Record,
    Spans,
    Tap,
    Timing,
    known_units,
    refer_channel,
)
from jointid.records.resampling import Resampling, Signal, bring_together

_TURNS_ON = 1.5  # wraps: a motor that travels further passes the wrap of its reference
_FEWEST_ROWS = 3  # fewest rows with a number in a sparse column


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
    resample: Resampling | None = None,
    start: float | None = None,
    stop: float | None = None,
    part: int | None = None,
    leave_out: Spans = (),
    **options: Any,
) -> Record:
    """Read a record from a file.

    The clock is `sample_time`, or the time column: named by `time`, or the only one called t or time (as "Time [ms]").
    Channels of different rates end at their last number; otherwise an early end is a fault. A jump of the
    clock is a fault unless `resample` or `part` is given. If stamps jitter, a position decides whether the samples
    follow them. Channels without a common instant are resampled to the fastest, with a remark.
    The file's own unit applies if neither `columns` nor the column's name states one.

    Args:
        path: the file; its suffix selects the format.
        columns: channel of `CHANNELS` -> column name or `Column`. A drive's profile finds missing ones.
        drive: factors for counts, shares of rated torque and ampere, and the profile of the traces.
        time: name of the time column.
        time_unit: unit of the time column; None takes the one in its name, or s.
        sample_time: time between samples [s]; it must agree with `time`.
        kind: "revolute" (rad, rad/s, N m unless a column says otherwise) or "prismatic" (m, m/s, N).
        transmission: between motor and load; it sets both kinds and refers every channel to its `side`.
        name: of the record in reports; None takes the file's name without suffix.
        start: first instant to read, in seconds of the log's own clock.
        stop: last instant to read.
        part: part between jumps of the clock to read, counted from 1; 0 takes the longest.
        leave_out: excluded time spans, [begin, end) each; simulations continue through them.
        resample: rules for a uniform clock.
        options: a channel's column, as torque="i_q", or of the format's reader; see `records.formats.TextOptions`.

    Raises:
        RecordError: the file cannot be read, or contradicts its declaration; `faults` has a sentence for each fault.
    """
    cut = Cut(start, stop, part, tuple(leave_out))
    own = {**(columns or {}), **{name: options.pop(name) for name in CHANNELS if name in options}}
    reader = RecordReader(own, drive or Drive(), time, time_unit, sample_time, kind, transmission, name, resample, cut)
    return reader.build_record(read_table(path, **options), Path(path).stem)


@dataclass(frozen=True, slots=True)
class RecordReader:
    """Settings that convert a table to a record; see `read`."""

    columns: Mapping[str, str | Column]
    drive: Drive
    time: str | None = None
    time_unit: str | None = None
    sample_time: float | None = None
    kind: str = "revolute"
    transmission: Transmission | None = None
    name: str | None = None
    resample: Resampling | None = None
    cut: Cut = field(default_factory=Cut)

    def __post_init__(self) -> None:
        if not {*self.columns} <= {*CHANNELS} or self.kind not in units.POSITION_UNITS:
            raise RecordError(
                f'Channels are {", ".join(CHANNELS)}, and a joint is "prismatic" or "revolute"; got '
                f'{", ".join(self.columns)} and "{self.kind}": correct them.'
            )

    def build_record(self, table: Table, name: str) -> Record:
        """Build the record of a table."""
        given, time, period = as_columns(self.columns), self.time, self.sample_time
        wanted = {name: given[name] for name in CHANNELS if name in given}
        if any(column.sample_time or column.time for column in wanted.values()):
            # A column ends with its last number, unless a gap precedes it.
            known = {column: np.flatnonzero(~np.isnan(values)) for column, values in table.columns.items()}
            ends = {column: at.size for column, at in known.items() if at.size and at[-1] + 1 == at.size}
            cut = {column: values[: ends.get(column)] for column, values in table.columns.items()}
            table = replace(table, columns=cut)
        if time is None and period is None and self.drive.traces is not None:
            time = self.drive.traces.time_column(table.columns)
        # A sample time given alone, or the named time column of a file with one clock, overrides the file's clocks.
        alone = period is not None if time is None else self.time is not None and len(set(table.clocks.values())) == 1
        clocks = {} if alone else dict(table.clocks)
        columns, bare = self._select(table, wanted)
        signals = self._log(table, columns, time, clocks)
        channels, begin, done, said = bring_together(signals, self.resample)
        # The file begins with the first row of its clocks, including unused ones.
        origins = [one.clock.first for one in signals.values()]
        for one in set(clocks.values()):
            _, stamps = find_stamps(table, one, self.time_unit, None)
            origins.append(float(stamps[self._find_rows(stamps, stamps, one)][0]))
        first = min((float(one.clock.stamps[0]) for one in signals.values()), default=0.0)
        logged: dict[str, Any] = dict(channels)
        if "torque" in logged:
            logged["tap"] = columns["torque"].tap or Tap.COMMAND
        if "injected" in logged:
            logged["injected"] = Injection(logged["injected"], columns["injected"].at, columns["injected"].in_torque)
        record = Record(
            **logged,
            name=self.name or name,
            begin=begin + (first - min(origins, default=first)),
            left_out=self.cut.leave_out,
            zero=min(origins, default=first),
            resampled=done,
            remarks=tuple(dict.fromkeys((*bare, *(r for one in signals.values() for r in one.remarks), *said))),
        )
        if faults := scale_faults(record):
            raise RecordError(faults)
        return record

    def _select(self, table: Table, wanted: Mapping[str, Column]) -> tuple[dict[str, Column], list[str]]:
        """Return the columns: declared, by profile, or in the file's units; and a remark if some have no unit."""
        profile, faults, bare = self.drive.traces, list[str](), list[str]()
        frame = Frame(self.drive, self.kind, self.transmission)
        found = {channel: column for channel, column in wanted.items() if column.column}
        if profile is not None:
            kinds = {channel: frame.kind_of(channel, wanted.get(channel)) for channel in CHANNELS}
            found, faults = profile.find_columns(wanted, table.columns, self.drive.place, kinds, table.source)
        elif unnamed := [channel for channel in wanted if channel not in found]:
            faults.append(f"{' and '.join(unnamed)} has no column; name it, or give the drive a profile.")
        selected = {n: frame.find_side(n, column) for n, column in found.items() if column.column in table.columns}
        if needed := {n: c.column for n, c in found.items() if n not in selected and not c.optional}:
            listed = " and no ".join(f'"{column}" (for {n})' for n, column in needed.items())
            why = table.explain_missing(needed.values())
            faults.append(f"{table.source} has no column {listed}{why}; it has {table.list_columns()}.")
        for channel, column in selected.items():
            declared = replace(wanted.get(channel, column), column=column.column)
            unit = units.normalise_unit(table.units.get(column.column, ""))
            known = known_units(channel, frame.kind_of(channel, column))
            if declared.gain == 1 and declared.stated_unit(known) is None:
                selected[channel] = replace(column, unit=unit or column.unit)
            if self.transmission is None and column.side is not None:
                faults.append(f"{channel} has a side, but no transmission is given; give it, or leave side out.")
            try:
                read = frame.unit_of(channel, selected).si
                if declared.gain == 1 and selected[channel].stated_unit(known) is None:
                    bare.append(f"{channel} is read in {read}")
            except units.UnitError as error:
                faults.append(f'{channel} (column "{column.column}") {error}.')
        if faults:
            raise RecordError(faults)
        return selected, [f"no unit is given: {join(bare)}"] if bare else []

    def _log(
        self, table: Table, columns: Mapping[str, Column], time: str | None, clocks: Mapping[str, str]
    ) -> dict[str, Signal]:
        """Return unwrapped channels in SI with their clocks, at refreshed rows."""
        made, faults, gear = dict[str, Signal](), list[str](), self.transmission
        frame = Frame(self.drive, self.kind, gear)
        for name in (n for n in dict.fromkeys((*POSITIONS, *columns)) if n in columns):  # the reference after the motor
            column, what = columns[name], f'{name} (column "{columns[name].column}")'
            unit, side, held = frame.unit_of(name, columns), self.drive.side(name, column), name in TORQUES
            factor, wrap, own = column.sign * column.gain * unit.factor, 0.0, column.time or clocks.get(column.column)
            scale = abs(factor * (1.0 if gear is None else gear.position(side)))
            try:
                values, clock, remarks = self._sample(table, what, column, own, time)
                if name in POSITIONS:
                    wrap = column.wrap or _find_wrap(name, values, factor, scale, made.get("motor_position"))
                    values = unwrap(values, wrap, name) if wrap else values
                elif column.wrap is not None:
                    values = values - column.wrap * (values >= column.wrap / 2)
                elif (signed := restore_sign(values)) is not None:
                    values = signed
                    remarks.append(f"{name} jumps where it passes 0: it is read as whole numbers that lost their sign")
            except RecordError as error:
                faults += error.faults
                continue
            if wrap and column.wrap is None:
                remarks.append(f"{name} jumps by its wrap of {wrap:.10g}: it is unwrapped")
            timing, stated = column.timing or (Timing.HELD if held else Timing.SAMPLED), column.timing or not held
            source = f"{table.source}: {column.column}"
            channel = Channel(values * factor, unit.si, clock.sample_time, timing, source, stated=bool(stated))
            channel = channel if gear is None else refer_channel(gear, name, channel, side)
            made[name] = Signal(channel, clock, wrap * scale, tuple(remarks))
        if faults:
            raise RecordError(list(dict.fromkeys(faults)))
        return _begin_in_one_turn({name: made[name] for name in columns})

    def _sample(
        self, table: Table, what: str, column: Column, own: str | None, time: str | None
    ) -> tuple[FloatArray, Clock, list[str]]:
        """Return the refreshed numbers of a column, their clock, and remarks."""
        values, period, resampled = table.columns[column.column], column.sample_time, self.resample is not None
        stated, first, remarks = None if own else self.sample_time, 0.0, list[str]()
        try:
            at, stamps = find_stamps(table, own or time, self.time_unit, stated)
            first = float(np.nan_to_num(stamps[0]))
            stamps = stamps if at or period else stamps[: values.size]
            if stamps.size != values.size:
                raise RecordError(
                    f"{what} has {values.size} samples, the time {stamps.size}; name columns of one length."
                )
            rows = self._find_rows(stamps, values, at)
            clock = fit_clock(at, stamps[rows], stated, resampled=resampled)
        except RecordError:
            if period is None:
                raise
            stamps = np.asarray(first + np.arange(values.size) * period, dtype=np.float64)
            rows = self._find_rows(stamps, values)
            clock = fit_clock("", stamps[rows], period)
        if again := int(np.count_nonzero(_repeats(stamps, values))):
            remarks.append(f"{table.source} repeats {pluralise(again, 'sample')}, left out")
        values = values[rows]
        kept = _find_filled_rows(values, resampled=resampled)
        if kept is None and (faults := finite_faults(what, values)):
            raise RecordError(faults)
        if kept is None and period is not None:
            kept = _find_refreshes(values, period / clock.sample_time)
        if kept is None:
            return values, clock, remarks
        every = float(np.diff(np.flatnonzero(kept)[:2])[0]) * clock.sample_time
        if period is None and not resampled:
            remarks.append(f"{what} has numbers in some rows: it is a channel with a sample every {every:g} s")
        elif period is not None and not resampled and not is_same_rate(every, period):
            raise RecordError(
                f"{what} has no new number every {period:g} s, as its sample_time says; correct that, or leave it out."
            )
        return values[kept], replace(clock, stamps=clock.stamps[kept], sample_time=every), remarks

    def _find_rows(self, stamps: FloatArray, values: FloatArray, clock: str = "") -> NDArray[np.bool_]:
        """Return the samples to read, (samples,): in the cut, without repetitions."""
        rows = ~_repeats(stamps, values)
        if self.cut != Cut():
            rows[rows] = self.cut.find_rows(stamps[rows], clock)
        return rows


def _find_wrap(name: str, values: FloatArray, factor: float, scale: float, motor: Signal | None) -> float:
    """Return the wrap of a position; 0 without one.

    A measured position cannot jump by its range in one sample. A reference can, as a saw tooth: its wrap counts if the
    motor position wraps or travels on, or if none is logged and the jump is a known wrap.

    Column values, (samples,), are converted to SI by `factor`, and in size to the joint's position by `scale`.
    """
    wrap, known = find_wrap(values, 2 * np.pi / abs(factor)) or (0.0, False)
    if motor is not None:
        known = bool(motor.wrap) or float(np.ptp(motor.channel.values)) > _TURNS_ON * wrap * scale
    return wrap if known or name != "reference" else 0.0


def _begin_in_one_turn(made: dict[str, Signal]) -> dict[str, Signal]:
    """Shift a wrapping motor position to the turn of its reference."""
    motor, reference = made.get("motor_position"), made.get("reference")
    if motor is None or not motor.wrap or reference is None:
        return made
    there = np.interp(motor.clock.stamps, reference.clock.stamps, reference.channel.values)
    turns = np.round(np.median(there - motor.channel.values) / motor.wrap)
    values = motor.channel.values + motor.wrap * turns
    return made | {"motor_position": replace(motor, channel=replace(motor.channel, values=values))}


def _repeats(stamps: FloatArray, values: FloatArray) -> NDArray[np.bool_]:
    """Test which samples, (samples,), repeat the preceding stamp and value."""
    same = (np.diff(values) == 0) | (np.isnan(values[1:]) & np.isnan(values[:-1]))
    return np.concatenate([[False], (np.diff(stamps) == 0) & same])


def _find_filled_rows(values: FloatArray, *, resampled: bool) -> NDArray[np.bool_] | None:
    """Return the filled rows of a sparse column, (samples,), or None."""
    filled = ~np.isnan(values)
    rows = np.flatnonzero(filled)
    if rows.size < _FEWEST_ROWS or (longest := int(np.diff(rows).max())) == 1:
        return None
    ends = max(rows[0] + 1, values.size - rows[-1]) <= longest
    return filled if ends and (resampled or np.all(np.diff(rows) == longest)) else None


def _find_refreshes(values: FloatArray, ratio: float) -> NDArray[np.bool_]:
    """Return the rows, (samples,), of refreshes every `ratio` rows, or all."""
    every = round(min(ratio, values.size))
    changes = np.flatnonzero(np.diff(values)) + 1
    phase = int(np.argmax(np.bincount(changes % every, minlength=every)))
    kept = np.arange(values.size) % every == phase
    return kept if np.all(kept[changes]) and 2 * every <= values.size else np.ones(values.size, dtype=bool)
