"""What was measured, as data: written as JSON beside the page, which is made from it alone."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np


@dataclass(frozen=True, slots=True)
class Spread:
    """Median and quartiles of so many values."""

    median: float
    low: float
    high: float
    count: int


def spread(values: Sequence[float] | np.ndarray) -> Spread:
    """Return the median and the quartiles of values."""
    low, median, high = np.percentile(values, (25, 50, 75))
    return Spread(float(median), float(low), float(high), len(values))


@dataclass(frozen=True, slots=True)
class Timed:
    """Seconds of one simulation, and how many times those of this package in the same round."""

    seconds: Spread
    ratio: Spread


@dataclass(frozen=True, slots=True)
class Point:
    """One setting of a peer: its worst torque error as a share of the peak, and its time."""

    peer: str
    setting: str
    error: float
    seconds: Spread


@dataclass(frozen=True, slots=True)
class Row:
    """A peer in its chosen setting: one simulation, one with derivatives, and one of a batch on two cores."""

    peer: str
    setting: str
    error: float
    single: Timed
    slopes: Timed
    batch: Timed


@dataclass(frozen=True, slots=True)
class LoopResult:
    """All rows of one loop.

    Attributes:
        law, title: of the controller. samples: periods. events, peak: of the reference, which took `seconds`.
        rows: of the peers that ran. absent: peer and reason.
        differences: largest, as shares of the peak, between the reference or this package and the stick's.
    """

    law: str
    title: str
    samples: int
    events: int
    peak: float
    seconds: float
    rows: tuple[Row, ...]
    absent: tuple[tuple[str, str], ...]
    differences: tuple[tuple[str, float], ...] = ()


@dataclass(frozen=True, slots=True)
class Own:
    """What only this package is asked: seconds of its kernel alone, of a batch on one core, and to compile.

    Attributes:
        kernel: one simulation. single: the same as an optimiser calls it, in the same rounds.
        one_core: each of a batch of 1,000 on one core. compiling: the first simulation ever. cached: the first of a
            process later.
    """

    kernel: Spread
    single: Spread
    one_core: Spread
    compiling: float
    cached: float


@dataclass(frozen=True, slots=True)
class Footprint:
    """A fresh process up to its first torque: seconds, and the most memory it held, MB."""

    peer: str
    seconds: Spread
    memory: float


@dataclass(frozen=True, slots=True)
class Size:
    """What an installation takes, MB, and how many distributions it is; a reason where it could not be made."""

    title: str
    megabytes: float
    distributions: int
    failed: str = ""


@dataclass(frozen=True, slots=True)
class Solver:
    """A way to identify, from the same random starts.

    Attributes:
        title: in words. starts: tried. seconds, simulations: of each start. left: share of the torque each left.
        found: which of them ended at the lowest minimum that any of them found.
    """

    title: str
    starts: int
    seconds: tuple[float, ...]
    simulations: tuple[int, ...]
    left: tuple[float, ...]
    found: tuple[bool, ...]
    note: str = ""


@dataclass(frozen=True, slots=True)
class Rigid:
    """The public record of a real rigid axis, identified from torque alone: samples, what it took, and what it left."""

    samples: int
    seconds: Spread
    simulations: int
    left: float


@dataclass(frozen=True, slots=True)
class Release:
    """Ratios of one version to its peers on the first loop; times of other machines would not compare.

    Attributes:
        ratios: by the peer, how many times as long as this package it takes for one simulation, for one with
            derivatives, and for one of a batch.
    """

    version: str
    date: str
    ratios: dict[str, tuple[float, float, float]]


@dataclass(frozen=True, slots=True)
class Results:
    """Everything the page is made of.

    Attributes:
        machine, versions, date: of the last run. load: of the machine before and after it, as processes that want a
            core; nobody else on the machine would leave about 0 before.
        points: every setting on the first loop. releases: one for each version that was measured.
            The others are named as their classes are.
    """

    machine: str
    versions: tuple[tuple[str, str], ...]
    date: str
    load: tuple[float, ...] = ()
    points: tuple[Point, ...] = ()
    loops: tuple[LoopResult, ...] = ()
    own: Own | None = None
    footprints: tuple[Footprint, ...] = ()
    sizes: tuple[Size, ...] = ()
    solvers: tuple[Solver, ...] = field(default=())
    rigid: Rigid | None = None
    releases: tuple[Release, ...] = ()

    def of_release(self, version: str) -> Results:
        """Return these with the ratios of the first loop as those of a version, in the place of what it had."""
        rows = self.loops[0].rows if self.loops else ()
        medians = {
            row.peer: tuple(one.ratio.median for one in (row.single, row.slopes, row.batch))
            for row in rows
            if row.peer != "jointid"
        }
        ratios = {peer: (round(a, 3), round(b, 3), round(c, 3)) for peer, (a, b, c) in medians.items()}
        others = tuple(one for one in self.releases if one.version != version)
        return replace(self, releases=(*others, Release(version, self.date, ratios)) if ratios else others)


def save(results: Results, path: Path) -> None:
    """Write results as JSON."""
    from pydantic import TypeAdapter

    path.write_bytes(TypeAdapter(Results).dump_json(results, indent=1) + b"\n")


def load(path: Path) -> Results:
    """Read what `save` wrote."""
    from pydantic import TypeAdapter

    return TypeAdapter(Results).validate_json(path.read_bytes())
