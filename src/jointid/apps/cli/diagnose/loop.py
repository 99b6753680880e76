"""`jointid diagnose loop`: the controller and the log, checked against the record."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from cyclopts import Parameter

from jointid.apps.cli.options import Changes


def loop(
    joint: Path,
    /,
    *,
    record: Path | None = None,
    changes: Changes = (),
    json: Path | None = None,
    quiet: Annotated[bool, Parameter(name=["--quiet", "-q"], negative=())] = False,
) -> None:
    """Identify a joint by didim, and test whether its controller and its log are as declared.

    Gains, delay, time stamps, the log's gain and an offset are freed one at a time and together.

    Args:
        joint: the joint file (TOML); its method is didim.
        record: the record, instead of the one the joint file names.
        changes: a key of the joint file and its value, as method.frequency=30; may be given several times.
        json: also write the answer as JSON to this file.
        quiet: say nothing of the progress.
    """
    from jointid import check_loop
    from jointid.apps.cli.console import check_outputs, identified, progress, show
    from jointid.config import load

    listener = progress(quiet)
    check_outputs(None, json)
    logged, estimate = identified(load(joint, changes).override(method="didim"), record, listener)
    check = check_loop(estimate, logged)
    show(check)
    if json is not None:
        from jointid.output import json as answers

        answers.write(answers.to_dict(check), json)
