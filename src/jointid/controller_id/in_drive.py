"""Learned controller numbers in the drive's units, beside the declared ones."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

from jointid.common.arrays import FloatArray
from jointid.common.document import Table
from jointid.common.text import number
from jointid.controller_id.intervals import LearnedNumber
from jointid.models.controllers.drive_numbers import DriveNumber


@dataclass(frozen=True, slots=True)
class NumberInDrive:
    """One learned number in the drive's unit.

    Attributes:
        name: of it in the drive, as integral_time for an integral gain.
        value: in the drive's unit.
        declared: what the joint file says, in that unit; None where it says nothing.
    """

    name: str
    value: float
    lower: float
    upper: float
    unit: str
    declared: float | None = None

    @property
    def spread(self) -> float:
        """Distance from the value to the further end of its interval."""
        return max(self.upper - self.value, self.value - self.lower)

    @property
    def difference(self) -> float | None:
        """Relative deviation from the declared value; None if none is declared."""
        return self.value / self.declared - 1.0 if self.declared else None


def numbers_in_drive(
    learned: Sequence[LearnedNumber], correlation: FloatArray, shown: Iterable[DriveNumber]
) -> tuple[NumberInDrive, ...]:
    """Convert learned numbers to the drive's; empty if the drive shows them unchanged.

    Args:
        learned: the numbers.
        correlation: (numbers, numbers) of their errors.
        shown: conversion to the drive's numbers.
    """
    known, places = {one.number: one for one in shown}, {one.name: place for place, one in enumerate(learned)}
    law = {one.name: one.value for one in learned}
    both = [(one, to) for one in learned if (to := known.get(one.name)) and (not to.per or law.get(to.per))]
    if not any(to.tells_more for _, to in both):
        return ()
    found = []
    for one, to in both:
        lower, upper = one.lower, one.upper
        if to.per:  # of a ratio, by the derivatives by both
            other = learned[places[to.per]]
            spreads = one.spread, other.spread * one.value / other.value
            common = correlation[places[one.name], places[to.per]] * spreads[0] * spreads[1]
            far = math.sqrt(max(spreads[0] ** 2 + spreads[1] ** 2 - 2 * common, 0.0))
            lower, upper = one.value - far, one.value + far
        ends = sorted((to.of(lower, law), to.of(upper, law)))
        if to.inverse and not lower > 0:  # the interval of the gain holds 0, that of the time no end
            ends = [to.of(upper, law), math.inf] if upper > 0 else [-math.inf, math.inf]
        found.append(NumberInDrive(to.name, to.of(one.value, law), ends[0], ends[1], to.unit, to.declared))
    return tuple(found)


def drive_table(numbers: tuple[NumberInDrive, ...]) -> Table:
    """Table of the drive's numbers beside the declared ones."""
    compared = any(one.declared is not None for one in numbers)
    header = ("in the drive", "learned", "+-", "unit", *(("declared", "differs by") if compared else ()))
    rows = []
    for one in numbers:
        beside: tuple[str, ...] = ()
        if compared:
            differs = "-" if one.difference is None else f"{100 * one.difference:+.2g} %"
            beside = ("-" if one.declared is None else f"{one.declared:.6g}", differs)
        rows.append((one.name, number(one.value, 5), number(one.spread, 2), one.unit, *beside))
    return Table(header, tuple(rows), words=(0, 3))
