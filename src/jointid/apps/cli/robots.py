"""What the commands do with a robot file, which has the table [robot]."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from cyclopts import Parameter

from jointid.apps.cli.console import Changes, Options, deliver, listen, make_folder, show
from jointid.apps.cli.places import Outputs
from jointid.common.errors import MethodError
from jointid.common.messages import Progress, silent

if TYPE_CHECKING:
    from jointid.config.robot_file import RobotFile
    from jointid.estimation.robots.idim import RobotEstimate
    from jointid.estimation.robots.torque_estimate import RobotTorqueEstimate
    from jointid.estimation.robots.validation import RobotValidation
    from jointid.records.record import Record


_SAMPLE_TIME, _DURATION = 1e-3, 10.0  # s, of a test where no file and no record says them


def is_robot(path: Path) -> bool:
    """True if a file in TOML is of a robot; of one that cannot be read the joint file's own sentences tell."""
    from jointid.config.loading import is_robot_file

    return is_robot_file(path)


def refuse(**options: object) -> None:
    """Refuse options that are for a joint file.

    Raises:
        MethodError: one of them was given.
    """
    given = [f"--{name}" for name, value in options.items() if value]
    if given:
        raise MethodError(
            f"{', '.join(given)} is for a joint file; a robot file says it itself, or --set for it, as "
            "--set method.name=didim: leave it out."
        )


def identify_robot_file(
    path: Path, records: Sequence[Path], changes: Sequence[str], outputs: Outputs, json: Path | None, details: bool,
    progress: Progress,
) -> None:  # fmt: skip
    """Identify all joints of a robot file from one record."""
    if len(records) > 1:
        raise MethodError(f"A robot is identified from one record; received {len(records)}: name one.")
    _, _, estimate = _identified(path, changes, outputs, progress, records[0] if records else None)
    deliver(estimate, json, details=details)


def simulate_robot_file(path: Path, options: Options, out: Path | None, outputs: Outputs) -> None:
    """Simulate a robot under its controllers along the references of a record, and write what its drives would log."""
    from jointid.output.json import documents
    from jointid.output.json import write as write_answer
    from jointid.simulation.robots import robot_records, simulate_robot, strays
    from jointid.simulation.simulated import require_success

    file = _loaded(path, options.changes, outputs, options.record)
    loop, records = file.loop, file.driven(options.record, logged=False)
    found = require_success(simulate_robot(loop, records), f"The simulation of {file.robot.name}")
    peaks = ", ".join(
        f"{name} {peak:.4g} {file.robot.torque_unit(k)}"
        for k, (name, peak) in enumerate(zip(file.robot.names, abs(found.torque).max(axis=0), strict=True))
    )
    show(
        f"{len(found.torque)} samples of {found.sample_time:g} s, {found.events} reversals, stops and starts; peak "
        f"torques: {peaks}"
    )
    astray = strays(records, found)
    for k, off in astray.items():
        show(
            f"{file.robot.names[k]} does not follow its reference: it gets {off:.3g} {file.robot.position_unit(k)} off "
            "it; check its controller's gains and limit, and its signs."
        )
    if out is not None:
        file.write(robot_records(loop, records, found), out)
        show(f"Written: {out}")
    if options.json is not None:
        write_answer(documents.robot_simulation_answer(file.robot, found, astray), options.json)


def validate_robot_file(path: Path, options: Options, outputs: Outputs) -> None:
    """Identify a robot from the record that its file names, and hold the estimate against another one."""
    if options.record is None:
        raise MethodError(
            "A robot's estimate is held against a record that it has not seen; expected --record OTHER, beside the "
            "record that the robot file names."
        )
    file, _, estimate = _identified(path, options.changes, outputs, options.progress)
    deliver(_held_out(file, estimate, options.record), options.json)


def _held_out(file: RobotFile, estimate: RobotEstimate | RobotTorqueEstimate, other: Path) -> RobotValidation:
    """Hold an estimate against another record than its own."""
    from jointid.estimation.robots.idim import RobotEstimate
    from jointid.estimation.robots.torque_estimate import validate_robot_torques
    from jointid.estimation.robots.validation import validate_robot

    if isinstance(estimate, RobotEstimate):
        return validate_robot(estimate, file.records(other))
    return validate_robot_torques(estimate, file.to_identify(other))


def diagnose_robot_file(path: Path, options: Options) -> None:
    """Identify a robot, and say what its record tells of each joint and whether its loops are as declared."""
    from jointid.diagnostics.robots.diagnose import diagnose_robot

    outputs = options.outputs
    outputs.spare("JOINT", path)
    if not is_robot(path):
        raise MethodError(
            f"{path} is no robot file, which has the table [robot]; of a joint file one question is asked: jointid "
            "diagnose --help lists them."
        )
    file, records, estimate = _identified(path, options.changes, outputs, options.progress, options.record, judged=True)
    found = diagnose_robot(estimate, records, [one.controller for one in file.joints], feed_forward=file.feed_forward)
    deliver(found, options.json)


def report_robot_file(
    path: Path, options: Options, page: Path | None, markdown: Path | None, figures: Path | None, held_out: Path | None,
    outputs: Outputs,
) -> None:  # fmt: skip
    """Identify a robot, and report it as one page, held against another record where one is given."""
    from jointid.output.report import repetition
    from jointid.output.report.robots import RobotReport

    outputs.spare("--held-out", held_out)
    file, records, estimate = _identified(path, options.changes, outputs, options.progress, options.record, judged=True)
    source = Path(file.joints[0].record_path(options.record))
    found = None if held_out is None else _held_out(file, estimate, held_out)
    html = "report.html" if page is None else page.name
    again = repetition(path, source, {"held_out": held_out and held_out.name}, options.changes, html, "robot")
    told = RobotReport.of(
        estimate, records, [one.controller for one in file.joints], found, feed_forward=file.feed_forward,
        repetition=again,
    )  # fmt: skip
    written = [] if page is None else [told.save(page)]
    written += [] if markdown is None else [told.save_markdown(markdown)[0]]
    written += [] if figures is None else [*told.save_figures(figures)]
    written += [] if options.json is None else [options.json]
    deliver(told.estimate if found is None else found, None)
    if options.json is not None:
        from jointid.common.files import write_whole

        write_whole(options.json, told.answer())
    show("\nWritten: " + ", ".join(map(str, written)))


def payload(
    robot: Path,
    /,
    *,
    without: Path,
    with_: Annotated[Path, Parameter(name="--with")],
    mass: float | None = None,
    changes: Changes = (),
    json: Path | None = None,
    quiet: bool = False,
) -> None:
    """Weigh what a robot carries: mass, centre and inertia, from a record without it and one with it.

    By IDIM from motor positions and torques, by DIDIM from torques and references, or on the drive side from torques
    and motor positions of a flexible robot, as the robot file asks.

    Of a payload whose mass is known, --mass asks for the gains of the drives instead: what each joint's torque, or its
    current, as the robot file reads it, is to be multiplied with.

    Args:
        robot: the robot file (TOML), which has the table [robot].
        without: the record without the payload.
        with_: the record with it, of the same or another motion.
        mass: of the payload as it was weighed, kg.
        changes: a key of the robot file and its value, as method.estimator=robust; may be given several times.
        json: also write the answer as JSON to this file.
        quiet: say nothing of the progress of searches.
    """
    from jointid.estimation.robots.drive_gains import identify_drive_gains
    from jointid.estimation.robots.idim import RobotIDIM
    from jointid.estimation.robots.torque_estimate import RobotDIDIM
    from jointid.estimation.robots.weighing import weigh_payload, weigh_payload_from_torques
    from jointid.simulation.robot_drive_side import RobotDriveSide

    outputs = Outputs({"--json": json})
    outputs.spare("--without", without)
    outputs.spare("--with", with_)
    file = _loaded(robot, changes, outputs)
    if not isinstance(file.method, RobotIDIM):
        if mass is not None:
            raise MethodError(
                "The drives' gains are found by IDIM, from motor positions and torques, and this robot file asks for "
                "DIDIM or the drive side; add --set method.name=idim, and declare record.channels.motor_position."
            )
        closing = file.loop if isinstance(file.method, RobotDIDIM) else RobotDriveSide(file.robot)
        empty, loaded = file.to_identify(without), file.to_identify(with_)
        found = weigh_payload_from_torques(closing, empty, loaded, file.method, file.filtering, listen(quiet))
        deliver(found, json)
        return
    if mass is not None and (file.method.fixed or file.method.estimator != RobotIDIM().estimator):
        raise MethodError(
            "The drives' gains are searched with all parameters free, each joint weighed by its error; leave "
            "method.fixed and method.estimator out, or add --set method.estimator=weighted --set method.fixed={}."
        )
    empty, loaded = file.records(without), file.records(with_)
    if mass is None:
        deliver(weigh_payload(file.robot, empty, loaded, file.method, filtering=file.filtering), json)
    else:
        deliver(identify_drive_gains(file.robot, empty, loaded, {"m": mass}, filtering=file.filtering), json)


def export_robot_file(path: Path, changes: Sequence[str], out: Path) -> None:
    """Identify a robot from the record that its file names, and write bodies that fit, as URDF or MJCF."""
    from jointid.common.files import write_whole
    from jointid.estimation.robots.consistent import consistent_robot
    from jointid.estimation.robots.idim import RobotEstimate
    from jointid.output.export.robot_model import write_robot

    _, _, estimate = _identified(path, changes, Outputs({"--out": out}), silent)
    if not (estimate.converged if isinstance(estimate, RobotEstimate) else estimate.fit.converged):
        raise MethodError(
            "The search did not settle, so there is nothing to export; identify the robot to see what it leaves, or "
            "allow more by method.iterations, of springs method.evaluations."
        )
    found = consistent_robot(estimate)
    text, lost = write_robot(found.robot, out)
    write_whole(out, text)
    show(
        f"Bodies near those of the model that fit the estimate to {found.misfit:.2g} of its deviations, rms; the mass "
        f"matrix is positive in 1000 random poses, {found.least_inertia:.3g} at the least."
    )
    for one in lost:
        show(f"Left out: {one}.")
    show(f"Written: {out}")


def design_robot_file(
    path: Path, options: Options, duration: float | None, seconds: float, motion: Path | None, out: Path | None,
    figure: Path | None, outputs: Outputs,
) -> None:  # fmt: skip
    """Plan the motion that tells most of a robot, beside that of a first record where there is one."""
    import numpy as np

    from jointid import figures
    from jointid.common.files import write_whole
    from jointid.estimation.robots.idim import RobotIDIM
    from jointid.planning.robots.design import design_robot_test
    from jointid.planning.robots.first_record import first_record

    outputs.spare("--motion", motion)
    file = _loaded(path, options.changes, outputs, options.record)
    first = own = None
    sample_time = file.joints[0].source.sample_time or _SAMPLE_TIME
    if motion is not None:
        played = [record.reference for record in file.driven(motion, logged=False)]
        given = [one for one in played if one is not None]
        own = np.column_stack([one.values for one in given]) @ np.linalg.inv(file.robot.coupling).T
        sample_time = given[0].sample_time
        duration = len(own) * sample_time
    elif options.record is not None or not all(one.complete for one in file.limits):
        _, records, estimate = _identified(path, options.changes, outputs, options.progress, options.record)
        first = first_record(estimate, records)
        sample_time = first.sample_time
    found = design_robot_test(
        file.robot, file.limits, duration=duration or (_DURATION if first is None else first.duration),
        sample_time=sample_time, loop=None if isinstance(file.method, RobotIDIM) else file.loop,
        # Of a motion that was never played nothing is logged: such a robot is foretold without.
        feed_forward="none" if file.feed_forward == "logged" else file.feed_forward,
        noise=None if first is None else first.noise, present=None if first is None else first.motion, motion=own,
        filtering=file.filtering, seconds=seconds, progress=options.progress,
    )  # fmt: skip
    deliver(found, options.json, (figure, figures.draw))
    if out is not None:
        make_folder(out, "--out")
        file.write(found.records(), out / "motion.csv")
        write_whole(out / "design.md", found.document().markdown())
        show(f"\nWritten to {out}: motion.csv, design.md")


def _loaded(path: Path, changes: Sequence[str], outputs: Outputs, record: Path | None = None) -> RobotFile:
    """Return a robot file, whose model and record no output may replace."""
    from jointid.config.robot_file import load_robot_file

    file = load_robot_file(path, changes)
    outputs.spare("JOINT", path, path.parent / str(file.raw["robot"]["model"]))
    source = file.joints[0].source.file
    outputs.spare("the record", record, path.parent / source if source else None)
    return file


def _identified(
    path: Path,
    changes: Sequence[str],
    outputs: Outputs,
    progress: Progress,
    record: Path | None = None,
    *,
    judged: bool = False,
) -> tuple[RobotFile, tuple[Record, ...], RobotEstimate | RobotTorqueEstimate]:
    """Identify a robot as its file says; return what the file says, and the record, too.

    With `judged` the record has the feed-forward that the file computes, to hold its controllers against the torques.
    """
    file = _loaded(path, changes, outputs, record)
    records = file.to_identify(record, judged=judged)
    return file, records, file.identify(records, progress=progress)
