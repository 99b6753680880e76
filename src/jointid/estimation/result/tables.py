"""The tables of an estimate, for every rendering of it: terminal, report, notebook."""

from __future__ import annotations

import math

from jointid.common.document import Facts, Table
from jointid.common.text import number
from jointid.estimation.problems.nuisance_parameters import INITIAL
from jointid.estimation.result.estimate import Estimate
from jointid.estimation.result.params import EstimatedParameter, known_on_other_side
from jointid.uncertainty.identifiability import Kind
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


def parameters_table(estimate: Estimate, caption: str = "", *, initial: bool = True) -> Table:
    """Return every parameter with its interval, and with a transmission what it is on the other side.

    Args:
        estimate: whose parameters are shown.
        caption: of the table.
        initial: whether to show the state at the first sample.
    """
    header: tuple[str, ...] = ("symbol", "parameter", "value", "2 sigma", "sigma %", "unit")
    listed = [i for i, p in enumerate(estimate.params) if initial or p.name not in INITIAL]
    rows = [parameter_row(estimate.params[i]) for i in listed]
    if estimate.other is not None:
        header, there = (*header, f"{estimate.other.side} side", "unit"), estimate.other_side
        rows = [(*row, shown(there[i]), there[i].unit) for row, i in zip(rows, listed, strict=True)]
    return Table(header, tuple(rows), caption, words=(0, 1, 5, 7))


def combinations_table(
    estimate: Estimate, caption: str = "", *, directions: bool = False, differences: bool = True
) -> Table | None:
    """Return sums and differences of both sides; None where there are none.

    Args:
        estimate: whose combinations are shown.
        caption: of the table.
        directions: whether to add the singular directions of the sensitivities.
        differences: whether to show the differences of both sides, too; else only their sums.
    """
    known = estimate.checks.known
    if known is None:
        return None
    there = known_on_other_side(known.physical, estimate.other)
    told = {id(one): f"{number(o.value)} {o.combination.unit}" for one, o in zip(known.physical, there, strict=False)}
    every = (*known.physical, *(known.directions if directions else ()))
    shown = [one for one in every if differences or one.combination.kind is not Kind.DIFFERENCE]
    if not shown:
        return None
    rows: list[tuple[str, ...]] = [
        (one.combination.formula, number(one.value), number(2 * one.std, 2), one.combination.unit, one.verdict)
        for one in shown
    ]
    header: tuple[str, ...] = ("combination", "value", "2 sigma", "unit", "known")
    if estimate.other is not None:
        header = (*header, f"{estimate.other.side} side")
        rows = [(*row, told.get(id(one), "-")) for row, one in zip(rows, shown, strict=True)]
    return Table(header, tuple(rows), caption, words=(0, 3, 4, 5))


def bounds_table(estimate: Estimate, caption: str = "") -> Table | None:
    """Return the lower bounds of a refused stiffness; None where it is not refused."""
    bounds, other = estimate.checks.bounds, estimate.other
    if not bounds:
        return None
    unit = estimate["stiffness"].unit
    header: tuple[str, ...] = ("load's share of the inertia", f"stiffness at least [{unit}]", "free-free mode [Hz]")
    rows = [_bound(bound) for bound in bounds]
    if other is not None:
        header = (*header, f"{other.side} side [{other.unit(unit)}]")
        there = ["-" if b.stiffness is None else number(other.ratio**2 * b.stiffness, 2) for b in bounds]
        rows = [(*row, value) for row, value in zip(rows, there, strict=True)]
    return Table(header, tuple(rows), caption)


def _bound(bound: StiffnessBound) -> tuple[str, ...]:
    if bound.stiffness is None or bound.frequency is None:
        return f"{bound.share:.2f}", "not bounded", "-"
    return f"{bound.share:.2f}", number(bound.stiffness, 2), f"{bound.frequency:.0f}"


def bands_table(estimate: Estimate, caption: str = "") -> Table | None:
    """Return the residual in each band of frequencies; None where it was not looked at."""
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


def settings_facts(estimate: Estimate) -> Facts:
    """Return how it was identified."""
    f, joint, fit = estimate.settings.filtering, estimate.settings.joint, estimate.fit
    position = "none" if f.position_cutoff is None else f"{f.position_cutoff:g} Hz"
    return Facts(
        (
            ("Method", estimate.settings.variant),
            ("Model", f"{joint.model}, {joint.friction.name} friction"),
            ("Left out of the raw error", f"{fit.borders[0]} samples at the start, {fit.borders[1]} at the end"),
            ("Filter", f"{f.cutoff:g} Hz, one sample in {f.decimation}; positions {position}; timing {f.timing}"),
            ("Rows fitted", str(fit.rows)),
            ("Delay of the torque", f"{1e3 * estimate.settings.delay:.4g} ms"),
            ("Effort", f"{fit.iterations} iterations, {fit.simulations} simulations"),
            ("Stopped", fit.stop),
            ("Intervals", estimate.params.basis),
        )
    )
