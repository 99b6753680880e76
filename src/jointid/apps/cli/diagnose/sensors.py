"""`jointid diagnose sensors`: which sensor, or which other motion, would narrow the intervals of an estimate."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

from cyclopts import Parameter

from jointid.apps.cli.options import Changes


def sensors(
    joint: Path,
    /,
    *,
    record: Path | None = None,
    changes: Changes = (),
    encoder_step: float | None = None,
    noise: Literal["loop", "log"] | None = None,
    json: Path | None = None,
    quiet: Annotated[bool, Parameter(name=["--quiet", "-q"], negative=())] = False,
) -> None:
    """Identify a joint from torque and reference, and predict what an encoder or another motion would add.

    Args:
        joint: the joint file (TOML); its method is didim.
        record: the record, instead of the one the joint file names.
        changes: a key of the joint file and its value, as method.frequency=30; may be given several times.
        encoder_step: of the encoders, in m or rad, on the side of a transmission that is reported; without it that of
            the record's own, or a millionth of the travel.
        noise: where the torque's residual comes from, a force in the loop or the log itself; without it as the tap of
            the torque says.
        json: also write the answer as JSON to this file.
        quiet: say nothing of the progress.
    """
    from jointid import advise as run
    from jointid import design_stiffness_test
    from jointid.apps.cli.console import check_outputs, identified, progress, show
    from jointid.config import load
    from jointid.output import json as answers

    listener = progress(quiet)
    check_outputs(None, json)
    file = load(joint, changes).override(method="didim")
    logged, estimate = identified(file, record, listener)
    if estimate.checks.bounds:
        found = design_stiffness_test(estimate, logged, encoder_step=encoder_step, noise=noise, progress=listener)
        show(found)
        answer = answers.to_dict(found)
    else:
        advice = run(estimate, logged, encoder_step=encoder_step, noise=noise, progress=listener)
        show(advice)
        answer = answers.to_dict(advice)
    if json is not None:
        answers.write(answer, json)
