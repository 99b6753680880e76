"""Legend of symbols and remarks in a table of parameters: the field's letters beside the paper's."""

from __future__ import annotations

from collections.abc import Iterator, Mapping

from jointid.estimation.problems.base import INITIAL
from jointid.estimation.result.answer import is_another_law, loop_verdict, moved_by_loop
from jointid.estimation.result.parts import EstimateParts

SHOWN_SHIFT = 0.5
"""Standard errors that a fault moves a parameter by at least to be marked beside it."""

_LETTERS: Mapping[str, str] = {
    "inertia": "J", "motor_inertia": "J1", "load_inertia": "J2", "stiffness": "c", "damping": "d",
}  # fmt: skip


def field_symbol(name: str, unit: str) -> str:
    """Return the letter that a parameter usually has in the field, "" for one without: J of an inertia, m of a mass."""
    letter = _LETTERS.get(name.partition("@")[0], "")
    return letter.replace("J", "m") if unit == "kg" else letter


def legend(estimate: EstimateParts, *, initial: bool = True) -> Iterator[str]:
    """Yield the legend of the table of parameters, line by line.

    Args:
        estimate: whose table it is.
        initial: whether the table shows the state at the first sample.
    """
    rows = {p.name: p for p in estimate.params.rows}
    both = [rows[name] for name in ("motor_inertia", "load_inertia") if name in rows]
    if {"stiffness", "damping"} <= rows.keys() and len(both) == 2:
        (one, other), spring = both, f"{rows['stiffness'].symbol}, {rows['damping'].symbol}"
        letters = f"{field_symbol(one.name, one.unit)}, {field_symbol(other.name, other.unit)}"
        kind = "masses" if one.unit == "kg" else "inertias"
        yield f"{spring}: stiffness c and damping d of the spring; {one.symbol}, {other.symbol}: {kind} {letters}"
    if moved_by_loop(estimate, beyond=SHOWN_SHIFT):
        loop = loop_verdict(estimate)
        undecided = loop is not None and is_another_law(loop.reasons)
        when = "if the drive runs the other law" if undecided else "once the fault of loop or log is corrected"
        yield f"loop: how much the value changes {when}"
    first = [rows[name] for name in INITIAL if initial and name in rows]
    if first:
        words = ", ".join(f"{p.symbol} {p.name.removeprefix('initial_')}" for p in first)
        yield f"at the first sample: {words}"
