"""`jointid long`: a joint file and a record too long for memory in, one table and its drift out."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from cyclopts import Parameter


def long(
    joint: Path,
    /,
    *,
    record: Path | None = None,
    window: float = 60.0,
    settling: float | None = None,
    json: Path | None = None,
    quiet: Annotated[bool, Parameter(name=["--quiet", "-q"], negative=())] = False,
) -> None:
    """Identify a joint from hours of its log, in bounded memory, and say whether it drifts.

    Args:
        joint: the joint file (TOML); its method is didim.
        record: the record, of a format that is read in pieces, instead of the one the joint file names.
        window: seconds that count in a window.
        settling: seconds before and after each window that are simulated and do not count; without it measured.
        json: also write the answer as JSON to this file.
        quiet: say nothing of the progress.
    """
    from jointid.apps.cli.console import check_outputs, progress, ready, show_result
    from jointid.common.errors import MethodError
    from jointid.config import load
    from jointid.estimation.identify import identify
    from jointid.estimation.streaming.settings import Windowing

    listener = progress(quiet)
    check_outputs(None, json)
    file = load(joint)
    if file.loop is None:
        raise MethodError("A long record is identified by simulating its loop; add [controller] to the joint file.")
    log = file.log(record)
    ready(listener)
    estimate = identify(
        log,
        file.loop,
        file.method,
        windows=Windowing(window, settling),
        filtering=file.filtering,
        parameters=file.parameters,
        progress=listener,
    )
    show_result(estimate)
    if json is not None:
        from jointid.output import json as answers

        answers.write(answers.estimate_answer(estimate), json)
    if estimate.fit.interrupted:
        raise KeyboardInterrupt
