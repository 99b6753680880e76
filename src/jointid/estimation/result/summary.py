"""An estimate as a document: a screen of it, or all there is to say; and its tables, for every rendering of it."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from typing import TYPE_CHECKING, TypeAlias

import numpy as np

from jointid.common.document import Block, Document, Facts, Heading, Listing, Table, Verdicts
from jointid.common.parameters import POSITION_UNIT, TORQUE_UNIT, Quantity, unit_of
from jointid.common.text import in_words, interval, number
from jointid.estimation.problems.base import INITIAL
from jointid.estimation.result.answer import moved_by_loop, told_bounds
from jointid.estimation.result.parts import EstimatedParameter, format_signed, show_value
from jointid.estimation.result.verdict import Status

if TYPE_CHECKING:
    from jointid.estimation.result.estimate import Estimate

Column: TypeAlias = tuple[str, Sequence[str], bool]
"""Header and cells of a column, and whether they are words."""

_SHOWN_SHIFT = 0.5  # standard errors that a fault moves a parameter by at least to be marked beside it
_INSEPARABLE = 0.95  # a correlation that says two parameters are known only together
_KNOWN = 1.0  # relative standard error: a robot's parameter that is known worse stands in the details only


def describe_estimate(estimate: Estimate, *, details: bool = False) -> Document:
    """Return an estimate as a document.

    Args:
        estimate: of one record, of several, of a long log, or of a robot.
        details: whether to show every verdict with all its reasons, tests, effort and settings; else only the verdicts
            that did not pass, a line each.
    """
    checks, listed = estimate.checks, []
    for verdict in checks.verdicts:
        reasons = verdict.reasons if details else verdict.reasons[:1]
        if details or verdict.status is not Status.PASSED:
            said = [str(one) if details else one.brief for one in reasons]
            more = f" (and {len(verdict.reasons) - 1} more in the report)" * (len(verdict.reasons) > len(reasons))
            listed.append((str(verdict.subject), verdict.good, (*said[:-1], f"{said[-1]}{more}")))
    notes = [] if checks.verdicts and not details else [("note", note) for note in checks.notes]
    blocks = (
        *_tables(estimate, details=details),
        *([Verdicts(tuple(listed))] if listed else []),
        Facts((*(("warning", warning) for warning in checks.warnings), *notes)),
        Facts((*_results(estimate, details=details), *_sources(estimate))),
    )
    return Document(estimate.sentence, blocks)


def _tables(estimate: Estimate, *, details: bool) -> Iterator[Block]:
    """Yield errors by axis, parameters, what is known together, bounds, segments, and sums."""
    part, drift = estimate.robot, estimate.checks.drift
    if part is not None:
        columns = {"estimate": np.array([*estimate.fit.axis_errors.values()])}
        if part.model.has_masses:
            columns["nominal"] = part.nominal_errors
        shown = [[f"{100 * e:.3g}" if np.isfinite(e) else "runs away" for e in errors] for errors in columns.values()]
        rows = tuple(zip(part.model.names, *shown, strict=True))
        header = ("joint", *(f"{name}, %" for name in columns))
        yield Table(header, rows, "filtered torque that is left, of the record it was identified from")
    yield parameters_table(estimate, details=details)
    known = [] if estimate.checks.known is None else [(one, one.combination) for one in estimate.checks.known.physical]
    if known:
        rows = tuple((of.name, interval(one.value, 2 * one.std), of.unit, of.formula) for one, of in known)
        yield Table(("combination", "value ± 2 sigma", "unit", "symbol"), rows, "known together", words=(0, 2, 3))
    if bounds := told_bounds(estimate):
        header = ("load's share of the inertia", f"stiffness at least [{estimate['stiffness'].unit}]", "mode [Hz]")
        rows = tuple(
            (f"{b.share:.2f}", f"{b.stiffness:.3g}", f"{b.frequency:.0f}")
            if b.stiffness and b.frequency
            else (f"{b.share:.2f}", "not bounded", "-")
            for b in bounds
        )
        yield Table(header, rows, "the stiffness is refused; its lower bound (95 %, mode damped by up to 15 %)")
    if drift is not None:
        free = [p for p in estimate.params.rows if p.free]
        header = ("from h", "to h", *(f"{p.symbol} {p.unit}" for p in free), "error %")
        found = [{n: interval(s.values[n], 2 * s.std[n]) for n in s.values} for s in drift.segments]
        rows = tuple(
            (
                f"{s.begin / 3600:.2f}", f"{s.end / 3600:.2f}",
                *(one.get(p.name, "not excited") for p in free), f"{100 * s.filtered_error:.2f}",
            )
            for s, one in zip(drift.segments, found, strict=True)
        )  # fmt: skip
        yield Table(header, rows, "each segment by itself, ± 2 sigma without what all of them err alike", words=())
    # A base parameter has the name of a sum; what has the name of a joint's number and is a sum always says so.
    sums = tuple(
        f"{row.name} is {formula}"
        for row, formula in zip(estimate.params.rows, part.formulas if part is not None else (), strict=False)
        if row.symbol != formula and (details or row.name != row.symbol)
    )
    if sums:
        yield from (Heading("Sums that the parameters stand for"), Listing(sums))


def _results(estimate: Estimate, *, details: bool) -> Iterator[tuple[str, str]]:
    """Yield the facts of the fit and of the checks that have no verdict."""
    fit, checks, windows, part = estimate.fit, estimate.checks, estimate.data.windows, estimate.robot
    if part is None:
        raw = f"{100 * fit.relative_error:.4f} % raw, " if math.isfinite(fit.relative_error) else ""
        yield "torque error", f"{raw}{100 * fit.filtered_error:.4f} % filtered ({fit.rows} rows)"
    if fit.position_rms:
        kinds = [estimate.settings.joint.kind] if part is None else [one.kind for one in part.model.links]
        kind_of = dict(zip(("",) if part is None else part.model.names, kinds, strict=True))
        each = [f"{name} {rms:.3g} {POSITION_UNIT[kind_of[name]]}".strip() for name, rms in fit.position_rms.items()]
        yield "position error", f"{', '.join(each)} rms"
    if windows is not None:
        still = f", {windows.still} without motion left out" if windows.still else ""
        yield (
            "windows",
            f"{windows.count} of {windows.length:g} s, and {windows.settling:g} s at either end{still}; "
            f"{number(windows.duration / 3600, 3)} h",
        )
    if details:
        yield from (("test", str(test)) for test in checks.tests)
        passes = f", {fit.passes} times over the whole" if fit.passes else ""
        yield "effort", f"{fit.simulations} simulations{passes}"
    if checks.verdicts:
        passed = [verdict.good for verdict in checks.verdicts].count(True)
        yield "checks", f"{passed} of {len(checks.verdicts)} passed"


def _sources(estimate: Estimate) -> Iterator[tuple[str, str]]:
    """Return method, data and side of the values."""
    data, settings = estimate.data, estimate.settings
    if estimate.robot is not None:
        yield "method", f"{estimate.robot.model.name}, {settings.variant}"
        return
    source = f"of {data.record}" if not data.records else f"of {len(data.records)} records"
    yield "method", f"{settings.joint.model} joint, {settings.variant}, {source}"
    if not data.records:
        yield "read", ", ".join(data.channels)
    unit = unit_of(Quantity.INERTIA, settings.joint.kind, TORQUE_UNIT[settings.joint.kind])
    for k, record in enumerate(data.records, 1):
        more = f", {number(record.added_inertia)} {unit} added to the load" if record.added_inertia else ""
        error = f"{100 * record.filtered_error:.4f} % filtered ({record.rows} rows)"
        yield f"record {k}", f"{record.name}{more}; {error}; read: {', '.join(record.channels)}"
    if data.resampled is not None:
        yield "resampled", str(data.resampled)
    if settings.joint.transmission is not None:
        yield "transmission", str(settings.joint.transmission)


def parameters_table(estimate: Estimate, *, details: bool = True, truth: Mapping[str, float] | None = None) -> Table:
    """Return the parameters with their intervals.

    Args:
        estimate: whose parameters are shown.
        details: whether to show the state at the first sample, and what a robot's record does not tell from 0.
        truth: true values by name, others are not shown.
    """
    every, part, caption = estimate.params.rows, estimate.robot, ""
    if truth is not None:
        shown = [i for i, p in enumerate(every) if p.name in truth]
    elif part is None:
        shown = [i for i, p in enumerate(every) if details or p.name.partition("@")[0] not in INITIAL]
    else:
        shown = [i for i, p in enumerate(every) if _is_listed(p, details=details)]
        hidden = len(every) - len(shown)
        caption = f"{hidden} more are not significant in this record" if hidden else ""
    rows, said = [every[i] for i in shown], remarks(estimate)
    columns: list[Column] = [
        ("parameter", [in_words(p.name) for p in rows], True),
        ("value ± 2 sigma", [show_value(p) for p in rows], False),
        ("unit", [p.unit for p in rows], True),
    ]
    if truth is not None:
        columns.append(("truth", [f"{truth[p.name]:.6g}" for p in rows], False))
    elif part is not None:
        columns.append(("nominal", [number(float(part.nominal[i]), 4) for i in shown], False))
    for k, record in enumerate(estimate.data.records, 1):
        alone = {p.name: show_value(p) for p in record.alone}
        columns.append((f"{k} alone", [alone.get(p.name, "-") for p in rows], False))
    if any(p.name in said for p in rows):
        columns.append(("remark", [said.get(p.name, "") for p in rows], True))
    columns.append(("symbol", [p.symbol for p in rows], True))
    header, texts, words = zip(*columns, strict=True)
    return Table(header, tuple(zip(*texts, strict=True)), caption, tuple(i for i, word in enumerate(words) if word))


def _is_listed(p: EstimatedParameter, *, details: bool) -> bool:
    """Return whether a robot's parameter has a row: a value that the record tells from 0, or a bound."""
    if p.value is None:
        return p.lower_bound is not None
    return details or not p.free or p.at_bound is not None or (p.stderr or 0.0) < _KNOWN * abs(p.value)


def remarks(estimate: Estimate) -> dict[str, str]:
    """Return remarks on parameters, by name: how much the value changes once a fault is corrected, known only with."""
    rows = {p.name: p for p in estimate.params.rows if p.value is not None}
    moved = {name: by for name, by in moved_by_loop(estimate).items() if name in rows}
    shown = {name: by for name, by in moved.items() if abs(by) > _SHOWN_SHIFT * (rows[name].stderr or 0.0)}
    found = {name: [f"would change by {format_signed(by, 3)}"] for name, by in shown.items()}
    for i, j in np.argwhere(np.abs(estimate.params.correlation) > _INSEPARABLE) if estimate.robot is None else ():
        one, other = (estimate.params.names[k] for k in (i, j))
        if i != j and all(name in rows and rows[name].of_joint for name in (one, other)):
            found.setdefault(one, []).append(f"only with {rows[other].symbol}")
    return {name: ", ".join(said) for name, said in found.items()}
