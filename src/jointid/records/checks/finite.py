"""Check that numbers are finite: columns that end early, and gaps."""

from __future__ import annotations

import numpy as np

from jointid.common.arrays import FloatArray


def finite_faults(name: str, values: FloatArray, time: FloatArray | None = None) -> list[str]:
    """Return the faults of raw values, shape (samples,), that are not finite: an early end, and gaps.

    Args:
        name: what the sentences call the values.
        values: the values, before they become a channel.
        time: instants of the samples [s], shape (samples,), if they are known.
    """
    bad = np.flatnonzero(~np.isfinite(values))
    if bad.size == 0:
        return []
    if bad.size == values.size:
        return [f"{name} has no finite number in its {values.size} samples; name another column."]
    faults = []
    end = int(np.flatnonzero(~np.isnan(values))[-1]) + 1
    if end < values.size:
        faults.append(
            f"{name} ends early: after {end} of {values.size} samples it is empty (NaN); cut all columns to "
            "one length, or give the channels of another rate their own sample_time."
        )
    bad = bad[bad < end]
    if bad.size:
        first = int(bad[0])
        faults.append(
            f"{name} has {format_count(bad.size, 'sample')} without a finite number, the first {values[first]} at "
            f"sample {first}{format_instant(time, first)}; mend them, or cut the record there."
        )
    return faults


def format_instant(time: FloatArray | None, index: int) -> str:
    """Return the instant of a sample, in brackets; "" where it is not known."""
    return "" if time is None else f" (t = {time[index]:g} s)"


def format_count(number: int, noun: str, plural: str = "") -> str:
    """Return a number of things in words."""
    return f"{number} {noun if number == 1 else plural or f'{noun}s'}"
