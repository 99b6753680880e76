"""The commands `jointid report`, `validate`, `compare` and `export`, on estimates."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from jointid.apps.cli.console import DEFAULTS, Flag, Options, deliver, ready, save, show, show_result, spare
from jointid.common.errors import MethodError
from jointid.common.files import write_whole


def report(
    joint: Path,
    /,
    *,
    options: Options = DEFAULTS,
    html: Path = Path("report.html"),
    no_profiles: Flag = False,
    no_tuning: Flag = False,
    held_out: Path | None = None,
) -> None:
    """Identify, and report it on one page with figures.

    The page has the result, the verdicts, figures, and how to repeat it.

    Args:
        joint: the joint file (TOML), or a robot file, which has the table [robot].
        options: those that most commands have.
        html: the page, one file that opens without a network.
        no_profiles: leave out the profiles of the criterion along stiffness and compliance.
        no_tuning: leave out margins and gains, which a controller with a limit otherwise has.
        held_out: a record that the estimate has not seen, for validation.
    """
    from jointid import Report, figures
    from jointid import validate as validate_estimate
    from jointid.output.report import repetition
    from jointid.output.report.sections import PAGES

    figures.require_format(html, PAGES)
    spare((html, options.json), held_out)
    file = options.load(joint, html)
    unseen = None if held_out is None else file.record(held_out)
    named = {"axis": options.axis, "held_out": held_out and held_out.name}
    again = repetition(joint, (Path(file.record_path(options.record)),), named, options.changes, html.name)
    record, found = options.identify(file, whole=True)
    checks = [] if unseen is None else [validate_estimate(found, unseen)]
    stated = Report.of(
        found, record, checks, name=file.name or "", profiles=() if no_profiles else None,
        tuning=not no_tuning, controllers=file.controllers, repetition=again, progress=options.progress,
    )  # fmt: skip
    for one in (found, *checks):
        show_result(one)
    stated.save(html)
    if options.json is not None:
        write_whole(options.json, stated.answer())
    show("\nWritten: " + ", ".join(str(path) for path in (html, options.json) if path is not None))


def validate(joint: Path, /, *, options: Options = DEFAULTS) -> None:
    """Test whether an estimate predicts another record.

    The joint or robot is identified from the record that its file names, or from the first of two --record. The
    estimate then predicts the last --record. On its own record this is the direct test, which only gives the residual.

    Args:
        joint: the joint file (TOML), or a robot file, which has the table [robot].
        options: those that most commands have.
    """
    from jointid import validate as run

    file = options.load(joint)
    if not options.records:
        raise MethodError("A validation takes a record that the estimate has not seen; expected --record OTHER.")
    identified = replace(options, records=options.records[:-1]).identify(file, several=True)[1]
    ready(options.progress, file)
    deliver(run(identified, file.record(options.records[-1])), options.json)


def compare(before: Path, after: Path, /, *, json: Path | None = None) -> None:
    """Test whether two estimates differ.

    They are of the same joint or robot; a difference counts if it is larger than their errors.

    Args:
        before: the first (A): a file of identify --json, or the page of a report.
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
    options: Options = DEFAULTS,
    out: Path,
    format: str | None = None,  # noqa: A002
) -> None:
    """Write an estimate for another tool.

    Values that the format cannot represent are listed.
    The file's ending selects the format: .toml a joint file with the values filled in, .mat a linear state space for
    MATLAB and SciPy, .xml MuJoCo's MJCF, .urdf URDF, .py an actuator of Isaac Lab; mjlab needs --format. --set also
    takes a setting of the language, as export.timestep=1e-3 or export.side=motor.

    Args:
        joint: the joint file (TOML), or a robot file, which has the table [robot]; MJCF and URDF have bodies that fit.
        options: those that most commands have.
        out: the file to write.
        format: name of the language, as joint-file, instead of the one that the file's ending implies.
    """
    from jointid.config.toml import apply_changes
    from jointid.output.export import export as run
    from jointid.output.export import find_language

    of_file = tuple(one for one in options.changes if not one.startswith("export."))
    settings = apply_changes({}, [one for one in options.changes if one not in of_file]).get("export", {})
    options = replace(options, changes=of_file)
    file = options.load(joint, out)
    if unknown := settings.keys() - {"control", "delay", "period", "side", "timestep", "values"}:
        raise MethodError(f"export.{min(unknown)} is no setting of an export; leave it out.")
    language = find_language(format or out.suffix.lower())
    if file.robot is None:
        settings |= {"name": file.name}
        settings |= {"file": file, "folder": out.parent} if language == "joint-file" else {}
    elif language == "urdf" and file.model_path is not None and file.model_path.suffix.lower() == ".urdf":
        settings |= {"model": file.model_path, "locked": file.locked}
    found = options.identify(file, several=True)[1]
    exported = run(found, language, controllers=file.controllers, **settings)
    exported.save(out)
    save(found, options.json)
    for line in filter(None, (exported.note, exported, f"Written: {out}")):
        show(line)
