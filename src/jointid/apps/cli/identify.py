"""`jointid identify`: a joint file and one record, several, or a long log in, the table out."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from cyclopts import Parameter

from jointid.apps.cli.console import Changes, FilteringName, Flag, Options, Quiet, check_outputs, deliver, ready, show
from jointid.common.errors import MethodError
from jointid.estimation.methods.registry import MethodName

if TYPE_CHECKING:
    from jointid import Estimate, Windowing
    from jointid.common.progress import Progress
    from jointid.config import JointFile


def identify(
    joint: Path,
    /,
    *,
    record: Annotated[list[Path] | None, Parameter(negative=())] = None,
    window: float | None = None,
    settling: float | None = None,
    changes: Changes = (),
    method: MethodName | None = None,
    filtering: FilteringName | None = None,
    friction: str | None = None,
    json: Path | None = None,
    figure: Path | None = None,
    details: Flag = False,
    quiet: Quiet = False,
) -> None:
    """Identify a joint from a record, from several in one fit, or from hours of its log in bounded memory.

    Args:
        joint: the joint file (TOML).
        record: the record, instead of the one the joint file names; given several times, or with [[records]] in the
            joint file and none here, all of them are identified in one fit, and held against each other.
        window: seconds of a window; the record, of a format that is read in chunks, is a log too long for memory: it is
            identified in windows, and tested for drift.
        settling: seconds before and after each window that are simulated and not fitted; without it measured.
        changes: a key of the joint file and its value, as method.frequency=30; may be given several times; whatever
            has no option here, as method.minimiser, method.estimator or method.harmonics, is set so.
        method: didim reads torque and reference only; idim reads torque and motor position, and the load's position
            too if the joint is flexible; drive_side and open_loop read torque and motor position, and no controller.
        filtering: published repeats the results of the EMPS benchmark; as-printed the paper's for a flexible joint,
            which aliases at 1 kHz and warns of it; default is the program's own.
        friction: the friction law, symmetric (the same in both directions) or another that joint.friction may name.
        json: also write the answer as JSON to this file.
        figure: also save measured, simulated and error torque as PNG, SVG or PDF.
        details: print every verdict with all its reasons, the method's tests, effort and settings.
        quiet: say nothing of the progress.
    """
    from jointid import Windowing, design_stiffness_test
    from jointid.diagnostics.check_loop import add_loop_verdict
    from jointid.output.figures.figures import torque_figure

    check_outputs(json, figures=(figure,))
    records = record or []
    options = Options(record=records[0] if records else None, changes=changes, json=json, quiet=quiet)
    file = options.load(joint, method=method, filtering=filtering, friction=friction)
    logged = None
    if window is not None or settling is not None:
        estimate = _from_log(file, records, Windowing(window or Windowing().length, settling), options.progress)
    elif len(records) > 1 or (file.runs and not records):
        estimate = _from_several(file, records, options.progress)
    else:
        logged, estimate = options.identify(file)
        if file.tells_of_its_loop:
            estimate = add_loop_verdict(estimate, logged)
    deliver(estimate, json, (figure, torque_figure), details=details)
    if logged is not None and estimate.checks.bounds:
        show(f"\n{design_stiffness_test(estimate, logged)}")
    if estimate.fit.interrupted:
        raise KeyboardInterrupt


def _from_several(file: JointFile, records: list[Path], listener: Progress) -> Estimate:
    from jointid import SeveralRecords
    from jointid import identify as run

    each = file.each(records)
    loops = [one.loop for one in each if one.loop is not None]
    if len(loops) < len(each):
        raise MethodError(
            "Several records are identified by simulating their loop; add [controller] to the joint file."
        )
    logged = [one.record() for one in each]
    ready(listener)
    several = SeveralRecords(
        added_inertia=[more for one in each for more in one.added_inertias],
        own=[more.own for one in each for more in one.runs],
        free=file.together.free,
        weighting=file.together.weighting,
    )
    return run(
        logged, loops, file.method, several=several, filtering=file.filtering, parameters=file.parameters,
        progress=listener,
    )  # fmt: skip


def _from_log(file: JointFile, records: list[Path], windows: Windowing, listener: Progress) -> Estimate:
    from jointid import identify as run

    if len(records) > 1:
        raise MethodError(
            f"A log is one record; received {len(records)} with --window: name one, or leave --window out."
        )
    if file.loop is None:
        raise MethodError("A long record is identified by simulating its loop; add [controller] to the joint file.")
    log = file.log(records[0] if records else None)
    ready(listener)
    return run(
        log, file.loop, file.method, windows=windows, filtering=file.filtering, parameters=file.parameters,
        progress=listener,
    )  # fmt: skip
