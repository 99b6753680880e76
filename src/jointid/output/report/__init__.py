"""The report of an identification: one page, the same as Markdown, its figures, and what it takes to do it again."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

from jointid import Drive, Record
from jointid.common.charts import Chart
from jointid.common.document import Block
from jointid.common.errors import JointidError
from jointid.common.messages import Progress, ignore_progress
from jointid.diagnostics.report_data import ReportData, collect_report_data
from jointid.diagnostics.validation import Validation
from jointid.estimation.result.estimate import Estimate
from jointid.models.controllers.drive_numbers import DriveNumber
from jointid.output.figures.charts import report_charts
from jointid.output.json import plain
from jointid.output.json.documents import REPORT_SCHEMA
from jointid.output.report.pages import Pages, Repetition, repetition
from jointid.output.report.sections import report_blocks
from jointid.output.report.summary import report_title
from jointid.planning.joint_design import Design
from jointid.tuning.tuned import Tuned

__all__ = ["Repetition", "Report", "repetition", "tune_to_limit"]

_TUNING = (
    "The joint's response, the loop cut open at the torque, and its Nyquist plot; the bands are the estimate's "
    "interval, the circle about -1 the distance that was asked."
)
_TEST = (
    "What is to be played, the torque that is predicted, and its spectrum beside the modes of the joint as it was "
    "identified."
)


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class Report(Pages):
    """An estimate, told.

    Attributes:
        data: the results to present; `of` collects them.
        name: of the joint; that of the record when empty.
        repetition: what it takes to do it again.
        tuned: what to set in the drive; None where that was not asked for.
        design: the next test; likewise.
    """

    data: ReportData
    name: str = ""
    repetition: Repetition = field(default_factory=Repetition)
    tuned: Tuned | None = None
    design: Design | None = None

    @classmethod
    def of(
        cls,
        estimate: Estimate,
        record: Record,
        checks: Sequence[Validation] = (),
        *,
        name: str = "",
        profiles: Sequence[str] | None = None,
        tuned: Tuned | None = None,
        repetition: Repetition | None = None,
        progress: Progress = ignore_progress,
    ) -> Report:
        """Report an estimate: what it says, how far it can be trusted, and what it takes to repeat it.

        Args:
            estimate: by any method.
            record: that it was identified from.
            checks: validations of it on other records, from `validate`.
            name: of the joint, for the title.
            profiles: quantities whose criterion is followed, as `intervals` takes them; none when empty. When None,
                every free parameter of the joint along which the criterion is no parabola, and its compliance. Of DIDIM
                only.
            tuned: margins and gains of the drive from `tune`, which then have a section.
            repetition: what it takes to do it again, where the files are known.
            progress: is told each step.

        Example:
            >>> import jointid as ji
            >>> axis = ji.twin(noise="white")
            >>> record = axis.record.without("motor_position", "load_position")
            >>> estimate = ji.identify(record, axis.loop, ji.DIDIM(frequency=30.0))
            >>> told = ji.Report.of(estimate, record, profiles=["stiffness"])
            >>> "## Checks" in told.markdown()
            True
        """
        found = collect_report_data(estimate, record, checks, profiles=profiles, progress=progress)
        return cls(found, name, repetition or Repetition(), tuned)

    @property
    def estimate(self) -> Estimate:
        """The estimate, with the verdict on its loop."""
        return self.data.estimate

    @property
    def charts(self) -> dict[str, Chart]:
        """Its figures by name."""
        drawn = report_charts(self.data)
        if self.tuned is not None:
            drawn["tuning"] = replace(self.tuned.chart(), caption=_TUNING)
        if self.design is not None:
            drawn["test"] = replace(self.design.chart(), caption=_TEST)
        return drawn

    @property
    def title(self) -> str:
        """The axis, and the date of its record if it is known."""
        return report_title(self.estimate, self.name, self.repetition.date)

    def _repr_html_(self) -> str:
        """Return the answer and the parameters, as a notebook shows them; `save` writes the whole."""
        return self.estimate._repr_html_()

    def _contents(self) -> dict[str, Any]:
        given = self.data
        return {
            "schema": REPORT_SCHEMA,
            "estimate": given.estimate,
            "validation": given.validation,
            "checks": given.checks,
            "loop": given.loop,
            "profiles": given.profiles,
            "frequencies": {} if given.response is None else given.response.modes,
            "revealing": given.stiffness_test,
            "parabolic": given.parabolic,
            "tuning": None if self.tuned is None else _without_responses(plain(self.tuned)),
            "design": self.design,
            "absent": given.absent,
        }

    def _blocks(self, *, interactive: bool) -> Iterable[Block]:
        return report_blocks(self.data, self.charts, self.repetition, self.tuned, self.design, interactive=interactive)


def tune_to_limit(estimate: Estimate, drive: Drive, shown: Iterable[DriveNumber] = ()) -> Tuned | str | None:
    """Return margins and gains of a loop whose limit is declared; why there are none, or None where none is asked."""
    from numpy.linalg import LinAlgError

    from jointid import tune

    loop = estimate.settings.loop
    if loop is None or not math.isfinite(getattr(loop.controller, "limit", math.inf)):
        return None
    try:
        return tune(estimate, drive=drive, shown=shown)
    except JointidError as error:  # a refused parameter, say: the report is written all the same
        return str(error)
    except LinAlgError as error:  # values beyond all bounds have no margins
        return f"they cannot be computed from these values ({error})."


def _without_responses(tuning: dict[str, Any]) -> dict[str, Any]:
    """Return a tuning as JSON without the loops' responses, which are half a megabyte of curves."""
    loops = {key: tuning[key] for key in ("present", "proposed") if tuning[key] is not None}
    shown = {key: {k: v for k, v in loop.items() if k != "response"} for key, loop in loops.items()}
    return tuning | shown
