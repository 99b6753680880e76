"""A number of the controller in words: what it is called, and by how much it is off, as its drive shows it."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping

from jointid.common.text import number
from jointid.diagnostics.fault_tests import FaultTest
from jointid.models.controllers.drive_numbers import DriveNumber

_FACTOR = "torque, reference, ratio or a gain is wrong by a"


def call(name: str) -> str:
    """Return a number's name as a sentence has it, of a filter's number, too: "the integral time"."""
    *owner, last = name.replace("_", " ").split(".")
    if len(owner) == 2:  # one of several, which are counted
        return f"the {last} of {owner[0].removesuffix('s')} {owner[1]}"
    return f"the {last} of the {owner[0]}" if owner else f"the {last}"


def show(there: DriveNumber, value: float, law: Mapping[str, float]) -> str:
    """Return a number of a law as the drive shows it, with its unit."""
    return f"{number(there.of(value, law), 3)} {there.unit}".rstrip()


def show_times_beside(name: str, value: float, law: Mapping[str, float], shown: Iterable[DriveNumber]) -> str:
    """Return the times that change with a gain which they are per, where their own gains stay; else nothing."""
    beside = (one for one in shown if one.per == name and law.get(one.number))
    return "".join(f", with {call(one.name)} {show(one, law[one.number], {**law, name: value})}" for one in beside)


def tell_difference(name: str, s: FaultTest, scale: float, *, spread: bool) -> str:
    """Return by how much a number differs from what is declared, in percent of that, or that it cannot be this number.

    A sensitivity is no guide to a change as large as the number itself; and nothing is smaller by more than all of it.

    Args:
        name: as a sentence has it.
        s: the test of the number.
        scale: what 100 % of it is.
        spread: whether to give the interval.
    """
    share, deviation = s.size / scale, 2 * s.std / scale
    if (no_size := _tell_no_size(name, share, deviation, share > 0)) is not None:
        return no_size
    sense = "larger" if share > 0 else "smaller"
    if share > 1:
        times = f"{number(1 + share, 2)} times"
        return f"{_FACTOR} factor ({name} alone would be about {times} as large)"
    if share - deviation <= -1:
        return f"{name} is at least {number(100 * (abs(share) - deviation), 2)} % smaller than declared"
    percent = number(100 * abs(share), 2) + (f" +- {number(100 * deviation, 2)}" if spread else "")
    return f"{name} is {percent} % {sense} than declared"


def tell_difference_in_drive(there: DriveNumber, s: FaultTest, law: Mapping[str, float], *, spread: bool) -> str:
    """Return what a number is and what it is declared as, both as the drive shows them: a time for a gain, say.

    Args:
        there: how the drive shows it.
        s: the test of the number.
        law: the numbers as they are declared.
        spread: whether to give the interval, the longer half of it.
    """
    name, value = call(there.name), s.declared + s.size
    share, deviation = s.size / abs(s.declared), 2 * s.std / abs(s.declared)
    if (no_size := _tell_no_size(name, share, deviation, (share > 0) is not there.inverse)) is not None:
        return no_size
    declared = f"declared {there.of(s.declared, law):.6g} {there.unit}"
    if share > 1:
        return f"{_FACTOR} factor ({name} alone would be about {show(there, value, law)}, {declared})"
    if share - deviation <= -1:
        bound = "least" if there.inverse else "most"
        return f"{name} is at {bound} {show(there, value + 2 * s.std, law)}, {declared}"
    told = there.of(value, law)
    far = max(abs(there.of(value + by, law) - told) for by in (-2 * s.std, 2 * s.std))
    interval = f" +- {number(far, 2)}" if spread else ""
    digits = max(3, 1 + math.ceil(-math.log10(abs(share))))  # so many that the two are not the same
    return f"{name} is {number(told, digits)}{interval} {there.unit}, {declared}"


def _tell_no_size(name: str, share: float, deviation: float, more: bool) -> str | None:
    """Return the sentence where a size would be absurd, or is not known; else None."""
    if share <= -1:
        return f"{_FACTOR} large factor ({name} alone would have to change its sign)"
    if share <= 1 and deviation >= abs(share):
        return f"{name} is {'larger' if more else 'smaller'} than declared, by how much this record does not tell"
    return None
