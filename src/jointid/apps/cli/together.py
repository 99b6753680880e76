"""`jointid together`: a joint file and several records in, one table out."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from cyclopts import Parameter


def together(
    joint: Path,
    /,
    *,
    record: Annotated[list[Path] | None, Parameter(negative=())] = None,
    json: Path | None = None,
    quiet: Annotated[bool, Parameter(name=["--quiet", "-q"], negative=())] = False,
) -> None:
    """Identify a joint from several records in one fit, and say whether they agree.

    Args:
        joint: the joint file (TOML), with a [[records]] table for each record.
        record: a record, given as often as there are records: instead of those the joint file lists, in their order.
        json: also write the answer as JSON to this file.
        quiet: say nothing of the progress.
    """
    from jointid.apps.cli.console import check_outputs, progress, ready, show_result
    from jointid.common.errors import MethodError
    from jointid.config import load
    from jointid.estimation.identify import identify
    from jointid.estimation.several_records.settings import SeveralRecords

    listener = progress(quiet)
    check_outputs(None, json)
    file = load(joint)
    each = file.each(record or ())
    loops = [one.loop for one in each if one.loop is not None]
    if len(loops) < len(each):
        raise MethodError(
            "Several records are identified by simulating their loop; add [controller] to the joint file."
        )
    logged = [one.record() for one in each]
    ready(listener)
    several = SeveralRecords(
        added_inertia=[more for one in each for more in one.added_inertias],
        own=[run.own for one in each for run in one.runs],
        free=file.free,
        weighting=file.weighting,
    )
    estimate = identify(
        logged,
        loops,
        file.method,
        several=several,
        filtering=file.filtering,
        parameters=file.parameters,
        progress=listener,
    )
    show_result(estimate)
    if json is not None:
        from jointid.output import json as answers

        answers.write(answers.estimate_answer(estimate), json)
