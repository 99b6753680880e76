"""Repeated runs with different noise: scatter against stated deviations, and outliers.

For normal estimates, ``(n - 1) s^2`` over the variance is chi-square with n - 1 degrees of freedom, which gives the
interval of the scatter s of n runs over the median stated deviation. Limits: an outlier widens s, and is reported; a
bias does not scatter.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from jointid.campaigns.rows import Outcome, Row
from jointid.common.arrays import FloatArray
from jointid.common.document import Block, Heading, Table
from jointid.common.text import counted, listed, number, signed

_FEWEST = 3  # runs that have a scatter
_LEVEL = 0.95  # of its interval
_CLOSE = 1.1  # a ratio that is no other, however surely it is known
_OUT = 6.0  # robust deviations above which a run stands out
_NAMED = 5  # quantities in a sentence
_TO_SIGMA = 1.4826  # from the median of absolute deviations, for a normal distribution


@dataclass(frozen=True, slots=True, eq=False)
class Repeated:
    """A quantity over runs that differ in their seed alone.

    Attributes:
        name: of the quantity, with the swept settings of these runs.
        seeds: (runs,) of each.
        values: (runs,) in SI units.
        stds: (runs,) stated standard deviations.
        truth: where it is known, and of all runs the same.
    """

    name: str
    seeds: tuple[int | None, ...]
    values: FloatArray
    stds: FloatArray
    unit: str = ""
    truth: float | None = None

    @property
    def ratio(self) -> float:
        """Scatter over the median stated standard deviation."""
        return float(np.std(self.values, ddof=1) / np.median(self.stds))

    @property
    def interval(self) -> tuple[float, float]:
        """Interval of the ratio, of 95 %."""
        from scipy.special import chdtri

        freedom = self.values.size - 1
        lower, upper = (
            self.ratio * math.sqrt(freedom / float(chdtri(freedom, (1 - sign * _LEVEL) / 2))) for sign in (1, -1)
        )
        return lower, upper

    @property
    def verdict(self) -> str:
        """Whether the scatter agrees with the stated deviations."""
        lower, upper = self.interval
        if lower > 1 and self.ratio > _CLOSE:
            return "more than stated"
        return "less" if upper < 1 and self.ratio < 1 / _CLOSE else "as stated"

    @property
    def outlying(self) -> Iterator[tuple[int | None, float, float]]:
        """Seed, value and deviations of each outlier."""
        off = self.values - np.median(self.values)
        scale = max(_TO_SIGMA * float(np.median(np.abs(off))), float(np.median(self.stds)))
        for k in np.flatnonzero(np.abs(off) > _OUT * scale):
            yield self.seeds[k], float(self.values[k]), float(off[k] / scale)


def repeats_of(rows: Sequence[Row]) -> Iterator[Repeated]:
    """Yield every quantity of three or more runs with different seeds."""
    groups: dict[tuple[str, tuple[str, ...]], list[tuple[int | None, float, float]]] = {}
    units, truths = dict[str, str](), dict[tuple[str, tuple[str, ...]], set[float | None]]()
    for row in rows:
        if row.outcome is Outcome.IDENTIFIED:
            for name, one in row.found.items():
                if one.value is not None and one.std:
                    groups.setdefault((name, row.changes), []).append((row.seed, one.value, one.std))
                    truths.setdefault((name, row.changes), set()).add(row.truth.get(name))
                    units[name] = one.unit
    for (name, changes), runs in sorted(groups.items(), key=lambda one: one[0][1]):
        if len(runs) >= _FEWEST:
            seeds, values, stds = zip(*runs, strict=True)
            called = f"{name} ({'; '.join(changes)})" if changes else name
            known = truths[name, changes]
            truth = next(iter(known)) if len(known) == 1 else None
            yield Repeated(called, seeds, np.array(values), np.array(stds), units[name], truth)


def summarise_repeats(found: Sequence[Repeated], runs: int, what: str) -> tuple[str, bool | None]:
    """State whether runs scatter as stated; None if unknown."""
    if not found:
        return f"{counted(runs, f'{what} run')} with an answer; three are needed to say how they scatter.", None
    wrong = [one for one in found if one.verdict != "as stated"]
    if not wrong:
        return f"{counted(runs, f'{what} run')} scatter as their stated deviations say.", True
    said = [f"{one.name} ({number(one.ratio, 2)} times as stated)" for one in wrong[:_NAMED]]
    more = [f"{len(wrong) - _NAMED} more"] if len(wrong) > _NAMED else []
    return f"{counted(runs, f'{what} run')} scatter otherwise than stated in {listed([*said, *more])}.", False


def repeat_blocks(found: Sequence[Repeated], most: int | None) -> Iterator[Block]:
    """Yield scatter against stated deviations, and outliers."""
    if found:
        yield Heading("Scatter between the runs over the stated standard deviation")
        scatter = ((one.name, str(one.values.size), number(one.ratio, 3), " to ".join(number(end, 3) for end in
                   one.interval), one.verdict) for one in found)  # fmt: skip
        yield Table(("quantity", "runs", "ratio", "95 %", "verdict"), tuple(scatter), "", (0, 3, 4))
    outlying = [
        (one.name, f"seed {seed}", number(value), signed(off, 2))
        for one in found
        for seed, value, off in one.outlying
    ]  # fmt: skip
    if outlying:
        yield Heading("Runs that stand out from the others")
        outlying.sort(key=lambda row: -abs(float(row[-1])))
        yield Table(("quantity", "run", "value", "deviations"), tuple(outlying[:most]), "", (0, 1))
