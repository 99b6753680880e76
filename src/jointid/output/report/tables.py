"""The tables of a report, from a dossier."""

from __future__ import annotations

from jointid.common.text import number
from jointid.diagnostics.report_data import Dossier
from jointid.diagnostics.validation import Validation
from jointid.estimation.result.estimate import Estimate
from jointid.estimation.result.params import known_on_other_side
from jointid.estimation.result.table_rows import parameter_row, shown
from jointid.output.report.document import Facts, Table


def parameters_table(estimate: Estimate) -> Table:
    """Return every parameter with its interval, and with a transmission what it is on the other side."""
    header: tuple[str, ...] = ("symbol", "parameter", "value", "± 2 sigma", "sigma %", "unit")
    rows = [parameter_row(p) for p in estimate.params]
    if estimate.other is not None:
        header = (*header, f"on the {estimate.other.side} side", "unit")
        rows = [(*row, shown(p), p.unit) for row, p in zip(rows, estimate.other_side, strict=True)]
    gear = estimate.settings.joint.transmission
    side = "" if gear is None else f", on the {gear.side} side"
    return Table(header, tuple(rows), f"The parameters{side}", words=(0, 1, 5, 7))


def sums_table(estimate: Estimate) -> Table | None:
    """Return what is known of several parameters together; None where nothing is."""
    if estimate.checks.known is None or not (estimate.checks.known.physical or estimate.checks.known.directions):
        return None
    physical = estimate.checks.known.physical
    there = known_on_other_side(physical, estimate.other)
    rows: list[tuple[str, ...]] = [
        (one.combination.formula, number(one.value), number(2 * one.std, 2), one.combination.unit, one.verdict)
        for one in (*physical, *estimate.checks.known.directions)
    ]
    header: tuple[str, ...] = ("combination", "value", "± 2 sigma", "unit", "known")
    if estimate.other is not None:
        header = (*header, f"on the {estimate.other.side} side")
        told = [f"{number(one.value)} {one.combination.unit}" for one in there]
        rows = [(*row, told[i] if i < len(told) else "-") for i, row in enumerate(rows)]
    caption = f"What is known together: {'sums and differences, then ' if physical else ''}the best known combinations"
    return Table(header, tuple(rows), caption, words=(0, 3, 4, 5))


def bounds_table(estimate: Estimate) -> Table | None:
    """Return how soft a refused spring may be; None where it is not refused."""
    if not estimate.checks.bounds:
        return None
    unit = estimate["stiffness"].unit
    rows = tuple(
        (f"{b.share:.2f}", "not bounded", "-")
        if b.stiffness is None or b.frequency is None
        else (f"{b.share:.2f}", f"{number(b.stiffness, 2)}", f"{b.frequency:.0f}")
        for b in estimate.checks.bounds
    )
    return Table(
        ("load's share of the inertia", f"stiffness at least [{unit}]", "free-free mode at least [Hz]"), rows,
        "With 95 % confidence, for a lightly damped mode",
    )  # fmt: skip


def bands_table(estimate: Estimate) -> Table | None:
    """Return what remains in each band of frequencies; None where it was not looked at."""
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
    return Table(("band [Hz]", "error [% of the torque there]", "share of the residual [%]"), rows, "Where it remains")


def modes_table(given: Dossier) -> Table | None:
    """Return the three frequencies of a flexible joint; None where there are none."""
    if given.response is None or not given.response.modes:
        return None
    words = {
        "free_free": ("free-free", "both sides free: the peak, and the pole a controller meets"),
        "motor_locked": ("motor locked", "the load on its spring: the dip the motor sees"),
        "load_locked": ("load locked", "the motor on its spring, the load held"),
    }
    rows = tuple((*words[name], f"{hertz:.2f}") for name, hertz in given.response.modes.items())
    return Table(("frequency", "what it is", "Hz"), rows, "The three frequencies", words=(0, 1))


def profiles_table(given: Dossier) -> Table | None:
    """Return the profiles' intervals; None where there are none."""
    if not given.profiles:
        return None
    rows: tuple[tuple[str, ...], ...] = tuple(
        (
            one.formula,
            number(one.estimate),
            *("no end found" if end is None else number(end, 4) for end in one.interval),
            one.unit,
            "least squares ends lower" if one.improved else "",
        )
        for one in given.profiles
    )
    level = 100 * given.profiles[0].level
    header: tuple[str, ...] = ("quantity", "estimate", "from", "to", "unit", "note")
    if not any(row[-1] for row in rows):
        header, rows = header[:-1], tuple(row[:-1] for row in rows)
    return Table(header, rows, f"Profile intervals, {level:.4g} %", words=(0, 4, 5))


def suspects_table(given: Dossier) -> Table | None:
    """Return every test of loop and log; None where they were not checked."""
    if given.loop is None:
        return None
    rows = tuple(
        (s.words, f"{s.size:+.3g}", number(2 * s.std, 2), f"{s.statistic:+.1f}", number(s.p_value, 2))
        for s in given.loop.suspects
    )
    said = (
        "Every test of loop and log, each as if nothing else were wrong; the sentences above take in, one after the "
        "other, what was found before them. Friction towards standstill is tested one way only"
    )
    return Table(("suspect", "more than declared", "± 2 sigma", "statistic", "p"), rows, said)


def checks_table(checks: tuple[Validation, ...]) -> Table | None:
    """Return the tests on records; None where there is none."""
    if not checks:
        return None
    rows = tuple(
        (
            f"{check.test}, {check.record}",
            f"{100 * check.relative_error:.2f}",
            f"{100 * check.filtered_error:.2f}",
            "-" if check.tracking_error is None else f"{100 * check.tracking_error:.2f}",
            f"{100 * check.outside_band:.0f}",
        )
        for check in checks
    )
    header = ("test", "error, raw [%]", "error, filtered [%]", "tracking error off by [%]", "not white [% of lags]")
    return Table(header, rows, "The identified joint simulated, or its inverse model evaluated, on whole records")


def channels_table(given: Dossier) -> Table:
    """Return the channels of the record, and which of them were read."""
    rows = tuple(
        (
            one.name.replace("_", " "),
            "read" if one.name in given.estimate.data.channels else "not read",
            one.source or "-",
            one.timing,
            one.unit,
            f"{one.sample_time:.6g}",
            str(one.samples),
        )
        for one in given.channels
    )
    header = ("channel", "in this answer", "source", "timing", "unit", "sample time [s]", "samples")
    return Table(header, rows, "The record's channels, in SI units", words=(0, 1, 2, 3, 4))


def settings(estimate: Estimate) -> Facts:
    """Return how it was identified."""
    f, joint = estimate.settings.filtering, estimate.settings.joint
    borders = f"{estimate.fit.borders[0]} samples at the start, {estimate.fit.borders[1]} at the end"
    position = "none" if f.position_cutoff is None else f"{f.position_cutoff:g} Hz"
    pairs = [
        ("Method", estimate.settings.variant),
        (
            "Model",
            f"{joint.model}, {joint.friction.name} friction",
        ),
        ("Left out of the raw error", borders),
        ("Filter", f"{f.cutoff:g} Hz, one sample in {f.decimation}; positions {position}; timing {f.timing}"),
        ("Rows fitted", str(estimate.fit.rows)),
        ("Delay of the torque", f"{1e3 * estimate.settings.delay:.4g} ms"),
        ("Effort", f"{estimate.fit.iterations} iterations, {estimate.fit.simulations} simulations"),
        ("Stopped", estimate.fit.stop),
        ("Intervals", estimate.params.basis),
    ]
    return Facts(tuple(pairs))
