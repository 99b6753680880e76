"""Columns of a table for a record's channels: unit, gain and sign."""

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

_FEWEST_MOVES = 3  # fewest steps other than jumps
_SAFE_STEP = 0.4  # largest step as a share of the wrap: from a half on, its direction is ambiguous
_BEYOND_WRAP = 1e-2  # tolerated excess of the range over the wrap, relative
_WHOLE_RANGE = 0.6  # of the range of a column: a larger step may be a wrap
_ALIKE = 0.02  # largest spread of the jumps, as a share of the wrap
_AGAINST = 0.8  # smallest share of the jumps that oppose a steady motion
_KNOWN_WRAP, _PART_OF_TURN = 2e-3, 1e-4  # largest relative distance of a jump from a known wrap
_WORDS = (2.0**8, 2.0**11, 2.0**16, 2.0**32)  # ranges of logged integers; a ten-bit load has its sign in bit 11
POSITIONS = ("motor_position", "load_position", "reference")
_IN_BRACKETS = re.compile(r"[\[(]\s*([^\[\]()]+?)\s*[\])]\s*$")


@add_settings_to_docstring
@dataclass(frozen=True, slots=True)
class Column:
    """A file column for one channel: `sign` x `gain` x column, in `unit`.

    Raises:
        RecordError: gain, sample_time or wrap is not positive and finite, sign is not 1 or -1, or the side is
            unknown.
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
    gain: float = setting(1.0, "factor from the column to the unit", above=0)
    sign: int = setting(1, "-1 reverses the channel", only=(1, -1))
    timing: Timing | None = setting(
        None,
        "whether a value is sampled at its instant, held until the next, or the mean since the last one; by default "
        "held for torque and injected, sampled for the others",
    )
    sample_time: float | None = setting(
        None,
        "the channel's own time between samples, if it differs from the record's; of a column with repeated values or "
        "empty rows, those with a new value are read",
        unit="s",
        above=0,
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
        "side of the transmission on which the channel is measured; by default the load's for load_position, the "
        "motor's for the others",
    )
    wrap: float | None = setting(
        None,
        "range after which a position begins anew, in numbers of the column, such as 65536 or 360; the position is "
        "unwrapped, and a move of more than 0.4 of the range in a sample is refused. For a torque, 2^n of a word that "
        "was read without its sign. By default, clear jumps decide",
        above=0,
    )
    optional: bool = setting(False, "whether a record may lack the column")
    time: str | None = setting(None, "name of the channel's own time column, where it has one")

    def __post_init__(self) -> None:
        check_settings(self, RecordError, f'Column "{self.column}"')

    def stated_unit(self, known: tuple[str, ...]) -> str | None:
        """Unit stated here or in the column's name, if any."""
        # A gain converts the values from the unit in the name to another one.
        if self.unit is not None:
            return self.unit if self.unit in known else units.normalise_unit(self.unit)
        return None if self.gain != 1 else unit_in_name(self.column, known)


def as_columns(given: Mapping[str, str | Column]) -> dict[str, Column]:
    """Convert column names to `Column` objects, by channel."""
    return {channel: Column(one) if isinstance(one, str) else one for channel, one in given.items()}


def unit_in_name(column: str, known: tuple[str, ...]) -> str | None:
    """Unit at the end of a column's name, one of another kind too; unknown ones in brackets."""
    match = _IN_BRACKETS.search(column)
    if match is None or match[1].isdigit():  # "phi[0]" is an element
        return None
    # "q [clicks]" is refused, not read as metres; "(filtered)" in "q (filtered)" is a remark, as is "(A)" of an axis.
    said = match[1] if match[1] in known else units.normalise_unit(match[1])
    another = said in units.units_of() and len(said) > 1 and said != "min"
    return (said or None) if said in known or another or column.rstrip().endswith("]") else None


def unit_fault(name: str, known: tuple[str, ...]) -> str:
    """Describe an unknown unit, as a predicate."""
    return f'is in "{name}"; expected one of {", ".join(known)}: give its unit, and the gain to it'


def finite_faults(name: str, values: FloatArray) -> list[str]:
    """Return the fault of non-finite values, (samples,), if any; `name` is theirs."""
    bad = np.flatnonzero(~np.isfinite(values))
    if bad.size == 0:
        return []
    first = int(bad[0])
    return [
        f"{name} has {pluralise(bad.size, 'sample')} of {values.size} without a finite number, the first "
        f"{values[first]} at sample {first}; mend them, cut the record there, give a channel of another rate its "
        "sample_time, or give resample."
    ]


def find_wrap(values: FloatArray, turn: float) -> tuple[float, bool] | None:
    """Find the wrap of a position column, (samples,); None without clear jumps.

    At a wrap a step d spans nearly the whole range, against the motion v before and after it: W = |d - v|. A square
    wave is excluded, since it rests between jumps.

    Args:
        values: of the column, finite.
        turn: one turn in the column's unit.

    Returns:
        The wrap, and whether it is a multiple or fraction of a turn, or a power of two.
    """
    with np.errstate(over="ignore"):
        steps, span = np.diff(values), float(np.ptp(values))
    steps = steps[steps != 0]  # a slowly refreshed column repeats its values
    jumps = np.abs(steps) > _WHOLE_RANGE * span
    if not (np.isfinite(span) and jumps.any() and np.count_nonzero(~jumps) > _FEWEST_MOVES):
        return None
    at, others = np.flatnonzero(jumps), np.flatnonzero(~jumps)
    after = np.searchsorted(others, at).clip(1, others.size - 1)
    before, behind = steps[others[after - 1]], steps[others[after]]
    way = -np.sign(steps[at])
    against = (way * before > 0) & (way * behind > 0)
    # Noise at the edge jumps back and forth, independent of the motion.
    lone = np.diff(at, prepend=-2, append=steps.size + 2).clip(max=2)
    lone = (lone[:-1] > 1) & (lone[1:] > 1)
    if np.count_nonzero(against & lone) <= _AGAINST * np.count_nonzero(lone):
        return None
    sizes = np.abs(steps[at] - (before + behind) / 2)[lone]
    size, spread = float(np.median(sizes)), float(np.ptp(sizes))
    uneven = 2 * float(np.max(np.abs(np.diff(steps[others]))))  # as of samples that jitter
    slow = np.all(np.abs(steps[others]) <= _SAFE_STEP * size)
    if size < span * (1 - _BEYOND_WRAP) or not slow or spread > _ALIKE * size + uneven:
        return None
    wraps = {turn * part: _PART_OF_TURN for part in (*range(2, 11), *(1 / whole for whole in range(2, 201)))}
    wraps |= dict.fromkeys((turn, *(2.0**bits for bits in range(8, 33))), _KNOWN_WRAP)
    near = min(wraps, key=lambda one: abs(one - size))
    if abs(near - size) <= min(max(spread, uneven) + _PART_OF_TURN * size, wraps[near] * size):
        return near, True
    whole = np.allclose(values, np.round(values), rtol=0.0, atol=1e-3)
    return float(round(size)) if whole else size, False


def restore_sign(values: FloatArray) -> FloatArray | None:
    """Restore the sign of unsigned whole numbers, (samples,), or return None.

    A negative number was read as an unsigned word, 2^n larger, or has a sign bit: it jumps at 0.
    """
    whole = np.all(values >= 0) and np.all(values == np.round(values))
    found, fastest = None, _SAFE_STEP * float(np.max(np.abs(np.diff(values)), initial=0.0))
    for size in (size for size in _WORDS if whole and size / 2 <= np.max(values) < size):
        sign = values >= size / 2
        for signed in (values - size * sign, np.where(sign, size / 2 - values, values)):
            step = float(np.max(np.abs(np.diff(signed))))
            if step < fastest and np.count_nonzero(np.diff(sign)) > _FEWEST_MOVES:
                found, fastest = signed, step
    return found


def unwrap(values: FloatArray, wrap: float, name: str = "The position") -> FloatArray:
    """Unwrap a position (samples,), taking the shorter way at each step.

    Raises:
        RecordError: the values span more than their wrap, or move by more than 0.4 of it in a sample.
    """
    steps, span = np.diff(values), float(np.ptp(values))
    turns = np.round(steps / wrap)
    fastest = float(np.max(np.abs(steps - wrap * turns), initial=0.0))
    if span > wrap * (1 + _BEYOND_WRAP) or fastest > _SAFE_STEP * wrap:
        raise RecordError(
            f"{name} spans {span:g} and moves by up to {fastest:g} in a sample; expected at most its wrap of {wrap:g}, "
            f"and {_SAFE_STEP:g} of it in a sample: log it more often, correct the wrap, or leave it out."
        )
    return np.asarray(values - wrap * np.concatenate([[0.0], np.cumsum(turns)]))
