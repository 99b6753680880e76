"""`jointid payload`: what a robot carries, and the gains of its drives."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from cyclopts import Parameter

from jointid.apps.cli.console import Changes, Options, Quiet, deliver
from jointid.apps.cli.places import Outputs
from jointid.common.errors import MethodError


def payload(
    robot: Path,
    /,
    *,
    without: Path,
    with_: Annotated[Path, Parameter(name="--with")],
    mass: float | None = None,
    changes: Changes = (),
    json: Path | None = None,
    quiet: Quiet = False,
) -> None:
    """Identify what a robot carries: mass, centre and inertia, from a record without it and one with it.

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
    from jointid import IDIM, identify_payload
    from jointid.config.robot_file import RobotFile
    from jointid.robots import identify_drive_gains

    outputs = Outputs({"--json": json})
    outputs.spare("--without", without)
    outputs.spare("--with", with_)
    options = Options(changes=changes, quiet=quiet)
    file = options.load(robot, outputs)
    if not isinstance(file, RobotFile):
        raise MethodError(f"{robot} is no robot file, which has the table [robot]; a payload is weighed by a robot.")
    if mass is None:
        empty, loaded = file.record(without), file.record(with_)
        found = identify_payload(
            file.setup, empty, loaded, file.method, filtering=file.filtering, progress=options.progress
        )
        deliver(found, json)
        return
    if not isinstance(file.method, IDIM):
        raise MethodError(
            "The drives' gains are found by IDIM, from motor positions and torques, and this robot file asks for "
            "DIDIM or the drive side; add --set method.name=idim, and declare record.channels.motor_position."
        )
    if file.method.fixed or file.method.estimator not in (None, "weighted"):
        raise MethodError(
            "The drives' gains are searched with all parameters free, each joint weighed by its error; leave "
            "method.fixed and method.estimator out, or add --set method.estimator=weighted --set method.fixed={}."
        )
    empty, loaded = file.records(without), file.records(with_)
    deliver(identify_drive_gains(file.robot, empty, loaded, {"m": mass}, filtering=file.filtering), json)
