"""`jointid compare`: what changed between two estimates of the same joint."""

from __future__ import annotations

from pathlib import Path


def compare(
    before: Path,
    after: Path,
    /,
    *,
    level: float = 0.05,
    json: Path | None = None,
) -> None:
    """Say what changed between two estimates of the same joint, and whether it is more than their errors.

    Args:
        before: the first (A): what identify --json wrote, or the page of a report.
        after: the second (B), likewise.
        level: chance that anything is called changed where nothing is, for all quantities together.
        json: also write the answer as JSON to this file.
    """
    from jointid import compare_estimates as run
    from jointid.apps.cli.console import check_outputs, show
    from jointid.output import json as answers

    check_outputs(None, json)
    found = run(answers.read_report(before), answers.read_report(after), level)
    show(found)
    if json is not None:
        answers.write(answers.to_dict(found), json)
