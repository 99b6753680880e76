"""A worker process of the page: `python -m jointid.apps.web.worker MEMORY SECONDS WORDS`.

The words are a command of jointid or one of the actions below, run in the current folder. A file may be damaged and a
fit may take hours: the page survives any end of the process, whose memory and time are bounded. It ends when its
standard input is closed, at the end of the page.
"""

from __future__ import annotations

import os
import sys
import threading
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from jointid.apps.cli.app import app, run
from jointid.apps.cli.inspection import propose_columns
from jointid.apps.web.folder import Draft
from jointid.apps.web.form import TEXT, make_tables, show_tables
from jointid.common.arrays import FloatArray
from jointid.common.charts import MEASURED, panels, styled, svg
from jointid.common.errors import JointidError
from jointid.config.toml import parse_toml

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_DRAWN, _LISTED = 64, 2000  # most columns that are drawn, and that are listed
_STRETCHES, _LARGEST = 640, 1e300  # intervals of a drawn column, and its largest number


def preview() -> None:
    """Write the names and plots of the first record's columns, and proposals."""
    from jointid import inspect

    draft = Draft(Path.cwd())
    given = make_tables({one.key: draft.texts.get(one.key, "") for one in TEXT}, [])
    found = inspect(draft.path / draft.records[0], **given.get("record", {}))
    if not found.channels:
        raise JointidError(f"{found.file} holds no column with more than one number; choose another file.")
    for k, channel in enumerate(found.channels[:_DRAWN]):
        (draft.path / f"_plot-{k}.svg").write_bytes(svg(draw_column(channel.values), "column"))
    listed = [
        {"name": one.name, "samples": one.rows, "plot": f"{k}.svg" * (k < _DRAWN), "span": f"{np.ptp(one.values):.4g}"}
        for k, one in enumerate(found.channels[:_LISTED])
    ]
    columns, sentence, drive = propose_columns(found), "", dict[str, Any]()
    if found.recognised is not None:
        axes, sentence = found.recognised.axes, found.recognised.sentence
        place, columns = (axes[0].place, {}) if len(axes) > 1 else ({}, columns | dict(axes[0].channels))
        drive = {"profile": found.recognised.profile.name} | {key: place[key] for key in place if key != "index"}
    channels = {one: {"column": column} for one, column in columns.items() if column}
    clock = {channel.time: {"time": channel.time} for channel in found.channels if channel.time}
    record = {"channels": channels} | (clock.popitem()[1] if len(clock) == 1 else {})
    tables: dict[str, Any] = {"record": record, "joint": {"model": "flexible"}, "drive": drive}
    names = {channel.name: channel.unit for channel in found.channels}
    draft.write_json("_columns.json", {"columns": listed, "names": names, "tables": tables, "sentence": sentence})


def example() -> None:
    """Simulate the digital twin; write its record and forms."""
    from jointid import twin, write
    from jointid.paper.twin import JOINT_FILE

    write(twin().record, "example.csv")
    tables = parse_toml(JOINT_FILE.replace(", optional = true", ""))  # it has every channel
    Draft(Path.cwd()).enter(show_tables(tables))


def check() -> None:
    """Read the records as declared; write a summary of the first one."""
    from jointid.config import load

    draft, file = Draft(Path.cwd()), load("_order.toml")
    record, *_ = [part.record(path) for part, path in file.each([draft.path / name for name in draft.records])]
    torque, moved, gear = record.torque, record.reference or record.motor_position, file.joint.transmission
    size = {"samples": len(torque), "sample_time": torque.sample_time, "duration": torque.duration, "unit": torque.unit}
    if moved is not None:
        scale, unit = (180 / np.pi, "°") if moved.unit == "rad" else (1e3, " mm")
        size["travel"] = f"{scale * np.ptp(moved.values):.4g}{unit} of the {'axis' if gear is None else gear.side}"
    draft.write_json("_checked.json", size)


@styled
def draw_column(values: FloatArray) -> Figure:
    """Draw a column by the minima and maxima of intervals."""
    figure, (axes,) = panels([150], width=6.4)
    drawn = np.where(np.abs(values) < _LARGEST, values, np.nan)
    starts = np.arange(count := min(_STRETCHES, drawn.size)) * drawn.size // count
    low, high = np.fmin.reduceat(drawn, starts), np.fmax.reduceat(drawn, starts)
    across = np.linspace(0.0, values.size, low.size)
    axes.plot(np.repeat(across, 2), np.stack([low, high], axis=1).ravel(), color=MEASURED)
    axes.set_xlabel("row")
    return figure


def _end_with_the_page() -> None:
    """Exit when the standard input is closed, at the page's end."""
    while os.read(0, 1):  # unbuffered, since a thread must not hold the buffer's lock when Python ends
        pass
    os._exit(1)


if __name__ == "__main__":
    threading.Thread(target=_end_with_the_page, daemon=True).start()
    if sys.platform == "linux":
        import resource

        for limit, least in zip((resource.RLIMIT_AS, resource.RLIMIT_CPU), map(int, sys.argv[1:3]), strict=True):
            bounds = (least, most := resource.getrlimit(limit)[1])
            resource.setrlimit(limit, (min(one for one in bounds if one != resource.RLIM_INFINITY), most))
    for _action in (preview, example, check):
        app.command(_action, show=False)
    run(sys.argv[3:])
