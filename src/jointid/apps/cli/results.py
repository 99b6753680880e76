"""The commands `jointid report`, `validate`, `compare` and `export`, on estimates."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from jointid.apps.cli.console import DEFAULTS, Changes, Flag, Options, deliver, ready, show, show_result, spare
from jointid.common.errors import MethodError
from jointid.common.files import write_whole
from jointid.common.messages import Progress, ignore_progress

if TYPE_CHECKING:
    from jointid import Estimate
    from jointid.config import File


def report(
    joint: Path,
    /,
    *,
    options: Options = DEFAULTS,
    html: Path = Path("report.html"),
    no_profiles: Flag = False,
    no_tuning: Flag = False,
    held_out: Path | None = None,
    estimate: Path | None = None,
) -> None:
    """Identify, and report it on one page with figures.

    The page has the result, the verdicts, figures, and how to repeat it.

    Args:
        joint: the joint file (TOML), or a robot file, which has the table [robot].
        options: those that most commands have.
        html: the page, one file that opens without a network.
        no_profiles: do not follow the criterion along stiffness and compliance.
        no_tuning: leave out margins and gains, which a controller with a limit otherwise has.
        held_out: another record, that the estimate has not seen, which it is held against.
        estimate: what identify --json wrote, to report it with its record, and identify nothing.
    """
    from jointid import Report, figures
    from jointid import validate as validate_estimate
    from jointid.output.json import load_estimate
    from jointid.output.report import repetition, tune_to_limit
    from jointid.output.report.sections import PAGES

    figures.require_format(html, PAGES)
    spare((html, options.json), held_out)
    file = options.load(joint, html, estimate=estimate)
    unseen = None if held_out is None else file.record(held_out)
    records = (Path(file.record_path(options.record)),)
    files = {"held_out": held_out and held_out.name, "estimate": estimate and estimate.name}
    again = repetition(joint, records, {"axis": options.axis, **files}, options.changes, html.name)
    if estimate is None:
        record, found = options.identify(file, whole=True)
    else:
        record, found = file.record(options.record), load_estimate(estimate, file)
    checks = [] if unseen is None else [validate_estimate(found, unseen)]
    stated = Report.of(
        found, record, checks, name=file.name or "", profiles=() if no_profiles else None,
        controllers=file.controllers, repetition=again, progress=options.progress,
    )  # fmt: skip
    tuned = None if no_tuning else tune_to_limit(found)
    if isinstance(tuned, str):
        stated = replace(stated, absent={**stated.absent, "tuning": tuned})
    else:
        stated = replace(stated, tuned=tuned)
    for one in (found, *checks):
        show_result(one)
    stated.save(html)
    if options.json is not None:
        write_whole(options.json, stated.answer())
    show("\nWritten: " + ", ".join(str(path) for path in (html, options.json) if path is not None))


def validate(
    joint: Path,
    /,
    *,
    estimate: Path | None = None,
    options: Options = DEFAULTS,
    figure: Path | None = None,
) -> None:
    """Test whether an estimate predicts a record.

    On another record than its own that is the cross test; on its own, the direct test, which only says what is left.

    Args:
        joint: the joint file (TOML), or a robot file, which has the table [robot]: without --estimate it is identified
            from the record that it names, and held against --record.
        estimate: what identify --json wrote.
        options: those that most commands have.
        figure: also save measured, simulated and error torque as PNG, SVG or PDF.
    """
    from jointid import figures
    from jointid import validate as run

    figures.require_format(figure)
    file = options.load(joint, figure, estimate=estimate)
    if estimate is None and options.record is None:
        raise MethodError(
            "An estimate is held against a record that it has not seen; expected --estimate FILE, of identify --json, "
            "or --record OTHER beside the record that the file names."
        )
    identified = _read_or_identify(file, estimate, options.progress)
    ready(options.progress)
    found = run(identified, file.record(options.record))
    deliver(found, options.json, (figure, figures.torque))


def compare(before: Path, after: Path, /, *, json: Path | None = None) -> None:
    """Test whether two estimates differ.

    They are of the same joint or robot; a difference counts if it is larger than their errors.

    Args:
        before: the first (A): what identify --json wrote, or the page of a report.
        after: the second (B), likewise.
        json: also write the answer as JSON to this file.
    """
    from jointid import compare
    from jointid.output import json as answers

    spare((json,), before, after)
    deliver(compare(answers.read_report(before), answers.read_report(after)), json)


def export(
    joint: Path,
    /,
    *,
    estimate: Path | None = None,
    changes: Changes = (),
    axis: str | None = None,
    out: Path,
    format: str | None = None,  # noqa: A002
) -> None:
    """Write an estimate for another tool.

    What its language cannot represent is listed.
    The ending of the file says for which: .toml a joint file with the values filled in, .mat a linear state space for
    MATLAB and SciPy, .xml MuJoCo's MJCF, .urdf URDF, .py an actuator of Isaac Lab; mjlab needs --format.

    Args:
        joint: the joint file (TOML), or a robot file, which has the table [robot]: without --estimate it is identified
            from the record that it names; MJCF and URDF have bodies that fit.
        estimate: what identify --json wrote.
        changes: a key of the joint file and its value, as method.frequency=30, or a setting of the language, as
            export.timestep=1e-3 or export.side=motor; may be given several times.
        axis: of a robot file the name of the one joint that the estimate is of.
        out: the file to write.
        format: the language by its name, as joint-file, instead of the one the ending of the file means.
    """
    from jointid.config.toml import apply_changes
    from jointid.estimation.result.estimate import law_fingerprint
    from jointid.output.export import export as run
    from jointid.output.export import find_language

    of_file = tuple(one for one in changes if not one.startswith("export."))
    file = Options(changes=of_file, axis=axis).load(joint, out, estimate=estimate)
    settings = apply_changes({}, [one for one in changes if one not in of_file]).get("export", {})
    if unknown := settings.keys() - {"control", "delay", "period", "side", "timestep", "values"}:
        raise MethodError(f"export.{min(unknown)} is no setting of an export; leave it out.")
    language = find_language(format or out.suffix.lower())
    if file.robot is None:
        settings |= {"name": file.name}
        settings |= {"file": file, "folder": out.parent} if language == "joint-file" else {}
    elif language == "urdf" and file.model_path is not None and file.model_path.suffix.lower() == ".urdf":
        settings |= {"model": file.model_path, "locked": file.locked}
    found = _read_or_identify(file, estimate, system=file.joint if file.robot is None else file)
    if file.robot is None and file.loop and found.settings.controller not in ("", law_fingerprint(file.loop)):
        show("The controller of the joint file is not the one the joint was identified under.")
    exported = run(found, language, controllers=file.controllers, **settings)
    exported.save(out)
    for line in filter(None, (exported.note, exported)):
        show(line)
    show(f"Written: {out}")


def _read_or_identify(
    file: File, estimate: Path | None, progress: Progress = ignore_progress, system: Any = None
) -> Estimate:
    """Return an estimate: from its file, or else from the record that the joint file or robot file names."""
    from jointid.output.json import load_estimate

    if estimate is not None:
        return load_estimate(estimate, file if system is None else system)
    return file.identify_together([], progress) if file.only_lists else file.identify(file.record(), progress)
