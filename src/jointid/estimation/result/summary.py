"""An estimate as a document: a screen of it, or all there is to say; and its tables, for every rendering of it."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence

import numpy as np

from jointid.common.arrays import FloatArray
from jointid.common.document import Block, Document, Facts, Heading, Listing, Paragraph, Table, Tone, Verdicts
from jointid.common.errors import MethodError
from jointid.common.text import format_signed, interval, join, number, uniform
from jointid.estimation.problems.base import INITIAL
from jointid.estimation.problems.log_windows import VISITS
from jointid.estimation.result.agreement import DriftTest
from jointid.estimation.result.answer import (
    Trust,
    answer_of,
    is_another_law,
    loop_verdict,
    moved_by_loop,
    spares_answer,
    told_bounds,
)
from jointid.estimation.result.parts import EstimatedParameter, EstimateParts, known_on_other_side
from jointid.models.joints import FlexibleJoint
from jointid.models.robots.robot import Robot
from jointid.uncertainty.identifiability import Kind
from jointid.uncertainty.verdict import Status

_SHOWN = 2.0  # standard errors that a trend has at least to be printed as one
_LOST = 2000.0  # %: a deviation so much larger than its value says nothing in percent


def describe_estimate(estimate: EstimateParts, *, details: bool = False) -> Document:
    """Return an estimate as a document.

    Args:
        estimate: of one record, of several, of a long log, or of a robot.
        details: whether to show every verdict with all its reasons, tests, effort and settings; else only the verdicts
            that did not pass, a line each.
    """
    if estimate.robot is not None:
        return describe_robot_estimate(estimate, tuple(_verdicts(estimate, details=details)), details=details)
    fit, checks = estimate.fit, estimate.checks
    facts = [*_results(estimate, details=details)]
    if details:
        facts += _effort(estimate)
    elif fit.interrupted or not (fit.converged or checks.verdicts):  # no verdict says why it ended so
        facts += [("stopped", fit.stop)]
    facts += _limits(estimate, details=details)
    if checks.verdicts:
        facts += [("checks", _counted_checks(estimate))]
    notes = [] if checks.verdicts and not details else [("note", note) for note in checks.notes]
    warnings = [("warning", warning) for warning in checks.warnings]
    return Document(
        str(answer_of(estimate)),
        (
            *_tables(estimate, details=details),
            *_verdicts(estimate, details=details),
            Facts((*warnings, *notes)),
            Facts((*facts, *_sources(estimate))),
        ),
    )


def _counted_checks(estimate: EstimateParts) -> str:
    """Count the passed checks, and name the others if they do not affect the answer."""
    verdicts = estimate.checks.verdicts
    others = [verdict for verdict in verdicts if verdict.status is not Status.PASSED]
    if not others:
        return f"all {len(verdicts)} passed"
    said = f"{len(verdicts) - len(others)} of {len(verdicts)} passed"
    if not (answer_of(estimate).reliable and all(spares_answer(estimate, verdict) for verdict in others)):
        return said
    value = answer_of(estimate).found.values["parameter"].partition("@")[0].replace("_", " ")
    named = join([str(one.subject) for one in others])
    return f"{said}; {named} {'do' if len(others) > 1 else 'does'} not speak against the {value}"


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
    if data.torque_constant:
        yield "scale", f"values scale with torque_constant {data.torque_constant}, which no record checks"


def _tables(estimate: EstimateParts, *, details: bool) -> Iterator[Block]:
    if estimate.data.records:
        yield _shared_table(estimate)
        own = tuple((str(k), *_cells(p)) for k, rows in enumerate(estimate.params.own, 1) for p in rows)
        if own:
            yield Table(("record", "symbol", "parameter", "value", "2 sigma", "unit"), own, words=(0, 1, 2, 5))
        errors = tuple(
            (str(k), *(f"{100 * e:.4f}" for e in (r.relative_error, r.filtered_error, r.alone_error)), str(r.rows))
            for k, r in enumerate(estimate.data.records, 1)
        )
        yield Table(("record", "error % raw", "filtered", "filtered, alone", "rows"), errors)
        return
    yield parameters_table(estimate, initial=details)
    lines = tuple(legend(estimate, initial=details))
    if lines:
        yield Listing(lines)
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
            found = {n: f"{number(s.values[n], 4)} +- {number(2 * s.std[n], 2)}" for n in s.values}
            stated = (found.get(p.name, "not excited") for p in free)
            rows.append((f"{s.begin / 3600:.2f}", f"{s.end / 3600:.2f}", *stated, f"{100 * s.filtered_error:.2f}"))
        caption = "each segment by itself, +- 2 sigma to compare them by; without what all of them err alike"
        yield Table(header, tuple(rows), caption, words=())


def _results(estimate: EstimateParts, *, details: bool) -> Iterator[tuple[str, str]]:
    fit, checks, windows = estimate.fit, estimate.checks, estimate.data.windows
    if checks.agreement is not None:
        if not checks.agreement.differs:  # else it is a warning
            yield "agreement", str(checks.agreement)
    elif windows is not None:
        yield "torque error", f"{100 * fit.filtered_error:.4f} % filtered ({fit.rows} rows)"
        still = f", {windows.still} without motion left out" if windows.still else ""
        yield (
            "windows",
            f"{windows.count} of {windows.length:g} s, and {windows.settling:g} s at either end{still}; "
            f"{number(windows.duration / 3600, 3)} h",
        )
    else:
        left, rows = "", ""
        if details:
            left = f" ({fit.borders[0]} + {fit.borders[1]} samples at the ends left out)"
            rows = f" ({fit.rows} rows)"
        yield (
            f"{fit.compared} error",
            f"{100 * fit.relative_error:.4f} % raw{left}, {100 * fit.filtered_error:.4f} % filtered{rows}",
        )
    if checks.drift is not None:
        yield "drift", describe_drift(checks.drift, estimate.params.rows)


def _effort(estimate: EstimateParts) -> Iterator[tuple[str, str]]:
    fit = estimate.fit
    if fit.conditioning is not None:
        c = fit.conditioning
        said = f"{c.raw:.6g} raw, {c.normalised:.4g} normalised, {c.scaled:.4g} scaled by the parameters"
        yield "conditioning", said
    if fit.simulations and estimate.data.windows is not None:
        yield "effort", f"{fit.passes} times over the whole, {fit.simulations} windows simulated"
    elif fit.simulations:
        steps = f"{fit.iterations} iterations, " if fit.trace else ""
        yield "effort", f"{steps}{fit.simulations} simulations"
    yield "stopped", fit.stop
    if estimate.settings.weighting:
        yield "weighting", estimate.settings.weighting
    yield "intervals", estimate.params.basis


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
        first, *others = map(str, verdict.reasons)
        if details:
            listed.append((str(verdict.subject), verdict.good, (first, *others)))
        elif verdict.status is not Status.PASSED:
            more = f" (and {len(others)} more in the report)" if others else ""
            listed.append((str(verdict.subject), verdict.good, (f"{verdict.reasons[0].brief}{more}",)))
    if listed:
        yield Verdicts(tuple(listed))


def _shared_table(estimate: EstimateParts) -> Table:
    """Return the table of the parameters that records share, beside the estimate of each record by itself."""
    assert estimate.checks.agreement is not None
    alone = [{p.name: p for p in record.alone} for record in estimate.data.records]
    tests = {p.name: p for p in estimate.checks.agreement.parameters}
    there: list[tuple[str, ...]] = [(format_value(p), p.unit) for p in estimate.other_side]
    rows = []
    for p, beside in zip(estimate.params.rows, there or [()] * len(estimate.params.rows), strict=True):
        test = tests.get(p.name)
        p_value, between = (f"{test.p_value:.2g}", number(test.between, 2)) if test else ("-", "-")
        rows.append((*_cells(p), *(_beside(each.get(p.name)) for each in alone), p_value, between, *beside))
    heads = [f"{k} alone" for k in range(1, len(alone) + 1)]
    more = () if estimate.other is None else (f"{estimate.other.side} side", "unit")
    header = ("symbol", "parameter", "value", "2 sigma", "unit", *heads, "p", "between", *more)
    words = (0, 1, 4, *((len(header) - 1,) if more else ()))
    return Table(header, tuple(rows), words=words)


def _cells(p: EstimatedParameter) -> tuple[str, str, str, str, str]:
    spread = number(2 * p.deviation, 2) if p.deviation is not None else "fixed"
    return p.symbol, p.name.replace("_", " "), number(p.value), spread, p.unit


def _beside(p: EstimatedParameter | None) -> str:
    if p is None or p.value is None or p.deviation is None:
        return "-"
    return f"{number(p.value)} +- {number(2 * p.deviation, 2)}"


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
            f", {number(trend.per_hour, 3)} +- {number(2 * trend.std, 2)} {unit} per hour"
            if abs(trend.per_hour) > _SHOWN * trend.std
            else ", without a trend"
        )
        changes.append(f"{name} by {number(scatter.between, 2)} {unit} rms (p = {scatter.p_value:.2g}{line})")
    listed = "; ".join(changes) or "none by itself, all of them together"
    return f"between {count} segments parameters change by more than their intervals allow: {listed}"


# The tables


def format_value(p: EstimatedParameter) -> str:
    """Format a value for tables; a refused one by its lower bound, if there is one."""
    if p.at_bound is not None:
        return number(p.at_bound)
    if p.value is None:
        return "not identifiable" if p.lower_bound is None else f"> {number(p.lower_bound)}"
    return number(p.value)


def parameter_row(p: EstimatedParameter) -> tuple[str, ...]:
    """Return symbol, words, value, two deviations, the same in percent of the value, and unit."""
    words = p.name.replace("_", " ")
    if p.value is None or p.deviation is None or not p.free or p.at_bound is not None:
        fixed = p.value is not None and not p.free and p.at_bound is None
        return p.symbol, words, format_value(p), "fixed" if fixed else "-", "-", p.unit
    percent = 200 * p.deviation / abs(p.value) if p.value else math.inf
    relative = number(percent, 2) if percent < _LOST else "-"
    return p.symbol, words, number(p.value), number(2 * p.deviation, 2), relative, p.unit


def remarks(estimate: EstimateParts) -> dict[str, str]:
    """Return the remarks of the checks on parameters, by name: at a bound, moved by a fault, known only with another.

    Of a fault of loop or log it is by how much the value changes, in its unit, when the fault is corrected.
    """
    found: dict[str, list[str]] = {p.name: ["at its bound"] for p in estimate.params.rows if p.at_bound is not None}
    for name, by in moved_by_loop(estimate, threshold=SHOWN_SHIFT).items():
        found.setdefault(name, []).append(f"loop: {format_signed(by, 3)}")
    known, symbols = estimate.checks.known, {p.name: p.symbol for p in estimate.params.rows}
    for limitation in () if known is None else known.limitations:
        pair = [name for name in limitation.values.get("parameters", ()) if name in symbols]
        if len(pair) == 2:  # of the joint, both of them
            for name, other in (pair, pair[::-1]):
                found.setdefault(name, []).append(f"only with {symbols[other]}")
    drift = estimate.checks.drift
    for name in () if drift is None else drift.names:
        found.setdefault(name, []).append("changes")
    return {name: ", ".join(said) for name, said in found.items()}


def parameters_table(estimate: EstimateParts, *, initial: bool = True, letters: bool = False) -> Table:
    """Return every parameter with its interval, and with a transmission what it is on the other side.

    Args:
        estimate: whose parameters are shown.
        initial: whether to show the state at the first sample.
        letters: whether the field's letters stand beside the paper's: "ZZ1, J1".
    """
    header: tuple[str, ...] = ("symbol", "parameter", "value", "2 sigma", "2 sigma %", "unit")
    shown_rows = [i for i, p in enumerate(estimate.params.rows) if initial or p.name not in INITIAL]
    rows = [parameter_row(estimate.params.rows[i]) for i in shown_rows]
    if letters:
        beside = [field_symbol(estimate.params.rows[i].name, estimate.params.rows[i].unit) for i in shown_rows]
        rows = [(f"{row[0]}, {one}" if one else row[0], *row[1:]) for row, one in zip(rows, beside, strict=True)]
    words, said = [0, 1, 5], remarks(estimate)
    if any(estimate.params.rows[i].name in said for i in shown_rows):
        words.append(len(header))
        header = (*header, "remark")
        rows = [(*row, said.get(estimate.params.rows[i].name, "")) for row, i in zip(rows, shown_rows, strict=True)]
    if estimate.other is not None:
        words.append(len(header) + 1)
        header, there = (*header, f"{estimate.other.side} side", "unit"), estimate.other_side
        rows = [(*row, format_value(there[i]), there[i].unit) for row, i in zip(rows, shown_rows, strict=True)]
    return Table(header, tuple(rows), words=tuple(words))


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
    there = known_on_other_side(known.physical, estimate.other)
    stated = {id(one): f"{number(o.value)} {o.combination.unit}" for one, o in zip(known.physical, there, strict=False)}
    shown = [one for one in known.physical if differences or one.combination.kind is not Kind.DIFFERENCE]
    if not shown:
        return None
    rows: list[tuple[str, ...]] = [
        (one.combination.formula, number(one.value), number(2 * one.std, 2), one.combination.unit, one.verdict)
        for one in shown
    ]
    header: tuple[str, ...] = ("combination", "value", "2 sigma", "unit", "known")
    if estimate.other is not None:
        header = (*header, f"{estimate.other.side} side")
        rows = [(*row, stated.get(id(one), "-")) for row, one in zip(rows, shown, strict=True)]
    return Table(header, tuple(rows), caption, words=(0, 3, 4, 5))


def bounds_table(estimate: EstimateParts, caption: str = "") -> Table | None:
    """Return the lower bounds of a refused stiffness; None where it is not refused, or the fit says nothing of it."""
    bounds, other = told_bounds(estimate), estimate.other
    if not bounds:
        return None
    unit = estimate["stiffness"].unit
    header: tuple[str, ...] = ("load's share of the inertia", f"stiffness at least [{unit}]", "free-free mode [Hz]")
    shown = uniform([b.stiffness for b in bounds], "not bounded")
    modes = ["-" if b.stiffness is None or b.frequency is None else f"{b.frequency:.0f}" for b in bounds]
    rows: list[tuple[str, ...]] = [(f"{b.share:.2f}", *row) for b, *row in zip(bounds, shown, modes, strict=True)]
    if other is not None:
        header = (*header, f"{other.side} side [{other.unit(unit)}]")
        there = uniform([None if b.stiffness is None else other.ratio**2 * b.stiffness for b in bounds], "-")
        rows = [(*row, value) for row, value in zip(rows, there, strict=True)]
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


def settings_facts(estimate: EstimateParts) -> Facts:
    """Return how it was identified."""
    f, joint, fit = estimate.settings.filtering, estimate.settings.joint, estimate.fit
    position = "none" if f.position_cutoff is None else f"{f.position_cutoff:g} Hz"
    nonlinear = isinstance(joint, FlexibleJoint) and not joint.spring.linear
    spring = f", {joint.spring_name} spring" if nonlinear else ""
    return Facts(
        (
            ("Method", estimate.settings.variant),
            ("Model", f"{joint.model}, {joint.friction.name} friction" + spring),
            ("Left out of the raw error", f"{fit.borders[0]} samples at the start, {fit.borders[1]} at the end"),
            ("Filter", f"{f.cutoff:g} Hz, one sample in {f.decimation}; positions {position}; timing {f.timing}"),
            ("Rows fitted", str(fit.rows)),
            ("Delay of the torque", f"{1e3 * estimate.settings.delay:.4g} ms"),
            ("Effort", f"{fit.iterations} iterations, {fit.simulations} simulations"),
            ("Stopped", fit.stop),
            ("Intervals", estimate.params.basis),
        )
    )


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
    if moved_by_loop(estimate, threshold=SHOWN_SHIFT):
        loop = loop_verdict(estimate)
        undecided = loop is not None and is_another_law(loop.reasons)
        when = "if the drive runs the other law" if undecided else "once the fault of loop or log is corrected"
        yield f"loop: how much the value changes {when}"
    first = [rows[name] for name in INITIAL if initial and name in rows]
    if first:
        words = ", ".join(f"{p.symbol} {p.name.removeprefix('initial_')}" for p in first)
        yield f"at the first sample: {words}"


_KNOWN = 1.0  # relative standard error: a parameter that is known worse stands in the details only
_TONES: dict[Trust, Tone] = {Trust.RELIABLE: "good", Trust.NOT_YET: "bad"}


def robot_blocks(estimate: EstimateParts, *, details: bool = False) -> tuple[Block, ...]:
    """Return errors by axis, parameters and sums.

    Args:
        estimate: of a robot.
        details: whether the parameters that this record does not tell from 0 are listed, and the sums behind all.
    """
    part = estimate.require_robot()
    errors = {"estimate": np.array([*estimate.fit.axis_errors.values()])}
    if part.model.has_masses:
        errors["nominal"] = part.nominal_errors
    listed = [
        (row, nominal)
        for row, nominal in zip(estimate.params.rows, part.nominal, strict=True)
        if details
        or not row.free
        or row.value is None
        or row.at_bound is not None
        or (row.stderr or 0.0) < _KNOWN * abs(row.value)
    ]
    listed = [(row, nominal) for row, nominal in listed if row.value is not None or row.lower_bound is not None]
    hidden = len(part.names) - len(listed)
    caption = f"{hidden} more are not significant in this record" if hidden else ""
    rows = tuple((row.symbol, *_cells_of_robot(row), number(float(nominal), 4)) for row, nominal in listed)
    # A base parameter has the name of a sum; what has the name of a joint's number and is a sum always says so.
    sums = tuple(
        f"{row.name} is {formula}"
        for row, formula in zip(estimate.params.rows, part.formulas, strict=True)
        if row.symbol != formula and (details or row.name != row.symbol)
    )
    return (
        errors_table(part.model, errors, "of the record it was identified from"),
        Table(("symbol", "parameter", "value, 2 sigma", "unit", "sigma, %", "nominal"), rows, caption, (0, 1, 2, 3)),
        *((Heading("Sums that the parameters stand for"), Listing(sums)) if sums else ()),
    )


def describe_robot_estimate(estimate: EstimateParts, verdicts: tuple[Block, ...], *, details: bool = False) -> Document:
    """Return the estimate of a robot as a document; see `describe_estimate`."""
    part, answer = estimate.require_robot(), answer_of(estimate)
    tone = _TONES.get(Trust(answer.trust.code), "open")
    return Document(
        f"{part.model.name}: {len(part.names)} parameters of {len(part.model)} joints",
        (
            Paragraph(str(answer), lead=True, tone=tone),
            *verdicts,
            Facts(tuple(("warning", warning) for warning in estimate.checks.warnings)),
            *(Paragraph(f"{one}.") for one in part.springs),
            Facts((("method", estimate.settings.variant), ("search", estimate.fit.stop))),
            *robot_blocks(estimate, details=details),
        ),
    )


def _cells_of_robot(row: EstimatedParameter) -> tuple[str, str, str, str]:
    if row.value is None:
        assert row.lower_bound is not None
        return row.name, f"at least {number(row.lower_bound, 3)}", row.unit, ""
    if row.stderr is None or row.at_bound is not None:
        return row.name, interval(row.value, 0.0), row.unit, "fixed" if row.at_bound is None else "at its bound"
    share = row.stderr / max(abs(row.value), 1e-300)
    return row.name, interval(row.value, 2 * row.stderr), row.unit, f"{100 * share:.2g}"


def errors_table(robot: Robot, columns: Mapping[str, FloatArray], of_what: str) -> Table:
    """Return the errors of the joints as a table, a column for each model, in per cent.

    Raises:
        MethodError: a joint has no torque to explain.
    """
    for errors in columns.values():
        if np.any(np.isnan(errors)):
            raise MethodError("A joint's torque is 0 throughout; expected a torque of every motor: check the channels.")
    rows = tuple(
        (name, *(f"{100 * errors[k]:.3g}" if np.isfinite(errors[k]) else "runs away" for errors in columns.values()))
        for k, name in enumerate(robot.names)
    )
    header = ("joint", *(f"{name}, %" for name in columns))
    return Table(header, rows, f"filtered torque that is left, {of_what}")
