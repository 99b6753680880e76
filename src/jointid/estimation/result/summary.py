"""An estimate as a document, short or full, and its tables."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from itertools import groupby
from typing import TYPE_CHECKING, TypeAlias

import numpy as np

from jointid.common.document import Block, Document, Facts, Table, Text, common_facts
from jointid.common.text import in_words, interval, number
from jointid.estimation.result.agreement import Alone
from jointid.estimation.result.verdict import OF_MECHANICS, Subject, moved_by_loop, told_bounds, trust_in_axis
from jointid.models.robots.robot import Robot
from jointid.simulation.start import INITIAL
from jointid.uncertainty.covariance import INTERVAL
from jointid.uncertainty.identifiability import INSEPARABLE

if TYPE_CHECKING:
    from jointid.estimation.result.estimate import Estimate, EstimatedParameter

Column: TypeAlias = tuple[str, Sequence[str], bool]
"""Header and cells of a column, and whether they are words."""

_SHOWN_SHIFT = 0.5  # standard errors that a fault moves a parameter by at least to be marked beside it
_KNOWN = 1.0  # relative standard error: a robot's parameter that is known worse stands in the details only


def describe_estimate(estimate: Estimate, *, details: bool = False) -> Document:
    """Return an estimate as a document.

    Args:
        estimate: of one record, of several, of a long log, or of a robot.
        details: whether to show every answer with all its statements, effort and settings; else only the questions that
            did not pass and can be acted on, a line each, that on the loop first.
    """
    listed = list[tuple[str, bool | None, str]]()
    for asked, found in groupby(
        estimate.checks, lambda one: "mechanics" if one.code in OF_MECHANICS else str(one.name)
    ):
        first, *others = found
        brief = first.brief + f" (and {len(others)} more)" * bool(others)
        listed.append((asked, first.passed, "\n".join(one.words for one in (first, *others)) if details else brief))
    passed = [good for _, good, _ in listed]
    listed = [row for row in listed if details or not (row[1] or row[0] == Subject.WHITENESS)]
    listed.sort(key=lambda row: row[0] not in (Subject.LOOP, "mechanics"))
    notes = [] if passed and not details else [("note", note) for note in estimate.notes]
    blocks = (
        *_tables(estimate, details=details),
        Facts(tuple((asked, said) for asked, _, said in listed), tuple(good for _, good, _ in listed)),
        Facts((*(("warning", warning) for warning in estimate.warnings), *notes)),
        Facts(tuple(_facts(estimate, passed, details=details))),
    )
    return Document(estimate.sentence, blocks)


def _tables(estimate: Estimate, *, details: bool) -> Iterator[Block]:
    """Yield tables: errors by axis, parameters, combinations, bounds, segments, sums."""
    fit, rows, parts = estimate.fit, estimate.rows, _parts_of(estimate, "segments")
    if axes := [*fit.axis_errors]:
        errors = [
            (f"{name}, %", [f"{100 * of[a]:.3g}" if math.isfinite(of[a]) else "runs away" for a in axes], False)
            for name, of in (("torque left", fit.axis_errors), ("nominal", fit.nominal_errors))
            if of
        ]
        told = sorted((p for p in rows if p.name.endswith((".coulomb", ".stiffness"))), key=lambda p: p.name)
        last = {p.axis: f"{p} {p.unit}" for p in told}  # a joint's stiffness, if it has one
        caption = "filtered torque that is left, of the record it was identified from"
        shown = ("stiffness or friction", [last.get(a, "-") for a in axes], True)
        trust = ("trust", [in_words(trust_in_axis(estimate, a)) for a in axes], True)
        yield _table(caption, ("joint", axes, True), *errors, shown, trust)
    yield parameters_table(estimate, details=details)
    if known := [] if estimate.known is None else estimate.known.physical:
        each = [interval(one.value, INTERVAL * math.hypot(one.std, one.lack_of_fit)) for one in known]
        yield _table(
            "known together",
            ("combination", [one.combination.name for one in known], True),
            ("value ± 2 sigma", each, False),
            ("unit", [one.combination.unit for one in known], True),
            *([("symbol", [one.combination.formula for one in known], True)] if details else []),
        )
    if bounds := told_bounds(estimate):
        least = [f"{b.stiffness:.3g}" if b.stiffness else "not bounded" for b in bounds]
        yield _table(
            "the stiffness is refused; its lower bound (95 %, mode damped by up to 15 %)",
            ("load's share of the inertia", [f"{b.share:.2f}" for b in bounds], True),
            (f"stiffness at least [{estimate['stiffness'].unit}]", least, False),
            ("mode [Hz]", [f"{b.frequency:.0f}" if b.frequency else "-" for b in bounds], False),
        )
    if parts:
        own = [p for p in rows if p.free and p.of_joint]
        alone = [{n: interval(one.values[n], INTERVAL * one.std[n]) for n in one.values} for one in parts]
        yield _table(
            "each by itself, ± 2 sigma without what all of them err alike",
            ("", [one.name for one in parts], True),
            *((f"{p.symbol} {p.unit}", [one.get(p.name, "-") for one in alone], False) for p in own),
            ("error %", [f"{100 * one.filtered_error:.2f}" for one in parts], False),
        )
    # A base parameter has the name of a sum; what has the name of a joint's number and is a sum always says so.
    if sums := [p for p in rows if p.formula not in ("", p.symbol) and (details or p.name != p.symbol)]:
        yield Text("Sums that the parameters stand for", "heading")
        yield Text("\n".join(f"{p.name}: {p.formula}" for p in sums), "list")


def _table(caption: str, *columns: Column) -> Table:
    """Return the table of some columns."""
    header, cells, words = zip(*columns, strict=True)
    return Table(header, tuple(zip(*cells, strict=True)), caption, tuple(i for i, word in enumerate(words) if word))


def _facts(estimate: Estimate, passed: Sequence[bool | None], *, details: bool) -> Iterator[tuple[str, str]]:
    """Yield facts: fit, passed questions, method, data and side of values."""
    fit, data, settings, system = estimate.fit, estimate.data, estimate.settings, estimate.settings.system
    if not fit.axis_errors:
        raw = f"{100 * fit.relative_error:.4f} % raw, " if math.isfinite(fit.relative_error) else ""
        yield "torque error", f"{raw}{100 * fit.filtered_error:.4f} % filtered ({fit.rows} rows)"
    if (windows := data.windows) is not None:
        still = f", {windows.still} without motion left out" if windows.still else ""
        each = f"{windows.count} of {windows.length:g} s, and {windows.settling:g} s at either end{still}"
        yield "windows", f"{each}; {number(windows.duration / 3600, 3)} h"
    if details:
        passes = f", {fit.passes} times over the whole" if fit.passes else ""
        yield "effort", f"{fit.simulations} simulations{passes}"
    if passed:
        yield "checks", f"{passed.count(True)} of {len(passed)} passed"
    if isinstance(system, Robot):
        yield "method", f"{system.name}, {settings.variant}"
    else:
        yield "method", f"{system.model} joint, {settings.variant}, of {data.record}"
        yield "read", ", ".join(data.channels)
        yield from common_facts(data.resampled, system.transmission or "none: values are on the motor side")


def parameters_table(estimate: Estimate, *, details: bool = True, truth: Mapping[str, float] | None = None) -> Table:
    """Table of the parameters with their intervals.

    Args:
        estimate: whose parameters are shown.
        details: whether to show symbols, the state at the first sample, and insignificant values of a robot.
        truth: true values by name, others are not shown.
    """
    said, hidden = remarks(estimate), 0
    if truth is not None:
        rows = [p for p in estimate.rows if p.name in truth]
    else:
        rows = [p for p in estimate.rows if _is_listed(p, details=details)]
        hidden = sum(bool(p.formula) for p in estimate.rows) - sum(bool(p.formula) for p in rows)
    columns: list[Column] = [
        ("parameter", [in_words(p.name) for p in rows], True),
        ("value ± 2 sigma", [str(p) for p in rows], False),
        ("unit", [p.unit for p in rows], True),
    ]
    if truth is not None:
        columns.append(("truth", [f"{truth[p.name]:.6g}" for p in rows], False))
    elif any(p.nominal is not None for p in rows):
        columns.append(("nominal", ["-" if p.nominal is None else number(p.nominal, 4) for p in rows], False))
    for k, one in enumerate(_parts_of(estimate, "records"), 1):
        alone = {name: interval(value, INTERVAL * one.std[name]) for name, value in one.values.items()}
        columns.append((f"{k} alone", [alone.get(p.name, "-") for p in rows], False))
    if any(p.name in said for p in rows):
        columns.append(("remark", [said.get(p.name, "") for p in rows], True))
    if details:
        columns.append(("symbol", [p.symbol for p in rows], True))
    return _table(f"{hidden} more are not significant in this record" if hidden else "", *columns)


def _parts_of(estimate: Estimate, of: str) -> tuple[Alone, ...]:
    return estimate.agreement.parts if estimate.agreement is not None and estimate.agreement.of == of else ()


def _is_listed(p: EstimatedParameter, *, details: bool) -> bool:
    """Test whether a parameter has a row: for robots, significant or bounded."""
    if not p.formula:
        return details or p.name.partition("@")[0] not in INITIAL
    if p.value is None:
        return p.lower_bound is not None
    return details or not p.free or p.at_bound is not None or (p.stderr or 0.0) < _KNOWN * abs(p.value)


def remarks(estimate: Estimate) -> dict[str, str]:
    """Remarks on parameters by name: change by a correction, or strong correlation."""
    rows = {p.name: p for p in estimate.rows if p.value is not None}
    moved = {name: sum(by) for name, by in moved_by_loop(estimate).items() if name in rows}
    shown = {name: by for name, by in moved.items() if abs(by) > _SHOWN_SHIFT * (rows[name].stderr or 0.0)}
    found = {name: [f"would change by {number(by, 3, '+')}"] for name, by in shown.items()}
    for i, j in np.argwhere(np.abs(estimate.correlation) > INSEPARABLE):
        one, other = estimate.free[i], estimate.free[j]
        apart = i != j and not estimate.fit.axis_errors
        if apart and all(name in rows and rows[name].of_joint for name in (one, other)):
            found.setdefault(one, []).append(f"only with {in_words(other)}")
    return {name: ", ".join(said) for name, said in found.items()}
