"""The figures of a report: each chart from a dossier, with a caption that says what to see."""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np

from jointid.common.text import number
from jointid.diagnostics.report_data import ReportData
from jointid.estimation.result.estimate import Estimate
from jointid.output.figures.charts import (
    ERROR,
    LOAD,
    MEASURED,
    OTHERS,
    SIMULATED,
    Band,
    Cells,
    Chart,
    Item,
    Level,
    Line,
    Mark,
    Panel,
)
from jointid.output.figures.figures import torque_word
from jointid.output.report.signals import Axes, residual_chart, torque_chart
from jointid.uncertainty.profile import Profile

_MODES = {"free_free": "free-free", "motor_locked": "motor locked", "load_locked": "load locked"}


def spectra_chart(given: ReportData) -> Chart | None:
    """Return the spectra of measured, simulated and error, with the joint's frequencies; None where there are none."""
    found, names = given.spectra, Axes.of(given.estimate)
    if found is None:
        return None
    modes = {} if given.response is None else given.response.modes
    marks = _marks(modes, float(found.frequency[-1]))
    cutoff = given.estimate.settings.filtering.cutoff
    if cutoff is not None:
        marks += (Mark(cutoff, f"fitted up to {cutoff:.3g} Hz", len(marks), "dotted"),)
    panel = Panel(
        "frequency [Hz]", f"{names.quantity}{names.side} [{names.unit}/√Hz]",
        (
            Line(found.frequency, found.measured, MEASURED, "measured"),
            Line(found.frequency, found.predicted, SIMULATED, names.predicted),
            Line(found.frequency, found.error, ERROR, "error", 0.9),
            *marks,
        ),
        log_x=True, log_y=True, height=360,
    )  # fmt: skip
    where = "" if not modes else " The joint's three frequencies are marked, " + ", ".join(_said_modes(modes)) + "."
    caption = (
        f"Amplitude spectra, {found.resolution:.2g} Hz apart. Where the error lies well below the measured "
        f"{names.quantity} the model explains it; where it reaches it, nothing is explained.{where}"
    )
    return Chart("spectra", caption, (panel,))


def _said_modes(modes: Mapping[str, float]) -> list[str]:
    return [f"{_MODES[name]} {hertz:.1f} Hz" for name, hertz in modes.items()]


def _marks(modes: Mapping[str, float], highest: float) -> tuple[Mark, ...]:
    ordered = sorted(modes.items(), key=lambda item: item[1])
    seen = [(name, hertz) for name, hertz in ordered if hertz < highest]
    return tuple(Mark(hertz, f"{_MODES[name]} {hertz:.1f} Hz", row) for row, (name, hertz) in enumerate(seen))


def response_chart(given: ReportData) -> Chart | None:
    """Return the frequency response of the joint, magnitude over phase; None where it cannot be had."""
    found = given.response
    if found is None:
        return None
    colours = {"motor": MEASURED, "load": LOAD}
    sizes: list[Item] = []
    phases: list[Item] = []
    for curve in found.curves:
        colour = colours[curve.side]
        sizes += [
            Band(found.frequency, curve.low, curve.high, colour),
            Line(found.frequency, curve.magnitude, colour, f"{curve.side} side", 1.6),
        ]
        phases.append(Line(found.frequency, curve.phase, colour, "", 1.6, "solid"))
    highest = float(found.frequency[-1])
    marks = _marks(found.modes, highest)
    names, drive = Axes.of(given.estimate), torque_word(given.estimate.data.torque_unit)
    panels = (
        Panel(
            "", f"velocity per {drive}{names.side} [{found.unit}]", (*sizes, *marks), log_x=True, log_y=True,
            height=320, group="frequency",
        ),
        Panel("frequency [Hz]", "phase [°]", tuple(phases), log_x=True, height=200, group="frequency"),
    )  # fmt: skip
    way = " of moving forwards" if given.estimate.settings.joint.friction.depends_on_direction("viscous") else ""
    caption = (
        f"What the identified joint answers to its motor's torque, viscous friction{way} and no Coulomb friction taken "
        "in; the shaded band is 2 sigma of the estimate."
    )
    if found.modes:
        caption += (
            " The motor shows a dip at the motor-locked frequency and a peak at the free-free one; a controller has to "
            "stay away from the latter, or damp it."
        )
    else:
        caption += " A rigid joint falls by 10 for each decade above its corner, and shows no mode."
    return Chart("response", caption, panels)


def correlation_chart(given: ReportData) -> Chart | None:
    """Return the correlations of the estimate's errors; None where they are not known."""
    estimate = given.estimate
    free = [p for p in estimate.params if p.free][: len(estimate.params.correlation)]
    own = [i for i, p in enumerate(free) if p.of_joint]
    if len(own) < 2 or any(free[i].value is None for i in own):
        return None
    values = estimate.params.correlation[np.ix_(own, own)]
    names = tuple(free[i].symbol for i in own)
    apart = np.abs(values - np.diag(np.diag(values)))
    i, j = np.unravel_index(int(np.argmax(apart)), apart.shape)
    caption = (
        f"Correlations of the errors. Where one is near 1 or -1 the record tells a sum or a difference of the two, not "
        f"each; the largest here is {values[i, j]:+.2f}, of {names[int(i)]} and {names[int(j)]}."
    )
    panel = Panel("", "", (Cells(names, values),), height=min(140 + 42 * len(names), 560))
    return Chart("correlation", caption, (panel,))


def profiles_chart(given: ReportData) -> Chart | None:
    """Return the profiles, each beside what the table's interval says; None where there is none."""
    shown = [one for one in given.profiles if one.points.size > 2]
    if not shown:
        return None
    panels = tuple(_profile(one, given.estimate) for one in shown)
    caption = (
        "Each quantity held away from its estimate, all others fitted again: how many standard deviations the "
        "criterion has risen. The interval ends where the line passes 2; the dashed line is what the table's interval, "
        "by the slopes at the estimate alone, takes it for. Where the two part, the profile is to be believed."
    )
    if any(one.improved for one in shown):
        caption += (
            " Rigid DIDIM ends where the simulated motion's regressor sees nothing more in the error, which is not "
            "quite where the squares are least: a profile may go below the estimate."
        )
    return Chart("profiles", caption, panels, columns=3)


def _profile(one: Profile, estimate: Estimate) -> Panel:
    risen = 2.0 * np.sqrt(np.maximum(one.rise, 0.0) / one.threshold)
    items: list[Item] = [Line(one.points, risen, MEASURED, "", 1.6, dots=True)]
    known = next((p for p in estimate.params if p.symbol == one.formula and p.stderr), None)
    std = None if known is None else known.stderr
    if one.name == "compliance" and estimate["stiffness"].stderr:
        std = (estimate["stiffness"].stderr or 0.0) * one.estimate**2
    if std:
        inside = np.clip(one.points, one.estimate - 3 * std, one.estimate + 3 * std)
        x = np.unique(np.array([inside.min(), one.estimate, inside.max()]))
        items.append(Line(x, np.abs(x - one.estimate) / std, "#666666", "", 1.0, "dashed"))
    items.append(Level(2.0, ""))
    return Panel(f"{one.formula} [{one.unit}]", "rise [sigma]", tuple(items), height=210, y_range=(0.0, 3.2))


def convergence_chart(given: ReportData) -> Chart | None:
    """Return the residual and the parameters over the iterations; None where there are none to show."""
    trace = given.estimate.fit.trace
    if len(trace) < 2:
        return None
    numbers = np.array([line.number for line in trace], dtype=np.float64)
    norms = np.array([line.residual_norm for line in trace])
    panels = [
        Panel(
            "iteration", f"residual norm [{Axes.of(given.estimate).unit}]", (Line(numbers, norms, ERROR, dots=True),),
            log_y=bool(norms.min() > 0 and norms.max() > 10 * norms.min()), height=280,
        )
    ]  # fmt: skip
    last, lines = trace[-1].values, []
    told = all(p.value is not None for p in given.estimate.params)
    own = {p.name: p.symbol for p in given.estimate.params if p.of_joint and p.free} if told else {}
    for (name, symbol), colour in zip(own.items(), OTHERS * 2, strict=False):
        ways = [line.values.get(name, math.nan) for line in trace]
        if last.get(name) and all(map(math.isfinite, ways)):
            lines.append(Line(numbers, np.array(ways) / last[name], colour, symbol, 1.4))
    if lines:
        panels.append(Panel("iteration", "parameter over its last value", tuple(lines), height=280))
    caption = (
        f"How the search went: {given.estimate.fit.iterations} iterations, "
        f"{given.estimate.fit.simulations} simulations in "
        f"all. The residual goes from {number(norms[0], 3)} to {number(norms[-1], 3)}; where it jumps up, another "
        "start begins."
    )
    if lines:
        caption += " Every parameter ends at 1: one that still moves there is not settled."
    return Chart("convergence", caption, tuple(panels), columns=len(panels))


def bounds_chart(given: ReportData) -> Chart | None:
    """Return how soft a refused spring may be, by the load's share of the inertia; None where it is not refused."""
    known = [b for b in given.estimate.checks.bounds if b.stiffness is not None and b.frequency is not None]
    if not known:
        return None
    share = np.array([b.share for b in known])
    stiffness = np.array([b.stiffness for b in known], dtype=np.float64)
    mode = np.array([b.frequency for b in known], dtype=np.float64)
    unit = given.estimate["stiffness"].unit
    panels = (
        Panel(
            "load's share of the inertia", f"stiffness [{unit}]",
            (
                Band(share, np.full(share.size, 0.5 * stiffness.min()), stiffness, OTHERS[3], "excluded"),
                Line(share, stiffness, OTHERS[3], "", 1.6, dots=True),
            ),
            log_y=True, height=280,
        ),
        Panel(
            "load's share of the inertia", "free-free mode [Hz]",
            (Band(share, np.zeros(share.size), mode, OTHERS[3], "excluded"),
             Line(share, mode, OTHERS[3], "", 1.6, dots=True)),
            height=280,
        ),
    )  # fmt: skip
    caption = (
        "The stiffness is refused, and this is what is known of it instead: what lies in the shaded part is excluded "
        "with 95 % confidence, for a lightly damped mode. The more of the inertia is behind the spring, the stiffer it "
        "must be."
    )
    return Chart("bounds", caption, panels, columns=2)


def draw_charts(given: ReportData) -> dict[str, Chart]:
    """Return every figure that can be had of a dossier, by its name, in the order of a report."""
    makers = (
        bounds_chart, torque_chart, residual_chart, spectra_chart, response_chart, correlation_chart, profiles_chart,
        convergence_chart,
    )  # fmt: skip
    found = [made for made in (make(given) for make in makers) if made is not None]
    return {chart.name: chart for chart in found}
