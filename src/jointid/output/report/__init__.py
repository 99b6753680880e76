"""The report of an identification: one page, the same as Markdown, its figures, and what it takes to do it again."""

from __future__ import annotations

import contextlib
import hashlib
import math
import re
import shlex
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from jointid import Drive, Record, __version__
from jointid.common.charts import Chart
from jointid.common.document import Document, dumps
from jointid.common.errors import JointidError, RecordError
from jointid.common.messages import Progress, silent
from jointid.common.typography import typeset_block
from jointid.diagnostics.report_data import ReportData, collect_report_data
from jointid.diagnostics.validation import Validation
from jointid.estimation.result.estimate import Estimate
from jointid.models.controllers.drive_numbers import DriveNumber
from jointid.output.figures.charts import report_charts
from jointid.output.json import plain
from jointid.output.json.documents import REPORT_SCHEMA
from jointid.output.report.pages import Pages
from jointid.output.report.sections import report_blocks
from jointid.output.report.summary import report_title
from jointid.planning.design import Design
from jointid.tuning.tuned import Tuned

_TUNING = (
    "The joint's response, the loop cut open at the torque, and its Nyquist plot; the bands are the estimate's "
    "interval, the circle about -1 the distance that was asked."
)
_TEST = (
    "What is to be played, the torque that is predicted, and its spectrum beside the modes of the joint as it was "
    "identified."
)
_CREATED = re.compile(rb"Created on: \w{3} (\w{3} +\d+ \d\d:\d\d:\d\d \d{4})")  # of the header of a .mat file
_BLOCK = 1 << 20  # bytes that are read at once


@dataclass(frozen=True, slots=True)
class Repetition:
    """Version, files and command that reproduce a report.

    Attributes:
        version: of this program.
        record_name: file of the record; empty for one that came from no file, as the next ones.
        record_sha256: of that file.
        date: of the record, as year-month-day: that in a .mat file's header, else when the file was last written (UTC).
        joint_name: file of the joint.
        joint_file: its text.
        command: that writes the report again.
    """

    version: str = __version__
    record_name: str = ""
    record_sha256: str = ""
    date: str = ""
    joint_name: str = ""
    joint_file: str = ""
    command: str = ""

    @property
    def facts(self) -> tuple[tuple[str, str], ...]:
        """The names and hashes that are known."""
        found = [
            ("jointid", self.version),
            ("Record", self.record_name),
            ("Its date", self.date),
            ("Its SHA-256", self.record_sha256),
        ]
        return tuple((name, value) for name, value in found if value)


def repetition(
    joint: Path,
    record: Path,
    options: Mapping[str, object],
    changes: Iterable[str] = (),
    html: str = "report.html",
) -> Repetition:
    """Return what it takes to repeat a report: files by their names, not by where they lie on this machine.

    Of the command's options None leaves one away; `changes` are keys of the joint file, as ``method.frequency=30``.

    Raises:
        RecordError: a file cannot be read.
    """
    words = ["jointid", "report", joint.name, "--record", record.name]
    for name, value in options.items():
        if value is not None:
            words += [f"--{name.replace('_', '-')}", str(value)]
    for change in changes:
        words += ["--set", change]
    try:
        text = joint.read_text(encoding="utf-8")
        digest = hashlib.sha256()
        date = _find_date(record)
        with record.open("rb") as file:
            while block := file.read(_BLOCK):
                digest.update(block)
    except OSError as error:
        why = (error.strerror or type(error).__name__).lower()
        raise RecordError(f"{error.filename} cannot be opened ({why}); check the path.") from None
    return Repetition(
        record_name=record.name,
        record_sha256=digest.hexdigest(),
        date=date,
        joint_name=joint.name,
        joint_file=text,
        command=shlex.join([*words, "--html", html]),
    )


def _find_date(record: Path) -> str:
    """Return the date of a record's file; a copy that keeps no times still has that of its header, where it has one."""
    with record.open("rb") as file:
        created = _CREATED.search(file.read(128))
    if created is not None:
        with contextlib.suppress(ValueError):
            return datetime.strptime(created[1].decode("ascii"), "%b %d %H:%M:%S %Y").date().isoformat()
    return datetime.fromtimestamp(record.stat().st_mtime, UTC).date().isoformat()


@dataclass(frozen=True, slots=True, eq=False)
class Report(Pages):
    """An estimate, told.

    Attributes:
        dossier: what is told; made by `of`.
        name: of the joint; that of the record when empty.
        repetition: what it takes to do it again.
        tuned: what to set in the drive; None where that was not asked for.
        design: the next test; likewise.
    """

    dossier: ReportData
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
        progress: Progress = silent,
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
            >>> estimate = ji.identify(record, axis.loop, ji.FlexibleDIDIM(frequency=30.0))
            >>> told = ji.Report.of(estimate, record, profiles=["stiffness"])
            >>> "## Checks" in told.markdown()
            True
        """
        found = collect_report_data(estimate, record, checks, profiles=profiles, progress=progress)
        return cls(found, name, repetition or Repetition(), tuned)

    @property
    def estimate(self) -> Estimate:
        """The estimate, with the verdict on its loop."""
        return self.dossier.estimate

    @property
    def charts(self) -> dict[str, Chart]:
        """Its figures by name."""
        drawn = report_charts(self.dossier)
        if self.tuned is not None:
            drawn["tuning"] = replace(self.tuned.chart(), caption=_TUNING)
        if self.design is not None:
            drawn["test"] = replace(self.design.chart(), caption=_TEST)
        return drawn

    def __repr__(self) -> str:
        return f"Report({report_title(self.estimate, self.name, self.repetition.date)!r})"

    def _repr_html_(self) -> str:
        """Return the answer and the parameters, as a notebook shows them; `save` writes the whole."""
        return self.estimate._repr_html_()

    def answer(self) -> str:
        """Return the JSON that the page carries along."""
        given, repeated = self.dossier, self.repetition
        return dumps(
            plain(
                {
                    "schema": REPORT_SCHEMA,
                    "version": repeated.version,
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
                    "record_file": repeated.record_name or None,
                    "record_date": repeated.date or None,
                    "record_file_sha256": repeated.record_sha256 or None,
                    "joint_file_name": repeated.joint_name or None,
                    "joint_file": repeated.joint_file or None,
                    "command": repeated.command or None,
                }
            )
        )

    def _document(self, *, interactive: bool) -> Document:
        told = report_blocks(
            self.dossier, self.charts, self.repetition, self.tuned, self.design, interactive=interactive
        )
        title = report_title(self.estimate, self.name, self.repetition.date)
        return Document(title, tuple(map(typeset_block, told)), self.answer() if interactive else "")


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
