"""Read a record from a file by steps: select columns, log them with their clocks, unwrap, convert to SI, align.

Each step reports all of its faults at once.
"""

from __future__ import annotations

import os
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

from jointid.common import units
from jointid.common.arrays import FloatArray
from jointid.common.errors import RecordError
from jointid.common.transmission import Transmission
from jointid.records.checks import scale_faults
from jointid.records.clock import CLOCK_TOLERANCE, Clock, Cut, cut_table, find_clock, own_clocks, seconds_of
from jointid.records.columns import POSITIONS, Column, find_wrap, known_units, unwrap
from jointid.records.drives import Drive, Frame, index_columns
from jointid.records.formats import Table, read_table
from jointid.records.record import CHANNELS, Channel, Injection, Record, Tap, Timing, refer_channel
from jointid.records.resampling import Resampling, Signal, bring_together, pick_samples

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
    """Read a record from a file, and report all faults of a step at once.

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
        given, time, period = self.columns, self.time, self.sample_time
        wanted = {n: Column(c) if isinstance(c := given[n], str) else c for n in CHANNELS if n in given}
        if any(column.sample_time or column.time for column in wanted.values()):
            table = _cut_tails(table)
        if time is None and period is None and self.drive.traces is not None:
            time = self.drive.traces.time_column(table.columns)
        repaired = self.resample is None and (self.time is not None or period is None)
        table, repeated = cut_table(table, time, self.time_unit, period, self.cut, repaired=repaired)
        # A sample time that is given alone is all that counts, unless a channel names its own column.
        own = {} if time is None and period is not None else own_clocks(table, self.time)
        columns = self._select(table, wanted)
        signals = _unwrap(self._log(table, columns, time, own))
        channels, begin, done, said = bring_together(signals, self.resample, self.clock_tolerance)
        # The file begins with the first row of its clocks, which no channel may use.
        origins = [float(table.columns[one][0]) * seconds_of(table, one, self.time_unit) for one in set(own.values())]
        origins += [one.clock.first for one in signals.values()]
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
            resampled=done,
            remarks=(*repeated, *(one.remark for one in signals.values() if one.remark), *said),
        )
        if faults := [*self._gain_faults(table), *scale_faults(record)]:
            raise RecordError(faults)
        return record

    @property
    def _frame(self) -> Frame:
        return Frame(self.drive, self.kind, self.transmission)

    def _select(self, table: Table, wanted: Mapping[str, Column]) -> dict[str, Column]:
        """Return the columns as declared, else by the drive's profile, else in the units of the file."""
        profile, frame, faults = self.drive.traces, self._frame, list[str]()
        found = {channel: column for channel, column in wanted.items() if column.column}
        if profile is not None:
            kinds = {channel: frame.kind_of(channel, wanted.get(channel)) for channel in CHANNELS}
            found, faults = profile.find_columns(wanted, table.columns, self.drive.place, kinds, table.source)
        elif unnamed := [channel for channel in wanted if channel not in found]:
            faults.append(f"{' and '.join(unnamed)} has no column; name it, or give the drive a profile.")
        selected = {n: column for n, column in found.items() if column.column in table.columns}
        needed = {n: c.column for n, c in found.items() if n not in selected and not c.optional}
        if needed:
            listed = " and no ".join(f'"{column}" (for {n})' for n, column in needed.items())
            why = table.explain_missing(needed.values())
            faults.append(f"{table.source} has no column {listed}{why}; it has {table.list_columns()}.")
        for channel, column in selected.items():
            declared = replace(wanted.get(channel, column), column=column.column)
            unit = units.normalise_unit(table.units.get(column.column, ""))
            known = known_units(channel, frame.kind_of(channel, column))
            if unit and declared.gain == 1 and declared.stated_unit(known) is None:
                selected[channel] = replace(column, unit=unit)
            faults += column.misplaced_faults(channel)
            if self.transmission is None and column.side is not None:
                faults.append(f"{channel} has a side, but no transmission is given; give it, or leave side out.")
            try:
                frame.unit_of(channel, selected)
            except units.UnitError as error:
                faults.append(f'{channel} (column "{column.column}") {error}.')
        if faults:
            raise RecordError(faults)
        return selected

    def _log(
        self, table: Table, columns: Mapping[str, Column], time: str | None, own: Mapping[str, str]
    ) -> dict[str, Signal]:
        """Return the channels in SI with their clocks, at the rows in which there are new numbers."""
        resampled = self.resample is not None

        @cache
        def find(stamps: str | None, needed: bool) -> Clock | None:
            tolerance, period = None if resampled else self.clock_tolerance, None if stamps else self.sample_time
            try:
                return find_clock(table, stamps or time, self.time_unit, period, tolerance)
            except RecordError:
                if needed:
                    raise
                return None

        made, faults = dict[str, Signal](), list[str]()
        for name, column in columns.items():
            values, what = table.columns[column.column], f'{name} (column "{column.column}")'
            own_rate, remark = column.sample_time, ""
            try:
                clock = find(column.time or own.get(column.column), own_rate is None)
                values, clock, picked = pick_samples(what, values, clock, own_rate, resampled=resampled)
            except RecordError as error:
                faults += error.faults
                continue
            if picked and own_rate is None and not resampled:
                remark = f"{what} has numbers in some rows: it is a channel with a sample every {clock.sample_time:g} s"
            channel, grain, turn = self._convert(table, columns, name, values, clock.sample_time)
            wrap = None if column.wrap is None else column.wrap * grain
            made[name] = Signal(channel, clock, picked, grain, turn, wrap, remark)
        if faults:
            raise RecordError(list(dict.fromkeys(faults)))
        return made

    def _convert(
        self, table: Table, columns: Mapping[str, Column], name: str, values: FloatArray, sample_time: float
    ) -> tuple[Channel, float, float]:
        """Return numbers as a channel on the joint's side, and what 1 and a turn are of its position there."""
        column, gear, on_joint, held = columns[name], self.transmission, 1.0, name in ("torque", "injected")
        unit, side = self._frame.unit_of(name, columns), self.drive.side(name, column)
        factor = column.sign * column.gain * unit.factor
        channel = Channel(
            values * factor,
            unit.si,
            sample_time,
            column.timing or (Timing.HELD if held else Timing.SAMPLED),
            f"{table.source}: {column.column}",
            stated=column.timing is not None or not held,
        )
        if gear is not None:
            channel, on_joint = refer_channel(gear, name, channel, side), gear.position(side)
        return channel, abs(factor * on_joint), abs(2 * np.pi * on_joint)

    def _gain_faults(self, table: Table) -> Iterator[str]:
        """Yield gains of the log that are not the declared ones."""
        profile = self.drive.traces
        if profile is None or not self.gains:
            return
        for name, gain in profile.gain_columns(index_columns(table.columns), self.drive.place).items():
            values, declared = table.columns[name], self.gains.get(gain.key)
            low, high = float(np.fmin.reduce(values)), float(np.fmax.reduce(values))
            if declared is not None and max(abs(low - declared), abs(high - declared)) > _SAME_GAIN * abs(declared):
                yield (
                    f'{gain.name} (column "{name}") goes from {low:g} to {high:g} in the record, and '
                    f"controller.{gain.key} is {declared:g}; correct it, or cut the record by start and stop."
                )


def _unwrap(signals: Mapping[str, Signal]) -> dict[str, Signal]:
    """Unwrap positions whose wrap is declared or found; the motor's then begins in the turn of its reference.

    A measured position cannot go by its range in one sample. A reference can, as a saw tooth: it wraps where a
    measured one does, or turns on, or where none is logged and the jump is a known wrap.
    """
    made = dict(signals)
    for name, one in ((name, signals[name]) for name in POSITIONS if name in signals):
        wrap, remark = one.wrap, one.remark
        if wrap is None:
            wrap, known = find_wrap(one.channel.values, one.turn, one.grain) or (0.0, False)
            if name == "reference" and (motor := made.get("motor_position")) is not None:
                known = bool(motor.wrap) or float(np.ptp(motor.channel.values)) > _TURNS_ON * wrap
            wrap = wrap if known or name != "reference" else 0.0
            remark = f"{name} jumps by its wrap of {wrap / one.grain:.10g}: it is unwrapped" if wrap else remark
        if wrap:
            values = unwrap(one.channel.values, wrap, name)
            made[name] = replace(one, channel=replace(one.channel, values=values), wrap=wrap, remark=remark)
    motor, reference = made.get("motor_position"), made.get("reference")
    if motor is not None and motor.wrap and reference is not None:
        there = np.interp(motor.clock.stamps, reference.clock.stamps, reference.channel.values)
        turns = np.round(np.median(there - motor.channel.values) / motor.wrap)
        values = motor.channel.values + motor.wrap * turns
        made["motor_position"] = replace(motor, channel=replace(motor.channel, values=values))
    return made


def _cut_tails(table: Table) -> Table:
    """Cut each column after its last number, if it has one in every row until then."""
    cut = {}
    for name, values in table.columns.items():
        filled = np.flatnonzero(~np.isnan(values))
        cut[name] = values[: filled.size] if filled.size and filled[-1] + 1 == filled.size else values
    return replace(table, columns=cut)
