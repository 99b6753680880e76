"""The commands `jointid inspect` and `diagnose`: contents and faults of records."""

from __future__ import annotations

import os
import re
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

from cyclopts import Parameter

from jointid.apps.cli.console import DEFAULTS, Flag, Options, deliver, require_kinds, show, spare
from jointid.common.errors import MethodError, RecordError
from jointid.common.files import write_whole

if TYPE_CHECKING:
    from jointid.config import File
    from jointid.diagnostics.diagnosis import Diagnosis
    from jointid.records.inspection import Inspection

_FAULTY = 3  # exit code for a faulty record, or for any finding
_NAMES = {
    "torque": "torque|moment|force|kraft|current|strom|\\biq",
    "reference": "(pos|lage|angle|winkel|^[xq]_).*(soll|set|ref|com|cmd)",
    "motor_position": "(pos|lage|angle|winkel).*(ist|act|meas|mot)",
}
"""Patterns of column names for a log of an unknown drive; a single match is proposed."""


def inspect(
    file: Path,
    /,
    *,
    delimiter: str | None = None,
    decimal: Literal[".", ","] | None = None,
    header: Annotated[bool | None, Parameter(negative="--no-header")] = None,
    json: Path | None = None,
    write: Path | None = None,
    axis: str | None = None,
) -> None:
    """List what is in a file, channel by channel.

    The file has any format of records, or is the folder of a ROS 2 bag or of several files. The answer names the clock,
    and the drive if recognised.

    Args:
        file: the file, or the folder of a bag.
        delimiter: of a text file; detected by default.
        decimal: decimal mark of a text file; detected by default.
        header: whether a text file names its columns; detected by default.
        json: also write the answer as JSON to this file.
        write: also write a joint file that reads the log, never over a file.
        axis: number or name of the axis, if the log has several.
    """
    from jointid import inspect as look
    from jointid.config.loading import describe_log

    require_kinds(None, file)
    spare((json, write), file)
    if write is not None and write.exists():
        raise RecordError(f"{write} exists, and may hold what only you know; name another file, or remove it first.")
    options = {"delimiter": delimiter, "decimal": decimal, "header": header}
    found = look(file, **{name: value for name, value in options.items() if value is not None})
    text = ""
    if write is not None:  # refuse before any file is written
        place = Path(os.path.relpath(file.absolute(), write.absolute().parent)).as_posix()
        text = describe_log(found, place, axis, propose_columns(found))
    deliver(found, json)
    if write is not None:
        write_whole(write, text)
        show(f"Written: {write}")


def propose_columns(found: Inspection) -> dict[str, str | None]:
    """Return the column of each channel by the names of the columns, None if unknown."""
    names = [channel.name for channel in found.channels]
    fitting = {one: [name for name in names if re.search(words, name.lower())] for one, words in _NAMES.items()}
    return {one: some[0] if len(some) == 1 else None for one, some in fitting.items()}


def diagnose(joint: Path, /, *, options: Options = DEFAULTS, laws: Flag = False) -> int:
    """Find faults of record, loop, log and joint.

    First the record: its clock, the torque and its limit, the motion, the controller (if the motor position was
    logged). Then, for each axis, the residual and its correlations, the identifiable parameters, and the faults of
    loop, log and mechanics that the record shows; of [[records]], each one. If the identification fails, the record
    is still reported. The exit code is 0 without findings, else 3.

    Args:
        joint: the joint file (TOML), or a robot file, which has the table [robot]. A joint whose controller is declared
            is identified by didim.
        options: those that most commands have.
        laws: also compare the laws of spring and friction, each by its prediction of parts of the record that it was
            not fitted to.
    """
    file = options.load(joint)
    if file.robot is None and file.loop is not None:
        file = options.load(joint, method="didim")
    pairs = file.each(() if options.record is None and file.only_lists else [file.record_path(options.record)])
    if len(pairs) > 1 and options.json is not None:
        raise MethodError(f"--json holds one record, and {joint} lists {len(pairs)}; name one of them by --record.")
    every = [_diagnose_record(part, Path(path), options, laws) for part, path in pairs]
    return 0 if all(found.healthy and not found.sentences for found in every) else _FAULTY


def _diagnose_record(file: File, path: Path, options: Options, laws: bool) -> Diagnosis:
    """Diagnose one record, and print and write the findings."""
    from jointid.diagnostics.diagnose import diagnose as run
    from jointid.diagnostics.diagnosis import Diagnosis, Symptom

    alone = replace(options, records=(path,))
    try:
        record = file.record(path)
    except RecordError as error:
        if not path.exists():
            raise
        found = Diagnosis(path.stem, symptoms=tuple(Symptom("unreadable", one) for one in error.faults))
    else:
        found = run(
            record, file.setup, file.method, filtering=file.filtering, parameters=file.parameters, laws=laws,
            search=lambda *_, **__: alone.find(file, record), progress=options.progress,
            controllers=() if file.robot is None else file.controllers,
        )  # fmt: skip
    deliver(found, options.json)
    return found
