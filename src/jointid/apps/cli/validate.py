"""`jointid validate`: an estimate against the record it came from, or another one."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from cyclopts import Parameter

from jointid.apps.cli.options import Changes


def validate(
    joint: Path,
    /,
    *,
    estimate: Path,
    record: Path | None = None,
    changes: Changes = (),
    json: Path | None = None,
    figure: Path | None = None,
    residuals: Path | None = None,
    quiet: Annotated[bool, Parameter(name=["--quiet", "-q"], negative=())] = False,
) -> None:
    """Compare an estimate with a record: the direct test on its own, the cross test on another.

    Args:
        joint: the joint file (TOML).
        estimate: what identify --json wrote.
        record: the record, instead of the one the joint file names.
        changes: a key of the joint file and its value, as method.frequency=30; may be given several times.
        json: also write the answer as JSON to this file.
        figure: also save measured, simulated and error torque as PNG, SVG or PDF.
        residuals: also save the error against velocity and position, and its autocorrelation, likewise.
        quiet: say nothing of the progress.
    """
    from jointid import validate as run
    from jointid.apps.cli.console import check_outputs, progress, ready, show
    from jointid.config import load
    from jointid.output import json as answers

    check_outputs(figure, json)
    check_outputs(residuals)
    file = load(joint, changes).override(friction=answers.read_friction(estimate))
    identified = answers.read_identified(estimate, file.joint, file.loop)
    file = file.override(method=identified.method)
    logged = file.record(record)
    ready(progress(quiet))
    validation = run(identified, logged)
    show(validation)
    if json is not None:
        answers.write(answers.to_dict(validation), json)
    if figure is not None:
        from jointid.output.figures.figures import save, torque_figure

        save(torque_figure(validation), figure)
    if residuals is not None:
        from jointid.output.figures.figures import residual_figure, save

        save(residual_figure(validation), residuals)
