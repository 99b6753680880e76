"""An estimate as a document, short or full, and its tables."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np

from jointid.common.document import Block, Document, Facts, Table, common_facts
from jointid.common.text import in_words, interval, join, number
from jointid.estimation.result.agreement import Alone
from jointid.estimation.result.verdict import (
    OF_MECHANICS,
    Reason,
    Subject,
    Trust,
    told_bounds,
    trust_in_axis,
)
from jointid.models.robots.robot import Robot
from jointid.simulation.start import INITIAL
from jointid.uncertainty.covariance import INTERVAL
from jointid.uncertainty.identifiability import INSEPARABLE

if TYPE_CHECKING:
    from jointid.estimation.result.estimate import Estimate, EstimatedParameter

_SHOWN_SHIFT = 0.5  # standard errors that a fault moves a parameter by at least to be marked beside it
_KNOWN = 1.0  # relative standard error: a robot's parameter that is known worse stands in the details only


def describe_estimate(estimate: Estimate, *, details: bool = False) -> Document:
    """Return an estimate as a document: tables and the lines beside them, or every check, effort and settings."""
    tables = tuple(_tables(estimate, details=details))
    if not details:
        return Document(estimate.sentence, (*tables, Facts(tuple(_lines(estimate)))))
    asked = [("mechanics" if one.code in OF_MECHANICS else str(one.name), one) for one in estimate.checks]
    asked.sort(key=lambda row: row[0] not in (Subject.LOOP, "mechanics"))
    said = {name: "\n".join(str(one) for other, one in asked if other == name) for name, _ in asked}
    marks = {name: one.passed for name, one in reversed(asked)}
    told = [("warning", one) for one in estimate.warnings] + [("note", one) for one in estimate.notes]
    answers = Facts(tuple(said.items()), tuple(marks[name] for name in said))
    return Document(estimate.sentence, (*tables, answers, Facts(tuple(told)), Facts(tuple(_facts(estimate)))))


def _lines(estimate: Estimate) -> Iterator[tuple[str, str]]:
    """Yield the lines beside answer and tables: what to do, what the record does not show, and where the rest is."""
    trust, reasons = estimate.answer.trust, estimate.answer.trust.values["reasons"]
    checks = sorted(estimate.checks, key=lambda one: (one.name != Subject.LOOP, one.name != Subject.IDENTIFIABILITY))
    wrong = [one for one in checks if one.passed is False and (one.name == Subject.LOOP or one.code in reasons)]
    unseen = Trust.REFUSED, Reason.AT_BOUND, Reason.STIFFNESS_NOT_SHOWN, Reason.WIDE_INTERVAL, Reason.NO_INTERVAL
    if {trust.code, *reasons[:1]} & {*unseen, Reason.RECORD_TOO_SHORT, Reason.HARDLY_MOVES}:
        yield "next", "record a motion that shows it" + ": jointid design plans one" * (trust.code != Trust.REFUSED)
    elif wrong:
        remedies = (one.values.get("remedy") for one in wrong[: 1 if wrong[0].name == Subject.LOOP else None])
        yield "next", f"{next(filter(None, remedies), 'correct what the first line names')}, and identify again"
    elif estimate.motion_measured:  # another record has the same bias
        yield "next", "give its controller, and identify by DIDIM"
    else:
        yield "next", "see whether it predicts another record: jointid validate"
    of_trust = (Subject.SOLVER, Subject.FIT, Subject.WHITENESS)  # which limit no value
    limits = [*(one.brief for one in checks if not one.passed and one.name not in of_trust), *estimate.warnings]
    if limits := [one for one in limits if one not in estimate.sentence and not one.startswith("not checked")]:
        yield "limits", limits[0] + f" (and {len(limits) - 1} more)" * bool(limits[1:])
    passed = [*{one.name: one.passed for one in checks}.values()]
    left = f"{100 * estimate.fit.filtered_error:.3g} % of the torque is left"
    yield "details", f"{left}, {passed.count(True)} of {len(passed)} checks passed: --details"


def _tables(estimate: Estimate, *, details: bool) -> Iterator[Block]:
    """Yield tables: errors by axis, parameters, combinations, bounds, segments."""
    fit, rows, parts = estimate.fit, estimate.rows, _parts_of(estimate, "segments")
    if axes := [*fit.axis_errors]:
        errors = [
            (f"{name}, %", [f"{100 * of[a]:.3g}" if math.isfinite(of[a]) else "runs away" for a in axes], False)
            for name, of in (("torque left", fit.axis_errors), ("nominal", fit.nominal_errors))
            if of
        ]
        told = sorted((p for p in rows if p.name.endswith((".coulomb", ".stiffness"))), key=lambda p: p.name)
        last = {p.axis: f"{p} {p.unit}" for p in told}  # a joint's stiffness, if it has one
        shown = [("stiffness or friction", [last.get(a, "-") for a in axes], True)]
        shown.append(("trust", [in_words(trust_in_axis(estimate, a)) for a in axes], True))
        yield _table("share of the filtered torque that is left", ("joint", axes, True), *errors, *shown)
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
            "each by itself, ± 2 sigma without their common error",
            ("", [one.name for one in parts], True),
            *((f"{p.symbol} {p.unit}", [one.get(p.name, "-") for one in alone], False) for p in own),
            ("error %", [f"{100 * one.filtered_error:.2f}" for one in parts], False),
        )


def _table(caption: str, *columns: tuple[str, Sequence[str], bool]) -> Table:
    """Return the table of some columns: header, cells, and whether these are words."""
    header, cells, words = zip(*columns, strict=True)
    return Table(header, tuple(zip(*cells, strict=True)), caption, tuple(i for i, word in enumerate(words) if word))


def _facts(estimate: Estimate) -> Iterator[tuple[str, str]]:
    """Yield facts: fit, effort, method, data and side of values."""
    fit, data, settings, system = estimate.fit, estimate.data, estimate.settings, estimate.settings.system
    if not fit.axis_errors:
        raw = f"{100 * fit.relative_error:.4f} % raw, " if math.isfinite(fit.relative_error) else ""
        yield "torque error", f"{raw}{100 * fit.filtered_error:.4f} % filtered ({fit.rows} rows)"
    if (windows := data.windows) is not None:
        still = f", {windows.still} without motion left out" if windows.still else ""
        each = f"{windows.count} of {windows.length:g} s, and {windows.settling:g} s at either end{still}"
        yield "windows", f"{each}; {number(windows.duration / 3600, 3)} h"
    passes = f", {fit.passes} times over the whole" if fit.passes else ""
    yield "effort", f"{fit.simulations} simulations{passes}"
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
    said = remarks(estimate)
    rows = [p for p in estimate.rows if (_is_listed(p, details=details) if truth is None else p.name in truth)]
    hidden = sum(bool(p.formula) for p in estimate.rows) - sum(bool(p.formula) for p in rows)
    columns = [
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
        columns.append(("symbol", [p.formula or p.symbol for p in rows], True))
    gear = getattr(estimate.settings.system, "transmission", None)
    caption = "" if gear is None else f"values are on the {gear.side} side"
    return _table(f"{hidden} more are not significant in this record" if hidden else caption, *columns)


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
    changes = [one.values.get("changes", {}) for one in estimate.about(Subject.LOOP)]
    moved = {name: sum(by.get(name, 0.0) for by in changes) for name in rows}
    shown = {name: by for name, by in moved.items() if abs(by) > _SHOWN_SHIFT * (rows[name].stderr or 0.0)}
    # A base parameter has the name of a sum; what has the name of a joint's number and is a sum says so.
    sums = (p for p in rows.values() if p.formula not in ("", p.symbol) and p.name != p.symbol)
    found = {p.name: [f"stands for {p.formula}"] for p in sums}
    for name, by in shown.items():
        found.setdefault(name, []).append(f"would change by {number(by, 3, '+')}")
    apart = {name for name, one in rows.items() if one.of_joint and not estimate.fit.axis_errors}
    for one, alike in zip(estimate.free, np.abs(estimate.correlation) > INSEPARABLE, strict=False):
        others = [name for name, like in zip(estimate.free, alike, strict=False) if like and name in apart - {one}]
        if others and one in apart:
            found.setdefault(one, []).append(f"only with {join([*map(in_words, others)])}")
    return {name: ", ".join(said) for name, said in found.items()}
