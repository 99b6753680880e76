"""Compare the stamps of a clock with a uniform one: jumps and jitter as faults, or as numbers."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from jointid.common.arrays import FloatArray
from jointid.records.checks.finite import finite_faults, format_count, format_instant

CLOCK_TOLERANCE = 0.05
"""Largest jitter of a time stamp step, as a share of the sample time.

A twentieth of a sample is well below the half sample by which a held and an averaged torque differ, and well
above the jitter of good loggers (0.004 % in EMPS) and of stamps rounded to a microsecond at 10 kHz (1 %).
"""

JUMP = 0.5
"""A step this far from the sample time, as a share of it, is a jump: samples are missing or doubled."""

GAP = 1.75
"""From so many sample times on a step leaves out samples: two stamps 30 % early and late are 1.6 apart."""


@dataclass(frozen=True, slots=True)
class Irregularity:
    """Deviation of time stamps from a uniform clock: the straight line of least squares through them.

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
            told.append(f"{format_count(self.gaps, 'gap')} of up to {left_out}")
        told += [format_count(self.repeats, "repeated stamp")] if self.repeats else []
        told += [format_count(self.backward, "step back", "steps back")] if self.backward else []
        return ", ".join(told)


@dataclass(frozen=True, slots=True)
class Resampled:
    """Resampling that a record went through.

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


def measure_irregularity(stamps: FloatArray) -> Irregularity:
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


@np.errstate(over="ignore", invalid="ignore")
def clock_faults(stamps: FloatArray, tolerance: float | None = CLOCK_TOLERANCE, name: str = "The time") -> list[str]:
    """Return the faults of a clock: stamps that do not run forward, jumps, and jitter beyond a tolerance.

    The sample time is the median step. A step that is more than half a sample time off is a jump (samples
    left out, a repeated or a backward stamp); what is less is jitter, judged by its largest value as a share
    of the sample time.

    Args:
        stamps: time stamps [s], shape (samples,).
        tolerance: largest jitter, as a share of the sample time; None for stamps that are resampled, which may jump.
        name: what the sentences call the clock.
    """
    if stamps.size < 2:
        return [f"{name} has a single stamp, which tells no sample time; give sample_time."]
    faults = finite_faults(name, stamps)
    if faults:
        return faults
    steps = np.diff(stamps)
    sample_time = float(np.median(steps))
    if sample_time <= 0:
        return [
            f"{name} does not run forward (its median step is {sample_time:g} s); name another time "
            "column, or give sample_time without time."
        ]
    if tolerance is None:
        return []
    error = np.abs(steps / sample_time - 1)
    jumped = error > max(JUMP, tolerance)
    if jumped.any():
        first = int(np.argmax(jumped))
        faults.append(
            f"{name} jumps {format_count(int(jumped.sum()), 'time')}: after sample {first}"
            f"{format_instant(stamps, first)} it {_jump(float(steps[first]), sample_time)}; cut the record there, or "
            "give sample_time without time if only the stamps are wrong."
        )
    jitter = np.where(jumped, 0.0, error)
    if jitter.max() > tolerance:
        first = int(np.argmax(jitter > tolerance))
        faults.append(
            f"{name} jitters by up to {jitter.max():.1%} of the sample time of {sample_time:g} s "
            f"({np.sqrt(np.mean(jitter**2)):.1%} rms), first beyond {tolerance:.1%} after sample {first}"
            f"{format_instant(stamps, first)}; give resample = {{ sample_time, method }}, or sample_time without time "
            "if only the stamps jitter."
        )
    return faults


def _jump(step: float, sample_time: float) -> str:
    """Return what a step of the time that is no jitter does."""
    if step == 0:
        return "repeats its stamp"
    lost = round(step / sample_time) - 1
    late = f"leaves out {format_count(lost, 'sample')}" if lost > 0 else "steps early"
    return f"{'runs backward' if step < 0 else late} (a step of {step:g} s, expected {sample_time:g} s)"
