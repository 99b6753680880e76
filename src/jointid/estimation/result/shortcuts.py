"""Shortcuts from an estimate to what is made of it: JSON, a data frame, figures, a report.

The one place of its layer that looks up, to the rooms that read estimates; each import waits for its call, and the
contract of the layers names them (pyproject.toml).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from jointid.common.extras import extra

if TYPE_CHECKING:
    from matplotlib.figure import Figure
    from pandas import DataFrame

    from jointid.estimation.result.estimate import Estimate
    from jointid.output.report.report import Report
    from jointid.records.record import Record

__all__ = ["Plots", "Report", "report", "save", "to_dataframe", "to_dict"]


@dataclass(frozen=True, slots=True, eq=False)
class Plots:
    """The figures of an estimate, of matplotlib: ``figure.savefig(path)`` writes one."""

    estimate: Estimate

    def torque(self) -> Figure:
        """Return measured, simulated and error torque over time."""
        from jointid.output.figures.figures import torque_figure

        return torque_figure(self.estimate)

    def residual(self, record: Record) -> Figure:
        """Return the torque error against velocity and position, and its autocorrelation.

        Args:
            record: that it was identified from, or another one of the joint; an estimate keeps no motion.
        """
        from jointid.diagnostics.validation import validate
        from jointid.output.figures.figures import residual_figure

        return residual_figure(validate(self.estimate, record))


def to_dict(estimate: Estimate) -> dict[str, Any]:
    """Return the JSON document of an estimate."""
    from jointid.output.json import to_dict

    return to_dict(estimate)


def save(estimate: Estimate, path: str | Path) -> Path:
    """Write the JSON document of an estimate, and return its path."""
    from jointid.output.json import write

    write(to_dict(estimate), path)
    return Path(path)


def report(estimate: Estimate, record: Record, *, name: str = "", profiles: Sequence[str] | None = None) -> Report:
    """Return the report of an estimate."""
    from jointid.output.report.report import report_estimate

    return report_estimate(estimate, record, name=name, profiles=profiles)


def to_dataframe(estimate: Estimate) -> DataFrame:
    """Return the parameters as a data frame, a row each."""
    pandas = extra("pandas", "dataframe", "A data frame")
    rows = {
        p.name: {
            "symbol": p.symbol,
            "value": p.value,
            "stderr": p.stderr,
            "lower": None if p.interval is None else p.interval[0],
            "upper": None if p.interval is None else p.interval[1],
            "unit": p.unit,
            "free": p.free,
            "identifiable": p.identifiable,
        }
        for p in estimate.params
    }
    frame: DataFrame = pandas.DataFrame.from_dict(rows, orient="index").rename_axis("parameter")
    return frame.astype(dict.fromkeys(("value", "stderr", "lower", "upper"), float))
