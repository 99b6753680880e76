"""Warnings on the record of an estimate: what the log did to it, and other axes that moved."""

from __future__ import annotations

import numpy as np

from jointid.common.arrays import FloatArray
from jointid.estimation.result.parts import EstimateParts
from jointid.records.checks import find_record_warnings
from jointid.records.record import Record
from jointid.records.signals.filtering import differentiate_twice, lowpass
from jointid.uncertainty.residual_tests import coupling

_FEWEST = 4  # rows to a column of the regression


def record_warnings(record: Record, estimate: EstimateParts) -> tuple[str, ...]:
    """Return warnings on the record of an estimate, one sentence each."""
    return (*find_record_warnings(record, estimate.data.channels), *coupling_warnings(record, estimate))


def coupling_warnings(record: Record, estimate: EstimateParts) -> tuple[str, ...]:
    """Return that other axes moved too, and how much of what the model leaves follows them; nothing without any.

    Inertia shared with another axis shows as its acceleration, gravity as its position. What an axis of few harmonics
    explains by chance is much, so it stands beside. A joint's own columns have taken their part already: a share that
    is small, or no more than by chance, does not say that there is no coupling.
    """
    if not record.other_axes:
        return ()
    said = (
        f"other axes moved too ({', '.join(record.other_axes)}), and their coupling (inertia, Coriolis, gravity) is "
        "not in the model of a single joint: the parameters are those of this motion and these poses"
    )
    motion = None if estimate.fit.compared == "position" else _residual_and_motion(record, estimate)
    if motion is None:
        return (said,)
    found = coupling(*motion)
    share = f"{100 * found.explained:.0f} % of what it leaves follows their accelerations and positions"
    chance = f"up to {100 * found.by_chance:.0f} % would by chance"
    return (f"{said}; {share}, {chance}{'' if found.seen else ', so this record cannot tell how much is theirs'}",)


def _residual_and_motion(record: Record, estimate: EstimateParts) -> tuple[FloatArray, FloatArray] | None:
    """Return the residual, (rows,), and the motion of other axes, (rows, columns); None of too few rows."""
    filtering, T = estimate.settings.filtering, estimate.data.sample_time
    residual = estimate.fit.measured - estimate.fit.predicted
    at = np.arange(residual.size) * T
    cutoff = filtering.position_cutoff
    assert cutoff is not None
    columns = []
    for channel in record.other_axes.values():
        position = lowpass(np.interp(at, channel.time, channel.values), cutoff, T)
        columns += [differentiate_twice(position, T)[1], position]
    first, last = estimate.fit.borders
    inside = slice(first, residual.size - last)
    both = np.column_stack([residual, *columns])[inside]
    rows = filtering.decimate(both, T)
    return (rows[:, 0], rows[:, 1:]) if len(rows) > _FEWEST * len(columns) else None
