"""Report of an identification on one page, with data to repeat it."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, cast

from numpy.linalg import LinAlgError

from jointid import Record
from jointid.common.document import Document
from jointid.common.errors import JointidError, MethodError
from jointid.common.files import write_whole
from jointid.common.messages import Progress, ignore_progress
from jointid.diagnostics.analysis import FrequencyResponse, Profiles, compute_response, intervals
from jointid.diagnostics.diagnosis import Diagnosis, diagnose_robot
from jointid.diagnostics.validation import Validation, validate
from jointid.estimation.result.estimate import IN_WINDOWS, Estimate
from jointid.estimation.result.fields import dumps, plain
from jointid.estimation.result.verdict import Trust
from jointid.models.controllers import Controller
from jointid.output.figures import require_format
from jointid.output.json import REPORT_SCHEMA, to_dict
from jointid.output.report.sections import PAGES, Repetition, draw_figures, page, repetition, report_blocks
from jointid.records.record import Channel, takes_record
from jointid.tuning.tune import Tuned

if TYPE_CHECKING:
    from matplotlib.figure import Figure

__all__ = ["Repetition", "Report", "repetition"]


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class Report:
    """Report of a joint or a robot: figures and text.

    Attributes:
        estimate: reported.
        diagnosis: of loop, log and residual; None without one.
        checks: of the same estimate on other records.
        name: of the joint; that of the record when empty.
        repetition: data to repeat it.
        tuned: settings of the drive; None if not requested.
        channels: of the record of a joint, by name.
        validation: the direct test of a joint; None without one.
        response: frequency response of the joint; None without one.
        profiles: of single quantities.
        absent: reason why a part is missing, by its name, in a sentence.
    """

    estimate: Estimate
    diagnosis: Diagnosis | None
    checks: tuple[Validation, ...] = ()
    name: str = ""
    repetition: Repetition = field(default_factory=Repetition)
    tuned: Tuned | None = None
    channels: Mapping[str, Channel] = field(default_factory=dict)
    validation: Validation | None = None
    response: FrequencyResponse | None = None
    profiles: Profiles = ()
    absent: Mapping[str, str] = field(default_factory=dict)

    @classmethod
    @takes_record
    def of(
        cls,
        estimate: Estimate,
        record: Record | Sequence[Record],
        checks: Sequence[Validation] = (),
        *,
        name: str = "",
        profiles: Sequence[str] | None = None,
        tuning: bool = False,
        controllers: Sequence[Controller | None] = (),
        repetition: Repetition | None = None,
        progress: Progress = ignore_progress,
    ) -> Report:
        """Report an estimate: result, trust and data to repeat it.

        Args:
            estimate: by any method.
            record: that it was identified from; of a robot the record of each joint.
            checks: validations of it on other records, from `validate`.
            name: of the joint, for the title.
            profiles: quantities whose criterion is followed, as `intervals` takes them; none when empty. When None,
                the stiffness and the compliance of a flexible joint. Of DIDIM only.
            tuning: whether to add margins and gains by `tune`, of a controller with a limit.
            controllers: of each joint of a robot, see `diagnose`.
            repetition: data to repeat it, if the files are known.
            progress: receives each step.

        Raises:
            MethodError: profiles are given for a robot, or the record was identified in windows.

        Example:
            >>> import jointid as ji
            >>> axis = ji.twin(noise="white")
            >>> record = axis.record.without("motor_position", "load_position")
            >>> estimate = ji.identify(record, axis.loop, ji.DIDIM(frequency=30.0))
            >>> report = ji.Report.of(estimate, record, profiles=["stiffness"])
            >>> "Appendix" in report.to_document().text()
            True
        """
        again = repetition or Repetition()
        if estimate.data.windows is not None:
            raise MethodError(IN_WINDOWS)
        if not isinstance(record, Record):
            if profiles:
                raise MethodError("The report of a robot has no profiles; leave them out.")
            return cls(estimate, diagnose_robot(estimate, record, controllers), tuple(checks), name, again)
        flexible = estimate.settings.joint.model == "flexible" and estimate["stiffness"].free
        asked = (["stiffness", "compliance"] if flexible else []) if profiles is None else profiles
        parts: dict[str, Callable[[], Any]] = {
            "validation": lambda: validate(estimate, record),
            "response": lambda: compute_response(estimate),
            "profiles": lambda: intervals(estimate, record, asked),
        }
        if tuning and math.isfinite(getattr(getattr(estimate.settings.loop, "controller", None), "limit", math.inf)):
            parts["tuned"] = lambda: _tune(estimate)
        found, absent, checked = dict[str, Any](), dict[str, str](), cast("Diagnosis | None", estimate.diagnosis)
        for part, compute in parts.items():
            progress(f"collecting the report: {part}")
            try:
                found[part] = compute()
            except (JointidError, LinAlgError) as error:  # a refused parameter, say: the report is written all the same
                absent["tuning" if part == "tuned" else part] = str(error)
        channels = dict(record.items())
        return cls(estimate, checked, tuple(checks), name, again, channels=channels, absent=absent, **found)

    @property
    def figures(self) -> dict[str, Figure]:
        """Its figures by name, of matplotlib."""
        return draw_figures(self)

    @property
    def title(self) -> str:
        """Axis, date of its record if known, and version of this program."""
        robot, again = self.estimate.robot, self.repetition
        own = self.estimate.data.record if robot is None else robot.model.name
        return ", ".join(filter(None, (self.name or own, again.record_date, f"jointid {again.version}")))

    def answer(self) -> str:
        """Return the JSON that the page carries along."""
        contents: dict[str, Any] = {
            "schema": REPORT_SCHEMA,
            "estimate": to_dict(self.estimate),
            **{name: getattr(self, name) for name in ("diagnosis", "validation", "checks", "profiles", "absent")},
            "frequencies": {} if self.response is None else self.response.modes,
            "tuning": self.tuned,
        }
        return dumps(contents | plain(self.repetition))

    def to_document(self) -> Document:
        """The page as a document, with its JSON."""
        return Document(self.title, tuple(report_blocks(self, self.figures)), self.answer())

    def html(self) -> str:
        """Return one self-contained HTML page."""
        return page(self.to_document())

    def save(self, path: str | Path) -> Path:
        """Write the page.

        Args:
            path: of the file, which ends in .html.

        Raises:
            RecordError: another suffix, or the file cannot be written.
        """
        path = Path(path)
        require_format(path, PAGES)
        write_whole(path, self.html())
        return path


def _tune(estimate: Estimate) -> Tuned:
    """Tune a loop by values that can be relied on."""
    from jointid import tune

    if estimate.answer.trust.code == Trust.NOT_YET:
        raise MethodError("Margins and gains need values that can be relied on; correct what the result names.")
    return tune(estimate)
