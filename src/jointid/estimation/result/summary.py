"""An estimate as a document: a screen of it, or all there is to say."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from jointid.common.document import Block, Document, Facts, Table, Verdicts
from jointid.common.text import number
from jointid.estimation.result.estimate import Estimate
from jointid.estimation.result.params import EstimatedParameter
from jointid.estimation.result.tables import bounds_table, combinations_table, parameters_table, shown
from jointid.estimation.streaming.drift import DriftTest, Segment
from jointid.uncertainty.verdict import Status, Verdict

_SHOWN = 2.0  # standard errors that a trend has at least to be printed as one


def estimate_document(estimate: Estimate, *, details: bool = False) -> Document:
    """Return an estimate as a document.

    Args:
        estimate: of one record, of several, or of a long log.
        details: whether to show every verdict with all its reasons, tests, effort and settings; else only the verdicts
            that did not pass, a line each.
    """
    data, joint = estimate.data, estimate.settings.joint
    source = f"of {data.record}" if not data.records else f"of {len(data.records)} records"
    title = f"{joint.model.capitalize()} joint, {estimate.settings.variant}, {source}"
    facts = (
        *_results(estimate),
        *(_effort(estimate) if details else _unfinished(estimate)),
        *_limits(estimate, details=details),
        *_count(estimate),
    )
    tables = _tables(estimate, details=details)
    blocks = [Facts(tuple(_sources(estimate))), *tables, Facts(facts), *_verdicts(estimate, details=details)]
    warnings = tuple(("warning", warning) for warning in estimate.checks.warnings)
    return Document(title, (*blocks, *((Facts(warnings),) if warnings else ())))


def _sources(estimate: Estimate) -> Iterator[tuple[str, str]]:
    """Return what was read, and on which side the values are."""
    data, gear = estimate.data, estimate.settings.joint.transmission
    if not data.records:
        yield "read", ", ".join(data.channels)
    for k, record in enumerate(data.records, 1):
        unit = next(p.unit for p in (*estimate.params, *estimate.params.own[k - 1]) if p.name.endswith("inertia"))
        more = f", {number(record.added_inertia)} {unit} added to the load" if record.added_inertia else ""
        yield f"record {k}", f"{record.name}{more}; read: {', '.join(record.channels)}"
        if record.resampled is not None:
            yield "resampled", str(record.resampled)
    if data.resampled is not None:
        yield "resampled", str(data.resampled)
    if gear is not None:
        yield "transmission", str(gear)


def _tables(estimate: Estimate, *, details: bool) -> Iterator[Block]:
    if estimate.data.records:
        yield _shared(estimate)
        own = [(k, p) for k, rows in enumerate(estimate.params.own, 1) for p in rows]
        if own:
            yield _own(own)
        yield _errors(estimate)
        return
    yield parameters_table(estimate, initial=details)
    known = combinations_table(estimate, "known together", differences=details)
    if known is not None:
        yield known
    bounds = bounds_table(estimate, "the stiffness is refused; its lower bound (95 %, lightly damped mode)")
    if bounds is not None:
        yield bounds
    drift = estimate.checks.drift
    if drift is not None and drift.segments:
        yield _segments(estimate, drift)


def _results(estimate: Estimate) -> Iterator[tuple[str, str]]:
    fit, checks, windows = estimate.fit, estimate.checks, estimate.data.windows
    if checks.agreement is not None:
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
        yield (
            f"{fit.compared} error",
            f"{100 * fit.relative_error:.4f} % raw ({fit.borders[0]} + {fit.borders[1]} samples at the ends left "
            f"out), {100 * fit.filtered_error:.4f} % filtered ({fit.rows} rows)",
        )
    if checks.drift is not None:
        yield "drift", describe_drift(checks.drift, estimate.params)


def _effort(estimate: Estimate) -> Iterator[tuple[str, str]]:
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


def _unfinished(estimate: Estimate) -> Iterator[tuple[str, str]]:
    """Return why a search that no verdict is on ended where it should not have."""
    if estimate.fit.interrupted or not (estimate.fit.converged or estimate.checks.verdicts):
        yield "stopped", estimate.fit.stop


def _limits(estimate: Estimate, *, details: bool) -> Iterator[tuple[str, str]]:
    """Return what no verdict says: the residual and the limitations of a long log, and the method's own tests."""
    checks = estimate.checks
    if checks.repeatable is not None:
        yield "residual", str(checks.repeatable)
    if estimate.data.windows is not None and checks.known is not None:
        yield from (("limitation", str(one)) for one in checks.known.limitations)
    if details:
        yield from (("test", f"{test.name}: {test.sentence}") for test in checks.tests)


def _count(estimate: Estimate) -> Iterator[tuple[str, str]]:
    """Return how many verdicts passed."""
    passed = [verdict.status is Status.PASSED for verdict in estimate.checks.verdicts]
    if passed:
        yield "checks", f"all {len(passed)} passed" if all(passed) else f"{sum(passed)} of {len(passed)} passed"


def _verdicts(estimate: Estimate, *, details: bool) -> Iterator[Block]:
    verdicts = estimate.checks.verdicts
    listed = [verdict for verdict in verdicts if details or verdict.status is not Status.PASSED]
    if listed:
        yield Verdicts(tuple((str(v.subject), v.good, _reasons(v, details=details)) for v in listed))


def _reasons(verdict: Verdict, *, details: bool) -> tuple[str, ...]:
    first, *others = map(str, verdict.reasons)
    if details or not others:
        return first, *others
    return (f"{first} (and {len(others)} more)",)


def _shared(estimate: Estimate) -> Table:
    """Return the table of the parameters that records share, beside the estimate of each record by itself."""
    assert estimate.checks.agreement is not None
    alone = [{p.name: p for p in record.alone} for record in estimate.data.records]
    tests = {p.name: p for p in estimate.checks.agreement.parameters}
    there: list[tuple[str, ...]] = [(shown(p), p.unit) for p in estimate.other_side]
    rows = []
    for p, beside in zip(estimate.params, there or [()] * len(estimate.params), strict=True):
        test = tests.get(p.name)
        p_value, between = (f"{test.p_value:.2g}", number(test.between, 2)) if test else ("-", "-")
        rows.append((*_cells(p), *(_beside(each.get(p.name)) for each in alone), p_value, between, *beside))
    heads = [f"{k} alone" for k in range(1, len(alone) + 1)]
    more = () if estimate.other is None else (f"{estimate.other.side} side", "unit")
    header = ("symbol", "parameter", "value", "2 sigma", "unit", *heads, "p", "between", *more)
    words = (0, 1, 4, *((len(header) - 1,) if more else ()))
    return Table(header, tuple(rows), words=words)


def _errors(estimate: Estimate) -> Table:
    rows = tuple(
        (str(k), *(f"{100 * e:.4f}" for e in (r.relative_error, r.filtered_error, r.alone_error)), str(r.rows))
        for k, r in enumerate(estimate.data.records, 1)
    )
    return Table(("record", "error % raw", "filtered", "filtered, alone", "rows"), rows)


def _own(own: list[tuple[int, EstimatedParameter]]) -> Table:
    rows = tuple((str(k), *_cells(p)) for k, p in own)
    return Table(("record", "symbol", "parameter", "value", "2 sigma", "unit"), rows, words=(0, 1, 2, 5))


def _cells(p: EstimatedParameter) -> tuple[str, str, str, str, str]:
    spread = number(2 * p.stderr, 2) if p.stderr is not None else "fixed"
    return p.symbol, p.name.replace("_", " "), number(p.value), spread, p.unit


def _beside(p: EstimatedParameter | None) -> str:
    if p is None or p.value is None or p.stderr is None:
        return "-"
    return f"{number(p.value)} +- {number(2 * p.stderr, 2)}"


def describe_drift(drift: DriftTest, params: Sequence[EstimatedParameter]) -> str:
    """Return whether the joint stays the same, and which parameters change, in a sentence."""
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


def _segments(estimate: Estimate, drift: DriftTest) -> Table:
    """Return the table of the segments: each free parameter with two standard errors."""
    free = [p for p in estimate.params if p.free]
    header = ("from h", "to h", *(f"{p.symbol} {p.unit}" for p in free), "error %")
    rows = tuple(_segment(s, [p.name for p in free]) for s in drift.segments)
    caption = "each segment by itself, +- 2 sigma to compare them by; without what all of them err alike"
    return Table(header, rows, caption, words=())


def _segment(s: Segment, names: list[str]) -> tuple[str, ...]:
    found = {n: f"{number(s.values[n], 4)} +- {number(2 * s.std[n], 2)}" for n in s.values}
    cells = (found.get(n, "not excited") for n in names)
    return f"{s.begin / 3600:.2f}", f"{s.end / 3600:.2f}", *cells, f"{100 * s.filtered_error:.2f}"
