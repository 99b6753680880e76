"""How far the stamps of a clock are from a uniform one, and what was done about it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

GAP = 1.75
"""From so many sample times on a step leaves out samples: two stamps 30 % early and late are 1.6 apart."""


@dataclass(frozen=True, slots=True)
class Irregularity:
    """How far time stamps are from a uniform clock, which is the straight line of least squares through them.

    Attributes:
        sample_time: of the uniform clock, s.
        largest, rms: deviation of the stamps from it, s.
        gaps: steps of `GAP` sample times and more; longest_gap: samples left out in the longest.
        repeats: stamps that are those before them again.
        backward: steps back.
    """

    sample_time: float
    largest: float
    rms: float
    gaps: int = 0
    longest_gap: int = 0
    repeats: int = 0
    backward: int = 0

    def __str__(self) -> str:
        """Return it in words."""
        told = [
            f"{1e3 * self.sample_time:.6g} ms, off by up to {self.largest / self.sample_time:.2g} samples "
            f"({self.rms / self.sample_time:.2g} rms)"
        ]
        if self.gaps:
            left_out = f"{self.longest_gap} sample{'' if self.longest_gap == 1 else 's'}"
            told.append(f"{_count(self.gaps, 'gap')} of up to {left_out}")
        told += [_count(self.repeats, "repeated stamp")] if self.repeats else []
        told += [_count(self.backward, "step back", "steps back")] if self.backward else []
        return ", ".join(told)


@dataclass(frozen=True, slots=True)
class Resampled:
    """That a record was resampled, and how.

    Attributes:
        sample_time: of the record, s.
        methods: by channel, "hold", "linear", "cubic", or "mean" of what was logged as an average.
        longest_gap: samples that might be missing in a row.
        clocks: by time column, what the stamps were.
        channels: by channel, its time column.
    """

    sample_time: float
    methods: Mapping[str, str]
    longest_gap: int
    clocks: Mapping[str, Irregularity]
    channels: Mapping[str, str]

    def __str__(self) -> str:
        """Return it in a sentence."""
        how = ", ".join(f"{name} {method}" for name, method in self.methods.items())
        logged = "; ".join(f'"{name}" {clock}' for name, clock in self.clocks.items())
        return f"to {1e3 * self.sample_time:g} ms ({how}); stamps of {logged}"


def irregularity(stamps: NDArray[np.float64]) -> Irregularity:
    """Return how far stamps [s], shape (samples,), two or more and finite, are from a uniform clock.

    A stamp that is repeated is no further sample, and one that runs backward is.
    """
    steps = np.diff(stamps)
    forward = steps[steps > 0]
    typical = float(np.median(forward)) if forward.size else 1.0
    skipped = np.where(steps >= GAP * typical, np.maximum(np.round(steps / typical), 1), steps != 0)
    number = np.concatenate([[0.0], np.cumsum(skipped)])
    centred, times = number - number.mean(), stamps - stamps.mean()
    period = float(centred @ times / (centred @ centred))
    off = times - period * centred
    return Irregularity(
        sample_time=period,
        largest=float(np.abs(off).max()),
        rms=float(np.sqrt(np.mean(off**2))),
        gaps=int(np.count_nonzero(skipped > 1)),
        longest_gap=int(skipped.max()) - 1,
        repeats=int(np.count_nonzero(steps == 0)),
        backward=int(np.count_nonzero(steps < 0)),
    )


def _count(number: int, noun: str, plural: str = "") -> str:
    return f"{number} {noun if number == 1 else plural or f'{noun}s'}"
