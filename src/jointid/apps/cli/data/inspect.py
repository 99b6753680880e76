"""`jointid data inspect`: what is in a file, as a table with a small picture of every channel."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

from cyclopts import Parameter


def inspect(
    file: Path,
    /,
    *,
    delimiter: str | None = None,
    decimal: Literal[".", ","] | None = None,
    header: Annotated[bool | None, Parameter(negative="--no-header")] = None,
    json: Path | None = None,
    figure: Path | None = None,
) -> None:
    """List what is in a file: every channel with its rows, unit, sample time, range and a small picture.

    Any format that records are read from, and the folder of a ROS 2 bag. What is taken for a clock is said.

    Args:
        file: the file, or the folder of a bag.
        delimiter: of a text file, where it is not found by itself.
        decimal: mark of a text file, likewise.
        header: whether a text file names its columns, likewise.
        json: also write the answer as JSON to this file.
        figure: also save a picture of all channels, PNG, SVG or PDF by its suffix.
    """
    from jointid import inspect as look
    from jointid.apps.cli.console import check_outputs, show

    check_outputs(figure, json)
    given = {"delimiter": delimiter, "decimal": decimal, "header": header}
    inspection = look(file, **{key: value for key, value in given.items() if value is not None})
    show(inspection)
    if json is not None:
        from jointid.output import json as answers

        answers.write(answers.to_dict(inspection), json)
    if figure is not None:
        from jointid.output.figures import channels_figure
        from jointid.output.figures.figures import save

        save(channels_figure(inspection), figure)
