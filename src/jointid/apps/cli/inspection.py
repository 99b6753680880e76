"""`jointid inspect`: what is in a file of a record."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Annotated, Literal, TypeAlias

from cyclopts import Parameter

from jointid.apps.cli.console import deliver, require_kinds, show, spare
from jointid.common.errors import RecordError
from jointid.common.files import write_whole

Decimal: TypeAlias = Literal[".", ","]
Header: TypeAlias = Annotated[bool | None, Parameter(negative="--no-header")]


def inspect(
    file: Path,
    /,
    *,
    delimiter: str | None = None,
    decimal: Decimal | None = None,
    header: Header = None,
    json: Path | None = None,
    write: Path | None = None,
    axis: str | None = None,
) -> None:
    """List what is in a file, channel by channel.

    Each with its rows, unit, sample time and range.
    Any format that records are read from, and the folder of a ROS 2 bag or of several files. The answer says what is
    taken for a clock, and whose log it is, if known.

    Args:
        file: the file, or the folder of a bag.
        delimiter: of a text file, where it is not found by itself.
        decimal: mark of a text file, likewise.
        header: whether a text file names its columns, likewise.
        json: also write the answer as JSON to this file.
        write: also write a joint file that reads the log, never over a file.
        axis: number or name of its axis, where the log has several.
    """
    from jointid import inspect as look
    from jointid.config.logged import describe_log

    require_kinds(None, file)
    spare((json, write), file)
    if write is not None and write.exists():
        raise RecordError(f"{write} exists, and may hold what only you know; name another file, or remove it first.")
    options = {"delimiter": delimiter, "decimal": decimal, "header": header}
    found = look(file, **{name: value for name, value in options.items() if value is not None})
    text = ""
    if write is not None:  # what it refuses comes before any file
        text = describe_log(found, Path(os.path.relpath(file.absolute(), write.absolute().parent)).as_posix(), axis)
    deliver(found, json)
    if write is not None:
        write_whole(write, text)
        show(f"Written: {write}")
