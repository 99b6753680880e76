"""How the cost of simulations grows with their length, their number and the workers, and its figure.

Each number is time of a core, the best of several by turns: others that use the machine make it only longer, and less
so than time by the clock. What two workers make of two cores by the clock is in `benchmarks.campaigns`.
"""

from __future__ import annotations

import os
import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from benchmarks.peers import peer
from benchmarks.problem import PERIOD, SAMPLES, STICK, candidates, loop_of

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_TURNS = 15
_LENGTHS = (SAMPLES // 16, SAMPLES // 4, SAMPLES, 4 * SAMPLES)
_NUMBERS = (1, 3, 10, 30, 100, 300, 1000)
_OF_A_LENGTH, _OF_WORKERS = 40, 200  # simulations
_COLOUR = "#0072B2"


@dataclass(frozen=True, slots=True)
class Growth:
    """Seconds of a core: of a simulation by the seconds it lasts, of a batch by its candidates, of one by workers."""

    length: dict[float, float]
    candidates: dict[int, float]
    workers: dict[int, float]

    def __str__(self) -> str:
        """Return it in lines."""
        lines = [
            *(f"length {of:6.2f} s  {1e9 * PERIOD * s / of:6.1f} ns a sample" for of, s in self.length.items()),
            *(f"candidates {of:5}  {1e3 * s / of:7.3f} ms each" for of, s in self.candidates.items()),
            *(f"workers {of:2}  {1e3 * s:7.3f} ms of a core each" for of, s in self.workers.items()),
        ]
        return "\n".join(lines)


def measure() -> Growth:
    """Measure how cost grows; lengths and candidates with one worker."""
    setting = peer("jointid").settings[0]
    made = {samples: peer("jointid")(loop_of(STICK, samples), setting) for samples in _LENGTHS}
    every, whole = candidates(max(_NUMBERS)), made[SAMPLES]
    workers = range(1, (os.cpu_count() or 1) + 1)

    def batch(engine: Any, number: int, workers: int = 1) -> Callable[[], object]:
        return lambda: engine.batch(every[:number], workers)

    best = _best(
        {("length", n): batch(made[n], _OF_A_LENGTH) for n in _LENGTHS}
        | {("candidates", n): batch(whole, n) for n in _NUMBERS}
        | {("workers", n): batch(whole, _OF_WORKERS, n) for n in workers}
    )
    return Growth(
        {n * PERIOD: best["length", n] / _OF_A_LENGTH for n in _LENGTHS},
        {n: best["candidates", n] for n in _NUMBERS},
        {n: best["workers", n] / _OF_WORKERS for n in workers},
    )


def _best(works: dict[tuple[str, int], Callable[[], object]]) -> dict[tuple[str, int], float]:
    found: dict[tuple[str, int], list[float]] = {key: [] for key in works}
    for turn in range(_TURNS + 1):
        for key, work in works.items():
            begin = time.process_time()
            work()
            if turn:  # the first loads and compiles
                found[key].append(time.process_time() - begin)
    return {key: min(times) for key, times in found.items()}


def growth_figure(growth: Growth) -> Figure:
    """Return cost against length, candidates and workers, each beside what is strictly in proportion."""
    from matplotlib.figure import Figure
    from matplotlib.ticker import FuncFormatter

    figure = Figure(figsize=(10.0, 3.4), layout="constrained")
    panels = figure.subplots(1, 3)
    shown = (
        ("length of a simulation [s]", "core time of each [ms]", {of: 1e3 * s for of, s in growth.length.items()}),
        ("candidates of 25 s", "core time of all [ms]", {of: 1e3 * s for of, s in growth.candidates.items()}),
        ("workers", "core time of 25 s [ms]", {of: 1e3 * s for of, s in growth.workers.items()}),
    )
    for axes, (along, up, points) in zip(panels, shown, strict=True):
        x, y = np.array(list(points), dtype=float), np.array(list(points.values()))
        flat = along == "workers"
        line = np.full_like(y, y[0]) if flat else y[-1] * x / x[-1]
        axes.plot(x, line, color="0.6", linewidth=1)
        at = 0 if flat else len(x) // 2
        said, off, va = ("the same for any number", 10, "bottom") if flat else ("in proportion", -6, "top")
        axes.annotate(
            said, (x[at], line[at]), (8, off), textcoords="offset points", va=va, fontsize=8, color="0.4"
        )  # fmt: skip
        axes.plot(x, y, "o-", color=_COLOUR, markersize=6)
        if flat:
            axes.set(xticks=x, xlim=(x[0] - 0.5, x[-1] + 0.5), ylim=(0.0, 1.5 * y.max()))
        else:
            axes.set(xscale="log", yscale="log")
            for axis in (axes.xaxis, axes.yaxis):
                axis.set_major_formatter(FuncFormatter(lambda value, _at: f"{value:,g}"))
        axes.set_xlabel(along)
        axes.set_ylabel(up)
        axes.grid(color="0.9")
    return figure
