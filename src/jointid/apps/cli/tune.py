"""`jointid tune`: margins over an estimate's interval, gains, a notch, feed-forward, and what change would be told."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from cyclopts import Parameter

from jointid.apps.cli.options import Changes


def tune(
    joint: Path,
    /,
    *,
    record: Path | None = None,
    changes: Changes = (),
    gain_margin: float = 2.0,
    phase_margin: float = 45.0,
    modulus: float = 0.5,
    confidence: float = 0.95,
    notch: bool = True,
    false_alarm: float = 0.01,
    power: float = 0.9,
    json: Path | None = None,
    figure: Path | None = None,
    quiet: Annotated[bool, Parameter(name=["--quiet", "-q"], negative=())] = False,
) -> None:
    """Identify a joint by didim, then say how far its loop is from instability, and what to set in the drive.

    Args:
        joint: the joint file (TOML).
        record: the record, instead of the one the joint file names.
        changes: a key of the joint file and its value, as method.frequency=30; may be given several times.
        gain_margin: that the proposed loop keeps in the worst case, a ratio; 2 is 6 dB.
        phase_margin: likewise, degrees.
        modulus: likewise, the smallest distance of the loop's response from -1; the inverse of the largest sensitivity.
        confidence: with which the interval holds all parameters together.
        notch: whether one may be proposed.
        false_alarm: share of comparisons with a new record that may say a change where there is none.
        power: share that are to say one where it is as large as stated.
        json: also write the answer as JSON to this file.
        figure: also save the responses of joint and loop, with the interval as a band, as PNG, SVG or PDF.
        quiet: say nothing of the progress.
    """
    from jointid import Tuning
    from jointid import tune as run
    from jointid.apps.cli.console import check_outputs, identified, progress, show
    from jointid.config import load
    from jointid.diagnostics.check_loop import add_loop_verdict

    listener = progress(quiet)
    check_outputs(figure, json)
    settings = Tuning(gain_margin, phase_margin, modulus, confidence, notch, false_alarm, power)
    file = load(joint, changes).override(method="didim")
    logged, estimate = identified(file, record, listener)
    if file.tells_of_its_loop:  # margins are of the loop as it is declared
        estimate = add_loop_verdict(estimate, logged)
    tuned = run(estimate, settings, drive=file.drive, progress=listener)
    show(tuned)
    if json is not None:
        from jointid.output import json as answers

        answers.write(answers.to_dict(tuned), json)
    if figure is not None:
        from jointid.output.figures import tuning_figure
        from jointid.output.figures.figures import save

        save(tuning_figure(tuned), figure)
