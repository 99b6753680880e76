"""What the commands do with a robot file, which has the table [robot]: identify, validate and export all joints."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from cyclopts import Parameter

from jointid.apps.cli.console import Changes, Options, deliver, show
from jointid.apps.cli.places import Outputs
from jointid.common.errors import MethodError
from jointid.common.messages import Progress, silent

if TYPE_CHECKING:
    from jointid.config.robot_file import RobotFile
    from jointid.estimation.robots.idim import RobotEstimate
    from jointid.estimation.robots.torque_only import RobotTorqueEstimate


def is_robot(path: Path) -> bool:
    """True if a file in TOML is of a robot; of one that cannot be read the joint file's own sentences tell."""
    from jointid.config.robot_file import is_robot_file

    return is_robot_file(path)


def refuse(**options: object) -> None:
    """Refuse options that are for a joint file.

    Raises:
        MethodError: one of them was given.
    """
    given = [f"--{name}" for name, value in options.items() if value]
    if given:
        raise MethodError(f"{', '.join(given)} is for a joint file; a robot file says it itself: leave it out.")


def identify_robot_file(
    path: Path, records: Sequence[Path], changes: Sequence[str], outputs: Outputs, json: Path | None, details: bool,
    progress: Progress,
) -> None:  # fmt: skip
    """Identify all joints of a robot file from one record."""
    if len(records) > 1:
        raise MethodError(f"A robot is identified from one record; received {len(records)}: name one.")
    _, estimate = _identified(path, changes, outputs, progress, records[0] if records else None)
    deliver(estimate, json, details=details)


def simulate_robot_file(path: Path, options: Options, out: Path | None, outputs: Outputs) -> None:
    """Simulate a robot under its controllers along the references of a record, and write what its drives would log."""
    from jointid.simulation.robots import RobotOutcome, robot_records, simulate_robot

    file = _loaded(path, options.changes, outputs, options.record)
    loop, records = file.loop, file.driven(options.record, logged=False)
    found = simulate_robot(loop, records)
    if found.outcome is not RobotOutcome.FINISHED:
        raise MethodError(f"{file.robot.name} cannot be simulated: {found.outcome.value}.")
    peaks = ", ".join(
        f"{name} {peak:.4g} {file.robot.torque_unit(k)}"
        for k, (name, peak) in enumerate(zip(file.robot.names, abs(found.torque).max(axis=0), strict=True))
    )
    show(
        f"{len(found.torque)} samples of {found.sample_time:g} s, {found.events} reversals, stops and starts; peak "
        f"torques: {peaks}"
    )
    if out is not None:
        file.write(robot_records(loop, records, found), out)
        show(f"Written: {out}")


def validate_robot_file(path: Path, options: Options, outputs: Outputs) -> None:
    """Identify a robot from the record that its file names, and hold the estimate against another one."""
    from jointid.estimation.robots.idim import RobotEstimate
    from jointid.estimation.robots.torque_only import validate_robot_torques
    from jointid.estimation.robots.validation import validate_robot

    if options.record is None:
        raise MethodError(
            "A robot's estimate is held against a record that it has not seen; expected --record OTHER, beside the "
            "record that the robot file names."
        )
    file, estimate = _identified(path, options.changes, outputs, options.progress)
    if isinstance(estimate, RobotEstimate):
        found = validate_robot(estimate, file.records(options.record))
    else:
        found = validate_robot_torques(estimate, file.driven(options.record))
    deliver(found, options.json)


def payload(
    robot: Path,
    /,
    *,
    without: Path,
    with_: Annotated[Path, Parameter(name="--with")],
    mass: float | None = None,
    changes: Changes = (),
    json: Path | None = None,
) -> None:
    """Weigh what a robot carries: mass, centre and inertia, from a record without it and one with it.

    Of a payload whose mass is known, --mass asks for the gains of the drives instead: what each joint's torque, or its
    current, as the robot file reads it, is to be multiplied with.

    Args:
        robot: the robot file (TOML), which has the table [robot].
        without: the record without the payload.
        with_: the record with it, of the same or another motion.
        mass: of the payload as it was weighed, kg.
        changes: a key of the robot file and its value, as method.estimator=robust; may be given several times.
        json: also write the answer as JSON to this file.
    """
    from jointid.estimation.robots.drive_gains import identify_drive_gains
    from jointid.estimation.robots.idim import RobotIDIM
    from jointid.estimation.robots.weighing import weigh_payload

    outputs = Outputs({"--json": json})
    outputs.spare("--without", without)
    outputs.spare("--with", with_)
    file = _loaded(robot, changes, outputs)
    if not isinstance(file.method, RobotIDIM):
        raise MethodError(
            "A payload is weighed by IDIM, from motor positions and torques, and this robot file asks for DIDIM; add "
            "--set method.name=idim, with records that have them."
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

    _, estimate = _identified(path, changes, Outputs({"--out": out}), silent)
    if not isinstance(estimate, RobotEstimate):
        raise MethodError(
            "Bodies are fitted to an estimate by IDIM, of motor positions, and this robot file asks for DIDIM; add "
            "--set method.name=idim, with a record that has them."
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


def _loaded(path: Path, changes: Sequence[str], outputs: Outputs, record: Path | None = None) -> RobotFile:
    """Return a robot file, whose model and record no output may replace."""
    from jointid.config.robot_file import load_robot_file

    file = load_robot_file(path, changes)
    outputs.spare("JOINT", path, path.parent / str(file.raw["robot"]["model"]))
    source = file.joints[0].source.file
    outputs.spare("the record", record, path.parent / source if source else None)
    return file


def _identified(
    path: Path, changes: Sequence[str], outputs: Outputs, progress: Progress, record: Path | None = None
) -> tuple[RobotFile, RobotEstimate | RobotTorqueEstimate]:
    from jointid.estimation.robots.idim import RobotIDIM, identify_robot
    from jointid.estimation.robots.torque_only import identify_robot_from_torques

    file = _loaded(path, changes, outputs, record)
    if isinstance(file.method, RobotIDIM):
        simulates = file.method.estimator == "iv"
        records, loop = (file.driven(record), file.loop) if simulates else (file.records(record), None)
        return file, identify_robot(file.robot, records, file.method, filtering=file.filtering, loop=loop)
    found = identify_robot_from_torques(
        file.loop, file.driven(record), file.method, filtering=file.filtering, progress=progress
    )
    return file, found
