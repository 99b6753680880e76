"""Drift: whether the segments of a long log, each by itself, agree on one joint."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from jointid.estimation.several_records.heterogeneity import Agreement


@dataclass(frozen=True, slots=True, eq=False)
class Segment:
    """The estimate from one part of a long log by itself.

    Attributes:
        begin, end: seconds from the first sample of the record.
        windows: in it.
        values: of the free parameters, by name, but for those that it does not tell, as friction backwards in hours
            that only go forwards; std: their standard deviations.
        filtered_error: what the joint of the whole record leaves of its filtered torque; a ratio.
    """

    begin: float
    end: float
    windows: int
    values: Mapping[str, float]
    std: Mapping[str, float]
    filtered_error: float


@dataclass(frozen=True, slots=True)
class Trend:
    """The straight line through what the segments say of a parameter.

    Attributes:
        name: of the parameter. per_hour: its change, in its unit. std: of that.
    """

    name: str
    per_hour: float
    std: float


@dataclass(frozen=True, slots=True, eq=False)
class DriftTest:
    """The test whether the parameters stay the same from the beginning of a long log to its end.

    Attributes:
        segments: in the order of time; none where the record is too short for two.
        agreement: whether they agree; None without them.
        trends: of the parameters that two segments tell, in their order.
    """

    segments: tuple[Segment, ...]
    agreement: Agreement | None
    trends: tuple[Trend, ...]

    @property
    def names(self) -> tuple[str, ...]:
        """Of the parameters that change by more than their intervals allow."""
        return () if self.agreement is None else tuple(p.name for p in self.agreement.parameters if p.differs)
