"""How one record, or a long log, takes part in an estimate."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from jointid.common.arrays import FloatArray
from jointid.estimation.result.params import EstimatedParameter
from jointid.records.record import Resampled
from jointid.records.signals.filtering import Filtering
from jointid.simulation.closed_loop import Initial
from jointid.simulation.loop_input import ClosedLoop
from jointid.uncertainty.position_dependent_error import Repeatable


@dataclass(frozen=True, slots=True, eq=False)
class RecordFit:
    """One of several records: what it says by itself, and how well the common model reproduces it.

    Attributes:
        name: of the record; fingerprint: of its torque.
        loop: joint and controller it was logged under.
        channels: that were read.
        added_inertia: known, on the load, on top of what is shared.
        alone: estimated from this record by itself: all that is free in it, in the units of the answer, without
            the added inertia, so that records can be compared.
        values: every parameter of the joint as it is in this record, the added inertia included.
        initial: the motor's state at the first sample.
        level: the residual that remains of it by itself, rms over its degrees of freedom: its rows are weighted by
            the inverse.
        repeatable: what of the residual it leaves by itself repeats with the motion.
        sample_time, filtering, rows: of its torque; how it was filtered; how many rows it gave.
        measured, predicted: (samples,) raw torque, and that of the common model.
        resampled: how its samples were brought to a uniform clock, None where they were logged so.
        relative_error, filtered_error: norm of the error of the common model over that of the torque, raw with the
            borders left out, and filtered; alone_error: the filtered one of the record by itself.
    """

    name: str
    fingerprint: str
    loop: ClosedLoop
    channels: tuple[str, ...]
    added_inertia: float
    alone: tuple[EstimatedParameter, ...]
    values: Mapping[str, float]
    initial: Initial
    level: float
    repeatable: Repeatable
    sample_time: float
    filtering: Filtering
    rows: int
    measured: FloatArray
    predicted: FloatArray
    relative_error: float
    filtered_error: float
    alone_error: float
    resampled: Resampled | None = None


@dataclass(frozen=True, slots=True)
class Windows:
    """The windows in which a long log was identified.

    Attributes:
        count: that were fitted; still: in which nothing was asked of the axis, and which were left out.
        length: seconds of each. settling: seconds simulated before and after each window, and not fitted.
        duration: seconds from the first to the last fitted row.
    """

    count: int
    still: int
    length: float
    settling: float
    duration: float
