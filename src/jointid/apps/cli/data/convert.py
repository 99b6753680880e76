"""`jointid data convert`: a file of one format into a file of another."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

from cyclopts import Parameter


def convert(
    source: Path,
    target: Path,
    /,
    *,
    columns: Annotated[list[str] | None, Parameter(negative=())] = None,
    delimiter: str | None = None,
    decimal: Literal[".", ","] | None = None,
    header: Annotated[bool | None, Parameter(negative="--no-header")] = None,
    mat_version: Literal["7", "7.3"] | None = None,
) -> None:
    """Write the columns of a file into a file of another format, and say what was renamed or had no place.

    Every number is kept to the last bit. The suffix of the target tells its format; a target without a suffix becomes
    the folder of a ROS 2 bag.

    Args:
        source: the file that is read, or the folder of a bag.
        target: the file that is written; one that is there is replaced, but never the source.
        columns: take this column alone; may be given several times.
        delimiter: of a text file that is read, where it is not found by itself.
        decimal: mark of a text file that is read, likewise.
        header: whether a text file that is read names its columns, likewise.
        mat_version: of a MAT file that is written; 7.3 is HDF5.
    """
    from jointid import convert as turn
    from jointid.apps.cli.console import check_outputs, show

    check_outputs(None, *([target] if target.suffix else []))
    given = {"delimiter": delimiter, "decimal": decimal, "header": header}
    reading = {key: value for key, value in given.items() if value is not None}
    writing = {} if mat_version is None else {"version": mat_version}
    show(turn(source, target, columns, reading=reading, writing=writing))
