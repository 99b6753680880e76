"""The tables of a report that are not of the estimate alone."""

from __future__ import annotations

from jointid.common.document import Table
from jointid.common.text import number
from jointid.diagnostics.report_data import ReportData
from jointid.diagnostics.validation import Validation


def modes_table(given: ReportData) -> Table | None:
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


def profiles_table(given: ReportData) -> Table | None:
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


def suspects_table(given: ReportData) -> Table | None:
    """Return every test of loop and log; None where they were not checked."""
    if given.loop is None:
        return None
    said = (
        "Every test of loop and log, each as if nothing else were wrong; the sentences above take in, one after the "
        "other, what was found before them. Friction towards standstill is tested one way only"
    )
    return given.loop.table(said)


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


def channels_table(given: ReportData) -> Table:
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
