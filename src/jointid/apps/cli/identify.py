"""`jointid identify`: a joint file and a record in, the table out."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

from cyclopts import Parameter


def identify(
    joint: Path,
    /,
    *,
    record: Path | None = None,
    method: Literal["didim", "idim", "drive_side", "open_loop"] | None = None,
    filtering: Literal["default", "published", "as-printed"] | None = None,
    friction: Literal["symmetric", "asymmetric"] | None = None,
    minimiser: Literal["least-squares", "nelder-mead"] | None = None,
    frequency: float | None = None,
    estimator: Literal["ols", "weighted", "robust", "iv"] | None = None,
    harmonics: int | None = None,
    period: float | None = None,
    drift: Literal["force", "viscous", "both"] | None = None,
    json: Path | None = None,
    figure: Path | None = None,
    details: Annotated[bool, Parameter(negative=())] = False,
    quiet: Annotated[bool, Parameter(name=["--quiet", "-q"], negative=())] = False,
) -> None:
    """Identify a joint from a record.

    Args:
        joint: the joint file (TOML).
        record: the record, instead of the one the joint file names.
        method: didim reads torque and reference only; idim reads torque and motor position, and the load's position
            too if the joint is flexible; drive_side and open_loop read torque and motor position, and no controller.
        filtering: published repeats the results of the EMPS benchmark; as-printed the paper's for a flexible joint,
            which aliases at 1 kHz and warns of it; default is the program's own.
        friction: the same in both directions, or not.
        minimiser: of didim for a flexible joint; nelder-mead is the paper's.
        frequency: in Hz, free-free, from which didim for a flexible joint starts its stiffness.
        estimator: of idim; weighted, each equation of a flexible joint by the size of its error; robust, rows that do
            not fit weigh less; iv, instruments from the simulated loop.
        harmonics: of idim, so many of the force over the motor position.
        period: of the first harmonic, in m or rad; without it the period is searched for.
        drift: of idim, what changes linearly in time.
        json: also write the answer as JSON to this file.
        figure: also save measured, simulated and error torque as PNG, SVG or PDF.
        details: print every verdict with all its reasons, the method's tests, effort and settings.
        quiet: say nothing of the progress.
    """
    from jointid.apps.cli.console import check_outputs, identified, progress, show, show_result
    from jointid.config import load
    from jointid.diagnostics.check_loop import with_loop_verdict

    listener = progress(quiet)
    check_outputs(figure, json)
    file = load(joint).overridden(
        method=method,
        filtering=filtering,
        friction=friction,
        minimiser=minimiser,
        frequency=frequency,
        estimator=estimator,
        harmonics=harmonics,
        period=period,
        drift=drift,
    )
    logged, estimate = identified(file, record, listener)
    if file.tells_of_its_loop:
        estimate = with_loop_verdict(estimate, logged)
    show_result(estimate, details=details)
    if json is not None:
        from jointid.output import json as answers

        answers.write(answers.estimate_answer(estimate), json)
    if figure is not None:
        from jointid.output.figures.figures import save, torque_figure

        save(torque_figure(estimate), figure)
    if estimate.checks.bounds:
        from jointid.diagnostics.stiffness_test_design import what_would_tell_more

        show(f"\n{what_would_tell_more(estimate, logged)}")
