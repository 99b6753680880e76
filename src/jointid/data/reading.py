"""From a file to a record and back: the clock, the channels in SI, and every fault reported at once."""

from __future__ import annotations

import difflib
import os
import re
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from jointid.common import units
from jointid.common.errors import RecordError
from jointid.data.checks import CLOCK_TOLERANCE, clock_faults, finite_faults, scale_faults
from jointid.data.columns import Column, known_units, period_faults, unit_in_name
from jointid.data.formats import Table, read_table, write_table
from jointid.data.record import CHANNELS, Channel, FloatArray, Injection, Record, Tap, Timing

RATE_TOLERANCE = 1e-3
"""How far a given sample time may be from that of the time stamps, as a share of it.

Clocks of drives and computers differ by 0.01 %; a wrong rate is wrong by far more.
"""

_LISTED = 20  # columns that a message lists; some MAT files have thousands
_TIME = re.compile(r"(?:t|time)\s*(?:[\[(].*[\])])?", re.IGNORECASE)


def read(
    path: str | os.PathLike[str],
    columns: Mapping[str, str | Column],
    *,
    time: str | None = None,
    time_unit: str | None = None,
    sample_time: float | None = None,
    kind: str = "prismatic",
    name: str | None = None,
    clock_tolerance: float = CLOCK_TOLERANCE,
    **options: object,
) -> Record:
    """Read a record from a file; everything that is wrong with it is reported at once.

    The time between samples is `sample_time`, or else that of the time column: the one that `time` names, or
    else the one called t or time ("Time [ms]" is one). Where a channel has a rate of its own, columns end at
    their last number; elsewhere a column that ends early is a fault.

    Args:
        path: the file; its suffix tells the format.
        columns: channel -> its column, by name or as a `Column`; the channels are those of `CHANNELS`.
        time: name of the time column.
        time_unit: unit of the time column; None takes the one in its name, or else s.
        sample_time: time between samples [s]; given together with `time`, the two must agree.
        kind: "prismatic" (m, m/s, N unless a column says otherwise) or "revolute" (rad, rad/s, N m).
        name: what reports call the record; None takes the file's name without its suffix.
        clock_tolerance: largest jitter of the time stamps, as a share of the sample time.
        options: options of the format's reader; see `jointid.data.formats.Csv`.

    Raises:
        RecordError: the file cannot be read, or does not hold what it is declared to hold; `faults` has a
            sentence for each missing column, wrong unit, gap, jump of the clock and impossible scale.
    """
    unknown = [channel for channel in columns if channel not in CHANNELS]
    if unknown:
        raise RecordError(f"No channel is called {', '.join(unknown)}; there are {', '.join(CHANNELS)}.")
    if kind not in units.POSITION_UNITS:
        raise RecordError(f'A joint is "prismatic" or "revolute"; got {kind!r}.')
    wanted = {n: Column(c) if isinstance(c := columns[n], str) else c for n in CHANNELS if n in columns}
    table = read_table(path, **options)
    if any(column.sample_time for column in wanted.values()):
        table = _without_tails(table)
    reading = _Reading(table, kind, [])
    found = reading.found(wanted)
    clock = _Clock(sample_time)
    if time is not None or any(column.sample_time is None for column in found.values()):
        clock = reading.clock(time, time_unit, sample_time, clock_tolerance)
    channels = {channel: reading.channel(channel, found, clock) for channel in found}
    if reading.faults:
        raise RecordError(reading.faults)
    record = _record({n: c for n, c in channels.items() if c is not None}, found, name or Path(path).stem)
    faults = scale_faults(record)
    if faults:
        raise RecordError(faults)
    return record


def write(record: Record, path: str | os.PathLike[str]) -> None:
    """Write a record to a file: the time as column "t" [s], and every channel in SI under its own name.

    `read` gives it back to the last bit once told what a table of numbers does not hold: the joint's kind, a
    torque in A or V, and what differs from the defaults of `Column`.

    Args:
        record: the record; its channels share one rate and have at least two samples.
        path: the file; its suffix tells the format. A file that is there is replaced.

    Raises:
        RecordError: the channels differ in rate or have one sample, or the file cannot be written.
    """
    channels = dict(record.items())
    if len({channel.sample_time for channel in channels.values()}) > 1:
        rates = ", ".join(f"{name} {channel.sample_time:g} s" for name, channel in channels.items())
        raise RecordError(f"A file holds channels of one rate; got {rates}: write each rate to a file of its own.")
    time = next(iter(channels.values())).time
    if time.size < 2:
        raise RecordError("A record of one sample has no time between samples; write two samples or more.")
    write_table(path, Table({"t": time, **{name: channel.values for name, channel in channels.items()}}))


@dataclass(frozen=True, slots=True)
class _Clock:
    """The time between samples [s] and the time stamps [s], as far as they are known."""

    sample_time: float | None = None
    stamps: FloatArray | None = None


@dataclass(frozen=True, slots=True)
class _Reading:
    """A table on its way to a record; what is wrong with it is collected in `faults`, and reading goes on."""

    table: Table
    kind: str
    faults: list[str]

    def found(self, wanted: Mapping[str, Column]) -> dict[str, Column]:
        """Return the columns that are there; one that is not is a fault unless it is optional."""
        missing = {n: column for n, column in wanted.items() if column.column not in self.table.columns}
        needed = [f'"{column.column}" (for {n})' for n, column in missing.items() if not column.optional]
        if needed:
            listed = self.listed(" ".join(column.column for column in missing.values()))
            self.faults.append(f"{self.table.source} has no column {' and no '.join(needed)}; it has {listed}.")
        return {n: column for n, column in wanted.items() if n not in missing}

    def listed(self, wanted: str) -> str:
        """Return the names of the table's columns; of very many, those most like the one that was wanted."""
        names = list(self.table.columns)
        shown = names if len(names) <= _LISTED else difflib.get_close_matches(wanted, names, _LISTED, cutoff=0.0)
        rest = f" and {len(names) - len(shown)} more" if len(shown) < len(names) else ""
        return (", ".join(f'"{name}"' for name in shown) or "none") + rest

    def clock(self, time: str | None, time_unit: str | None, sample_time: float | None, tolerance: float) -> _Clock:
        """Return the record's clock, from the stamps, from the sample time, or from both."""
        wrong = period_faults("sample time", sample_time)
        if wrong or (sample_time is not None and time is None):
            self.faults.extend(wrong)
            return _Clock(None if wrong else sample_time)
        column = self.time_column(time)
        if column is None:
            return _Clock()
        known = units.units_of("time")
        named = unit_in_name(column, known)
        if time_unit is not None and named is not None and named != time_unit:
            self.faults.append(
                f'The time column "{column}" names its unit, and time_unit is "{time_unit}"; leave time_unit out, or '
                "rename the column."
            )
            return _Clock()
        unit = self.unit(f'time (column "{column}")', time_unit or unit_in_name(column, known) or "s", known)
        if unit is None:
            return _Clock()
        stamps = self.table.columns[column] * unit.factor
        wrong = clock_faults(stamps, tolerance)
        if wrong:
            self.faults.extend(wrong)
            return _Clock()
        period = _period(stamps)
        if sample_time is not None and abs(sample_time / period - 1) > RATE_TOLERANCE:
            self.faults.append(
                f'The sample time is given as {sample_time:g} s, and column "{column}" has {period:g} s; '
                "mend one, or leave sample_time or time out."
            )
        return _Clock(sample_time or period, stamps)

    def time_column(self, time: str | None) -> str | None:
        """Return the name of the time column; one that is missing or in doubt is a fault."""
        source = self.table.source
        if time is not None:
            if time not in self.table.columns:
                self.faults.append(f'{source} has no time column "{time}"; it has {self.listed(time)}.')
                return None
            return time
        names = [name for name in self.table.columns if _TIME.fullmatch(name)]
        if len(names) == 1:
            return names[0]
        several = ", ".join(f'"{name}"' for name in names)
        fact = f"more than one time column ({several})" if names else 'no column called "t" or "time"'
        self.faults.append(f"{source} has {fact}; give sample_time, or the name of the time column as time.")
        return None

    def unit(self, what: str, name: str, known: tuple[str, ...]) -> units.Unit | None:
        """Return the unit of that name; one that is not among `known` is a fault."""
        if name in known:
            return units.unit(name)
        expected = ", ".join(known)
        self.faults.append(f'{what} is in "{name}"; expected one of {expected}: give its unit, and the gain to it.')
        return None

    def channel(self, name: str, found: Mapping[str, Column], clock: _Clock) -> Channel | None:
        """Return a channel in SI, None if its unit or its rate is at fault."""
        column = found[name]
        what, values = f'{name} (column "{column.column}")', self.table.columns[column.column]
        period, stamps = column.sample_time or clock.sample_time, clock.stamps
        if column.sample_time is not None or stamps is None:
            stamps = None if period is None else Channel(values, "", period).time
        elif stamps.size != values.size:
            lengths = f"{values.size} samples, the time {stamps.size}"
            self.faults.append(f"{what} has {lengths}; name columns of one length.")
            stamps = None
        self.faults.extend(finite_faults(what, values, stamps))
        self.faults.extend(column.misplaced(name))

        known = known_units(name, self.kind)
        default = known[0]
        if name == "injected" and "torque" in found:
            default = found["torque"].stated_unit(known) or default
        unit = self.unit(what, column.stated_unit(known) or default, known)
        if unit is None or period is None:
            return None
        held = name in ("torque", "injected")
        return Channel(
            values * (column.sign * column.gain * unit.factor),
            unit.si,
            period,
            column.timing or (Timing.HELD if held else Timing.SAMPLED),
            f"{self.table.source}: {column.column}",
        )


def _without_tails(table: Table) -> Table:
    """Return the table with each column cut after its last number."""
    cut = {}
    for name, values in table.columns.items():
        filled = np.flatnonzero(~np.isnan(values))
        cut[name] = values[: filled[-1] + 1] if filled.size else values
    return Table(cut, table.scalars, table.source)


def _period(stamps: FloatArray) -> float:
    """Return the time between samples [s] of stamps that have been checked."""
    index, first = np.arange(stamps.size), float(stamps[1] - stamps[0])
    if np.array_equal(stamps[0] + index * first, stamps):
        return first  # stamps that were computed give their sample time back to the last bit
    # The mean over the record is better than any one step; its thirteenth digit is rounding.
    return float(f"{(stamps[-1] - stamps[0]) / index[-1]:.12g}")


def _record(channels: Mapping[str, Channel], found: Mapping[str, Column], name: str) -> Record:
    """Return the record that the channels make."""
    torque, injected = channels.get("torque"), channels.get("injected")
    if torque is not None and injected is not None and torque.unit != injected.unit:
        raise RecordError(
            f"The torque is in {torque.unit}, the injected signal in {injected.unit}; give both in one unit."
        )
    return Record(
        torque=torque,
        tap=Tap.COMMAND if torque is None else found["torque"].tap,
        reference=channels.get("reference"),
        reference_velocity=channels.get("reference_velocity"),
        motor_position=channels.get("motor_position"),
        load_position=channels.get("load_position"),
        injected=None if injected is None else Injection(injected, found["injected"].at, found["injected"].in_torque),
        name=name,
    )
