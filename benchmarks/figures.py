"""The figures of the page: units on every axis, labels beside what they name, colours for the colour-blind."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from benchmarks.peers import PEERS, peer
from benchmarks.results import LoopResult, Point, Release, Results, Solver

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.axis import Axis
    from matplotlib.figure import Figure

# Okabe-Ito, each with a marker of its own, so that a grey print still reads.
_LOOKS = dict(
    zip(
        PEERS,
        (
            ("#000000", "D"), ("#999999", "d"), ("#D55E00", "o"), ("#0072B2", "s"), ("#009E73", "^"), ("#56B4E9", "v"),
            ("#CC79A7", "P"), ("#E69F00", "X"),
        ),
        strict=True,
    )
)  # fmt: skip
_SEARCHES = ("#000000", "#0072B2", "#D55E00")
LEFT = 0.03  # %: what is more exact is drawn there

IMAGES = ("benchmarks-error.png", "benchmarks-times.png", "benchmarks-searches.png", "benchmarks-releases.png")
"""Names of the files, in the order of the page."""


def drawn(results: Results, folder: Path) -> tuple[Path, ...]:
    """Draw everything the results have into a folder; return the files."""
    folder.mkdir(parents=True, exist_ok=True)
    figures = []
    if results.points:
        figures.append((IMAGES[0], error_figure(results.points)))
    if results.loops:
        figures.append((IMAGES[1], times_figure(results.loops[0])))
    if results.solvers:
        figures.append((IMAGES[2], searches_figure(results.solvers)))
    if results.releases:
        figures.append((IMAGES[3], releases_figure(results.releases)))
    for name, figure in figures:
        figure.savefig(folder / name, dpi=130)
    return tuple(folder / name for name, _ in figures)


def error_figure(points: Sequence[Point]) -> Figure:
    """Return time against error, a line for each peer through its settings; both as small as possible are best."""
    figure, axes = _one(9.0, 5.0)
    for key in PEERS:
        own = sorted((p for p in points if p.peer == key), key=lambda p: -p.error)
        for friction, line in (("smooth", ":"), ("", "-")):
            some = [p for p in own if ("smooth" in p.setting) == bool(friction)]
            if not some:
                continue
            x = [max(100 * p.error, LEFT) for p in some]
            y = [1e3 * p.seconds.median for p in some]
            colour, marker = _LOOKS[key]
            axes.plot(x, y, line, color=colour, marker=marker, markersize=7, linewidth=1.2)
            # Names stand at the exact end; that of a peer alone on the left has its error beside it.
            exact = f" (error {100 * some[-1].error:.0e} %)" if 100 * some[-1].error < LEFT else ""
            name = peer(key).title + (", tanh" if friction and key != "scipy" else "")
            axes.annotate(
                name + exact, (x[-1], y[-1]), (9, 6 - 12 * (key == "c")) if exact else (-7, 0),
                textcoords="offset points", va="center", ha="left" if exact else "right", fontsize=9, color=colour,
            )  # fmt: skip
    axes.set(xscale="log", yscale="log", xlim=(0.8 * LEFT, 30.0))
    axes.set_xlabel("worst torque error [% of the peak]")
    axes.set_ylabel("one simulation of 25 s [ms]")
    axes.grid(color="0.9")
    _plain(axes.xaxis, axes.yaxis)
    return figure


def times_figure(loop: LoopResult) -> Figure:
    """Return the times of one loop as points with their quartiles, the ratio to this package beside each."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(10.0, 3.6), layout="constrained")
    panels = figure.subplots(1, 3, sharey=True)
    rows = loop.rows[::-1]
    titles = ("one simulation", "with eight derivatives", "each of 1,000, two cores")
    for axes, name, title in zip(panels, ("single", "slopes", "batch"), titles, strict=True):
        for at, row in enumerate(rows):
            timed = getattr(row, name)
            low, middle, high = (1e3 * value for value in (timed.seconds.low, timed.seconds.median, timed.seconds.high))
            colour, marker = _LOOKS[row.peer]
            axes.plot([low, high], [at, at], color=colour, linewidth=2)
            axes.plot(middle, at, marker=marker, color=colour, markersize=8)
            axes.annotate(
                f"{_times(timed.ratio.median)}", (middle, at), (0, 7), textcoords="offset points", ha="center",
                fontsize=8,
            )  # fmt: skip
        axes.set(xscale="log", ylim=(-0.6, len(rows) - 0.3))
        axes.margins(x=0.15)
        axes.set_title(title, fontsize=10, loc="left")
        axes.set_xlabel("time [ms]")
        axes.tick_params(axis="x", labelsize=8)
        _plain(axes.xaxis)
        axes.grid(color="0.9", axis="x")
    panels[0].set_yticks(
        range(len(rows)), [f"{peer(row.peer).title}\nerror {_percent(row.error)}" for row in rows], fontsize=8
    )
    return figure


def searches_figure(solvers: Sequence[Solver]) -> Figure:
    """Return the share of the starts that have ended at the lowest minimum, over time and over simulations."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(9.0, 3.6), layout="constrained")
    panels = figure.subplots(1, 2, sharey=True)
    many = [solver for solver in solvers if solver.starts > 5]
    for axes, name, label in zip(panels, ("seconds", "simulations"), ("time [s]", "simulations"), strict=True):
        for number, (solver, colour) in enumerate(zip(many, _SEARCHES, strict=False)):
            _shares(axes, solver, getattr(solver, name), colour, ("-", "--", ":")[number])
        axes.set(xscale="log", ylim=(0, 104))
        axes.set_xlabel(label)
        _plain(axes.xaxis)
        axes.grid(color="0.9")
    panels[0].set_ylabel("starts that found the minimum [%]")
    panels[1].legend(loc="center left", bbox_to_anchor=(1.0, 0.5), frameon=False, fontsize=9)
    return figure


def releases_figure(releases: Sequence[Release]) -> Figure:
    """Return the ratios to each peer over the releases: one simulation, and one with derivatives."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(9.0, 3.6), layout="constrained")
    panels = figure.subplots(1, 2, sharey=True)
    for number, (axes, title) in enumerate(zip(panels, ("one simulation", "with eight derivatives"), strict=True)):
        for key in (key for key in PEERS if key != "jointid"):
            own = [(at, one.ratios[key][number]) for at, one in enumerate(releases) if key in one.ratios]
            colour, marker = _LOOKS[key]
            if own:
                axes.plot(*zip(*own, strict=True), color=colour, marker=marker, label=peer(key).title)
        axes.axhline(1.0, color="0.3", linewidth=1)
        axes.set(yscale="log", xlim=(-0.5, len(releases) - 0.5))
        axes.set_xticks(range(len(releases)), [one.version for one in releases])
        axes.set_title(title, fontsize=10, loc="left")
        axes.set_xlabel("release")
        axes.grid(color="0.9", axis="y")
        _plain(axes.yaxis)
    panels[0].set_ylabel("times as long as jointid")
    panels[1].legend(loc="center left", bbox_to_anchor=(1.0, 0.5), frameon=False, fontsize=9)
    return figure


def _shares(axes: Axes, solver: Solver, values: Sequence[float], colour: str, line: str) -> None:
    found = np.sort([value for value, good in zip(values, solver.found, strict=True) if good])
    share = 100 * np.arange(1, found.size + 1) / solver.starts
    axes.step(found, share, line, where="post", color=colour, label=solver.title, linewidth=2)


def _plain(*along: Axis) -> None:
    """Write numbers, not powers, along a logarithmic axis."""
    from matplotlib.ticker import FuncFormatter

    for axis in along:
        axis.set_major_formatter(FuncFormatter(lambda value, _at: f"{value:,g}"))


def _one(width: float, height: float) -> tuple[Figure, Axes]:
    from matplotlib.figure import Figure

    figure = Figure(figsize=(width, height), layout="constrained")
    return figure, figure.subplots()


def _times(ratio: float) -> str:
    return f"{ratio:,.2f}x" if ratio < 10 else f"{ratio:,.0f}x"


def _percent(share: float) -> str:
    return f"{100 * share:.0e} %" if share < 1e-6 else f"{100 * share:.2g} %"
