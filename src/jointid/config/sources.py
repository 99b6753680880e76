"""The records of a joint file: the file of the one that is identified, and those that are identified together."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from jointid.common.settings import declare, documented, setting
from jointid.common.units import units_of
from jointid.records.clock import CLOCK_TOLERANCE
from jointid.records.formats import format_of
from jointid.records.resampling import Resampling


@documented
@dataclass(frozen=True, slots=True)
class Source:
    """The file of the record, and how it is read; see `jointid.records.reading`."""

    file: str | None = setting(None, "path of the record, from the joint file's folder", accept=format_of)
    time: str | None = setting(
        None, "name of the time column; without it, and without a sample time, the column called t or time"
    )
    time_unit: str | None = setting(
        None, "unit of the time column; without it the one in its name, as in Time [ms], or s", choices=units_of("time")
    )
    sample_time: float | None = setting(
        None, "time between samples, where there is no time column; beside one the two must agree", unit="s", above=0
    )
    clock_tolerance: float = setting(
        CLOCK_TOLERANCE, "largest jitter of the time stamps, as a share of the sample time", at_least=0
    )
    options: Mapping[str, Any] = field(default_factory=dict)  # of the format's reader
    resample: Resampling | None = setting(
        None,
        "to which uniform clock all channels are brought, and how; without it a clock that is not uniform is refused",
    )


@documented
@dataclass(frozen=True, slots=True)
class Run:
    """One of several records that are identified together."""

    file: str = field(metadata=declare("path of the record, from the joint file's folder", accept=format_of))
    added_inertia: float = setting(
        0.0,
        "what is known to have been added to the load, as it is there, beyond what is shared",
        unit="kg or kg m2",
        at_least=0,
    )
    own: tuple[str, ...] = setting(
        (),
        "names of parameters of this record's own, which the others do not share; the motor's state at the first "
        "sample always is",
    )
    controller: Mapping[str, float] = field(
        default_factory=dict,
        metadata=declare("numbers of the controller that were others in this record, by the keys of [controller]"),
    )
