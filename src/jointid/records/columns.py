"""Table columns for the channels of a record: name, unit, gain and sign."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from jointid.common import units
from jointid.common.arrays import FloatArray
from jointid.common.errors import RecordError
from jointid.common.settings import add_settings_to_docstring, check_settings, setting
from jointid.common.text import pluralise
from jointid.common.transmission import Side
from jointid.records.record import InjectionPoint, Tap, Timing

_FEWEST_MOVES = 3  # steps beside the jumps of a wrap
_SAFE_STEP = 0.4  # of a wrap in one sample: from a half on, forwards and backwards cannot be distinguished
_BEYOND_WRAP = 1e-2  # of a wrap, by which values may span more
_WHOLE_RANGE = 0.6  # of the range of a column: a larger step may be a wrap
_ALIKE = 0.02  # of a wrap, that the jumps at it may differ by
_AGAINST = 0.8  # of the jumps at a wrap, that go against a steady motion
_KNOWN_WRAP, _PART_OF_TURN = 2e-3, 1e-4  # greatest relative distance of a jump from the wrap that it is taken for
_IN_BRACKETS = re.compile(r"[\[(]\s*([^\[\]()]+?)\s*[\])]\s*$")


@add_settings_to_docstring
@dataclass(frozen=True, slots=True)
class Column:
    """A file column for one channel: `sign` x `gain` x column, in `unit`.

    Raises:
        RecordError: gain, sample_time, wrap or update_time is not positive and finite, sign is not 1 or -1, there is
            no such side, or there are a sample time and a time column.
    """

    column: str = setting(
        "",
        "name of the column, as the format has it: name, structure.field, group/dataset, or name[0] for a column of "
        "a matrix; without it the drive's profile finds it",
    )
    unit: str | None = setting(
        None,
        'unit of gain x column; without it the one in the column\'s name, as in "pos [mm]", if the gain is 1; or else '
        "the SI unit of the joint's kind, and for an injected signal that of the torque",
    )
    gain: float = setting(1.0, "what takes the column to the unit", above=0)
    sign: int = setting(1, "-1 turns the channel round", only=(1, -1))
    timing: Timing | None = setting(
        None,
        "whether a value stands for its instant, for the time from it to the next, or for the mean since the last; "
        "without it held for torque and injected, sampled for the others",
    )
    sample_time: float | None = setting(
        None, "the channel's own time between samples, where it differs from the record's", unit="s", above=0
    )
    tap: Tap | None = setting(
        None,
        "where the torque was logged: the controller's output behind its filters and its limit, or a measured current; "
        "the drive's profile may say, or else the controller's output",
    )
    at: InjectionPoint = setting(
        InjectionPoint.AFTER_LIMIT,
        "where the known signal is added to the controller's output: whether it passes the limit",
    )
    in_torque: bool = setting(
        True, "whether the logged torque contains the known signal; before the limit it always does"
    )
    side: Side | None = setting(
        None,
        "of the transmission, on which the channel is; without it the load's for load_position, the motor's for the "
        "others",
    )
    wrap: float | None = setting(
        None,
        "of a position: where the column wraps round, in its own numbers, such as 65536 or 360; it is unwrapped, and "
        "refused where it moves by more than 0.4 of it in a sample; without it found where the jumps are clear",
        above=0,
    )
    update_time: float | None = setting(
        None,
        "time between refreshes of a column that is logged more often than that; it is picked at its own rate, from "
        "where its values change, and becomes a channel of that sample time",
        unit="s",
        above=0,
    )
    optional: bool = setting(False, "whether a record may lack the column")
    time: str | None = setting(None, "name of the channel's own time column, where it has one")

    def __post_init__(self) -> None:
        check_settings(self, RecordError, f'Column "{self.column}"')
        if self.sample_time is not None and self.time is not None:
            raise RecordError(
                f'Column "{self.column}" has a sample_time and a time column of its own; leave one of them out.'
            )
        object.__setattr__(self, "timing", None if self.timing is None else Timing(self.timing))
        object.__setattr__(self, "tap", None if self.tap is None else Tap(self.tap))
        object.__setattr__(self, "at", InjectionPoint(self.at))

    def stated_unit(self, known: tuple[str, ...]) -> str | None:
        """Unit stated here or in the column's name, if any."""
        # A gain takes the values from the unit in the name to another one.
        if self.unit is not None:
            return self.unit if self.unit in known else units.normalise_unit(self.unit)
        return None if self.gain != 1 else unit_in_name(self.column, known)

    def doubled_unit(self, known: tuple[str, ...]) -> str | None:
        """Unit in the column's name that contradicts the declared one without a gain."""
        named = None if self.unit is None or self.gain != 1 else unit_in_name(self.column, known)
        return named if named in known and named != self.stated_unit(known) else None

    def misplaced_faults(self, channel: str) -> list[str]:
        """Faults of settings that belong to other channels."""
        faults = []
        if channel != "torque" and self.tap is not None:
            faults.append(f"{channel} has tap = {self.tap}, which says where a torque was logged; leave it out.")
        if channel != "injected" and not (self.in_torque and self.at is InjectionPoint.AFTER_LIMIT):
            faults.append(f"{channel} has at or in_torque, which are for an injected signal; leave them out.")
        if self.wrap is not None and channel not in ("reference", "motor_position", "load_position"):
            faults.append(f"{channel} has a wrap of {self.wrap:g}, which is for a position; leave it out.")
        return faults


def unit_in_name(column: str, known: tuple[str, ...]) -> str | None:
    """Unit at the end of a column's name; unknown ones only in square brackets."""
    match = _IN_BRACKETS.search(column)
    if match is None or match[1].isdigit():  # "phi[0]" is an element
        return None
    # "q [clicks]" is to be refused, not to be read as metres; "q (filtered)" has a remark.
    said = match[1] if match[1] in known else units.normalise_unit(match[1])
    return (said or None) if said in known or column.rstrip().endswith("]") else None


def unit_fault(what: str, name: str, known: tuple[str, ...]) -> str:
    """Describe an unknown unit."""
    return f'{what} is in "{name}"; expected one of {", ".join(known)}: give its unit, and the gain to it.'


def known_units(channel: str, kind: str) -> tuple[str, ...]:
    """Units allowed for a channel and kind of joint, SI first."""
    if channel in ("torque", "injected"):
        return units.units_of(*units.TORQUE_UNITS[kind])
    dimensions = units.VELOCITY_UNITS if channel == "reference_velocity" else units.POSITION_UNITS
    return units.units_of(*dimensions[kind])


def unit_of_column(channel: str, columns: Mapping[str, Column], kind: str) -> str:
    """Unit of a channel's values: as stated, the torque's for injections, or SI."""
    known = known_units(channel, kind)
    default = known[0]
    if channel == "injected" and "torque" in columns:
        stated = columns["torque"].stated_unit(known)  # on another side of a transmission it may be no unit here
        default = stated if stated in known else default
    return columns[channel].stated_unit(known) or default


def finite_faults(name: str, values: FloatArray, time: FloatArray | None = None, *, sparse: bool = False) -> list[str]:
    """Faults of non-finite raw values (samples,): an early end, and gaps.

    Args:
        name: of the values, in sentences.
        values: (samples,).
        time: instants [s], (samples,), if known.
        sparse: whether resampling would take the rows without NaN.
    """
    bad, rows = np.flatnonzero(~np.isfinite(values)), np.flatnonzero(~np.isnan(values))
    if bad.size == 0:
        return []
    if bad.size == values.size:
        return [f"{name} has no finite number in its {values.size} samples; name another column."]
    faults, end = [], int(rows[-1]) + 1
    if values.size - end >= np.diff(rows, prepend=rows[0] - 1).max():  # longer than any gap
        faults.append(
            f"{name} ends early: after {end} of {values.size} samples it is empty (NaN); cut all columns to "
            "one length, or give the channels of another rate their own sample_time."
        )
    bad = bad[bad < end]
    if bad.size:
        first = int(bad[0])
        more = ", or give resample, which takes every channel at the rows in which it has a number"
        faults.append(
            f"{name} has {pluralise(bad.size, 'sample')} without a finite number, the first {values[first]} at "
            f"sample {first}{format_instant(time, first)}; mend them, or cut the record there"
            f"{more if sparse and not np.isinf(values).any() else ''}."
        )
    return faults


def format_instant(time: FloatArray | None, index: int) -> str:
    """Format a sample's instant in brackets; empty if unknown."""
    return "" if time is None else f" (t = {time[index]:g} s)"


@dataclass(frozen=True, slots=True)
class Wrap:
    """Jumps of a position that look like a wrap.

    Attributes:
        size: of the jumps, in the column's own numbers.
        count: of the jumps.
        first: sample before the first one.
        known: whether the size is a turn, turns of a gear, or a power of two.
        clear: whether all jumps have one size, as far as the motion is even.
    """

    size: float
    count: int
    first: int
    known: bool
    clear: bool


def find_wrap(values: FloatArray, turn: float = 2 * np.pi) -> Wrap | None:
    """Find the wrap of a position (samples,); None without one.

    At a wrap a step goes by nearly the whole range, against the motion before and after it. With that motion v it is
    as large as the wrap: W = |d - v|. A square wave rests where it jumps.

    Args:
        values: the column, finite.
        turn: one turn, in the column's numbers.

    Example:
        >>> import numpy as np
        >>> find_wrap(np.mod(np.arange(1000.0), 360.0), 360.0)
        Wrap(size=360.0, count=2, first=359, known=True, clear=True)
    """
    with np.errstate(over="ignore"):
        steps, span = np.diff(values), float(np.ptp(values))
    (moved,) = np.nonzero(steps)  # a column that is refreshed slowly rests between
    steps = steps[moved]
    jumps = np.abs(steps) > _WHOLE_RANGE * span
    if not (np.isfinite(span) and jumps.any() and np.count_nonzero(~jumps) > _FEWEST_MOVES):
        return None
    at, others = np.flatnonzero(jumps), np.flatnonzero(~jumps)
    after = np.searchsorted(others, at).clip(1, others.size - 1)
    before, behind = steps[others[after - 1]], steps[others[after]]
    way = -np.sign(steps[at])
    against = (way * before > 0) & (way * behind > 0)
    # Noise at the edge jumps there and back, which says nothing of the motion.
    lone = np.diff(at, prepend=-2, append=steps.size + 2).clip(max=2)
    lone = (lone[:-1] > 1) & (lone[1:] > 1)
    if np.count_nonzero(against & lone) <= _AGAINST * np.count_nonzero(lone):
        return None
    sizes = np.abs(steps[at] - (before + behind) / 2)[lone]
    size = float(np.median(sizes))
    if size < span * (1 - _BEYOND_WRAP):
        return None
    if np.any(np.abs(steps[others]) > _SAFE_STEP * size):
        return None
    spread = float(np.ptp(sizes))
    uneven = 2 * float(np.max(np.abs(np.diff(steps[others]))))  # as of samples that jitter
    parts = [turn * whole for whole in (*range(2, 11), *(1 / part for part in range(2, 201)))]
    known = [
        near
        for wraps, most in (((turn, *(2.0**bits for bits in range(8, 33))), _KNOWN_WRAP), (parts, _PART_OF_TURN))
        if abs((near := min(wraps, key=lambda one: abs(one - size))) - size)
        <= min(max(spread, uneven) + _PART_OF_TURN * size, most * size)
    ]
    size = known[0] if known else float(round(size)) if np.all(values == np.round(values)) else size
    return Wrap(size, int(at.size), int(moved[at[0]]), bool(known), spread <= _ALIKE * size + uneven)


def unwrap(values: FloatArray, wrap: float) -> FloatArray:
    """Unwrap a position (samples,), taking the shorter way at each step."""
    steps = np.diff(values)
    return np.asarray(values - wrap * np.concatenate([[0.0], np.cumsum(np.round(steps / wrap))]))


def wrap_faults(name: str, values: FloatArray, wrap: float) -> list[str]:
    """Faults of raw values (samples,) that contradict their wrap or move too fast."""
    span = float(np.ptp(values))
    if span > wrap * (1 + _BEYOND_WRAP):
        return [f"{name} spans {span:g}, more than its wrap of {wrap:g}; correct the wrap, or leave it out."]
    steps = np.abs(np.diff(unwrap(values, wrap)))
    fast = np.flatnonzero(steps > _SAFE_STEP * wrap)
    if fast.size == 0:
        return []
    return [
        f"{name} moves by {steps[fast[0]] / wrap:.2f} of its wrap of {wrap:g} after sample {fast[0]} (at most "
        f"{_SAFE_STEP:g} can be distinguished from a move backwards); log it more often, or correct the wrap."
    ]
