"""The lines of an answer's tables: a parameter, what is known of several together, a bound of the stiffness."""

from __future__ import annotations

import math

from jointid.common.text import number
from jointid.estimation.result.params import EstimatedParameter
from jointid.models.refer import OtherSide
from jointid.uncertainty.identifiability import Known
from jointid.uncertainty.verdict import StiffnessBound

_LOST = 1000.0  # %: a deviation so much larger than its value says nothing in percent


def shown(p: EstimatedParameter) -> str:
    """Return a value as tables print it; of a refused one what is known instead."""
    if p.value is None:
        return "not identifiable" if p.lower_bound is None else f"> {number(p.lower_bound)}"
    return number(p.value)


def parameter_row(p: EstimatedParameter) -> tuple[str, ...]:
    """Return symbol, words, value, two deviations, one in percent, and unit."""
    words = p.name.replace("_", " ")
    if p.value is None or p.stderr is None or not p.free:
        return p.symbol, words, shown(p), "fixed" if p.value is not None and not p.free else "-", "-", p.unit
    percent = 100 * p.stderr / abs(p.value) if p.value else math.inf
    relative = f"{percent:.2f}" if percent < _LOST else "-"
    return p.symbol, words, number(p.value), number(2 * p.stderr, 2), relative, p.unit


def known_line(known: Known, there: Known | None, side: OtherSide | None) -> str:
    """Return the line of a combination; `there` is the same on the other side, where there is one."""
    c = known.combination
    line = f"{c.formula:14} {number(known.value):>11} +- {number(2 * known.std, 2)} {c.unit}"
    if there is None or side is None:
        return line
    return f"{line}  ({number(there.value)} {there.combination.unit} on the {side.side} side)"


def bound_line(bound: StiffnessBound, unit: str, side: OtherSide | None) -> str:
    """Return the line of a bound, in `unit` on the joint's side, and what it is on the other side."""
    if bound.stiffness is None:
        return f"share {bound.share:4.2f}  not bounded by this record"
    there = ""
    if side is not None:
        value = number(side.ratio**2 * bound.stiffness, 2)
        there = f" ({value} {side.unit(unit)} on the {side.side} side)"
    return (
        f"share {bound.share:4.2f}  {number(bound.stiffness, 2):>8} {unit}{there}, a mode at {bound.frequency:.0f} Hz"
    )
