"""`jointid diagnose`: whether a record, its loop and its joint are as they are declared."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

from jointid.apps.cli.console import DEFAULTS, Flag, Options, deliver, ready
from jointid.common.errors import MethodError, RecordError

if TYPE_CHECKING:
    from jointid.config import File
    from jointid.diagnostics.diagnosis import Diagnosis

FAULTY = 3
"""Exit code where something is wrong with the record, or something is found."""


def diagnose(joint: Path, /, *, options: Options = DEFAULTS, laws: Flag = False) -> int:
    """Find what is wrong with record, loop, log and joint.

    First the record: its clock, the torque and its limit, the motion, the controller (where the motor's position was
    logged). Then, of each axis, what is left once it is identified and what that follows, which parameters are known,
    and which faults of loop, log and mechanics the record shows; of [[records]] of each. Where no joint can be
    identified the record is still reported on. Exit code 0 where nothing is found, 3 where something is.

    Args:
        joint: the joint file (TOML), or a robot file, which has the table [robot]. A joint whose controller is declared
            is identified by didim.
        options: those that most commands have.
        laws: also compare the laws of spring and friction, each by how well it predicts parts of the record that were
            kept from its fit.
    """
    file = options.load(joint)
    if file.robot is None and file.loop is not None:
        file = options.load(joint, method="didim")
    several = options.record is None and file.only_lists
    paths = file.listed if several else [Path(file.record_path(options.record))]
    if len(paths) > 1 and options.json is not None:
        raise MethodError(f"--json holds one record, and {joint} lists {len(paths)}; name one of them by --record.")
    nothing = True
    for path in paths:
        found = _diagnose_record(file, path, options, laws)
        nothing &= found.healthy and not found.sentences
    return 0 if nothing else FAULTY


def _diagnose_record(file: File, path: Path, options: Options, laws: bool) -> Diagnosis:
    """Diagnose one record, print what is found, and write it."""
    from jointid.diagnostics.diagnose import diagnose as run
    from jointid.diagnostics.diagnose import unreadable

    try:
        record = file.record(path)
    except RecordError as error:
        if not path.exists():
            raise
        found = unreadable(error, path.stem)
        deliver(found, options.json)
        return found
    ready(options.progress)
    robot: dict[str, Any] = {} if file.robot is None else {"controllers": file.controllers}
    found = run(
        record, file.setup, file.method, filtering=file.filtering, parameters=file.parameters, laws=laws,
        progress=options.progress, **robot,
    )  # fmt: skip
    deliver(found, options.json)
    return found
