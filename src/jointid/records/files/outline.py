"""Outline a signal of any length in bounded memory: range, missing numbers, monotonicity, envelope."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from itertools import pairwise

import numpy as np

from jointid.common.arrays import FloatArray

_STRETCHES = 1024  # that are kept at most, of equal length; a power of two


@dataclass(frozen=True, slots=True, eq=False)
class Outline:
    """A signal in short.

    Attributes:
        rows: how many numbers it has, NaN included.
        missing: how many of them are NaN.
        minimum, maximum: of the others; None where all are missing.
        first, last: its ends.
        rises: True if every number is larger than the one before.
        step: mean difference between neighbours.
        jitter: largest deviation of such a difference from the mean, as a share of it; NaN where the mean is 0.
        low, high: smallest and largest of every stretch, shape (stretches,); NaN where all of it is missing.
        length: numbers of a stretch; the last one may have fewer.
    """

    rows: int
    missing: int
    minimum: float | None
    maximum: float | None
    first: float
    last: float
    rises: bool
    step: float
    jitter: float
    low: FloatArray
    high: FloatArray
    length: int

    def stretches(self, count: int) -> list[tuple[float, float]]:
        """Return the range of so many stretches, or of as many as there are."""
        edges = np.linspace(0, self.low.size, min(count, self.low.size) + 1).astype(int)
        return [
            (float(np.fmin.reduce(self.low[start:end])), float(np.fmax.reduce(self.high[start:end])))
            for start, end in pairwise(edges)
        ]


@dataclass(slots=True)
class OutlineBuilder:
    """Builder of an outline from a signal that comes part after part."""

    rows: int = 0
    missing: int = 0
    rises: bool = True
    first: float = math.nan
    last: float = math.nan
    steps: tuple[float, float] = (math.inf, -math.inf)
    low: FloatArray = field(default_factory=lambda: np.full(_STRETCHES, np.nan))
    high: FloatArray = field(default_factory=lambda: np.full(_STRETCHES, np.nan))
    length: int = 1

    def take(self, values: FloatArray) -> None:
        """Add the next numbers, shape (samples,), one or more."""
        if self.rows == 0:
            self.first = float(values[0])
        before = values[:1] if self.rows == 0 else np.array([self.last])
        with np.errstate(invalid="ignore", over="ignore"):  # infinite numbers have no difference
            steps = np.diff(np.concatenate([before, values])[1 if self.rows == 0 else 0 :])
        if steps.size:
            self.rises = self.rises and bool(np.all(steps > 0))
            self.steps = (min(self.steps[0], float(steps.min())), max(self.steps[1], float(steps.max())))
        self.missing += int(np.count_nonzero(np.isnan(values)))
        while self.rows + values.size > _STRETCHES * self.length:
            self._halve()
        stretches = np.arange(self.rows // self.length, (self.rows + values.size - 1) // self.length + 1)
        starts = np.maximum(stretches * self.length - self.rows, 0)
        self.low[stretches] = np.fmin(self.low[stretches], np.fmin.reduceat(values, starts))
        self.high[stretches] = np.fmax(self.high[stretches], np.fmax.reduceat(values, starts))
        self.rows += values.size
        self.last = float(values[-1])

    def _halve(self) -> None:
        """Make stretches twice as long."""
        for kept, smaller in ((self.low, np.fmin), (self.high, np.fmax)):
            pairs = smaller.reduce(kept.reshape(-1, 2), axis=1)
            kept[:] = np.nan
            kept[: pairs.size] = pairs
        self.length *= 2

    def build(self) -> Outline:
        """Return the outline; one number or more must have been taken."""
        used = math.ceil(self.rows / self.length)
        low, high = self.low[:used].copy(), self.high[:used].copy()
        there = self.missing < self.rows
        step = (self.last - self.first) / (self.rows - 1) if self.rows > 1 else 0.0
        jitter = max(self.steps[1] - step, step - self.steps[0]) / step if step else math.nan
        minimum, maximum = (float(np.nanmin(low)), float(np.nanmax(high))) if there else (None, None)
        return Outline(
            self.rows, self.missing, minimum, maximum, self.first, self.last, self.rises, step, jitter, low, high,
            self.length,
        )  # fmt: skip
