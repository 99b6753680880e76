"""`jointid report`: a joint file and a record in, a page out."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

from cyclopts import Parameter

from jointid.apps.cli.options import Changes
from jointid.estimation.methods.registry import MethodName


def report(
    joint: Path,
    /,
    *,
    record: Path | None = None,
    changes: Changes = (),
    html: Path | None = None,
    markdown: Path | None = None,
    figures: Path | None = None,
    method: MethodName | None = None,
    filtering: Literal["default", "published", "as-printed"] | None = None,
    friction: str | None = None,
    no_profiles: Annotated[bool, Parameter(negative=())] = False,
    json: Path | None = None,
    quiet: Annotated[bool, Parameter(name=["--quiet", "-q"], negative=())] = False,
) -> None:
    """Identify a joint from a record, and report it as one page: result, verdicts, figures, and how to repeat it.

    Args:
        joint: the joint file (TOML).
        record: the record, instead of the one the joint file names.
        changes: a key of the joint file and its value, as method.frequency=30; may be given several times.
        html: the page, one file that opens without a network; report.html where nothing else is asked for.
        markdown: folder for the same as Markdown, report.md, and its figures as SVG.
        figures: folder for the figures as PNG and SVG, for a paper.
        method: as for identify.
        filtering: as for identify.
        friction: as for identify.
        no_profiles: do not follow the criterion along every parameter, which takes a few seconds.
        json: also write the estimate as JSON to this file, as identify does.
        quiet: say nothing of the progress.
    """
    from jointid.apps.cli.console import check_outputs, progress, ready, show
    from jointid.config import load
    from jointid.output.report.page import require_extra
    from jointid.output.report.report import report_file, require_page
    from jointid.output.report.reproducibility import repetition

    page = html if html or markdown or figures else Path("report.html")
    check_outputs(None, page, json)
    if page is not None:
        require_page(page)
        require_extra(plots=True)
    listener = progress(quiet)
    file = load(joint, changes).override(method=method, filtering=filtering, friction=friction)
    source = Path(file.record_path(record))
    options = {"method": method, "filtering": filtering, "friction": friction}
    again = repetition(joint, source, options, "report.html" if page is None else page.name)
    ready(listener)
    told = report_file(file, source, repetition=again, profiles=() if no_profiles else None, progress=listener)
    written = [] if page is None else [told.save(page)]
    written += [] if markdown is None else [told.save_markdown(markdown)[0]]
    written += [] if figures is None else [*told.save_figures(figures)]
    if json is not None:
        from jointid.output import json as answers

        answers.write(answers.to_dict(told.estimate), json)
        written.append(json)
    show(told.estimate)
    show("\nWritten: " + ", ".join(map(str, written)))
