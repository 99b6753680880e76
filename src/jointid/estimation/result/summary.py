"""The printed summary of an estimate: its table, and everything a reader must know beside it."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from jointid.common.text import aligned, number
from jointid.estimation.result.estimate import Estimate
from jointid.estimation.result.params import EstimatedParameter, known_on_other_side
from jointid.estimation.result.table_rows import bound_line, known_line, parameter_row, shown
from jointid.estimation.streaming.drift import DriftTest, Segment
from jointid.models.transmission import transmission_lines
from jointid.records.time_base.uniformity import resampled_lines

_SHOWN = 2.0  # standard errors that a trend has at least to be printed as one


def summarise(estimate: Estimate) -> str:
    """Return an estimate as text."""
    return "\n".join([*_head(estimate), "", *_tables(estimate), "", *_facts(estimate)])


def _head(estimate: Estimate) -> Iterator[str]:
    data, settings = estimate.data, estimate.settings
    if not data.records:
        yield f"{settings.joint.model.capitalize()} joint, {settings.variant}, of {data.record}"
        yield f"read: {', '.join(data.channels)}"
        yield from resampled_lines(data.resampled)
        yield from transmission_lines(settings.joint.transmission)
        return
    yield f"{settings.joint.model.capitalize()} joint, {len(data.records)} records together, {settings.variant}"
    yield from transmission_lines(settings.joint.transmission)
    for k, record in enumerate(data.records, 1):
        unit = next(p.unit for p in (*estimate.params, *estimate.params.own[k - 1]) if p.name.endswith("inertia"))
        more = f", {number(record.added_inertia)} {unit} added to the load" if record.added_inertia else ""
        yield f"record {k}: {record.name}{more}; read: {', '.join(record.channels)}"
        yield from resampled_lines(record.resampled)


def _tables(estimate: Estimate) -> Iterator[str]:
    if estimate.data.records:
        yield _shared(estimate)
        own = [(k, p) for k, rows in enumerate(estimate.params.own, 1) for p in rows]
        yield from ["", _own(own)] if own else []
        yield from ["", _residuals(estimate)]
        return
    yield _parameters(estimate)
    known = estimate.checks.known
    if known is not None and known.physical:
        there = known_on_other_side(known.physical, estimate.other) or (None,) * len(known.physical)
        yield from ["", "known together"]
        yield from (known_line(k, o, estimate.other) for k, o in zip(known.physical, there, strict=True))
    if estimate.checks.bounds:
        yield from ["", "K12 is at least, by the load's share of the inertia (95 %, lightly damped mode)"]
        unit = estimate["stiffness"].unit
        yield from (bound_line(bound, unit, estimate.other) for bound in estimate.checks.bounds)
    drift = estimate.checks.drift
    if drift is not None and drift.segments:
        yield from ["", "each segment by itself, +- 2 sigma to compare them by; without what all of them err alike"]
        yield _segments(estimate, drift)


def _facts(estimate: Estimate) -> Iterator[str]:
    fit, checks, windows = estimate.fit, estimate.checks, estimate.data.windows
    if checks.agreement is not None:
        yield f"agreement     {checks.agreement}"
    elif windows is not None:
        yield f"torque error  {100 * fit.filtered_error:.4f} % filtered ({fit.rows} rows)"
        still = f", {windows.still} without motion left out" if windows.still else ""
        yield (
            f"windows       {windows.count} of {windows.length:g} s, and {windows.settling:g} s at either end{still}; "
            f"{number(windows.duration / 3600, 3)} h"
        )
    else:
        yield (
            f"{fit.compared} error".ljust(13)
            + f" {100 * fit.relative_error:.4f} % raw ({fit.borders[0]} + {fit.borders[1]} samples at the ends left "
            f"out), {100 * fit.filtered_error:.4f} % filtered ({fit.rows} rows)"
        )
    if fit.conditioning is not None:
        c = fit.conditioning
        yield f"conditioning  {c.raw:.6g} raw, {c.normalised:.4g} normalised, {c.scaled:.4g} scaled by the parameters"
    if fit.simulations:
        yield f"effort        {_effort(estimate)}"
    yield f"stopped       {fit.stop}"
    if estimate.settings.weighting:
        yield f"weighting     {estimate.settings.weighting}"
    yield f"intervals     {estimate.params.basis}"
    if checks.repeatable is not None:
        yield f"residual      {checks.repeatable}"
    if checks.drift is not None:
        yield f"drift         {describe_drift(checks.drift, estimate.params)}"
    if windows is not None and checks.known is not None:
        yield from (f"limitation    {sentence}" for sentence in checks.known.sentences)
    if checks.verdicts:
        yield from ["", "verdicts", *map(str, checks.verdicts), ""]
    yield from (f"test          {test.name}: {test.sentence}" for test in checks.tests)
    yield from (f"warning       {warning}" for warning in checks.warnings)


def _effort(estimate: Estimate) -> str:
    fit = estimate.fit
    if estimate.data.windows is not None:
        return f"{fit.passes} times over the whole, {fit.simulations} windows simulated"
    return (
        f"{fit.iterations} iterations, {fit.simulations} simulations" if fit.trace else f"{fit.simulations} simulations"
    )


def _parameters(estimate: Estimate) -> str:
    """Return the table of the parameters; with a transmission, beside what they are on its other side."""
    header, right = ("symbol", "parameter", "value", "2 sigma", "sigma %", "unit"), (False, False, *[True] * 3, False)
    rows = [parameter_row(p) for p in estimate.params]
    if estimate.other is None:
        return aligned(header, rows, right)
    there = [(shown(p), p.unit) for p in estimate.other_side]
    wider = [(*row, *cells) for row, cells in zip(rows, there, strict=True)]
    return aligned((*header, f"{estimate.other.side} side", "unit"), wider, (*right, True, False))


def _shared(estimate: Estimate) -> str:
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
    right = (False, False, True, True, False, *(True for _ in heads), True, True, *((True, False) if more else ()))
    return aligned(header, rows, right)


def _residuals(estimate: Estimate) -> str:
    rows = [
        (str(k), *(f"{100 * e:.4f}" for e in (r.relative_error, r.filtered_error, r.alone_error)), str(r.rows))
        for k, r in enumerate(estimate.data.records, 1)
    ]
    header = ("record", "error % raw", "filtered", "filtered, alone", "rows")
    return aligned(header, rows, (False, True, True, True, True))


def _own(own: list[tuple[int, EstimatedParameter]]) -> str:
    rows = [(str(k), *_cells(p)) for k, p in own]
    header = ("record", "symbol", "parameter", "value", "2 sigma", "unit")
    return aligned(header, rows, (False, False, False, True, True, False))


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


def _segments(estimate: Estimate, drift: DriftTest) -> str:
    """Return the table of the segments: each free parameter with two standard errors."""
    free = [p for p in estimate.params if p.free]
    header = ("from h", "to h", *(f"{p.symbol} {p.unit}" for p in free), "error %")
    rows = [_segment(s, [p.name for p in free]) for s in drift.segments]
    return aligned(header, rows, tuple(np.ones(len(header), dtype=bool)))


def _segment(s: Segment, names: list[str]) -> tuple[str, ...]:
    found = {n: f"{number(s.values[n], 4)} +- {number(2 * s.std[n], 2)}" for n in s.values}
    cells = (found.get(n, "not excited") for n in names)
    return f"{s.begin / 3600:.2f}", f"{s.end / 3600:.2f}", *cells, f"{100 * s.filtered_error:.2f}"
