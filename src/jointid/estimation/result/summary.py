"""An estimate as a document: a screen of it, or all there is to say; and its tables, for every rendering of it."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from typing import TypeAlias

import numpy as np

from jointid.common.document import Block, Document, Facts, Heading, Listing, Paragraph, Table, Tone, Verdicts
from jointid.common.parameters import POSITION_UNIT
from jointid.common.text import format_signed, in_words, interval, number
from jointid.estimation.problems.base import INITIAL
from jointid.estimation.problems.log_windows import VISITS
from jointid.estimation.result.agreement import DriftTest
from jointid.estimation.result.answer import (
    Trust,
    answer_of,
    is_another_law,
    loop_verdict,
    moved_by_loop,
    told_bounds,
)
from jointid.estimation.result.parts import EstimatedParameter, EstimateParts, show_value
from jointid.estimation.result.robot import IdentifiedRobot
from jointid.uncertainty.identifiability import Kind
from jointid.uncertainty.verdict import Status

_SHOWN = 2.0  # standard errors that a trend has at least to be printed as one
_INSEPARABLE = 0.95  # a correlation that says two parameters are known only together
_LOST = 2000.0  # %: a deviation so much larger than its value says nothing in percent


def describe_estimate(estimate: EstimateParts, *, details: bool = False) -> Document:
    """Return an estimate as a document.

    Args:
        estimate: of one record, of several, of a long log, or of a robot.
        details: whether to show every verdict with all its reasons, tests, effort and settings; else only the verdicts
            that did not pass, a line each.
    """
    fit, checks, part = estimate.fit, estimate.checks, estimate.robot
    verdicts = tuple(_verdicts(estimate, details=details))
    warnings = [("warning", warning) for warning in checks.warnings]
    if part is not None:
        answer = answer_of(estimate)
        return Document(
            f"{part.model.name}: {len(part.names)} parameters of {len(part.model)} joints",
            (
                Paragraph(str(answer), tone=_TONES.get(Trust(answer.trust.code), "open")),
                *verdicts,
                Facts(tuple(warnings)),
                *(Paragraph(f"{one}.") for one in part.springs),
                Facts((("method", estimate.settings.variant), ("search", fit.stop), *_position_error(estimate))),
                *_robot_tables(estimate, part, details=details),
            ),
        )
    facts = [*_results(estimate, details=details)]
    if details:
        facts += _effort(estimate)
    elif fit.interrupted or not (fit.converged or checks.verdicts):  # no verdict says why it ended so
        facts += [("stopped", fit.stop)]
    facts += _limits(estimate, details=details)
    if checks.verdicts:
        facts += [("checks", _count_checks(estimate))]
    notes = [] if checks.verdicts and not details else [("note", note) for note in checks.notes]
    return Document(
        str(answer_of(estimate)),
        (
            *_tables(estimate, details=details),
            *verdicts,
            Facts((*warnings, *notes)),
            Facts((*facts, *_sources(estimate))),
        ),
    )


def _count_checks(estimate: EstimateParts) -> str:
    """Return the number of passed checks, in words."""
    marks = [verdict.good for verdict in estimate.checks.verdicts]
    passed = marks.count(True)
    return f"all {passed} passed" if passed == len(marks) else f"{passed} of {len(marks)} passed"


def _sources(estimate: EstimateParts) -> Iterator[tuple[str, str]]:
    """Return method, data and side of the values."""
    data, joint = estimate.data, estimate.settings.joint
    gear = joint.transmission
    source = f"of {data.record}" if not data.records else f"of {len(data.records)} records"
    yield "method", f"{joint.model} joint, {estimate.settings.variant}, {source}"
    if not data.records:
        yield "read", ", ".join(data.channels)
    for k, record in enumerate(data.records, 1):
        unit = next(p.unit for p in (*estimate.params.rows, *estimate.params.own[k - 1]) if p.name.endswith("inertia"))
        more = f", {number(record.added_inertia)} {unit} added to the load" if record.added_inertia else ""
        yield f"record {k}", f"{record.name}{more}; read: {', '.join(record.channels)}"
        if record.resampled is not None:
            yield "resampled", str(record.resampled)
    if data.resampled is not None:
        yield "resampled", str(data.resampled)
    if gear is not None:
        yield "transmission", str(gear)


def _tables(estimate: EstimateParts, *, details: bool) -> Iterator[Block]:
    if estimate.data.records:
        yield _shared_table(estimate)
        own = [(k, each) for k, rows in enumerate(estimate.params.own, 1) for each in rows]
        if own:
            yield _table([each for _, each in own], [("record", [str(k) for k, _ in own], False)])
        errors = tuple(
            (str(k), *map(_share, (r.relative_error, r.filtered_error, r.alone_error)), str(r.rows))
            for k, r in enumerate(estimate.data.records, 1)
        )
        yield Table(("record", "error % raw", "filtered", "filtered, alone", "rows"), errors)
        return
    yield parameters_table(estimate, details=details)
    if moved_by_loop(estimate, threshold=SHOWN_SHIFT):
        yield Paragraph(describe_loop_remark(estimate))
    for table in (
        combinations_table(estimate, "known together", differences=details),
        bounds_table(estimate, "the stiffness is refused; its lower bound (95 %, mode damped by up to 15 %)"),
    ):
        if table is not None:
            yield table
    drift = estimate.checks.drift
    if drift is not None and drift.segments:
        free = [p for p in estimate.params.rows if p.free]
        header = ("from h", "to h", *(f"{p.symbol} {p.unit}" for p in free), "error %")
        rows = []
        for s in drift.segments:
            found = {n: interval(s.values[n], 2 * s.std[n]) for n in s.values}
            stated = (found.get(p.name, "not excited") for p in free)
            rows.append((f"{s.begin / 3600:.2f}", f"{s.end / 3600:.2f}", *stated, f"{100 * s.filtered_error:.2f}"))
        caption = "each segment by itself, ± 2 sigma to compare them by; without what all of them err alike"
        yield Table(header, tuple(rows), caption, words=())


def _share(error: float) -> str:
    return f"{100 * error:.4f}" if math.isfinite(error) else "-"  # in windows no raw torque is kept


def _results(estimate: EstimateParts, *, details: bool) -> Iterator[tuple[str, str]]:
    fit, checks, windows = estimate.fit, estimate.checks, estimate.data.windows
    if checks.agreement is not None and not checks.agreement.differs:  # else it is a warning
        yield "agreement", str(checks.agreement)
    if windows is not None:
        yield "torque error", f"{100 * fit.filtered_error:.4f} % filtered ({fit.rows} rows)"
        still = f", {windows.still} without motion left out" if windows.still else ""
        yield (
            "windows",
            f"{windows.count} of {windows.length:g} s, and {windows.settling:g} s at either end{still}; "
            f"{number(windows.duration / 3600, 3)} h",
        )
    elif checks.agreement is None:
        left, rows = "", ""
        if details:
            left = f" ({fit.borders[0]} + {fit.borders[1]} samples at the ends left out)"
            rows = f" ({fit.rows} rows)"
        known = math.isfinite(fit.relative_error)  # a long log keeps no raw torque
        raw = f"{100 * fit.relative_error:.4f} % raw{left}, " if known else ""
        yield (
            "torque error",
            f"{raw}{100 * fit.filtered_error:.4f} % filtered{rows}"
            f"{estimate.signal.removeprefix('torque').replace(' comp', ', comp')}",
        )
    yield from _position_error(estimate)
    if checks.drift is not None:
        yield "drift", describe_drift(checks.drift, estimate.params.rows)


def _position_error(estimate: EstimateParts) -> Iterator[tuple[str, str]]:
    """Yield the errors of the simulated motor positions, in mm or degrees, where there are any."""
    each = []
    for name, rms in estimate.fit.position_rms.items():
        robot = None if estimate.robot is None else estimate.robot.model
        unit = (
            POSITION_UNIT[estimate.settings.joint.kind]
            if robot is None
            else robot.position_unit(robot.names.index(name))
        )
        factor, shown = (1e3, "mm") if unit == "m" else (180 / math.pi, "deg")
        each.append(f"{name} {number(factor * rms, 3)} {shown}".strip())
    if each:
        yield "position error", f"{', '.join(each)} rms"


def _effort(estimate: EstimateParts) -> Iterator[tuple[str, str]]:
    fit = estimate.fit
    if fit.conditioning is not None:
        c = fit.conditioning
        said = f"{c.raw:.6g} raw, {c.normalised:.4g} normalised, {c.scaled:.4g} scaled by the parameters"
        yield "conditioning", said
    if estimate.data.windows is not None:
        simulated = f", {fit.simulations} windows simulated" if fit.simulations else ""
        yield "effort", f"{fit.passes} times over the whole{simulated}"
    elif fit.simulations:
        yield "effort", f"{fit.simulations} simulations"
    yield "stopped", fit.stop


def _limits(estimate: EstimateParts, *, details: bool) -> Iterator[tuple[str, str]]:
    """Return the facts without a verdict: residual and limitations of a long log, and tests of the method."""
    checks, windows = estimate.checks, estimate.data.windows
    if windows is not None and checks.repeatable is not None:
        said = str(checks.repeatable)
        if checks.repeatable.p_value is None:
            said = (
                "whether it repeats with position, direction and speed cannot be judged: that takes a place which the "
                f"axis passes in {VISITS} windows or more, and in these {windows.count} there is none; give a longer "
                "record, or shorter windows"
            )
        yield "residual", said
    if windows is not None and checks.known is not None:
        yield from (("limitation", str(one)) for one in checks.known.limitations)
    if details:
        yield from (("test", f"{test.name}: {test.sentence}") for test in checks.tests)


def _verdicts(estimate: EstimateParts, *, details: bool) -> Iterator[Block]:
    """Return the verdicts that did not pass, with the first of their reasons; or all of them."""
    listed = []
    for verdict in estimate.checks.verdicts:
        mark, texts = verdict.good, [*map(str, verdict.reasons)]
        if not details and verdict.status is Status.PASSED:
            continue
        if not details:
            more = f" (and {len(texts) - 1} more in the report)" if len(texts) > 1 else ""
            texts = [f"{verdict.reasons[0].brief}{more}"]
        listed.append((str(verdict.subject), mark, tuple(texts)))
    if listed:
        yield Verdicts(tuple(listed))


def _shared_table(estimate: EstimateParts) -> Table:
    """Return the table of the parameters that records share, beside the estimate of each record by itself."""
    assert estimate.checks.agreement is not None
    rows, agreement = estimate.params.rows, estimate.checks.agreement
    alone = [{p.name: p for p in record.alone} for record in estimate.data.records]
    columns = [
        (f"{k} alone", ["-" if (p := each.get(row.name)) is None else show_value(p) for row in rows], False)
        for k, each in enumerate(alone, 1)
    ]
    tests = {p.name: (f"{p.p_value:.2g}", number(p.between, 2)) for p in agreement.parameters}
    for i, head in enumerate(("p", "between")):
        columns.append((head, [tests[row.name][i] if row.name in tests else "-" for row in rows], False))
    return _table(rows, columns)


def describe_drift(drift: DriftTest, params: Sequence[EstimatedParameter]) -> str:
    """Return the drift of the parameters in a sentence."""
    agreement, count = drift.agreement, len(drift.segments)
    if agreement is None or agreement.p_value is None:
        return "not tested: the record has too few windows for two segments"
    if not agreement.differs:
        return f"no parameter changes by more than its intervals allow over {count} segments"
    units, trends = {p.name: p.unit for p in params}, {t.name: t for t in drift.trends}
    changes = []
    for name in drift.names:
        trend, scatter, unit = trends[name], agreement[name], units[name]
        line = (
            f", {number(trend.per_hour, 3)} ± {number(2 * trend.std, 2)} {unit} per hour"
            if abs(trend.per_hour) > _SHOWN * trend.std
            else ", without a trend"
        )
        changes.append(f"{name} by {number(scatter.between, 2)} {unit} rms (p = {scatter.p_value:.2g}{line})")
    listed = "; ".join(changes) or "none by itself, all of them together"
    return f"between {count} segments parameters change by more than their intervals allow: {listed}"


# The tables


Column: TypeAlias = tuple[str, Sequence[str], bool]
"""Header and cells of a column, and whether they are words."""


def _table(rows: Sequence[EstimatedParameter], more: Sequence[Column] = (), caption: str = "") -> Table:
    """Return a table of estimates: words, the field's letters, value, more, and last the symbol that is the key."""
    letters = [field_symbol(p) for p in rows]
    columns: list[Column] = [
        ("parameter", [in_words(p.name) for p in rows], True),
        *([("letter", letters, True)] if any(letters) else []),
        ("value ± 2 sigma", [show_value(p) for p in rows], False),
        ("unit", [p.unit for p in rows], True),
        *more,
        ("symbol", [p.symbol for p in rows], True),
    ]
    header, cells, words = zip(*columns, strict=True)
    return Table(header, tuple(zip(*cells, strict=True)), caption, tuple(i for i, word in enumerate(words) if word))


def _percent(p: EstimatedParameter) -> str:
    """Return two deviations in percent of the value."""
    if p.value is None or p.deviation is None or not p.free or p.at_bound is not None:
        return "-"
    percent = 200 * p.deviation / abs(p.value) if p.value else math.inf
    return number(percent, 2) if percent < _LOST else "-"


def remarks(estimate: EstimateParts) -> dict[str, str]:
    """Return the remarks of the checks on parameters, by name: at a bound, moved by a fault, known only with another.

    Of a fault of loop or log it is by how much the value changes, in its unit, when the fault is corrected.
    """
    found: dict[str, list[str]] = {p.name: ["at its bound"] for p in estimate.params.rows if p.at_bound is not None}
    for name, by in moved_by_loop(estimate, threshold=SHOWN_SHIFT).items():
        found.setdefault(name, []).append(f"loop: {format_signed(by, 3)}")
    symbols = {p.name: p.symbol for p in estimate.params.rows if p.of_joint and p.value is not None}
    alike = np.argwhere(np.abs(estimate.params.correlation) > _INSEPARABLE) if estimate.robot is None else ()
    for i, j in alike:
        one, other = estimate.params.names[i], estimate.params.names[j]
        if i != j and {one, other} <= symbols.keys():
            found.setdefault(one, []).append(f"only with {symbols[other]}")
    drift = estimate.checks.drift
    for name in () if drift is None else drift.names:
        found.setdefault(name, []).append("changes")
    return {name: ", ".join(said) for name, said in found.items()}


def parameters_table(
    estimate: EstimateParts,
    *,
    details: bool = True,
    truth: Mapping[str, float] | None = None,
    caption: str = "",
) -> Table:
    """Return the parameters with their intervals.

    Args:
        estimate: whose parameters are shown.
        details: whether to show the state at the first sample, and what a robot's record does not tell from 0.
        truth: true values by name, others are not shown.
        caption: of the table; else it counts what is not shown of a robot.
    """
    every, part = estimate.params.rows, estimate.robot
    if truth is not None:
        shown = [i for i, p in enumerate(every) if p.name in truth]
    elif part is None:
        shown = [i for i, p in enumerate(every) if details or p.name not in INITIAL]
    else:
        shown = [i for i, p in enumerate(every) if _is_listed(p, details=details)]
        hidden = len(every) - len(shown)
        caption = f"{hidden} more are not significant in this record" if hidden else ""
    rows, said = [every[i] for i in shown], remarks(estimate)
    columns: list[Column] = []
    if truth is not None:
        columns.append(("truth", [f"{truth[p.name]:.6g}" for p in rows], False))
    elif part is None:
        columns.append(("± %", [_percent(p) for p in rows], False))
    else:
        columns.append(("nominal", [number(float(part.nominal[i]), 4) for i in shown], False))
    if any(p.name in said for p in rows):
        columns.append(("remark", [said.get(p.name, "") for p in rows], True))
    return _table(rows, columns, caption)


def _is_listed(p: EstimatedParameter, *, details: bool) -> bool:
    """Return whether a robot's parameter has a row: a value that the record tells from 0, or a bound."""
    if p.value is None:
        return p.lower_bound is not None
    return details or not p.free or p.at_bound is not None or (p.stderr or 0.0) < _KNOWN * abs(p.value)


def combinations_table(estimate: EstimateParts, caption: str = "", *, differences: bool = True) -> Table | None:
    """Return sums and differences of both sides; None where there are none.

    Args:
        estimate: whose combinations are shown.
        caption: of the table.
        differences: whether to show the differences of both sides, too; else only their sums.
    """
    known = estimate.checks.known
    if known is None:
        return None
    shown = [one for one in known.physical if differences or one.combination.kind is not Kind.DIFFERENCE]
    if not shown:
        return None
    rows = [
        (
            one.combination.name.partition(",")[0],
            interval(one.value, 2 * one.std),
            one.combination.unit,
            one.verdict,
            one.combination.formula,
        )
        for one in shown
    ]
    header = ("combination", "value ± 2 sigma", "unit", "known", "symbol")
    return Table(header, tuple(rows), caption, words=(0, 2, 3, len(header) - 1))


def bounds_table(estimate: EstimateParts, caption: str = "") -> Table | None:
    """Return the lower bounds of a refused stiffness; None where it is not refused, or the fit says nothing of it."""
    bounds = told_bounds(estimate)
    if not bounds:
        return None
    unit = estimate["stiffness"].unit
    header = ("load's share of the inertia", f"stiffness at least [{unit}]", "free-free mode [Hz]")
    shown = ["not bounded" if b.stiffness is None else f"{b.stiffness:.3g}" for b in bounds]
    modes = ["-" if b.stiffness is None or b.frequency is None else f"{b.frequency:.0f}" for b in bounds]
    rows = [(f"{b.share:.2f}", *row) for b, *row in zip(bounds, shown, modes, strict=True)]
    return Table(header, tuple(rows), caption)


def bands_table(estimate: EstimateParts, caption: str = "") -> Table | None:
    """Return the residual in each band of frequencies; None where it was not computed."""
    if estimate.fit.residuals is None:
        return None
    rows = tuple(
        (
            f"{number(band.low, 3)} to {number(band.high, 3)}",
            "-" if band.error is None else f"{100 * band.error:.2f}",
            f"{100 * band.share:.1f}",
        )
        for band in estimate.fit.residuals.bands
    )
    return Table(("band [Hz]", "error [% of the torque there]", "share of the residual [%]"), rows, caption)


SHOWN_SHIFT = 0.5
"""Standard errors that a fault moves a parameter by at least to be marked beside it."""

_LETTERS: Mapping[str, str] = {"inertia": "J", "stiffness": "c", "damping": "d", "viscous": "b", "coulomb": "T_C"}
_SIDES: Mapping[str, str] = {"motor": "M", "rotor": "M", "load": "L", "link": "L"}
_DIRECTIONS: Mapping[str, str] = {"forwards": "+", "backwards": "-"}


def field_symbol(p: EstimatedParameter) -> str:
    """Return the letter that a parameter usually has in the field: J_M, m_L, c, d, b_M, T_C; "" for one without."""
    words = p.name.rpartition(".")[2].partition("@")[0].split("_")
    side = _SIDES.get(words[0], "")
    way = _DIRECTIONS.get(words[-1], "")
    letter = _LETTERS.get("_".join(words[bool(side) : len(words) - bool(way)]), "")
    if not letter:
        return ""
    if p.unit == "kg" or p.unit.endswith(" s2/m"):
        letter = letter.replace("J", "m")
    if p.unit != "N m":
        letter = letter.replace("T", "F")
    return f"{letter}{'_' if side and '_' not in letter else ''}{side}{way}"


def describe_loop_remark(estimate: EstimateParts) -> str:
    """Describe the remark "loop" of the table."""
    loop = loop_verdict(estimate)
    undecided = loop is not None and is_another_law(loop.reasons)
    when = "if the drive runs the other law" if undecided else "once the fault of loop or log is corrected"
    return f"loop: how much the value changes {when}"


_KNOWN = 1.0  # relative standard error: a parameter that is known worse stands in the details only
_TONES: dict[Trust, Tone] = {Trust.RELIABLE: "good", Trust.NOT_YET: "bad"}


def _robot_tables(estimate: EstimateParts, part: IdentifiedRobot, *, details: bool) -> Iterator[Block]:
    """Yield errors by axis, parameters and sums."""
    columns = {"estimate": np.array([*estimate.fit.axis_errors.values()])}
    if part.model.has_masses:
        columns["nominal"] = part.nominal_errors
    rows = tuple(
        (name, *(f"{100 * errors[k]:.3g}" if np.isfinite(errors[k]) else "runs away" for errors in columns.values()))
        for k, name in enumerate(part.model.names)
    )
    header = ("joint", *(f"{name}, %" for name in columns))
    yield Table(header, rows, "filtered torque that is left, of the record it was identified from")
    yield parameters_table(estimate, details=details)
    # A base parameter has the name of a sum; what has the name of a joint's number and is a sum always says so.
    sums = tuple(
        f"{row.name} is {formula}"
        for row, formula in zip(estimate.params.rows, part.formulas, strict=True)
        if row.symbol != formula and (details or row.name != row.symbol)
    )
    if sums:
        yield from (Heading("Sums that the parameters stand for"), Listing(sums))
