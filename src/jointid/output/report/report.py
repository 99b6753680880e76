"""The report of an identification: one page, the same as Markdown, and its figures."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

from jointid.common.document import Document
from jointid.common.errors import RecordError
from jointid.common.json_file import dumps
from jointid.common.progress import Progress, silent
from jointid.config import JointFile
from jointid.diagnostics.report_data import ReportData, collect_report_data
from jointid.diagnostics.validation import Validation
from jointid.estimation.result.estimate import Estimate
from jointid.output.figures.charts import Chart
from jointid.output.figures.matplotlib_backend import png, svg
from jointid.output.json import plain
from jointid.output.json.shapes import REPORT_SCHEMA
from jointid.output.report.page import page, write_files
from jointid.output.report.pictures import draw_charts
from jointid.output.report.reproducibility import Repetition
from jointid.output.report.sections import report_blocks, report_title
from jointid.records.record import Record


@dataclass(frozen=True, slots=True, eq=False)
class Report:
    """An estimate, told.

    Attributes:
        dossier: what is told; `dossier.estimate` is the estimate, with the verdict on its loop.
        name: of the joint; that of the record when empty.
        repetition: what it takes to do it again.
    """

    dossier: ReportData
    name: str = ""
    repetition: Repetition = field(default_factory=Repetition)

    @property
    def estimate(self) -> Estimate:
        """The estimate, with the verdict on its loop."""
        return self.dossier.estimate

    @property
    def charts(self) -> dict[str, Chart]:
        """Its figures by name."""
        return draw_charts(self.dossier)

    def html(self) -> str:
        """Return one self-contained HTML page.

        Raises:
            ExtraError: bokeh or jinja2 is not installed.
        """
        return page(self._document(interactive=True))

    def markdown(self) -> str:
        """Return the same as Markdown; its figures are SVG files beside it, which `save` writes."""
        return self._document(interactive=False).markdown()

    def save(self, path: str | Path) -> Path:
        """Write the page.

        Args:
            path: of the file, which ends in .html.

        Raises:
            RecordError: another suffix, or the file cannot be written.
            ExtraError: bokeh or jinja2 is not installed.
        """
        path = Path(path)
        require_page(path)
        content = self.html()
        try:
            path.write_text(content, encoding="utf-8", newline="\n")
        except OSError as error:
            raise RecordError(f"{path} cannot be written ({error.strerror}); choose another place.") from None
        return path

    def save_markdown(self, folder: str | Path) -> tuple[Path, ...]:
        """Write report.md and its figures into a folder, which is made; return what was written.

        Raises:
            RecordError: the folder or a file cannot be written.
        """
        document = self._document(interactive=False)
        return write_files(folder, {"report.md": document.markdown().encode()} | document.pictures)

    def save_figures(self, folder: str | Path) -> tuple[Path, ...]:
        """Write every figure as PNG and as SVG into a folder, which is made; return what was written.

        Raises:
            RecordError: the folder or a file cannot be written.
        """
        files: dict[str, bytes] = {}
        for name, chart in self.charts.items():
            files |= {f"{name}.png": png(chart), f"{name}.svg": svg(chart)}
        return write_files(folder, files)

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
                    "absent": given.absent,
                    "record_file": repeated.record_name or None,
                    "record_file_sha256": repeated.record_sha256 or None,
                    "joint_file_name": repeated.joint_name or None,
                    "joint_file": repeated.joint_file or None,
                    "command": repeated.command or None,
                }
            )
        )

    def _document(self, *, interactive: bool) -> Document:
        told = report_blocks(self.dossier, self.charts, self.repetition, interactive=interactive)
        return Document(report_title(self.estimate, self.name), told, self.answer() if interactive else "")


def report_estimate(
    estimate: Estimate,
    record: Record,
    checks: Sequence[Validation] = (),
    *,
    name: str = "",
    profiles: Sequence[str] | None = None,
    loop: bool = True,
    progress: Progress = silent,
) -> Report:
    """Report an estimate: what it says, how far it can be trusted, and what it takes to repeat it.

    Args:
        estimate: by any method.
        record: that it was identified from.
        checks: validations of it on other records, from `validate`.
        name: of the joint, for the title.
        profiles: quantities whose criterion is followed, as `intervals` takes them; every free parameter of the joint
            when None, none when empty. Of DIDIM only.
        loop: whether loop and log are checked; see `jointid.diagnostics.report_data.collect_report_data`.
        progress: is told each step.

    Example:
        >>> import jointid as ji
        >>> axis = ji.twin(noise="white")
        >>> record = axis.record.without("motor_position", "load_position")
        >>> estimate = ji.identify(record, axis.loop, ji.FlexibleDIDIM(frequency=30.0))
        >>> told = ji.report_estimate(estimate, record, profiles=["stiffness"])
        >>> "## Verdicts" in told.markdown()
        True

    It is not called `report`, which is the room it lives in.
    """
    return Report(collect_report_data(estimate, record, checks, profiles=profiles, loop=loop, progress=progress), name)


def report_file(
    file: JointFile,
    record: str | Path | None = None,
    *,
    repetition: Repetition | None = None,
    profiles: Sequence[str] | None = None,
    progress: Progress = silent,
) -> Report:
    """Identify the joint of a joint file from a record, and report it.

    Args:
        file: a loaded joint file.
        record: path of the record, instead of the one the file names.
        repetition: what it takes to do it again, where the files are known; see `repetition`.
        profiles: see `report_estimate`.
        progress: is told each step.

    Raises:
        JointidError: the record cannot be read, or the joint cannot be identified from it.
    """
    logged = file.record(record)
    estimate = file.identify(logged, progress)
    found = collect_report_data(estimate, logged, profiles=profiles, loop=file.tells_of_its_loop, progress=progress)
    return Report(found, file.name or "", repetition or Repetition())


def require_page(path: Path) -> None:
    """Raise a `RecordError` if a page cannot be saved under that name."""
    if path.suffix.lower() not in (".html", ".htm"):
        raise RecordError(f'A report is saved as .html; received "{path.name}": change its suffix.')
