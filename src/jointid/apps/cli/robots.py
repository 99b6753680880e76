"""What the commands do with a robot file, which has the table [robot]: identify, validate and export all joints."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from jointid.apps.cli.console import deliver, show
from jointid.apps.cli.places import Outputs
from jointid.common.errors import MethodError

if TYPE_CHECKING:
    from jointid.config.robot_file import RobotFile
    from jointid.estimation.robots.idim import RobotEstimate


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
        raise MethodError(f"{', '.join(given)} is for a joint file; a robot file is identified by IDIM: leave it out.")


def identify_robot_file(
    path: Path, records: Sequence[Path], changes: Sequence[str], outputs: Outputs, json: Path | None, details: bool
) -> None:
    """Identify all joints of a robot file from one record."""
    if len(records) > 1:
        raise MethodError(f"A robot is identified from one record; received {len(records)}: name one.")
    _, estimate = _identified(path, changes, outputs, records[0] if records else None)
    deliver(estimate, json, details=details)


def validate_robot_file(
    path: Path, record: Path | None, changes: Sequence[str], outputs: Outputs, json: Path | None
) -> None:
    """Identify a robot from the record that its file names, and hold the estimate against another one."""
    from jointid.estimation.robots.validation import validate_robot

    if record is None:
        raise MethodError(
            "A robot's estimate is held against a record that it has not seen; expected --record OTHER, beside the "
            "record that the robot file names."
        )
    file, estimate = _identified(path, changes, outputs)
    deliver(validate_robot(estimate, file.records(record)), json)


def export_robot_file(path: Path, changes: Sequence[str], out: Path) -> None:
    """Identify a robot from the record that its file names, and write bodies that fit, as URDF or MJCF."""
    from jointid.common.files import write_whole
    from jointid.estimation.robots.consistent import consistent_robot
    from jointid.output.export.robot_model import write_robot

    _, estimate = _identified(path, changes, Outputs({"--out": out}))
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


def _identified(
    path: Path, changes: Sequence[str], outputs: Outputs, record: Path | None = None
) -> tuple[RobotFile, RobotEstimate]:
    from jointid.config.robot_file import load_robot_file
    from jointid.estimation.robots.idim import identify_robot

    file = load_robot_file(path, changes)
    outputs.spare("JOINT", path, path.parent / str(file.raw["robot"]["model"]))
    source = file.joints[0].source.file
    outputs.spare("the record", record, path.parent / source if source else None)
    return file, identify_robot(file.robot, file.records(record), file.method, filtering=file.filtering)
