"""`jointid diagnose methods`: every method that a record allows, side by side."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

from cyclopts import Parameter

from jointid.apps.cli.options import Changes


def methods(
    joint: Path,
    /,
    *,
    record: Path | None = None,
    changes: Changes = (),
    filtering: Literal["default", "published", "as-printed"] | None = None,
    json: Path | None = None,
    quiet: Annotated[bool, Parameter(name=["--quiet", "-q"], negative=())] = False,
) -> None:
    """Identify a joint by every method that the record and the joint file allow, and set the answers side by side.

    Args:
        joint: the joint file (TOML); of its method the settings of didim are used.
        record: the record, instead of the one the joint file names.
        changes: a key of the joint file and its value, as method.frequency=30; may be given several times.
        filtering: of every method, as for identify.
        json: also write the answer as JSON to this file.
        quiet: say nothing of the progress.
    """
    from jointid import DIDIM, FlexibleDIDIM
    from jointid import compare_methods as run
    from jointid.apps.cli.console import check_outputs, progress, ready, show
    from jointid.config import load

    listener = progress(quiet)
    check_outputs(None, json)
    file = load(joint, changes).override(filtering=filtering)
    logged = file.record(record)
    ready(listener)
    comparison = run(
        logged,
        file.loop or file.joint,
        filtering=file.filtering,
        parameters=file.parameters,
        didim=file.method if isinstance(file.method, DIDIM | FlexibleDIDIM) else None,
        progress=listener,
    )
    show(comparison)
    if json is not None:
        from jointid.output import json as answers

        answers.write(answers.to_dict(comparison), json)
